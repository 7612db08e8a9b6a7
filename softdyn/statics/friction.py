"""Rests of robots whose cables rub: they depend on the last motion.

A rest fulfils K + g - B u - F(q, u, d) = 0 with the joint forces F of `softdyn.actuation.capstan`
and a direction d of sliding at each guide. After a slow motion that slid everywhere, d is 1 or -1.
Where a cable sticks, d is the value between that balances the forces, and the cable did not move.
So a step of a slow motion from q₀ to q is a rest with

    d_i = s_i / √(s_i² + ε²),    s_i = -∂L_i/∂q · (q - q₀),

where s_i is the sliding at guide i in this step. A cable sticks to within ε. The equations are
solved by Newton's method, with ε falling to `STICK`. Nothing depends on time: the last shape is the
whole memory of a robot with Coulomb friction. A step in which a guide first sticks and then slides
is one of first order in its length. `follow` therefore divides steps in which a direction changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from softdyn.actuation.capstan import Capstan
from softdyn.checks import array, instance, vector
from softdyn.copies import Frozen
from softdyn.dynamics.model import SoftModel, State
from softdyn.exceptions import InputError
from softdyn.statics.equilibria import newton, settle
from softdyn.statics.equilibrium import StaticsError

STICK = 1e-10  # sliding up to which a cable sticks (m, or the unit of a fixed tendon's length)
FALLING = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, STICK)
HALVINGS = 4
TURNED = 0.5  # a change of a guide's direction for which a step is divided
PARTS = 16

Direction = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class StuckRest(Frozen):
    """A rest with friction of cables.

    Attributes
    ----------
    state : State
        The robot's state at rest.
    u : ndarray, (nu,)
        The input.
    direction : ndarray, (guides,)
        The direction of the last sliding, between -1 and 1 where the cable sticks.
    residual : float
        Largest unbalanced force (N m, N).
    """

    state: State
    u: np.ndarray
    direction: np.ndarray
    residual: float

    @property
    def y(self) -> np.ndarray:
        """Tip position (3,) in the world (m)."""
        return self.state.y


def check_capstan(capstan: Capstan) -> Capstan:
    """`capstan`, if it is one; otherwise an InputError."""
    return instance("capstan", capstan, Capstan, "a softdyn.actuation.Capstan")


def rest_after(
    capstan: Capstan, u: np.ndarray, direction: np.ndarray | float, start: np.ndarray | None = None
) -> StuckRest:
    """The rest under an input after a slow motion in a stated direction.

    Parameters
    ----------
    capstan : Capstan
        The robot's guides.
    u : array_like, (nu,)
        Input.
    direction : float or array_like, (guides,)
        1 where the cables slid towards their driven ends, -1 where they were paid out.
    start : array_like, (nq,), optional
        A shape nearby; by default the rest without friction.

    Raises
    ------
    StaticsError
        If Newton's method finds no rest.
    InputError
        For a wrong shape or a number that is not finite.
    """
    model = check_capstan(capstan).model
    u = vector("u", u, model.nu)
    guides = len(capstan.tendon)
    one = not np.shape(direction)
    given = array("direction", direction, () if one else (guides,))
    q = settle(model, u).q if start is None else array("start", start, (model.nq,))
    return _solve(capstan, u, q, stated(np.broadcast_to(given, (guides,)), model))


def rest_interval(capstan: Capstan, u: np.ndarray) -> tuple[StuckRest, StuckRest]:
    """The rests under an input after all cables were pulled in, and after all were paid out.

    Parameters and errors are those of `rest_after`.
    """
    first = rest_after(capstan, u, 1.0)
    return first, rest_after(capstan, u, -1.0, first.state.q)


def follow(
    capstan: Capstan, inputs: Iterable[np.ndarray], start: np.ndarray | None = None
) -> list[StuckRest]:
    """The rests along a slow path of inputs, such as a hysteresis loop.

    Parameters
    ----------
    capstan : Capstan
        The robot's guides.
    inputs : iterable of array_like, (nu,)
        The inputs, in small steps.
    start : array_like, (nq,), optional
        The shape before the first input; by default its rest without friction.

    Raises
    ------
    StaticsError, InputError
        As in `rest_after`.
    """
    model, found = check_capstan(capstan).model, list[StuckRest]()
    q = None if start is None else array("start", start, (model.nq,))
    for k, given in enumerate(instance("inputs", inputs, Iterable, "an iterable of inputs")):
        u = vector(f"inputs[{k}]", given, model.nu)
        q = settle(model, u).q if q is None else q
        before = found[-1].u if found else u
        rest = _lead(capstan, before, u, q, HALVINGS)
        if found and (np.abs(rest.direction - found[-1].direction) > TURNED).any():
            for path in np.linspace(before, u, PARTS + 1)[1:]:
                rest = _lead(capstan, before, path, q, HALVINGS)
                before, q = path, rest.state.q
        found.append(rest)
        q = rest.state.q
    if not found:
        raise InputError("inputs", "at least one", "none")
    return found


def _lead(
    capstan: Capstan, before: np.ndarray, u: np.ndarray, q: np.ndarray, halvings: int
) -> StuckRest:
    """The rest to which a change of the input leads, in halves where one step finds none."""
    try:
        return _step(capstan, u, q)
    except StaticsError:
        if not halvings or (before == u).all():
            raise
    middle = (before + u) / 2
    half = _lead(capstan, before, middle, q, halvings - 1)
    return _lead(capstan, middle, u, half.state.q, halvings - 1)


def _step(capstan: Capstan, u: np.ndarray, before: np.ndarray) -> StuckRest:
    """The rest to which a change of the input leads from a shape."""
    model = capstan.model
    zero, at = np.zeros(model.nv), model.coordinates(before)
    beyond = capstan.at(model.state(before, zero)).arms_beyond
    q = before
    for width in FALLING:

        def direction(q: np.ndarray, width: float = width) -> tuple[np.ndarray, np.ndarray]:
            slid = -beyond @ (model.coordinates(q) - at)
            size = np.hypot(slid, width)
            return slid / size, -beyond * (width**2 / size**3)[:, None]

        rest = _solve(capstan, u, q, direction)
        q = rest.state.q
    return rest


def _solve(capstan: Capstan, u: np.ndarray, q: np.ndarray, direction: Direction) -> StuckRest:
    """The rest near a shape, with the directions of sliding as a function of the shape."""
    model = capstan.model
    here, _ = newton(model, u, q, Rubbing(capstan, u, direction))
    return StuckRest(here.state, u, direction(here.state.q)[0], here.left)


@dataclass(frozen=True, eq=False)
class Rubbing:
    """The friction of cables under an input.

    Attributes
    ----------
    capstan : Capstan
        The guides.
    u : ndarray, (nu,)
        The input.
    direction : Callable
        Configuration → directions of sliding (guides,) and their Jacobian by q (guides, nv).
    """

    capstan: Capstan
    u: np.ndarray
    direction: Direction

    def forces(self, state: State) -> np.ndarray:
        """The joint forces (nv,) at rest."""
        return self.capstan.at(state).forces(self.u, self.direction(state.q)[0])

    def stiffness(self, state: State) -> np.ndarray:
        """Their part in the tangent stiffness (nv, nv), -∂forces/∂q."""
        d, by_q = self.direction(state.q)
        slope = self.capstan.derivatives(state, self.u, d).q
        slope += self.capstan.direction_gradients(state, self.u, d) @ by_q
        return -slope


def stated(directions: np.ndarray, model: SoftModel) -> Direction:
    """Directions of sliding (guides,) that no shape changes."""
    return lambda _: (directions, np.zeros((len(directions), model.nv)))
