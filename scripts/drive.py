#!/usr/bin/env python3
"""Run a closed loop on a real rig, by a driver of your own."""

from __future__ import annotations

import sys
from functools import partial
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli
from softdyn.commands.run import controller_of, goal_of, naming, unmodelled

if TYPE_CHECKING:
    from softdyn import SoftModel
    from softdyn.validation.bench.drive import Drive, DriveResult
    from softdyn.validation.bench.signals import Signals

EPILOG = """\
--driver FILE.py:CLASS is your class for the rig. It is built as CLASS(model) and needs start(),
read(), send(commands) and stop(); docs/examples/served_rig.py is one. read() returns the newest
readings of the file's sensors and their times in seconds of time.monotonic(), NaN where nothing is
new. send() gets forces, free lengths or velocities, as the file's motors state. stop() relaxes the
cables; it may be called at any time, and twice.

CONTROLLER, --theta, --omega, --target, --targets, --trajectory and --gains are those of softdyn
run. The state is estimated from the readings; --observer names disturbances to estimate or a class
of your own, as for softdyn run.

--hold C ... sends these constant commands instead of a controller's, to check directions, units and
zero. CONTROLLER and a target are then left out.

The commands rise over --ramp seconds, and fall as long after the end. The run stops at once, and
stop() is called, at Ctrl-C, SIGTERM and SIGHUP; at an exception of controller, observer or driver;
at a reading older than --stale, or one that the observer has not used for as long; at one outside
its <sensor lower upper>, or of a tension beyond the bounds of its motors; at a command that is not
finite; after --missed deadlines in a row; and when the innovations of the estimate over --lost
seconds are beyond the 1 - 1e-6 quantile of chi-square (not while the commands rise or fall). A
signal before start() ends the program at once. Later ones lose neither the stop nor the log. A
stop() that has not returned after 2 s is interrupted and tried a second time. A log without room is
written to another folder, which a line names. If the program itself is killed, or is late by --late
seconds and a whole period, another process kills it and relaxes the rig by a second driver; it
writes the log up to there.

--zero measures the zeros of the rig instead, and writes them to --out: the offset of each winch and
the bias of each encoder. It winds up one cable after the other until its tension rises, and pays it
out again; every cable needs a sensor of its tension. A cable that does not tighten within --reach,
that jams, or with a zero that scatters stops it, and --out is not written. The zeros that were
found before are kept in a file, which a line names; --resume FILE goes on from it. The motors must
not have been switched off meanwhile.

--serve simulates the rig of the file in real time on 127.0.0.1 and prints its port. Its driver is
docs/examples/served_rig.py:ServedRig. Its docstring shows how to let readings fail.

exit codes: 0 reached (--no-verdict: not failed; --hold and --serve: done); 1 not reached, or
stopped for any other cause than Ctrl-C, also by the watchdog, or a file that could not be written
where it should; 2 bad input; 130 Ctrl-C.
"""
PORT = 7600

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
cli.add_force_options(parser)
parser.add_argument("controller", metavar="CONTROLLER", nargs="?")
parser.add_argument("--driver", metavar="FILE.py:CLASS", help="the driver of your rig")
goal = parser.add_mutually_exclusive_group()
goal.add_argument("--theta", type=cli.finite, metavar="T", help="set point at T pi")
goal.add_argument("--omega", type=cli.positive, metavar="W", help="track at W pi rad/s, two cycles")
goal.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="set point in m"
)
goal.add_argument("--targets", metavar="FILE", help="paths of the tasks in the file, a CSV file")
goal.add_argument("--trajectory", metavar="FILE", help="path of the tip, as for run")
goal.add_argument("--hold", type=cli.finite, nargs="+", metavar="C", help="constant commands")
goal.add_argument("--zero", action="store_true", help="measure offsets and biases instead")
goal.add_argument("--serve", action="store_true", help="simulate the rig instead, in real time")
parser.add_argument("--periodic", action="store_true", help="repeat the path of --trajectory")
parser.add_argument("--gains", metavar="FILE", help="gains, a TOML file")
parser.settings(
    "duration", "period", "observer",
    period="control period in s (default: the paper's, 0.005 for other robots)",
    observer="disturbances to estimate, or FILE.py:CLASS",
)  # fmt: skip
parser.option("--ramp", cli.finite, "S", "time in which the commands rise and fall", 0.5)
parser.option("--stale", cli.positive, "S", "largest age of a reading", 0.1)
parser.option("--missed", cli.count, "N", "deadlines missed in a row that stop the run", 5)
parser.option("--lost", cli.positive, "S", "time over which the estimate is judged", 0.2)
parser.option("--late", cli.positive, "S", "time by which the loop may be late, and a period", 0.05)
parser.add_argument("--tolerance", type=cli.positive, metavar="M", help="tolerance in m")
parser.add_argument("--no-verdict", action="store_true", help="exit with 0 unless the run failed")
parser.output("--log", "FILE", "write the run as NPZ, or as CSV where FILE ends in .csv")
parser.output("--html", "FILE", "write the run as a page that replays it")
parser.option("--repeats", cli.count, "N", "--zero: number of pulls of each cable", 3)
parser.option("--reach", cli.positive, "M", "--zero: largest distance of a zero in m", 0.05)
parser.add_argument(
    "--pull", type=cli.positive, metavar="N",
    help="--zero: tension of a pull in N (default: 5 %% of the motor's largest, or more if the "
    "sensor is noisy)",
)  # fmt: skip
parser.output("--out", "FILE", "--zero: write the robot's file with the zeros that were found")
parser.add_argument(
    "--resume", metavar="FILE", help="--zero: go on from zeros that a stopped run has kept"
)
parser.add_argument("--view", action="store_true", help="show the run live in the browser")
parser.option("--seed", cli.whole, "N", "seed of the noise of --serve", 0)
cli.add_server_options(parser)
cli.add_json(parser)
parser.unused("--no-open --origin", lambda a: not a.view, "only --view opens a page")
parser.unused(
    "--port", lambda a: not (a.view or a.serve), "only --view and --serve serve something"
)
parser.unused("--periodic", lambda a: a.trajectory is None, "only with --trajectory")
parser.unused("--seed", lambda a: not a.serve, "only --serve has noise of its own")

parser.unused(
    "--repeats --reach --pull --out --resume", lambda a: not a.zero, "only --zero has them"
)
parser.unused(
    "--ramp --lost --duration --observer --gains --tolerance --no-verdict", lambda a: a.zero,
    "--zero has no controller",
)  # fmt: skip

HELD = 0.005  # s, the period of a robot that is not bundled


def command(arguments: cli.Arguments) -> int:
    """Make everything ready, run, and report."""
    check(arguments)
    model = cli.load_robot(arguments)
    if arguments.serve:
        return serve(model, arguments)
    from softdyn.validation.bench.fail_safe import RigLimits
    from softdyn.validation.bench.signals import Signals

    a = arguments
    limits = RigLimits(a.stale, a.missed, a.lost, a.ramp, a.late)
    if arguments.zero:
        with Signals().heard() as heard:
            return zero(model, arguments, limits, heard)
    drive = hold(model, arguments, limits) if arguments.hold else make(model, arguments, limits)
    with Signals().heard() as heard:
        return drive_and_report(drive, arguments, heard)


def drive_and_report(drive: Drive, arguments: cli.Arguments, heard: Signals) -> int:
    """Run, write the log and the page, and report; the exit code."""
    from softdyn.validation.bench.fail_safe import StopCause

    driven, results = run(drive, arguments, heard)
    log, model = driven.log, drive.loop.model
    report = log.report(arguments.tolerance)
    report |= {"stopped_by": driven.cause.value, "stopped": driven.reason}
    report["record"] = cli.record_beside(log, arguments.json)
    text = f"{log.summary(tolerance=arguments.tolerance)}\nstopped by     {driven.cause.value}"
    if not arguments.hold:
        line, report["process_noise"] = unmodelled(drive.observer)
        text = f"{text}\n{line}".rstrip()
    elif log.finite_samples:
        text = f"{text}\n{held_text(log, model)}"
    results.tell(report, arguments.json, text if log.finite_samples else "")
    if driven.cause is not StopCause.END:
        return stopped_code(driven)
    done = not log.failed if arguments.no_verdict or arguments.hold else report["reached"]
    return cli.PASSED if done and not results.lost else cli.FAILED


def run(drive: Drive, arguments: cli.Arguments, heard: Signals) -> tuple[DriveResult, cli.Results]:
    """Run, say what has stopped it, and write log and page."""
    from softdyn.validation.bench.fail_safe import StopCause

    driven = (
        view(drive, arguments, heard) if arguments.view
        else drive.run(progress=True, signals=heard)
    )  # fmt: skip
    if driven.error is not None:
        say_trace(driven.error)
    none = "" if driven.log.finite_samples else ", before the first reading"
    if driven.cause is not StopCause.END:
        print(f"stopped by {driven.cause.value}{none}: {driven.reason}", file=sys.stderr)
    results = cli.Results()
    if none:  # a log without a row, and a page of it, say nothing
        return driven, results
    if arguments.log is not None:
        results.save(partial(cli.save_log, driven.log), arguments.log)
    if arguments.html is not None:
        results.save(driven.log.show(drive.loop.model).save, arguments.html)
    return driven, results


def stopped_code(driven: DriveResult) -> int:
    """The exit code of a run that something has stopped."""
    from softdyn.validation.bench.fail_safe import StopCause

    return cli.INTERRUPTED if driven.cause is StopCause.CTRL_C else cli.FAILED


def zero(model: SoftModel, arguments: cli.Arguments, limits: Any, heard: Signals) -> int:
    """Measure the rig's zeros, and write the robot's file with them."""
    from dataclasses import asdict

    from softdyn.description.urdf_writer import write
    from softdyn.validation.bench.driver import make_driver
    from softdyn.validation.bench.fail_safe import StopCause
    from softdyn.validation.bench.kept_zeros import KeptZeros
    from softdyn.validation.bench.zeroing import ZeroSettings, zero_drive
    from softdyn.validation.files import write_text

    settings = ZeroSettings(arguments.repeats, arguments.reach, arguments.pull)
    found = KeptZeros(arguments.resume, model).read() if arguments.resume else []
    kept = KeptZeros(f"{arguments.out}.zeros.json", model)
    drive, zeroing = zero_drive(
        model, make_driver(arguments.driver, model), settings, limits=limits,
        period=arguments.period or HELD, log_to=arguments.log, found=found, keep=kept.write,
    )  # fmt: skip
    driven, results = run(drive, arguments, heard)
    if driven.finished:
        text = write(zeroing.robot(model.robot))
        results.save(lambda path: write_text(path, text), arguments.out)
        if not results.lost:
            kept.remove()
    elif zeroing.zeros and kept.wait():
        number = f"{len(zeroing.zeros)} of {model.nu} zeros"
        print(f"{kept.path}: {number} are kept; --resume goes on from there", file=sys.stderr)
    report = {
        "robot": model.name, "stopped_by": driven.cause.value, "stopped": driven.reason,
        "zeros": [asdict(found) for found in zeroing.zeros],
    }  # fmt: skip
    lines = [zeroing.text(), f"stopped by     {driven.cause.value}"]
    results.tell(report, arguments.json, "\n".join(lines))
    if driven.cause is not StopCause.END:
        return stopped_code(driven)
    return cli.FAILED if results.lost else cli.PASSED


def check(arguments: cli.Arguments) -> None:
    """Refuse arguments that do not belong together."""
    a = arguments
    aims = [a.theta, a.omega, a.target, a.targets, a.trajectory]
    if a.serve:
        if a.controller is not None or a.driver is not None:
            parser.error("argument --serve: not allowed with a CONTROLLER or --driver")
        return
    if a.driver is None:
        parser.error("argument --driver: expected FILE.py:CLASS, or --serve, got neither")
    if a.hold is not None or a.zero:
        if a.controller is not None:
            given = "--zero" if a.zero else "--hold"
            parser.error(f"argument {given}: not allowed with a CONTROLLER")
        if a.zero and a.out is None:
            parser.error("argument --out: expected a FILE for the zeros, got none")
    elif a.controller is None or all(aim is None for aim in aims):
        parser.error("expected a CONTROLLER with a target (--target, --theta …), or --hold")
    if a.ramp < 0:
        parser.error("argument --ramp: expected a number >= 0")


def make(model: SoftModel, arguments: cli.Arguments, limits: Any) -> Drive:
    """The run of a controller."""
    from softdyn.controllers.registry import one_line_errors
    from softdyn.validation.bench.drive import Drive
    from softdyn.validation.bench.driver import make_driver
    from softdyn.validation.loop.observation import make_observer

    experiment, more = goal_of(model, arguments)
    driver = make_driver(arguments.driver, model)
    with naming(model):
        controller = controller_of(model, arguments.controller, arguments.gains, **more)
    observer = make_observer(model, "file", arguments.observer or "")
    with one_line_errors(arguments.controller, "a command"):
        return Drive(
            model, controller, experiment, driver, observer,
            period=arguments.period or (experiment.period if model.bundled else HELD),
            duration=arguments.duration or experiment.duration, limits=limits,
            name=arguments.controller, log_to=arguments.log,
        )  # fmt: skip


def hold(model: SoftModel, arguments: cli.Arguments, limits: Any) -> Drive:
    """The run of constant commands."""
    from softdyn.validation.bench.drive import hold_commands
    from softdyn.validation.bench.driver import make_driver

    return hold_commands(
        model, arguments.hold, make_driver(arguments.driver, model),
        period=arguments.period or HELD, duration=arguments.duration or 3.0, limits=limits,
        log_to=arguments.log,
    )  # fmt: skip


def held_text(log: Any, model: SoftModel) -> str:
    """The readings at the end beside the model's at the estimated state."""
    import numpy as np

    state = model.state(log.q[-1], log.v[-1])
    expected = np.asarray(model.measure(state, log.acting[-1]))
    rows = zip(log.columns("measured"), log.measured[-1], expected, strict=True)
    lines = [f"{'reading':16}{'measured':>12}{'estimated':>12}"]
    lines += [f"{name:16}{read:12.5g}{there:12.5g} {unit}" for (name, unit), read, there in rows]
    return "\n".join(lines)


def view(drive: Drive, arguments: cli.Arguments, heard: Signals) -> DriveResult:
    """Run while a browser shows it; the page is served by another process."""
    from softdyn.validation.live import watching
    from softdyn.view.live.pacing import RATE

    loop = drive.loop
    columns = watching.columns_of(loop)
    every = max(round(1 / (RATE * loop.grid.period)), 1)
    with watching.open_watch_page(loop, arguments.port, origin=arguments.origin) as channel:
        print(channel.url, file=sys.stderr, flush=True)
        if not arguments.no_open:
            channel.open()
        channel.wait(watching.WAIT)

        def show(step: Any) -> None:
            if loop.steps % every == 0:
                clock, spent = drive.clock, loop.loop.nanoseconds / 1e3
                timing = {"misses": clock.missed, "wake_us": 1e6 * clock.late, "step_us": spent}
                channel.frame(watching.frame_of(columns, loop, step, pace=1.0, **timing))

        driven = drive.run(on_step=show, signals=heard)
        channel.state({"notice": driven.reason or "done", "paused": True})
        channel.leave(driven.log.show(loop.model).html())
    return driven


def serve(model: SoftModel, arguments: cli.Arguments) -> int:
    """Simulate the rig until the command is ended."""
    from softdyn.validation.bench.served import ServedRig
    from softdyn.validation.twin.twin import SimulationError

    with cli.ends_cleanly() as over:
        rig = ServedRig(model, arguments.port or PORT, arguments.seed)
        cli.say(f"serving {model.name} on 127.0.0.1:{rig.port}; Ctrl-C ends it")
        try:
            rig.serve(over)
        except SimulationError as error:
            print(f"error: the simulated rig diverged at {error.time:g} s: {error.reason}",
                  file=sys.stderr)  # fmt: skip
        if not over():
            return cli.FAILED  # told to die
    return cli.PASSED


def say_trace(error: BaseException) -> None:
    """Print the traceback of an exception of the user's own code."""
    import traceback

    from softdyn.exceptions import own_frames, printable

    own = own_frames(error)
    if own is not None:
        text = "".join(traceback.format_exception(type(error), error, own))
        print(printable(text), end="", file=sys.stderr)


main = cli.program(parser, command, __name__, can_be_killed=lambda a: not a.serve)
