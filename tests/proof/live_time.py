"""How live pages slow down a running robot: its clock and control step, with and without pages."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import softdyn
from softdyn.commands import cli, play
from softdyn.validation.live.playing import drive, open_play_page
from softdyn.validation.live.session import Session
from softdyn.validation.tables import Table
from softdyn.view.live import messages
from softdyn.view.live.channel import Channel
from softdyn.view.live.pacing import Clock

EPILOG = """\
It compares runs of --seconds: without pages, with two pages that read every frame and draw none,
and with two windows of Chromium if it is installed. They take turns. The report has the times of
the control step and the pace of the clock.

exit codes: 0 measured; 1 the step with two readers took more than 1.1 x as long; 2 bad input.
"""
PAGES = 2
WARM = 1.0  # s before a measurement
RATIO = 1.1  # limit of the ratio of step times, with pages that do not render
COLUMNS = (
    ("", "pages", ""),
    ("step µs", "median_us", ".0f"),
    ("p99", "p99_us", ".0f"),
    ("ratio", "ratio", ".2f"),
    ("late µs", "wake_us", ".0f"),
    ("p99", "wake_p99_us", ".0f"),
    ("misses", "misses", "d"),
    ("of", "periods", "d"),
    ("dropped", "dropped", "d"),
    ("× real time", "pace", ".2f"),
)
# A page that reads every frame and draws none.
READER = """
import asyncio, sys
from tornado.websocket import websocket_connect
async def read():
    link = await websocket_connect(sys.argv[1])
    while await link.read_message() is not None:
        pass
asyncio.run(read())
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument("controllers", nargs="*", metavar="CONTROLLER")
parser.option("--seconds", cli.positive, "S", "length of a run", 5.0)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure the cost of pages."""
    session = play.make_session(play.parser.parse_args([arguments.robot, *arguments.controllers]))
    report = measure(session, arguments.seconds, browser=shutil.which("chromium"))
    cli.write_report(report, arguments.json, live_time_text(report))
    return cli.PASSED if report["passed"] else cli.FAILED


def measure(
    session: Session, seconds: float, rounds: int = 6, browser: str | None = None
) -> dict[str, Any]:
    """Time a robot without pages, with two pages that do not draw, and with a browser.

    The cases take turns for `rounds` rounds, forth and back (A B B A), so that other load of the
    machine affects all of them alike. Step times are medians over the rounds. A ratio is the median
    of the rounds' ratios, and `ratios` are the least and the largest of these.

    Parameters
    ----------
    session : Session
        The robot and its controller.
    seconds : float
        Length of a round (s).
    rounds : int
        Number of rounds of each case.
    browser : str, optional
        Chromium's program; without it, the browser is left out.
    """
    kinds = ["none", "two readers", *(["two windows"] if browser else [])]
    runs: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    model = session.model
    goal = session.frame()[session.columns.places["y"]].astype(float)
    session.apply(messages.SetTarget(goal + 0.05 * model.robot.length))
    for k in range(rounds):
        for kind in kinds[:: (-1) ** k]:
            runs[kind].append(_round(session, kind, seconds, browser))
    rows = [{"pages": kind, **_middle(runs[kind])} for kind in kinds]
    for row, kind in zip(rows, kinds, strict=True):
        pairs = zip(runs[kind], runs["none"], strict=True)
        ratios = [one["median_us"] / other["median_us"] for one, other in pairs]
        row["ratio"] = median(ratios)
        row["ratios"] = [min(ratios), max(ratios)]
    return {
        "robot": model.name,
        "law": session.shown.law,
        "rows": rows,
        "passed": rows[1]["ratio"] <= RATIO,
        "load": os.getloadavg()[0],
        "version": softdyn.__version__,
    }


def _round(session: Session, kind: str, seconds: float, browser: str | None) -> dict[str, Any]:
    with ExitStack() as stack:
        channel = stack.enter_context(open_play_page(session))
        if kind != "none":
            for _ in range(PAGES):
                stack.enter_context(_Page(channel, kind, browser))
            channel.wait(20)
        _run(session, channel, WARM)
        dropped = channel.dropped
        clock = _run(session, channel, seconds)
        kept = clock.statistics()
        return {
            "median_us": kept.step_us["median"], "p99_us": kept.step_us["p99"],
            "wake_us": kept.wake_us["median"], "wake_p99_us": kept.wake_us["p99"],
            "misses": kept.misses, "periods": kept.periods, "pace": kept.pace,
            "dropped": channel.dropped - dropped,
        }  # fmt: skip


def _run(session: Session, channel: Channel, seconds: float) -> Clock:
    count = round(seconds / session.period)
    clock = Clock(session.period, keep=count)
    drive(session, channel, clock, lambda: clock.periods >= count)
    return clock


class _Page:
    """Context manager for a process that has the page open."""

    def __init__(self, channel: Channel, kind: str, browser: str | None) -> None:
        if kind == "two readers":
            url = channel.url.replace("http:", "ws:").replace("/?", "/live?")
            self._command = [sys.executable, "-c", READER, url]
        else:
            self._folder = TemporaryDirectory(ignore_cleanup_errors=True)
            profile = f"--user-data-dir={self._folder.name}"
            flags = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader",
                     "--enable-unsafe-swiftshader", "--no-first-run", "--window-size=900,600",
                     "--remote-debugging-port=0")  # fmt: skip
            self._command = [str(browser), *flags, profile, channel.url]

    def __enter__(self) -> None:
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen(self._command, stdout=quiet, stderr=quiet)

    def __exit__(self, *_error: object) -> None:
        self._process.terminate()
        self._process.wait()


def _middle(rounds: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of times, sums of counts."""
    sums = ("misses", "periods", "dropped")
    columns = {name: [one[name] for one in rounds] for name in rounds[0]}
    return {name: (sum if name in sums else median)(rows) for name, rows in columns.items()}


def live_time_text(report: Mapping[str, Any]) -> str:
    """The report for a terminal."""
    least, largest = report["rows"][1]["ratios"]
    return (
        f"{report['robot']}, {report['law']}; load {report['load']:.1f}\n"
        f"{Table.of(COLUMNS, report['rows']).text()}\n"
        f"step time with two readers {report['rows'][1]['ratio']:.2f} x "
        f"({least:.2f} to {largest:.2f}), limit {RATIO:g} x"
    )


main = cli.program(parser, command, __name__)
