#!/usr/bin/env python3
"""Identify stiffness, damping, masses and gears of a robot from measurements."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn import SoftModel
    from softdyn.identification import Parameter

EPILOG = """\
DATA is CSV. Its header names the columns: t (s), u.INPUT for every input, and the measured ones of
q.JOINT (rad, m), tip.x, tip.y, tip.z (m) and length.TENDON (m). Time steps may differ.

KIND is stiffness, damping, friction (dry), rest, armature, mass, gear, tendon_stiffness,
tendon_damping or offset (the unknown zero of a length.TENDON). --free identifies each member in the
file separately. --shared identifies one factor on the file's values of all members. The file's
values are the first guess. If every joint is measured, samples near a stop are left out. Otherwise
the run must begin at rest under its first input, and it is used up to its first stop.

--twin S shows, before there are data, what S seconds of them would identify. MuJoCo's twin moves
with parameters drawn within 30 % of the file's, its outputs get noise (5 mrad, 0.1 mm of a
prismatic joint, 1 mm of tip and cables), and the drawn parameters are identified. --excitations
compares inputs instead: amplitudes and times between knots, with the least deviation that any fit
can have.

--second-opinion also fits the same unknowns to the same data by MuJoCo's own identification (extra
`sysid`), and prints both. It needs measurements of all joints and of nothing else, equal time
steps, and no joint that stays at a stop.

exit codes: 0 all parameters identified; 1 some not, they keep the file's value; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument("data", metavar="DATA", nargs="?", help="CSV")
parser.add_argument("--free", nargs="+", metavar="KIND", help="default: stiffness damping")
parser.add_argument("--shared", nargs="+", default=[], metavar="KIND")
parser.option("--hold-out", cli.finite, "PART", "last part of the data, only for a test", 0.2)
parser.add_argument("--step", type=cli.positive, metavar="S", help="longest step (s) of the model")
parser.add_argument("--twin", type=cli.positive, metavar="S", help="seconds of the twin's data")
parser.add_argument(
    "--measure",
    choices=("joints", "tip"),
    default="joints",
    help="outputs of the twin; default: joints",
)
parser.option("--noise", cli.finite, "X", "noise of the twin; 1: 5 mrad, 0.1 mm, tip 1 mm", 1.0)
for names, metavar, default, what in (
    (("--amplitude", "--reach"), "PART", 0.6, "share of the inputs' ranges in the twin's data"),
    (("--bias",), "PART", 0.0, "share of the ranges, added to move joints off their stops"),
    (("--knots",), "S", 0.2, "time between the twin's random inputs"),
):
    parser.add_argument(
        *names, type=cli.finite, nargs="+", metavar=metavar, default=[default],
        help=f"{what}, one for all or one for each; default: {default:g}",
    )  # fmt: skip
parser.add_argument(
    "--at-rest", action="store_true", help="begin at rest; default: fall from q = 0"
)
parser.option("--seeds", cli.count, "N", "number of twins", 1)
parser.add_argument("--excitations", action="store_true", help="compare inputs on the twin")
parser.add_argument(
    "--second-opinion", action="store_true", help="also MuJoCo's own identification"
)
parser.add_argument("--jobs", type=cli.count, metavar="N", help="default: one per core")
parser.option("--timestep", cli.positive, "S", "longest step of the twin", 1e-4)
parser.output("--out", "URDF", "write the robot's file with the new numbers")
parser.output("--html", "FILE", "write a page: fit, residuals, intervals")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Read, fit and write."""
    import math

    import softdyn
    from softdyn import InputError, identification
    from softdyn.validation.files import write_text
    from softdyn.validation.report.identification_page import page

    if (arguments.data is None) == (arguments.twin is None):
        raise InputError("DATA", "a file, or --twin", "both" if arguments.data else "neither")
    if arguments.twin is not None and (arguments.out or arguments.html):
        raise InputError("--out, --html", "DATA", "--twin, which is no robot's measurement")
    if arguments.data is not None and arguments.excitations:
        raise InputError("--excitations", "--twin S", "DATA, whose inputs are as they are")
    model = softdyn.load(arguments.robot)
    unknowns = identification.unknowns_of(model, arguments.free or (), arguments.shared)
    if arguments.twin is not None:
        return of_twin(arguments, model, unknowns)
    data = identification.read_csv(arguments.data, model)
    if arguments.second_opinion:
        from softdyn.validation.identification import second_opinion as second

        second.check(model, data, unknowns, arguments.hold_out)
    found = identification.identify(
        model, data, unknowns, hold_out=arguments.hold_out, step=arguments.step or math.inf
    )
    if arguments.out:
        write_text(arguments.out, identification.rewritten(model.robot, found.values()))
    if arguments.html:
        write_text(arguments.html, page(model.name, data, found))
    report = {"robot": model.name, "data": arguments.data, **found.report()}
    text = str(found)
    if arguments.second_opinion:
        opinion = second.second_opinion(model, data, unknowns, found, arguments.hold_out)
        report["second_opinion"] = opinion.report()
        text += f"\n\n{opinion}"
    cli.write_report(report, arguments.json, text)
    return cli.PASSED if all(one.identified for one in found.estimates) else cli.FAILED


def of_twin(arguments: cli.Arguments, model: SoftModel, unknowns: Sequence[Parameter]) -> int:
    """Identify drawn parameters, seed by seed, or find the inputs that identify them best."""
    import math

    from softdyn import InputError
    from softdyn.validation.identification import excitations, trials
    from softdyn.validation.identification import second_opinion as second

    outputs = [f"q.{name}" for name in model.joint_names]
    if arguments.measure == "tip":
        outputs = [f"tip.{axis}" for axis in "xyz"]
    excitation = trials.Excitation(
        arguments.twin,
        knots=tuple(arguments.knots),
        amplitude=tuple(arguments.amplitude),
        bias=tuple(arguments.bias),
        at_rest=arguments.at_rest,
        timestep=arguments.timestep,
    )
    what, jobs = (model, unknowns, outputs, excitation, arguments.noise), arguments.jobs or -1
    report: dict[str, Any] = {"robot": model.name, "labels": [one.label for one in unknowns]}
    if arguments.excitations:
        if arguments.second_opinion:
            raise InputError("--second-opinion", "a fit", "--excitations, which fits nothing")
        found = excitations.compared(*what, jobs=jobs)
        report["excitations"] = [
            {"amplitude": one.excitation.amplitude, "knots": one.excitation.knots,
             "relative": one.relative.tolist(), "refused": one.refused,
             "reach": one.excitation.amplitude}  # the former key
            for one in found
        ]  # fmt: skip
        cli.write_report(report, arguments.json, excitations.comparison(unknowns, found))
        return cli.PASSED if found[0].identifiable.all() else cli.FAILED
    options = {"seeds": arguments.seeds, "step": arguments.step or math.inf, "jobs": jobs}
    opinions: list[second.Opinion] = []
    if arguments.second_opinion:
        pairs = trials.each_trial(second.of_trial, *what, **options)
        several, opinions = [one for one, _ in pairs], [one for _, one in pairs]
    else:
        several = trials.each_trial(trials.trial, *what, **options)
    rows = [
        {"seed": one.seed, "relative": one.relative.tolist(), "scores": one.scores.tolist(),
         "width": one.width.tolist(), **one.found.report()}
        for one in several
    ]  # fmt: skip
    for k, opinion in enumerate(opinions):
        rows[k]["second_opinion"] = opinion.report()
    report |= {"summary": trials.summary(several), "trials": rows}
    text = "\n\n".join([trials.trial_table(several).text(), *map(str, opinions)])
    cli.write_report(report, arguments.json, text)
    known = all(one.identified for trial in several for one in trial.found.estimates)
    return cli.PASSED if known else cli.FAILED


main = cli.program(parser, command, __name__)
