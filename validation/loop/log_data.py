"""The data of a run: its channels, its settings, and the figures that follow from them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np

from softdyn import InputError
from softdyn.controllers.channels import LogChannel
from softdyn.copies import freeze
from softdyn.description.task_mark import TaskMark
from softdyn.safety import Surroundings
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.loop.metrics import (
    CM,
    SIGMAS,
    STEP_TIMES,
    mean_square,
    moves,
    quantiles,
    task_figures,
)


class ChannelValues:
    """An attribute of a log with the values of the channel of that name, which every log has."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, log: None, owner: type) -> Self: ...
    @overload
    def __get__(self, log: LogData, owner: type) -> np.ndarray: ...
    def __get__(self, log: LogData | None, owner: type) -> Self | np.ndarray:
        return self if log is None else log.channels[self.name].values


class OptionalValues:
    """The same of a channel that only some runs have; None in all others."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, log: None, owner: type) -> Self: ...
    @overload
    def __get__(self, log: LogData, owner: type) -> np.ndarray | None: ...
    def __get__(self, log: LogData | None, owner: type) -> Self | np.ndarray | None:
        if log is None:
            return self
        channel = log.channels.get(self.name)
        return None if channel is None else channel.values


@dataclass(frozen=True, eq=False, repr=False)
class LogData:
    """The data of a log: its samples, its settings and its robot.

    With N control steps done there are N + 1 samples of the plant: one at the start of every
    hold, ``t[k] = k · period``, and one at the end of the last, which is the run's final state.
    ``u[k]`` was held from ``t[k]`` to ``t[k + 1]``. Arrays are read-only.

    Attributes
    ----------
    channels : dict of str to LogChannel
        All quantities along the run by name, with the names and units of their columns.
        ``log["V"]`` are the values of the channel V, and so is the attribute ``log.V``. Every log
        has those from `t` to `step_us` below; the others are attributes that are None in runs that
        do not have them. A plant or a controller of your own may have more.
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
        Of a `certify` log: V̇ and the relaxation computed with the model's acceleration.
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
    contact_force : np.ndarray, (N + 1, 3 · solid obstacles), or None
        Among solid obstacles, in the twin: the force of each on the robot (N), with columns such as
        ``floor.z`` in the world's axes.
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
    record : mapping
        The run's settings, controller, reference, files with their digests, processor and git
        commit, as plain data; `repeat.record_of` describes it. Empty in logs of older versions.
    """

    t = ChannelValues()
    q = ChannelValues()
    v = ChannelValues()
    y = ChannelValues()
    y_ref = ChannelValues()
    error = ChannelValues()
    u = ChannelValues()
    V = ChannelValues()
    delta = ChannelValues()
    status = ChannelValues()
    step_us = ChannelValues()
    Vdot = OptionalValues()
    delta_true = OptionalValues()
    command = OptionalValues()
    acting = OptionalValues()
    q_seen = OptionalValues()
    v_seen = OptionalValues()
    measured = OptionalValues()
    clock = OptionalValues()
    stamps = OptionalValues()
    missed = OptionalValues()
    tasks = OptionalValues()
    targets = OptionalValues()
    disturbances = OptionalValues()
    deviations = OptionalValues()
    reserve = OptionalValues()
    contact_force = OptionalValues()
    distance = OptionalValues()

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
    record: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze((self.u_min, self.u_max, *(channel.values for channel in self.channels.values())))

    def __reduce__(self) -> tuple[Any, ...]:
        # copies of NumPy arrays are writable; the constructor makes them read-only again
        return type(self), tuple(getattr(self, field.name) for field in fields(self))

    def __getitem__(self, name: str) -> np.ndarray:
        """The values of a channel: ``log["V"]``.

        Raises
        ------
        InputError
            The run has no channel of this name.
        """
        if name not in self.channels:
            raise InputError("a channel of the log", " or ".join(self.channels), repr(name))
        return self.channels[name].values

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    if not TYPE_CHECKING:  # a type checker knows the attributes that are listed above

        def __getattr__(self, name: str) -> np.ndarray:
            """The values of a channel of one's own."""
            channel = vars(self).get("channels", {}).get(name)
            if channel is None:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            return channel.values

    def altered(self, *more: LogChannel, **changes: Any) -> Self:
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
        """Time-mean of ‖e‖² (cm²) by the trapezoidal rule, the paper's TT; NaN when it ended early.

        It is 1/T ∫ ‖e‖² dt over the whole run of T seconds, no mean of the samples: the first and
        the last one have half the weight of the others. See `metrics.mean_square`.
        """
        return CM**2 * mean_square(self.t, self.error) if self.complete else math.nan

    @property
    def step_times_us(self) -> dict[str, float | None]:
        """Median, 99 %, 99.9 % and maximum (µs) of the control step; None without steps.

        Periods that a rig's clock has left out do not count.
        """
        return quantiles(self.step_us)

    @property
    def jitter_us(self) -> dict[str, float | None]:
        """Median, 99 %, 99.9 % and maximum (µs) of the lateness of a period on a real rig."""
        if self.clock is None:
            return dict.fromkeys(STEP_TIMES)
        return quantiles(1e6 * (self.clock - self.clock[0] - self.t))

    @property
    def moving(self) -> bool:
        """Whether the reference, or the target of a task of a link's frame, is a trajectory."""
        parts = [self.y_ref] if self.targets is None else [self.y_ref, self.targets]
        return moves(np.hstack(parts))

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
        return task_figures(self.columns("tasks"), self.tasks)


CHANNELS = tuple(
    name for name, one in vars(LogData).items() if isinstance(one, ChannelValues | OptionalValues)
)
"""The channels that softdyn knows; a log may have others, of a user's controller or plant."""


def own_channels(log: LogData) -> list[LogChannel]:
    """The channels of a user's own controller or plant."""
    return [channel for name, channel in log.channels.items() if name not in CHANNELS]
