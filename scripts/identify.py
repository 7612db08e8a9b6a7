#!/usr/bin/env python3
"""Identify parameters of a robot, or of the design of an arm, from measurements."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    import numpy as np

    from softdyn import SoftModel
    from softdyn.identification import DesignFile, Parameter

EPILOG = """\
ROBOT is a URDF, a bundled name, or the TOML file of an arm, as `softdyn new` reads it.

DATA is CSV. Its header names the columns: t (s), u.INPUT for every input, and the measured ones of
q.JOINT (rad, m), tip.x, tip.y, tip.z (m), length.TENDON (m), point.MARKER.x, .y, .z (m) and
pose.MARKER.x … .rz (m, rotation vector in rad), and measured.SENSOR of the file's length, joint,
position and pose sensors, as in the log of a run with --rig. Time steps may differ. Cells of all
but joints may be empty. --outputs: read only those that begin so. --static: each row is an
equilibrium under its inputs, t may be missing. --rests takes such rows out of data over time, such
as a log in which the inputs rise in steps.

--points FILE says where the markers are, in TOML: [[point]] (or [[pose]]) with a name, and either
link and xyz_mm, or s_mm along the arm and offset_mm. --camera fit identifies the frame of the
markers, --camera X Y Z RX RY RZ (m, rad) states it: a point p of the robot is seen at R p + t.
--relabel: the names of markers may change from row to row. Each marker is the point that makes the
sum of squared distances least: with --static the model's in that row, else the last one seen.

KIND is stiffness, damping, friction (dry), rest, armature, mass, gear (the area of a chamber),
area_growth (its coefficients of the stretch), tendon_stiffness, tendon_damping, free_length (of an
elastic cable), offset (the unknown zero of a length.TENDON), sensor_bias (of each reading),
sensor_latency (of each sensor), or force (numbers of --force). force.NAME.FIELD is one number of a
force; KIND.MEMBER is one member of any kind of a URDF.
--free identifies each member in the file separately. --shared identifies one factor on the file's
values of all members. The file's values are the first guess. If every joint is measured, samples
near a stop are left out. Otherwise the run must begin at rest under its first input, and it is used
up to its first stop.

Static rows: --free cable_friction (the file has a first guess), input_loss (the part of an input
that friction at the motor takes). direction.INPUT is the last direction, 1 pulled in, -1 paid out;
without it the order of the rows says so.

Of a TOML file, KIND is any key of a number without its unit, such as youngs_modulus, density or
offset. offset.2 means second entries, offset.left those of the [[cable]] called left.

--twin S shows, before there are data, what S seconds of them would identify. MuJoCo's twin moves
with parameters drawn within 30 % of the file's, its outputs get noise (5 mrad, 0.1 mm of a
prismatic joint, 1 mm of tip and cables), and the drawn parameters are identified. --excitations
compares inputs instead: amplitudes and times between knots, with the least deviation that any fit
can have.

exit codes: 0 all parameters identified; 1 some not, they keep the file's value; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument("data", metavar="DATA", nargs="?", help="CSV")
cli.add_force_options(parser)
parser.add_argument("--free", nargs="+", metavar="KIND", help="default: stiffness damping")
parser.add_argument("--shared", nargs="+", default=[], metavar="KIND")
parser.option("--hold-out", cli.finite, "PART", "last part of the data, only for a test", 0.2)
parser.add_argument("--outputs", nargs="+", default=[], metavar="NAME", help="default: all")
parser.add_argument("--static", action="store_true", help="each row is an equilibrium")
parser.add_argument(
    "--rests", type=cli.positive, nargs="?", const=1.0, metavar="S",
    help="as --static, with rows at rest out of data over time: means where the inputs are held "
    "for S seconds (default: 1)",
)  # fmt: skip
parser.output("--rows", "FILE", "write the rows of --rests, CSV for --static")
parser.add_argument("--test", metavar="CSV", help="static data for the test, instead of --hold-out")
parser.add_argument("--points", metavar="FILE", help="where the markers are, TOML")
parser.add_argument(
    "--camera", nargs="+", metavar="X", help="fit, or X Y Z RX RY RZ; default: the world's frame"
)
parser.add_argument("--folds", type=cli.count, metavar="N", help="test on N parts of static rows")
parser.add_argument(
    "--hints", action="store_true", help="what the model may lack: try extensions on unseen data"
)
parser.add_argument("--relabel", action="store_true", help="markers' names change in the data")
parser.add_argument("--step", type=cli.positive, metavar="S", help="longest step (s) of the model")
parser.add_argument("--twin", type=cli.positive, metavar="S", help="seconds of the twin's data")
parser.add_argument(
    "--measure",
    choices=("joints", "tip", "markers"),
    default="joints",
    help="outputs of the twin; default: joints; markers are lost and renamed",
)
parser.option("--noise", cli.finite, "X", "noise of the twin; 1: 5 mrad, 0.1 mm, tip 1 mm", 1.0)
for name, metavar, default, what in (
    ("--amplitude", "PART", 0.6, "share of the inputs' ranges in the twin's data"),
    ("--bias", "PART", 0.0, "share of the ranges, added to move joints off their stops"),
    ("--knots", "S", 0.2, "time between the twin's random inputs"),
):
    parser.add_argument(
        name, type=cli.finite, nargs="+", metavar=metavar, default=[default],
        help=f"{what}, one for all or one for each; default: {default:g}",
    )  # fmt: skip
parser.add_argument(
    "--at-rest", action="store_true", help="begin at rest; default: fall from q = 0"
)
parser.option("--seeds", cli.count, "N", "number of twins", 1)
parser.add_argument("--excitations", action="store_true", help="compare inputs on the twin")
parser.add_argument("--jobs", type=cli.count, metavar="N", help="default: one per core")
parser.option("--timestep", cli.positive, "S", "longest step of the twin", 1e-4)
parser.output("--out", "FILE", "write the robot's file, URDF or TOML, with the new numbers")
parser.output("--html", "FILE", "write a page: fit, residuals, intervals")
cli.add_json(parser)
parser.unused(
    "--measure --noise --amplitude --bias --knots --at-rest --seeds --jobs --timestep",
    lambda a: a.twin is None, "only with --twin",
)  # fmt: skip
parser.unused(
    "--hold-out --outputs --static --rests --test --camera --folds --hints --relabel",
    lambda a: a.twin is not None, "--twin makes its own data",
)  # fmt: skip
parser.unused("--seeds --step", lambda a: a.excitations, "--excitations fits nothing")
parser.unused("--rows", lambda a: a.rests is None, "only with --rests")
parser.unused("--hold-out", lambda a: a.test, "--test has the data of the test")


def command(arguments: cli.Arguments) -> int:
    """Read, fit and write."""
    import math

    import numpy as np

    from softdyn import InputError, identification
    from softdyn.exceptions import errors_in
    from softdyn.identification.data import csv_text
    from softdyn.identification.hints import FOLDS, hints, left_out, where, where_text
    from softdyn.identification.result import distance
    from softdyn.validation.files import write_text
    from softdyn.validation.report.identification_page import page

    if (arguments.data is None) == (arguments.twin is None):
        raise InputError("DATA", "a file, or --twin", "both" if arguments.data else "neither")
    if arguments.twin is not None and (arguments.out or arguments.html):
        raise InputError("--out, --html", "DATA", "--twin, which is no robot's measurement")
    if arguments.data is not None and arguments.excitations:
        raise InputError("--excitations", "--twin S", "DATA, whose inputs are as they are")
    arguments.static |= arguments.rests is not None
    made, model = robot_of(arguments)
    chosen = arguments.free or (), arguments.shared
    if arguments.twin is not None:
        return of_twin(arguments, model, identification.choose_unknowns(model, *chosen))
    results = cli.Results()
    how = {"static": arguments.static, "outputs": arguments.outputs}
    timed = {"static": False} if arguments.rests is not None else {}
    raw = identification.read_csv(arguments.data, model, **how | timed)
    if arguments.rests is not None:
        samples = len(raw.t)
        with errors_in(arguments.data):
            raw, moving = identification.rest_rows(raw, arguments.rests)
        line = f"rests: {len(raw.t)} of {samples} rows, {moving} stretches left out that still move"
        print(line, file=sys.stderr)
        if arguments.rows:
            results.save(lambda path: write_text(path, csv_text(raw, model)), arguments.rows)
    given, fitted = camera_of(arguments)
    data, acquisition = identification.prepared(
        model, raw, static=arguments.static, camera=given, fit_camera=fitted,
        relabel=arguments.relabel,
    )  # fmt: skip
    unknowns = made.unknowns(*chosen) if made else identification.choose_unknowns(model, *chosen)
    if fitted and acquisition.view is not None:
        unknowns += identification.camera_unknowns(acquisition.view.camera)
    options: dict[str, Any] = {
        "hold_out": 0.0 if arguments.test else arguments.hold_out,
        "step": arguments.step or math.inf, "acquisition": acquisition,
        "progress": True,
    }  # fmt: skip
    found = identification.identify(model, data, unknowns, **options)
    again: dict[str, Any] = {"static": True, "relabel": arguments.relabel, "camera": found.camera}
    if arguments.relabel and arguments.static:  # the fitted model may name the markers otherwise
        renamed, _ = identification.prepared(found.model, raw, **again)
        if not np.array_equal(renamed.outputs, data.outputs, equal_nan=True):
            found = identification.identify(model, renamed, unknowns, **options)
    if arguments.test:
        test = identification.read_csv(arguments.test, model, **how)
        found = identification.tested(found, identification.prepared(found.model, test, **again)[0])
    values = found.values()
    if arguments.out:
        text = (
            made.rewrite(values.get("design", {})) if made
            else identification.rewrite_urdf(model.robot, values)
        )  # fmt: skip
        results.save(lambda path: write_text(path, text), arguments.out)
    if arguments.html:
        results.save(lambda path: write_text(path, page(model.name, found)), arguments.html)
    lines = list(identification.doubts(found))
    words = [f"{name}={value:.12g}" for name, value in values.get("force", {}).items()]
    lines += [f"for another command: --force-set {' --force-set '.join(words)}"] if words else []
    unseen = None
    if arguments.folds:
        unseen = distance(found.names, left_out(found.fit, arguments.folds))
        lines.append(f"rms on rows left out, in {arguments.folds} parts: {unseen:.3g}")
    places, shown = where(found), 0
    if arguments.hints:
        if arguments.json != "-":  # the hints take longer than the fit
            cli.say("\n".join([str(found), *lines]))
            shown = len(lines) + 1
        lines += [where_text(places)]
        folds = arguments.folds or max(2, min(FOLDS, len(found.data.t) // 3))
        tried = list(hints(
            found, lambda more: identification.identify(model, data, (*unknowns, *more), **options),
            folds, made, progress=True,
        ))  # fmt: skip
        lines += map(str, tried)
        again["hints"] = [vars(one) for one in tried]
    report = {"robot": model.name, "data": arguments.data, **found.report(), "doubts": lines,
              "rms_left_out": unseen, "residuals": places,
              "hints": again.get("hints", [])}  # fmt: skip
    cli.write_report(report, arguments.json, "\n".join([str(found), *lines][shown:]))
    identified = all(one.identified for one in found.estimates)
    return cli.PASSED if identified and not results.lost else cli.FAILED


def robot_of(arguments: cli.Arguments) -> tuple[DesignFile | None, SoftModel]:
    """The design, if the robot is a TOML file, and the model with the markers."""
    import softdyn
    from softdyn import InputError, identification
    from softdyn.dynamics.mimic import build

    for name, on in (("--test", arguments.test), ("--relabel", arguments.relabel)):
        if on and not (arguments.static or name == "--relabel"):
            raise InputError(name, "--static", "data over time")
    if Path(arguments.robot).suffix == ".toml":
        if arguments.twin is not None:
            expected = "a URDF; `softdyn new` makes one of the TOML file"
            raise InputError("--twin", expected, arguments.robot)
        forces = cli.make_forces(arguments)
        made = identification.DesignFile(arguments.robot, arguments.points, forces=forces)
        return made, made.model
    model = softdyn.load(arguments.robot, forces=cli.make_forces(arguments))
    if arguments.points:
        markers = identification.read_points(arguments.points)
        model = build(identification.marked(model.robot, markers))
    return None, model


def camera_of(arguments: cli.Arguments) -> tuple[np.ndarray | None, bool]:
    """The stated camera (6,), and whether it is to be identified."""
    import numpy as np

    from softdyn import InputError

    words = arguments.camera
    if words is None or words == ["fit"]:
        return None, words is not None
    try:
        found = np.array([float(word) for word in words])
    except ValueError:
        found = np.zeros(0)
    if found.shape != (6,) or not np.isfinite(found).all():
        raise InputError("--camera", "fit, or six numbers: X Y Z RX RY RZ", " ".join(words))
    return found, False


def of_twin(arguments: cli.Arguments, model: SoftModel, unknowns: Sequence[Parameter]) -> int:
    """Identify drawn parameters, seed by seed, or find the inputs that identify them best."""
    import math

    from softdyn.validation.identification import trials, twin_report

    excitation = trials.Excitation(
        arguments.twin, knots=tuple(arguments.knots), amplitude=tuple(arguments.amplitude),
        bias=tuple(arguments.bias), at_rest=arguments.at_rest, timestep=arguments.timestep,
    )  # fmt: skip
    outputs = twin_report.outputs_of(model, arguments.measure)
    what, jobs = (model, unknowns, outputs, excitation, arguments.noise), arguments.jobs or -1
    if arguments.excitations:
        report, text, known = twin_report.of_excitations(*what, jobs=jobs)
    else:
        report, text, known = twin_report.of_trials(
            *what, seeds=arguments.seeds, step=arguments.step or math.inf, jobs=jobs
        )  # fmt: skip
    cli.write_report({"robot": model.name, **report}, arguments.json, text)
    return cli.PASSED if known else cli.FAILED


main = cli.program(parser, command, __name__)
