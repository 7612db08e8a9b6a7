"""The decrease of V along runs of the paper's controllers, and their zero dynamics."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

ROBOTS = ("finger", "helix", "spirob")
LAWS = ("soft-id-clf-qp", "id-clf-qp", "clf-qp")
EPILOG = """\
This runs the paper's set points. For each run it shows three things. The first is the share of
control steps at which V grows faster, under the model's own acceleration, than the QP's -V/eps +
delta. The second is the poles of the zero dynamics (y = y_d, frozen poses). The third is whether
stiffness dominates gravity where no input acts, the paper's condition on the zero dynamics.
OUT/certificates.md is the table. OUT/certificates_ROBOT.png shows the runs of the soft and of the
hard controller at the first THETA.

exit codes: 0 written; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, choices=ROBOTS, metavar="ROBOT")
parser.add_argument("--thetas", nargs="+", type=cli.finite, default=(0.5, 0.0, 1.0, 1.5),
                    metavar="T", help="multiples of pi")  # fmt: skip
parser.add_argument(
    "--duration", type=cli.positive, metavar="S", help="length of a run (default: 10 s)"
)
parser.add_argument("--out", type=Path, default=Path("results/certificates"), metavar="DIR")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run, draw and report."""
    from tqdm import tqdm

    import softdyn
    from softdyn.validation.files import write_text
    from softdyn.validation.tables import Table
    from tests.proof.paper import certificates

    cli.make_folder(arguments.out)
    rows = []
    runs = len(arguments.robots) * len(arguments.thetas) * len(LAWS)
    with tqdm(total=runs, disable=None, leave=False, unit="run") as bar:
        for robot in arguments.robots:
            found = certificates.runs(robot, LAWS, arguments.thetas, arguments.duration, bar.update)
            rows += [row for _, row in found]
            picture = arguments.out / f"certificates_{robot}.png"
            certificates.draw(picture, softdyn.load(robot), [log for log, _ in found[:2]])
    table = Table.of(certificates.COLUMNS, rows)
    write_text(arguments.out / "certificates.md", table.markdown() + "\n")
    cli.write_report({"rows": rows}, arguments.json, table.text())
    return cli.PASSED


main = cli.program(parser, command, __name__)
