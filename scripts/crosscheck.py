#!/usr/bin/env python3
"""Pinocchio against MuJoCo: the same robot in two engines, quantity by quantity and along time."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

import cli

if TYPE_CHECKING:
    from validation.crosscheck import CrossCheck

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

At random states inside the limits each quantity is computed by both engines, and
error = max|a - b| / max(|a|, |b|, scale). Limits, contacts and dry friction are off.

exit codes: 0 everything agrees; 1 something differs; 2 bad input.
"""


def parser() -> cli.Parser:
    """The command line."""
    found = cli.Parser(description=__doc__, epilog=EPILOG)
    found.add_argument("robot", metavar="ROBOT")
    found.add_argument(
        "--samples", type=cli.count, default=20, metavar="N", help="random states (default: 20)"
    )
    found.add_argument(
        "--seed", type=seed, default=0, metavar="S", help="of the random states (default: 0)"
    )
    cli.add_json(found)
    return found


def seed(text: str) -> int:
    """A whole number >= 0, for `type=`."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number >= 0, got {text!r}")
    return int(text)


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return cli.start(parser(), command, argv)


def command(arguments: argparse.Namespace) -> int:
    """Load, compare, report."""
    import softdyn
    from validation import Twin, crosscheck

    cli.check_outputs(arguments.json)
    model = softdyn.load(arguments.robot)
    twin = Twin(model, limits=False)
    show = sys.stderr.isatty()
    result = crosscheck(
        model,
        twin,
        samples=arguments.samples,
        seed=arguments.seed,
        progress=say if show else None,
    )
    if show:
        say("")
    cli.write_report(result.to_dict(), arguments.json, summary(result))
    return cli.PASSED if result.passed else cli.FAILED


def say(text: str) -> None:
    """Replace the progress line on stderr."""
    print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


def summary(result: CrossCheck) -> str:
    """The tables for people."""
    lines = [
        f"{result.robot}: {result.nv} degrees of freedom, {result.nu} inputs; "
        f"{result.samples} random states, seed {result.seed}",
        "",
        f"{'quantity':<12}{'max error':>10}{'tolerance':>11}  {'':<7}relative to at least",
    ]
    for check in result.checks:
        verdict = "ok" if check.passed else "FAILED"
        lines.append(
            f"{check.quantity:<12}{check.max_error:>10.1e}{check.tolerance:>11.0e}  "
            f"{verdict:<7}{check.scale}"
        )
        if check.reason:
            lines.append(f"{'':<12}{check.reason}")
    if result.runs:
        lines += ["", f"{'trajectory':<12}{'scheme':<10}{'step s':>9}{'length s':>10}{'error':>10}"]
    for run in result.runs:
        lines.append(
            f"{run.name:<12}{run.scheme:<10}{run.step:>9.2g}{run.duration:>10.3g}"
            f"{run.max_error:>10.1e}  {run.why}"
        )
    for ladder in result.ladders:
        lines += [
            "",
            f"step halving, {ladder.scheme} over {ladder.duration:.2g} s, "
            f"expected order {ladder.expected_order}",
            f"{'':<4}{'step s':>9}{'engines differ':>16}{'from the limit':>16}{'order':>8}",
        ]
        for rung in ladder.rungs:
            order = "-" if rung.order is None else f"{rung.order:.2f}"
            lines.append(
                f"{'':<4}{rung.step:>9.2g}{rung.engine_error:>16.1e}"
                f"{rung.truncation_error:>16.1e}{order:>8}"
            )
    failed = ", ".join(result.failures)
    lines += ["", f"FAILED: {failed}" if failed else "the two engines agree"]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
