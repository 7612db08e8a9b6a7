"""Force and payload at the tip, estimated from lengths and a camera: docs/rigs.md."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from softdyn.commands import cli

EPILOG = """\
`best` holds set points with the estimates alone. MuJoCo applies the force at its exact time.
Lengths have 0.5 mm of noise at 1 kHz, the camera 1 mm at 60 Hz, 30 ms late. At the end the error is
compared with the filter's covariance, along the directions in which the tip can move: `inside`
counts errors within the 95 % region, `near` those of at most 10 % of the force (its amplitude), or
2 g. The rows go to tests/proof/documents/measured/forces.json; then `python -m tests.proof tables`
writes the table.

exit codes: 0 done; 2 bad input.
"""
ROBOTS, POINTS = ("finger", "spirob"), (0.5, 1.0)
KINDS = {  # memory (s): a force that stays, one that changes, a payload
    "constant": 1e9,
    "sine": 1.0,
    "payload": 300.0,
}
LONGEST = 5e-4  # s, of the prediction: it errs less than the readings tell
LEAST, LARGEST, FREQUENCY, MASS = 0.1, 1.0, 0.5, 0.02  # N, N, Hz, kg
NEAR, LIGHT = 0.1, 0.002  # of a force; kg
LEVEL, SECONDS = 0.95, 4.0
SENSORS = "lengths=0.0005@1000,tip=0.001@60+0.03"
MOVES = 1e-6  # of the largest singular value of J
COLUMNS = (
    ("robot", "robot", ""),
    ("θ (π)", "theta", "g"),
    ("at the tip", "kind", ""),
    ("runs", "runs", "d"),
    ("in the 95 % region", "inside", "d"),
    ("at most 10 % off", "near", "d"),
    ("error, median (%)", "median_pct", ".2f"),
    ("worst (%)", "worst_pct", ".2f"),
    ("deviation (%)", "deviation_pct", ".2f"),
)

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robots", nargs="*", metavar="ROBOT", help="default: finger and spirob")
parser.add_argument("--runs", type=cli.count, default=25, metavar="N", help="of each set point")
parser.add_argument("--seed", type=cli.whole, default=0, metavar="S")


def command(arguments: cli.Arguments) -> int:
    """Run all cases; the rows of a robot are written when it is done."""
    import numpy as np

    from softdyn import InputError
    from tests.proof.documents.measured_rows import replace_rows
    from tests.proof.documents.settings import MEASURED

    path = MEASURED / "forces.json"
    for robot in arguments.robots or ROBOTS:
        if robot not in ROBOTS:
            raise InputError("ROBOT", " or ".join(ROBOTS), robot)
        found = []
        for kind in KINDS:
            for theta in POINTS:
                seeds = range(arguments.seed, arguments.seed + arguments.runs)
                errors = np.array([run(robot, theta, kind, seed) for seed in seeds])
                inside, off, deviation = errors.T
                limit = LIGHT / MASS if kind == "payload" else NEAR
                found.append({
                    "robot": robot, "theta": theta, "kind": kind, "runs": len(errors),
                    "inside": int(np.sum(inside <= 1)), "near": int(np.sum(off <= limit)),
                    "median_pct": 100 * float(np.median(off)), "worst_pct": 100 * float(off.max()),
                    "deviation_pct": 100 * float(np.median(deviation)),
                })  # fmt: skip
                print(found[-1], flush=True)
        replace_rows(path, "robot", [robot], found, ROBOTS)
    return cli.PASSED


def run(robot: str, theta: float, kind: str, seed: int) -> tuple[float, float, float]:
    """Squared error over its bound at 95 %, and error and deviation as shares of the force."""
    import numpy as np
    from scipy.special import chdtri

    import softdyn
    from softdyn.commands.observe import sensors_of
    from softdyn.controllers import best
    from softdyn.estimation import Ekf, EkfParameters
    from softdyn.validation import Rig, paper
    from softdyn.validation.loop.closed_loop import ClosedLoop
    from softdyn.validation.loop.settings import RunOptions
    from softdyn.validation.twin.plant_errors import PlantErrors

    model, rng = softdyn.load(robot), np.random.default_rng(seed)
    sensors = sensors_of(model, SENSORS)
    moves = np.linalg.svd(model.state(model.q0 + 0.1, np.zeros(model.nv)).J, full_matrices=False)
    axes = moves[0][:, moves[1] > MOVES * moves[1][0]]
    direction = axes @ rng.normal(size=axes.shape[1])
    force = rng.uniform(LEAST, LARGEST) * direction / np.linalg.norm(direction)
    turn, phase = (2 * np.pi * FREQUENCY, rng.uniform(0, 2 * np.pi)) if kind == "sine" else (0, 0)
    loaded, name = (True, "payload") if kind == "payload" else (False, "tip_force")

    given = EkfParameters(memory=KINDS[kind], longest=LONGEST)
    observer = Ekf(model, sensors, (name,), parameters=given)
    rig = Rig(sensors=sensors, seed=seed, plant=PlantErrors(payload=MASS * loaded))
    goal = paper.set_point(robot, theta=theta)
    options = RunOptions.of({"duration": SECONDS, "rig": rig, "observer": observer})
    loop = ClosedLoop(model, best(model), goal, options)  # MuJoCo's compiler calls a callback, too
    with pulling(lambda t: (not loaded) * np.cos(turn * t + phase) * force):
        log = loop.run()
    assert log.disturbances is not None
    found, covariance = log.disturbances[-1], observer.covariance_of(name)
    error, size = found - MASS, MASS
    if not loaded:
        truth, size = np.cos(turn * log.t[-1] + phase) * force, float(np.linalg.norm(force))
        error, covariance = axes.T @ (found - truth), axes.T @ covariance @ axes
    squared = error @ np.linalg.solve(covariance, error)
    return (
        float(squared / chdtri(len(error), 1 - LEVEL)), float(np.linalg.norm(error) / size),
        float(np.sqrt(np.diag(covariance).max()) / size),
    )  # fmt: skip


@contextmanager
def pulling(force: Callable[[float], Any]) -> Iterator[None]:
    """Let a force (3,) of time (s) act at the tip of every MuJoCo model meanwhile."""
    import mujoco
    import numpy as np

    from softdyn.validation.twin.build import TASK_SITE

    def pull(model: Any, data: Any) -> None:
        J, site = np.zeros((3, model.nv)), model.site(TASK_SITE).id
        mujoco.mj_jacSite(model, data, J, None, site)
        data.qfrc_passive[:] += J.T @ force(data.time)

    mujoco.set_mjcb_passive(pull)
    try:
        yield
    finally:
        mujoco.set_mjcb_passive(None)


main = cli.program(parser, command, __name__)
