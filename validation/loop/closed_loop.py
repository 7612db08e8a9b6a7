"""One closed loop: a controller on the analytic model drives the MuJoCo twin."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from time import perf_counter_ns
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

import softdyn
from softdyn import InputError, Reference, SoftModel, State
from softdyn.checks import array, number
from softdyn.validation.loop.experiment import DEFAULT_PERIOD, SET_POINT_DURATION, Experiment
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.units import input_unit
from softdyn.validation.plain import plain
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import SimulationError, Twin

MAX_TIMESTEP = 5e-4  # s; coarser steps add numerical damping that flatters every controller
MAX_STEPS = 2_000_000
DIVERGED = 2.0  # ‖e‖ in robot lengths
RESOLUTION = 1e-6  # m; a final error below it is zero, whatever the initial one was


class Answer(Protocol):
    """What `simulate` needs of a controller's answer; V, delta and status are optional."""

    @property
    def u(self) -> Any:
        """(nu,) the input."""
        ...


Controller = Callable[[State, Any], Answer]
ReferenceLike = Experiment | Callable[[float], Reference]


def simulate(
    model: SoftModel,
    controller: Controller,
    reference: ReferenceLike,
    *,
    duration: float | None = None,
    period: float | None = None,
    timestep: float | None = None,
    q0: np.ndarray | None = None,
    v0: np.ndarray | None = None,
    contacts: bool = False,
    friction: bool = False,
    twin: Callable[..., Twin] = Twin,
    name: str | None = None,
    progress: bool = False,
    on_step: Callable[[float, State, Answer], None] | None = None,
) -> Log:
    """Run a controller against the twin and record what happens.

    Every control period the twin's state goes through `model.state` and the controller; the
    answer is clipped to the robot's bounds and held while MuJoCo integrates with
    ``implicitfast``, joint limits on. The run covers `duration` to the nearest plant step: where
    the period does not divide it, the last hold is shorter.

    A run is *failed* when

    - an answer is not a finite (nu,) array,
    - the plant diverges: a state that is not finite, a MuJoCo warning, or a tip farther from its
      reference than twice the robot's length (each of these ends the run and is in the log), or
    - the final ‖e‖ is not below the initial one (and not below a micrometre either).

    Parameters
    ----------
    model : the robot; the twin is built from its file, by its own path.
    controller : (State, Reference) → an object with `u` (nu,) and optionally V, delta, status.
        Integer attributes `not_solved` and `fallbacks`, a float `max_bound_violation` (on it or on
        its `guard`) and `gains` (or `parameters`) are recorded where they exist. Where it has a
        method `reset`, that is called once before the run with the control period (s). Its
        exceptions pass through.
    reference : an `Experiment`, or t (s) → `Reference`, e.g. a `SetPoint`.
    duration, period : length of the run and control period (s); the experiment's by default,
        10 s and 2 ms without one.
    timestep : plant step (s), an integer part of the period; by default the largest ≤ 0.5 ms.
    q0, v0 : (nq,), (nv,) initial state; rest by default.
    contacts : whether the plant's links can touch.
    friction : whether the plant has the file's dry friction.
    twin : makes the plant, called as `Twin` with the robot, timestep, contacts and friction.
    name : what the log calls the controller; its `name` or its class by default.
    progress : show a bar on stderr if that is a terminal.
    on_step : called with t (s), the State and the answer at every control step.

    Raises
    ------
    InputError
        For arguments that cannot be run, and for a reference that is not finite.
    """
    experiment = reference if isinstance(reference, Experiment) else None
    if experiment is not None:
        _check_robot(model, experiment)
    desired = _checked(experiment.reference if experiment else reference)
    schedule = Schedule.plan(
        _first(duration, experiment and experiment.duration, SET_POINT_DURATION),
        _first(period, experiment and experiment.period, DEFAULT_PERIOD),
        timestep,
    )
    if not callable(controller):
        raise InputError("controller", "a callable (state, reference) -> command", repr(controller))
    q = model.q0 if q0 is None else array("q0", q0, (model.nq,))
    v = np.zeros(model.nv) if v0 is None else array("v0", v0, (model.nv,))
    length = experiment.length if experiment else model.robot.length
    limit = DIVERGED * length if length > 0 else math.inf

    plant = twin(model.robot, timestep=schedule.timestep, contacts=contacts, friction=friction)
    states = StateMap(model, plant)
    try:
        plant.set_state(*states.to_twin(q, v))
    except SimulationError as error:
        raise InputError("q0, v0", "a state that MuJoCo can start from", error.reason) from None
    qpos, qvel = plant.data.qpos, plant.data.qvel  # views
    steps, t = schedule.steps, schedule.times()
    record = _Record(model, t)
    if hasattr(controller, "reset"):
        controller.reset(schedule.period)
    counters = _Counters(controller)
    reason = None

    bar = tqdm(total=steps, disable=None if progress else True, leave=False, unit="step")
    with bar:
        for k in range(steps + 1):
            q, v = states.from_twin(qpos, qvel)
            record.q[k], record.v[k] = q, v
            if not math.isfinite(q @ q + v @ v):
                reason = f"the plant diverged at t = {t[k]:.4g} s: a state that is not finite"
                break
            began = perf_counter_ns()
            state = model.state(q, v)
            spent = perf_counter_ns() - began
            target = desired(float(t[k]))
            distance = record.sample(k, state.y, target.y)
            if not distance <= limit:
                reason = (
                    f"the tip diverged at t = {t[k]:.4g} s: {distance:.3g} m from its reference, "
                    f"more than twice the length of {length:.3g} m"
                )
                break
            if k == steps:
                break
            began = perf_counter_ns()
            command = controller(state, target)
            spent += perf_counter_ns() - began
            reason = record.command(k, command, spent)
            if reason is not None:
                break
            if on_step is not None:
                on_step(float(t[k]), state, command)
            try:
                plant.advance(record.u[k], schedule.substeps if k < steps - 1 else schedule.last)
            except SimulationError as error:
                reason = f"the plant diverged at t = {error.time:.4g} s: {error.reason}"
                k += 1
                with np.errstate(invalid="ignore"):  # the cosine of an infinite angle
                    record.q[k], record.v[k] = states.from_twin(qpos, qvel)
                break
            bar.update()

    complete = reason is None
    if complete:
        initial, final = (float(np.linalg.norm(record.error[i])) for i in (0, steps))
        if final >= initial and final > RESOLUTION:
            reason = (
                f"no convergence: the final error of {100 * final:.3g} cm is not below "
                f"the initial {100 * initial:.3g} cm"
            )
    return Log(
        **record.arrays(k),
        u_unit=input_unit(model.robot),
        robot=model.bundled or model.name,
        controller=name or _name(controller),
        kind=experiment.kind if experiment else None,
        theta=experiment.theta if experiment else None,
        omega=experiment.omega if experiment else None,
        duration=schedule.duration,
        period=schedule.period,
        timestep=schedule.timestep,
        length=length if length > 0 else None,
        joint_names=model.joint_names,
        contacts=contacts,
        complete=complete,
        failed=reason is not None,
        reason=reason,
        not_solved=counters.since("not_solved"),
        fallbacks=counters.since("fallbacks"),
        max_bound_violation=max(record.violation(k), counters.violation()),
        gains=plain(getattr(controller, "gains", getattr(controller, "parameters", None))),
        versions=dict(_versions()),
    )


@dataclass(frozen=True)
class Schedule:
    """A run in whole plant steps: `steps` holds of `substeps` each, the last of `last`."""

    duration: float
    period: float
    timestep: float
    steps: int
    substeps: int
    last: int

    @classmethod
    def plan(cls, duration: float, period: float, timestep: float | None = None) -> Schedule:
        """Divide a run (s) into control periods (s) and those into plant steps (s)."""
        duration = number("duration", duration, above=0.0)
        period = number("period", period, above=0.0)
        if timestep is None:
            parts = period / MAX_TIMESTEP
            substeps = max(1, math.ceil(parts - 1e-9)) if parts <= MAX_STEPS else 0
        else:
            timestep = number("timestep", timestep, above=0.0)
            parts = period / timestep
            substeps = round(parts) if parts <= MAX_STEPS else 0
            if not math.isclose(parts, substeps, rel_tol=1e-9):
                raise InputError(
                    "timestep", f"an integer part of the period {period:g} s", timestep
                )
        if substeps == 0:
            raise InputError("period", f"at most {MAX_STEPS} plant steps", f"{period:g} s")
        timestep = period / substeps
        if not duration / period <= MAX_STEPS or not duration / timestep < 1e15:
            raise InputError("duration", f"at most {MAX_STEPS} control periods", f"{duration:g} s")
        total = round(duration / timestep)
        if total == 0:
            raise InputError(
                "duration", f"at least a plant step of {timestep:g} s", f"{duration:g} s"
            )
        steps = -(-total // substeps)
        return cls(duration, period, timestep, steps, substeps, total - (steps - 1) * substeps)

    def times(self) -> np.ndarray:
        """Sampling times (steps + 1,) (s): the start of every hold, then the end of the run."""
        t = np.arange(self.steps + 1) * self.period
        if self.last < self.substeps:
            t[-1] = t[-2] + self.last * self.timestep
        return t


class _Record:
    """The log's arrays, allocated once for the planned run."""

    def __init__(self, model: SoftModel, t: np.ndarray) -> None:
        samples, steps = len(t), len(t) - 1
        self.t = t
        self.q = np.empty((samples, model.nq))
        self.v = np.empty((samples, model.nv))
        self.y, self.y_ref, self.error = (np.full((samples, 3), np.nan) for _ in range(3))
        self.u = np.empty((steps, model.nu))
        self._answers = np.empty((steps, model.nu))  # u before it is clipped
        self.V, self.delta, self.step_us = (np.full(steps, np.nan) for _ in range(3))
        self.u_min, self.u_max = model.u_min, model.u_max
        self._codes = np.zeros(steps, np.int32)
        self._statuses: dict[Any, int] = {}

    def sample(self, k: int, y: np.ndarray, y_ref: np.ndarray) -> float:
        """Record the tip at sample `k`; returns ‖e‖ (m)."""
        error = np.subtract(y, y_ref, out=self.error[k])
        self.y[k], self.y_ref[k] = y, y_ref
        return math.sqrt(error @ error)

    def command(self, k: int, command: Answer, nanoseconds: int) -> str | None:
        """Record an answer, its input clipped to the bounds; returns why it cannot be used."""
        try:
            u = array("u", command.u, self.u_min.shape)
        except AttributeError:
            return f"the controller failed at t = {self.t[k]:.4g} s: its answer has no u"
        except InputError as error:
            return f"the controller failed at t = {self.t[k]:.4g} s: {error}"
        self._answers[k] = u
        np.minimum(np.maximum(u, self.u_min), self.u_max, out=self.u[k])
        self.V[k] = _scalar(getattr(command, "V", None))
        self.delta[k] = _scalar(getattr(command, "delta", None))
        status = getattr(command, "status", "")
        self._codes[k] = self._statuses.setdefault(_text(status), len(self._statuses))
        self.step_us[k] = nanoseconds / 1e3
        return None

    def violation(self, steps: int) -> float:
        """Largest violation of the bounds by an answer of the first `steps`, before clipping."""
        return float(np.abs(self._answers[:steps] - self.u[:steps]).max(initial=0.0))

    def arrays(self, steps: int) -> dict[str, np.ndarray]:
        """The arrays of a run that did `steps` control steps."""
        samples = ("t", "q", "v", "y", "y_ref", "error")
        found = {name: getattr(self, name)[: steps + 1].copy() for name in samples}
        found |= {name: getattr(self, name)[:steps].copy() for name in ("u", "V", "delta")}
        names = np.array(list(self._statuses) or [""])
        return found | {
            "step_us": self.step_us[:steps].copy(),
            "u_min": self.u_min.copy(),
            "u_max": self.u_max.copy(),
            "status": names[self._codes[:steps]],
        }


class _Counters:
    """What a controller counts itself, since the start of the run."""

    def __init__(self, controller: object) -> None:
        has_own = hasattr(controller, "not_solved") or hasattr(controller, "fallbacks")
        self._source = controller if has_own else getattr(controller, "guard", controller)
        self._before = {name: self._count(name) for name in ("not_solved", "fallbacks")}

    def _count(self, name: str) -> int:
        return int(getattr(self._source, name, 0))

    def since(self, name: str) -> int:
        """Increase of a counter."""
        return self._count(name) - self._before[name]

    def violation(self) -> float:
        """Largest violation of the bounds that the controller itself clipped."""
        return float(getattr(self._source, "max_bound_violation", 0.0))


def _check_robot(model: SoftModel, experiment: Experiment) -> None:
    """An experiment is scaled to one robot; refuse to run it on another bundled one."""
    if model.bundled is not None and model.bundled != experiment.robot:
        raise InputError(
            "experiment", f"one for {model.bundled!r}", f"one for {experiment.robot!r}"
        )


def _checked(reference: Any) -> Callable[[float], Reference]:
    """`reference` as a function that surely returns a `Reference`; tried at t = 0."""
    if not callable(reference):
        expected = "an Experiment, or a callable t -> Reference such as SetPoint(y)"
        raise InputError("reference", expected, repr(reference))

    def checked(t: float) -> Reference:
        value = reference(t)
        if isinstance(value, Reference):
            return value
        try:
            return Reference(value.y, value.ydot, value.yddot)
        except AttributeError:
            raise InputError("reference", "a Reference(y, ydot, yddot)", repr(value)) from None

    checked(0.0)
    return checked


def _first(*values: Any) -> Any:
    return next(value for value in values if value is not None)


def _scalar(value: Any) -> float:
    """A diagnostic as a float; NaN when there is none or it is not a number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def _text(status: Any) -> str:
    return str(status.value if isinstance(status, Enum) else status)


def _name(controller: Any) -> str:
    named = getattr(controller, "name", None) or getattr(controller, "__name__", None)
    return named if isinstance(named, str) else type(controller).__name__


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    """Versions of what decides a run's numbers."""
    found = [("softdyn", softdyn.__version__)]
    for package in ("pin", "mujoco", "proxsuite", "numpy"):
        try:
            found.append((package, version(package)))
        except PackageNotFoundError:
            continue
    return tuple(found)
