"""Let runs on a served rig fail at random times, each in another way: is the rig relaxed?"""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from softdyn.commands import cli

EPILOG = """\
Each fault is a run of softdyn drive with a controller, an observer and a driver of its own, on a
rig that softdyn drive --serve simulates in another process. The table has the time from the moment
at which the loop can know of the fault to the call of stop() and to the relaxed rig. The bar is two
periods, or 100 ms after the missed heartbeat. All processes have a real-time priority if they may.

exit codes: 0 all faults passed; 1 one did not; 2 bad input.
"""
PRIORITY = 10  # a real-time one, of all processes
SOONEST, LATEST = 0.8, 3.0  # s after the first command
HEARTBEAT = 0.1  # s
MOST_EARLY = 20  # runs that something else stops before their fault, such as a busy machine
LOGGED = 2  # periods from the last logged one to the fault

parser = cli.Parser(__doc__, EPILOG)
parser.option("--seed", cli.whole, "N", "seed of the random times", 0)
parser.option("--period", cli.positive, "S", "control period", 0.005)
parser.add_argument("--only", nargs="+", metavar="KIND", help="these faults (default: all)")


def command(arguments: cli.Arguments) -> int:
    """Run all faults, one after the other."""
    import numpy as np

    from tests.support.rig_processes import CAUSES, CODES, END, FALLING, StoppedBefore, fault

    period = arguments.period
    times = np.random.default_rng(arguments.seed).uniform(SOONEST, LATEST, len(CAUSES))
    priority = "no priority"
    with suppress(OSError, AttributeError):  # no right to it, or not on this system
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
        priority = f"real-time priority {PRIORITY}"
    print(f"seed {arguments.seed}, period {1e3 * period:g} ms, {priority}")
    print(f"{'fault':31}{'at s':>6}{'stop() ms':>11}{'relaxed ms':>12}{'bar ms':>8}"
          f"{'code':>6}{'log':>6}  load")  # fmt: skip
    passed: list[bool] = []
    early: list[str] = []
    for kind, after in zip(CAUSES, times, strict=True):
        if arguments.only and kind not in arguments.only:
            continue
        bar = 2 * period
        if kind in ("blocked read", "freeze loop", "kill loop"):
            bar = period + HEARTBEAT  # the heartbeat that is missed comes a period after the last
        words = ("--period", str(period))
        while True:
            try:
                with tempfile.TemporaryDirectory() as folder:
                    done = fault(Path(folder), kind, *words, after=float(after))
                break
            except StoppedBefore as error:
                early.append(str(error))
                print(f"again: {' '.join(str(error).splitlines()[:1])}", flush=True)
                if len(early) > MOST_EARLY:
                    raise
        logged = kind in (END, FALLING) or done.unlogged < LOGGED * period
        said = kind == END or f"stopped by {CAUSES[kind]}" in done.err
        code = CODES.get(kind, 1) if kind != END else int(done.log.failed)  # the verdict's
        good = done.called <= bar and done.code == code and logged and said
        passed.append(good)
        relaxed = "-" if done.relaxed is None else f"{1e3 * done.relaxed:.1f}"
        print(f"{kind:31}{after:6.2f}{1e3 * done.called:11.1f}{relaxed:>12}{1e3 * bar:8.0f}"
              f"{done.code:6}{'whole' if logged else 'short':>6}  {os.getloadavg()[0]:.1f}"
              f"{'' if good else '  FAILED'}", flush=True)  # fmt: skip
        if not good:
            print(done.err, file=sys.stderr)
    print(f"{sum(passed)} of {len(passed)} passed; {len(early)} runs were stopped before the fault")
    return cli.PASSED if all(passed) else cli.FAILED


main = cli.program(parser, command, __name__)
