"""Points of a neutral form at rest: the least potential energy of weight and springs.

There are no inputs. Stops bound the joints, and dry friction and rubbing cables do not count.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from softdyn.validation.mjcf.comparison.dynamics import SCALARS, rebuild
from softdyn.validation.mjcf.comparison.finding import coefficients, force
from softdyn.validation.mjcf.comparison.neutral import Neutral, NeutralTendon, Part

STEP = 1e-6  # rad, m: of the differences of forces
ROUNDS = 20  # of Newton's method behind the search
STILL = 1e-9  # rad, m: the last step of a robot at rest


def springs_of(robot: Neutral) -> list[Part | NeutralTendon]:
    """The joints and tendons with a spring."""
    items: tuple[Part | NeutralTendon, ...] = (*robot.parts, *robot.cables)
    return [item for item in items if sprung(item)]


def sprung(item: Part | NeutralTendon) -> bool:
    """Whether a joint or a tendon has a spring."""
    return any(coefficients(item, "stiffness"))


def has_rest(robot: Neutral) -> bool:
    """Whether springs hold the robot: without couplings, servos, balls and sprung wraps."""
    held = springs_of(robot)
    wrapped = any(isinstance(item, NeutralTendon) and item.shapes for item in held)
    moved = any(not motor.takes_force for motor in robot.motors)
    scalar = all(part.kind in SCALARS for part in robot.parts)
    tied = robot.couplings or robot.equalities
    return bool(held) and scalar and not (tied or moved or wrapped)


def tip_points(robot: Neutral) -> list[tuple[int, np.ndarray]]:
    """Part and place (3,) at zero of the points that show a rest (m).

    They are the link origin, the centre of mass and the frames of each part that carries no other.
    """
    last = [k for k in range(len(robot.parts)) if not robot.children(k)]
    found = [(k, robot.parts[k].pose.translation) for k in last]
    found += [(k, robot.parts[k].inertia.com) for k in last]
    return found + [
        (frame.part, frame.pose.translation)
        for frame in robot.frames.values() if frame.part in last
    ]  # fmt: skip


def resting_points(robot: Neutral, points: Sequence[tuple[int, np.ndarray]]) -> np.ndarray | None:
    """Places (points, 3) of points of some parts at the rest next to q = 0 (m).

    None for a robot that no spring holds, and if the search finds no stable rest.

    Parameters
    ----------
    robot : Neutral
    points : sequence of (int, ndarray)
        As those of `tip_points`.
    """
    if not has_rest(robot):
        return None
    from scipy.optimize import minimize  # imported only here, because it is slow to import

    model = rebuild(robot)
    data = mujoco.MjData(model)
    energy = _energy(robot, model, data)
    lower = np.array([part.lower for part in robot.parts])
    upper = np.array([part.upper for part in robot.parts])
    size = sum(abs(coefficients(item, "stiffness")[0]) for item in springs_of(robot)) or 1.0
    found = minimize(
        lambda q: tuple(value / size for value in energy(q)), np.clip(0.0, lower, upper), jac=True,
        method="L-BFGS-B", bounds=list(zip(lower, upper, strict=True)),
        options={"maxiter": 5000, "maxfun": 10000, "ftol": 1e-16, "gtol": 1e-12},
    )  # fmt: skip
    q = _settled(energy, found.x, lower, upper)
    if q is None:
        return None
    energy(q)
    bodies = {k: int(model.jnt_bodyid[model.joint(str(k)).id]) for k, _ in points}
    return np.array([
        data.xpos[bodies[k]]
        + data.xmat[bodies[k]].reshape(3, 3) @ (place - robot.parts[k].point)
        for k, place in points
    ])  # fmt: skip


def _energy(
    robot: Neutral, model: mujoco.MjModel, data: mujoco.MjData
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """Joint coordinates (n,) → potential energy (J) and its gradient (n,), in the parts' order."""
    joints = [model.joint(str(k)).id for k in range(len(robot.parts))]
    place, row = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    weight = model.body_mass * (1.0 - model.body_gravcomp)
    springs = [(k, part) for k, part in enumerate(robot.parts) if sprung(part)]
    cables = [(k, cable) for k, cable in enumerate(robot.cables) if sprung(cable)]
    arms = np.zeros((model.ntendon, model.nv))

    def energy(q: np.ndarray) -> tuple[float, np.ndarray]:
        data.qpos[place], data.qvel[:] = q, 0.0
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        value = -float(weight @ (data.xipos @ model.opt.gravity))
        slope = (data.qfrc_bias - data.qfrc_gravcomp)[row]
        for k, part in springs:
            x = q[k] - part.rest
            value += _stored(part, x)
            slope[k] += force("stiffness", coefficients(part, "stiffness"), x)
        if cables:
            sparse = model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
            mujoco.mju_sparse2dense(arms, data.ten_J, *sparse)
        for k, cable in cables:
            low, high = cable.rest
            x = max(data.ten_length[k] - high, 0.0)
            x += 0.0 if cable.slack else min(data.ten_length[k] - low, 0.0)
            value += _stored(cable, x)
            slope += force("stiffness", coefficients(cable, "stiffness"), x) * arms[k, row]
        return value, slope

    return energy


def _stored(item: Part | NeutralTendon, x: float) -> float:
    """The energy of a spring (J) at a displacement: the integral of its force."""
    return sum(c * x ** (k + 2) / (k + 2) for k, c in enumerate(coefficients(item, "stiffness")))


def _settled(
    energy: Callable[[np.ndarray], tuple[float, np.ndarray]],
    q: np.ndarray, lower: np.ndarray, upper: np.ndarray,
) -> np.ndarray | None:  # fmt: skip
    """The stable rest near q by Newton's method on the joints that no stop holds, or None."""
    for _ in range(ROUNDS):
        slope = energy(q)[1]
        free = ~(((q <= lower) & (slope > 0)) | ((q >= upper) & (slope < 0)))
        if not free.any():
            return q
        turns = STEP * np.eye(len(q))[free]
        H = np.array([(energy(q + by)[1] - energy(q - by)[1])[free] for by in turns]) / (2 * STEP)
        if np.linalg.eigvalsh((H + H.T) / 2)[0] <= 0:
            return None
        step = np.zeros(len(q))
        step[free] = np.linalg.solve(H, -slope[free])
        moved = np.clip(q + step, lower, upper)
        if np.abs(moved - q).max() < STILL:
            return moved
        q = moved
    return None
