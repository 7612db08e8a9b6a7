"""Whole arms among obstacles: seeded scenes, judged by MuJoCo's own distances."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from softdyn.commands import cli

EPILOG = """\
Every scene has a half-space, a ball and a box on the way of the free arm's links (see
tests/proof/safety/scenes.py). Soft ID-CLF-QP runs with barriers of all links. ROBOT is as for
`softdyn run`; a robot without published gains gets Kp = 100 and eps = 0.1. The rows of
`--out` replace earlier rows of the same robots.

exit codes: 0 no run without relaxed rows goes deeper than 0.1 mm; 1 one does; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robots", nargs="+", metavar="ROBOT")
parser.add_argument("--scenes", type=cli.count, default=10, metavar="N", help="of each robot")
parser.add_argument("--seed", type=cli.whole, default=0, metavar="S")
parser.add_argument("--out", type=Path, metavar="FILE", help="write the table's rows")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run all scenes and report."""
    from tqdm import tqdm

    import softdyn
    from softdyn.controllers import Gains
    from softdyn.controllers.barriers import UnsafeStart
    from softdyn.validation.files import read_json, write_json
    from softdyn.validation.tables import Table
    from tests.proof.safety import scenes

    rows: list[dict[str, Any]] = []
    for name in arguments.robots:
        model = softdyn.load(name)
        gains = None if model.bundled else Gains(Kp=100.0, eps=0.1)
        runs = []
        made = scenes.scenes(model, gains, arguments.scenes, arguments.seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnsafeStart)
            for scene in tqdm(made, total=arguments.scenes, desc=model.name, disable=None):
                runs.append(scenes.run(model, gains, scene))
        rows.append(scenes.summary(model.name, runs))
    if arguments.out is not None:
        old = read_json(arguments.out, "rows of a table")["rows"] if arguments.out.is_file() else []
        names = [row["robot"] for row in rows]
        write_json(arguments.out, {"rows": [r for r in old if r["robot"] not in names] + rows})
    cli.write_report({"rows": rows}, arguments.json, Table.of(scenes.COLUMNS, rows).markdown())
    return cli.PASSED if all(row["deeper"] == 0 for row in rows) else cli.FAILED


main = cli.program(parser, command, __name__)
