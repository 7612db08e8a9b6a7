"""Targets that a robot can reach: points, paths and rates from its statics alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from softdyn.checks import array, instance, number, whole
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.references import Reference
from softdyn.statics.branch import approach, input_scale
from softdyn.statics.equilibria import rest
from softdyn.statics.equilibrium import Equilibrium
from softdyn.statics.samples import sample_between, sample_rests

RAYS, BETWEEN = 20, 30  # rests that are sampled: along random inputs, and in the gaps
ROOM = 0.95  # of the bounds that a rest's input may take: a law needs the others
APART = 0.02  # of the robot's length, at least, between two points
AXIS = 0.08  # largest semi-axis of a path, as a share of the robot's length
ON_PATH = 0.01  # of the length: a point that a rest comes so close to is reachable
SHORTEST, LONGEST = 2.0, 6.0  # s of a cycle
STATIONS = 12  # points of a path that are tried


def spread_rests(model: SoftModel, count: int, seed: int = 0) -> tuple[Equilibrium, ...]:
    """Stable rests whose tips are spread over the reachable set, the outermost first.

    Each is the sampled rest (`sample_rests`, `sample_between`) that is farthest from the rest
    without input and from all before it. Its input has room to all bounds; no joint is at a limit,
    unless every sample has one there.

    Parameters
    ----------
    count : int
        At most so many.
    seed : int
        Of the samples.

    Raises
    ------
    InputError
        A robot whose inputs move its tip nowhere.
    StaticsError
        A robot that rests nowhere.
    """
    start, count = rest(model), whole("count", count, 1)
    samples = list(sample_rests(model, RAYS, seed))
    samples += sample_between(samples, BETWEEN, seed)
    stable = [one for one in samples if one.stable and _has_room(one)]
    # a robot whose strokes end at stops is always at some of them
    left = [one for one in stable if not one.held.any()] or stable
    found: list[Equilibrium] = []
    distance = np.array([np.linalg.norm(one.y - start.y) for one in left])
    size = max(model.robot.length, 1e-6)
    while len(found) < count and len(left) and distance.max() > APART * size:
        found.append(left[int(np.argmax(distance))])
        distance = np.minimum(distance, [np.linalg.norm(one.y - found[-1].y) for one in left])
    if not found:
        expected = f"inputs that move the tip of {model.robot.path} from one stable rest to another"
        raise InputError("robot", expected, "none that were found")
    return tuple(found)


def _has_room(one: Equilibrium) -> bool:
    """Whether no input is close to the bound that it moves towards; slack is no such bound."""
    model = one.model
    origin = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
    room = np.where(one.u > origin, model.u_max - origin, origin - model.u_min)
    return bool((np.abs(one.u - origin) <= ROOM * room).all())


@dataclass(frozen=True, eq=False)
class Loop:
    """An ellipse anywhere in space, y = centre + a cos ωt + b sin ωt.

    Attributes
    ----------
    centre, a, b : ndarray, (3,)
        Centre and both semi-axes (m).
    omega : float
        ω (rad/s).
    """

    centre: np.ndarray
    a: np.ndarray
    b: np.ndarray
    omega: float

    def __post_init__(self) -> None:
        for name in ("centre", "a", "b"):
            object.__setattr__(self, name, array(name, getattr(self, name), (3,)))
        if number("omega", self.omega) == 0:
            raise InputError("omega", "a rate that is not zero", self.omega)

    def __call__(self, t: float) -> Reference:
        """The reference at time t (s)."""
        angle, rate = self.omega * number("t", t), self.omega
        cos, sin = math.cos(angle), math.sin(angle)
        offset = cos * self.a + sin * self.b
        return Reference(
            self.centre + offset, rate * (cos * self.b - sin * self.a), -(rate**2) * offset
        )

    @property
    def period(self) -> float:
        """Duration of one cycle (s)."""
        return 2 * math.pi / self.omega


def loop_around(one: Equilibrium) -> Loop | None:
    """A path about a rest's tip that stable rests follow, its rate that of the robot; None without.

    Its axes are the two directions that the inputs move the tip in most, as the rest's linear
    response says; they shrink until rests come close to every one of its points. ω is half the
    rate |s| of the slowest pole there, but a cycle takes `SHORTEST` to `LONGEST`.
    """
    size = max(instance("one", one, Equilibrium, "an Equilibrium").model.robot.length, 1e-6)
    response = one.tip_sensitivity * input_scale(one.model, one)
    directions, gains, _ = np.linalg.svd(response, full_matrices=False)
    if not gains.size or gains[0] <= 0:
        return None
    gains = np.append(gains, 0.0)[:2] / gains[0]
    second = directions[:, min(1, directions.shape[1] - 1)]
    a, b = AXIS * size * directions[:, 0], AXIS * size * max(gains[1], 0.0) * second
    slowest = float(np.abs(one.poles).min()) / 2
    omega = float(np.clip(slowest, 2 * math.pi / LONGEST, 2 * math.pi / SHORTEST))
    for _ in range(4):
        loop = Loop(one.y, a, b, omega)
        if all(_follows(one, loop(t).y, size) for t in _times(loop)):
            return loop
        a, b = a / 2, b / 2
    return None


def _times(loop: Loop) -> np.ndarray:
    return np.arange(STATIONS) / STATIONS * loop.period


def _follows(one: Equilibrium, point: np.ndarray, size: float) -> bool:
    near = approach(one, point, 30, stay_stable=True)
    return bool(np.linalg.norm(near.y - point) < ON_PATH * size and _has_room(near))
