#!/usr/bin/env python3
"""How well and how fast sensors show a robot's state; an observer over recorded data."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    import numpy as np

    from softdyn import SoftModel
    from softdyn.description.rig import Sensor
    from softdyn.estimation import Observability
    from softdyn.statics import Equilibrium

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

--sensors is "file", or kinds of sensors with NOISE[@RATE[+LATENCY]] in SI units and Hz:
"lengths=0.0005@1000,tip=0.001@60+0.03". Kinds are lengths and tensions of the driven tendons,
joints, tip (position) and pose (of the tip).

The filter gets the readings of a robot that rests, from a start that is wrong by 0.2 rad in every
joint. The answer holds near this rest. --log FILE answers along a run that softdyn run --log saved,
with noise in the readings. The table has the error of each joint that is expected at the end,
without readings and with them; the picture has the arm coloured by it.

--data runs the filter over a CSV file with the columns t, command.INPUT or u.INPUT, and
measured.SENSOR, such as the CSV of a run with --rig. The residuals of its sensors show biases,
wrong noise and what the model lacks; `softdyn identify ROBOT FILE --free sensor_bias
sensor_latency` fits biases and latencies to the same file.

exit codes: 0 done, the wrong start was forgotten; 1 it was not; 2 bad input.
"""
SENSOR = re.compile(r"(\w+)=([^@+,]+)(?:@([^@+,]+)(?:\+([^@+,]+))?)?")


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
parser.option("--sensors", str, "WHICH", "file, or a list", "file")
parser.option("--disturbances", str, "NAMES", "disturbances to estimate, e.g. tip_force", "")
goal = parser.add_mutually_exclusive_group()
goal.add_argument("--theta", type=cli.finite, metavar="T", help="rest near the set point at T pi")
goal.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="rest near a point in m"
)
goal.add_argument("--log", metavar="FILE", help="along a run, a log of softdyn run")
goal.add_argument("--data", metavar="FILE", help="recorded data, a CSV file")
parser.option("--period", cli.positive, "S", "time between steps in s", 0.002)
parser.option("--seconds", cli.positive, "S", "time to observe in s", 1.0)
parser.output("--plot", "FILE", "draw the arm coloured by its expected error: .png or .pdf")
cli.add_json(parser)
parser.unused("--period --seconds", lambda a: a.log or a.data, "the file has the times")


def command(arguments: cli.Arguments) -> int:
    """Observe and report."""
    from softdyn.estimation import observe
    from softdyn.validation.loop.pictures import plot_style

    if arguments.plot is not None:
        if arguments.data is not None:
            parser.error("argument --plot: not allowed with --data")
        plot_style.check_path(arguments.plot)
    model = cli.load_robot(arguments)
    sensors = sensors_of(model, arguments.sensors)
    disturbances = [word for word in arguments.disturbances.split(",") if word]
    if arguments.data is not None:
        return observe_file(model, sensors, disturbances, arguments)
    if arguments.log is not None:
        found, q = along_run(model, sensors, disturbances, arguments.log)
    else:
        cli.doing("looks for the rest")
        rest, times = rest_of(model, arguments), (arguments.period, arguments.seconds)
        cli.doing(f"observes {arguments.seconds:g} s")
        found = observe(rest, sensors, disturbances, period=times[0], seconds=times[1])
        q = rest.q
    if arguments.plot is not None:
        from softdyn.validation.report.uncertainty_figure import draw

        draw(model, q, found, arguments.plot)
    cli.write_report(found.to_dict(), arguments.json, str(found))
    return cli.PASSED if found.forgotten is not None else cli.FAILED


def along_run(
    model: SoftModel, sensors: tuple[Sensor, ...], disturbances: list[str], path: str
) -> tuple[Observability, np.ndarray]:
    """The answer along a saved run, and the run's last q."""

    from softdyn import InputError
    from softdyn.estimation import observe_run

    log = cli.read_log(path)
    if log.q.shape[1] != model.nq or log.u.shape[1] != model.nu:
        raise InputError(path, f"a run of {model.name}", f"one of {log.robot}")
    states = [model.state(q, v) for q, v in zip(log.q, log.v, strict=True)]
    commands = log.u if log.command is None else log.command
    sent = [commands[0], *commands]
    zero = model.relaxed
    return observe_run(model, log.t, states, zero, sent, sensors, disturbances, seed=0), log.q[-1]


def observe_file(
    model: SoftModel,
    sensors: tuple[Sensor, ...],
    disturbances: list[str],
    arguments: cli.Arguments,
) -> int:
    """Run the filter over recorded data."""
    from softdyn.estimation import Ekf, observe_data

    data = observe_data(model, Ekf(model, sensors, disturbances), arguments.data)
    cli.write_report(data.to_dict(), arguments.json, str(data))
    return cli.PASSED


def rest_of(model: SoftModel, arguments: cli.Arguments) -> Equilibrium:
    """The equilibrium that is asked for."""
    from softdyn import statics
    from softdyn.validation import paper

    if arguments.theta is None and arguments.target is None:
        return statics.rest(model)
    goal = paper.experiment(model, theta=arguments.theta, target=arguments.target)
    return statics.inputs_for_tip(model, goal.reference(0.0).y).nearest


def sensors_of(model: SoftModel, words: str) -> tuple[Sensor, ...]:
    """The sensors that --sensors means.

    Raises
    ------
    InputError
        A word of another form, an unknown kind, a file without sensors.
    """
    from softdyn import InputError
    from softdyn.description.rig import Sensor, SensorKind

    if words == "file":
        if not model.robot.sensors:
            raise InputError("--sensors", "a list, the file having none", repr(words))
        return model.robot.sensors
    driven = dict.fromkeys(actuator.tendon for actuator in model.robot.actuators)
    tip = [{"link": model.robot.task}]
    known: dict[str, tuple[SensorKind, list[dict[str, Any]]]] = {
        "lengths": (SensorKind.LENGTH, [{"tendon": name} for name in driven]),
        "tensions": (SensorKind.TENSION, [{"tendon": name} for name in driven]),
        "joints": (SensorKind.JOINT, [{"joint": name} for name in model.joint_names]),
        "tip": (SensorKind.POSITION, tip),
        "pose": (SensorKind.POSE, tip),
    }
    sensors = []
    for word in words.split(","):
        found = SENSOR.fullmatch(word.strip())
        if found is None or found[1] not in known:
            expected = f"KIND=NOISE[@RATE[+LATENCY]] with KIND {', '.join(known)}"
            raise InputError("--sensors", expected, repr(word))
        noise, rate, latency = (
            0.0 if text is None else _not_negative(word, text) for text in found.groups()[1:]
        )
        kind, places = known[found[1]]
        if not places:
            expected = f"{found[1]} of a robot with driven tendons"
            raise InputError("--sensors", expected, "one without inputs")
        sensors += [
            Sensor(
                f"{found[1]} {part}", kind, noise=(noise,), rate=rate, latency=latency,
                **place,
            )
            for place in places for part in place.values()
        ]  # fmt: skip
    return tuple(sensors)


def _not_negative(word: str, text: str) -> float:
    from softdyn import InputError
    from softdyn.checks import number

    try:
        return number(f"--sensors {word}", float(text), lower=0.0)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"--sensors {word}", "a number", repr(text)) from None


main = cli.program(parser, command, __name__)
