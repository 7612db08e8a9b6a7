"""Targets of tasks, and references: callables t → target, for each kind, stacked by name."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.checks import array, flag, instance, length, number
from softdyn.copies import Frozen, KeepsMaking
from softdyn.csv_table import CsvTable
from softdyn.exceptions import InputError, errors_in
from softdyn.references import Reference
from softdyn.tasks.rotations import log3

ORTHONORMAL = 1e-6  # largest entry of RᵀR - I of a rotation
POINT, TURN = ["x", "y", "z"], ["rx", "ry", "rz"]  # parts of columns
CLOSES = 1e-6  # of the path's size, how far apart the ends of a period may be
CLOSED = 5  # least number of waypoints in a period: the degree of the spline
FULL_TURN = 2 * math.pi + 1e-6  # rad
OPPOSITE = -1 + 1e-6  # cosine of two directions from which none of those between is unique
LARGEST = 1e6  # m, rad; of a recorded number
TANGENT = {(3, 3): (3,), (4, 4): (6,)}  # shapes of rates, if not those of the value


@dataclass(frozen=True, eq=False)
class Target(Frozen):
    """The desired motion of one task at one instant; calling it with t gives itself.

    Attributes
    ----------
    y : array_like
        A point, direction or vector of coordinates (k,), points (k, 3), a rotation (3, 3) or a pose
        (4, 4); a rotation is made exactly orthonormal.
    ydot, yddot : array_like, optional
        Its rates, zero by default. Those of a rotation are ω and ω̇ (3,), those of a pose (ṗ, ω) and
        (p̈, ω̇) (6,), in the world's axes.

    Raises
    ------
    InputError
        For a shape that is none of these, numbers that are not finite, or a matrix that is no
        rotation or pose.
    """

    y: Any
    ydot: Any = None
    yddot: Any = None

    def __post_init__(self) -> None:
        shape = np.shape(self.y)
        y = array("y", self.y, shape)
        if shape in TANGENT:
            y = _rigid(y)
        elif not (len(shape) == 1 or (len(shape) == 2 and shape[1] == 3)):
            expected = "a vector, points (k, 3), a rotation (3, 3) or a pose (4, 4)"
            raise InputError("y", expected, f"shape {shape}")
        object.__setattr__(self, "y", y)
        tangent = TANGENT.get(shape, shape)
        for name in ("ydot", "yddot"):
            given = getattr(self, name)
            value = array(name, np.zeros(tangent) if given is None else given, tangent)
            object.__setattr__(self, name, value)

    def __call__(self, t: float) -> Target:
        """The same target at every time: a set point."""
        return self


def _rigid(y: np.ndarray) -> np.ndarray:
    """A rotation or a pose, its rotation the nearest orthonormal matrix."""
    R = y[:3, :3]
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    if not off < ORTHONORMAL or np.linalg.det(R) < 0:
        raise InputError("y", "a rotation matrix, RᵀR = I and det R = 1", repr(y.tolist()))
    if len(y) == 4 and not np.array_equal(y[3], (0, 0, 0, 1)):
        raise InputError("y", "a pose with the last row 0 0 0 1", repr(y[3].tolist()))
    U, _, Vt = np.linalg.svd(R)
    nearest = y.copy()
    nearest[:3, :3] = U @ Vt
    nearest.flags.writeable = False
    return nearest


Motion = Callable[[float], Any]  # t (s) → Target or Reference


class StackedReference(Reference):
    """Targets of several tasks at one instant, by the tasks' names.

    `y`, `ydot` and `yddot` are those of the first target that has a position: a `Reference` or a
    pose. They are what logs and verdicts compare with the tip.

    Parameters
    ----------
    targets : mapping
        Task name → `Target` or `Reference`.

    Attributes
    ----------
    targets : mapping
        The same.

    Raises
    ------
    InputError
        For anything else, or if no target has a position.
    """

    targets: Mapping[str, Any]

    def __init__(self, targets: Mapping[str, Any]) -> None:
        held = dict(instance("targets", targets, Mapping, "a mapping of names to targets"))
        place = None
        for name, target in held.items():
            if not isinstance(target, Target | Reference):
                raise InputError(f"target of {name!r}", "a Target or a Reference", repr(target))
            if place is None and (isinstance(target, Reference) or target.y.shape == (4, 4)):
                place = target
        if place is None:
            got = ", ".join(held) or "none"
            raise InputError("targets", "a target with a position: a SetPoint or a pose", got)
        object.__setattr__(self, "targets", held)
        if isinstance(place, Reference):
            super().__init__(place.y, place.ydot, place.yddot)
        else:
            super().__init__(place.y[:3, 3], place.ydot[:3], place.yddot[:3])


class References(KeepsMaking):
    """References of several tasks: a callable t → `StackedReference`.

    Parameters
    ----------
    motions : mapping
        Task name → callable t → `Target` or `Reference`, such as `SetPoint`, `Ellipse`, `Target`,
        `Waypoints`, `Turns`, `Poses` or an own one.

    Raises
    ------
    InputError
        For anything that cannot be called, or gives anything else at t = 0.
    """

    def __init__(self, motions: Mapping[str, Motion]) -> None:
        self.motions = dict(instance("motions", motions, Mapping, "a mapping of names"))
        for name, motion in self.motions.items():
            if not callable(motion):
                raise InputError(f"motion of {name!r}", "a callable t -> Target", repr(motion))
        self(0.0)

    def __call__(self, t: float) -> StackedReference:
        """The targets at time `t` (s)."""
        return StackedReference({name: motion(t) for name, motion in self.motions.items()})


class Waypoints(KeepsMaking, Frozen):
    """A path of points, directions or coordinates through waypoints: a spline of degree five.

    Rates and accelerations are continuous, and zero at both ends. Before the first and after the
    last waypoint the path rests. With two waypoints it is the line of least jerk. A periodic path
    repeats for ever, with continuous rates and accelerations where it closes.

    Parameters
    ----------
    times : array_like, (N,)
        Increasing times (s), at least two.
    values : array_like, (N, …)
        The waypoints, each a `Target`'s `y`, but no rotation or pose. A path of points (N, 3)
        gives a `Reference`.
    unit : bool
        Whether values are directions, which are made unit vectors all along the path.
    periodic : bool
        Whether the path closes: the last waypoint is the first one again, and there are at least
        `CLOSED` others.

    Raises
    ------
    InputError
        For other shapes, times that do not increase, numbers that are not finite, or a periodic
        path that does not close.
    """

    def __init__(
        self, times: Any, values: Any, *, unit: bool = False, periodic: bool = False
    ) -> None:
        # it loads scipy.optimize, which no control step needs
        from scipy.interpolate import make_interp_spline

        self.times = _times(times)
        shape = np.shape(values)
        values = array("values", values, (len(self.times), *shape[1:]))
        self._directions = bool(unit)
        if unit:
            _check_directions(values)
        self.periodic = flag("periodic", periodic)
        ends: Any = "periodic"
        if periodic:
            values = _closed(values)
        else:
            ends = ([(k, np.zeros(values.shape[1:])) for k in (1, 2)],) * 2
        self._spline = make_interp_spline(self.times, values, k=5, bc_type=ends)
        self._rates = self._spline.derivative(), self._spline.derivative(2)

    def __call__(self, t: float) -> Target | Reference:
        """The target at time `t` (s)."""
        t = number("t", t)
        if self.periodic:
            t = self.times[0] + (t - self.times[0]) % (self.times[-1] - self.times[0])
        inside = self.times[0] <= t <= self.times[-1]
        at = min(max(t, self.times[0]), self.times[-1])
        y = self._spline(at)
        ydot, yddot = (rate(at) if inside else np.zeros_like(y) for rate in self._rates)
        if self._directions:
            return Target(*_on_sphere(y, ydot, yddot))
        return Reference(y, ydot, yddot) if y.shape == (3,) else Target(y, ydot, yddot)


def _closed(values: np.ndarray) -> np.ndarray:
    """The waypoints with a last one that is exactly the first."""
    apart = float(np.abs(values[-1] - values[0]).max())
    expected = "a last waypoint that is the first one again, as a periodic path closes"
    if apart > CLOSES * float(np.ptp(values, axis=0).max()):
        raise InputError("values", expected, f"{apart:.3g} between them")
    if len(values) <= CLOSED:
        got = f"{len(values) - 1} waypoints"
        raise InputError("values", f"{CLOSED} waypoints or more in a period", got)
    return np.concatenate((values[:-1], values[:1]))


def _check_directions(values: np.ndarray) -> None:
    """Refuse directions that are zero, or opposite to the one before: no path between is unique."""
    sizes = np.linalg.norm(values, axis=-1)
    cosines = (values[1:] * values[:-1]).sum(-1) / np.maximum(sizes[1:] * sizes[:-1], 1e-300)
    if not (sizes > 1e-9).all() or (cosines < OPPOSITE).any():
        expected = "directions that are not zero, nor opposite to the one before"
        raise InputError("values", expected, repr(values.tolist()))


def _on_sphere(
    y: np.ndarray, ydot: np.ndarray, yddot: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """y / |y| and its two rates."""
    size = float(np.linalg.norm(y))
    if not size > 1e-9:
        raise InputError("values", "directions that do not pass through zero", repr(y.tolist()))
    d = y / size
    growth = d @ ydot
    rate = (ydot - growth * d) / size
    second = (yddot - (rate @ ydot + d @ yddot) * d - 2 * growth * rate) / size
    return d, rate, second


class Turns(KeepsMaking, Frozen):
    """Orientations through waypoints: from each to the next about a fixed axis (slerp).

    Along a turn the angle is the path of least jerk, so rates and accelerations are continuous, and
    zero at each waypoint.

    Parameters
    ----------
    times : array_like, (N,)
        Increasing times (s), at least two.
    rotations : array_like, (N, 3, 3)
        The waypoints.

    Raises
    ------
    InputError
        As `Waypoints`, and for matrices that are no rotations.
    """

    def __init__(self, times: Any, rotations: Any) -> None:
        self.times = _times(times)
        given = array("rotations", rotations, (len(self.times), 3, 3))
        self._corners = [_rigid(R) for R in given]
        self._turns = [log3(after @ before.T) for before, after in pairwise(self._corners)]

    def __call__(self, t: float) -> Target:
        """The rotation at time `t` (s), with ω and ω̇ in the world's axes."""
        t = number("t", t)
        k = int(np.clip(np.searchsorted(self.times, t, "right") - 1, 0, len(self._turns) - 1))
        span = self.times[k + 1] - self.times[k]
        x = min(max((t - self.times[k]) / span, 0.0), 1.0)
        share = x * x * x * (10 - 15 * x + 6 * x * x)
        rate = 30 * x * x * (1 - x) ** 2 / span
        second = 60 * x * (1 - x) * (1 - 2 * x) / span**2
        turn = self._turns[k]
        return Target(exp3(share * turn) @ self._corners[k], rate * turn, second * turn)


@dataclass(frozen=True, eq=False)
class Poses:
    """A path of poses from one of points and one of orientations.

    Attributes
    ----------
    points : Callable
        t → a target of shape (3,), such as `SetPoint`, `Ellipse` or `Waypoints`.
    rotations : Callable
        t → a target of shape (3, 3), such as `Turns`, or a `Target`.
    """

    points: Motion
    rotations: Motion

    @property
    def times(self) -> np.ndarray:
        """Times (s) of the waypoints of `points`."""
        found: np.ndarray = self.points.times  # type: ignore[attr-defined]
        return found

    def __call__(self, t: float) -> Target:
        """The pose at time `t` (s)."""
        point, turn = self.points(t), self.rotations(t)
        if np.shape(turn.y) != (3, 3) or np.shape(point.y) != (3,):
            got = f"shapes {np.shape(point.y)} and {np.shape(turn.y)}"
            raise InputError("pose", "a point (3,) and a rotation (3, 3)", got)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn.y, point.y
        both = (np.concatenate((getattr(point, x), getattr(turn, x))) for x in ("ydot", "yddot"))
        return Target(pose, *both)


def exp3(turn: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) of a rotation vector (3,)."""
    angle = math.sqrt(turn @ turn)
    x, y, z = turn
    K = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    half = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    rotation: np.ndarray = np.eye(3) + np.sinc(angle / np.pi) * K + half * K @ K
    return rotation


def turned(name: str, turn: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) of a user's rotation vector (3,).

    Raises
    ------
    InputError
        For a vector longer than a full turn, which is probably in degrees.
    """
    if not np.abs(turn).max() <= FULL_TURN:
        raise InputError(name, "a rotation vector in rad, at most a full turn", repr(turn.tolist()))
    return exp3(turn)


def _times(times: Any) -> np.ndarray:
    found = array("times", times, (length("times", times),))
    if len(found) < 2 or not (np.diff(found) > 0).all():
        raise InputError("times", "two increasing times or more", repr(times))
    return found


def read_paths(path: str | Path) -> dict[str, Waypoints | Turns | Poses]:
    """Paths of tasks from a CSV file, for `References`; its columns are ``t`` and those of tasks.

    NAME.x, NAME.y and NAME.z are a point, NAME.rx, NAME.ry and NAME.rz a rotation vector (rad), all
    six a pose, NAME.dx, NAME.dy and NAME.dz a direction, and NAME.0, NAME.1, … coordinates.

    Raises
    ------
    InputError
        For a file that cannot be read, columns that are none of these or not complete, entries that
        are no numbers, or times that do not increase.
    """
    read = CsvTable(path)
    file, names = read.path, ["t", *(name for name in read.names if name != "t")]
    read.once(names)
    if len(names) < 2 or len(read) < 2:
        got = f"{read.names}, {len(read)} rows"
        raise InputError(file, "columns t, NAME.x … and two rows", got)
    table = dict(zip(names, read.numbers(names).T, strict=True))
    with errors_in(file):
        return _paths(file, table.pop("t"), table)


def read_path(path: str | Path, *, periodic: bool = False) -> Waypoints:
    """A path of the tip from a CSV file with the columns ``t`` (s), ``x``, ``y``, ``z`` (m).

    Its first row is at t = 0. Units may stand behind the names, as in ``x (m)``.

    Parameters
    ----------
    path : str or Path
    periodic : bool
        Whether the path repeats; its last row then has the point of the first.

    Raises
    ------
    InputError
        It names the file, and the line of a cell that is no number: for a file that cannot be read,
        other columns, fewer than two rows, times that do not increase from 0, and a periodic path
        that does not close.
    """
    read = CsvTable(path)
    read.once(["t", *POINT])
    if len(read) < 2:
        raise InputError(read.path, "two rows or more", f"{len(read)}")
    times, values = np.split(read.numbers(["t", *POINT]), [1], axis=1)
    with errors_in(read.path):
        if times[0, 0] != 0:
            raise InputError("t", "0 in the first row", f"{times[0, 0]:g} s")
        if not np.abs(values).max() <= LARGEST:
            raise InputError("numbers", f"within ±{LARGEST:g} m", f"{np.abs(values).max():g}")
        return Waypoints(times[:, 0], values, periodic=periodic)


def _paths(
    file: str, times: np.ndarray, table: dict[str, np.ndarray]
) -> dict[str, Waypoints | Turns | Poses]:
    groups: dict[str, dict[str, np.ndarray]] = {}
    for name, values in table.items():
        task, _, part = name.rpartition(".")
        groups.setdefault(task, {})[part] = values
    found: dict[str, Waypoints | Turns | Poses] = {}
    for task, parts in groups.items():
        numbered = [str(k) for k in range(len(parts))]
        for wanted in (POINT, TURN, [*POINT, *TURN], ["dx", "dy", "dz"], numbered):
            if task and set(parts) == set(wanted):
                break
        else:
            expected = f"{task or 'NAME'}.x .y .z, .rx .ry .rz, all six, .dx .dy .dz or .0 .1 …"
            raise InputError(file, expected, ", ".join(parts))
        values = np.column_stack([parts[part] for part in wanted])
        with errors_in(f"{file}: {task}"):
            found[task] = _path(wanted, times, values)
    return found


def _path(parts: list[str], times: np.ndarray, values: np.ndarray) -> Waypoints | Turns | Poses:
    """The path of the numbers (N, parts) of one task."""
    if not np.abs(values).max() <= LARGEST:
        raise InputError("numbers", f"within ±{LARGEST:g}", np.abs(values).max())
    if "rx" not in parts:
        return Waypoints(times, values, unit=parts[0] == "dx")
    turns = Turns(times, [turned("rotation", turn) for turn in values[:, -3:]])
    return turns if parts == TURN else Poses(Waypoints(times, values[:, :3]), turns)


def recorded_paths(path: str | Path) -> dict[str, Waypoints | Turns | Poses]:
    """The former name of `read_paths`, for one version."""
    warnings.warn("recorded_paths is now read_paths", DeprecationWarning, stacklevel=2)
    return read_paths(path)
