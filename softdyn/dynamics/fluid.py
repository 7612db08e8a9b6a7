"""The drag of a fluid on the links: MuJoCo's model of a body as a box of its inertia.

A body of mass m has the principal moments I_1, I_2, I_3 about its centre of mass. It is taken for a
box with the edges

    b_i = √(6 (I_j + I_k - I_i) / m).

Along the box's axes the centre of mass has the velocity v, and the body the angular velocity ω. A
fluid of the density ρ and the viscosity μ acts with the force f and the torque τ,

    f_i = -3 π b μ v_i - ½ ρ b_j b_k |v_i| v_i,
    τ_i = -π b³ μ ω_i - ρ/64 b_i (b_j⁴ + b_k⁴) |ω_i| ω_i,

where b is the mean edge (MuJoCo's documentation, "Computation", passive forces). The joint force is
Σ Jᵀ (f, τ) over the bodies. Added mass and buoyancy are absent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from softdyn.checks import read_only
from softdyn.description.robot import Fluid as Fluid  # a public name of the room
from softdyn.dynamics.engine import ThreadScratch

LEAST = 1e-15  # kg, m: MuJoCo's least mass of a body with drag, and its least moment


class FluidDrag:
    """The drag as a force of the model; it meets the contract of `softdyn.dynamics.forces.Force`.

    Parameters
    ----------
    engine : pinocchio.Model
        The engine's model of the robot.
    fluid : Fluid
        Density and viscosity.
    floating : bool
        Whether the base floats: its place changes nothing, and would cost digits.
    """

    name = "fluid"

    def __init__(self, engine: pin.Model, fluid: Fluid, floating: bool) -> None:
        self._given = engine, fluid, floating
        model = engine.copy()
        model.gravity.linear = np.zeros(3)
        self._scratch, self._floating = ThreadScratch(model), floating
        self._bodies: list[int] = []
        places, boxes = [], []
        for k in range(1, model.njoints):
            inertia = model.inertias[k]
            if inertia.mass < LEAST:
                continue
            moments, axes = np.linalg.eigh(inertia.inertia)
            rest = np.maximum(moments.sum() - 2 * moments, LEAST)
            boxes.append(np.sqrt(6 * rest / inertia.mass))
            axes[:, 2] *= np.sign(np.linalg.det(axes))
            places.append(pin.SE3(axes, inertia.lever))
            self._bodies.append(k)
        box = np.array(boxes).reshape(-1, 3)
        across = np.roll(box, -1, 1), np.roll(box, -2, 1)
        mean = box.mean(axis=1, keepdims=True)
        rho, mu = fluid.density, fluid.viscosity
        # (bodies, 6): force, then torque
        self._linear = read_only(
            np.hstack((np.tile(3 * np.pi * mu * mean, 3), np.tile(np.pi * mu * mean**3, 3)))
        )
        turning = box * (across[0] ** 4 + across[1] ** 4) / 64
        self._square = read_only(rho * np.hstack((across[0] * across[1] / 2, turning)))
        # velocities of the joints' frames to those of the boxes, (bodies, 6, 6)
        actions = [place.actionInverse for place in places]
        self._actions = read_only(np.array(actions).reshape(-1, 6, 6))

    def __reduce__(self) -> tuple[Any, ...]:
        return FluidDrag, self._given

    def __call__(self, model: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """F (n,) in the order of v (N m, N)."""
        engine, data, here = self._at(q)
        pin.forwardKinematics(engine, data, here, v)
        wrenches = self._wrenches(self._twists(data))[0]
        zero = np.zeros(len(v))
        return -np.array(pin.rnea(engine, data, here, zero, zero, self._applied(wrenches)))

    def derivatives(
        self, model: Any, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n)."""
        engine, data, here = self._at(q)
        n = len(v)
        zero, by_q, by_v = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
        pin.computeForwardKinematicsDerivatives(engine, data, here, v, zero)
        wrenches, slopes = self._wrenches(self._twists(data))
        for body, action, slope in zip(self._bodies, self._actions, slopes, strict=True):
            moved, J = (
                action @ np.reshape(one, (6, n))
                for one in pin.getJointVelocityDerivatives(
                    engine, data, body, pin.ReferenceFrame.LOCAL
                )
            )
            by_q -= J.T @ (slope[:, None] * moved)
            by_v -= J.T @ (slope[:, None] * J)
        turned = pin.computeStaticTorqueDerivatives(engine, data, here, self._applied(wrenches))
        return by_q - np.reshape(turned, (n, n)), by_v

    def energy(self, model: Any, q: np.ndarray) -> float:
        """The potential (J) of the force at rest, where it is zero."""
        return 0.0

    def _at(self, q: np.ndarray) -> tuple[pin.Model, pin.Data, np.ndarray]:
        """The engine without gravity, its memory, and q with the base at the origin."""
        here = q
        if self._floating:
            here = np.array(q)
            here[:3] = 0.0
        return self._scratch.model, self._scratch.data, here

    def _twists(self, data: pin.Data) -> np.ndarray:
        """Velocities (bodies, 6) of the boxes along their axes, the linear ones first."""
        joints = np.array([data.v[k].vector for k in self._bodies]).reshape(-1, 6, 1)
        found: np.ndarray = (self._actions @ joints)[..., 0]
        return found

    def _wrenches(self, twists: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Wrenches (bodies, 6) in the joints' frames; minus the slopes along the boxes' axes."""
        sizes = np.abs(twists)
        acting = -(self._linear + self._square * sizes) * twists
        return (
            (self._actions.transpose(0, 2, 1) @ acting[..., None])[..., 0],
            self._linear + 2 * self._square * sizes,
        )

    def _applied(self, wrenches: np.ndarray) -> pin.StdVec_Force:
        """The wrenches as the engine's external forces."""
        applied = pin.StdVec_Force(self._scratch.model.njoints, pin.Force.Zero())
        for k, wrench in zip(self._bodies, wrenches, strict=True):
            applied[k] = pin.Force(wrench)
        return applied
