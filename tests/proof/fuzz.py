"""Fuzzing: thousands of damaged files, each loaded in a separate process."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from tests.proof.fuzzing.arguments import Line

CORPUS = Path(__file__).resolve().parents[1] / "corpus"

EPILOG = """\
Each input is a file of the corpus after a few random changes (tests/proof/fuzzing/inputs.py), fully
determined by --seed and its number. It is loaded as a user's file would be, in a separate process
that is killed after 5 s of processor time. A finding is

  crash            the process died
  hang             it took longer than 5 s
  exception        an exception other than a softdyn error, or terms that are not finite at rest
  message          an error that is not one line, or names no file
  lost content     accepted, but a second reading of the file by another parser differs
  engines differ   accepted, but MuJoCo computes another robot (one input in three is compared)

--arguments damages command lines instead. A command must succeed and write every requested file, or
report the error in one line and write no file (tests/proof/fuzzing/arguments.py).

--data damages logs, a store's results, a sweep and a schedule instead, and
reads them as their commands do. Lost content then is accepted content in which json, tomllib or
numpy.load differ from the reader (tests/proof/fuzzing/data.py).

--messages sends damaged messages to a live robot (softdyn play). A refused message must change
nothing, and after any other the robot must go on (tests/proof/fuzzing/messages.py).

Inputs with findings are written to --out.

exit codes: 0 no finding; 1 some; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.option("--count", cli.count, "N", "inputs", 1000)
parser.add_argument("--seed", type=int, default=0, metavar="S", help="(default: 0)")
parser.add_argument("--first", type=int, default=0, metavar="I", help="number of the first one")
parser.add_argument(
    "--corpus", type=Path, default=CORPUS, metavar="DIR", help="where base files are"
)
parser.add_argument("--out", type=Path, metavar="DIR", help="folder for inputs with a finding")
instead = parser.add_mutually_exclusive_group()
instead.add_argument(
    "--data", action="store_true", help="logs, stores and TOML instead of robot files"
)
instead.add_argument(
    "--messages", action="store_true", help="what pages say to a live robot instead of robot files"
)
instead.add_argument("--arguments", action="store_true", help="command lines instead")
cli.add_json(parser)


# commands that run, with options that may be added; none serves pages or starts processes
RUN = {
    "run": (
        "finger ic --theta 0.5 --duration 0.01 --log here.npz --json out.json",
        "arm.urdf soft-id-clf-qp --target 0.1 0 0.2 --duration 0.01 --gains gains.toml",
        "finger mine.py:Still --omega 0.3 --duration 0.01 --period 0.005 --json -",
    ),
    "check": ("arm.urdf --samples 2 --json out.json",),
    "crosscheck": ("arm.urdf --states-only --samples 1 --seed 3 --json out.json",),
    "statics": ("arm.urdf --inputs 0.1 0 --hold 0.01 --rays 1 --spread 1 --json out.json",),
    "replay": ("log.npz --html page.html --labels one",),
    "compare": ("arm.urdf arm.urdf --samples 2 --json out.json",),
    "export": ("arm.urdf --mjcf out.xml --json out.json",),
    "new": (
        "arm.toml --out new.urdf --json out.json",
        "arm.toml --converge --segments 2 3 --json out.json",
    ),
}
READ = {
    "run": "finger best --theta 0 --view --port 7000 --speed 2",
    "play": "finger best --port 7000 --no-open",
    "view": "finger --html page.html --port 7000",
    "sweep": "robustness --robots finger helix --controllers best --period 0.01 --jobs 2 "
    "--out folder --dry-run --ensemble 3 --seed 2 --keep kept.json --json out.json",
    "benchmark": "--robots finger --controllers ic uic --theta 0 1 --omega 0.1 --jobs 2",
    "step_time": "finger ic --theta 0.5 --seconds 0.1 --json out.json",
}
ADDED = (
    "--theta", "--target", "--duration", "--period", "--seed", "--samples", "--floating", "--json",
    "--help",
)  # fmt: skip
FILES = {
    "gains.toml": b"Kp = 100.0\neps = 0.1\n",
    "mine.py": b"""import sys
import numpy as np
from types import SimpleNamespace
class Still:
    def __init__(self, model, table=None): self.u = np.zeros(model.nu)
    def __call__(self, state, reference): return SimpleNamespace(u=self.u)
class Odd(Still):
    def __call__(self, state, reference): return "no"
class Leaves(Still):
    def __init__(self, model, table=None): sys.exit(0)
""",
    "arm.toml": b"""name = "arm"
[material]
youngs_modulus_MPa = 0.25
density_kg_m3 = 1070
[[section]]
length_mm = 200
radius_mm = [15, 10]
[[cable]]
count = 3
offset_mm = [12, 8]
routing = "channel"
max_tension_N = 5
""",
}


def lines() -> list[Line]:
    """Lines of all commands that take arguments."""
    from tests.proof.fuzzing import data
    from tests.proof.fuzzing.arguments import Line

    files = FILES | {"arm.urdf": (CORPUS / "base" / "arm.urdf").read_bytes()}
    files["log.npz"] = data.kinds()[0].base
    name = "softdyn.commands.{}".format
    run = [
        Line(name(command), tuple(text.split()), files, True, ADDED)
        for command, texts in RUN.items()
        for text in texts
    ]
    return run + [Line(name(command), tuple(text.split())) for command, text in READ.items()]


def command(arguments: cli.Arguments) -> int:
    """Fuzz, count, report."""
    from tqdm import tqdm

    from tests.proof.fuzzing import arguments as words
    from tests.proof.fuzzing import campaign, data, messages

    if arguments.out is not None:
        cli.make_folder(arguments.out)
    bases: Sequence[Any]
    judge: tuple[Any, Any]
    if arguments.arguments:
        bases, judge = lines(), (words.work, words.kept)
    elif arguments.data:
        bases, judge = data.kinds(), (data.work, data.kept)
    elif arguments.messages:
        bases, judge = messages.said(), (messages.work, messages.kept)
    else:
        bases = campaign.base_files(arguments.corpus)
        judge = (campaign.work, campaign.robot_file)
    numbers = range(arguments.first, arguments.first + arguments.count)
    with tqdm(total=len(numbers), disable=None, leave=False, unit="file") as bar:
        report = campaign.campaign(
            bases, arguments.seed, numbers, arguments.out, bar.update, *judge
        )
    cli.write_report(report, arguments.json, campaign.summary(report))
    return cli.FAILED if report["inputs_with_findings"] else cli.PASSED


main = cli.program(parser, command, __name__)
