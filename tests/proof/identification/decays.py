"""Share and time of a creeping spring, identified from steps and their decays: do intervals hold?

MuJoCo turns one joint (Runge-Kutta of order 4, a branch at its stages) by a step of torque, and
lets it go. A hundred noises of the angle (5 mrad, 12.5 Hz) give a hundred fits. The file's first
guess is off by 30 %. Of 95 % intervals about 95 should hold the truth.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from softdyn import SoftModel
from softdyn.commands import cli
from softdyn.dynamics.mimic import build
from softdyn.identification import Measurements, choose_unknowns, identify
from softdyn.validation import Twin

SHARE, TIME = 0.2, 0.8  # of the instantaneous stiffness; s
TORQUE, HELD, LONG = 3.0, 2.0, 4.0  # N m; s under the torque, and in all
PERIOD, NOISE, WRONG = 0.08, 5e-3, 1.3  # s, rad, factor of the first guess
ROTOR, DAMPING = 0.2, 0.4  # kg m², N m s/rad; a joint that swings at 3 rad/s
UNKNOWNS = ("relaxation_share", "relaxation_time", "stiffness", "damping")

parser = cli.Parser(__doc__, "exit codes: 0 within ±4 of 95 %; 1 not; 2 bad input.")
parser.add_argument("--runs", type=cli.count, default=100, metavar="N")
parser.add_argument("--seed", type=cli.whole, default=0, metavar="S", help="of the first run")
cli.add_json(parser)


def creeping(model: SoftModel, share: float = SHARE, time: float = TIME) -> SoftModel:
    """The robot with one branch beside each spring."""
    joints = tuple(
        replace(
            one,
            armature=ROTOR,
            damping=DAMPING,
            relaxation=((share / (1 - share) * one.stiffness, time),),
        )
        for one in model.robot.moving_joints
    )
    fixed = tuple(one for one in model.robot.joints if not one.moves)
    return build(replace(model.robot, joints=fixed + joints))


def decay(model: SoftModel, seed: int) -> Measurements:
    """The angle of a robot of one joint, measured under a step of torque and after it."""
    model = creeping(model)
    twin, steps = Twin(model, timestep=PERIOD / 20, integrator="rk4"), round(LONG / PERIOD)
    t = PERIOD * np.arange(steps)
    u = np.where(t < HELD, TORQUE, 0.0)[:, None]
    q = np.empty((steps, 1))
    for k in range(steps):
        q[k] = twin.qpos
        twin.advance(u[k], 20)
    noise = NOISE * np.random.default_rng(seed).normal(size=q.shape)
    return Measurements(t, u, (f"q.{model.joint_names[0]}",), q + noise)


def fitted(model: SoftModel, data: Measurements) -> dict[str, bool]:
    """Whether the interval of each kind of unknown holds the truth, from a wrong first guess."""
    truth = dict(zip(UNKNOWNS, (SHARE, TIME, model.stiffness[0], DAMPING), strict=True))
    guess = creeping(model, SHARE * WRONG, TIME * WRONG)
    found = identify(guess, data, choose_unknowns(guess, UNKNOWNS), hold_out=0.0)
    return {
        one.parameter.kind.name: bool(
            one.identified and abs(one.value - truth[one.parameter.kind.name]) <= one.half
        )
        for one in found.estimates
    }


def command(arguments: cli.Arguments) -> int:
    """Fit all runs and print how many intervals hold."""
    from tests.dynamics.test_relaxation import one_joint

    model = one_joint()
    seeds = range(arguments.seed, arguments.seed + arguments.runs)
    inside = []
    for seed in seeds:
        inside.append(fitted(model, decay(model, seed)))
        print(seed, *inside[-1].values(), file=sys.stderr, flush=True)
    counts = {name: sum(one[name] for one in inside) for name in UNKNOWNS}
    text = "\n".join(f"{name:18}{count} of {len(inside)}" for name, count in counts.items())
    cli.write_report({"runs": len(inside), "inside": counts}, arguments.json, text)
    shares = [100 * counts[name] / len(inside) for name in UNKNOWNS[:2]]
    return cli.PASSED if all(abs(one - 95) <= 4 for one in shares) else cli.FAILED


main = cli.program(parser, command, __name__)
