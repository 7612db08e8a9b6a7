"""The cross-check: Pinocchio against MuJoCo, quantity by quantity and along trajectories.

Both engines read the same file by different parsers. At random states every term of the dynamics is
computed by each, and

    error = max|a - b| / max(|a|, |b|, scale),

where the norms are largest absolute values. The scale keeps the error small where both values are
almost zero. Limits, contacts and dry friction are off, because only the plant has them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from softdyn.description.robot import NO_FLUID
from softdyn.dynamics.forces import differences, energy_of
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.projection import underlying_tree
from softdyn.dynamics.reduced import rebuild
from softdyn.exceptions import InputError, SoftdynError
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.crosschecks.result import Check, CrossCheck, StepLadder, TrajectoryRun
from softdyn.validation.crosschecks.rigged import (
    RIG_SCALES,
    RIG_TOLERANCES,
    RigStates,
    compare_motion,
    quantities_of,
)
from softdyn.validation.crosschecks.trajectories import compare_trajectories, input_window
from softdyn.validation.mjcf.scene import Scene
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import SimulationError, Twin

SPEED = 1.0  # rad/s, or m/s of a prismatic joint, at most
TOLERANCE = 1e-10
TOLERANCE_SPATIAL = 1e-9  # wider, because moment arms come from directions between sites
TOLERANCE_TRAJECTORY = 1e-11
# Where a cable bends inside a body, MuJoCo finds the angle of the bend to 1e-6 rad only. Forces
# depend on it; accelerations and motions gather its effect.
TOLERANCE_INSIDE = {"B": 1e-6, "K": 1e-6, "D": 1e-6, "qdd": 1e-5, "trajectory": 1e-5} | (
    dict.fromkeys(RIG_SCALES, 1e-5)
)
SCALES = {
    "tip": "length of the robot",
    "J": "length of the robot per rad",
    "Jdot": "length of the robot per rad times the largest speed",
    "M": "largest entry of M",
    "bias": "largest entry of M times 1 rad/s²",
    "g": "largest entry of M times 1 rad/s²",
    "K": "largest entry of M times 1 rad/s²",
    "D": "largest entry of M times 1/s",
    "B": "largest gear times the length of the robot per rad",
    "length": "length of the robot",
    "qdd": "1 rad/s²",
    "energy": "total mass times 9.81 m/s² times the length of the robot",
    "trajectory": "1 rad and 1 rad/s",
}
QUANTITIES = tuple(SCALES)
FORCE = "F"  # forces of one's own, or a fluid's, in robots that have some
GIVEN = "given, not checked; its derivatives and energy against finite differences"
TOLERANCE_FORCE = 1e-4
DIFFERENCE = 1e-5  # rad, m; of an energy
SOLVED = {"qdd", "rigged qdd"}  # by M
INTEGRATED = {"trajectory", "rigged"}
ROUNDING = 2.0**-52
WORST = 1e-6  # a larger difference is none of rounding, whatever the condition number


@dataclass
class Tally:
    """The largest error of each quantity so far, and the first failure of each.

    `unable` are the quantities that MuJoCo could not compute, because it refused the state.
    """

    errors: dict[str, float] = field(default_factory=lambda: dict.fromkeys(QUANTITIES, 0.0))
    reasons: dict[str, str] = field(default_factory=dict)
    unable: set[str] = field(default_factory=set)
    condition: float = 1.0

    def fail(self, reason: str, *quantities: str) -> None:
        """Mark quantities as failed, with the reason."""
        for quantity in quantities or QUANTITIES:
            self.errors[quantity] = math.nan
            self.reasons.setdefault(quantity, reason)

    def compare(self, quantity: str, a: np.ndarray, b: np.ndarray, scale: float) -> None:
        """Record one comparison of the model's `a` with the twin's `b`."""
        a, b = np.asarray(a, float), np.asarray(b, float)
        if a.shape != b.shape:
            self.fail(f"shape {a.shape} of the model, {b.shape} of the twin", quantity)
        elif not (np.isfinite(a).all() and np.isfinite(b).all()):
            whose = "twin" if np.isfinite(a).all() else "model"
            self.fail(f"a number of the {whose} is not finite", quantity)
        elif quantity not in self.reasons:
            before = self.errors.get(quantity, 0.0)
            self.errors[quantity] = max(before, relative_error(a, b, scale))

    @contextmanager
    def guard(self, *quantities: str) -> Iterator[None]:
        """Turn an exception of an engine into a failure of `quantities`."""
        try:
            with np.errstate(all="ignore"):
                yield
        except SimulationError as error:
            self.unable |= set(quantities) - self.reasons.keys()
            self.fail(f"MuJoCo stops at {error.reason}", *quantities)
        except (SoftdynError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            self.fail(str(error), *quantities)


def relative_error(a: np.ndarray, b: np.ndarray, scale: float) -> float:
    """max|a - b| / max(|a|, |b|, scale); zero where both are zero or empty."""
    difference = float(np.abs(a - b).max(initial=0.0))
    size = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0), scale)
    return difference / float(size) if difference else 0.0


def crosscheck(
    model: SoftModel,
    twin: Twin | Scene | None = None,
    *,
    samples: int = 20,
    seed: int = 0,
    trajectories: bool = True,
    progress: Callable[[str], None] | None = None,
) -> CrossCheck:
    """Compare a model with its twin, or with the twin of another file.

    Parameters
    ----------
    model : SoftModel
        The analytic model.
    twin : Twin or Scene, optional
        By default it is built from the model's own file. A copy of its MuJoCo model is used, so
        that the twin's state does not change.
    samples : int
        Number of random states.
    seed : int
        Seed of the random states and inputs.
    trajectories : bool
        Whether to compare trajectories too, which takes most of the time.
    progress : callable, optional
        Called with a short text about the current step.

    Returns
    -------
    CrossCheck
        Differences, crashes and a twin that does not fit are failed checks, not exceptions.

    Raises
    ------
    InputError
        For fewer than one sample.
    UrdfError
        When the twin of the model's own file cannot be built.
    """
    if not isinstance(samples, int) or samples < 1:
        raise InputError("samples", "an integer >= 1", samples)
    twin = Twin(check_model(model), limits=False) if twin is None else twin
    report = progress or (lambda _text: None)
    tally = Tally()
    runs: tuple[TrajectoryRun, ...] = ()
    ladders: tuple[StepLadder, ...] = ()
    try:
        states = twin.states if isinstance(twin, Scene) else StateMap(model, twin)
        judge = MujocoTerms(twin, states)
    except InputError as error:
        tally.fail(str(error))
    else:
        if judge.nu != model.nu:
            reason = f"{model.nu} actuators of the model, {judge.nu} of the twin"
            tally.fail(reason, "B", "qdd", "trajectory")
        rng = np.random.default_rng(seed)
        for k in range(samples):
            report(f"state {k + 1} of {samples}")
            q, v = random_state(model, rng)
            _compare_at(tally, model, judge, q, v, rng.uniform(*input_window(model)))
        if trajectories and "trajectory" not in tally.reasons:
            with tally.guard("trajectory"):
                runs, ladders = compare_trajectories(model, judge, rng, report)
                errors = [run.max_error for run in runs if run.duration]
                errors += [rung.engine_error for ladder in ladders for rung in ladder.rungs]
                tally.errors["trajectory"] = float(np.max(errors))
    tolerances = RIG_TOLERANCES | _tolerances(model)
    if model.forces:
        tolerances[FORCE] = TOLERANCE_FORCE
    names = QUANTITIES if trajectories else QUANTITIES[:-1]
    if model.forced:
        names = (*names[:-1], FORCE, names[-1])
    if model.forces:
        rng = np.random.default_rng((seed, 2))
        with tally.guard(FORCE):
            errors = [given_error(model, *random_state(model, rng)) for _ in range(samples)]
            tally.errors[FORCE] = float(np.max(errors))
    if isinstance(twin, Twin):
        rig = [name for name in quantities_of(model) if trajectories or name != "rigged"]
        runs += _compare_rigs(tally, model, twin, rig, samples, seed, report)
        names += tuple(rig)
    return CrossCheck(
        model.name, model.nv, model.nu, samples, seed,
        _verdicts(tally, tolerances, names, model), tally.condition, runs, ladders,
    )  # fmt: skip


def _verdicts(
    tally: Tally, tolerances: dict[str, float], names: Iterable[str], model: SoftModel
) -> tuple[Check, ...]:
    """One check per quantity of a robot.

    A solve by M of n rows errs by up to about n ε cond(M), relative to q̈ (Higham, Accuracy and
    Stability of Numerical Algorithms, section 10.1), and what is integrated by about ε cond(M). No
    tolerance is below that.

    A quantity that MuJoCo could not compute is no failure if all others agree: the motion follows
    from the terms. Else the terms that differ may be why it could not.
    """
    rounding = ROUNDING * tally.condition
    floors = dict.fromkeys(SOLVED, model.nv * rounding) | dict.fromkeys(INTEGRATED, rounding)
    scales = SCALES | RIG_SCALES | {FORCE: GIVEN if model.forces else SCALES["bias"]}
    checks = [
        Check(
            name, tally.errors[name],
            max(tolerances[name], min(floors.get(name, 0.0), WORST)), scales[name],
            tally.reasons.get(name, ""),
        )
        for name in names
    ]  # fmt: skip
    if all(check.passed for check in checks if check.quantity not in tally.unable):
        checks = [replace(c, compared=c.quantity not in tally.unable) for c in checks]
    return tuple(checks)


def _compare_rigs(
    tally: Tally,
    model: SoftModel,
    twin: Twin,
    rig: list[str],
    samples: int,
    seed: int,
    report: Callable[[str], None],
) -> tuple[TrajectoryRun, ...]:
    """Compare the quantities of the rig, at random states and along a trajectory."""
    robot = twin.robot
    if robot.forces:  # on which no rig depends
        model = rebuild(model, replace(model.robot, forces=()))
        robot = replace(robot, forces=())
    rng = np.random.default_rng((seed, 1))
    states = [name for name in rig if name != "rigged"]
    with tally.guard(*states):
        judges = [RigStates(model, robot)] if states else []
        for judge, k in product(judges, range(samples)):
            report(f"state {k + 1} of {samples} with the rig")
            for comparison in judge.compare(*random_state(model, rng), rng):
                tally.compare(*comparison)
    if "rigged" not in rig:
        return ()
    with tally.guard("rigged"):
        run = compare_motion(model, robot, rng, report)
        tally.errors["rigged"] = run.max_error
        return (run,)
    return ()


def _tolerances(model: SoftModel) -> dict[str, float]:
    """Tolerance of each quantity; a quantity that depends on spatial tendons gets the wider one."""
    found = dict.fromkeys((*QUANTITIES, FORCE), TOLERANCE) | {"trajectory": TOLERANCE_TRAJECTORY}
    spatial = [tendon for tendon in model.robot.tendons if tendon.sites]
    driven = {actuator.tendon for actuator in model.robot.actuators}
    for quantity, enters in (
        ("B", any(tendon.name in driven for tendon in spatial)),
        ("K", any(tendon.stiffness for tendon in spatial)),
        ("D", any(tendon.damping for tendon in spatial)),
    ):
        if enters:
            found[quantity] = TOLERANCE_SPATIAL
    if any(wrap.inside for tendon in spatial for wrap in tendon.wraps):
        found |= TOLERANCE_INSIDE
    return found


def given_error(model: SoftModel, q: np.ndarray, v: np.ndarray) -> float:
    """The largest relative error of the derivatives and energies that forces of one's own state.

    The derivatives stand against central differences of the force, and F at rest against minus the
    gradient of the energy. The force itself is given: the twin calls the same object.
    """
    tree, S = underlying_tree(model)
    free = rebuild(tree, replace(tree.robot, forces=(), fluid=NO_FLUID, balls=()))
    q, v = (q, v) if S is None else (model.expand(q), S @ v)  # type: ignore[attr-defined]
    found = 0.0
    for force in model.forces:
        alone = free.with_forces(force)
        pairs = list(
            zip(alone.force_derivatives(q, v), differences(force, free, q, v), strict=True)
        )
        if energy_of(force, free, q) is not None:
            gradient = np.empty(free.nv)
            for k in range(free.nv):
                move = np.zeros(free.nv)
                move[k] = DIFFERENCE
                ahead, behind = (
                    energy_of(force, free, free.integrate(q, sign * move)) for sign in (1, -1)
                )
                gradient[k] = (ahead - behind) / (2 * DIFFERENCE)  # type: ignore[operator]
            pairs.append((alone.forces_at(q, np.zeros(free.nv)), -gradient))
        size = max(1.0, *(float(np.abs(b).max(initial=0.0)) for _, b in pairs))
        found = max(found, *(relative_error(a, b, size) for a, b in pairs))
    return found


def random_state(model: SoftModel, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A random configuration q (nq,) inside the limits and velocity v (nv,).

    Coordinates are drawn within ±π (rad or m) where a joint has no limits or wider ones.
    """
    lower, upper = window(model)
    q = model.configuration(rng.uniform(lower, upper))
    reach = SPEED * np.clip(upper - lower, 0.1, 1.0)
    return q, rng.uniform(-reach, reach)


def window(model: SoftModel) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds (nv,) of the random coordinates."""
    lower, upper = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    outside = lower > upper  # both limits lie beyond ±π
    return np.where(outside, model.lower, lower), np.where(outside, model.upper, upper)


def _compare_at(
    tally: Tally, model: SoftModel, judge: MujocoTerms, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> None:
    """Compare every pointwise quantity at one state."""
    with tally.guard(*QUANTITIES[:-1]):
        judge.set_state(q, v)
        length = model.robot.length or 1.0
        inertia = float(np.abs(judge.M()).max())
        gear = max((abs(a.gear) for a in model.robot.actuators), default=0.0)
        weight = 9.81 * judge.mass * length
        state = model.state(q, v)
        speed = float(np.abs(v).max())
        tally.condition = max(tally.condition, float(np.linalg.cond(state.M)))
        energy = model.kinetic_energy(q, v) + model.gravity_energy(q) + model.elastic_energy(q)
        lengths = state.lengths
        if len(judge.shared) == len(lengths):  # else their number is the error that is told
            lengths = lengths[judge.shared]
        pairs: dict[str, tuple[Any, Callable[[], Any], float]] = {
            "tip": (state.y, judge.tip, length),
            "J": (state.J, judge.J, length),
            "Jdot": (state.Jdot, judge.Jdot, length * speed),
            "M": (state.M, judge.M, inertia),
            "bias": (state.bias, judge.bias, inertia),
            "g": (state.g, judge.g, inertia),
            "K": (state.K, judge.K, inertia),
            "D": (state.D, judge.D, inertia),
            "length": (lengths, judge.lengths, length),
            "energy": (energy, judge.energy, weight),
        }
        if model.forced and not model.forces:
            pairs[FORCE] = (state.F, judge.F, inertia)
        if judge.nu == model.nu:
            pairs["B"] = (state.B, judge.B, gear * length)
            qdd = model.forward_dynamics(q, v, u)
            pairs["qdd"] = (qdd, lambda: judge.qdd(u), 1.0)
        for quantity, (ours, oracle, scale) in pairs.items():
            with tally.guard(quantity):
                tally.compare(quantity, ours, oracle(), scale)
