#!/usr/bin/env python3
"""How many joints an arm needs: sag, frequencies, shape under its cables against their number."""

from __future__ import annotations

from typing import Any

from softdyn.commands import cli

EPILOG = """\
FILE is TOML as for `softdyn new`. Errors are against what the finest arms extrapolate to; of tips
relative to the arm's length.

--closed-forms takes no FILE: rods with joints at Gauss-Legendre nodes and at midpoints against
Euler-Bernoulli, Rayleigh, Timoshenko, the elastica and constant curvature, as Markdown
(docs/design.md).

--peer takes no FILE either: M, C v, g, K and the tip of an arm of two sections at one random state
against SoRoMoX's piecewise constant strains (extra `peers`), and the time of an evaluation of each.

exit codes: 0 done; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
which = parser.add_mutually_exclusive_group(required=True)
which.add_argument("file", metavar="FILE", nargs="?", help="TOML")
which.add_argument("--closed-forms", action="store_true", help="rods that theory knows")
which.add_argument("--peer", action="store_true", help="an arm in SoRoMoX too")
parser.add_argument(
    "--segments", type=cli.count, nargs="+", default=[5, 10, 20, 40, 80], metavar="N",
    help="joints in each section (default: 5 10 20 40 80)",
)  # fmt: skip
parser.option("--tolerance", cli.positive, "X", "relative error that is allowed", 1e-3)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure, extrapolate, report."""
    cli.check_outputs(arguments.json, inputs=[arguments.file])
    measure = closed_forms if arguments.closed_forms else peer if arguments.peer else converge
    report, text = measure(arguments)
    cli.write_report(report, arguments.json, text)
    return cli.PASSED


def converge(arguments: cli.Arguments) -> tuple[dict[str, Any], str]:
    """A user's arm against itself."""
    from softdyn import design
    from softdyn.validation.rods import convergence

    arm = design.arm_of(cli.read_toml(arguments.file), arguments.file)
    found = convergence.converge(arm, arguments.segments, arguments.tolerance)
    return {"file": arguments.file, "name": arm.name, **found.to_dict()}, str(found)


def closed_forms(arguments: cli.Arguments) -> tuple[dict[str, Any], str]:
    """Rods against theory."""
    from softdyn.validation.rods import proof

    counts = sorted(set(arguments.segments))
    if arguments.json is None:
        return {}, proof.markdown(counts)
    found = proof.run(counts)
    tables = {rule: [ladder.to_dict() for ladder in ladders] for rule, ladders in found.items()}
    return tables, "\n".join(tables)


def peer(arguments: cli.Arguments) -> tuple[dict[str, Any], str]:
    """An arm against an independent code."""
    from softdyn.validation.rods import peer

    found = peer.compare(sorted({n for n in arguments.segments if n <= peer.MOST}))
    text = peer.markdown(found)
    return {**found, "ladders": [ladder.to_dict() for ladder in found["ladders"]]}, text


main = cli.program(parser, command, __name__)
