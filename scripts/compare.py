#!/usr/bin/env python3
"""Two files, one robot: does your MJCF agree with your URDF, and if not, where?"""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
A and B are URDFs or MJCFs in any combination, or names as everywhere. Joints are matched by name,
by like names, then by kinematics; --map FILE names pairs that this gets wrong, as lines
"joint of A" = "joint of B" in TOML.

What differs is listed by cause, the largest effect at random states first, each relative: on M, on
gravity, on the tips. What only one file, or only its format, states (armature in the MJCF alone)
is listed apart. Then each cause is repaired in turn: what is left must be nothing.

--catalogue compares the robots of example-robot-data with the MJCFs of public repositories that are
found in the folders given, a row a pair.

exit codes: 0 the files agree; 1 they differ; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("a", metavar="A", nargs="?", help="a URDF or an MJCF")
parser.add_argument("b", metavar="B", nargs="?", help="the other file")
parser.add_argument("--map", metavar="FILE", help="TOML: joints of A = joints of B")
parser.add_argument("--strict", action="store_true", help="fail for what one file alone states too")
parser.add_argument(
    "--engines", action="store_true", help="each file through its own engine, at the same states"
)
parser.add_argument("--samples", type=cli.count, default=8, metavar="N", help="random states (8)")
parser.add_argument("--seed", type=cli.whole, default=0, metavar="S", help="of the random states")
parser.add_argument(
    "--catalogue", nargs="+", metavar="DIR", help="folders with the repositories of public MJCFs"
)
parser.add_argument("--markdown", metavar="FILE", help="write the rows of --catalogue as a table")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Compare, report."""
    from softdyn import InputError
    from softdyn.validation import compare

    cli.check_outputs(arguments.json, arguments.markdown)
    if arguments.catalogue is not None:
        if arguments.a is not None:
            raise InputError("--catalogue", "no A and B", arguments.a)
        return catalogue(arguments)
    if arguments.b is None:
        raise InputError("A B", "two files, or --catalogue DIR", arguments.a)
    if arguments.markdown is not None:
        raise InputError("--markdown", "--catalogue", "two files")
    mapping = None if arguments.map is None else read_map(arguments.map)
    result = compare(
        arguments.a,
        arguments.b,
        mapping=mapping,
        strict=arguments.strict,
        samples=arguments.samples,
        seed=arguments.seed,
    )
    report, said = result.to_dict(), str(result)
    if arguments.engines:
        from softdyn.validation.comparison.engines import engine_errors

        options = {"samples": arguments.samples, "seed": arguments.seed}
        errors = {side: engine_errors(getattr(arguments, side), **options) for side in ("a", "b")}
        report["engines"] = errors
        for side, found in errors.items():
            figures = ", ".join(f"{name} {error:.1e}" for name, error in found.items())
            said += f"\n{side.upper()} in its own engine: {figures or 'mimic joints, not asked'}"
    cli.write_report(report, arguments.json, said)
    return cli.PASSED if result.passed else cli.FAILED


def read_map(path: str) -> dict[str, str]:
    """Pairs of joints from a TOML file."""
    from softdyn import InputError

    table = cli.read_toml(path)
    for joint, other in table.items():
        if not isinstance(other, str):
            raise InputError(path, "lines joint = joint", f"{joint} = {other!r}")
    return table


def catalogue(arguments: cli.Arguments) -> int:
    """One row a public pair."""
    from softdyn.validation.comparison import public_pairs
    from softdyn.validation.files import write_text

    survey = public_pairs.survey(arguments.catalogue, arguments.samples, arguments.seed)
    if arguments.markdown is not None:
        write_text(arguments.markdown, survey.markdown())
    cli.write_report(survey.to_dict(), arguments.json, str(survey))
    return cli.PASSED if survey.passed else cli.FAILED


main = cli.program(parser, command, __name__)
