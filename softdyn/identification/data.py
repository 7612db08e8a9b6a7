"""Measurements of a robot: inputs, and joint angles, markers, the tip or cable lengths."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.ndimage import minimum_filter1d

from softdyn.checks import array, did_you_mean, flag, in_degrees, instances, length, whole
from softdyn.csv_table import CsvTable
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.stops import Stops
from softdyn.exceptions import InputError, errors_in
from softdyn.identification.markers.points import PREFIX
from softdyn.identification.unknowns.sensor_errors import READ, layout_of

FAR = 5.0  # times its bound; an input this large is probably in another unit
AWAY = 50.0  # robot lengths; a tip that is farther away is probably in mm
SLOW = 0.5  # s between samples; with longer steps the times are probably milliseconds
BESIDE = ("v.", "target.", "command.", "acting.")  # other columns of a rig's recording
LOG = "log"  # a column of a log's CSV; all of its columns that are no measurements are left out
GAPS = ("tip.", "length.", "point.", "pose.", READ)  # columns whose cells may be empty
AXES = ("x", "y", "z")
SHORTEST = 20  # least samples of a stretch; each stretch has its own unknown first state
ENOUGH = 0.2  # if this share of the data lies in stretches without a stop, hold no further joint
NEAR = 0.02  # of a joint's range; a joint this close to a stop may be pressed against it
LARGEST = 1e6  # rad or m; no robot's output is larger, and its square would hide all others
BEYOND = 0.1  # of an input's range; a measured tension may overshoot its bound
LOST = 5.0  # times the usual distance of rows; in a longer one, rows were lost
TURNED = np.pi / 2  # rad between rows; with more, an angle that jumps by 2 pi is ambiguous
ROUNDED = 1e-3  # rad; wrapped angles are within one turn up to their digits
ROUND = 0.1  # of the unit circle's radius; cosines and sines may be noisy, but no other numbers
PRESSED = 4  # samples before and after at which a held joint must be at its stop; arrivals bounce


@dataclass(frozen=True, eq=False)
class Measurements:
    """N samples of measured inputs and outputs.

    Attributes
    ----------
    t : ndarray, (N,)
        Times (s), increasing, in any steps.
    u : ndarray, (N, m)
        Inputs, each held from its sample to the next one.
    names : tuple of str
        Names of the measured outputs: ``q.JOINT``, ``tip.x``, ``length.TENDON``,
        ``point.MARKER.x``, ``pose.MARKER.rx``.
    outputs : ndarray, (N, len(names))
        Their values (rad or m); NaN where one was not measured. Joints have no gaps.

    direction : ndarray, (N, m), optional
        Last direction of each input's cable in static rows: 1 pulled in, -1 paid out, 0 unknown.

    Raises
    ------
    InputError
        For other shapes, numbers that are not finite or beyond `LARGEST`, a repeated output, times
        that do not increase, outputs that are all constant, and an output without a number.
    """

    t: np.ndarray
    u: np.ndarray
    names: tuple[str, ...]
    outputs: np.ndarray
    direction: np.ndarray | None = None

    def __post_init__(self) -> None:
        samples = length("t", self.t)
        if samples < 3 or not instances("names", self.names, str, "an output's name"):
            raise InputError("data", "three samples of an output or more", f"{samples}")
        object.__setattr__(self, "t", array("t", self.t, (samples,)))
        for name in self.names:
            if self.names.count(name) > 1:
                raise InputError("names", "each output once", f"{name!r} twice")
        rows = self.u
        if not isinstance(rows, np.ndarray):
            rows = instances("u", rows, object, "the inputs of one sample")
        inputs = length("u[0]", rows[0]) if length("u", rows) else 0
        object.__setattr__(self, "u", array("u", rows, (samples, inputs)))
        if self.direction is not None:
            way = array("direction", self.direction, (samples, inputs))
            if not np.isin(way, (-1, 0, 1)).all():
                raise InputError("direction", "1 pulled in, -1 paid out or 0", "another number")
            object.__setattr__(self, "direction", way)
        shape = (samples, len(self.names))
        object.__setattr__(self, "outputs", array("outputs", self.outputs, shape, finite=False))
        self._check_gaps()
        most = np.nanmax(np.abs(self.outputs), axis=0)
        if most.max() > LARGEST:
            k = int(most.argmax())
            raise InputError(self.names[k], f"rad or m, at most {LARGEST:g}", f"{most[k]:g}")
        late = np.flatnonzero(np.diff(self.t) <= 0)
        if late.size:
            k = int(late[0])
            raise InputError("t", "increasing times", f"{self.t[k]:g}, then {self.t[k + 1]:g}")
        if not spread(self.outputs).any():
            raise InputError("data", "outputs that move: excite the robot", "constant ones")

    def _check_gaps(self) -> None:
        """Refuse infinities, gaps of joints, and outputs without a number."""
        missing = np.isnan(self.outputs)
        for k, name in enumerate(self.names):
            gaps = int(missing[:, k].sum())
            if np.isinf(self.outputs[:, k]).any():
                raise InputError(name, "finite numbers", "an infinite one")
            if gaps == len(missing) or (gaps and name.startswith("q.")):
                expected = "a number in every row" if name.startswith("q.") else "a number"
                raise InputError(name, expected, f"{gaps} empty cells")

    def part(self, begin: int, end: int) -> Measurements:
        """The samples from `begin` to `end`."""
        keep = slice(whole("begin", begin), whole("end", end))
        return self.rows(np.arange(len(self.t))[keep])

    def rows(self, keep: np.ndarray) -> Measurements:
        """The samples of these indices."""
        way = None if self.direction is None else self.direction[keep]
        return Measurements(self.t[keep], self.u[keep], self.names, self.outputs[keep], way)

    def joints(self, model: SoftModel) -> np.ndarray | None:
        """Joint coordinates (N, n) if all were measured, else None."""
        wanted = [f"q.{name}" for name in check_model(model).joint_names]
        if not set(wanted) <= set(self.names):
            return None
        return self.outputs[:, [self.names.index(name) for name in wanted]]


def spread(outputs: np.ndarray) -> np.ndarray:
    """Largest minus least value (outputs,) of each output (N, outputs), without gaps."""
    result: np.ndarray = np.nanmax(outputs, axis=0) - np.nanmin(outputs, axis=0)
    return result


def at_stops(model: SoftModel, joints: np.ndarray) -> np.ndarray:
    """Whether each joint (N, n) is so near a stop that the stop may push it.

    `joints` are smoothed angles, because noise could hide or feign a stop. A joint reaches and
    leaves a stop between samples, so the two neighbours of a sample at a stop count too.
    """
    close = Stops.of(model).near(joints, NEAR)
    wide = close.copy()
    wide[1:] |= close[:-1]
    wide[:-1] |= close[1:]
    return wide


def stretches(stops: np.ndarray) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Joints to hold at their stops, and the stretches in which only these are at a stop.

    A stop acts on all joints through the inertia. A sample is therefore useful only if all held
    joints and no free ones are at a stop. A held joint gives no information about itself, so few
    joints are held: those that are most often at a stop. Their number is the smallest one whose
    stretches of at least `SHORTEST` samples cover `ENOUGH` of the data. If there is none, it is the
    number that leaves the most samples of free joints.

    Parameters
    ----------
    stops : ndarray of bool, (N, n)
        The result of `at_stops`.

    Returns
    -------
    held : ndarray of bool, (n,)
    stretches : list of (begin, end)
        Empty if every joint is always at a stop.
    """
    shortest = min(SHORTEST, len(stops))
    order = np.argsort(-stops.mean(0), kind="stable")
    pressed = minimum_filter1d(stops, 2 * PRESSED + 1, axis=0, mode="nearest")
    best: tuple[int, np.ndarray, list[tuple[int, int]]] = (0, np.ones(stops.shape[1], bool), [])
    for count in range(stops.shape[1]):
        held = np.zeros(stops.shape[1], bool)
        held[order[:count]] = True
        fits = ~stops[:, ~held].any(1) & pressed[:, held].all(1)
        good = np.concatenate(([False], fits, [False])).astype(int)
        begins, ends = np.flatnonzero(np.diff(good) == 1), np.flatnonzero(np.diff(good) == -1)
        runs = [(int(b), int(e)) for b, e in zip(begins, ends, strict=True) if e - b >= shortest]
        total = sum(end - begin for begin, end in runs)
        if total >= ENOUGH * len(stops):
            return held, runs
        samples = total * int((~held).sum())
        if samples > best[0]:
            best = (samples, held, runs)
    return best[1], best[2]


def unwound(where: str, angles: np.ndarray) -> np.ndarray:
    """Angles (N,) of a joint that turns without end, without the jumps of an encoder by 2 pi.

    Angles within one turn that jump by more than a half of one are taken as wrapped.

    Raises
    ------
    InputError
        For wrapped angles so far apart that the number of turns between rows is unknown.
    """
    if np.ptp(angles) > 2 * np.pi + ROUNDED or not (np.abs(np.diff(angles)) > np.pi).any():
        return angles
    found: np.ndarray = np.unwrap(angles)
    most = float(np.abs(np.diff(found)).max())
    if most > TURNED:
        raise InputError(where, "less than a quarter of a turn between rows", f"{most:.3g} rad")
    return found


def _angles(path: str | Path, name: str, cosine: np.ndarray, sine: np.ndarray) -> np.ndarray:
    """The angles (N,) of points (N,) on the unit circle, in one turn."""
    size = np.hypot(cosine, sine)
    off = np.flatnonzero(np.abs(size - 1) > ROUND)
    if off.size:
        k = int(off[0])
        expected = "with the column of the sine a point on the unit circle"
        raise InputError(f"{path}: column {name}", expected, f"{cosine[k]:g} and {sine[k]:g}")
    found: np.ndarray = np.arctan2(sine, cosine)
    return found


def gaps(data: Measurements) -> np.ndarray:
    """The rows (k,) behind which rows are lost and the input is another one afterwards.

    An input is held from its row to the next. In a gap it is unknown when it changed.
    """
    interval = np.diff(data.t)
    lost = interval > LOST * np.median(interval)
    return np.flatnonzero(lost & (np.diff(data.u, axis=0) != 0).any(1))


def cut(
    runs: Sequence[tuple[int, int]], after: np.ndarray, shortest: int = SHORTEST
) -> list[tuple[int, int]]:
    """The runs, cut behind the rows `after`; parts of fewer samples than `shortest` are left out.

    If no part is long enough, the runs stay whole.
    """
    parts = []
    for begin, end in runs:
        inside = [int(k) + 1 for k in after if begin <= k < end - 1]
        parts += list(pairwise([begin, *inside, end]))
    return [one for one in parts if one[1] - one[0] >= shortest] or list(runs)


def output_names(model: SoftModel) -> tuple[str, ...]:
    """Names of all outputs that can be measured of a robot."""
    check_model(model)
    return (
        *(f"q.{name}" for name in model.joint_names), *(f"tip.{axis}" for axis in AXES),
        *(f"length.{name}" for name in model.tendons.names),
        *(PREFIX[sensor.kind] + name for sensor in model.robot.sensors
          if sensor.kind in PREFIX for name in sensor.reading_names),
        *(READ + name for name in layout_of(model.robot).names),
    )  # fmt: skip


def check_data(model: SoftModel, data: Measurements) -> None:
    """Refuse data of another robot.

    Raises
    ------
    InputError
        For another number of inputs, inputs far beyond the file's bounds, outputs that the robot
        does not have, and a tip far beyond its length.
    """
    if data.u.shape[1] != model.nu:
        raise InputError("data", f"{model.nu} inputs, as {model.name!r} has", data.u.shape[1])
    known = output_names(model)
    for name in data.names:
        if name not in known:
            raise InputError("data", f"outputs of {model.name!r}", did_you_mean(name, known))
    most = AWAY * model.robot.length or math.inf
    tips = np.array([name.startswith("tip.") for name in data.names], bool)
    for k, j in np.argwhere(tips & (np.abs(data.outputs) > most))[:1]:
        within = f"metres, for a robot of {model.robot.length:.3g} m"
        got = f"{data.outputs[k, j]:g} at t = {data.t[k]:g} s: millimetres?"
        raise InputError(data.names[j], within, got)
    room = BEYOND * (model.u_max - model.u_min)
    beyond = (data.u < model.u_min - room) | (data.u > model.u_max + room)
    for k, j in np.argwhere(beyond)[:1]:
        low, high, most = model.u_min[j], model.u_max[j], np.abs(data.u[:, j]).max()
        far = most > FAR * max(abs(low), abs(high))
        raise InputError(
            f"u.{model.robot.actuators[j].name}",
            f"{low:g} to {high:g}, the bounds in the robot's file",
            f"{data.u[k, j]:g} at t = {data.t[k]:g} s: another unit"
            + (", such as grams or mN?" if far else "?"),
        )


def csv_text(data: Measurements, model: SoftModel) -> str:
    """The text of a CSV file from which `read_csv` reads these measurements again.

    A number has all its digits, and a gap is an empty cell.

    Raises
    ------
    InputError
        Data of another robot.
    """
    check_data(model, data)
    inputs = [actuator.name for actuator in model.robot.actuators]
    titles = ["t (s)", *(f"u.{name}" for name in inputs), *data.names]
    parts = [data.t[:, None], data.u, data.outputs]
    if data.direction is not None:
        titles += [f"direction.{name}" for name in inputs]
        parts.append(data.direction)
    written = io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    table.writerow(titles)
    for row in np.hstack(parts).tolist():
        table.writerow("" if math.isnan(value) else value for value in row)
    return written.getvalue()


def read_csv(
    path: str | Path, model: SoftModel, *, static: bool = False, outputs: Sequence[str] = ()
) -> Measurements:
    """Measurements from a CSV file whose header names the columns.

    ``direction.INPUT`` of static rows is the last direction of motion, see `Measurements`.
    The columns are ``t`` in seconds, ``u.NAME`` for every input, and any of ``q.JOINT`` (rad, m),
    ``tip.x``, ``tip.y``, ``tip.z``, ``length.TENDON``, ``point.MARKER.x`` (m) and
    ``measured.SENSOR``. A continuous joint may have ``q.JOINT.cos`` and ``q.JOINT.sin`` instead, as
    in a log, or wrapped angles. An empty cell is a gap. The log of a rig has ``acting.NAME`` too;
    the mean of two rows is then the input between them, if a motor changed what was asked for.

    Parameters
    ----------
    path : str or Path
        The file.
    model : SoftModel
        The robot whose joints, tendons, inputs and sensors it names.
    static : bool
        Whether each row is an equilibrium. ``t`` may then be missing.
    outputs : sequence of str
        Beginnings of the outputs to read, such as ``measured.``; by default all.

    Raises
    ------
    InputError
        A file that cannot be read, an unknown, missing or doubled column, a cell that is no finite
        number, angles in degrees, times in milliseconds, inputs beyond the file's bounds.
    """
    static = flag("static", static)
    turning = {
        f"q.{one.name}": (f"q.{one.name}.cos", f"q.{one.name}.sin")
        for one in check_model(model).robot.moving_joints if one.kind == "continuous"
    }  # fmt: skip
    inputs = tuple(f"u.{actuator.name}" for actuator in check_model(model).robot.actuators)
    ways = tuple(name.replace("u.", "direction.", 1) for name in inputs) if static else ()
    known = ("t", *inputs, *output_names(model))
    file = CsvTable(path)
    acting = tuple(name.replace("u.", "acting.", 1) for name in inputs)
    acting = acting if set(acting) <= set(file.names) else ()
    chosen = tuple(instances("outputs", outputs, str, "the beginning of an output's name"))
    optional = "" if LOG in file.names else READ  # these may be unknown
    pairs = {one: pair for one, pair in turning.items() if set(pair) <= set(file.names)}
    circles = tuple(name for pair in pairs.values() for name in pair)
    readable = {*known, *circles}
    header = [
        name for name in file.names
        if name in acting or not (
            name.startswith(BESIDE) or (name.startswith(optional) and name not in readable)
            or (chosen and name in {*output_names(model), *circles} and not name.startswith(chosen))
        )
    ]  # fmt: skip
    for name in header:
        if name not in (*readable, *ways, *acting):
            expected = "t, u.INPUT, q.JOINT, tip.x, tip.y, tip.z, length.TENDON, point.MARKER.x,"
            expected += " pose.MARKER.rx or measured.SENSOR, of this robot and its markers"
            raise InputError(f"{path}: header", expected, did_you_mean(name, known))
    timed = not static or "t" in header
    file.once(("t", *inputs) if timed else inputs)
    table = file.numbers(header, GAPS)
    column = {name: table[:, k] for k, name in enumerate(header)} if len(table) else {}
    for name, (cosine, sine) in pairs.items():
        if cosine in column and name not in column:
            column[name] = _angles(path, cosine, column.pop(cosine), column.pop(sine))
    for name in turning.keys() & column.keys():
        column[name] = unwound(f"{path}: column {name}", column[name])
    names = tuple(name for name in known[1 + len(inputs) :] if name in column)
    if not names or not column:
        expected = "rows, and a column of q.JOINT, tip.x, length.TENDON or point.MARKER.x"
        raise InputError(str(path), expected, f"{len(table)} rows of {', '.join(header)}")
    revolute = [joint for joint in model.robot.moving_joints if joint.kind == "revolute"]
    for joint in revolute:
        angles = column.get(f"q.{joint.name}", np.zeros(1))
        most = float(angles[np.argmax(np.abs(angles))])
        if in_degrees(most, joint.lower, joint.upper):
            expected = f"radians, from {joint.lower:g} to {joint.upper:g}"
            raise InputError(f"{path}: column q.{joint.name}", expected, f"{most:g}: degrees?")
    turning_sensors = [one for one in model.robot.sensors if one.kind.form.turns]
    for name in (
        *(f"q.{joint.name}" for joint in revolute),
        *(READ + name for one in turning_sensors for name in one.reading_names),
    ):
        angles = column.get(name, np.zeros(1))
        jumps = np.flatnonzero(np.abs(np.abs(np.diff(angles)) - 2 * np.pi) < TURNED)
        if jumps.size:
            k = int(jumps[0])
            got = f"{angles[k]:g}, then {angles[k + 1]:g}: wrapped by 2 pi?"
            raise InputError(f"{path}: column {name}", "an angle without jumps", got)
    u, values, forces = (
        np.stack([column[name] for name in some], 1) if some else np.zeros((len(table), 0))
        for some in (inputs, names, acting)
    )
    if acting and not np.array_equal(forces[1:], u[:-1]):
        u = (forces + np.vstack((forces[1:], forces[-1:]))) / 2
    with errors_in(str(path)):
        times = column["t"] if timed else np.arange(float(len(table)))
        way = None
        if any(name in column for name in ways):
            file.once(ways)
            way = np.stack([column[name] for name in ways], 1)
        data = Measurements(times, u, names, values, way)
        check_data(model, data)
    step = float(np.median(np.diff(data.t)))
    if step >= SLOW and "t (s)" not in file.titles and not static:
        expected = f"seconds, or the title t (s) where samples are {step:g} s apart"
        raise InputError(f"{path}: column t", expected, f"steps of {step:g}: milliseconds?")
    return data
