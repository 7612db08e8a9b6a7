"""Chambers whose area changes with their stretch, in the twin.

MuJoCo's gears are constant, so the twin sets them at each step, from its own lengths of the tendons
at the step's start. That is the explicit force of the schemes of order 1. With Runge-Kutta they are
set at each of the four stages.
"""

from __future__ import annotations

import mujoco
import numpy as np

from softdyn.description.robot import Robot


class ChamberAreas:
    """The areas of a robot's chambers on a MuJoCo model.

    Parameters
    ----------
    robot : Robot
        The description.
    model : mujoco.MjModel
        Its MuJoCo model, whose gears change.
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self._model, self._laws = model, []
        paths = {tendon.name: bool(tendon.sites) for tendon in robot.tendons}
        for one in robot.actuators:
            if one.area_growth:
                place, tendon = model.actuator(one.name).id, model.tendon(one.tendon).id
                # the length of joint terms counts from the straight robot
                known = 0.0 if paths[one.tendon] else 1.0
                law = np.polynomial.Polynomial((1.0, *one.area_growth)) * one.gear
                self._laws.append((place, tendon, known, one.area_length, law))

    def update(self, data: mujoco.MjData) -> None:
        """Set the gears for the present positions."""
        model = self._model
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        for place, tendon, known, length, law in self._laws:
            stretch = known + data.ten_length[tendon] / length
            model.actuator_gear[place, 0] = law(stretch - 1.0)
