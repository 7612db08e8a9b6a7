"""Targets of shape and input for the predictive controller: equilibria that hold the tip."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from softdyn import Reference, SoftModel, statics
from softdyn.controllers.predictive.background import Job
from softdyn.controllers.predictive.buckling import buckling_input
from softdyn.copies import KeepsMaking
from softdyn.dynamics.stops import Stops
from softdyn.statics import Equilibrium, StaticsError
from softdyn.statics.target_search import SECONDS, all_at
from softdyn.statics.unknown_inputs import TargetProblem
from softdyn.tasks.task import Task

WITHIN = 5e-3  # m: equilibria whose tips are this close to the reference count as equally near
SHAPES = 6  # random shapes from which the search starts where the arm does not buckle
FOLDED = 400  # and where it does
BENT = (0.2, 1.0)  # rad, m: how much they are bent
PULLS = (1.1, 5.0)  # their inputs, in the least ones that buckle
STRAIGHT = 1e-6  # of the largest bend: such joints stay straight
ASIDE = 0.05  # rad, m; of the inputs: deviations from the plane
SLOW = 1.0  # 1/s: a sum of unstable poles up to this is as easy to hold as none
BEST = 4  # targets that are kept
SAME = 1e-3  # rad, m; of the poles: equilibria this close count as one


@dataclass(frozen=True, eq=False)
class RestTarget:
    """An equilibrium (q*, u*) for a reference of the tip, or of tasks.

    Attributes
    ----------
    q : ndarray, (nq,)
        Configuration.
    u : ndarray, (nu,)
        Input.
    stable : bool
        Whether it is stable without control.
    distance : float
        From its tip to the reference (m); ‖error‖ of tasks, unweighted (m, rad).
    """

    q: np.ndarray
    u: np.ndarray
    stable: bool
    distance: float


def instability(one: Equilibrium) -> tuple[float, float]:
    """Sum of the unstable poles' real parts, and the rightmost pole's (1/s).

    With all joints at their stops there is no pole.
    """
    real = one.poles.real
    return float(real[real > 0].sum()), float(real.max(initial=-np.inf))


def folded(
    model: SoftModel, q: np.ndarray, least: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Random shapes like q, bent the other way beyond up to two joints, with inputs that buckle.

    Every second shape keeps the proportions of q, for example its plane, up to a factor for each
    joint.
    """
    rng, n, bend = np.random.default_rng(0), model.nv, model.coordinates(q)
    bend = bend / max(np.abs(bend).max(initial=0.0), 1e-300)
    bend = np.sign(bend) * (np.abs(bend) > STRAIGHT)
    for k in range(FOLDED):
        pieces = rng.integers(1, 4)
        ends = np.sort(rng.uniform(0, 1, pieces - 1))
        size = rng.uniform(*BENT, pieces) * (-1.0) ** np.arange(pieces) * rng.choice([-1, 1])
        shape = size[np.searchsorted(ends, (np.arange(n) + 0.5) / n)] * bend
        shape *= rng.uniform(0.6, 1.4, n)
        u = rng.uniform(*PULLS) * least
        if k % 2:
            shape += ASIDE * rng.normal(size=n)
            u = u * (1 + ASIDE * rng.normal(size=len(u)))
        shape = Stops.of(model).within(shape)
        yield model.configuration(shape), np.clip(u, model.u_min, model.u_max)


# the targets that each model's controllers have waited for
_KNOWN: WeakKeyDictionary[SoftModel, dict[tuple[Any, ...], tuple[RestTarget, ...]]]
_KNOWN = WeakKeyDictionary()


class RestTargets(KeepsMaking):
    """The targets of each set point, found once and kept.

    They are the equilibria within 5 mm of the set point, or as near as the nearest, with the least
    sum of unstable poles, which bounds the effort of holding them. Up to 1 1/s it counts as none,
    and the shape nearest to the branch from rest comes first. Where the arm can buckle
    (`buckling_input`), the search starts at folded shapes with the tip at the set point. Otherwise,
    or if these give nothing, it is `statics.inputs_for_tip`; for tasks `statics.inputs_for_tasks`.
    It takes seconds.

    Parameters
    ----------
    model : SoftModel
        The robot.
    """

    def __init__(self, model: SoftModel) -> None:
        self._model = model
        self._known = _KNOWN.setdefault(model, {})
        self._late = dict[tuple[Any, ...], tuple[RestTarget, ...]]()
        self._job: tuple[tuple[Any, ...], Job[tuple[RestTarget, ...]]] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return RestTargets, (self._model,)

    @property
    def searching(self) -> bool:
        """Whether a search goes on in the background."""
        return self._job is not None and not self._job[1].done()

    def find(
        self,
        y: np.ndarray,
        tasks: tuple[Task, ...] = (),
        reference: Reference | None = None,
        *,
        waits: bool,
    ) -> tuple[RestTarget, ...] | None:
        """The targets for the tip at y (3,), the best first; none if no equilibrium was found.

        A call that waits searches at once, and its result depends on the robot and the set point
        alone. Another call starts a process, which replaces the one of another set point; it
        returns None until that has the result. The searches of `statics` then have a limit of time.

        Parameters
        ----------
        y : ndarray, (3,) or (k,)
            The set point (m); for tasks, the numbers of all their targets.
        tasks : tuple of Task
            The tasks; none for the tip.
        reference : Reference, optional
            The targets of the tasks.
        waits : bool
            Whether to search in this call.
        """
        key = tasks, np.asarray(y, float).tobytes()
        if key in self._known:
            return self._known[key]
        if key in self._late and not waits:
            return self._late[key]
        seconds = math.inf if waits else SECONDS
        search = partial(targets_of, self._model, np.array(y, float), tasks, reference, seconds)
        if waits:
            self._known[key] = search()
            return self._known[key]
        if self._job is None or self._job[0] != key:
            if self._job is not None:
                self._job[1].cancel()
            self._job = key, Job(search)
        if not self._job[1].done():
            return None
        self._late[key], self._job = self._job[1].result_or(()), None
        return self._late[key]


@np.errstate(all="ignore")  # shapes far from any rest may overflow
def targets_of(
    model: SoftModel,
    y: np.ndarray,
    tasks: tuple[Task, ...],
    reference: Reference | None,
    seconds: float,
) -> tuple[RestTarget, ...]:
    """The targets of a set point, see `RestTargets`; `seconds` limits the searches of `statics`."""
    try:
        if tasks:
            return _for_tasks(model, tasks, reference, seconds)
        return _for_tip(model, y, seconds)
    except (StaticsError, np.linalg.LinAlgError):
        return ()


def _for_tasks(
    model: SoftModel, tasks: tuple[Task, ...], reference: Any, seconds: float
) -> tuple[RestTarget, ...]:
    search = statics.inputs_for_tasks(model, tasks, reference, shapes=0, seconds=seconds)
    errors = [math.hypot(*search.errors(one).values()) for one in search.found]
    within = max(WITHIN, errors[0])
    near = [pair for pair in zip(search.found, errors, strict=True) if pair[1] <= within]
    near.sort(key=lambda pair: max(instability(pair[0])[0], SLOW))  # stable
    return tuple(RestTarget(one.q, one.u, one.stable, far) for one, far in near[:BEST])


def _for_tip(model: SoftModel, y: np.ndarray, seconds: float) -> tuple[RestTarget, ...]:
    plain = statics.approach(statics.rest(model), y, stay_stable=True)
    found = _folded(model, plain, y)
    if not found:
        search = statics.inputs_for_tip(model, y, [plain], shapes=SHAPES, rays=0, seconds=seconds)
        within = max(WITHIN, search.distance(search.nearest))
        found = tuple(one for one in search.found if search.distance(one) <= within)
    bend = model.coordinates(plain.q)
    best = list[tuple[tuple[float, float, float], Equilibrium]]()
    for one in found:
        unstable, rightmost = instability(one)
        far = float(np.linalg.norm(model.coordinates(one.q) - bend))
        best.append(((max(unstable, SLOW), far, rightmost), one))
    best.sort(key=lambda pair: pair[0])
    kept = [
        one for k, (key, one) in enumerate(best)  # a mirrored shape is no other
        if k == 0 or not np.allclose(key, best[k - 1][0], rtol=SAME)
    ]  # fmt: skip
    return tuple(
        RestTarget(one.q, one.u, one.stable, float(np.linalg.norm(one.y - y)))
        for one in kept[:BEST]
    )


def _folded(model: SoftModel, plain: Equilibrium, y: np.ndarray) -> tuple[Equilibrium, ...]:
    """Distinct equilibria with the tip at y (3,), from folded shapes."""
    least = buckling_input(model)
    if least is None:
        return ()
    return all_at(TargetProblem.for_tip(model, y), folded(model, plain.q, least))
