"""Friction of cables on their guides: tensions along a path, joint forces, dissipation.

A cable is driven at one end with the tension T₀, and its guides follow as i = 1, 2, … from there.
The cable turns by the wrap angle φ_i at guide i. Let ℓ_i(q) be the length of the piece behind
guide i, and L_i = Σ_(k ≥ i) ℓ_k the whole length beyond it. The cable slides at guide i with the
speed v_i = -dL_i/dt, which is positive towards the driven end. Euler's and Eytelwein's capstan
equation gives the tension behind a guide,

    T_i = T_(i-1) exp(-d_i μ φ_i sign T),    d_i = sign v_i,

as in the tension propagation model of Kato et al. (IEEE/ASME Trans. Mechatronics 20(5), 2015). A
two-sided input is the difference of an antagonistic pair, so friction acts on |T|. The force along
a tendon is f = -T₀; motors, spring and damper pull at the driven end. The joint forces are

    τ = -Σ T_i ∂ℓ_i/∂q = f ∂ℓ/∂q + Σ (T_(i-1) - T_i) ∂L_i/∂q,

and the power lost is Σ (T_(i-1) - T_i) v_i ≥ 0.

A path over sites turns at its inner sites, by the angle between its straight pieces, and at the
round bodies that it touches: see `softdyn.dynamics.wraps`. The piece of cable between a body and a
site pulls the site against the body along the cable's end there, so that its part of ∂ℓ/∂q is that
of the site in `softdyn.dynamics.wrapped_paths`. A fixed tendon
turns at each revolute joint j by φ = |q_j|. A half of its length coef · q_j is before this guide
and a half behind it, which is the trapezoidal rule for a cable in a channel. Prismatic joints turn
no cable.

At rest a cable sticks. Then each T_i is somewhere between the values for d_i = 1 and -1. The caller
chooses the directions d, for example those of the last motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from softdyn.checks import array, number, read_only, vector
from softdyn.description.robot import (
    MOST_FRICTION,
    JointTerm,
    PathEnd,
    Robot,
    Site,
    Tendon,
    Wrap,
    driven_end,
)
from softdyn.dynamics.derivatives import Derivatives, tendon_curvature, tendon_forces
from softdyn.dynamics.engine import moved_bodies
from softdyn.dynamics.model import (
    SoftModel,
    State,
    check_model,
    check_state,
    taut_gains,
    taut_slopes,
)
from softdyn.dynamics.projection import Projection, project, underlying_tree
from softdyn.dynamics.tendons import TendonGeometry, compile_tendons
from softdyn.dynamics.wrapped_paths import WrappedPaths

STRAIGHT = 1e-9  # a wrap angle (rad) below which its gradient has no direction


class Capstan:
    """The guides of a robot's cables that rub: tendon by tendon, each from its driven end.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    friction : float or array_like, (tendons,), optional
        Coefficients μ that replace those of the file, but not those of its round bodies. One number
        is that of every cable that an input pulls.

    Attributes
    ----------
    model : SoftModel
        The robot's model.
    friction : ndarray, (guides,)
        The coefficient μ at each guide.
    tendon : ndarray of int, (guides,)
        The tendon of each guide. A tendon with μ = 0 everywhere has no guides here.

    Raises
    ------
    InputError
        For coefficients of the wrong shape, or outside 0 to 10.
    """

    def __init__(self, model: SoftModel, friction: np.ndarray | float | None = None) -> None:
        self.model, robot = check_model(model), model.robot
        given: Any = [tendon.friction for tendon in robot.tendons] if friction is None else friction
        if isinstance(given, Real):
            one = number("friction", given, lower=0.0, upper=MOST_FRICTION)
            driven = {actuator.tendon for actuator in robot.actuators}
            given = [one if tendon.name in driven else 0.0 for tendon in robot.tendons]
        self._given = mu = array("friction", given, (len(robot.tendons),))
        for tendon, value in zip(robot.tendons, mu, strict=True):
            number(f"friction of {tendon.name!r}", value, lower=0.0, upper=MOST_FRICTION)
        tree, self._S = underlying_tree(model)
        dof = {name: k for k, name in enumerate(tree.joint_names)}
        self._moves = moved_bodies(tree.engine)
        found = [
            (t, guide)
            for t, tendon in enumerate(robot.tendons)
            if mu[t] > 0 or any(wrap.friction for wrap in tendon.wraps)
            for guide in _guides(robot, tendon, float(mu[t]))
        ]
        self.tendon = np.array([t for t, _ in found], int)
        self.friction = read_only([guide.friction for _, guide in found])
        pieces = tuple(guide.piece for _, guide in found)
        self._pieces = compile_tendons(pieces, dof, tree.anchor, self._moves)
        guides = [guide for _, guide in found]
        self._at_joints = np.flatnonzero([guide.joint is not None for guide in guides])
        self._at_sites = np.flatnonzero([guide.sites != () for guide in guides])
        self._dof = np.array([dof[one.joint] for one in guides if one.joint is not None], int)
        anchors = [
            tree.anchor(site.link, np.array(site.xyz)) for guide in guides for site in guide.sites
        ]
        self._bodies = np.array([body for body, _ in anchors], int)
        self._offsets = np.array([xyz for _, xyz in anchors], float).reshape(-1, 3, 1)
        self._around = _Around.of(found, tree.tendons.wraps)
        self._downstream = np.triu(self.tendon[:, None] == self.tendon).astype(float)

    def __reduce__(self) -> tuple[Any, ...]:
        return Capstan, (self.model, self._given)

    def at(self, state: State) -> Guides:
        """The guides in a state of the robot.

        Raises
        ------
        InputError
            For a State of another robot, as in the other methods.
        """
        check_state(self.model, state)
        geometry = self._geometry(state)
        arms, angles = self._parts(geometry).moment_arms, np.zeros(len(self.tendon))
        angles[self._at_joints] = np.abs(geometry.coordinates[self._dof])
        if self._around:
            guide, piece, end = self._around.halves
            arms = arms.copy()
            arms[guide] += geometry.around.arms[piece, end]
            guide, piece = self._around.turns
            angles[guide] = geometry.around.courses.turn[piece]
        if len(self._at_sites):
            before, behind, _ = self._directions(geometry)
            apart, along = (np.linalg.norm(x, axis=1) for x in (before - behind, before + behind))
            angles[self._at_sites] = 2 * np.arctan2(apart, along)  # exact at any angle (Kahan)
        return Guides(self, state, angles, arms if self._S is None else arms @ self._S)

    def derivatives(self, state: State, u: np.ndarray, direction: np.ndarray) -> Derivatives:
        """`Guides.forces` and its Jacobians by q, q̇ (n, n) and u (n, m) at constant directions.

        They are those of a joint force, so the Jacobians of `softdyn.dynamics.balance` minus these
        are those of the balance with friction.

        Parameters
        ----------
        state : State
            The robot's state.
        u : array_like, (m,)
            Input.
        direction : array_like, (guides,)
            As in `Guides.tensions`.
        """
        guides, model = self.at(state), self.model
        force, arms = guides.pull(u), state.moment_arms
        sign = -np.sign(force[self.tendon])
        share, lost = guides.shares(direction, sign), guides.friction_arms(direction, sign)
        rates = arms @ state.v
        gain, damping = taut_slopes(model, state.lengths, rates)
        none = np.zeros(len(force))
        arm_rates = tendon_curvature(model, state.q, none, state.v)[1]
        tree, _ = underlying_tree(model)
        if tree.areas is not None:
            slopes = tree.areas.slopes(state.lengths) * u
            gain = gain - np.bincount(tree.actuated, slopes, len(gain))
        by_q = -lost.T @ (gain[:, None] * arms + damping[:, None] * arm_rates)
        by_q += self._bend(state, force[self.tendon] * (share - 1.0))
        turned = (sign * direction * self.friction)[:, None] * self._angle_gradients(state)
        by_angles = -share[:, None] * (self._downstream.T @ turned)
        by_q += guides.arms.T @ (force[self.tendon, None] * by_angles)
        by_v = -lost.T @ (damping[:, None] * arms)
        gears = tree.gears_at(state.lengths)
        return Derivatives(force @ lost, by_q, by_v, (gears[:, None] * lost[tree.actuated]).T)

    def direction_gradients(self, state: State, u: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Gradients (n, guides) of `Guides.forces` by the directions; arguments as there."""
        guides = self.at(state)
        pull = guides.pull(u)[self.tendon]
        sign = -np.sign(pull)
        behind = (pull * guides.shares(direction, sign))[:, None] * guides.arms
        return -(sign * self.friction * guides.angles * (self._downstream @ behind).T)

    def _geometry(self, state: State) -> TendonGeometry:
        """The tree's cables."""
        model = self.model
        tree, _ = underlying_tree(model)
        q = model.expand(state.q) if isinstance(model, Projection) else state.q
        return tree.tendon_geometry(q)

    def _parts(self, geometry: TendonGeometry) -> TendonGeometry:
        """The parts of the cables behind the guides, without those beside round bodies."""
        kinematics = geometry.S, geometry.rotations, geometry.translations
        return self._pieces.at(geometry.coordinates, *kinematics)

    def _directions(self, geometry: TendonGeometry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unit vectors before and behind each guide at a site, and the points (guides, 3, 3)."""
        points = np.matmul(geometry.rotations[self._bodies], self._offsets)[:, :, 0]
        points = (points + geometry.translations[self._bodies]).reshape(-1, 3, 3)
        before, behind = points[:, 1] - points[:, 0], points[:, 2] - points[:, 1]
        before /= np.linalg.norm(before, axis=1)[:, None]
        behind /= np.linalg.norm(behind, axis=1)[:, None]
        if self._around:
            directions = geometry.around.directions
            (row, piece, end), (last, beyond, there) = self._around.beside
            before[row], behind[last] = directions[piece, end], -directions[beyond, there]
        return before, behind, points

    def _angle_gradients(self, state: State) -> np.ndarray:
        """∂φ/∂q (guides, n).

        With the unit vectors a, b before and behind a guide and c = a · b = cos φ,
        ∂φ = -((b - c a) · ∂a + (a - c b) · ∂b) / sin φ.
        """
        geometry = self._geometry(state)
        S = geometry.S
        found = np.zeros((len(self.tendon), len(S)))
        found[self._at_joints, self._dof] = np.sign(geometry.coordinates[self._dof])
        if self._around:
            guide, piece = self._around.turns
            found[guide] = geometry.around.turn_gradients()[piece]
        if len(self._at_sites):
            before, behind, points = self._directions(geometry)
            # columns of each point, (points, n, 3)
            moved = S[:, :3] + np.cross(S[:, 3:], points.reshape(-1, 1, 3))
            moved = (moved * self._moves.T[self._bodies, :, None]).reshape(len(points), 3, -1, 3)
            cosine = np.einsum("gi,gi->g", before, behind)[:, None]
            sine = np.linalg.norm(np.cross(before, behind), axis=1)[:, None]
            factor = np.where(sine > STRAIGHT, -1.0 / np.maximum(sine, STRAIGHT), 0.0)
            rates = geometry.around.direction_gradients(self._moves) if self._around else None
            for k, (one, other) in enumerate(((before, behind), (behind, before))):
                length = np.linalg.norm(points[:, k + 1] - points[:, k], axis=1)
                across = factor * (other - cosine * one)
                change = (moved[:, k + 1] - moved[:, k]) / length[:, None, None]
                if rates is not None:
                    row, piece, end = self._around.beside[k]
                    change[row] = (1 - 2 * k) * rates[piece, end]
                found[self._at_sites] += np.einsum("gi,gni->gn", across, change)
        return found if self._S is None else found @ self._S

    def _bend(self, state: State, force: np.ndarray) -> np.ndarray:
        """Σ force ∂²ℓ/∂q² (n, n) of the pieces behind the guides."""
        if not self._pieces.spatial and not self._around:
            return np.zeros((self.model.nv, self.model.nv))
        geometry = self._geometry(state)
        total, _ = self._parts(geometry).curvature(force, np.zeros(len(self._moves)))
        if self._around:
            guide, piece, end = self._around.halves
            total += np.tensordot(force[guide], geometry.around.arm_gradients[piece, end], 1)
        return project(self._S, total)


@dataclass(frozen=True, eq=False)
class Guides:
    """The guides in one state.

    Attributes
    ----------
    capstan : Capstan
        The guides of the robot.
    state : State
        The state.
    angles : ndarray, (guides,)
        Wrap angles φ (rad).
    arms : ndarray, (guides, n)
        Moment arms ∂ℓ_i/∂q of the piece of cable behind each guide, up to the next one.
    """

    capstan: Capstan
    state: State
    angles: np.ndarray
    arms: np.ndarray

    @property
    def arms_beyond(self) -> np.ndarray:
        """Moment arms ∂L_i/∂q (guides, n) of the whole cable beyond each guide."""
        return self.capstan._downstream @ self.arms

    @property
    def speeds(self) -> np.ndarray:
        """Sliding speed (guides,) of the cable, positive towards the driven end (m/s)."""
        return -self.arms_beyond @ self.state.v

    def pull(self, u: np.ndarray) -> np.ndarray:
        """Force f (tendons,) at the driven ends, negative for a tension (N).

        Parameters
        ----------
        u : array_like, (m,)
            Input.
        """
        state, model = self.state, self.capstan.model
        force = tendon_forces(model, vector("u", u, model.nu), state.lengths)
        if model.stretches:
            rates = state.moment_arms @ state.v
            gain, damping = taut_gains(model, state.lengths, rates)
            force -= gain * (state.lengths - model.tendon_rest) + damping * rates
        return force

    def tensions(self, u: np.ndarray, direction: np.ndarray | None = None) -> np.ndarray:
        """Tension (guides,) behind each guide (N).

        Parameters
        ----------
        u : array_like, (m,)
            Input.
        direction : array_like, (guides,), optional
            Direction of sliding d, from -1 to 1, positive towards the driven end. Values between
            stand for a cable that sticks. By default the sign of `speeds`.
        """
        pull = -self.pull(u)[self.capstan.tendon]
        return pull * self.shares(self._direction(direction), np.sign(pull))

    def shares(self, direction: np.ndarray, sign: np.ndarray) -> np.ndarray:
        """T_i / T₀ (guides,) of cables with tensions of a sign.

        Parameters
        ----------
        direction, sign : ndarray, (guides,)
            The direction of sliding, and the sign of T.
        """
        capstan = self.capstan
        lost = capstan._downstream.T @ (direction * capstan.friction * self.angles)
        return np.exp(-sign * lost)

    def friction_arms(self, direction: np.ndarray, sign: np.ndarray) -> np.ndarray:
        """Change of each tendon's moment arms (tendons, n) by friction; arguments as in `shares`.

        A tendon's force f acts on the joints with ∂ℓ/∂q and this change.
        """
        change = (self.shares(direction, sign) - 1.0)[:, None] * self.arms
        found = np.zeros(self.state.moment_arms.shape)
        np.add.at(found, self.capstan.tendon, change)
        return found

    def forces(self, u: np.ndarray, direction: np.ndarray | None = None) -> np.ndarray:
        """Joint forces of friction (n,), to add to B u - h; arguments as in `tensions`."""
        force = self.pull(u)
        sign = -np.sign(force[self.capstan.tendon])
        return force @ self.friction_arms(self._direction(direction), sign)

    def dissipation(self, u: np.ndarray, direction: np.ndarray | None = None) -> np.ndarray:
        """Power lost at each guide (guides,) (W); arguments as in `tensions`."""
        capstan = self.capstan
        behind = self.tensions(u, direction)
        before = -self.pull(u)[capstan.tendon]
        inner = capstan.tendon[1:] == capstan.tendon[:-1]
        before[1:][inner] = behind[:-1][inner]
        return (before - behind) * self.speeds

    def _direction(self, direction: np.ndarray | None) -> np.ndarray:
        if direction is None:
            return np.sign(self.speeds)
        return array("direction", direction, (len(self.angles),))


class _Guide(NamedTuple):
    """A guide of a tendon: a joint, a site or a round body.

    Attributes
    ----------
    friction : float
        Its coefficient μ.
    piece : Tendon
        The piece of cable behind it; empty if that lies beside a round body.
    joint : str or None
        The joint.
    sites : tuple of Site
        The site, between the one before it and the one behind it; else empty.
    body : Wrap or None
        The round body.
    before, behind : tuple of (Wrap, int) or None
        The round body, this one included, beside which the cable lies before a site or behind a
        guide, and which of the two sites beside the body, 0 or 1, this piece leads to.
    """

    friction: float
    piece: Tendon
    joint: str | None = None
    sites: tuple[Site, ...] = ()
    body: Wrap | None = None
    before: tuple[Wrap, int] | None = None
    behind: tuple[Wrap, int] | None = None


class _Around(NamedTuple):
    """Numbers of the guides at and beside round bodies; false if there are none.

    Attributes
    ----------
    turns : ndarray of int, (2, k)
        Guides at a body, and the cables' pieces around it.
    halves : ndarray of int, (3, k)
        Guides whose piece behind lies beside a body, that piece, and the site, 0 or 1.
    beside : tuple of ndarray of int, (3, k)
        Rows of guides at sites with a body before the site, that piece, and the site; likewise with
        a body behind the site.
    """

    turns: np.ndarray
    halves: np.ndarray
    beside: tuple[np.ndarray, np.ndarray]

    def __bool__(self) -> bool:
        return self.turns.size > 0

    @classmethod
    def of(cls, found: list[tuple[int, _Guide]], paths: WrappedPaths) -> _Around:
        pieces = zip(paths.tendon.tolist(), paths.after.tolist(), strict=True)
        number = {piece: k for k, piece in enumerate(pieces)}
        turns, halves, row = [], [], 0
        beside: tuple[list[tuple[int, ...]], list[tuple[int, ...]]] = [], []
        for g, (t, guide) in enumerate(found):
            if guide.body is not None:
                turns.append((g, number[t, guide.body.after]))
            if guide.behind is not None:
                wrap, end = guide.behind
                halves.append((g, number[t, wrap.after], end))
            if guide.sites:
                for there, rows in zip((guide.before, guide.behind), beside, strict=True):
                    if there is not None:
                        rows.append((row, number[t, there[0].after], there[1]))
                row += 1
        before, behind = (np.array(rows, int).reshape(-1, 3).T for rows in beside)
        return cls(
            np.array(turns, int).reshape(-1, 2).T, np.array(halves, int).reshape(-1, 3).T,
            (before, behind),
        )  # fmt: skip


def _guides(robot: Robot, tendon: Tendon, friction: float) -> Iterator[_Guide]:
    """A tendon's guides with the piece behind each, from the driven end."""
    forward = driven_end(robot, tendon) is PathEnd.FIRST
    if tendon.sites:
        yield from _guides_of_path(tendon, forward, friction)
        return
    kinds = {joint.name: joint.kind for joint in robot.joints}
    found: list[tuple[str, list[JointTerm]]] = []
    behind: list[JointTerm] = []  # the piece behind the last guide; there is none yet
    for term in tendon.terms if forward else tendon.terms[::-1]:
        if kinds[term.joint] == "revolute":
            half = JointTerm(term.joint, term.coef / 2)
            behind.append(half)
            behind = [half]
            found.append((term.joint, behind))
        else:
            behind.append(term)
    for joint, terms in found:
        yield _Guide(friction, Tendon(tendon.name, terms=tuple(terms)), joint)


def _guides_of_path(tendon: Tendon, forward: bool, friction: float) -> Iterator[_Guide]:
    """The inner sites and the round bodies of a path."""
    order = 1 if forward else -1
    sites, far, near = tendon.sites[::order], int(forward), int(not forward)
    between: list[Wrap | None] = [None] * (len(sites) - 1)
    for wrap in tendon.wraps:
        between[wrap.after] = wrap
    empty, before = Tendon(tendon.name), None
    for k, body in enumerate(between[::order]):
        if k > 0:
            yield _Guide(
                friction, empty if body else Tendon(tendon.name, sites=sites[k : k + 2]),
                sites=sites[k - 1 : k + 2], before=before, behind=(body, near) if body else None,
            )  # fmt: skip
        before = (body, far) if body else None
        if body is not None:
            own = friction if body.friction is None else body.friction
            yield _Guide(own, empty, body=body, behind=before)
