"""Compare two files of one robot: causes of differences, their effects, and the residual."""

from __future__ import annotations

import math
import time
from itertools import groupby
from pathlib import Path

import numpy as np

from softdyn.checks import number
from softdyn.exceptions import InputError, UrdfError
from softdyn.validation.mjcf.comparison.dynamics import (
    QUANTITIES,
    States,
    Terms,
    evaluate,
    misreading,
    random_states,
)
from softdyn.validation.mjcf.comparison.finding import KINDS, Finding, Turns
from softdyn.validation.mjcf.comparison.geometry import find_geometry
from softdyn.validation.mjcf.comparison.matching import Match, match, reduce, with_links_of
from softdyn.validation.mjcf.comparison.neutral import FREEDOMS, Neutral
from softdyn.validation.mjcf.comparison.parameters import find_order, find_parameters
from softdyn.validation.mjcf.comparison.resting import resting_points, tip_points
from softdyn.validation.mjcf.comparison.result import (
    ROUNDING,
    SHOWN,
    Cause,
    Comparison,
    RepairStep,
    Worst,
)
from softdyn.validation.mjcf.comparison.side import Side

# kinds that affect M, bias, g or a tip; others are measured only by their values
DYNAMIC = KINDS[: KINDS.index("gravity") + 1]
# kinds that may change the rest under weight and springs
RESTING = ("base", "pose", "zero", "axis", "mass", "centre", "gravity", "stiffness", "rest",
           "limit", "tendon")  # fmt: skip
LIGHTEST = 1e-6  # least inertia of a motion whose joints have inertia 1; smaller ones are rounding
LEAST = 1e-3  # least scale of forces and Jacobians, relative to what they could be
READ = 1e-12  # largest relative error of an MJCF's neutral form against MuJoCo's own model
NAMED = 1e-6  # smallest effect, or relative difference of a value, of a named cause


def compare(
    a: str | Path | Side,
    b: str | Path | Side,
    *,
    mapping: dict[str, str] | None = None,
    strict: bool = False,
    repair_inertia: bool = False,
    tolerance: float | None = None,
    samples: int = 8,
    seed: int = 0,
) -> Comparison:
    """Compare two files of one robot, each a URDF or an MJCF.

    Parameters
    ----------
    a, b : str, Path or Side
        Paths, or arguments of `softdyn.load`. A URDF gets a floating base if the other file's robot
        has one.
    mapping : dict[str, str] or None
        Joints of A → joints of B, for pairs that names and kinematics would match wrongly.
    strict : bool
        Whether properties that only one file states fail, too.
    repair_inertia : bool
        Whether a URDF's impossible inertias become the nearest possible ones, with a note each.
    tolerance : float, optional
        Values that differ by at most this count as equal. It is relative: lengths to the extent of
        their part, angles to 1 rad, other numbers to themselves. By default it is 0; but if one
        file prints at most six significant digits and no difference exceeds `ROUNDING`, all are
        rounding.
    samples, seed : int
        Number of random states at which effects are computed, and their seed.

    Returns
    -------
    Comparison
        ``assert compare(urdf, mjcf).passed`` is a test; printed, it is a report.

    Raises
    ------
    UrdfError
        A file cannot be used; the message names file, element, expected and got. softdyn misreads
        an MJCF, so that MuJoCo computes other dynamics from the neutral form than from the file.
    InputError
        A name is unknown, or the mapping is impossible.
    """
    begin = time.perf_counter()
    if not isinstance(samples, int) or samples < 1:
        raise InputError("samples", "an integer >= 1", samples)
    if tolerance is not None:
        number("tolerance", tolerance, lower=0.0)
    one, other = (Side.of(source, repair_inertia=repair_inertia) for source in (a, b))
    for side in (one, other):
        if side.is_mjcf:
            _check_reading(side, samples, seed)
    return compare_neutral(
        one.beside(other).neutral, other.beside(one).neutral, mapping=mapping, strict=strict,
        tolerance=tolerance, samples=samples, seed=seed, begin=begin,
    )  # fmt: skip


def _check_reading(side: Side, samples: int, seed: int) -> None:
    """Raise an error if an MJCF's neutral form has other dynamics than MuJoCo's compiled model."""
    robot = side.neutral
    errors = misreading(robot, side.compiled, random_states(robot, samples, seed))
    if wrong := {name: error for name, error in errors.items() if not error <= READ}:
        expected = f"that softdyn reads MuJoCo's own M, bias, g and J, to {READ:g}"
        got = ", ".join(f"{name} {error:.1e} apart" for name, error in wrong.items())
        raise UrdfError(side.path, "<mujoco>", expected, got)


def compare_neutral(
    one: Neutral,
    other: Neutral,
    *,
    mapping: dict[str, str] | None = None,
    strict: bool = False,
    tolerance: float | None = None,
    samples: int = 8,
    seed: int = 0,
    begin: float | None = None,
) -> Comparison:
    """Compare two robots in the neutral form; the other arguments as in `compare`."""
    begin = time.perf_counter() if begin is None else begin
    pairs = match(one, other, mapping)
    names, unmatched = _names(one, other, pairs)
    paths = str(one.path), str(other.path)
    notes = tuple(f"{side}: {note}" for side, r in (("A", one), ("B", other)) for note in r.notes)
    how = {one.parts[i].name: pairs.how[i] for i, _ in pairs.pairs}
    if not pairs.pairs:
        seconds = time.perf_counter() - begin
        return Comparison(*paths, names, how, unmatched, (), (), {}, strict, notes, seconds)
    left, right = (robot.without_idle_sites() for robot in reduce(one, other, pairs))
    right = with_links_of(right, left)
    left = with_links_of(left, right)
    states = random_states(left, samples, seed)
    reference = evaluate(left, states)
    measure = _Measure(left, reference, states)

    found, repaired = find_geometry(left, right)
    turns = _turns(found)
    found += find_parameters(left, repaired, turns, states)
    found += find_order(left, right)
    causes: list[Cause] = []
    steps = [RepairStep("as is", measure.errors(right))]
    robot = right
    any_armature = any(tendon.armature for tendon in (*left.cables, *right.cables))
    for _, stage in groupby(sorted(found, key=_stage), _stage):
        kinds: list[str] = []
        for finding in stage:
            before = robot
            robot = finding.repair(robot)
            # M contains a tendon's armature
            moves = finding.kind in DYNAMIC or (finding.kind == "tendon" and any_armature)
            effect = measure.effect(before, robot if moves else before) | {"value": finding.size}
            effect["forces"] = 0.0 if finding.force is None else measure.pushed(finding.force)
            effect["qdd"] = max(effect["qdd"], effect["forces"])
            if max(effect.values()) > NAMED:
                kinds.append(finding.kind)
                effect |= measure.further(finding.kind, before, robot)
                idle = not finding.acts and effect["qdd"] <= NAMED
                causes.append(
                    Cause(
                        finding.kind, finding.where, *finding.values, effect, finding.detail,
                        finding.alone and idle, _printed(finding), finding.alone,
                    )
                )  # fmt: skip
        if kinds:
            steps.append(RepairStep(", ".join(dict.fromkeys(kinds)), measure.errors(robot)))
    residual = measure.errors(robot)
    causes.sort(key=lambda cause: (cause.one_sided, -cause.largest, -cause.effect.get("value", 0)))
    if tolerance is None:
        tolerance = _rounding(causes) if one.rounded or other.rounded else 0.0
    counting = tuple(cause for cause in causes if cause.printed > tolerance)
    within = tuple(cause for cause in causes if cause.printed <= tolerance)
    return Comparison(
        *paths, names, how, unmatched, counting, tuple(steps), residual, strict, notes,
        time.perf_counter() - begin, turns, measure.worst(right), tolerance, within,
    )  # fmt: skip


def _printed(finding: Finding) -> float:
    """The relative difference of a finding's numbers; infinite if it has none."""
    return (finding.size or math.inf) if finding.printed is None else finding.printed


def _rounding(causes: list[Cause]) -> float:
    """`ROUNDING` if there are differences that both files state, and none exceeds it; else 0."""
    stated = [cause.printed for cause in causes if not cause.alone]
    return ROUNDING if stated and max(stated) <= ROUNDING else 0.0


def _stage(finding: Finding) -> int:
    """Sort key: geometry first, in the order found, because displaced parts carry others along."""
    return max(KINDS.index(finding.kind), KINDS.index("axis"))


def _turns(found: list[Finding]) -> Turns:
    """Sense and zero of the joints that differ in B."""
    turns: Turns = {}
    for finding in found:
        sense, zero = turns.get(finding.where, (1.0, 0.0))
        if finding.kind == "zero":
            turns[finding.where] = (sense, zero + finding.values[1])
        if finding.kind == "axis" and "reversed" in finding.detail:
            turns[finding.where] = (-sense, zero)
    return turns


def _names(
    one: Neutral, other: Neutral, pairs: Match
) -> tuple[dict[str, str], dict[str, list[str]]]:
    """Matched joints by name, and those without a partner."""
    matched = {one.parts[i].name: other.parts[j].name for i, j in pairs.pairs}
    unmatched = {
        "a": [part.name for part in one.parts if part.name not in matched],
        "b": [part.name for part in other.parts if part.name not in matched.values()],
    }
    return matched, unmatched


def _actuation(robot: Neutral, terms: Terms) -> np.ndarray:
    """B (samples, nv, inputs) of the actuators on joints with one freedom and on tendons."""
    B = np.zeros((*terms.bias.shape, len(robot.motors)))
    first = np.cumsum([0, *(FREEDOMS[part.kind] for part in robot.parts)])
    joints = {part.name: k for k, part in enumerate(robot.parts)}
    cables = {cable.name: k for k, cable in enumerate(robot.cables)}
    for k, motor in enumerate(robot.motors):
        kind, name = motor.end
        if kind == "tendon" and name in cables:
            B[:, :, k] = motor.gear * terms.arms[:, cables[name]]
        elif kind == "joint" and name in joints and not motor.axes:
            B[:, first[joints[name]], k] = motor.gear
    return B


class _Measure:
    """Relative differences from A's dynamics, with equal weight for every joint.

    Forces and inertias are divided by √M_ii of their joints, so that a fingertip counts as much as
    a trunk. Tips are divided by the extent of the robot.
    """

    def __init__(self, robot: Neutral, terms: Terms, states: States) -> None:
        self._terms, self._states, self._size = terms, states, robot.size
        diagonal = np.einsum("sii->si", terms.M).max(axis=0)
        self._weight = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        # forces that are zero but for rounding are measured by the inertia at 1 rad/s², 1 m/s²
        least = LEAST * (float(np.sqrt(diagonal.max(initial=0.0))) or 1.0)
        self._force = max(float(np.abs(terms.bias * self._weight).max(initial=0.0)), least)
        self._pull = max(
            float(np.abs(terms.g * self._weight).max(initial=0.0)), LEAST * self._force
        )
        self._arm = max(float(np.abs(terms.J).max(initial=0.0)), LEAST * self._size)
        moments, axes = np.linalg.eigh(terms.M * self._weight[:, None] * self._weight)
        self._whiten = axes / np.sqrt(np.maximum(moments, LIGHTEST))[:, None]
        self._fall = max(float(np.linalg.norm(self._forced(terms.bias), axis=1).max()), least)
        self._last = (robot, terms)
        self._points = tip_points(robot)
        self._rest: tuple[Neutral, np.ndarray | None] | None = None
        pulls = np.abs(_actuation(robot, terms) * self._weight[:, None])
        self._drive = float(pulls.max(initial=0.0)) or 1.0

    def _evaluate(self, robot: Neutral) -> Terms:
        """Terms of a robot; the last ones are cached, because repairs follow each other."""
        if self._last[0] is not robot:
            self._last = (robot, evaluate(robot, self._states))
        return self._last[1]

    def errors(self, robot: Neutral) -> dict[str, float]:
        """Relative errors of a robot's M, bias, g and J from A's."""
        found = self._gaps(self._terms, self._evaluate(robot))
        return {name: found[name] for name in QUANTITIES}

    def effect(self, before: Neutral, after: Neutral) -> dict[str, float]:
        """The changes by a repair in M, bias, g, the tips and, for any forces, in q̈."""
        if before is after:
            return dict.fromkeys((*SHOWN, "qdd"), 0.0)
        a, b = self._evaluate(before), self._evaluate(after)
        found = self._gaps(a, b) | {"qdd": self._acceleration(a, b)}
        return {name: found[name] for name in (*SHOWN, "qdd")}

    def further(self, kind: str, before: Neutral, after: Neutral) -> dict[str, float]:
        """The changes by a repair of this kind in B, and in the tips at rest.

        B maps the inputs to the joints' forces. Without a rest of both robots, it has no change.
        """
        found = {"B": 0.0, "rest": 0.0}
        if kind in ("tendon", "actuator"):
            a, b = (_actuation(robot, self._evaluate(robot)) for robot in (before, after))
            if a.shape == b.shape:
                gap = np.abs((a - b) * self._weight[:, None]).max(initial=0.0)
                found["B"] = float(gap) / self._drive
        if kind in RESTING:
            ends = [self._at_rest(robot) for robot in (before, after)]
            if ends[0] is not None and ends[1] is not None:
                moved = np.linalg.norm(ends[0] - ends[1], axis=1).max(initial=0.0)
                found["rest"] = float(moved) / self._size
        return {name: value if value > NAMED else 0.0 for name, value in found.items()}

    def _at_rest(self, robot: Neutral) -> np.ndarray | None:
        """The tips at rest; the last ones are cached."""
        if self._rest is None or self._rest[0] is not robot:
            self._rest = (robot, resting_points(robot, self._points))
        return self._rest[1]

    def pushed(self, force: np.ndarray) -> float:
        """The relative change of q̈ by a generalized force at the states (samples, nv)."""
        return float(np.linalg.norm(self._forced(force), axis=1).max(initial=0.0)) / self._fall

    def worst(self, robot: Neutral) -> tuple[Worst, ...]:
        """For each differing quantity, the state at which it differs most."""
        terms = self._evaluate(robot)
        found = []
        for name, gaps in self._scaled(self._terms, terms).items():
            errors = np.abs(gaps).reshape(len(gaps), -1).max(axis=1, initial=0.0)
            at = int(np.argmax(errors))
            if errors[at] > NAMED:
                q = {
                    part.name: value[at].tolist()
                    for part, value in zip(robot.parts, self._states.q, strict=True)
                }
                found.append(Worst(name, float(errors[at]), q))
        return tuple(sorted(found, key=lambda worst: -worst.error))

    def _gaps(self, a: Terms, b: Terms) -> dict[str, float]:
        scaled = self._scaled(a, b)
        return {name: float(np.abs(gap).max(initial=0.0)) for name, gap in scaled.items()}

    def _forced(self, forces: np.ndarray) -> np.ndarray:
        """Accelerations by forces (samples, nv), scaled to the norm √(2 · kinetic energy)."""
        return np.einsum("sji,sj->si", self._whiten, forces * self._weight)

    def _acceleration(self, a: Terms, b: Terms) -> float:
        """The largest relative change of q̈, in the norm of the kinetic energy.

        The change due to M holds for any force: it is the largest relative change of a kinetic
        energy.
        """
        inertia = np.swapaxes(self._whiten, 1, 2) @ self._scaled(a, b)["M"] @ self._whiten
        energy = float(np.abs(np.linalg.eigvalsh(inertia)).max(initial=0.0))
        fall = np.linalg.norm(self._forced(a.bias - b.bias), axis=1).max(initial=0.0)
        return max(energy, float(fall) / self._fall)

    def _scaled(self, a: Terms, b: Terms) -> dict[str, np.ndarray]:
        weight = self._weight
        return {
            "M": (a.M - b.M) * weight[:, None] * weight,
            "bias": (a.bias - b.bias) * weight / self._force,
            "g": (a.g - b.g) * weight / self._pull,
            "J": (a.J - b.J) / self._arm,
            "tip": (a.tips - b.tips) / self._size,
        }
