"""A twin with the collision geometry of an MJCF file, and a plant that is such a twin."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from softdyn.exceptions import InputError
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.validation.twin.twin import Twin


class BorrowedShapes(Twin):
    """A twin with the collision geometry of an MJCF file of the same robot in place of its own.

    The file's meshes collide as their convex hulls. Links touch the static base even where they are
    its neighbours, and two geoms have one contact point, as MuJoCo 3 does by default. Friction cone
    and tolerances are the file's. All else stays as in `Twin`.

    Parameters
    ----------
    shapes : Path
        An MJCF file with as many joints, in the same order, and a base that is only shifted.
    *arguments, **options
        The arguments of `Twin`.

    Raises
    ------
    InputError
        The file cannot be read, or has another number of joints.
    """

    def __init__(self, shapes: Path, *arguments: Any, **options: Any) -> None:
        self._shapes = shapes
        super().__init__(*arguments, **options)

    def amend(self, spec: mujoco.MjSpec) -> None:
        """Put the file's geoms in place of the robot's."""
        source = read(self._shapes)
        model = source.compile()
        joints = list(spec.joints)
        if model.nv != len(joints):
            raise InputError(str(self._shapes), f"{len(joints)} joints", model.nv)
        for geom in list(spec.geoms):
            spec.delete(geom)
        for exclude in list(spec.excludes):
            if "world" in (exclude.bodyname1, exclude.bodyname2):
                spec.delete(exclude)
        for mesh, file in zip(source.meshes, mesh_files(source, self._shapes), strict=True):
            added = spec.add_mesh()
            added.name = mesh.name or Path(mesh.file).stem
            added.file = str(file)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        base = data.xpos[model.jnt_bodyid[0]] - joints[0].parent.pos
        for geom in source.geoms:
            if model.geom_contype[geom.id]:
                _copy(geom, model, data, spec, joints, base)
        option = spec.option
        option.cone, option.tolerance = model.opt.cone, model.opt.tolerance
        option.ls_tolerance = model.opt.ls_tolerance
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MULTICCD)


@dataclass(frozen=True)
class BorrowedPlant(PlantErrors):
    """Plant errors of a twin whose links touch with the shapes of an MJCF file.

    Attributes
    ----------
    shapes : Path
        The file.
    sha256 : str
        The hash of its content, which makes stored runs depend on it.
    """

    shapes: Path = Path()
    sha256: str = ""

    @classmethod
    def of(cls, errors: PlantErrors, shapes: Path) -> BorrowedPlant:
        """The plant errors, with the shapes of a file; links can touch.

        Raises
        ------
        InputError
            The file cannot be read.
        """
        own = {field.name: getattr(errors, field.name) for field in fields(PlantErrors)}
        return cls(**own | {"contacts": True}, shapes=shapes, sha256=content(shapes))

    def twin(self, *arguments: Any, **options: Any) -> Twin:
        """The twin with the file's shapes and these differences."""
        friction = options.get("friction", False) or self.rubs
        options |= {"contacts": True, "friction": friction}
        return self.applied(BorrowedShapes(self.shapes, *arguments, **options))


def read(shapes: Path) -> mujoco.MjSpec:
    """An MJCF file that MuJoCo can compile.

    Raises
    ------
    InputError The file cannot be compiled.
    """
    try:
        source = mujoco.MjSpec.from_file(str(shapes))
        source.compile()
    except ValueError as error:
        raise InputError(str(shapes), "an MJCF file", error) from None
    return source


def mesh_files(source: mujoco.MjSpec, shapes: Path) -> list[Path]:
    """The mesh files of an MJCF file, in the order of the file."""
    folder = shapes.parent / source.meshdir
    return [(folder / mesh.file).resolve() for mesh in source.meshes]


def content(shapes: Path) -> str:
    """SHA-256 of an MJCF file, of the files that it includes and of its meshes.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    source = read(shapes)
    meshes = [file.read_bytes() for file in mesh_files(source, shapes) if file.is_file()]
    return hashlib.sha256(b"\0".join([source.to_xml().encode(), *meshes])).hexdigest()


def _copy(
    geom: mujoco.MjsGeom,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    spec: mujoco.MjSpec,
    joints: list[mujoco.MjsJoint],
    base: np.ndarray,
) -> None:
    """Add a geom of the source to our body that the same joints move."""
    body, target = model.geom_bodyid[geom.id], spec.worldbody
    pos, quat, size = (a[geom.id] for a in (model.geom_pos, model.geom_quat, model.geom_size))
    if geom.meshname:  # the compiler has moved it to the mesh's centre, and will do so again
        mesh, turned, moved = model.geom_dataid[geom.id], np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(turned, model.mesh_quat[mesh])
        mujoco.mju_mulQuat(turned, quat, turned.copy())
        mujoco.mju_rotVecQuat(moved, model.mesh_pos[mesh], turned)
        pos, quat, size = pos - moved, turned, np.zeros(3)
    if model.body_dofnum[body]:
        target = joints[model.body_dofadr[body] + model.body_dofnum[body] - 1].parent
    else:  # static: in the world's frame
        turned, rotated = np.zeros(4), np.zeros(3)
        mujoco.mju_mulQuat(turned, data.xquat[body], quat / np.linalg.norm(quat))
        mujoco.mju_rotVecQuat(rotated, pos, data.xquat[body])
        pos, quat = rotated + data.xpos[body] - base, turned
    added = target.add_geom()
    added.type, added.size, added.meshname = geom.type, size, geom.meshname
    added.pos, added.quat, added.mass = pos, quat, 0.0
    added.contype = added.conaffinity = 1
    added.friction, added.condim = model.geom_friction[geom.id], model.geom_condim[geom.id]
