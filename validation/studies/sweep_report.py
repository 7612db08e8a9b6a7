"""A sweep's results: every case as CSV, the best cases as Markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from softdyn.validation.files import write_text
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.loop.metrics import CM
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import Distribution, notes, pivot
from softdyn.validation.studies.engine.store import OUTCOMES, Store
from softdyn.validation.studies.engine.worker import CaseJob
from softdyn.validation.studies.study_targets import nearest_stable
from softdyn.validation.studies.sweep import (
    EMPTY,
    FIGURES,
    SENSORS,
    SHARE,
    Sweep,
    parameter,
    place,
)
from softdyn.validation.tables import Table, document, inline

BEST = 10
REST = "stable equilibrium"  # in the place of a controller
SHOWN_REASONS = 20
RESULTS = (
    "outcome", *FIGURES, "period_s", "timestep_s", "settling_time_s", "overshoot",
    "input_effort", "input_change_percent",
    "steps", "simulated_s",
    "not_solved", "fallbacks", "max_bound_violation", "reason",
)  # fmt: skip
UNITS = {
    "gains.Kp": "1/s²", "gains.eps": "s", "gains.null_damping": "1/s",
    "run.period": "s", "run.duration": "s", "run.timestep": "s",
    "plant.dry_friction": "N m or N", "plant.payload": "kg",
    "rig.delay": "s", "rig.lag": "s", "rig.latency": "s", "rig.noise": "m", "rig.bias": "m",
    "gains.horizon": "s", "gains.lag": "s", "gains.delay": "s",
    "rig.stiffness": "N/m", "rig.damping": "N s/m",
    "theta": "π rad", "omega": "π rad/s",
}  # fmt: skip
SYMBOLS = {"theta": "θ", "omega": "ω"}
TITLES = {f"gains.{SHARE}": "τ / ε", "gains.horizon": "τ", "run.period": "period"}

Row = tuple[Case, dict[str, Any]]


@dataclass(frozen=True)
class Setting:
    """A robot, a controller and its parameters, with all targets.

    Attributes
    ----------
    rows : tuple of Row
        Its cases with their results.
    mean, worst : float, optional
        Mean and largest figure over them; None when a case has none.
    """

    rows: tuple[Row, ...]
    mean: float | None
    worst: float | None

    @property
    def case(self) -> Case:
        """One of the cases; they differ only in their targets."""
        return self.rows[0][0]

    @property
    def failed(self) -> int:
        """The number of its cases that failed or ended in an error."""
        return sum(result["outcome"] != "done" for _, result in self.rows)


def sweep_rows(jobs: Iterable[CaseJob], store: Store) -> list[Row]:
    """Cases with their results, in the sweep's order; cases that never ran are left out.

    A result has the case's ``step_us`` if the store keeps step times.
    """
    found = ((j, store.figures(j.case, j.name) if j.log else store.result(j.name)) for j in jobs)
    return [
        (job.case, result | ({"step_us": store.step_times(job.name)} if store.times else {}))
        for job, result in found
        if result is not None
    ]


def settings(found: Iterable[Row], figure: str) -> list[Setting]:
    """Groups of cases that differ only in their targets, the best first.

    The number of failed cases ranks before the mean, because the figure of a failed run says
    little.
    """
    groups: dict[str, list[Row]] = {}
    for case, result in found:
        groups.setdefault(_setting(case), []).append((case, result))
    made = []
    for group in groups.values():
        values = [result.get(figure) for _, result in group]
        numbers = [v for v in values if v is not None]
        whole = len(numbers) == len(values)
        mean = math.fsum(numbers) / len(numbers) if whole else None
        made.append(Setting(tuple(group), mean, max(numbers) if whole else None))
    return sorted(made, key=lambda s: (s.failed, math.inf if s.mean is None else s.mean))


def _setting(case: Case) -> str:
    """All of a case except its target."""
    found = case.inputs
    for name in ("kind", "target"):
        del found[name]
    return repr(found)


def plan(sweep: Sweep, jobs: Sequence[CaseJob], missing: Sequence[CaseJob]) -> dict[str, Any]:
    """The cases that will run, for JSON; of those with one fingerprint only one runs."""
    runs = {job.fingerprint: job for job in missing}.values()
    return {
        "sweep": str(sweep.path),
        "cases": len(jobs),
        "missing": len(runs),
        "simulated_s": sum(job.simulated for job in runs),
        "names": [job.name for job in jobs],
    }


def plan_text(plan: Mapping[str, Any]) -> str:
    """The plan as text."""
    run = f"{plan['missing']} of them to be run: {plan['simulated_s']:g} s of simulated time"
    return f"{plan['cases']} cases, {run}"


def write_sweep(
    sweep: Sweep, found: list[Row], folder: Path, table: str = "", picture: str = "",
    more: Mapping[str, str] | None = None,
) -> list[str]:  # fmt: skip
    """Write every case as CSV, and `table` or the best cases as Markdown; return the files.

    `picture` is the name of a figure beside them; `more` are further files by their names.
    """
    shown = f"![Every case]({picture})" if picture else ""
    text = to_markdown(sweep, found, table, shown)
    texts = {"sweep.csv": to_csv(sweep, found), "sweep.md": text, **(more or {})}
    for name, text in texts.items():
        write_text(folder / name, text)
    return [str(folder / name) for name in texts]


def report(sweep: Sweep, found: list[Row], ran: int) -> dict[str, Any]:
    """The figures of a sweep for JSON; `ran` of its cases ran in this call."""
    ended = Counter(result["outcome"] for _, result in found)
    total = len(sweep.cases)
    return {
        "sweep": str(sweep.path),
        "cases": total,
        "ran": ran,
        "kept": total - ran,
        "outcomes": {name: ended[name] for name in OUTCOMES},
        "figure": sweep.figure,
        "best": [
            {
                "file": _file(case),
                "outcome": result["outcome"],
                sweep.figure: result.get(sweep.figure),
                "inputs": result["inputs"],
            }
            for case, result in ranked(found, sweep.figure)
        ],
    }


def summary(report: Mapping[str, Any]) -> str:
    """The report as text."""
    ended = ", ".join(f"{n} {_words(name)}" for name, n in report["outcomes"].items() if n)
    figure = report["figure"]
    return "\n".join([
        f"{report['cases']} cases: {ended} ({report['ran']} run now, {report['wall_s']:.0f} s)",
        *(f"best   {row['file']}: {figure} {row[figure]:.4g}"
          for row in report["best"][:3] if row[figure] is not None),
    ])  # fmt: skip


def _words(outcome: str) -> str:
    return outcome.replace("_", " ")


# -- CSV -------------------------------------------------------------------------------------------


def to_csv(sweep: Sweep, found: list[Row]) -> str:
    """One line per case, in the sweep's order: inputs, outcome, figures, reason, file."""
    gains = dict.fromkeys(f"gains.{name}" for case, _ in found for name in case.parameters or {})
    names = dict.fromkeys(["theta", "omega", *gains, *sweep.parameters, "sample"])
    titles = ["robot", "controller", *(f"{n} (m)" for n in "xyz")]
    units = {name: unit_of(name, sweep.unitless) for name in names}
    titles += [f"{name} ({unit})" if unit else name for name, unit in units.items()]
    lines = []
    for case, result in found:
        point = parameter(case, "point") or (None, None, None)
        varied = [parameter(case, name) for name in names]
        seed = None if case.sample is None else sweep.seed
        figures = (result.get(name) for name in RESULTS)
        lines.append([case.robot, case.controller, *point, *varied, seed, *figures, _file(case)])
    return Table([*titles, "seed", *RESULTS, "file"], lines).csv()


def _file(case: Case) -> str:
    return f"cases/{case.name}.json"


# -- Markdown --------------------------------------------------------------------------------------


def to_markdown(sweep: Sweep, found: list[Row], table: str = "", shown: str = "") -> str:
    """Varying parameters, outcomes, `table` or each robot's best cases, reasons of failures.

    `shown` is a picture of them all, in Markdown.
    """
    blocks = [f"# Sweep {inline(sweep.path.name)}", _counts(found, len(sweep.cases))]
    blocks += ["\n".join(_varied(sweep)), shown, table]
    for robot in sweep.robots if not table else ():
        of_robot = [row for row in found if row[0].robot == robot]
        if of_robot:
            blocks += _best(sweep, robot, of_robot)
    return document(*blocks, *_reasons(sweep, found))


def cell_tables(sweep: Sweep, cells: Mapping[str, Distribution]) -> str:
    """Tables of all cells; with means, one table of final errors and one of trajectories."""
    asked = sweep.cells
    titles = [TITLES.get(name) or label(name, sweep.unitless) for name in sweep.rows]
    kinds = [("", {"set_point", "point", "tracking"})]
    if sweep.means:
        kinds = [("mean (cm)", {"set_point", "point"}), ("mean (cm²)", {"tracking"})]
    groups = [({k: c for k, c in cells.items() if k not in asked or asked[k].kind in some}, mean)
              for mean, some in kinds]  # fmt: skip
    parts = [pivot(_with_units(group), titles, mean) for group, mean in groups if group]
    return "\n\n".join(filter(None, [*parts, notes(cells)]))


def _with_units(cells: Mapping[str, Distribution]) -> dict[str, Distribution]:
    """The cells by labels whose last part, the title of a column, has the unit of the figures."""
    return {f"{label} ({'cm²' if '/ω' in label else 'cm'})": cell for label, cell in cells.items()}


def missed(sweep: Sweep, cells: Mapping[str, Distribution]) -> dict[str, Distribution]:
    """The nearest stable equilibria (cm) of the set points that were missed, as more cells.

    A set point is missed if the median of a cell is beyond the sweep's bound.
    """
    rows: dict[str, Distribution] = {}
    for robot in sweep.robots:
        goals = {}
        for label, cell in cells.items():
            case = sweep.cells[label]
            beyond = case.kind != "tracking" and cell.median > sweep.statics_beyond_cm
            if beyond and case.robot == robot:
                known = {"robot": label.split("/")[sweep.rows.index("robot")], "controller": REST}
                row = "/".join(known.get(name, "-") for name in sweep.rows)
                goal = case.experiment(sweep.models[robot]).reference(0.0).y
                goals[f"{row}/{label.rpartition('/')[2]}"] = goal
        found = nearest_stable(sweep.models[robot], goals) if goals else {}
        rows |= {label: Distribution(CM * distance) for label, distance in found.items()}
    return rows


def _counts(found: list[Row], total: int) -> str:
    ended = Counter(result["outcome"] for _, result in found)
    left = total - len(found)
    words = [f"{ended[name]} {_words(name)}" for name in sorted(ended)]
    return f"{total} cases: " + ", ".join(words + ([f"{left} without a result"] if left else []))


def _varied(sweep: Sweep) -> list[str]:
    lines = []
    # of the random factors of each joint, one stands for all
    by_robot = [axis for axis in sweep.axes if axis.robot is not None and place(axis.name)[2]]
    joints = {axis.name.rpartition(".")[0]: axis for axis in by_robot}
    each = (replace(axis, name=f"{name} of each joint") for name, axis in joints.items())
    for axis in (*sweep.targets, *sweep.varying(), *each):
        if axis.drawn:
            kind = axis.drawn.replace("_", "-")
            text = f"{len(axis.values)} {kind} samples, seed {sweep.seed}"
        elif len(axis.values) > 12:
            ends = [value_text(axis.values[k]) for k in (0, -1)]
            text = f"{len(axis.values)} values from {' to '.join(ends)}"
        else:
            text = ", ".join(value_text(value) for value in axis.values)
        lines.append(f"- {label(axis.name, sweep.unitless)}: {text}")
    return lines


def _best(sweep: Sweep, robot: str, found: list[Row]) -> list[str]:
    """The best cases of one robot and, over several targets, its best settings."""
    figure = FIGURES[sweep.figure]
    names = _columns(sweep)
    made = settings(found, sweep.figure)
    blocks = [f"## {inline(robot)}"]
    if any(len(setting.rows) > 1 for setting in made):
        lines = []
        for i, setting in enumerate(made[:BEST], 1):
            failed = f"{setting.failed} of {len(setting.rows)}"
            figures = map(value_text, (setting.mean, setting.worst))
            lines.append([i, *_inputs(setting.case, names), *figures, failed])
        table = Table(["", *names, f"mean {figure}", "worst", "failed"], lines)
        title = f"Best settings by the mean {figure} over their targets."
        blocks += [title, table.markdown()]
    lines = []
    for i, (case, result) in enumerate(ranked(found, sweep.figure), 1):
        ended = (value_text(result.get(sweep.figure)), _words(result["outcome"]))
        lines.append([i, *_inputs(case, names), _target(case), *ended, _file(case)])
    table = Table(["", *names, "target", figure, "outcome", "file"], lines)
    return [*blocks, f"Best cases by {figure}.", table.markdown()]


def ranked(found: Iterable[Row], figure: str) -> list[Row]:
    """The best cases, successful ones first; equal cases keep the sweep's order."""

    def rank(row: Row) -> tuple[bool, float]:
        value = row[1].get(figure)
        return row[1]["outcome"] != "done", math.inf if value is None else value

    return sorted(found, key=rank)[:BEST]


def _columns(sweep: Sweep) -> dict[str, str]:
    """Heading → parameter, for all varying parameters except robots and targets."""
    names = {"controller": "controller"} if len(sweep.controllers) > 1 else {}
    return names | {label(axis.name, sweep.unitless): axis.name for axis in sweep.varying()}


def _inputs(case: Case, names: dict[str, str]) -> list[str]:
    return [value_text(parameter(case, name)) for name in names.values()]


def _target(case: Case) -> str:
    unit = " rad/s" if case.kind == "tracking" else ""
    return cell_title(case.kind, case.value) + unit


def _reasons(sweep: Sweep, found: list[Row]) -> list[str]:
    """Reasons of failed cases, the first few of them literally."""
    failures = [(case, result) for case, result in found if result["outcome"] != "done"]
    if not failures:
        return []
    names = _columns(sweep)
    called = {c.name: name for name, c in sweep.cells.items()}
    parts = []
    for case, result in failures[:SHOWN_REASONS]:
        inputs = [f"{n} = {v}" for n, v in zip(names, _inputs(case, names), strict=True)]
        words = called.get(case.name) or ", ".join([case.robot, *inputs, _target(case)])
        parts.append(f"- {inline(words)}: {_words(result['outcome'])}, "
                     f"{inline(result['reason'])}")  # fmt: skip
    more = len(failures) - SHOWN_REASONS
    parts += [f"- and {more} more: see sweep.csv"] if more > 0 else []
    return ["## Failed cases", "\n".join(parts)]


def label(name: str, unitless: Collection[str] = ()) -> str:
    """A parameter with its unit, e.g. ``Kp (1/s²)``, if it is not `unitless`."""
    unit = unit_of(name, unitless)
    return f"{title_of(name)} ({unit})" if unit else title_of(name)


def title_of(name: str) -> str:
    """A parameter's name in texts."""
    return SYMBOLS.get(name, name.partition(".")[2] or name)


def unit_of(name: str, unitless: Collection[str] = ()) -> str:
    """The unit of a parameter; empty if it has none, or one that depends on the sensor."""
    if name in unitless:
        return ""
    _, key, path = place(name)
    if key == SENSORS:
        return {"latency": "s", "rate": "Hz"}.get(path[-1], "")
    return UNITS.get(name, "")


def value_text(value: Any) -> str:
    """A parameter's value, or a figure, in a table."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "(" + ", ".join(f"{x:g}" if isinstance(x, float) else str(x) for x in value) + ")"
    return f"{value:.4g}" if isinstance(value, float) else str(value) or EMPTY
