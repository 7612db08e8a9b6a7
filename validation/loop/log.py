"""The record of one closed loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.copies import freeze
from softdyn.description.task_mark import TaskMark
from softdyn.safety import Surroundings
from softdyn.validation.channels import LogChannel
from softdyn.validation.loop import log_files
from softdyn.validation.loop import verdict as judged
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.loop.metrics import CM, SIGMAS, mean_square
from softdyn.validation.loop.verdict import Verdict

STEP_TIMES = {"median": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}  # percentiles


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """The record of a closed loop: its samples, its settings and its robot.

    With N control steps done there are N + 1 samples of the plant: one at the start of every
    hold, ``t[k] = k · period``, and one at the end of the last, which is the run's final state.
    ``u[k]`` was held from ``t[k]`` to ``t[k + 1]``. Arrays are read-only.

    Attributes
    ----------
    channels : dict of str to LogChannel
        All quantities along the run by name, with the names and units of their columns. The values
        of each are an attribute of this name, too. Every log has those from `t` to `step_us` below;
        the others are None in runs that do not have them. A plant of your own may have more.
    t : np.ndarray, (N + 1,)
        Time (s).
    q, v : np.ndarray, (N + 1, nq), (N + 1, nv)
        The plant's state in the model's convention.
    y, y_ref, error : np.ndarray, (N + 1, 3)
        Tip, reference and ``y - y_ref`` (m); the last two are NaN in a rollout.
    u : np.ndarray, (N, nu)
        The input the plant got, inside its bounds.
    V, delta : np.ndarray, (N,)
        Lyapunov function and relaxation; NaN from a controller that has none.
    status : np.ndarray, (N,)
        Text, empty from a controller that has none.
    step_us : np.ndarray, (N,)
        Time of the control step, (q, v) → State → u (µs).
    Vdot, delta_true : np.ndarray, (N,), or None
        Of a `certified` log: V̇ and the relaxation computed with the model's acceleration.
    command : np.ndarray, (N, nu), or None
        With a rig: the commands that were sent, in the file's units.
    acting : np.ndarray, (N + 1, nu), or None
        With a rig: the inputs that acted at each sample, as forces.
    q_seen, v_seen : np.ndarray, (N, nq), (N, nv), or None
        With a rig: the state that the controller saw.
    measured : np.ndarray, (N + 1, sensors), or None
        With a rig: the readings of its sensors, with columns such as ``camera.x``.
    clock, stamps : np.ndarray, (N + 1,), (N + 1, sensors), or None
        On a real rig: the time of each sample on the clock of `time.monotonic` (s), NaN of a period
        that was left out, and the time t (s) at which each reading was measured.
    missed : np.ndarray, (N + 1,), or None
        On a real rig: the deadlines missed before each sample.
    tasks : np.ndarray, (N + 1, columns), or None
        Of a controller with `tasks`: their errors.
    targets : np.ndarray, (N + 1, numbers), or None
        Of tasks of links' frames: the numbers of their targets.
    disturbances, deviations : np.ndarray, (N + 1, nd), or None
        Of an observer of disturbances: their estimates and standard deviations, with columns such
        as ``tip_force.x``.
    reserve : np.ndarray, (N + 1, barriers), or None
        Among obstacles: the smallest value of every barrier (m).
    distance : np.ndarray, (N,), or None
        Of a controller that found an equilibrium to go to: from the reference to its tip (m), NaN
        before it was found.
    u_min, u_max : np.ndarray, (nu,)
        The bounds of u.
    u_unit : str
        The unit of u, e.g. ``0.1 N m``.
    robot, controller : str
        Their names.
    kind, theta, omega : str, float, float or None
        Those of the experiment; ``rollout`` without a controller; None for a plain reference.
    duration, period, timestep : float
        Planned length of the run, control period, plant step (s).
    length : float or None
        The robot's length (m), None when unknown.
    contacts, complete : bool
        Whether links could touch, and whether the run reached its end.
    failed, reason : bool, str or None
        Whether the run counts as failed (see `ClosedLoop`), and the reason.
    not_solved, fallbacks : int
        The controller's counts over this run.
    max_bound_violation : float
        Largest violation of the input bounds by the controller's answer, before clipping.
    gains : Any
        Gains of the controller, None if it does not expose them.
    versions : dict[str, str]
        Versions of the packages that computed this run.
    source : LoggedRobot
        The robot, with the text of its file at the time of the run.
    plant : str or None
        Name of the user's file that was the plant, None where it was the twin.
    marks : tuple[TaskMark, ...]
        What the numbers of `targets` are.
    obstacles : dict or None
        The table of these barriers, see `softdyn.safety.Surroundings`.
    start : str
        Joints that the default start moves to their limits, because 0 lies beyond them.
    """

    t: ClassVar[np.ndarray]
    q: ClassVar[np.ndarray]
    v: ClassVar[np.ndarray]
    y: ClassVar[np.ndarray]
    y_ref: ClassVar[np.ndarray]
    error: ClassVar[np.ndarray]
    u: ClassVar[np.ndarray]
    V: ClassVar[np.ndarray]
    delta: ClassVar[np.ndarray]
    status: ClassVar[np.ndarray]
    step_us: ClassVar[np.ndarray]
    Vdot: ClassVar[np.ndarray | None] = None
    delta_true: ClassVar[np.ndarray | None] = None
    command: ClassVar[np.ndarray | None] = None
    acting: ClassVar[np.ndarray | None] = None
    q_seen: ClassVar[np.ndarray | None] = None
    v_seen: ClassVar[np.ndarray | None] = None
    measured: ClassVar[np.ndarray | None] = None
    clock: ClassVar[np.ndarray | None] = None
    stamps: ClassVar[np.ndarray | None] = None
    missed: ClassVar[np.ndarray | None] = None
    tasks: ClassVar[np.ndarray | None] = None
    targets: ClassVar[np.ndarray | None] = None
    disturbances: ClassVar[np.ndarray | None] = None
    deviations: ClassVar[np.ndarray | None] = None
    reserve: ClassVar[np.ndarray | None] = None
    distance: ClassVar[np.ndarray | None] = None

    channels: Mapping[str, LogChannel]
    u_min: np.ndarray
    u_max: np.ndarray
    u_unit: str
    robot: str
    controller: str
    kind: str | None
    theta: float | None
    omega: float | None
    duration: float
    period: float
    timestep: float
    length: float | None
    contacts: bool
    complete: bool
    failed: bool
    reason: str | None
    not_solved: int
    fallbacks: int
    max_bound_violation: float
    gains: Any
    versions: dict[str, str]
    source: LoggedRobot
    plant: str | None = None
    marks: tuple[TaskMark, ...] = ()
    obstacles: dict[str, Any] | None = None
    start: str = ""

    def __post_init__(self) -> None:
        taken = {field.name for field in fields(self)}
        for name, channel in self.channels.items():
            if name in taken or getattr(Log, name, None) is not None:
                raise InputError("channels", "a name that is no attribute of a log", name)
            object.__setattr__(self, name, channel.values)
        freeze((self.u_min, self.u_max, *(channel.values for channel in self.channels.values())))

    def __reduce__(self) -> tuple[Any, ...]:
        # copies of NumPy arrays are writable; the constructor makes them read-only again
        return Log, tuple(getattr(self, field.name) for field in fields(self))

    def altered(self, *more: LogChannel, **changes: Any) -> Log:
        """The log with other channels or values: ``log.altered(u=…, failed=True)``."""
        channels = dict(self.channels)
        for name in channels.keys() & changes:
            channels[name] = channels[name].filled(changes.pop(name))
        channels |= {channel.name: channel for channel in more}
        return replace(self, channels=channels, **changes)

    def columns(self, name: str) -> tuple[tuple[str, str], ...]:
        """(name, unit) of each column of a channel; none of a channel that is not there."""
        channel = self.channels.get(name)
        if channel is None or channel.columns is None:
            return ()
        return tuple(zip(channel.columns, channel.units, strict=True))

    def __repr__(self) -> str:
        outcome = f"failed: {self.reason}" if self.failed else "done"
        return f"Log({self.robot}, {self.controller}, {self.steps} steps, {outcome})"

    def __str__(self) -> str:
        return self.summary()

    def plot(self, path: str | Path | None = None) -> Any:
        """Errors and inputs over time, as a Matplotlib figure that a notebook shows.

        Parameters
        ----------
        path : str or Path, optional
            A file to write it to, a PNG.

        Raises
        ------
        InputError
            When nothing can be written there.
        """
        # local, because runs need no Matplotlib
        from softdyn.validation.loop.pictures.time_figures import plot

        return plot(self, path)

    def show(self, model: SoftModel | None = None) -> Any:
        """An interactive replay page of the run, for a notebook's cell or, by ``save``, a file.

        Parameters
        ----------
        model : SoftModel, optional
            The log's robot; by default it is made from the text in the log.

        Raises
        ------
        InputError
            The model is of another robot.
        """
        from softdyn.validation.loop.pictures.replay import replay

        return replay(self, self.source.model() if model is None else model)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The order of v."""
        return tuple(name for name, _ in self.columns("v"))

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """The columns of `measured`."""
        return tuple(name for name, _ in self.columns("measured"))

    @property
    def task_names(self) -> tuple[str, ...]:
        """The columns of `tasks`."""
        return tuple(name for name, _ in self.columns("tasks"))

    @property
    def disturbance_names(self) -> tuple[str, ...]:
        """The columns of `disturbances`."""
        return tuple(name for name, _ in self.columns("disturbances"))

    @property
    def steps(self) -> int:
        """Number N of control steps done."""
        return len(self.u)

    @property
    def surroundings(self) -> Surroundings | None:
        """The obstacles around the robot."""
        return None if self.obstacles is None else Surroundings.of(self.obstacles)

    @property
    def least_reserve(self) -> dict[str, float]:
        """The smallest reserve (m) of each barrier over the run, by its name."""
        if self.reserve is None or self.surroundings is None:
            return {}
        least = np.nanmin(self.reserve, axis=0).tolist()
        return dict(zip(self.surroundings.names, least, strict=True))

    @property
    def finite_samples(self) -> int:
        """Number of samples before the first that is not finite, the last of a diverged run."""
        finite = np.isfinite(self.y).all(axis=1) & np.isfinite(self.q).all(axis=1)
        return len(finite) if finite.all() else int(np.argmin(finite))

    @property
    def final_error_cm(self) -> float:
        """‖e(T)‖ (cm) of the run's final state, the paper's SP; NaN when the run ended early."""
        return CM * float(np.linalg.norm(self.error[-1])) if self.complete else math.nan

    @property
    def mse_cm2(self) -> float:
        """Time-mean of ‖e‖² (cm²) over the whole run, the paper's TT; NaN when it ended early.

        See `metrics.mean_square` for the samples and their weights.
        """
        return CM**2 * mean_square(self.t, self.error) if self.complete else math.nan

    @property
    def step_times_us(self) -> dict[str, float | None]:
        """Median, 99 %, 99.9 % and maximum (µs) of the control step; None without steps.

        Periods that a rig's clock has left out do not count.
        """
        return _quantiles(self.step_us)

    @property
    def jitter_us(self) -> dict[str, float | None]:
        """Median, 99 %, 99.9 % and maximum (µs) of the lateness of a period on a real rig."""
        if self.clock is None:
            return dict.fromkeys(STEP_TIMES)
        return _quantiles(1e6 * (self.clock - self.clock[0] - self.t))

    @property
    def moving(self) -> bool:
        """Whether the reference, or the target of a task of a link's frame, is a trajectory."""
        parts = [self.y_ref] if self.targets is None else [self.y_ref, self.targets]
        return judged.moves(np.hstack(parts))

    def verdict(self, tolerance: float | None = None) -> Verdict:
        """Whether the run reached its reference, with settling time, effort and missed deadlines.

        Parameters
        ----------
        tolerance : float, optional
            Tolerance (m); 1 % of the robot's length by default.

        Raises
        ------
        InputError
            For a tolerance that is no number > 0.
        """
        wanted = judged.tolerance_of(self.length, self.error, tolerance)
        cycle = 2 / self.omega if self.omega else None
        within, since, steady = not self.failed, None, math.nan
        off: tuple[str, ...] | None = None
        if self.complete:
            moving = self.moving
            steady = judged.steady_error(self.t, self.error, moving, cycle)
            columns = [] if self.tasks is None else [np.outer(e, [1, 0, 0]) for e in self.tasks.T]
            each = [
                max(judged.steady_error(self.t, e, moving, cycle), 0.0 if moving else e[-1, 0])
                for e in columns
            ]
            off = judged.missed_tasks(self.columns("tasks"), each, wanted, self.length)
            since = judged.settling_time(self.t, self.error, wanted)
            if off is None:
                within &= steady <= wanted and (since is not None or moving)
            else:
                within &= not off
        known = np.isfinite(self.step_us).all()
        last = self.finite_samples
        return Verdict(
            self.complete and within,
            wanted,
            steady,
            since,
            judged.overshoot(self.y[:last], self.y_ref[:last]) if last else None,
            *judged.activity(self.t, self.u, self.u_min, self.u_max),
            int((self.step_us > 1e6 * self.period).sum()) if known else None,
            off or (),
            off is not None,
        )

    def report(self, tolerance: float | None = None) -> dict[str, Any]:
        """The run's figures with the keys of the commands' JSON; `tolerance` is in m."""
        found, least = self.verdict(tolerance), self.least_reserve
        made = {
            "robot": self.robot,
            "controller": self.controller,
            "kind": self.kind,
            "final_error_cm": self.final_error_cm,
            "mse_cm2": self.mse_cm2,
            "failed": self.failed,
            "reason": self.reason,
            "steps": self.steps,
            "step_us": self.step_times_us,
            "not_solved": self.not_solved,
            "fallbacks": self.fallbacks,
            "max_bound_violation": self.max_bound_violation,
            "start": self.start or None,
            "verdict": "failed" if self.failed else ("reached" if found.reached else "not reached"),
            **found.to_dict(),
        }
        if self.missed is not None:
            made |= {"missed": int(np.nansum(self.missed)), "jitter_us": self.jitter_us}
        if least:
            made["reserve_mm"] = {name: 1e3 * m for name, m in least.items()}
        if self.disturbance_names:
            made["disturbances"] = self.disturbance_figures
        if self.task_names:
            made |= {"tasks": self.task_figures, "missed_tasks": [*found.missed_tasks]}
        return made

    def summary(
        self, beside: Mapping[str, str] | None = None, tolerance: float | None = None
    ) -> str:
        """The same figures as several lines of text.

        Parameters
        ----------
        beside : Mapping[str, str], optional
            Text after a figure, by the figure's key in `report`: ``final_error_cm``, ``mse_cm2``.
        tolerance : float, optional
            Tolerance of the `verdict` (m).
        """
        if self.kind == ROLLOUT:
            text = judged.rollout_text(self.robot, self.t[-1], self.y[-1], self.reason)
            return text + (f"\nstart: {self.start}" if self.start else "")
        sp, tt = (
            f"   {beside[name]}" if beside and name in beside else ""
            for name in ("final_error_cm", "mse_cm2")
        )
        lines = [
            f"{self.robot}{f' in {self.plant}' if self.plant else ''}, {self.controller}, "
            f"{judged.goal_text(self.theta, self.omega, self.y_ref)}: {self.t[-1]:g} s of "
            f"{self.duration:g} s, period {1e3 * self.period:g} ms",
            *([f"start          {self.start}"] if self.start else []),
            f"final error    {self.final_error_cm:.3f} cm{sp}",
            f"mean |e|^2     {self.mse_cm2:.3f} cm²{tt}",
        ]
        if parts := _stated(self.step_times_us):
            lines.append(f"step time      {parts} us over {self.steps} steps")
        if self.missed is not None and (parts := _stated(self.jitter_us)):
            lines.append(
                f"clock          periods began late by {parts} us; "
                f"{np.nansum(self.missed):.0f} deadlines missed"
            )
        beyond = self.max_bound_violation
        lines.append(
            f"solver         {self.not_solved} not solved, {self.fallbacks} fallbacks, "
            + (
                f"answers up to {beyond:.2g} beyond the bounds, clipped"
                if beyond
                else "inputs in bounds"
            )
        )
        lines += judged.task_lines(self.task_figures)
        found = self.verdict(tolerance)
        if found.activity is not None:
            lines.append(
                f"inputs         change by {found.activity:.3g} of their range a second, "
                f"{found.at_bound:.0%} of the time at a bound"
            )
        if found.overshoot is not None and found.overshoot > 1e-3:
            lines.append(f"overshoot      {found.overshoot:.1%} of the way")
        if found.missed:
            lines.append(
                f"deadlines      MISSED {found.missed} of {self.steps}: steps longer than the "
                f"period of {1e3 * self.period:g} ms"
            )
        for name, (value, half, unit) in self.disturbance_figures.items():
            lines.append(f"estimated      {name} {value:.3g} ± {half:.2g} {unit}".rstrip())
        if self.least_reserve:
            parts = ", ".join(f"{name} {1e3 * m:.2f}" for name, m in self.least_reserve.items())
            lines.append(f"least reserve  {parts} mm")
        return "\n".join([*lines, self._verdict_text(found)])

    def _verdict_text(self, found: Verdict) -> str:
        """The last line of a summary."""
        if self.failed:
            return f"failed: {self.reason}"
        if not self.complete:
            return "not reached: the run is not over"
        first, last = (CM * math.dist(self.y[i], self.y_ref[i]) for i in (0, -1))
        wanted, steady = (f"{CM * x:.3g} cm" for x in (found.tolerance, found.steady_error))
        if found.by_tasks:
            missed = ", ".join(found.missed_tasks)
            what = (
                f"beyond their tolerance: {missed}"
                if missed
                else "all tasks within their tolerance"
            )
        elif self.moving:
            what = f"rms error of {steady} over the last cycle, tolerance {wanted}"
        else:
            what = f"|e| fell from {first:.3f} to {last:.3f} cm, tolerance {wanted}"
            if found.settling_time is not None:
                what += f", within it since {found.settling_time:.3g} s"
        return ("reached: " if found.reached else "not reached: ") + what

    @property
    def disturbance_figures(self) -> dict[str, tuple[float, float, str]]:
        """The last estimate of each disturbance, half its 95 % interval, and their unit."""
        if self.disturbances is None or self.deviations is None:
            return {}
        last, half = self.disturbances[-1].tolist(), (SIGMAS * self.deviations[-1]).tolist()
        columns = zip(self.columns("disturbances"), last, half, strict=True)
        return {name: (value, error, unit) for (name, unit), value, error in columns}

    @property
    def found_at(self) -> tuple[int, ...]:
        """The steps at which an equilibrium arrived that the controller then went to."""
        if self.distance is None:
            return ()
        known = np.isfinite(self.distance)
        return tuple(np.flatnonzero(known & ~np.append(False, known[:-1])).tolist())

    @property
    def task_figures(self) -> dict[str, Any]:
        """The figures of every column of `tasks`."""
        return judged.task_figures(self.columns("tasks"), self.tasks)

    def save(self, path: str | Path) -> None:
        """Write the log as a compressed NPZ file; the file appears complete or not at all.

        Raises
        ------
        InputError
            When nothing can be written there.
        """
        log_files.save_npz(path, self.channels, self._about())

    def to_csv(self, path: str | Path) -> None:
        """Write the run as CSV (see `log_files.csv_text`), complete or not at all.

        Raises
        ------
        InputError
            When nothing can be written there, or the run has no control step.
        """
        log_files.save_csv(path, self.channels, self._about())

    @classmethod
    def load(cls, path: str | Path) -> Log:
        """Read a log exactly as it was saved.

        Raises
        ------
        InputError
            The file cannot be read, or is not a complete, consistent log of this version.
        """
        return cls._of(*log_files.load_npz(path))

    @classmethod
    def from_csv(cls, path: str | Path, model: SoftModel | None = None) -> Log:
        """Read a log exactly as `to_csv` wrote it, or what a rig recorded.

        Parameters
        ----------
        path : str or Path
            The file.
        model : SoftModel, optional
            The robot of a recording, which is a file without a log's settings; see
            `log_files.load_recording`.

        Raises
        ------
        InputError
            The file cannot be read, or is not a complete, consistent log of this version.
        """
        if model is not None and not log_files.is_log(path):
            return cls._of(*log_files.load_recording(path, model))
        return cls._of(*log_files.load_csv(path))

    def _about(self) -> dict[str, Any]:
        """All that is no channel, as plain data."""
        found = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "channels"}
        found |= {name: found[name].tolist() for name in ("u_min", "u_max")}
        return found | {
            "source": asdict(self.source), "marks": [mark.table for mark in self.marks],
        }  # fmt: skip

    @classmethod
    def _of(cls, channels: Mapping[str, LogChannel], about: dict[str, Any]) -> Log:
        about |= {name: np.array(about[name]) for name in ("u_min", "u_max")}
        about["marks"] = tuple(TaskMark.of(table) for table in about["marks"])
        return cls(channels, **about | {"source": LoggedRobot(**about["source"])})


def _quantiles(values: np.ndarray) -> dict[str, float | None]:
    """The percentiles `STEP_TIMES` of the values that are finite; None without any."""
    known = values[np.isfinite(values)]
    if not len(known):
        return dict.fromkeys(STEP_TIMES)
    return {name: float(np.percentile(known, p)) for name, p in STEP_TIMES.items()}


def _stated(times: Mapping[str, float | None]) -> str:
    """Times (µs) in one line; empty where none is known."""
    return ", ".join(f"{name} {value:.0f}" for name, value in times.items() if value is not None)
