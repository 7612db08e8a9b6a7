"""Targets for the tuning of a user's robot: points and paths from its statics, in three sets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SoftModel
from softdyn.statics import Equilibrium, Loop, loop_around, spread_rests
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.studies.engine.case import Case

POINTS, PATHS = {"search": 3, "final": 3, "test": 6}, {"search": 1, "final": 1, "test": 1}
NEAREST = 0.05  # of the length: targets closer to the start are left out
# s, duration of a run to a point, and of one that only judges the approach
POINT_TIME, WINDOW = 2.5, 1.0


@dataclass(frozen=True)
class Follow:
    """A factory of a path as reference, in place of a case's target."""

    loop: Loop

    def __call__(self, _robot: str, _experiment: Experiment) -> Callable[[float], Reference]:
        """The path."""
        return self.loop


@dataclass(frozen=True, eq=False)
class TuningTargets:
    """The targets of a robot: points and paths for each of `POINTS`.

    Attributes
    ----------
    robot, annotations : str, str or None
        As on the command line.
    model : SoftModel
        The robot.
    points : dict[str, list of ndarray, (3,)]
        Tips of stable equilibria.
    loops : dict[str, list of Loop]
        Paths that stable equilibria follow.
    inputs : float
        A typical nonzero input at these equilibria.
    """

    robot: str
    annotations: str | None
    model: SoftModel
    points: dict[str, list[np.ndarray]]
    loops: dict[str, list[Loop]]
    inputs: float

    def cases(
        self, part: str, controller: str = "best", parameters: Any = None, window: bool = False
    ) -> list[Case]:
        """Runs to each point and along each path of one part, from q = 0."""
        make = partial(
            Case, self.robot, controller, "point", parameters=parameters,
            annotations=self.annotations,
        )  # fmt: skip
        points = [
            make(tuple(y.tolist()), duration=WINDOW if window else POINT_TIME)
            for y in self.points[part]
        ]
        paths = [
            make(tuple(loop(0.0).y.tolist()), duration=WINDOW if window else loop.period,
                 target=Follow(loop))
            for loop in self.loops[part]
        ]  # fmt: skip
        # so that the first few are of both kinds
        return points[:1] + paths + points[1:]


def find_targets(robot: str, annotations: str | None, model: SoftModel, seed: int) -> TuningTargets:
    """Points and paths for a robot, spread over its stable equilibria.

    Raises
    ------
    InputError
        The robot has no inputs or no length, or its inputs hardly move the tip.
    """
    if model.nu == 0 or model.robot.length == 0:
        missing = "inputs" if model.nu == 0 else "a length from base to tip"
        raise InputError("robot", f"a robot with {missing}", str(model.robot.path))
    start = model.state(model.q0, np.zeros(model.nv)).y
    wanted = sum(POINTS.values())
    rests = [
        one
        for one in spread_rests(model, 2 * wanted, seed)
        if np.linalg.norm(one.y - start) > NEAREST * model.robot.length
    ][:wanted]
    if len(rests) < len(POINTS):
        expected = f"at least {len(POINTS)} stable equilibria with the tip away from its start"
        raise InputError(str(model.robot.path), expected, len(rests))
    # divided in turn, because the first ones are the outermost
    parts = [name for k in range(wanted) for name, n in POINTS.items() if k < n]
    dealt: dict[str, list[Equilibrium]] = {name: [] for name in POINTS}
    for name, one in zip(parts, rests, strict=False):
        dealt[name].append(one)
    loops = {
        name: list(islice(filter(None, map(loop_around, reversed(some))), PATHS[name]))
        for name, some in dealt.items()
    }
    least = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
    inputs = float(np.median([np.linalg.norm(one.u - least) for one in rests]))
    points = {name: [one.y for one in some] for name, some in dealt.items()}
    return TuningTargets(robot, annotations, model, points, loops, max(inputs, 1e-9))
