"""The shapes of a user's MJCF: its geoms, and the surroundings of the robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np

from softdyn.description.meshes import Mesh, shown
from softdyn.description.visuals import BoxShape, CylinderShape, Shape, SphereShape, Visual
from softdyn.validation.mjcf.scene import Scene
from softdyn.view.scene import WORLD

SHOWN_GROUPS = 3  # MuJoCo's viewer shows groups 0, 1 and 2 by default
MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


def scenery(scene: Scene) -> tuple[Visual, ...]:
    """The static shapes of a scene except the robot's base, in world coordinates.

    A plane becomes a slab of its size; an infinite plane is three robots wide. Height fields and
    moving shapes are left out.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_kinematics(model, data)
    bases = set()
    for name in scene.comparison.matched.values():
        body = int(model.jnt_bodyid[scene.joint_names.index(name)])
        while body:
            bases.add(body)
            body = int(model.body_parentid[body])
    still = [
        shape
        for geom, shape in geom_visuals(model, data)
        if model.body_weldid[body := int(model.geom_bodyid[geom])] == 0 and body not in bases
    ]
    return (*still, *_slabs(model, data, 3 * max(scene.robot.length, 0.1)))


def geom_visuals(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[tuple[int, Visual]]:
    """Number and shapes of every geom that MuJoCo's viewer shows, placed in the world by `data`."""
    geoms = _shown(model)
    used = {int(k) for k in model.geom_dataid[geoms[model.geom_type[geoms] == MESH]]}
    meshes = {k: _mesh(model, k) for k in used}
    for geom in map(int, geoms):
        for shape, local in _shapes(model, geom, meshes):
            yield geom, _placed(model, data, geom, shape, local)


def _shown(model: mujoco.MjModel) -> np.ndarray:
    seen = model.geom_group < SHOWN_GROUPS
    return np.flatnonzero(seen if seen.any() else ~seen)


def _placed(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, shape: Shape, local: np.ndarray
) -> Visual:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    return Visual(WORLD, pose @ local, shape, tuple(map(float, model.geom_rgba[geom])))


def _slabs(model: mujoco.MjModel, data: mujoco.MjData, wide: float) -> Iterator[Visual]:
    """The planes of the world, each a slab below its surface."""
    for geom in map(int, _shown(model)):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            x, y = (min(size, wide) if size > 0 else wide for size in model.geom_size[geom][:2])
            below = np.eye(4)
            below[2, 3] = -(thick := 0.005 * wide) / 2
            yield _placed(model, data, geom, BoxShape((2 * x, 2 * y, thick)), below)


def _shapes(
    model: mujoco.MjModel, geom: int, meshes: Mapping[int, Mesh]
) -> Iterator[tuple[Shape, np.ndarray]]:
    """The shapes of a geom in its frame; planes and height fields are left out."""
    kinds, here = mujoco.mjtGeom, np.eye(4)
    kind, size = int(model.geom_type[geom]), model.geom_size[geom].tolist()
    if kind == MESH:
        yield meshes[int(model.geom_dataid[geom])], here
    elif kind == kinds.mjGEOM_BOX:
        yield BoxShape((2 * size[0], 2 * size[1], 2 * size[2])), here
    elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        axes = size if kind == kinds.mjGEOM_ELLIPSOID else size[:1] * 3
        yield SphereShape(1.0), np.diag([*axes, 1.0])
    elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
        yield CylinderShape(size[0], 2 * size[1]), here
        for end in (-1, 1) if kind == kinds.mjGEOM_CAPSULE else ():
            moved = here.copy()
            moved[2, 3] = end * size[1]
            yield SphereShape(size[0]), moved


def _mesh(model: mujoco.MjModel, k: int) -> Mesh:
    first, count = model.mesh_vertadr[k], model.mesh_vertnum[k]
    faces = model.mesh_face[model.mesh_faceadr[k] :][: model.mesh_facenum[k]]
    return shown(model.mesh_vert[first : first + count].astype(float), np.array(faces, int))
