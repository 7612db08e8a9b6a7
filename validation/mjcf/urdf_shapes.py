"""The shapes of an MJCF as looks of URDF links, and the shapes that a URDF cannot state.

A shape that can touch becomes a ``<collision>``, one that MuJoCo's viewer shows a ``<visual>``. A
capsule becomes a cylinder with a sphere at each end, because most readers of URDF know no other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import mujoco
import numpy as np

from softdyn.description.robot import Origin
from softdyn.description.urdf_writer import origin, tag
from softdyn.validation.mjcf.comparison.neutral import WORLD, Neutral
from softdyn.validation.mjcf.scenery import SHOWN_GROUPS
from softdyn.validation.mjcf.transform import angles

GEOMS = mujoco.mjtGeom
Looks = dict[int, list[str]]  # part, or the root → elements of its link


def looks_of(model: mujoco.MjModel, robot: Neutral) -> tuple[Looks, tuple[str, ...]]:
    """The shapes of each part as URDF elements, and a line for each body that loses some.

    Parameters
    ----------
    model : mujoco.MjModel
        Compiled with all shapes.
    robot : Neutral
        The same file; the axes of a part's link are the root's, its origin is on the part's joint.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    looks: Looks = {}
    lost: dict[int, Counter[str]] = {}
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        part = _carrier(model, body)
        kinds = ["visual"] * bool(model.geom_group[geom] < SHOWN_GROUPS)
        kinds += ["collision"] * bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
        start = np.zeros(3) if part == WORLD else robot.parts[part].point
        shapes = list(_shapes(model, data, geom, start))
        for kind in kinds if shapes else ():
            looks.setdefault(part, []).extend(_element(model, geom, kind, s) for s in shapes)
        if not (kinds and shapes):
            word = GEOMS(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
            lost.setdefault(body, Counter())[word if kinds else f"hidden {word}"] += 1
    return looks, tuple(_words(model, body, counts) for body, counts in lost.items())


def _carrier(model: mujoco.MjModel, body: int) -> int:
    """The part that carries a body: the neutral form has one for each joint, in the same order."""
    while body and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    return int(model.body_jntadr[body] + model.body_jntnum[body]) - 1 if body else WORLD


def _shapes(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, start: np.ndarray
) -> Iterator[str]:
    """A shape as origin and geometry; several for a capsule, none for what a URDF cannot state."""
    turn, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom] - start
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]

    def at(element: str, along: float = 0.0) -> str:
        xyz = tuple((place + along * turn[:, 2]).tolist())
        return origin(Origin(xyz, angles(turn))) + tag("geometry", element)

    if kind == GEOMS.mjGEOM_BOX:
        yield at(tag("box", size=2 * size))
    elif kind == GEOMS.mjGEOM_SPHERE:
        yield at(tag("sphere", radius=size[0]))
    elif kind in (GEOMS.mjGEOM_CYLINDER, GEOMS.mjGEOM_CAPSULE):
        yield at(tag("cylinder", radius=size[0], length=2 * size[1]))
        for end in (-1, 1) if kind == GEOMS.mjGEOM_CAPSULE else ():
            yield at(tag("sphere", radius=size[0]), end * size[1])


def _element(model: mujoco.MjModel, geom: int, kind: str, shape: str) -> str:
    name = model.geom(geom).name or None
    if kind == "collision":
        return tag(kind, shape, name=name)
    colour = tag("color", rgba=np.clip(model.geom_rgba[geom].astype(float), 0.0, 1.0))
    return tag(kind, shape, tag("material", colour, name=f"geom_{geom}"), name=name)


def _words(model: mujoco.MjModel, body: int, counts: Counter[str]) -> str:
    kinds = (f"{count} {kind}" for kind, count in counts.items())
    return f"shapes of body {model.body(body).name or body!r}: {', '.join(kinds)}"
