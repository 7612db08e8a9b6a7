"""Points, paths with their rates, and directions of the tip that a robot's statics reach."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from softdyn.checks import array, instance, instances, number, unit, whole
from softdyn.copies import Frozen
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.references import Reference
from softdyn.statics.branch import approach, input_scale
from softdyn.statics.equilibria import rest
from softdyn.statics.equilibrium import Equilibrium
from softdyn.statics.samples import sample_between, sample_rests
from softdyn.tasks.link_motion import LinkKinematics

RAYS, BETWEEN = 20, 30  # numbers of sampled random inputs, and of sampled points in the gaps
ROOM = 0.95  # largest share of the bounds for a target's input; a controller needs the rest
APART = 0.02  # of the robot's length, the least distance of two points
AXIS = 0.08  # of the robot's length, the largest semi-axis of a path
ON_PATH = 0.01  # of the length; a point with an equilibrium this close is reachable
SHORTEST, LONGEST = 2.0, 6.0  # s, duration of a cycle
STATIONS = 12  # number of points of a path that are checked


def spread_rests(model: SoftModel, count: int, seed: int = 0) -> tuple[Equilibrium, ...]:
    """Stable or neutral equilibria whose tips are spread over the reachable set, outermost first.

    Each is the sampled equilibrium (`sample_rests`, `sample_between`) whose tip is farthest from
    that of `rest` and from those chosen before. Its input has room to all bounds. No joint is at a
    limit, unless every sample has one there.

    Parameters
    ----------
    count : int
        Largest number of equilibria.
    seed : int
        Seed of the samples.

    Raises
    ------
    InputError
        If the inputs do not move the robot's tip.
    StaticsError
        If the robot has no equilibrium.
    """
    start, count = rest(model), whole("count", count, 1)
    samples = list(sample_rests(model, RAYS, seed))
    samples += sample_between(samples, BETWEEN, seed)
    stable = [one for one in samples if not one.unstable and _has_room(one)]
    # some robots have a joint at a stop in every equilibrium
    left = [one for one in stable if not one.held.any()] or stable
    found: list[Equilibrium] = []
    distance = np.array([np.linalg.norm(one.y - start.y) for one in left])
    size = max(model.robot.length, 1e-6)
    while len(found) < count and len(left) and distance.max() > APART * size:
        found.append(left[int(np.argmax(distance))])
        distance = np.minimum(distance, [np.linalg.norm(one.y - found[-1].y) for one in left])
    if not found:
        expected = f"two stable equilibria of {model.robot.path} with different tips"
        raise InputError("robot", expected, "fewer")
    return tuple(found)


@dataclass(frozen=True, eq=False)
class ReachCell(Frozen):
    """A cube of tip positions, and the directions of the tip's link at equilibria in it.

    Attributes
    ----------
    centre : ndarray, (3,)
        Centre of the cube (m).
    rests : tuple of Equilibrium
        The equilibria with their tips in it.
    direction : ndarray, (3,)
        Mean direction in the world, a unit vector.
    cone : float
        Angle (rad) from it to the farthest of the directions. More samples may widen the cone.
    """

    centre: np.ndarray
    rests: tuple[Equilibrium, ...]
    direction: np.ndarray
    cone: float


def reach_by_direction(
    rests: Iterable[Equilibrium], axis: np.ndarray, side: float
) -> tuple[ReachCell, ...]:
    """Cells of tip positions with the cone of directions in each, the widest first.

    Parameters
    ----------
    rests : iterable of Equilibrium
        Equilibria, for example from `sample_rests` and `sample_between`.
    axis : array_like, (3,)
        A direction in the frame of the tip's link.
    side : float
        Side of a cell (m).

    Raises
    ------
    InputError
        For an axis of zero, or a side that is not positive.
    """
    axis, side = unit("axis", axis), number("side", side, above=0.0)
    cells: dict[tuple[int, ...], list[Equilibrium]] = {}
    for one in instances("rests", rests, Equilibrium, "an Equilibrium"):
        cells.setdefault(tuple(np.floor(one.y / side).astype(int).tolist()), []).append(one)
    found = []
    for index, members in cells.items():
        at = [LinkKinematics.of(one.model)(one.state, one.model.robot.task) for one in members]
        directions = np.array([motion.rotation @ axis for motion in at])
        mean = directions.sum(axis=0)
        # directions that cancel have no mean: any of them stands for it
        mean = unit("mean", mean if np.linalg.norm(mean) > 1e-9 else directions[0])
        cone = float(np.arccos(np.clip(directions @ mean, -1.0, 1.0)).max())
        found.append(ReachCell((np.array(index) + 0.5) * side, tuple(members), mean, cone))
    return tuple(sorted(found, key=lambda cell: -cell.cone))


def _has_room(one: Equilibrium) -> bool:
    """Whether no input is near the bound in its direction; an input of zero always has room."""
    model = one.model
    origin = model.relaxed
    room = np.where(one.u > origin, model.u_max - origin, origin - model.u_min)
    return bool((np.abs(one.u - origin) <= ROOM * room).all())


@dataclass(frozen=True, eq=False)
class Loop(Frozen):
    """An ellipse in space, y = centre + a cos ωt + b sin ωt.

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
    """A path around an equilibrium's tip that stable equilibria can follow; None if there is none.

    Its axes are the two directions in which the inputs move the tip most, by the linear response.
    They are halved until equilibria come close to each of the path's points. ω is half the rate |s|
    of the equilibrium's slowest pole, but a cycle takes `SHORTEST` to `LONGEST`.
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
