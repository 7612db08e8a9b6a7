"""Obstacles as geoms of the twin, from their plain numbers."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from softdyn.description.inertia import rotation_rpy
from softdyn.safety.obstacles import HalfSpace, KeepOutBox, KeepOutSphere, Obstacle

CONTACTS = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


def add_obstacles(spec: mujoco.MjSpec, obstacles: Sequence[Obstacle]) -> None:
    """Add geoms `obstacle_0`, … to the world; only those with `contact` touch the links.

    If contacts of links are off, the links still do not touch each other.
    """
    if any(one.contact for one in obstacles) and spec.option.disableflags & CONTACTS:
        spec.option.disableflags &= ~CONTACTS
        for geom in spec.geoms:
            geom.conaffinity = 0
    for k, obstacle in enumerate(obstacles):
        geom = spec.worldbody.add_geom()
        geom.name, quaternion = f"obstacle_{k}", np.empty(4)
        geom.contype, geom.conaffinity = 0, int(obstacle.contact)
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
