#!/usr/bin/env python3
"""Compare two files of one robot, e.g. URDF and MJCF: causes and effects of differences."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn.validation.mjcf.comparison.result import Comparison
    from softdyn.validation.mjcf.comparison.side import Side

EPILOG = """\
A and B are URDFs or MJCFs in any combination, or names of robots. Joints are matched by name, by
similar names, then by kinematics. --map FILE gives pairs that would be matched wrongly, as TOML
lines "joint of A" = "joint of B".

Differences are listed by cause, the largest effect at random states first. Effects are relative: on
M, on gravity, on the tips. Properties that only one file or its format states, such as armature in
the MJCF alone, are listed separately. Then the causes are repaired one by one, and no difference
must be left.

With --engines the command also fails if an engine disagrees with the comparison's own terms.

exit codes: 0 the files agree; 1 they differ; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("a", metavar="A", help="a URDF or an MJCF")
parser.add_argument("b", metavar="B", help="the other file")
parser.add_argument("--map", metavar="FILE", help="TOML: joints of A = joints of B")
parser.add_argument(
    "--strict", action="store_true", help="also fail for properties that only one file states"
)
parser.add_argument(
    "--tolerance",
    type=cli.finite,
    metavar="R",
    help="values within this relative difference count as equal (default: 0; 1e-5 if a file prints "
    "at most six digits and no difference is larger)",
)
cli.add_repair_option(parser)
cli.add_root_option(parser)
parser.add_argument(
    "--engines",
    action="store_true",
    help="compare with Pinocchio and MuJoCo, each file and both together",
)
parser.output("--html", "FILE", "write both robots as a page")
parser.add_argument("--view", action="store_true", help="show that page in the browser")
parser.add_argument("--samples", type=cli.count, default=8, metavar="N", help="random states (8)")
parser.add_argument(
    "--seed", type=cli.whole, default=0, metavar="S", help="seed of the random states"
)
cli.add_server_options(parser)
cli.add_json(parser)
parser.unused("--port --no-open --origin", lambda a: not a.view, "only --view serves a page")


def command(arguments: cli.Arguments) -> int:
    """Compare and report."""
    from softdyn.validation import compare
    from softdyn.validation.mjcf.comparison.side import Side
    from softdyn.validation.mjcf.mjcf_file import Contents

    cli.doing("reads both files")
    mapping = None if arguments.map is None else read_map(arguments.map)
    contents = Contents(arguments.opened, cli.root_folder(arguments))
    repair = arguments.repair_inertia
    sides = (
        Side.of(arguments.a, contents, repair_inertia=repair),
        Side.of(arguments.b, contents, repair_inertia=repair),
    )
    cli.doing("compares both files")
    result = compare(
        *sides,
        mapping=mapping,
        strict=arguments.strict,
        tolerance=arguments.tolerance,
        samples=arguments.samples,
        seed=arguments.seed,
    )
    report, said, passed = result.to_dict(), str(result), result.passed
    if arguments.engines:
        cli.doing("compares both engines")
        figures, text = engines(*sides, arguments, result.tolerance)
        report["engines"] = figures
        passed = passed and figures["passed"]
        said += f"\n\n{text}"
    cli.write_report(report | {"passed": passed}, arguments.json, said)
    if arguments.html is not None or arguments.view:
        show(result, *sides, arguments)
    return cli.PASSED if passed else cli.FAILED


def show(result: Comparison, a: Side, b: Side, arguments: cli.Arguments) -> None:
    """Write the page of both robots, or show it in the browser until the command is ended."""
    from softdyn.validation.report.pair_page import pair_page

    page = pair_page(a, b, result)
    if arguments.html is not None:
        page.save(arguments.html)
    if arguments.view:
        with cli.ends_cleanly() as over:
            cli.serve(page, arguments, over, sys.stderr)


def engines(
    a: Side, b: Side, arguments: cli.Arguments, tolerance: float
) -> tuple[dict[str, Any], str]:
    """Compare each file with its engine, and the two engines."""
    from softdyn import InputError
    from softdyn.validation.crosschecks.engines import SAME, differing, engine_errors, side_by_side

    options = {"samples": arguments.samples, "seed": arguments.seed}
    report: dict[str, Any] = {}
    said, failed = [], []
    for key, side in (("a", a), ("b", b)):
        report[key] = found = engine_errors(side, **options)
        words = ", ".join(f"{name} {error:.1e}" for name, error in found.items())
        said.append(
            f"{key.upper()} in its own engine: {words or 'mimic or ball joints, not compared'}"
        )
        if wrong := [name for name, error in found.items() if not error <= SAME]:
            failed.append(f"{key.upper()}'s engine disagrees in {', '.join(wrong)}")
    try:
        pair = side_by_side(a, b, **options)
    except InputError as error:
        report["pair"] = {"reason": str(error)}
        said.append(f"one engine against the other: not compared, {error}")
    else:
        report["pair"] = pair.to_dict()
        said.append(f"the URDF in Pinocchio against the MJCF in MuJoCo:\n{pair}")
        if wrong := differing(pair, tolerance):
            failed.append(f"the two engines disagree in {', '.join(wrong)}")
    report["passed"] = not failed
    return report, "\n".join([*said, *(f"FAILED: {text}" for text in failed)])


def read_map(path: str) -> dict[str, str]:
    """Pairs of joints from a TOML file."""
    from softdyn.toml_table import TomlTable

    table = TomlTable.read(path)
    return {joint: table.text(joint) for joint in table.values}


main = cli.program(parser, command, __name__)
