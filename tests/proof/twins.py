"""Identify the documents' twins, and write the committed figures."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from softdyn.commands import cli, identify

# Ten joints of the helix rest on their stops. The last input lifts two more joints off their stops.
# It is fast, because these two swing fast. The other inputs are slow, for the joints at the base.
# The values were found by the lower bound of the deviations, on 5 s.
HELIX = (
    "--at-rest --knots .3 .3 .3 .3 .3 .3 .3 .3 .12 "
    "--amplitude .018 .018 0 .012 .012 0 .007 .007 .015 --bias 0 0 0 0 0 0 0 0 .012"
)
# Three markers of 1 mm that are lost and renamed. No bundled robot is like the arm of 12 joints.
MARKERS = "--measure markers --shared stiffness damping --timestep 5e-4"
FILES = "tests/proof/markers"
# arguments of `softdyn identify`
CASES = (
    f"finger --points {FILES}/finger.toml --twin 0.8 {MARKERS} --seeds 100",
    f"{FILES}/arm12.urdf --points {FILES}/arm12.toml --twin 1.2 --amplitude 0.8 --knots 0.3"
    f" {MARKERS} --seeds 40",
    "finger --twin 5 --noise 0",
    "finger --twin 5 --noise 0 --step 1e-3",
    "spirob --twin 5 --noise 0",
    "spirob --twin 5 --noise 0 --step 2e-3",
    "finger --twin 20",
    "finger --twin 20 --measure tip --shared stiffness damping mass",
    "finger --twin 1.5 --seeds 100",
    "spirob --twin 20",
    "spirob --twin 20 --measure tip --shared stiffness damping mass",
    f"helix --twin 5 --noise 0 {HELIX}",
    f"helix --twin 5 --noise 0 --step 2e-3 {HELIX}",
    f"helix --twin 20 {HELIX}",
    "spirob --twin 5 --seeds 8",
)
EPILOG = """\
CASE is a command line of `softdyn identify`, quoted. Its figures take the place of earlier ones of
the same CASE in tests/proof/documents/measured/identification.json; then
`python -m tests.proof tables` writes the table. All cases take hours.

exit codes: 0 done; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("cases", nargs="*", metavar="CASE", help="default: all of the documents'")


def command(arguments: cli.Arguments) -> int:
    """Run the cases; each is written when it is done."""
    from softdyn import InputError
    from softdyn.validation.files import read_json
    from tests.proof.documents.measured_rows import replace_rows
    from tests.proof.documents.settings import MEASURED

    path = MEASURED / "identification.json"
    for case in arguments.cases or CASES:
        print(case, flush=True)
        with TemporaryDirectory() as folder:
            report = Path(folder, "report.json")
            code = identify.main([*case.split(), "--json", str(report)])
            found = read_json(report, "the report of identify") if report.exists() else {}
        if code == cli.BAD_INPUT or "summary" not in found:
            raise InputError("CASE", "an identification of --twin", case)
        rows = [{"case": case, **row} for row in found["summary"]]
        replace_rows(path, "case", [case], rows, CASES)
    return cli.PASSED


main = cli.program(parser, command, __name__)
