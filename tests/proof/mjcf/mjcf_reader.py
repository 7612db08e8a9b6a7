"""An MJCF read by Pinocchio's own reader, as plain numbers.

No model is made from it. A comparison checks it against MuJoCo's reading.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from softdyn.exceptions import UrdfError, one_line


@dataclass(frozen=True, eq=False)
class Reading:
    """A joint that Pinocchio read, and the body it carries, at q = 0 in the world.

    Attributes
    ----------
    name : str
        The joint's name.
    parent : int
        Index of the joint that carries it, -1 for the world.
    directions : np.ndarray, (freedoms, 6)
        Motion of each degree of freedom: angular velocity, velocity at the world's origin.
    free, ball : bool
        Whether it is a free or a ball joint.
    mass : float
        Mass (kg).
    com, tensor : np.ndarray, (3,), (3, 3)
        Centre of mass, and inertia about it (kg·m²).
    rotation, translation : np.ndarray, (3, 3), (3,)
        The joint's frame.
    armature : np.ndarray, (freedoms,)
    """

    name: str
    parent: int
    directions: np.ndarray
    free: bool
    ball: bool
    mass: float
    com: np.ndarray
    tensor: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    armature: np.ndarray


def read_mjcf_by_pinocchio(path: Path) -> tuple[tuple[Reading, ...], np.ndarray]:
    """The joints that ``pin.buildModelFromMJCF`` reads, parents first, and gravity (3,).

    Parameters
    ----------
    path : Path
        A file that was checked before, because Pinocchio opens every file that it names.

    Raises
    ------
    UrdfError
        If Pinocchio refuses it.
    """
    try:
        model = pin.buildModelFromMJCF(str(path))
    except Exception as error:  # its parser raises exceptions of any kind
        got = one_line(str(error).rpartition("message:\n")[2].strip())
        raise UrdfError(path, "<mujoco>", "a file that Pinocchio reads", got) from None
    model = model[0] if isinstance(model, tuple) else model
    data = model.createData()
    jacobian = pin.computeJointJacobians(model, data, pin.neutral(model))
    jacobian = np.reshape(jacobian, (6, model.nv))  # with one degree of freedom it is a vector
    readings = []
    for joint in range(1, model.njoints):
        first, count = model.idx_vs[joint], model.nvs[joint]
        # spatial velocity at the world's origin: linear over angular in Pinocchio
        columns = jacobian[:, first : first + count]
        inertia, pose = model.inertias[joint], data.oMi[joint]
        kind = model.joints[joint].shortname()
        readings.append(
            Reading(
                model.names[joint], model.parents[joint] - 1,
                np.concatenate((columns[3:], columns[:3])).T.copy(),
                kind == "JointModelFreeFlyer", kind.startswith("JointModelSpherical"),
                float(inertia.mass), pose.act(inertia.lever),
                pose.rotation @ inertia.inertia @ pose.rotation.T,
                pose.rotation.copy(), pose.translation.copy(),
                np.array(model.armature[first : first + count]),
            )
        )  # fmt: skip
    return tuple(readings), np.array(model.gravity.linear)
