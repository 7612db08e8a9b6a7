"""Obstacles as solid geoms of the twin, from their plain numbers, and the forces of contacts.

The links touch an obstacle with the shapes that barriers see: their collision primitives, which the
twin reads itself, and where a link has none its other shapes, meshes as convex hulls. The tip may
lie beyond the last shape; it touches as a point, and so does a point that an obstacle guards.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import mujoco
import numpy as np

from softdyn.description.inertia import rotation_rpy
from softdyn.description.robot import Robot
from softdyn.exceptions import InputError
from softdyn.safety.obstacles import HalfSpace, KeepOutBox, KeepOutSphere, Obstacle
from softdyn.safety.solids import Solid, link_solids
from softdyn.validation.twin.bodies import STATIC, Tree
from softdyn.validation.twin.build import body_name
from softdyn.validation.twin.settings import STIFF_SOLIMP, STIFF_SOLREF

CONTACTS = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
BODY = "obstacles"
LINKS, GUARDS = 1, 2  # bits: shapes that may touch each other, and those for obstacles alone
POINT = 1e-6  # m, the radius of a point
DEEP = 1e-3  # m: a run may not begin deeper in an obstacle


def obstacle_name(k: int) -> str:
    """The name of the geom of obstacle k."""
    return f"obstacle_{k}"


def add_obstacles(
    spec: mujoco.MjSpec, obstacles: Sequence[Obstacle], robot: Robot, tree: Tree
) -> None:
    """Add geoms `obstacle_0`, … of a body of the world; links touch those with `contact`.

    Contacts are as stiff as joint stops. If contacts of links are off, the links still do not touch
    each other.
    """
    solid = any(one.contact for one in obstacles)
    if solid and spec.option.disableflags & CONTACTS:
        spec.option.disableflags &= ~CONTACTS
        for geom in spec.geoms:
            geom.conaffinity = 0
    if solid:
        _add_guards(spec, obstacles, robot, tree)
    taken = {body.name for body in spec.bodies}
    # a body of its own, because the world's contacts with the first link are excluded
    body = spec.worldbody.add_body()
    body.name = next(name for n in range(len(taken) + 1) if (name := BODY + "_" * n) not in taken)
    for k, obstacle in enumerate(obstacles):
        geom = body.add_geom()
        geom.name, quaternion = obstacle_name(k), np.empty(4)
        geom.contype, geom.conaffinity = 0, (LINKS | GUARDS) * int(obstacle.contact)
        geom.priority, geom.mass = 1, 0.0
        geom.solref[:2], geom.solimp = STIFF_SOLREF, STIFF_SOLIMP
        if isinstance(obstacle, HalfSpace):
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_PLANE, (0.0, 0.0, 1.0)
            geom.pos = obstacle.offset * obstacle.normal
            mujoco.mju_quatZ2Vec(quaternion, obstacle.normal)
            geom.quat = quaternion
        elif isinstance(obstacle, KeepOutSphere):
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, (obstacle.radius, 0.0, 0.0)
            geom.pos = obstacle.centre
        elif isinstance(obstacle, KeepOutBox):
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, obstacle.size / 2
            geom.pos = obstacle.centre
            mujoco.mju_mat2Quat(quaternion, rotation_rpy(tuple(obstacle.rpy)).ravel())
            geom.quat = quaternion


def _add_guards(
    spec: mujoco.MjSpec, obstacles: Sequence[Obstacle], robot: Robot, tree: Tree
) -> None:
    """Add the shapes that touch obstacles alone: what the twin has no primitive for, and points."""
    try:
        solids = link_solids(robot, None)
    except InputError as error:
        guards_links = any(one.contact and one.links is not None for one in obstacles)
        if guards_links:
            raise
        warnings.warn(
            f"{robot.path}: no link touches an obstacle, only the point that it guards does: "
            f"{error.expected}, got {error.got}", stacklevel=2,
        )  # fmt: skip
        solids = ()
    shaped = {shape.link for body in tree.bodies for shape in body.shapes}
    for solid in solids:
        if solid.is_mesh or solid.link not in shaped:
            geom = _guard(spec, robot, tree, str(solid.link), solid.rotation, solid.centre)
            if geom is not None:
                _shape(spec, geom, solid)
    points = {(robot.task, (0.0, 0.0, 0.0))}
    points |= {(one.link, one.point) for one in obstacles if one.contact and one.link is not None}
    for link, point in sorted(points):
        geom = _guard(spec, robot, tree, link, np.eye(3), np.array(point))
        if geom is not None:
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, (POINT, 0.0, 0.0)


def _guard(
    spec: mujoco.MjSpec, robot: Robot, tree: Tree, link: str, rotation: np.ndarray, at: np.ndarray
) -> mujoco.MjsGeom | None:
    """A geom at a place of a link; None on a link that never moves, or that there is none."""
    index, pose = tree.place.get(link, (STATIC, np.eye(4)))
    body = tree.bodies[index]
    if body.joint is None:
        return None
    geom, quaternion = spec.body(body_name(robot, body.link)).add_geom(), np.empty(4)
    geom.pos = pose[:3, :3] @ at + pose[:3, 3]
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(pose[:3, :3] @ rotation).ravel())
    geom.quat, geom.mass = quaternion, 0.0
    geom.contype, geom.conaffinity = GUARDS, 0
    return geom


def _shape(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, solid: Solid) -> None:
    kinds = mujoco.mjtGeom
    if solid.is_mesh:
        assert solid.corners is not None
        mesh = spec.add_mesh()
        mesh.name = f"hull_{len(spec.meshes)}"
        mesh.uservert = np.ascontiguousarray(solid.corners).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom.type, geom.meshname = kinds.mjGEOM_MESH, mesh.name
    elif solid.round:
        geom.type = kinds.mjGEOM_CYLINDER
        geom.size = (solid.half[0], solid.half[2], 0.0)
    elif solid.half.any():
        geom.type, geom.size = kinds.mjGEOM_BOX, solid.half
    else:
        geom.type, geom.size = kinds.mjGEOM_SPHERE, (solid.swept, 0.0, 0.0)


class Contacts:
    """The contacts of a twin's links with its solid obstacles.

    Parameters
    ----------
    model : mujoco.MjModel
        The compiled model.
    obstacles : sequence of Obstacle
        All obstacles of the twin.

    Attributes
    ----------
    solid : tuple of int
        The numbers of the obstacles that links touch.
    """

    def __init__(self, model: mujoco.MjModel, obstacles: Sequence[Obstacle]) -> None:
        self._model = model
        self.solid = tuple(k for k, one in enumerate(obstacles) if one.contact)
        self._row = {model.geom(obstacle_name(k)).id: row for row, k in enumerate(self.solid)}

    def forces(self, data: mujoco.MjData) -> np.ndarray:
        """The force (solid, 3) of each solid obstacle on the robot, in the world's axes (N).

        It belongs to the state at which `data` was last evaluated.
        """
        found, force = np.zeros((len(self.solid), 3)), np.empty(6)
        for i in range(data.ncon):
            contact = data.contact[i]
            first, second = contact.geom
            row = self._row.get(int(first), self._row.get(int(second)))
            if row is None:
                continue
            mujoco.mj_contactForce(self._model, data, i, force)
            # the frame's rows are the contact's axes; its first leads from geom 1 to geom 2
            pushed = force[:3] @ contact.frame.reshape(3, 3)
            found[row] += pushed if int(first) in self._row else -pushed
        return found

    def deepest(self, data: mujoco.MjData) -> tuple[int, str, float] | None:
        """The obstacle, the body and the depth (m) of the deepest contact; None without one."""
        worst: tuple[int, str, float] | None = None
        for contact in data.contact:
            geoms = [int(g) for g in contact.geom]
            rows = [self._row[g] for g in geoms if g in self._row]
            if rows and contact.dist < -(worst[2] if worst else 0.0):
                other = next(g for g in geoms if g not in self._row)
                body = self._model.body(int(self._model.geom_bodyid[other])).name
                worst = self.solid[rows[0]], body, -float(contact.dist)
        return worst


def check_start(contacts: Contacts, data: mujoco.MjData, names: Sequence[str]) -> None:
    """Refuse a state inside a solid obstacle, which would throw the robot out.

    Parameters
    ----------
    contacts, data
        The contacts and the evaluated state.
    names : sequence of str
        A name for each obstacle.

    Raises
    ------
    InputError
        A link is deeper than 1 mm in an obstacle.
    """
    found = contacts.deepest(data)
    if found is not None and found[2] > DEEP:
        k, body, depth = found
        expected = "a start outside of obstacles (contact = false makes a region to keep out of)"
        raise InputError("q0", expected, f"link {body!r} {1e3 * depth:.3g} mm inside {names[k]!r}")
