"""The supervisor of predictive control: which target it follows now, and why.

`Supervisor` is a state machine. Its state is a `Phase`, which every command of `Mpc` reports in the
channel ``phase``; `docs/supervisor.md` has its drawing. It decides from four things: the
reference, the tip's distance from it, the shape of the robot, and the answers of its searches.

                              stuck 1 s          a nearer rest is known, 0.5 s later
    another set point ► GIVEN ─────────► SEARCH ─────────────────────────► REST ◄───────┐
                                                                   bent away │          │ its end
                                                                   for 1 s   ▼  there   │
                                                   REST ◄─ no plan ─ HOLD ─────► PLAN

    a path ► GIVEN;  where cables can buckle the arm ► BUCKLED ◄──────► PULL
                                                               far, 0.6 s
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from softdyn import Reference, SetPoint, SoftModel
from softdyn.controllers.channels import PHASE
from softdyn.controllers.predictive.aim import Aim, ErrorAhead
from softdyn.controllers.predictive.background import Job
from softdyn.controllers.predictive.plan import Plan, make_plan
from softdyn.controllers.predictive.prediction import Present
from softdyn.controllers.predictive.rest_target import WITHIN, RestTarget, RestTargets

# Lines "x 0.1" and "x 10" say what a tenth and ten times did. The finger is held by dry friction
# 8 cm from a set point. The paths are two of SpiRob at 0.35π rad/s with a lag of 10 ms, with a set
# point between them: mean square errors of 46 and 13 cm² as it is.
STUCK = 1.0  # s farther than 5 mm, then a rest is searched for, or another plan is made
# x 0.1: the finger ends at 0.19 in place of 0.21 cm, but every approach starts a search.
# x 10: it ends at 0.25 cm, because the rest acts after 10 s.
ARRIVES = 0.5  # s later the rest or the plan acts, however long the search took
# x 0.1: 0.19 cm, but no search is so short. x 10: 0.25 cm, because the rest acts after 6 s.
RESTS = 5.0  # s of HOLD in a loop that does not wait, after which the robot is at rest
# x 0.1: a plan that comes 8 s later ends 14 in place of 3 cm from the set point 0.25π, because the
# robot has moved by 0.09 rad; with 5 s by 0.004. x 10: the same plan, after 50 s.
BENT = 0.3  # rad, m: a joint this far from the rest's shape
# x 10: there is no plan, and SpiRob stays 7 cm from the set point 0.25π.
PLANS = 3  # for one set point
# x 0.1: none, as for BENT.

TIMES = 20.0  # the pull, in the least input that buckles the arm
# x 0.1: the arm does not buckle, 105 and 104 cm². x 10: it leaves the path, 162 and 70 cm².
KEEPS = 5.0  # the input that keeps it buckled
# x 0.1: no harm on these paths, 46 and 13 cm². x 10: it leaves the path, 68 and 75 cm².
# x 0: the shape is lost, 19 in place of 6.6 cm² at 0.25π rad/s.
LASTS = 0.6  # s of a pull
# x 0.1: the arm does not buckle, 115 and 107 cm². x 10: it is late, 58 and 34 cm².
AGAIN = 1.0  # s from the end of a pull to the next
# x 0.1: it pulls again and again, 46 and 40 cm². x 10: 46 and 13 cm².
# With one pull at the begin alone, the path at 0.25π rad/s has 7.6 in place of 6.6 cm².
FAR = 0.03  # m from the path
# x 0.1: 46 and 11 cm², with more pulls. x 10: 46 and 8 cm²: later pulls do not help here.


class Phase(Enum):
    """The thing that a controller follows now.

    `best` has the first seven phases, `Staged` the last two.
    """

    GIVEN = "given"  # the reference alone
    SEARCH = "search"  # the reference, while a rest that holds the set point is searched for
    REST = "rest"  # the reference, and the shape and input of a rest
    HOLD = "hold"  # the present input, while a plan to a rest is made
    PLAN = "plan"  # the plan's commands
    PULL = "pull"  # the path, and the input that buckles the arm
    BUCKLED = "buckled"  # the path, and the input that keeps the arm buckled
    APPROACH = "approach"  # the reference, with the gains to arrive
    STAY = "stay"  # the reference, with the gains to stay

    def __init__(self, value: str) -> None:
        self.channel = {PHASE.name: value}  # the values of a command's channels


class Followed(NamedTuple):
    """The target of one step of the predictive controller.

    Attributes
    ----------
    phase : Phase
        Why.
    aim : ErrorAhead
        The error of the tip, or of the tasks.
    moving : bool
        Whether the reference moves.
    rest : RestTarget, optional
        The rest whose input, and shape if it is unstable, are part of the cost.
    command : ndarray, (nu,), optional
        The command that is sent in place of the QP's answer.
    """

    phase: Phase
    aim: ErrorAhead
    moving: bool
    rest: RestTarget | None = None
    command: np.ndarray | None = None


class Supervisor:
    """Decides what the predictive controller follows.

    Parameters
    ----------
    model : SoftModel
        The robot.
    targets : RestTargets, optional
        Finds rests for set points; without it set points have `Phase.GIVEN` alone.
    least : ndarray, (nu,), optional
        The robot's `buckling_input`, for paths.

    Attributes
    ----------
    phase : Phase
        The present phase.
    """

    def __init__(
        self, model: SoftModel, targets: RestTargets | None, least: np.ndarray | None
    ) -> None:
        self._model, self._targets = model, targets
        self._pulls: dict[Phase, RestTarget] = {}
        if least is not None:
            for phase, times in ((Phase.PULL, TIMES), (Phase.BUCKLED, KEEPS)):
                u = np.clip(times * least, model.u_min, model.u_max)
                self._pulls[phase] = RestTarget(model.q0, u, True, math.nan)
        self._job: Job[Plan | None] | None = None
        self.reset(0.0, 0.0)

    def reset(self, period: float, lag: float) -> None:
        """Begin a run with a control period (s), and actuators of that lag (s)."""
        self._period, self._lag = period, lag
        self._start_over(None)

    def _start_over(self, goal: list[float] | None) -> None:
        """Follow another set point, its numbers `goal`, or a path."""
        if self._job is not None:
            self._job.cancel()
        self._goal, self._job = goal, None
        self._found: Sequence[RestTarget] = ()  # the rests of this set point, the best first
        self._rest: RestTarget | None = None  # the one that acts
        self._plan: Plan | None = None
        self._kept: np.ndarray | None = None  # the input that stays while a plan is made
        self._left = PLANS
        self._enter(Phase.GIVEN)

    def _enter(self, phase: Phase, time: float = 0.0) -> None:
        self.phase, self._time = phase, time  # s, of which each phase says what it counts

    @property
    def pulls(self) -> bool:
        """Whether it pulls the robot into buckled shapes on paths."""
        return bool(self._pulls)

    @property
    def planning(self) -> bool:
        """Whether a rest or a plan is searched for in the background."""
        if self.phase is Phase.SEARCH and self._targets is not None:
            return self._targets.searching
        return self._job is not None and not self._job.done()

    def __call__(
        self, reference: Reference | SetPoint, aim: Aim, moving: bool, error: ErrorAhead,
        now: Present, *, waits: bool,
    ) -> Followed:  # fmt: skip
        """The target of this period.

        Parameters
        ----------
        reference : Reference or SetPoint
            The reference.
        aim : Aim
            What is controlled: the tip, or tasks.
        moving : bool
            Whether the reference moves.
        error : ErrorAhead
            The present error.
        now : Present
            The present state, and the one at which the command begins to act.
        waits : bool
            Whether a search is done in this call, and not in a process of its own.
        """
        if moving:
            rest = self._follow_path(error.far)
            return Followed(self.phase, error, True, rest)
        if self._targets is None:
            return Followed(self.phase, error, False)
        goals = aim.targets(reference)
        y = numbers(goals)
        if y.tolist() != self._goal:
            self._start_over(y.tolist())
        if self.phase in (Phase.GIVEN, Phase.SEARCH):
            self._look_for_rests(error.far, y, aim, reference, waits)
        if self.phase in (Phase.REST, Phase.HOLD):
            self._approach_rest(error.far, None if aim.tasks else goals[0].y, now, waits)
        command = None
        if self.phase is Phase.HOLD:
            command = self._kept
        elif self.phase is Phase.PLAN:
            command = self._next_of_plan(now)
        return Followed(self.phase, error, False, self._rest, command)

    def _follow_path(self, far: float) -> RestTarget | None:
        """On a path: PULL begins far from it, and BUCKLED follows. The time is since the pull."""
        if self._goal is not None:
            self._start_over(None)
        if not self._pulls:
            return None
        if self.phase is Phase.GIVEN:
            self._enter(Phase.BUCKLED, LASTS + AGAIN)  # so that a pull may begin at once
        if self.phase is Phase.PULL and self._time >= LASTS:
            self.phase = Phase.BUCKLED
        if far > FAR and self._time >= LASTS + AGAIN:
            self._enter(Phase.PULL)
        self._time += self._period
        return self._pulls[self.phase]

    def _look_for_rests(
        self, far: float, y: np.ndarray, aim: Aim, reference: Any, waits: bool
    ) -> None:
        """GIVEN → SEARCH → REST. The time is since the tip is stuck."""
        stuck = self.phase is Phase.SEARCH or far > WITHIN
        self._time = self._time + self._period if stuck else 0.0
        if not (self._time > STUCK and math.isfinite(far)):
            return
        self.phase = Phase.SEARCH
        assert self._targets is not None
        found = self._targets.find(y, aim.tasks, reference, waits=waits)
        if found is not None and self._time > STUCK + ARRIVES:
            self._time = ARRIVES  # it asks again a second later where no rest is nearer
            if found and found[0].distance < far - WITHIN:
                self._found = found
                self._enter(Phase.REST, STUCK)  # so that a plan may begin at once

    def _approach_rest(
        self, far: float, goal: np.ndarray | None, now: Present, waits: bool
    ) -> None:
        """REST → HOLD → PLAN. The time is that far from the rest in tip and shape, or of HOLD."""
        wait = ARRIVES if waits else RESTS
        if self.phase is Phase.REST:
            rest = self._rest or self._found[0]
            away = far > rest.distance + WITHIN and self._bent(now.q, rest.q)
            self._time = self._time + self._period if away else 0.0
            if not (self._left > 0 and self._time >= STUCK):
                self._rest = rest
                return
            q, v, self._kept = (x.copy() for x in (now.q, now.v, now.acting))
            work = partial(
                make_plan, self._model, q, v, self._kept, self._found,
                None if goal is None else goal.copy(), self._lag, wait,
            )  # fmt: skip
            self._job, self._left = Job(work, waits), self._left - 1
            self._enter(Phase.HOLD)
            return
        assert self._job is not None
        self._time += self._period
        if not (self._time >= wait and self._job.done()):
            return
        self._plan, self._job = self._job.result_or(None), None
        if self._plan is None:
            self._rest, self._left = self._rest or self._found[0], 0
            self._enter(Phase.REST)
        else:
            self._rest = self._plan.target
            self._enter(Phase.PLAN)

    def _bent(self, q: np.ndarray, shape: np.ndarray) -> bool:
        coordinates = self._model.coordinates
        return bool(np.abs(coordinates(q) - coordinates(shape)).max(initial=0.0) > BENT)

    def _next_of_plan(self, now: Present) -> np.ndarray | None:
        """The plan's command; PLAN → REST at its end. The time is since the plan's begin."""
        assert self._plan is not None
        if self._time >= self._plan.duration:
            self._plan = None
            self._enter(Phase.REST)
            return None
        q = self._model.coordinates(now.q)
        command = self._plan.command(self._time, q, now.v, now.acting)
        self._time += self._period
        return command


class StageSupervisor:
    """Decides between the two stages of a schedule.

    Parameters
    ----------
    arrive, leave, dwell : float
        Its distances (m) and its time (s), see `softdyn.controllers.Schedule`.

    Attributes
    ----------
    phase : Phase
        `Phase.APPROACH` or `Phase.STAY`.
    """

    def __init__(self, arrive: float, leave: float, dwell: float) -> None:
        self._arrive, self._leave, self._dwell = arrive, leave, dwell
        self.reset(0.0)

    def reset(self, period: float) -> None:
        """Begin a run with a control period (s), in the first stage."""
        self._period, self.phase, self._near = period, Phase.APPROACH, 0.0

    def __call__(self, distance: float) -> Phase:
        """The phase of this period; the tip is `distance` (m) from the reference."""
        self._near = self._near + self._period if distance < self._arrive else 0.0  # s
        if self.phase is Phase.APPROACH and self._near > self._dwell:
            self.phase = Phase.STAY
        elif self.phase is Phase.STAY and distance > self._leave:
            self.phase = Phase.APPROACH
        return self.phase


def moves(goal: Any) -> bool:
    """Whether a target moves."""
    return bool(goal.ydot.any() or goal.yddot.any())


def numbers(goals: Sequence[Any]) -> np.ndarray:
    """The numbers of all targets in one array."""
    return np.concatenate([goal.y.ravel() for goal in goals])
