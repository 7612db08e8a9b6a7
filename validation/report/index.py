"""The page of a benchmark's results, where every picture links to a replay.

The benchmark's folder gets ``index.html``, ``replays/ROBOT/CONTROLLER.html`` with all runs of a
pair, their common ``replays/meshcat.js``, and ``thumbnails/``. All pages open from the file system
without a network.
"""

from __future__ import annotations

import re
import shlex
import shutil
import sys
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from tqdm.auto import tqdm

from softdyn import InputError
from softdyn.validation.files import safe_filename, write_text
from softdyn.validation.loop.labels import controller_title, experiment_title, robot_title
from softdyn.validation.loop.log import Log
from softdyn.validation.processes import in_processes
from softdyn.validation.report.document_page import document_page, picture, wide
from softdyn.validation.studies import benchmark
from softdyn.validation.studies.benchmark_table import (
    EMULATED,
    TITLES,
    benchmark_cells,
    benchmark_table,
    emulations,
    every_run_table,
)
from softdyn.validation.studies.engine.case import Case, number_text
from softdyn.validation.studies.engine.distribution import NOTE
from softdyn.view.page import library_file

PAGE = "index.html"
REPLAYS, THUMBNAILS, LIBRARY = "replays", "thumbnails", "meshcat.js"
RATE = 20.0  # frames per second of the replays, few because a benchmark has 162 runs
FIGURES = {
    "tracking": "The tip along the ellipse",
    "convergence_": "The tip from rest to each set point",
    "error_set_points": "Final errors of the set points",
    "error_trajectories": "Mean squared errors of the trajectories",
    "lyapunov_set_points": "Lyapunov function, set points",
    "lyapunov_trajectories": "Lyapunov function, trajectories",
    "inputs": "Inputs",
}
CODE, INSIDE = re.compile(r"`(.+?)`"), r"<code>\1</code>"  # of Markdown, of HTML
SHOWN = 0.5  # the set point in the thumbnails, in multiples of π

STYLE = """\
th:nth-child(2), td:nth-child(2) { text-align: left; }
.grid { display: grid; gap: 10px; grid-template-columns: repeat(auto-fill, minmax(165px, 1fr)); }
.grid a { display: block; padding: 8px; border: 1px solid var(--line); border-radius: 8px;
  background: var(--card); color: inherit; text-decoration: none; }
.grid a:hover, .grid a:focus { border-color: var(--link); }
.grid img { width: 100%; height: auto; display: block; border-radius: 4px;
  background: linear-gradient(#fbfdff, #dfe6ef); }
.grid b { display: block; margin-top: 6px; font-weight: 600; }
.grid span { display: block; font-size: 13px; color: var(--quiet); }
.grid .bad { color: var(--bad); }
"""


def make(cases: Iterable[Case], folder: Path, jobs: int = -1) -> Path:
    """Write the page, its replays and its pictures from the files of the cases.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        When a result or a log is missing or damaged.
    """
    cases = list(dict.fromkeys(cases))
    rows = benchmark.benchmark_rows(cases, folder, benchmark.committed())
    groups: dict[tuple[str, str], list[Case]] = {}
    for case in cases:
        groups.setdefault((case.robot, case.controller), []).append(case)
    for kind in (REPLAYS, THUMBNAILS):
        for robot in dict.fromkeys(case.robot for case in cases):
            (folder / kind / safe_filename(robot)).mkdir(parents=True, exist_ok=True)
    shutil.copyfile(library_file(), folder / REPLAYS / LIBRARY)
    calls = [(group, folder) for group in groups.values()]
    versions: dict[str, str] = {}
    with tqdm(total=len(calls), disable=None, leave=False, desc="replays") as bar:
        for found in in_processes(draw, calls, jobs):
            versions |= found
            bar.update()
    write_text(folder / PAGE, html(rows, groups, folder, versions))
    return folder / PAGE


def draw_all(cases: Sequence[Case], folder: Path, jobs: int = -1) -> dict[str, Any]:
    """Figures and page, from the files below a benchmark's folder alone.

    Returns
    -------
    dict
        ``figures``: the files of the figures. ``report``: the page, if the figures of merit, which
        it shows too, lie beside the logs.

    Raises
    ------
    InputError
        When logs are missing or damaged.
    """
    from softdyn.validation.report import plots

    store = benchmark.store(folder)
    missing = [case.name for case in cases if not store.log_path(case.name).is_file()]
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        got = f"no log of {', '.join(missing[:3])}{more}"
        raise InputError(str(folder), f"the logs of all {len(cases)} runs", got)
    drawn: dict[str, Any] = {"figures": [str(file) for file in plots.make_all(cases, folder)]}
    if all(store.result(case.name) is not None for case in cases):
        drawn["report"] = str(make(cases, folder, jobs))
    return drawn


def draw(cases: Sequence[Case], folder: Path) -> dict[str, str]:
    """Write replay and thumbnail of a robot with a controller; return the runs' versions."""
    from softdyn.validation.loop.pictures.replay import replays
    from softdyn.validation.report.thumbnail import thumbnail
    from softdyn.view.scene import Figure

    store = benchmark.store(folder)
    logs = [Log.load(store.log_path(case.name)) for case in cases]
    model = logs[0].source.model()  # from the log, as the robot's file may have changed
    name = f"{robot_title(cases[0].robot)}, {controller_title(cases[0].controller)}"
    page = replays(logs, model, name, RATE).html(f"../{LIBRARY}")
    write_text(folder / replay_path(cases[0]), page)
    shown = logs[chosen(cases)]
    thumbnail(shown, Figure.of(model), folder / thumbnail_path(cases[0]))
    return logs[0].versions


def chosen(cases: Sequence[Case]) -> int:
    """Index of the case that the thumbnail shows."""
    found = [i for i, c in enumerate(cases) if (c.kind, c.value) == ("set_point", SHOWN)]
    return found[0] if found else 0


def replay_path(case: Case) -> Path:
    """Path of the replay of a robot with a controller, relative to the benchmark's folder."""
    return Path(REPLAYS, safe_filename(case.robot), f"{safe_filename(case.controller)}.html")


def thumbnail_path(case: Case) -> Path:
    """Path of the picture of a robot with a controller, relative to the benchmark's folder."""
    return Path(THUMBNAILS, safe_filename(case.robot), f"{safe_filename(case.controller)}.png")


def html(
    rows: Sequence[dict[str, Any]],
    groups: dict[tuple[str, str], list[Case]],
    folder: Path,
    versions: dict[str, str],
) -> str:
    """The HTML text of the page."""
    total = sum(len(group) for group in groups.values())
    failed = sum(len(row["failed"]) for row in rows)
    cases = [case for group in groups.values() for case in group]
    simulated = benchmark.benchmark_report(cases, folder)["simulated_s"]
    parts = [
        f"<p>{total} closed loops, {simulated:.0f} s of simulated time, "
        f'<span class="{"bad" if failed else ""}">{failed} failed</span>. '
        "Every controller sees the analytic model; MuJoCo alone is the plant.</p>",
        _table(rows),
        "<h2>See the runs</h2><p>Each picture opens a replay of all runs of that robot with that "
        "controller, with a timeline and the cables' tensions.</p>",
        *_gallery(rows, groups),
        *_failures(rows, groups),
        *_figures(folder),
        "<h2>Every run</h2>",
        _runs(rows),
        "<h2>How it was made</h2>",
        f"<p><code>{escape(_command())}</code></p>",
        "<p>" + ", ".join(f"{escape(k)} {escape(v)}" for k, v in versions.items())
        + f", Python {sys.version_info.major}.{sys.version_info.minor}</p>",
        '<p class="quiet">The same numbers: <a href="table.md">table.md</a>, '
        '<a href="table.tex">table.tex</a>, <a href="results.json">results.json</a>; '
        "logs below <code>runs/</code>.</p>",
    ]  # fmt: skip
    return document_page("softdyn benchmark", parts, STYLE)


def _table(rows: Sequence[dict[str, Any]]) -> str:
    last = len(TITLES) - 1
    note = (
        '<p class="quiet">SP: final error of the set points. TT: time-mean of the squared error of '
        "the trajectories. Mean ± population standard deviation over all runs, failed ones "
        f'included; "none" where a run ended before its time. {NOTE}</p>'
    )
    if commands := emulations(rows):
        note = (
            f"<p><b>{CODE.sub(INSIDE, EMULATED)}</b></p>"
            "<details><summary>How the emulated figures were made"
            f"</summary><pre>{escape(chr(10).join(commands))}</pre></details>{note}"
        )
    return wide(benchmark_table(rows), [{last} if row["failed"] else set() for row in rows]) + note


def _gallery(
    rows: Sequence[dict[str, Any]], groups: dict[tuple[str, str], list[Case]]
) -> list[str]:
    parts: list[str] = []
    robot = ""
    for row in rows:
        if row["robot"] != robot:
            parts.append("</div>" if robot else "")
            robot = row["robot"]
            parts.append(f'<h3>{escape(robot_title(robot))}</h3><div class="grid">')
        cases = groups[row["robot"], row["controller"]]
        cells = benchmark_cells(row)
        bad = f'<span class="bad">{len(row["failed"])} of {len(cases)} failed</span>'
        parts.append(
            f'<a href="{_url(replay_path(cases[0]))}#run={chosen(cases)}">'
            f'<img src="{_url(thumbnail_path(cases[0]))}" width="360" height="300" loading="lazy" '
            f'alt="{escape(robot_title(robot))} with {escape(cells[1])}">'
            f"<b>{escape(cells[1])}</b><span>SP {escape(cells[2])} cm</span>"
            f"<span>TT {escape(cells[5])} cm²</span>{bad if row['failed'] else ''}</a>"
        )
    return [*parts, "</div>"]


def _failures(
    rows: Sequence[dict[str, Any]], groups: dict[tuple[str, str], list[Case]]
) -> list[str]:
    items = []
    for row in rows:
        cases = groups[row["robot"], row["controller"]]
        pair = f"{robot_title(row['robot'])}, {benchmark_cells(row)[1]}"
        for run in row["failed"]:
            at = next(
                i for i, c in enumerate(cases) if (c.kind, c.value) == (run["kind"], run["value"])
            )
            name = experiment_title(run["kind"], run["value"])
            items.append(
                f'<li><a href="{_url(replay_path(cases[0]))}#run={at}">'
                f"{escape(pair)}, {name}</a>: {escape(str(run['reason']))}</li>"
            )
    return ["<h2>Failed runs</h2><ul>", *items, "</ul>"] if items else []


def _figures(folder: Path) -> list[str]:
    parts = []
    for stem, caption in FIGURES.items():
        for file in sorted((folder / "figures").glob(f"{stem}*.png")):
            if not stem.endswith("_") and file.stem != stem:
                continue
            robot = file.stem.removeprefix(stem)
            words = f"{caption}, {robot}" if robot else caption
            pdf = file.with_suffix(".pdf")
            parts.append(picture(f"figures/{file.name}", words, f"figures/{pdf.name}"))
    return ["<h2>Figures</h2>", *parts] if parts else []


def _runs(rows: Sequence[dict[str, Any]]) -> str:
    if not rows:
        return ""
    keys = [("set_point", x) for x in rows[0]["set_points_cm"]]
    keys += [("tracking", x) for x in rows[0]["trajectories_cm2"]]
    bad = [
        {2 + keys.index((f["kind"], number_text(f["value"]))) for f in row["failed"]}
        for row in rows
    ]
    return wide(every_run_table(rows), bad)


def _url(path: Path | str) -> str:
    return escape(Path(path).as_posix())


def _command() -> str:
    """The running command line, with the script's name without its folder."""
    script = Path(sys.argv[0] or "python")
    return shlex.join(["python", "/".join(script.parts[-2:]), *sys.argv[1:]])
