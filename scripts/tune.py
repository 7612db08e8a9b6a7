#!/usr/bin/env python3
"""Tune the parameters of `best` on set points and rates that the paper does not have."""

from __future__ import annotations

import argparse
import sys
from typing import Any

import cli

EPILOG = """\
CMA-ES in the logarithms of controllers.Tuning's fields, from the present defaults; one set of
parameters for all robots. Every candidate runs set points at theta = 0.25, 0.75, 1.25 and 1.75 pi
and trajectories at 0.15 and 0.35 pi rad/s. The cost is the mean of log10 of root-mean-square and
final error over the robot's length. The trace (--out, JSON) holds the seed and every candidate.
Needs the extra: pip install 'softdyn[tune]'.

exit codes: 0 done; 2 bad input.
"""


def parser() -> cli.Parser:
    """The command line."""
    found = cli.Parser(description=__doc__, epilog=EPILOG)
    found.add_argument("--robots", nargs="+", default=["finger", "helix", "spirob"], metavar="R")
    found.add_argument("--generations", type=cli.count, default=6, metavar="N")
    found.add_argument("--population", type=cli.count, default=6, metavar="N")
    found.add_argument("--duration", type=cli.positive, default=4.0, metavar="S", help="of a run")
    found.add_argument("--seed", type=cli.count, default=1, metavar="S", help="> 0")
    found.add_argument("--jobs", type=cli.count, metavar="N", help="default: one per core")
    found.add_argument("--out", default="tuning.json", metavar="FILE", help="the trace")
    return found


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return cli.start(parser(), command, argv)


def command(arguments: argparse.Namespace) -> int:
    """Search, write the trace after every candidate, print the best."""
    from dataclasses import asdict

    from controllers import Tuning
    from validation import paper, tuning
    from validation.files import write_json

    cli.check_outputs(arguments.out)
    for robot in arguments.robots:
        paper.setup(robot)
    settings = {
        name: getattr(arguments, name)
        for name in ("robots", "generations", "population", "duration", "seed")
    }
    settings |= {"thetas": tuning.THETAS, "omegas": tuning.OMEGAS}
    trace: list[dict[str, Any]] = []

    def keep(entry: dict[str, Any]) -> None:
        trace.append(entry)
        write_json(arguments.out, {"settings": settings, "trace": trace})

    tuning.tune(
        tuning.cases(arguments.robots, "best", arguments.duration),
        asdict(Tuning()),
        generations=arguments.generations,
        population=arguments.population,
        seed=arguments.seed,
        jobs=arguments.jobs or -1,
        each=keep,
    )
    best = min(trace, key=lambda entry: entry["cost"])
    for name, entry in (("start", trace[0]), ("best", best)):
        print(name, "  ".join(f"{key} {value:.4g}" for key, value in entry.items()))
    return cli.PASSED


if __name__ == "__main__":
    sys.exit(main())
