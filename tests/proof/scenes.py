"""Whole arms among obstacles: seeded scenes, judged by MuJoCo's own distances."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from softdyn.commands import cli

EPILOG = """\
Every scene has a half-space, a ball and a box on the way of the free arm's links (see
tests/proof/safety/scenes.py). Soft ID-CLF-QP runs with barriers of all links. ROBOT is as for
`softdyn run`; a robot without published gains gets Kp = 100 and eps = 0.1. `--out` is written
after each run. Runs that it has already are not run again.

exit codes: 0 no run without relaxed rows goes deeper than 0.1 mm; 1 one does; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robots", nargs="+", metavar="ROBOT")
parser.add_argument(
    "--scenes", type=cli.count, default=10, metavar="N", help="of each robot and seed (default: 10)"
)
parser.add_argument("--seeds", type=cli.whole, nargs="+", default=[0], metavar="S")
parser.add_argument("--out", type=Path, metavar="FILE", help="write the table's rows")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run all scenes and report."""
    import softdyn
    from softdyn.controllers.barriers import UnsafeStart
    from softdyn.validation.files import read_json, write_json
    from softdyn.validation.tables import Table
    from tests.proof.safety import scenes

    out, rows = arguments.out, list[dict[str, Any]]()
    if out is not None and out.is_file():
        rows = read_json(out, "rows of a table")["rows"]
    models = [softdyn.load(name) for name in arguments.robots]
    for model in models:
        earlier = [run for row in rows if row["robot"] == model.name for run in row["runs"]]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnsafeStart)
            for runs in scenes.runs(model, arguments.scenes, arguments.seeds, earlier):
                others = [row for row in rows if row["robot"] != model.name]
                rows = [*others, scenes.summary(model.name, runs)]
                if out is not None:
                    write_json(out, {"rows": rows})
    rows = [row for row in rows if row["robot"] in [model.name for model in models]]
    cli.write_report({"rows": rows}, arguments.json, Table.of(scenes.COLUMNS, rows).markdown())
    return cli.PASSED if all(row["deeper"] == 0 for row in rows) else cli.FAILED


main = cli.program(parser, command, __name__)
