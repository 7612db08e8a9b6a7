"""The deviations that a filter assumes, the disturbances that it estimates, and its counts."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np

from softdyn.checks import number
from softdyn.dynamics.balance import Disturbance
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.relaxation import Branches
from softdyn.exceptions import InputError

HORIZON = 0.3  # s, of the force that moves a joint without a spring, and of the first velocity
SHORTEST_STEP = 1e-4  # s; a step over the longest gap ends within seconds
CORRELATED = 0.01  # s, over which a joint force of the process noise is constant


@dataclass(frozen=True)
class EkfParameters:
    """Deviations that the filter assumes; the same defaults for every robot.

    Attributes
    ----------
    spread : float
        Standard deviation of each joint's first position, as a share of its range (of 1 rad or 1 m
        without limits, and at most of these).
    lost : float
        As `spread`, if the first readings refute the start, after a gap, and for a lost estimate.
    process : float
        Standard deviation of the unmodelled joint forces, each constant over 10 ms, as a share of
        the force of the joint's spring over its range. Without a spring it is the force that moves
        the joint through its range in `HORIZON`. The filter begins with it, and lowers it as far as
        the readings agree with the model.
    least_process : float
        The lower bound of this. Where `process` is not larger, it is constant.
    memory : float
        Time (s) over which a disturbance may change by its own deviation
        (`softdyn.estimation.drift`).
    tip_force : float
        Standard deviation of the force at the tip (N).
    payload : float
        Of the payload (kg).
    stiffness : float
        Of the springs' relative change.
    joint_offsets : float
        Of the rest positions, as a share of each joint's range.
    relaxation : float
        Of the torques of Maxwell branches, as a share of their stiffness over the joint's range.
    longest : float
        No step of the prediction is longer (s); at least 1e-4.
    stops : float
        Standard deviation of the positions of joints at their stops when one of them meets its
        stop, as a share of each joint's range: stops give way, and joints bounce. It is at most
        that of the joint's way in the step until it meets the stop, and it fades. Joints that rest
        at their stops are known exactly.
    """

    spread: float = 0.01
    lost: float = 0.1
    process: float = 0.4
    least_process: float = 0.004
    memory: float = 1.0
    tip_force: float = 1.0
    payload: float = 0.05
    stiffness: float = 0.2
    joint_offsets: float = 0.05
    longest: float = 0.01
    relaxation: float = 0.02
    stops: float = 1e-3

    def __post_init__(self) -> None:
        for field in fields(self):
            number(field.name, getattr(self, field.name), above=0.0)
        number("longest", self.longest, lower=SHORTEST_STEP)

    @property
    def widening(self) -> float:
        """The factor from the variances of a known start to those of an unknown one."""
        return max(self.lost / self.spread, 1.0) ** 2

    @staticmethod
    def span(model: SoftModel) -> np.ndarray:
        """The joints' ranges (nv,) of which the deviations are shares; 1 rad or 1 m at most."""
        return np.minimum(model.upper - model.lower, 1.0)

    @property
    def quietest(self) -> float:
        """Logarithm of the factor from the variance of `process` to the least one, at most 0."""
        return 2 * min(math.log(self.least_process / self.process), 0.0)

    def variances(
        self, model: SoftModel, disturbances: tuple[Disturbance, ...]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Variances of the start (2 nv,), of joint forces (nv,), of the disturbances (nd,).

        That of a joint force is for a second; over a step of length T it is divided by T.
        """
        span = self.span(model)
        rest = model.state(model.q0, np.zeros(model.nv))
        moved = np.diag(rest.M) / HORIZON**2 + np.diag(rest.D) / HORIZON
        stiff = np.where(model.stiffness > 0, model.stiffness, moved)
        position = self.spread * span
        known: dict[Disturbance, np.ndarray | float] = {
            Disturbance.TIP_FORCE: self.tip_force,
            Disturbance.PAYLOAD: self.payload,
            Disturbance.STIFFNESS: self.stiffness,
            Disturbance.JOINT_OFFSETS: self.joint_offsets * span,
        }
        if Disturbance.RELAXATION in disturbances:
            branches = Branches.of(model)
            reach = np.abs(branches.rates) @ span
            known[Disturbance.RELAXATION] = self.relaxation * branches.stiffness * reach
        parts = [np.broadcast_to(known[one], one.size(model)) for one in disturbances]
        return (
            np.concatenate((position, position / HORIZON)) ** 2,
            (self.process * stiff * span) ** 2 * CORRELATED,
            np.concatenate([*parts, np.zeros(0)]) ** 2,
        )


@dataclass(frozen=True)
class EkfCounts:
    """Counts of a filter's data since its last `reset`.

    Attributes
    ----------
    used : int
        Readings used.
    skipped : int
        Readings that are not finite or larger than any robot's.
    doubted : int
        Readings more than 20 deviations from their prediction; they correct little.
    unmatched : int
        Late readings whose own time was in no step, or of which too many wait
        (`softdyn.estimation.arrivals`).
    refused : int
        Steps whose time is not finite, beyond ±1e10 s, or not after the last one; they change
        nothing.
    gaps : int
        Pauses longer than 0.5 s, and clocks that were set back: ten refused steps in a row whose
        times rise. The covariance begins anew at the estimate.
    held : int
        Steps without finite commands. The last ones are taken to act on.
    refuted : int
        Starts that the first readings refuted. They are then taken as unknown.
    restarts : int
        Estimates that were lost, because a prediction had no solution or was not finite. The
        filter begins anew at its start.
    """

    used: int = 0
    skipped: int = 0
    doubted: int = 0
    unmatched: int = 0
    refused: int = 0
    gaps: int = 0
    held: int = 0
    refuted: int = 0
    restarts: int = 0


def disturbances_of(
    model: SoftModel, given: Iterable[Disturbance | str]
) -> tuple[Disturbance, ...]:
    """Disturbances by their names.

    Raises
    ------
    InputError
        For an unknown one, one given twice, or springs' disturbances of a robot without springs.
    """
    words = [one.value for one in Disturbance]
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError("disturbances", f"a sequence of {' or '.join(words)}", repr(given))
    found = []
    for one in given:
        if not isinstance(one, Disturbance) and one not in words:
            raise InputError("disturbances", " or ".join(words), repr(one))
        found.append(Disturbance(one))
    if len(set(found)) < len(found):
        raise InputError("disturbances", "each one once", ", ".join(one.value for one in found))
    springs = {Disturbance.STIFFNESS, Disturbance.JOINT_OFFSETS} & set(found)
    if springs and not model.stiffness.any():
        raise InputError("disturbances", "a robot with joint springs", model.name)
    if Disturbance.RELAXATION in found and not Disturbance.RELAXATION.size(model):
        raise InputError("disturbances", "a robot whose springs creep", model.name)
    return tuple(found)
