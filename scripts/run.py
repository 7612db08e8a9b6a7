#!/usr/bin/env python3
"""Run one closed loop: a controller on the analytic model against the MuJoCo twin."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from softdyn import SoftModel
    from softdyn.description.visuals import Visual
    from softdyn.estimation import Ekf
    from softdyn.safety import Surroundings
    from softdyn.statics import Equilibrium
    from softdyn.validation import Log
    from softdyn.validation.live.watching import ViewerCost
    from softdyn.validation.loop.closed_loop import ClosedLoop
    from softdyn.validation.loop.experiment import Experiment
    from softdyn.validation.loop.kept_problems import KeptProblems
    from softdyn.validation.loop.recorded import RecordedRun
    from softdyn.validation.loop.settings import RunOptions
    from softdyn.validation.mjcf.scene import Scene

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

CONTROLLER is soft-id-clf-qp, the paper's own, or another of the package (a word that is none lists
all), or a class of your own as FILE.py:CLASS. best and mpc need no gains for any robot; --gains may
give best a schedule, as in
controllers/schedules/, and mpc fields of softdyn.controllers.MpcParameters. Your class is built
once as CLASS(model), or CLASS(model, table) with --gains, and called as controller(state,
reference). The result needs an attribute u.

--theta and --omega are multiples of pi on the paper's ellipse. For a robot that is not bundled the
ellipse is scaled to its length, the sum of joint offsets from base to tip, as for the finger (L/3
by L/8, its far end at distance L below and before the origin). --target needs no length.

--targets FILE is CSV: columns t, NAME.x .y .z for points, NAME.rx .ry .rz for rotation vectors,
NAME.dx .dy .dz for directions (see softdyn.tasks.read_paths), with the names of the robot's
<task> elements. The run is as long as the paths. A controller of your own gets tasks=[...].

--trajectory FILE is CSV with the columns t, x, y and z (s, m), from t = 0 on. The tip follows a
smooth path through the points. The run is as long as the path, or with --periodic two cycles of it;
the last point then is the first one again. FILE.py:CLASS is a class of your own. It is built as
CLASS(model) and called with t, and gives a softdyn.Reference. Its attribute duration (s) is the
length of the run, 10 s without one.

--gains FILE is TOML with the fields of softdyn.controllers.Gains, e.g. "Kp = 500" and "eps = 0.05".
Bundled robots have the paper's gains by default; other robots need a file.

--rig runs with the rig of the robot's file: commands of lengths, lag and delay of the motors,
sensors. --rig FILE is TOML with the fields of softdyn.validation.Rig, e.g. "lag = 0.02",
"noise = 0.001" and a table [plant] with "payload = 0.05"; the file's rig has all other values. best
and mpc know lag and delay of the plant, here of the rig, unless --gains says others.

--plant model integrates the analytic model in place of the twin, with the twin's scheme. It has the
rig, but no contacts and no dry friction. --plant FILE is an MJCF that replaces the twin.

--observer gives the controller an estimate from the rig's sensors (softdyn.estimation.Ekf) instead
of the state. Its process noise adapts to the readings; a line tells when they show forces that the
model lacks, or are off to one side. Disturbances may be named, e.g. "--observer
tip_force,stiffness". A class of your own is FILE.py:CLASS; it is built as CLASS(model) and needs
step(t, measurements, u).

--obstacles FILE is TOML with tables [[half_space]], [[sphere]], [[box]] and [[pairs]], whose keys
are the fields of softdyn.safety.HalfSpace, KeepOutSphere, KeepOutBox and LinkPairs. They are solid
in the plant unless they say "contact = false". The log has their forces on the robot, the page
shows them, and the least reserve of each is printed; a run that ends inside one reached nothing.
soft-id-clf-qp has them as barriers; no obstacle changes its horizon, which is 0 unless --gains say
otherwise. Any other controller, also a user's, is behind a safety filter: its input is changed as
little as the barriers require.

The run has reached a set point if |e| is within --tolerance, both as rms over the last tenth of the
run and at its end. It has reached a trajectory if the rms of |e| over the last cycle is within
--tolerance. Every task of the robot's file has to be as near: errors in rad within the angle by
which a straight robot turns when its tip moves by --tolerance. If a set point or tasks are missed,
statics searches for a few seconds the equilibrium nearest to the last targets.

An error in your own class ends the run with its traceback. --log then has the run up to there, as
it has after Ctrl-C.

A file that cannot be written, as on a full disk, is written to the folder of temporary files; the
figures are printed in any case.

exit codes: 0 reached (--no-verdict: not failed); 1 not reached, failed or diverged, an error in
your own class, or a file without room; 2 bad input; 130 interrupted.
"""


LACKING = 0.06  # of an Ekf's process noise; with a right model it ends below
RECENT = 2000  # steps of a run that are looked at again
PATIENCE = 4.0  # s to look for the nearest rest
AIMS = ("theta", "omega", "target", "targets", "trajectory")  # options that make the reference
TRANSIENT = 1.0  # s; a shorter run may not have had the time to reach its target


parser = cli.Parser(__doc__, EPILOG)
robot = parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
cli.add_force_options(parser)
law = parser.add_argument("controller", metavar="CONTROLLER")
goal = parser.add_mutually_exclusive_group(required=True)
goal.add_argument("--theta", type=cli.finite, metavar="T", help="set point at T pi, 10 s")
goal.add_argument("--omega", type=cli.positive, metavar="W", help="track at W pi rad/s, two cycles")
goal.add_argument(
    "--target", type=float, nargs=3, metavar=("X", "Y", "Z"), help="set point in m, 10 s"
)
goal.add_argument(
    "--targets", metavar="FILE", help="paths of the tasks in the robot's file, a CSV file"
)
goal.add_argument(
    "--trajectory", metavar="FILE", help="path of the tip, a CSV file, or FILE.py:CLASS"
)
parser.add_argument("--periodic", action="store_true", help="repeat the path, for two cycles")
parser.add_argument(
    "--from", dest="record", metavar="FILE",
    help="repeat a recorded run, a log or a case of a sweep, without ROBOT, CONTROLLER and target",
)  # fmt: skip
parser.add_argument(
    "--in", dest="folder", metavar="DIR", help="--from: files that a record knows by name alone"
)
parser.instead_of("--from", robot, law, group=goal)
parser.settings(
    period="control period in s (default: the paper's, 0.002 for other robots)",
    duration="length of the run in s",
)
parser.add_argument("--gains", metavar="FILE", help="gains, a TOML file")
parser.add_argument(
    "--seed", type=cli.whole, metavar="N", help="seed of the rig's noise and bias (default: 0)"
)
parser.add_argument(
    "--certify", action="store_true",
    help="log the rate of V under the model's own acceleration (the paper's controllers)",
)  # fmt: skip
parser.add_argument(
    "--tolerance",
    type=cli.positive,
    metavar="M",
    help="tolerance in m (default: 1 %% of the robot's length)",
)
parser.add_argument(
    "--no-verdict",
    action="store_true",
    help="exit with 0 unless the run failed, even if it did not reach its target",
)
parser.output("--log", "FILE", "write the run as NPZ, or as CSV where FILE ends in .csv")
parser.output("--html", "FILE", "write the run as a page that replays it")
parser.add_argument(
    "--keep-failed", metavar="DIR", help="write the QP of each fallback to an NPZ file in DIR"
)
parser.add_argument("--view", action="store_true", help="show the run live in the browser")
parser.option("--speed", cli.positive, "X", "pace of --view, simulated seconds per second", 1.0)
cli.add_server_options(parser)
cli.add_json(parser)
parser.unused("--periodic", lambda a: a.trajectory is None, "only with --trajectory")
parser.unused(
    "--speed --port --no-open --origin", lambda a: not a.view, "only --view serves a page"
)
parser.unused(
    "--seed", lambda a: a.rig is None and a.record is None, "only a rig has noise, see --rig"
)
parser.unused("--in", lambda a: a.record is None, "only --from searches files")
parser.unused(
    "--annotations --floating --repair-inertia", lambda a: a.record is not None,
    "the record has the robot",
)  # fmt: skip


def command(arguments: cli.Arguments) -> int:
    """Build, simulate and report."""
    from softdyn.controllers.registry import one_line_errors
    from softdyn.validation import paper
    from softdyn.validation.loop.closed_loop import ClosedLoop
    from softdyn.validation.loop.kept_problems import KeptProblems

    made = asked(arguments) if arguments.record is None else repeated(arguments)
    model, controller, plant = made.model, made.controller, made.scene
    bounded = arguments.certify or (made.recorded is not None and made.recorded.certified)
    if bounded:
        from softdyn.validation.loop.certificate import TrueRate, certify

        TrueRate(controller)  # it may refuse the controller
    shown, name, folder = None, made.options.name or "", arguments.keep_failed
    kept = None if folder is None else KeptProblems(folder, controller)
    with one_line_errors(name, "a command"), cli.saved_in_errors(arguments.log):
        loop = ClosedLoop(model, controller, made.reference, made.options)
        loop.record |= made.said
        if arguments.view:
            log, shown = watch(loop, plant, arguments, kept)
        else:
            log = loop.run(progress=True, on_step=kept)
    if bounded:
        log = certify(log, model, controller, loop.reference)
    results = cli.Results()
    if arguments.log is not None:
        results.save(partial(cli.save_log, log), arguments.log)
    if arguments.html is not None:
        from softdyn.validation.loop.pictures.replay import replay

        results.save(replay(log, model, scenery_of(plant)).save, arguments.html)
    text = log.summary(paper.beside(log), arguments.tolerance)
    report = log.report(arguments.tolerance)
    missed = log.complete and not report["reached"]
    if missed and made.recorded is None and not arguments.no_verdict:
        if log.tasks is None:
            line, report["nearest_rest_cm"] = nearest_rest(
                model, log, arguments.tolerance, controller
            )
        else:
            line, report["nearest_rest"] = nearest_to_tasks(loop, log, arguments.tolerance)
        text = f"{text}\n{line}".rstrip()
    text = "\n".join(filter(None, [cli.best_note(model, log.controller, arguments.gains), text]))
    if loop.loop.observation is not None:
        line, report["process_noise"] = unmodelled(loop.loop.observation.observer, log)
        text = f"{text}\n{line}".rstrip()
    if plant is not None:
        report["plant"] = plant.to_dict()
    if shown is not None:
        text += f"\n{shown}"
        report["viewer"] = asdict(shown)
    if kept is not None:
        text, report["failed_problems"] = f"{text}\n{kept.count} failed problems", kept.count
        text += f" in {folder}" if kept.count else ""
    if made.recorded is not None:
        repetition = made.recorded.compared(log)
        text += f"\nrepeated       {repetition}"
        report["repeated"] = repetition.to_dict() | {"changed": made.said["repeats"]["changed"]}
    report["record"] = cli.record_beside(log, arguments.json)
    results.tell(report, arguments.json, text)
    done = not log.failed if arguments.no_verdict else report["reached"]
    if made.recorded is not None:
        done = repetition.equal
    return cli.PASSED if done and not results.lost else cli.FAILED


@dataclass(frozen=True)
class Made:
    """The parts of a run.

    Attributes
    ----------
    model, controller, reference, options
        The arguments of `ClosedLoop`.
    recorded : RecordedRun, optional
        The run that it repeats.
    said : dict
        More entries of its record.
    """

    model: SoftModel
    controller: Any
    reference: Any
    options: RunOptions
    recorded: RecordedRun | None = None
    said: dict[str, Any] = field(default_factory=dict)

    @property
    def scene(self) -> Scene | None:
        """The user's own scene, if it is the plant."""
        from softdyn.validation.mjcf.scene import Scene

        return self.options.plant if isinstance(self.options.plant, Scene) else None


def asked(arguments: cli.Arguments) -> Made:
    """The run of a command line."""
    from softdyn.validation.loop.settings import RunOptions

    model = cli.load_robot(arguments)
    experiment, more = goal_of(model, arguments)
    read = read_settings(arguments, model)
    with naming(model):
        around = read.get("surroundings")
        controller = controller_of(model, arguments.controller, arguments.gains, around, **more)
    options = RunOptions(**parser.given(arguments) | read, name=arguments.controller)
    return Made(model, controller, experiment, with_seed(options, arguments.seed))


def with_seed(options: RunOptions, seed: int | None) -> RunOptions:
    """The settings with another seed of their rig; as they are without a rig or a seed."""
    from softdyn.validation.twin.rig import rig_of

    rig = rig_of(options.rig)
    if seed is None or rig is None:
        return options
    return replace(options, rig=replace(rig, seed=seed))


def read_settings(arguments: cli.Arguments, model: SoftModel) -> dict[str, Any]:
    """The settings of a command line that are read from files."""
    read = {
        "plant": make_plant(model, arguments.plant, arguments),
        "rig": make_rig(arguments.rig, model),
        "surroundings": make_surroundings(arguments.surroundings, model),
    }  # fmt: skip
    return {name: value for name, value in read.items() if value is not None}


def repeated(arguments: cli.Arguments) -> Made:
    """The run of a record, with the options of a command line in place of the record's."""
    from softdyn import InputError
    from softdyn.controllers.registry import one_line_errors
    from softdyn.validation.loop.provenance import file_of
    from softdyn.validation.loop.recorded import RecordedRun
    from softdyn.validation.loop.repeat import changed_files, experiment_of, lost_parts
    from softdyn.validation.loop.settings import RunOptions

    file, folder = arguments.record, arguments.folder
    if arguments.robot is not None:
        parser.error("argument --from: not allowed with a ROBOT, which the record has")
    recorded = RecordedRun.read(file)
    if recorded.record.get("reference") is None:
        expected = "a run with a controller; softdyn rollout --inputs takes a log's CSV"
        plant = recorded.record.get("settings", {}).get("plant")  # a rig is none that can be made
        held = isinstance(plant, dict) and "other" in plant
        raise InputError(file, expected, "commands held on a rig" if held else "a rollout")
    given = parser.given(arguments, explicit=True)
    aims = [name for name in (*AIMS, "gains", "seed") if getattr(arguments, name) is not None]
    aimed = bool({*AIMS} & {*aims})
    anew = {f"settings.{name}" for name in given} | ({"reference"} if aimed else set())
    lost = [part for part in lost_parts(recorded.record) if part.split(" ")[0] not in anew]
    if lost:
        raise InputError(file, "a run that its record can make again", "; ".join(lost))
    parts, assumed = experiment_of(recorded.record, recorded.source, folder)
    for line in (*changed_files(recorded.record, folder), *assumed):
        print(f"note: {line}", file=sys.stderr, flush=True)
    model, controller, reference = (
        parts.pop(name) for name in ("model", "controller", "reference")
    )
    given |= read_settings(arguments, model)
    options = with_seed(RunOptions.of(parts | given), arguments.seed)
    if options.plant is not None and "plant" not in given:
        options = replace(options, plant=make_plant(model, options.plant, arguments))
    more = dict[str, Any]()
    if aimed:
        reference, more = goal_of(model, arguments)
    if arguments.gains is not None:
        if getattr(controller, "tasks", ()):
            more = {"tasks": controller.tasks} | more
        name = recorded.controller(folder)
        controller = controller_of(model, name, arguments.gains, options.surroundings, **more)
    elif "surroundings" in given or more:
        with one_line_errors(options.name or "", "a controller that can be made again"):
            controller = made_anew(controller, model, options.surroundings, more)
    said = {"repeats": {"file": file_of(file), "changed": sorted([*given, *aims])}}
    return Made(model, controller, reference, options, recorded, said)


def made_anew(
    controller: Any, model: SoftModel, around: Surroundings | None, more: dict[str, Any]
) -> Any:
    """A controller with other obstacles or tasks, and else with the arguments of its making."""
    from softdyn import InputError
    from softdyn.controllers.safety_filter import SafetyFilter, with_barriers
    from softdyn.copies import making_of

    inner = controller.inner if isinstance(controller, SafetyFilter) else controller
    making = making_of(inner)
    if making is None or making.maker is None:
        raise InputError("--obstacles, --targets", "--gains too, which make the controller", "none")
    given = {key: value for key, value in making.named.items() if value is not model}
    given.pop("barriers", None)
    given |= more
    return with_barriers(making.maker, around)(model, *making.arguments[1:], **given)


def goal_of(model: SoftModel, arguments: cli.Arguments) -> tuple[Experiment, dict[str, Any]]:
    """The reference of a run, and the controller's further arguments: the tasks of --targets."""
    from softdyn import Reference
    from softdyn.validation import paper

    more, target = dict[str, Any](), arguments.target
    if arguments.trajectory is not None:
        return paper.trajectory(
            model, arguments.trajectory, periodic=arguments.periodic, period=arguments.period
        ), more
    if arguments.targets is not None:
        from softdyn.exceptions import errors_in
        from softdyn.tasks import make_tasks
        from softdyn.tasks.marks import recorded_targets

        more["tasks"] = make_tasks(model)
        reference = recorded_targets(arguments.targets, more["tasks"])
        times = sorted({t for path in reference.motions.values() for t in path.times.tolist()})
        for t, name in ((t, name) for t in times for name in reference.motions):
            goal = reference.motions[name](t)
            if goal.y.shape == (4, 4) or isinstance(goal, Reference):
                with errors_in(f"{arguments.targets}: {name} at {t:g} s"):
                    paper.check_reach(model, goal.y[:3, 3] if goal.y.ndim == 2 else goal.y)
        target = reference(0.0).y
    experiment = paper.experiment(
        model, theta=arguments.theta, omega=arguments.omega, target=target, period=arguments.period
    )
    if arguments.targets is not None:
        experiment = replace(experiment, reference=reference, duration=times[-1])
    return experiment, more


def unmodelled(observer: Any, log: Log | None = None) -> tuple[str, float | None]:
    """The process noise at which an `Ekf` arrived: a line, and its value; none of a user's own.

    With the log the line has the force at the tip that would explain readings off to one side.
    """
    from softdyn import estimation
    from softdyn.estimation.recorded import BIASED

    if not isinstance(observer, estimation.Ekf):
        return "", None
    given, found = observer.parameters, observer.process
    line = (
        f"observer       process noise {found:.2g}, adapted to the readings "
        f"(at most {given.process:g})"
    )
    biases = abs(observer.biases)
    if biases.max() > BIASED:
        name = observer.reading_names[biases.argmax()]
        line += (
            f". {name} is off to one side, by {biases.max():.0f} standard deviations of a mean: "
            "a bias of this sensor, or a force that stays and that the model lacks"
        )
        if log is not None and type(observer) is estimation.Ekf and not observer.disturbances:
            line += constant_force(observer, log)
    elif found > LACKING and not observer.disturbances:
        line += ": they may show forces that the model lacks"
    else:
        return line, found
    if not observer.disturbances:
        line += ". To estimate forces: --observer tip_force, payload, stiffness or joint_offsets"
    return line, found


def constant_force(observer: Ekf, log: Log) -> str:
    """The force at the tip that explains the last readings of a run; empty if none does."""
    import numpy as np

    from softdyn.estimation.recorded import BIASED

    name = "tip_force"
    other = type(observer)(observer.model, disturbances=(name,), parameters=observer.parameters)
    assert log.measured is not None
    assert log.q_seen is not None
    assert log.v_seen is not None
    if not log.complete or other.reading_names != observer.reading_names:
        return ""
    commands = log.u if log.command is None else log.command
    sent, first = [commands[0], *commands], max(log.steps - RECENT, 0)
    other.reset(log.q_seen[first], log.v_seen[first], sent[first])
    for k in range(first, log.steps):
        estimate = other.step(log.t[k], log.measured[k], sent[k])
    force = estimate.disturbances[name]
    size = float(np.linalg.norm(force))
    if not size or abs(other.biases).max() > BIASED:
        return ""
    along = force / size
    deviation = 1.96 * float(np.sqrt(along @ other.covariance_of(name) @ along))
    return f". A constant force of {size:.2g} ± {deviation:.1g} N at the tip would explain it"


def nearest_rest(
    model: SoftModel, log: Log, tolerance: float | None, controller: Any = None
) -> tuple[str, float | None]:
    """The equilibrium nearest to a set point that was not reached: its line and distance (cm).

    A second line says which gains of the paper's controllers to change.
    """
    import numpy as np

    from softdyn import SoftdynError, statics

    if np.ptp(log.y_ref, axis=0).any() or log.t[-1] < TRANSIENT:
        return "", None
    try:
        found = statics.inputs_for_tip(model, log.y_ref[-1], shapes=8, seconds=PATIENCE)
    except SoftdynError as error:
        return f"statics: {error}", None
    away = found.distance(found.nearest)
    within = away <= log.verdict(tolerance).tolerance
    reach = "it is within reach" if within else "it may be out of reach"
    line = (
        f"softdyn statics: the nearest equilibrium found in {PATIENCE:g} s is {100 * away:.3f} cm "
        f"from the target: {reach}"
    )
    if within and model.bundled is None:
        line += about_gains(found.nearest, controller, log.period)
    return line, 100 * away


def about_gains(one: Equilibrium, controller: Any, period: float) -> str:
    """A line about the gains of a controller of the paper; empty for any other."""
    from softdyn.controllers import CONTROLLERS, SoftIdClfQp
    from softdyn.controllers.proposed_gains import advice

    if getattr(controller, "name", "") not in CONTROLLERS:
        return ""
    line = f"softdyn check {one.model.robot.path} --gains --period {period:g} proposes gains"
    if isinstance(controller, SoftIdClfQp):
        line = f"{advice(one, controller.gains, period, controller.horizon)}; {line}"
    return f"\ngains: {line}"


def nearest_to_tasks(
    loop: ClosedLoop, log: Log, tolerance: float | None
) -> tuple[str, dict[str, Any] | None]:
    """The equilibrium nearest to tasks that were missed: a line, its errors by task."""
    from types import SimpleNamespace

    import numpy as np

    from softdyn import SoftdynError, statics
    from softdyn.tasks import compute_errors
    from softdyn.validation.loop.metrics import task_figures
    from softdyn.validation.loop.record import tasks_in
    from softdyn.validation.loop.verdict import missed_tasks

    if log.t[-1] < TRANSIENT:
        return "", None
    model, tasks, end = loop.model, tasks_in(loop.controller), float(log.t[-1])
    try:
        found = statics.inputs_for_tasks(model, tasks, loop.reference(end), seconds=PATIENCE)
    except SoftdynError as error:
        return f"statics: {error}", None
    rest = found.nearest
    here = SimpleNamespace(t=[end], q=[rest.q], v=[np.zeros(model.nv)])
    errors = np.hstack([*compute_errors(model, tasks, here, loop.reference).values()])
    within = log.verdict(tolerance).tolerance
    each = log.columns("tasks")
    missed = missed_tasks(each, errors.tolist(), within, log.length)
    figures = task_figures(each, errors[None])
    by_task = {name: {"error": one["last"], "unit": one["unit"]} for name, one in figures.items()}
    said = ", ".join(f"{name} {x['error']:.3f} {x['unit']}" for name, x in by_task.items())
    reach = "they may be out of reach" if missed else "they are within reach"
    return (
        f"softdyn statics: the nearest equilibrium found in {PATIENCE:g} s misses the last targets "
        f"by {said}: {reach}",
        by_task,
    )


def watch(
    loop: ClosedLoop, plant: Scene | None, arguments: cli.Arguments, kept: KeptProblems | None
) -> tuple[Log, ViewerCost]:
    """Run the loop while a browser shows it."""
    from softdyn.validation.live import watching
    from softdyn.validation.loop.pictures.replay import replay

    shapes = scenery_of(plant)
    with watching.open_watch_page(loop, arguments.port, shapes, arguments.origin) as channel:
        print(channel.url, file=sys.stderr, flush=True)
        if not arguments.no_open:
            channel.open()
        channel.wait(watching.WAIT)
        log, shown = watching.watch(loop, channel, arguments.speed, kept)
        channel.leave(replay(log, loop.model, shapes).html())
    return log, shown


def scenery_of(plant: Scene | None) -> Sequence[Visual]:
    """The shapes around the robot in a user's scene."""
    if plant is None:
        return ()
    from softdyn.validation.mjcf.scenery import scenery

    return scenery(plant)


def make_plant(model: SoftModel, given: Any, arguments: cli.Arguments) -> Any:
    """The plant, for a user's own scene after a report on its differences from the model."""
    from collections.abc import Mapping

    from softdyn.validation.loop.settings import MODEL, SCENE

    if not isinstance(given, str | Mapping) or given == MODEL:
        return given
    from softdyn.validation.mjcf.scene import scene_of

    root = cli.root_folder(arguments)
    if isinstance(given, str) and root is not None:
        given = {SCENE: given, "root": str(root)}
    plant = scene_of(model, given)
    if arguments.json != "-":
        cli.say(str(plant))
    return plant


def make_rig(said: str | None, model: SoftModel) -> Any:
    """The rig of the robot's file, or with what a TOML file changes.

    A warning names each key that this robot has no use for.
    """
    from softdyn.validation.twin.rig import FROM_FILE, Rig

    if said in (None, FROM_FILE):
        return said
    rig = Rig.of(cli.read_toml(said), said)
    robot = rig.robot(model.robot)
    missing = cli.lacks(robot)
    wound = any(actuator.is_winch for actuator in robot.actuators)
    for key, given, there, reason in (
        ("stiffness", rig.stiffness is not None, wound, "no motor winds a cable"),
        ("damping", rig.damping is not None, wound, "no motor winds a cable"),
        ("plant.contacts", rig.plant.contacts, "contacts" not in missing, missing.get("contacts")),
        ("plant.friction", rig.plant.friction, "friction" not in missing, missing.get("friction")),
    ):
        if given and not there:
            cli.warn_useless(f"{said}: {key}", str(reason))
    return rig


def make_surroundings(file: str | None, model: SoftModel) -> Surroundings | None:
    """The obstacles of a TOML file, tried with the robot, so that an error names their file."""
    import numpy as np

    from softdyn import InputError
    from softdyn.exceptions import errors_in
    from softdyn.safety import Surroundings
    from softdyn.validation.loop.arguments import starting_pose

    if file is None:
        return None
    around = Surroundings.of(cli.read_toml(file), file)
    if not around.barriers:
        raise InputError(file, "at least one obstacle", "none")
    with errors_in(file):
        around.reserve(model.state(starting_pose(model, None)[0], np.zeros(model.nv)))
    return around


@contextmanager
def naming(model: SoftModel) -> Iterator[None]:
    """Add the robot's file to an error about its tasks."""
    from softdyn import InputError

    try:
        yield
    except InputError as error:
        if error.name not in ("tasks", "targets"):
            raise
        where = f"{model.robot.path}: {error.name}"
        raise error.about(where) from None


def controller_of(
    model: SoftModel, name: str, file: str | None, around: Surroundings | None = None, **more: Any
) -> Any:
    """A controller by its command-line name, with the parameters of a file if there is one."""
    from softdyn.controllers import registry
    from softdyn.controllers.safety_filter import with_barriers

    table = None if file is None else cli.read_toml(file)
    cls = with_barriers(registry.find_controller(name), around)
    return registry.make_controller(name, model, table, cls, source=file, **more)


main = cli.program(parser, command, __name__)
