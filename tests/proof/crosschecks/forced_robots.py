"""Random robots with one kind of force each, and what MuJoCo says about it.

A wrench stands in no file. MuJoCo's own is its `xfrc_applied`, a force and a torque in the world's
axes at a body's centre of mass, so that the judge has it from there and not from the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.description.robot import Fluid, Robot, moving_link_of
from softdyn.description.urdf import parse_text
from softdyn.dynamics import Wrench
from softdyn.dynamics.derivatives import acceleration_derivatives
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel
from softdyn.validation.crosschecks.crosscheck import (
    TOLERANCE,
    TOLERANCE_TRAJECTORY,
    crosscheck,
    random_state,
    relative_error,
)
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.crosschecks.result import Check
from softdyn.validation.crosschecks.trajectories import compare_trajectories, input_window
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin
from tests.support.random_robots import random_urdf

Amend = Callable[[Robot, np.random.Generator], Robot]
TOLERANCE_SLOPES = 1e-6
# MuJoCo takes a point mass in a fluid for a box of 1e-7 m, whose axes are rounding in both engines.
TOLERANCE_IN_FLUID = 1e-9
STEPS = (1e-4, 2e-4)  # of the differences; both together leave an error of the fourth order


def _in_fluid(robot: Robot, rng: np.random.Generator) -> Robot:
    density, viscosity = 10.0 ** rng.uniform((1, -3), (3.5, 0.5))
    return replace(robot, fluid=Fluid(float(density), float(viscosity)))


def _lifted(robot: Robot, rng: np.random.Generator) -> Robot:
    carrier = moving_link_of(robot)
    shares = {name: float(rng.uniform(0, 1.5)) for name in dict.fromkeys(carrier.values())}
    links = tuple(
        replace(one, gravcomp=shares[carrier[one.name]]) if one.mass else one for one in robot.links
    )
    return replace(robot, links=links)


def _bent(stiffness: float, damping: float, rng: np.random.Generator) -> dict[str, Any]:
    """Coefficients of higher powers, beside linear ones of these sizes."""
    spring = stiffness * rng.uniform(-0.5, 0.5), stiffness * rng.uniform(0.1, 1.0)
    damper = damping * rng.uniform(0.0, 1.0), damping * rng.uniform(0.0, 1.0)
    return {"stiffness_poly": spring, "damping_poly": damper}


def _bent_joints(robot: Robot, rng: np.random.Generator) -> Robot:
    joints = tuple(
        replace(one, **_bent(one.stiffness or 0.3, one.damping or 0.01, rng))
        if one.moves and one.kind != "continuous" else one
        for one in robot.joints
    )  # fmt: skip
    return replace(robot, joints=joints)


def _bent_tendons(robot: Robot, rng: np.random.Generator) -> Robot:
    turning = {joint.name for joint in robot.joints if joint.kind == "continuous"}
    tendons = tuple(
        one if turning & {term.joint for term in one.terms}
        else replace(one, stiffness=(k := one.stiffness or 1.0), damping=(d := one.damping or 0.03),
                     **_bent(k, d, rng))
        for one in robot.tendons
    )  # fmt: skip
    return replace(robot, tendons=tendons)


def _pushed(robot: Robot, rng: np.random.Generator) -> Robot:
    twin = Twin(build(robot))
    body = int(rng.integers(1, twin.model.nbody))
    link = next(one.name for one in robot.links if twin.model.body(body).name == one.name)
    force, torque = rng.normal(scale=((0.3,), (0.02,)), size=(2, 3))
    point = tuple(twin.model.body_ipos[body].tolist())
    return replace(robot, forces=(Wrench(link, force, torque, point),))


KINDS: dict[str, Amend] = {
    "fluid": _in_fluid,
    "buoyancy": _lifted,
    "joints": _bent_joints,
    "tendons": _bent_tendons,
    "wrench": _pushed,
}
"""Kind → a robot with forces of that kind: fluid, buoyancy, springs and dampers of higher powers in
joints and in tendons, a wrench."""


class PushedTerms(MujocoTerms):
    """The judge of a robot with a `Wrench` in the world's axes at a centre of mass."""

    def __init__(self, model: SoftModel) -> None:
        bare = build(replace(model.robot, forces=()))
        twin = Twin(bare, limits=False)
        super().__init__(twin, StateMap(bare, twin))
        (wrench,) = model.robot.forces
        self._at = self._model.body(wrench.link).id
        self._wrench = np.array([*wrench.force, *wrench.torque])

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Go to the model's state, where the wrench acts."""
        super().set_state(q, v)
        self._data.xfrc_applied[self._at] = self._wrench


def forced_robot(kind: str, seed: int) -> SoftModel | None:
    """A random robot with a kind of force; None if its kind adds nothing to it."""
    robot = parse_text(random_urdf(seed), path=Path(f"random_{seed}.urdf"))
    forced = KINDS[kind](robot, np.random.default_rng((seed, len(kind))))
    return None if forced.digest == robot.digest else build(forced)


def forced_seeds(kind: str, count: int, seed: int) -> list[int]:
    """The first seeds, from `seed` on, of robots to which the kind of force adds something."""
    found: list[int] = []
    while len(found) < count:
        if forced_robot(kind, seed) is not None:
            found.append(seed)
        seed += 1
    return found


def forced_checks(
    model: SoftModel, samples: int, seed: int, *, trajectories: bool
) -> tuple[list[Check], float]:
    """The checks of a robot with one kind of force, and the condition number of M.

    They are those of the cross-check, and the derivatives of q̈ against differences of MuJoCo's.
    """
    rng = np.random.default_rng((seed, 3))
    if model.forces:
        judge: MujocoTerms = PushedTerms(model)
        result = crosscheck(build(replace(model.robot, forces=())), samples=samples, seed=seed,
                            trajectories=False)  # fmt: skip
        tally = {"F": 0.0, "qdd": 0.0}
        for _ in range(samples):
            for name, error in _wrench_errors(model, judge, *_sample(model, rng)).items():
                tally[name] = max(tally[name], error)
        known = {check.quantity: check for check in result.checks}
        floor = known["qdd"].tolerance
        checks = [check for check in result.checks if check.quantity != "qdd"]
        checks += [Check("F", tally["F"], TOLERANCE, ""), Check("qdd", tally["qdd"], floor, "")]
        if trajectories:
            runs, ladders = compare_trajectories(model, judge, rng, lambda _: None)
            errors = [run.max_error for run in runs if run.duration]
            errors += [rung.engine_error for ladder in ladders for rung in ladder.rungs]
            reached = max(TOLERANCE_TRAJECTORY, 2.0**-52 * result.condition)
            checks.append(Check("trajectory", max(errors), reached, ""))
    else:
        twin = Twin(model, limits=False)
        judge = MujocoTerms(twin, StateMap(model, twin))
        result = crosscheck(model, samples=samples, seed=seed, trajectories=trajectories)
        checks = list(result.checks)
        if model.robot.fluid:
            checks = [replace(one, tolerance=TOLERANCE_IN_FLUID) if one.quantity == "trajectory"
                      else one for one in checks]  # fmt: skip
    slopes = [_slope_errors(model, judge, *_sample(model, rng)) for _ in range(samples)]
    worst = np.max(slopes, axis=0).tolist()
    checks += [Check(f"dqdd/d{name}", error, TOLERANCE_SLOPES, "")
               for name, error in zip("qv", worst, strict=True)]  # fmt: skip
    return checks, result.condition


def _sample(
    model: SoftModel, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A random state and input."""
    return *random_state(model, rng), rng.uniform(*input_window(model))


def _slope_errors(
    model: SoftModel, judge: MujocoTerms, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> tuple[float, float]:
    """Errors of ∂q̈/∂q and ∂q̈/∂q̇ against differences of MuJoCo's accelerations.

    Relative to the larger of the matrix's largest entry and q̈'s own size.
    """

    def acceleration(at: np.ndarray, rate: np.ndarray) -> np.ndarray:
        judge.set_state(at, rate)
        return judge.qdd(u).copy()

    def slopes(at: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        near, far = (
            np.array([(at(h * one) - at(-h * one)) / (2 * h) for one in np.eye(model.nv)]).T
            for h in STEPS
        )
        found: np.ndarray = (4 * near - far) / 3
        return found

    found = acceleration_derivatives(model, q, v, u)
    size = float(np.abs(found.value).max(initial=0.0))
    by_q = slopes(lambda dq: acceleration(model.integrate(q, dq), v))
    by_v = slopes(lambda dv: acceleration(q, v + dv))
    return relative_error(found.q, by_q, size), relative_error(found.v, by_v, size)


def _wrench_errors(
    model: SoftModel, judge: MujocoTerms, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> dict[str, float]:
    """Errors of F and q̈ of a robot with a wrench, which `crosscheck` takes as given."""
    judge.set_state(q, v)
    qdd, data = judge.qdd(u).copy(), judge._data
    known = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
    inertia = float(np.abs(judge.M()).max())
    return {
        "F": relative_error(
            model.state(q, v).F, judge._map.T @ (data.qfrc_smooth - known), inertia
        ),
        "qdd": relative_error(model.forward_dynamics(q, v, u), qdd, 1.0),
    }
