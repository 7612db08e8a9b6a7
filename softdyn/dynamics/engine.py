"""Build Pinocchio's model of a robot, check it against the strict parse, and view its memory."""

from __future__ import annotations

import threading
import warnings
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from softdyn.description.inertia import MICROMETRE, Inertia
from softdyn.description.robot import Joint, Robot, moving_bodies
from softdyn.exceptions import UrdfError

# A floating base in v: velocity of its origin and angular velocity, both in its own axes.
BASE = ("base_vx", "base_vy", "base_vz", "base_wx", "base_wy", "base_wz")
FREE = "floating base"  # the name of its joint in Pinocchio


def free_joint(robot: Robot) -> Joint:
    """The joint of a floating base, which the file does not hold."""
    return Joint(FREE, "floating", "", robot.root)


def build_engine(robot: Robot) -> pin.Model:
    """Pinocchio's model of the file, checked against the strict parse.

    Raises
    ------
    UrdfError
        If Pinocchio refuses the file or reads other joints or inertias, or if no joint moves.
    """
    try:
        free = (pin.JointModelFreeFlyer(), FREE) if robot.floating else ()
        model = pin.buildModelFromXML(robot.xml, *free)
    except (ValueError, RuntimeError) as error:
        raise UrdfError(robot.path, "<robot>", "a URDF that Pinocchio reads", error) from None
    model.gravity.linear = np.array(robot.gravity)
    moving = {joint.name: joint for joint in robot.moving_joints}
    if robot.floating:
        if FREE in moving:
            where = f'<joint name="{FREE}">'
            raise UrdfError(robot.path, where, "another name, this one being the base's own", FREE)
        moving = {FREE: free_joint(robot)} | moving
    if not moving:
        raise UrdfError(robot.path, "<robot>", "at least one joint that moves", "none")
    freedoms = len(moving) + (5 if robot.floating else 0)
    if set(model.names[1:]) != set(moving) or model.nv != freedoms:
        raise UrdfError(robot.path, "<robot>", f"joints {sorted(moving)}", list(model.names[1:]))
    bodies = moving_bodies(robot)
    for joint, inertia in zip(model.names[1:], model.inertias[1:], strict=True):
        link = moving[joint].child
        _check_inertia(robot, link, inertia, bodies[link])
    return model


def _check_inertia(robot: Robot, link: str, read: pin.Inertia, body: Inertia) -> None:
    """Compare Pinocchio's inertia of a moving body with the strict parse's, up to rounding."""
    size = max(1.0, float(np.abs(body.com).max()))
    slack = 1e-9 * np.abs(body.tensor).max() + MICROMETRE**2 * body.mass
    compared: list[tuple[str, str, Any, Any, float]] = [
        ("mass", "kg", body.mass, read.mass, max(1e-9 * body.mass, 1e-12)),
        ("inertia", "kg m^2", body.tensor, read.inertia, slack),
    ]
    if body.mass > 0:  # a massless body has no centre of mass
        compared.insert(1, ("centre of mass", "m", body.com, read.lever, 1e-9 * size))
    for what, unit, expected, got, tolerance in compared:
        if not np.abs(np.subtract(got, expected)).max() <= tolerance:
            texts = (" ".join(f"{x:g}" for x in np.ravel(values)) for values in (expected, got))
            raise UrdfError(
                robot.path,
                f'<link name="{link}">',
                f"{what} {next(texts)} {unit}, its fixed links included",
                f"{next(texts)} {unit} in Pinocchio",
            )


def moved_bodies(model: pin.Model) -> np.ndarray:
    """Whether a degree of freedom moves a body: (nv, bodies) bool."""
    moves = np.zeros((model.nv, model.njoints), bool)
    for body in range(1, model.njoints):
        for j in model.supports[body]:
            moves[model.idx_vs[j] : model.idx_vs[j] + model.nvs[j], body] = True
    return moves


def joint_tree(model: pin.Model) -> np.ndarray:
    """For each degree of freedom the body that it moves first, and the body before: (nv, 2).

    A joint's first degree of freedom adds to the twist of the parent's body, its others to that of
    its own body.
    """
    bodies = [j for j in range(1, model.njoints) for _ in range(model.nvs[j])]
    before = [model.parents[j] if j not in bodies[:k] else j for k, j in enumerate(bodies)]
    return np.column_stack((bodies, before)).astype(int)


class Memory(NamedTuple):
    """The results of Pinocchio's algorithms in a Data, as the kernels read them.

    Attributes
    ----------
    bias : ndarray, (nv,)
        C q̇ + g, from `nonLinearEffects`.
    S : ndarray, (nv, 6)
        Joint Jacobian columns about the world's origin, as rows.
    momenta, centre : ndarray, (nv, 6), (3,)
        Columns of the centroidal map, as rows, and the centre of mass, their reference point.
    rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
        Joint placements.
    """

    bias: np.ndarray
    S: np.ndarray
    momenta: np.ndarray
    centre: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray

    def copy_from(self, data: pin.Data) -> None:
        """Copy the current results in `data` into these arrays."""
        for array, found in zip(self, _read(data), strict=True):
            array[...] = found


def memory(data: pin.Data) -> tuple[Memory, bool]:
    """Views of a Data's memory, which Pinocchio's algorithms update in place, and True.

    Views save time: each accessor of Data costs a microsecond, and `oMi` costs one for each joint.
    `oMi` is a C++ vector of (rotation, translation) pairs, contiguous by the standard. If this
    Pinocchio has another memory layout, the function warns and returns copies, which
    `Memory.copy_from` updates, and False.
    """
    rotations = [placement.rotation for placement in data.oMi]
    translations = [placement.translation for placement in data.oMi]
    found = _read(data)
    views = found._replace(rotations=_stacked(rotations), translations=_stacked(translations))
    seen = (*views[:4], *views.rotations, *views.translations)
    held = (data.nle, data.J, data.Ag, data.com[0], *rotations, *translations)
    if all(view.flags.c_contiguous for view in views[:4]) and all(
        view.ctypes.data == array.ctypes.data for view, array in zip(seen, held, strict=True)
    ):
        return views, True
    warnings.warn(
        "this Pinocchio keeps its results in an unknown layout: they are copied in every step",
        RuntimeWarning,
        stacklevel=2,
    )
    return Memory(*(np.array(array, order="C") for array in found)), False


class Scratch:
    """A Data of Pinocchio with views of its results; a copy is a new one, without results.

    A copy of an array is no longer a view, and would keep old results for ever. So no other object
    keeps views of a Data.

    Parameters
    ----------
    model : pinocchio.Model
        The engine's model.

    Attributes
    ----------
    model : pinocchio.Model
        The engine's model.
    data : pinocchio.Data
        The algorithms write to it.
    memory, in_view : Memory, bool
        The results of `memory`.
    arguments : tuple
        A kernel's arguments, views among them; its first call fills them in.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model, self.data = model, model.createData()
        self.memory, self.in_view = memory(self.data)
        self.arguments: tuple[Any, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.model,)

    def results(self) -> Memory:
        """The results of the algorithms that ran last."""
        if not self.in_view:
            self.memory.copy_from(self.data)
        return self.memory


class ThreadScratch(threading.local, Scratch):
    """Scratch memory of which each thread gets its own.

    Attributes
    ----------
    latest : ndarray or None
        The q of the State whose kinematics the memory still holds.
    """

    def __init__(self, model: pin.Model) -> None:
        Scratch.__init__(self, model)
        self.latest: np.ndarray | None = None


def _read(data: pin.Data) -> Memory:
    """Read through Data's accessors; with one joint, Pinocchio returns matrices as vectors."""
    n = len(data.nle)
    rotations = np.array([placement.rotation for placement in data.oMi])
    translations = np.array([placement.translation for placement in data.oMi])
    J, Ag = data.J.T.reshape(n, 6), data.Ag.T.reshape(n, 6)
    return Memory(data.nle, J, Ag, data.com[0], rotations, translations)


def _stacked(arrays: list[np.ndarray]) -> np.ndarray:
    """One view of arrays that follow each other in memory at even distances."""
    first, last = arrays[0], arrays[-1]
    stride = (last.ctypes.data - first.ctypes.data) // max(len(arrays) - 1, 1)
    return as_strided(first, (len(arrays), *first.shape), (stride, *first.strides))
