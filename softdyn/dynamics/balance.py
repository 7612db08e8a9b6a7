"""The balance of a robot's joint forces, with its Jacobians.

With the joint forces of springs, dampers, tendons and disturbances, the balance at (q, v, a) is

    r = M a + C v + g + D v + K - B u - F - E d.

F is the sum of one's own forces (`softdyn.dynamics.forces`). K, D and F are the tree's own: a State
in NumPy has them from the same place (`TreeModel.passive_forces`, `TreeModel.forces_at`).

Pinocchio's RNEA derivatives (Carpentier and Mansard 2018) give M a + C v + g, its Jacobians, M, the
joint Jacobian and the placements at once.

A tendon of length ℓ has the moment arms α = ∂ℓ/∂q, and its curvature is H = ∂²ℓ/∂q². It pushes with
the force f = Σ gear u - k (ℓ - rest) - d ℓ̇. Its part of r is -α f, with the Jacobians

    by q: αᵀ (k α + d (H v)) - f H,    by v: d αᵀ α.

The armature m of a tendon adds m α αᵀ to M, and takes m (α · a + vᵀ H v) from f, with

    by q: m α (H a + ∂(vᵀ H v)/∂q)ᵀ,    by v: 2 m α (H v)ᵀ.

A chamber whose area changes takes Σ u ∂gear/∂ℓ from k (`softdyn.dynamics.areas`). A slack tendon
without tension has k = d = 0. The cable of a winch adds its own k and d
(`softdyn.dynamics.winches`).

The disturbances d act through E:

- a force f at the tip, Jᵀ f (its Jacobian by q: `softdyn.dynamics.points`);
- a payload m at the tip, a point mass: the same derivatives of a robot of this mass alone, times m
  (below zero by its weight alone, since an inertia below zero has no motion);
- a factor 1 + s of the joint springs, -s K;
- offsets o of the springs' rest positions, k o;
- the torques z of Maxwell branches, -z (`softdyn.dynamics.relaxation`).
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.checks import vector
from softdyn.description.rig import Actuator
from softdyn.description.robot import sliding
from softdyn.dynamics.engine import Scratch
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.points import BodyPoint
from softdyn.dynamics.projection import Projection, underlying_tree
from softdyn.dynamics.relaxation import Branches
from softdyn.dynamics.winches import Winches


class Disturbance(Enum):
    """A slow quantity that the model lacks, estimated beside the state."""

    TIP_FORCE = "tip_force"
    """Force at the tip in the world's axes (N), three components."""
    PAYLOAD = "payload"
    """Mass at the tip (kg)."""
    STIFFNESS = "stiffness"
    """Relative change of all joint springs' stiffness."""
    JOINT_OFFSETS = "joint_offsets"
    """Offsets of the joint springs' rest positions (rad, m), one per degree of freedom."""
    RELAXATION = "relaxation"
    """Torques of the Maxwell branches (N m, N), one per branch of a joint."""

    def size(self, model: SoftModel) -> int:
        """The number of its components."""
        return len(self.units(model))

    def units(self, model: SoftModel) -> dict[str, str]:
        """The units of its components by their names, e.g. ``tip_force.x`` in N."""
        parts: dict[str, str] = {"": ""}
        if self is Disturbance.TIP_FORCE:
            parts = dict.fromkeys((".x", ".y", ".z"), "N")
        elif self is Disturbance.PAYLOAD:
            parts = {"": "kg"}
        elif self is Disturbance.JOINT_OFFSETS:
            slide = sliding(model.robot, names := model.joint_names)
            units = ("m" if slides else "rad" for slides in slide)
            parts = {f".{name}": unit for name, unit in zip(names, units, strict=True)}
        elif self is Disturbance.RELAXATION:
            parts = {
                f".{joint.name}.{number}": "N" if joint.kind == "prismatic" else "N m"
                for joint in model.robot.joints
                for number in range(1, len(joint.relaxation) + 1)
            }
        return {self.value + part: unit for part, unit in parts.items()}


class BalanceTerms(NamedTuple):
    """The balance at one point.

    Attributes
    ----------
    residual : ndarray, (n,)
        r (N m, N).
    by_q, by_v, by_a : ndarray, (n, n)
        Its Jacobians by q ⊕ dq, by v and by a; the last is M.
    by_commands : ndarray, (n, m)
        Its Jacobian by the commands.
    by_d : ndarray, (n, nd)
        -E, its Jacobian by the disturbances.
    inputs : ndarray, (m,)
        The inputs u that act.
    """

    residual: np.ndarray
    by_q: np.ndarray
    by_v: np.ndarray
    by_a: np.ndarray
    by_commands: np.ndarray
    by_d: np.ndarray
    inputs: np.ndarray


class ForceBalance:
    """The balance of a robot's joint forces.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    disturbances : tuple of Disturbance
        The disturbances, in the order of d.
    motors : tuple of Actuator, optional
        The motors that take the commands, by default those of the robot. Without motors, (),
        the commands are the inputs u.
    """

    def __init__(
        self,
        model: SoftModel,
        disturbances: tuple[Disturbance, ...] = (),
        motors: tuple[Actuator, ...] | None = None,
    ) -> None:
        self._model = check_model(model)
        tree, self._S = underlying_tree(model)
        self._tree, self._expand = tree, model.expand if isinstance(model, Projection) else None
        columns, self._size = {}, 0
        for one in disturbances:
            first, self._size = self._size, self._size + one.size(model)
            columns[one] = slice(first, self._size)
        self._force, self._mass, self._factor, self._offsets, self._creep = map(
            columns.get, Disturbance
        )
        if self._creep:
            self._creeping = Branches.of(tree).rates.T
        if self._force or self._mass:
            self._tip = BodyPoint(tree.engine, *tree.anchor(model.robot.task, np.zeros(3)))
            self._point = Scratch(_point_mass(tree.engine, self._tip))
        motors = model.robot.actuators if motors is None else motors
        self._winches = Winches(model, motors) if any(one.is_winch for one in motors) else None
        changes = self._winches is not None or tree.areas is not None
        self._pulls_back = changes or tree.stretches
        self._acts = np.zeros((len(tree.tendons.names), tree.nu))
        self._acts[tree.actuated, np.arange(tree.nu)] = 1.0
        self._gears = self._acts * tree.gear
        self._slope = -self._gears

    def __call__(
        self,
        q: np.ndarray,
        v: np.ndarray,
        a: np.ndarray,
        commands: np.ndarray,
        d: np.ndarray | None = None,
    ) -> BalanceTerms:
        """The balance, in new arrays.

        Parameters
        ----------
        q, v, a : array_like, (nq,), (n,), (n,)
            Configuration, velocity, acceleration.
        commands : array_like, (m,)
            Inputs u; for a winch the free length of its cable.
        d : array_like, (nd,), optional
            Disturbances, zero by default.

        Raises
        ------
        InputError
            For a wrong shape or a number that is not finite.
        """
        model = self._model
        return self.trusted(
            vector("q", q, model.nq), vector("v", v, model.nv), vector("a", a, model.nv),
            vector("commands", commands, model.nu),
            np.zeros(self._size) if d is None else vector("d", d, self._size),
        )  # fmt: skip

    def trusted(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, commands: np.ndarray, d: np.ndarray
    ) -> BalanceTerms:
        """The balance at arguments that are right, without the checks, a fifth of its time."""
        S = self._S
        if S is None or self._expand is None:
            return self._of_tree(q, v, a, commands, d)
        r, by_q, by_v, M, by_commands, by_d, u = self._of_tree(
            self._expand(q), S @ v, S @ a, commands, d
        )
        return BalanceTerms(
            S.T @ r, S.T @ by_q @ S, S.T @ by_v @ S, S.T @ M @ S, S.T @ by_commands, S.T @ by_d, u
        )

    def _of_tree(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, commands: np.ndarray, d: np.ndarray
    ) -> BalanceTerms:
        """The balance of the tree's joints at the tree's (q, v, a)."""
        tree, n, coordinates = self._tree, self._tree.nv, self._tree.chart.of(q)
        here, data = tree.about_base(q), tree.pin_data
        blocks = pin.computeRNEADerivatives(tree.engine, data, here, v, a)
        by_q, by_v, M = (np.array(block.reshape(n, n), order="C") for block in blocks)
        r, kinematics = np.array(data.tau), tree.last_kinematics()
        geometry = tree.tendons.at(coordinates, *kinematics)
        lengths, arms = geometry.lengths, geometry.moment_arms
        passive, u = tree.passive_forces(coordinates, lengths, arms, v), commands
        gears, slope = self._gears, self._slope
        if tree.areas is not None:
            gears = self._acts * tree.areas.gears(lengths)
            slope = -gears
        gain, damping = passive.gain, passive.damping
        by_v += passive.by_v
        if self._winches is not None:
            found = self._winches.inputs(lengths, arms @ v, commands)
            u, slope = found[0], slope * found[3]
            by_length, by_rate = (gears @ one for one in found[1:3])
            gain, damping = gain - by_length, damping - by_rate
            by_v -= arms.T @ (by_rate[:, None] * arms)
        if tree.areas is not None:
            gain = gain - self._acts @ (u * tree.areas.slopes(lengths))
        pull = gears @ u
        if tree.rotors:
            rates, seconds = tree.tendons.arm_rates(v, *kinematics)
            momenta = tree.tendon_armature[:, None] * arms
            M += momenta.T @ arms
            by_q += momenta.T @ (tree.tendons.arm_rates(a, *kinematics)[0] + seconds)
            by_v += 2.0 * (momenta.T @ rates)
            pull = pull - tree.tendon_armature * (arms @ a + rates @ v)
        r += passive.K + passive.D @ v - pull @ arms
        by_q.flat[:: n + 1] += passive.stiffness
        if self._pulls_back:
            by_q += arms.T @ (gain[:, None] * arms)
        if tree.tendons.spatial:
            force = pull - passive.tension if self._pulls_back else pull
            bend, turning = geometry.curvature(force, v)
            by_q -= bend
            if self._pulls_back and damping.any():
                by_q += arms.T @ (damping[:, None] * turning)
        by_d = np.zeros((n, self._size))
        terms = BalanceTerms(r, by_q, by_v, M, arms.T @ slope, by_d, u)
        if self._size:
            self._add_disturbances(terms, coordinates, here, v, a, d)
        if tree.forced:  # last, because they may use the engine
            own = tree.forces_at(q, v), *tree.force_derivatives(q, v)
            for term, part in zip((r, by_q, by_v), own, strict=True):
                term -= part
        return terms

    def _add_disturbances(
        self, terms: BalanceTerms, coordinates: np.ndarray, q: np.ndarray, v: np.ndarray,
        a: np.ndarray, d: np.ndarray,
    ) -> None:  # fmt: skip
        """Subtract the forces of the disturbances."""
        r, by_q, by_v, M, _, by_d, _ = terms
        tree, scale, shift = self._tree, 0.0, 0.0
        if self._factor:
            (scale,) = d[self._factor]
        if self._offsets:
            S = np.eye(tree.nv) if self._S is None else self._S
            shift = S @ d[self._offsets]
            by_d[:, self._offsets] = -(1.0 + scale) * (tree.stiffness[:, None] * S)
            r -= (1.0 + scale) * tree.stiffness * shift
        if self._factor:
            stretch = coordinates - tree.rest
            by_d[:, self._factor] = (tree.stiffness * (stretch - shift))[:, None]
            r += scale * tree.stiffness * stretch
            by_q.flat[:: tree.nv + 1] += scale * tree.stiffness
        if self._creep:
            by_d[:, self._creep] = self._creeping
            r += self._creeping @ d[self._creep]
        if self._force:
            kinematics, columns = tree.last_kinematics(), by_d[:, self._force]
            self._tip.subtract_force(r, by_q, columns, d[self._force], *kinematics)
        if self._mass:
            (mass,), point, n = d[self._mass], self._point, tree.nv
            inertia = max(mass, 0.0)
            moving = float(mass >= 0)
            blocks = pin.computeRNEADerivatives(point.model, point.data, q, moving * v, moving * a)
            by_d[:, self._mass] = point.data.tau[:, None]
            r += mass * point.data.tau
            for term, block, factor in zip(
                (by_q, by_v, M), blocks, (mass, inertia, inertia), strict=True
            ):
                term += factor * block.reshape(n, n)


def _point_mass(engine: pin.Model, at: BodyPoint) -> pin.Model:
    """The tree with a mass of 1 kg at a point, and no other."""
    alone = engine.copy()
    for k in range(len(alone.inertias)):
        alone.inertias[k] = pin.Inertia.Zero()
    alone.inertias[at.body] = pin.Inertia(1.0, at.offset, np.zeros((3, 3)))
    alone.armature[:] = 0.0
    return alone
