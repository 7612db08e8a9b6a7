#!/usr/bin/env python3
"""The tip meets an obstacle: the published law, the law over a hold, and the same with barriers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    import numpy as np

    from softdyn import SetPoint, SoftModel
    from softdyn.controllers import SoftIdClfQp
    from softdyn.controllers.barriers import Sphere
    from softdyn.validation import Log

BALL = 0.08  # its radius, as a share of the robot's length
OFFSET = 0.6  # of its radius: how far beside the path it stands

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48).

A ball stands half-way to the set point, so that the path of the published law cuts it. The second
run is the same law over a hold of eps of its gains, the third has the ball as a barrier, and the
file's joint limits with --limits. With --runs, as many random balls and targets besides (targets:
the tip of random configurations; balls: beside the line to them), all with barriers.

exit codes: 0 no barrier was violated by more than 1 mm or 0.01 rad; 1 one was; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument(
    "--theta", type=cli.finite, default=0.0, metavar="T", help="set point (default: 0)"
)
parser.add_argument("--duration", type=cli.positive, default=3.0, metavar="S")
parser.add_argument("--limits", action="store_true", help="joint limits are barriers too")
parser.add_argument("--runs", type=int, default=0, metavar="N", help="random runs (default: 0)")
parser.add_argument("--seed", type=int, default=0, metavar="S")
parser.add_argument("--html", metavar="FILE", help="write a page that replays the three runs")
parser.add_argument("--log", metavar="PREFIX", help="save the three runs, for replay.py")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run, judge, report."""
    import numpy as np
    from tqdm import tqdm

    import softdyn
    from softdyn.controllers import SoftIdClfQp
    from softdyn.controllers.barriers import JointLimits
    from softdyn.validation import simulate
    from softdyn.validation.files import write_text
    from softdyn.validation.report.replay import comparison
    from softdyn.validation.studies import paper

    cli.check_outputs(arguments.json, arguments.html)
    model = softdyn.load(arguments.robot)
    setup = paper.setup_of(model)
    radius = BALL * setup.length
    tau = SoftIdClfQp(model).gains.eps
    options: dict[str, Any] = {"duration": arguments.duration, "period": setup.period}
    limits = [JointLimits(model)] if arguments.limits else []

    goal = setup.set_point(arguments.theta)
    runs = []
    for name, law in (
        ("published", SoftIdClfQp(model)),
        ("over the hold", SoftIdClfQp(model, horizon=tau)),
    ):
        runs.append((name, law, simulate(model, law, goal, **options)))
    ball = in_the_way([log.y for _, _, log in runs], radius)
    law = SoftIdClfQp(model, horizon=tau, barriers=[ball, *limits])
    runs.append(("with barriers", law, simulate(model, law, goal, **options)))
    rows = [figures(name, controller, log, ball) for name, controller, log in runs]
    if arguments.log is not None:
        for name, _, log in runs:
            log.save(f"{arguments.log}-{name.replace(' ', '-')}.npz")

    if arguments.html is not None:
        x, y, z = map(float, ball.centre)
        write_text(
            arguments.html,
            comparison(
                [log for _, _, log in runs],
                [model] * len(runs),
                [name for name, _, _ in runs],
                balls=[(x, y, z, radius)],
            ).html(),
        )

    rng = np.random.default_rng(arguments.seed)
    start = model.state(model.q0, np.zeros(model.nv)).y
    for k in tqdm(range(arguments.runs), disable=None, leave=False):
        target, ball = draw(model, rng, start, radius)
        controller = SoftIdClfQp(model, horizon=tau, barriers=[ball, *limits])
        log = simulate(model, controller, target, **options)
        rows.append(figures(f"random {k}", controller, log, ball))
    worst = max(row["violation"] for row in rows[2:])
    report = {
        "robot": model.name, "hold_s": tau, "limits": arguments.limits, "seed": arguments.seed,
        "radius_m": radius, "worst_violation": worst, "passed": worst <= 1.0, "runs": rows,
    }  # fmt: skip
    cli.write_report(report, arguments.json, summary(report))
    return cli.PASSED if report["passed"] else cli.FAILED


def in_the_way(paths: list[np.ndarray], radius: float) -> Sphere:
    """A ball beside a path (samples, 3) of the tip in the xz-plane that cuts as many as it can."""
    import numpy as np

    from softdyn.controllers.barriers import Sphere

    def depth(ball: Sphere) -> float:
        return min(ball.radius - np.linalg.norm(y - ball.centre, axis=1).min() for y in paths)

    balls = []
    for path in paths:
        left = np.linalg.norm(path - path[-1], axis=1)
        for share in (0.3, 0.4, 0.5, 0.6, 0.7):
            k = max(int(np.argmax(left < left[0] * share)), 1)
            along = path[k + 1] - path[k - 1]
            beside = np.array([-along[2], 0.0, along[0]]) / np.linalg.norm(along)
            for side in (-OFFSET, OFFSET):
                balls.append(Sphere(path[k] + side * radius * beside, radius))
    return max(balls, key=depth)


def draw(
    model: SoftModel, rng: np.random.Generator, start: np.ndarray, radius: float
) -> tuple[SetPoint, Sphere]:
    """A target that some configuration reaches, and a ball beside the line from `start` to it."""
    import numpy as np

    from softdyn import SetPoint
    from softdyn.controllers.barriers import Sphere

    while True:
        low, high = np.maximum(model.lower, -1.0), np.minimum(model.upper, 1.0)
        y = model.state(model.configuration(0.6 * rng.uniform(low, high)), np.zeros(model.nv)).y
        centre = start + rng.uniform(0.3, 0.7) * (y - start) + OFFSET * radius * rng.normal(size=3)
        ball = Sphere(centre, radius)
        if min(np.linalg.norm(start - centre), np.linalg.norm(y - centre)) > 1.2 * radius:
            return SetPoint(y), ball


def figures(name: str, controller: SoftIdClfQp, log: Log, ball: Sphere) -> dict[str, Any]:
    """What a run came to; `violation` in mm (joint limits: 0.01 rad), whichever is worse."""
    import numpy as np

    clearance = float((np.linalg.norm(log.y - ball.centre, axis=1) - ball.radius).min())
    rows = controller.barrier_rows
    return {
        "name": name,
        "final_error_cm": 100 * float(np.linalg.norm(log.error[-1])),
        "clearance_mm": 1e3 * clearance,
        "violation": rows.violation if rows is not None else -1e3 * clearance,
        "relaxed": rows.relaxed if rows is not None else 0,
        "fallbacks": log.fallbacks,
        "failed": log.failed,
        "step_us": float(np.median(log.step_us)),
    }


def summary(report: dict[str, Any]) -> str:
    """A line a run, random ones together."""
    lines = [f"{'':16} error cm  clearance mm  violation  gave way  step us"]
    for row in report["runs"][:3]:
        lines.append(
            f"{row['name']:16} {row['final_error_cm']:8.2f} {row['clearance_mm']:13.2f} "
            f"{row['violation']:10.2f} {row['relaxed']:9d} {row['step_us']:8.0f}"
        )
    if random := report["runs"][3:]:
        lines.append(
            f"{len(random)} random runs: worst violation "
            f"{max(row['violation'] for row in random):.2f} mm or 0.01 rad, "
            f"{sum(row['relaxed'] > 0 for row in random)} in which rows gave way, "
            f"{sum(row['fallbacks'] for row in random)} fallbacks, "
            f"{sum(row['failed'] for row in random)} that did not come nearer"
        )
    return "\n".join(lines)


main = cli.program(parser, command, __name__)
