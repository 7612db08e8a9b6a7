#!/usr/bin/env python3
"""The time of a control step, from the state to the input, and its share of the period."""

from __future__ import annotations

from typing import TYPE_CHECKING

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn import SoftModel
    from softdyn.validation.loop.experiment import Experiment

THETA = 0.5  # the set point of the paper's robots, in multiples of pi
WARM_UP = 0.1  # s of a loop that is not measured; it compiles and loads
EPILOG = """\
ROBOT and CONTROLLER are named as for softdyn run; your own controller is FILE.py:CLASS. The step is
timed in a closed loop with the twin: the State, the controller and all checks of both, in one
thread. The loop goes to the set point at 0.5 pi, or to an equilibrium that statics finds for a
robot that is not in the paper.

Times are meaningful only on an idle machine.

exit codes: 0 measured; 1 the loop failed before its end; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
parser.add_argument("controller", metavar="CONTROLLER")
goal = parser.add_mutually_exclusive_group()
goal.add_argument("--theta", type=cli.finite, metavar="T", help="set point at T pi")
goal.add_argument("--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="in m")
parser.add_argument("--gains", metavar="FILE", help="gains, a TOML file")
parser.add_argument("--period", type=cli.positive, metavar="S", help="control period in s")
parser.option("--seconds", cli.positive, "S", "length of the loop", 5.0)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run the loop, and report the times of its steps."""
    import gc

    import numpy as np

    from softdyn.commands.run import controller_of, naming
    from softdyn.controllers.registry import one_line_errors
    from softdyn.validation import simulate

    model = cli.load_robot(arguments)
    experiment = experiment_of(model, arguments)
    name = arguments.controller
    gc.disable()  # as in a loop whose period counts
    try:
        for seconds in (WARM_UP, arguments.seconds):
            with naming(model):
                controller = controller_of(model, name, arguments.gains)
            with one_line_errors(name, "a command"):
                if hasattr(controller, "prepare"):  # else its first step would wait for a search
                    controller.prepare(experiment.reference)
                log = simulate(
                    model, controller, experiment, duration=seconds, name=name, progress=True
                )
    finally:
        gc.enable()
    times, period = log.step_us[np.isfinite(log.step_us)], 1e6 * log.period
    median, p99 = np.percentile(times, (50, 99)) if len(times) else (np.nan, np.nan)
    report = {
        "robot": model.bundled or model.name, "controller": log.controller,
        "median_us": float(median), "p99_us": float(p99), "period_us": period, "steps": len(times),
    }  # fmt: skip
    text = (
        f"{report['robot']}, {log.controller}: median {median:.1f} us, p99 {p99:.1f} us, "
        f"{100 * median / period:.2g} % and {100 * p99 / period:.2g} % of the control period "
        f"of {period:g} us ({len(times)} steps)"
    )
    if not log.complete:
        text += f"\n{log.reason}"
    cli.write_report(report, arguments.json, text)
    return cli.PASSED if log.complete else cli.FAILED


def experiment_of(model: SoftModel, arguments: cli.Arguments) -> Experiment:
    """The loop's set point: the one asked for, the paper's, or an equilibrium."""
    from dataclasses import replace

    from softdyn.validation import paper
    from softdyn.validation.studies.study_targets import study_experiments

    theta, target = arguments.theta, arguments.target
    if theta is None and target is None:
        if model.bundled not in paper.ROBOTS:
            found = study_experiments(model, 1)[0]
            return found if arguments.period is None else replace(found, period=arguments.period)
        theta = THETA
    return paper.experiment(model, theta=theta, target=target, period=arguments.period)


main = cli.program(parser, command, __name__)
