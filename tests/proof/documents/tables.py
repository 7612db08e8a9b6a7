"""The tables of the documents, written from the committed figures.

In a document a table lies between ``<!-- table NAME: written by tests/proof/tables.py -->`` and
``<!-- end of NAME -->``. Every figure comes from a file of ``measured`` beside this one or in
``validation/studies``, which a command made. So a figure is the same in all documents.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from softdyn import InputError
from softdyn.controllers import SoftIdClfQp
from softdyn.controllers.registry import in_table, label_of
from softdyn.validation.files import read_json, write_text
from softdyn.validation.identification.trials import SHOWN
from softdyn.validation.loop import setups
from softdyn.validation.loop.labels import ROBOTS, SYMBOLS, cell_title
from softdyn.validation.studies import benchmark, experiments
from softdyn.validation.studies.benchmark_table import spread
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import (
    NOTE,
    Agreement,
    Distribution,
    mean_and_std,
    notes,
    number,
    pivot,
    read_distributions,
)  # fmt: skip
from softdyn.validation.studies.sweep_report import REST
from softdyn.validation.tables import Table
from tests.proof import barrier_time, batches, episodes, loop_time, poses, weights
from tests.proof.documents.reports import reports_table
from tests.proof.documents.settings import MEASURED, changes_table, gains_table
from tests.proof.estimates import creep, forces
from tests.proof.paper import one_step
from tests.proof.safety import near_far, scenes
from tests.proof.timing.step_report import machine_text
from tests.support import public_reports

MARKED = re.compile(
    r"^<!-- table (?P<name>[\w-]+): written by tests/proof/tables\.py -->\n.*?"
    r"^<!-- end of (?P=name) -->$",
    re.M | re.S,
)
# A run equals the log if both print alike, differ by less than either of these, or are chaotic.
SAME_SHARE, SAME_CM = 0.01, 0.01
MISSED = 1.0  # cm: a set point that is missed by more gets its reason
LAW = SoftIdClfQp.name
ENGINES = ("reference, MuJoCo 3.2.7", "reference, 3.3.7", "emulated, 3.3.7", "emulated, 4.0.0")
VALUES = {"set_point": experiments.THETAS, "tracking": experiments.OMEGAS}
PAPER_ROBOTS = "finger", "helix", "spirob"
GRID = in_table()


def fill(text: str) -> str:
    """A document with up-to-date tables.

    Raises
    ------
    InputError
        A table has an unknown name.
    """

    def written(found: re.Match[str]) -> str:
        name = found["name"]
        if name not in TABLES:
            raise InputError("table", f"one of {', '.join(TABLES)}", name)
        begin, *_, end = found[0].splitlines()
        return f"{begin}\n{TABLES[name]().strip()}\n{end}"

    return MARKED.sub(written, text)


def write(paths: Iterable[Path], check: bool = False) -> list[Path]:
    """Write the tables of these documents; return the documents that were out of date.

    Parameters
    ----------
    paths : iterable of Path
    check : bool
        Whether to leave the files as they are.
    """
    stale = []
    for path in paths:
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise InputError(str(path), "a document", error.strerror) from None
        if (new := fill(text)) != text:
            stale.append(path)
            if not check:
                write_text(path, new)
    return stale


@cache
def _cells(name: str) -> dict[str, Distribution]:
    return read_distributions(MEASURED / f"{name}.json")


@cache
def _rows(name: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = read_json(MEASURED / f"{name}.json", "rows of a table")["rows"]
    return rows


def _loop_time() -> str:
    if not (file := MEASURED / "loop_time.json").exists():
        return "*Not measured yet on an idle machine.*"
    found = read_json(file, "rows of a table")
    table = Table.of(loop_time.COLUMNS, found["rows"]).markdown()
    return f"{machine_text(found['machine'])}\n\n{table}"


def _grid(robot: str, controller: str, kind: str) -> list[Distribution]:
    """A row of the paper's grid."""
    cells = benchmark.committed()
    return [cells[benchmark.label(Case(robot, controller, kind, x))] for x in VALUES[kind]]


def _noted(table: str) -> str:
    return f"{table}\n\n{NOTE}"


def _benchmark() -> str:
    titles = [
        "robot", "controller", "SP (cm)", "SP, paper", "SP, emulated", "TT (cm²)", "TT, paper",
        "TT, emulated",
    ]  # fmt: skip
    lines = []
    for robot in PAPER_ROBOTS:
        for controller in GRID:
            line: list[str | None] = [robot, label_of(controller)]
            theirs = experiments.published(robot, controller)
            again = benchmark.emulated(robot, controller)
            for kind, (short, unit, *_) in benchmark.KINDS.items():
                mean, std = mean_and_std(_grid(robot, controller, kind))
                keys = f"{short}_mean_{unit}", f"{short}_std_{unit}"
                line.append(mean.text(std))
                pair = (getattr(theirs, key, None) for key in keys)
                line.append(None if theirs is None else experiments.spread(*pair))
                line.append(None if again is None else spread(again, *keys))
            lines.append(line)
    return _noted(Table(titles, lines).markdown())


def _runs(controllers: Iterable[str]) -> str:
    titles = [cell_title(kind, x) for kind, values in VALUES.items() for x in values]
    lines = []
    for robot in PAPER_ROBOTS:
        for controller in controllers:
            found = [cell.text() for kind in SYMBOLS for cell in _grid(robot, controller, kind)]
            lines.append([robot, label_of(controller), *found])
    return Table(["robot", "controller", *titles], lines).markdown()


def _every_run() -> str:
    return _runs(GRID)


def _seeds() -> str:
    found = Agreement.of(benchmark.committed())
    counts = zip(*(map(len, cell.seeds.values()) for cell in found.cells.values()), strict=True)
    runs = [f"{min(n)} to {max(n)}" if min(n) < max(n) else min(n) for n in counts]
    titles = ["cells", "runs of seed 1", "of seed 2", "ranges apart", "p below 5 %", "by chance"]
    apart = [len(found.disjoint), len(found.apart), f"up to {found.allowed}"]
    return Table(titles, [[len(found.cells), *runs, *apart]]).markdown()


def _hard() -> str:
    return _runs(("id-clf-qp",))


def _beyond(controller: str) -> str:
    """Set points at several periods and trajectories of a controller and of the published one."""
    own = {k: c for k, c in _cells("beyond").items() if k.split("/")[1] == controller}
    for robot in PAPER_ROBOTS:
        published = f"{1e3 * setups.setup(robot).period:g} ms"
        for name in (controller, LAW):
            if name not in GRID:
                continue
            for kind, values in VALUES.items():
                for value, cell in zip(values, _grid(robot, name, kind), strict=True):
                    own[f"{robot}/{name}/{published}/{cell_title(kind, value)}"] = cell
    ordered = sorted(own, key=lambda label: _place(label, controller))
    parts = []
    for symbol, mean in zip(SYMBOLS.values(), ("mean (cm)", "mean (cm²)"), strict=True):
        mine = {label: own[label] for label in ordered if f"/{symbol} = " in label}
        parts += [pivot(mine, ["robot", "controller", "period"], mean)] if mine else []
    return "\n\n".join(filter(None, [*parts, notes(own)]))


def _place(label: str, first: str) -> tuple[int, bool, float]:
    robot, controller, period, _ = label.split("/")
    return list(ROBOTS).index(robot), controller != first, float(period.split()[0])


def _table(cells: Mapping[str, Distribution], titles: list[str]) -> str:
    """A table with one line of each of its marks."""
    return "\n\n".join(filter(None, [pivot(cells, titles), notes(cells)]))


def _robustness() -> str:
    """A row for each change, a column for each robot and target."""
    cells = {}
    for label, cell in {**_cells("robustness"), **_cells("noise")}.items():
        robot, _, change, target = label.split("/")
        cells[f"{change}/{robot} {target}"] = cell
    return _table(cells, ["change"])


def _reference_plant() -> str:
    """The published controller and `best` on the reference's targets, sampling and plant."""
    cells = {label.partition("/")[2]: cell for label, cell in _cells("there").items()}
    return _table(cells, ["robot", "controller"])


def _set_points() -> str:
    """A row for each set point, a column for each period, and what statics says of a miss."""
    cells = _cells("set_points")
    rows: dict[str, dict[str, Distribution]] = {}
    for label, cell in cells.items():
        _, name, period, target = label.split("/")
        rows.setdefault(target, {})[REST if name == REST else period] = cell
    found: dict[str, Distribution] = {}
    for target, row in rows.items():
        rest, runs = row.pop(REST, None), row.values()
        found |= {f"{target}/{period}": cell for period, cell in row.items()}
        if rest is not None and max(cell.median for cell in runs) > MISSED:
            found[f"{target}/nearest {REST}"] = rest
    return _table(found, ["SpiRob"])


def _points(name: str) -> str:
    """The set points of each robot by their number, because each robot has its own."""
    cells = _cells(name)
    points: dict[str, dict[str, int]] = {}
    found = {}
    for label, cell in cells.items():
        robot, name, change, point = label.split("/")
        of_robot = points.setdefault(robot, {})
        number_ = of_robot.setdefault(point, len(of_robot) + 1)
        found[f"{robot.partition('_urdf')[0]}/{name}/{change}/point {number_} (cm)"] = cell
    return _table(found, ["robot", "controller", "change"])


def _hold() -> str:
    cells = dict(_cells("hold"))
    for label in cells:
        robot, share, _, column = label.split("/")
        if share == "0":  # the published controller
            cells[label] = benchmark.committed()[f"{robot}/{LAW}/{column}"]
    return _table(cells, ["robot", "τ / ε", "τ"])


def _one_step() -> str:
    return Table.of(one_step.COLUMNS, _rows("one_step")).markdown()


def _statics() -> str:
    """Equilibria of the tip near the set points, found by `scripts/statics.py`."""
    titles = ["robot", "θ", "closest (cm)", "stable", "λ", "s (1/s)", "drift (cm)", "u",
              "closest stable (cm)", "λ", "drift (cm)", "law (cm)"]  # fmt: skip
    lines = []
    for row in _rows("statics"):
        cell = f"{row['robot']}/{LAW}/{cell_title('set_point', row['theta'])}"
        near, stable = row["closest"], row["closest_stable"]  # none where the closest is stable
        keys = ("eigenvalue", "pole", "drift_cm")
        lines.append([
            row["robot"], f"{row['theta']:g}π", number(near["distance_cm"]),
            "yes" if near["stable"] else "no", *(f"{near[key]:.2g}" for key in keys),
            ", ".join(f"{x:z.2f}" for x in near["u"]),
            *([None] * 3 if stable is None else
              [number(stable["distance_cm"]), *(f"{stable[key]:.2g}" for key in keys[::2])]),
            benchmark.committed()[cell].text(),
        ])  # fmt: skip
    return _noted(Table(titles, lines).markdown())


def _identification() -> str:
    """The identification of twins, as `tests/proof/twins.py` measured it."""
    shown = [("`softdyn identify …`", "case", ""), *SHOWN]
    rows = [{**row, "case": f"`{row['case']}`"} for row in _rows("identification")]
    return Table.of(shown, rows).markdown()


def _published() -> str:
    """Each published cell: the logs behind its mean, and the same runs by the emulation."""
    titles = ["cell", "published", "commit", "its logs", "emulated", "experiment", "same"]
    lines = []
    for cell in benchmark.published_cells():
        made = benchmark.emulation(cell)
        emulated = list(made.values())
        runs = [one for one in emulated if one is not None]
        logs = cell["logs"] or [None] * len(cell["columns"])
        known = [f"{x:.2f}" if x is not None else "-" for x in logs] if cell["logs"] else ["none"]
        mean = ""
        if len(runs) == len(emulated):
            average, std = mean_and_std(runs)
            if math.isfinite(average.median):
                mean = f" → {average.median:.2f} ± {std.median:.2f}"
        lines.append([
            cell["title"], cell["published"], cell["commit"], ", ".join(known),
            ", ".join("-" if one is None else one.text() for one in emulated) + mean,
            ", ".join(f"`{name}`" for name in dict.fromkeys(label.split("/")[0] for label in made)),
            verdict(cell["published"], cell["logs"], emulated),
        ])  # fmt: skip
    return _noted(Table(titles, lines).markdown())


def _engines() -> str:
    """The helix' trajectories by engine, for the reference implementation and for ours."""
    lines = []
    for row in _rows("engines"):
        lines.append([
            label_of(row["controller"]), f"{row['omega']:g}π", f"{row['log']:.2f}",
            *(None if row[name] is None else " to ".join(f"{x:.2f}" for x in row[name])
              for name in ENGINES),
        ])  # fmt: skip
    return Table(["controller", "ω", "its log", *ENGINES], lines).markdown()


def verdict(
    published: str, logs: list[float | None] | None, runs: list[Distribution | None]
) -> str:
    """Whether runs equal their logs: ✓, or the number that do and the distance of the others.

    A run equals its log if they differ by at most 1 % or 0.01 (cm, cm²). A chaotic run equals its
    log if the log lies in its range. Without logs, the published mean and deviation are compared
    with the runs' in the same way, and a published failure with failures.
    """
    whole = [run for run in runs if run is not None]
    if published == "failed":
        if len(whole) < len(runs):
            return "not run"
        failures = sum(run.failed.get("nominal", 0) for run in whole)
        return "✓" if failures == len(runs) else f"{failures} of {len(runs)} fail"
    if not logs:
        if len(whole) < len(runs):
            return "no log, not run"
        theirs = zip(map(float, published.split(" ± ")), mean_and_std(whole), strict=True)
        far = _far([(x, ours) for x, ours in theirs if not _same(x, ours)])
        return f"no log, {far} apart" if far else "✓, no log"
    pairs = [(x, run) for x, run in zip(logs, runs, strict=True) if x is not None and run]
    others = [(x, run) for x, run in pairs if not _same(x, run)]
    if not others and len(pairs) == len(logs):
        return "✓"
    far = f", others within {_far(others)}" if others else ""
    return f"{len(pairs) - len(others)} of {len(logs)}{far}"


def _far(pairs: list[tuple[float, Distribution]]) -> str:
    """The largest distance, relative to the log; absolute if it exceeds the log itself."""
    if not pairs:
        return ""
    share = max(abs(run.median - x) / x for x, run in pairs)
    return f"{100 * share:.0f} %" if share < 1 else number(max(abs(r.median - x) for x, r in pairs))


def _same(log: float, run: Distribution) -> bool:
    near = abs(run.nominal - log) <= max(SAME_SHARE * log, SAME_CM)
    return near or (run.moves and run.range[0] <= log <= run.range[1])


TABLES: Mapping[str, Callable[[], str]] = {
    "benchmark": _benchmark,
    "every-run": _every_run,
    "seeds": _seeds,
    "hard": _hard,
    "published": _published,
    "engines": _engines,
    "one-step": _one_step,
    "changes": changes_table,
    "gains": gains_table,
    "identification": _identification,
    "poses": lambda: poses.table(_rows("poses")),
    "best": lambda: _beyond("best"),
    "mpc": lambda: _beyond("mpc"),
    "robustness": _robustness,
    "set-points": _set_points,
    "unseen": lambda: _points("unseen"),
    "rigs": lambda: _points("rigs"),
    "friction": lambda: _points("friction"),
    "reference-plant": _reference_plant,
    "hold": _hold,
    "statics": _statics,
    "creep": lambda: Table.of(creep.COLUMNS, _rows("creep")).markdown(),
    "forces": lambda: Table.of(forces.COLUMNS, _rows("forces")).markdown(),
    "scenes": lambda: Table.of(scenes.COLUMNS, _rows("scenes")).markdown(),
    "near-far": lambda: Table.of(near_far.COLUMNS, _rows("near_far")).markdown(),
    "barriers": lambda: Table.of(barrier_time.COLUMNS, _rows("barriers")).markdown(),
    "loop-time": _loop_time,
    "weights": lambda: Table.of(weights.COLUMNS, _rows("weights")).markdown(),
    "batches": lambda: Table.of(batches.COLUMNS, _rows("batches")).markdown(),
    "batches-gpu": lambda: Table.of(batches.SPEED, batches.speeds(_rows("batches_gpu"))).markdown(),
    "batches-beside": lambda: Table.of(
        batches.BESIDE, batches.beside(_rows("batches_gpu"))
    ).markdown(),
    "episodes": lambda: Table.of(episodes.COLUMNS, _rows("episodes")).markdown(),
    "reports-right": lambda: reports_table(public_reports.RIGHT),
    "reports-mended": lambda: reports_table(public_reports.MENDED),
    "reports-beside": lambda: reports_table(public_reports.BESIDE),
}
