"""The interface of every model of a soft robot, and the State of its terms.

`softdyn.dynamics.tree.TreeModel` implements `SoftModel` with Pinocchio, and
`softdyn.dynamics.mimic.MimicModel` implements it for robots with mimic joints. `softdyn.build`
chooses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from softdyn.checks import array, length, read_only, vector
from softdyn.description.robot import Robot
from softdyn.dynamics import text
from softdyn.dynamics.curves import Curves, curves_of
from softdyn.dynamics.tendons import Tendons
from softdyn.exceptions import InputError

if TYPE_CHECKING:
    import softdyn


@runtime_checkable
class SoftModel(Protocol):
    """The analytic dynamics of an annotated robot.

    Below, n = nv is the number of degrees of freedom and m = nu that of inputs. Units are SI and
    radians. Several threads may use a model, because each has its own scratch memory. States do not
    use this memory.

    Attributes
    ----------
    robot : Robot
        The parsed description; the engine reads the same file.
    bundled : str or None
        Name among the bundled robots, None for any other file.
    name : str
        The robot's name.
    joint_names : tuple of str
        Names in the order of v and of all columns.
    nq, nv, nu : int
        Sizes of q, v and u.
    q0 : ndarray, (nq,)
        The configuration with all coordinates zero.
    u_min, u_max : ndarray, (m,)
        Bounds of the inputs.
    lower, upper : ndarray, (n,)
        Position limits; infinite for a joint without limits.
    stiffness, rest, damping, armature : ndarray, (n,)
        Spring stiffness, rest position, damping and armature of each joint.
    tendons : Tendons
        The tendons' geometry.
    tendon_stiffness, tendon_damping, tendon_rest : ndarray, (tendons,)
        Stiffness, damping and rest length of each tendon. A rest length that the file omits is the
        length at q = 0.
    joint_curves : Curves or None
        The joints' springs and dampers that are not linear, if there are any.
    tendon_slack : ndarray of bool, (tendons,)
        Whether each tendon only pulls.
    """

    robot: Robot
    bundled: str | None
    name: str
    joint_names: tuple[str, ...]
    nq: int
    nv: int
    nu: int
    q0: np.ndarray
    u_min: np.ndarray
    u_max: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    stiffness: np.ndarray
    rest: np.ndarray
    damping: np.ndarray
    armature: np.ndarray
    tendons: Tendons
    tendon_stiffness: np.ndarray
    tendon_damping: np.ndarray
    tendon_rest: np.ndarray
    tendon_slack: np.ndarray
    joint_curves: Curves | None = None

    @cached_property
    def tendon_armature(self) -> np.ndarray:
        """Armature (tendons,) of each tendon: its rotor's inertia felt along it (kg)."""
        return read_only([tendon.armature for tendon in self.robot.tendons])

    @cached_property
    def tendon_curves(self) -> Curves | None:
        """The tendons' springs and dampers that are not linear, if there are any."""
        return curves_of(self.robot.tendons)

    @cached_property
    def curved(self) -> bool:
        """Whether a spring or a damper is not linear."""
        return self.tendon_curves is not None or curves_of(self.robot.joints) is not None

    @cached_property
    def stretches(self) -> bool:
        """Whether a tendon has a spring or a damper."""
        linear = self.tendon_stiffness.any() or self.tendon_damping.any()
        return bool(linear) or self.tendon_curves is not None

    @property
    def relaxed(self) -> np.ndarray:
        """The input (m,) nearest to zero within the bounds, an array of the caller's own."""
        return np.clip(np.zeros(self.nu), self.u_min, self.u_max)

    @property
    def forces(self) -> tuple[Any, ...]:
        """The forces of one's own that act on the robot; see `with_forces`."""
        return self.robot.forces

    @property
    def forced(self) -> bool:
        """Whether F acts: own forces, drag of a fluid, buoyancy, or springs of ball joints."""
        robot = self.robot
        return bool(robot.forces or robot.fluid or robot.buoyant or robot.balls)

    def with_forces(self, *forces: Any) -> SoftModel:
        """A new model of the robot, on which further forces act.

        Parameters
        ----------
        *forces : Force
            Objects that meet the contract `softdyn.dynamics.Force`. The new model holds copies of
            them.

        Raises
        ------
        InputError
            For an object that does not meet the contract, and for two forces of one name.
        """

    def __reduce__(self) -> tuple[Any, ...]:
        # A pickle cannot keep views of the engine's memory, so the copy is built from the file.
        return type(self), (self.robot, self.bundled)

    def __repr__(self) -> str:
        return f"<softdyn model of {self.name!r}: nq {self.nq}, nv {self.nv}, nu {self.nu}>"

    def __str__(self) -> str:
        robot, bundled = self.robot, " (bundled)" if self.bundled else ""
        lines = (*text.joint_lines(robot), *text.input_lines(robot), *text.rig_lines(robot))
        head = text.head(self.name, robot, self.nv)
        return "\n  ".join((head, f"file    {robot.path}{bundled}", *lines))

    def state(self, q: np.ndarray, v: np.ndarray) -> State:
        """Every term of the dynamics at (q, v).

        Parameters
        ----------
        q : array_like, (nq,)
            Configuration (rad, m; (cos, sin) of a continuous joint).
        v : array_like, (n,)
            Velocity.

        Raises
        ------
        InputError
            For a wrong shape, a number that is not finite, or (cos, sin) of a continuous joint
            that is off the unit circle by more than 1e-6, as in all other methods.
        """

    def states(self, Q: np.ndarray, V: np.ndarray) -> StateBatch:
        """The States of k configurations and velocities, equal to those of `state` to the bit.

        Parameters
        ----------
        Q : array_like, (k, nq)
            Configurations.
        V : array_like, (k, n)
            Velocities.

        Raises
        ------
        InputError
            As `state`.
        """
        Q, V = check_batch(self, Q, V)
        return StateBatch.of(self, [self.state(q, v) for q, v in zip(Q, V, strict=True)])

    def coriolis(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Coriolis matrix C (n, n) with Ṁ - 2C skew-symmetric."""

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Gravity force g (n,), the gradient of `gravity_energy`."""

    def forward_dynamics(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Acceleration q̈ (n,) under the input u (m,), of M q̈ = B u - h."""

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> float:
        """½ q̇ᵀ M q̇ (J), armature included."""

    def gravity_energy(self, q: np.ndarray) -> float:
        """Potential energy of gravity (J), zero at the world's origin."""

    def elastic_energy(self, q: np.ndarray) -> float:
        """Energy of joint springs and elastic tendons (J)."""

    def forces_at(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """F (n,), the sum of one's own forces (N m, N), as in `State.F`.

        Raises
        ------
        ForceError
            For a force that raises, that returns anything but finite numbers of shape (n,), or that
            changes or keeps its arguments.
        """

    def force_derivatives(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n) of one's own forces; central differences by default."""

    @property
    def conserves(self) -> bool:
        """Whether each force of one's own has a potential."""

    def forces_energy(self, q: np.ndarray) -> float:
        """Energy of those forces of one's own that have a potential (J)."""

    def potential_energy(self, q: np.ndarray) -> float:
        """Gravity, elastic energy and that of one's own forces together (J)."""
        energy = self.gravity_energy(q) + self.elastic_energy(q)
        return energy + self.forces_energy(q) if self.forced else energy

    def tendon_lengths(self, q: np.ndarray) -> np.ndarray:
        """Lengths (tendons,) of all tendons, in the file's order (m, or the unit of coef · q)."""

    def tendon_moment_arms(self, q: np.ndarray) -> np.ndarray:
        """Moment arms ∂ℓ/∂q (tendons, n)."""

    def tendon_hessians(self, q: np.ndarray) -> np.ndarray:
        """Gradients of the moment arms ∂²ℓ/∂q² (tendons, n, n)."""

    def tangent_stiffness(self, q: np.ndarray, v: np.ndarray | None = None) -> np.ndarray:
        """∂K/∂q (n, n): joint springs, and k (a aᵀ + (ℓ - rest) ∂a/∂q) of each taut tendon.

        Parameters
        ----------
        q : array_like, (nq,)
            Configuration.
        v : array_like, (n,), optional
            Velocity, zero by default. Slack tendons depend on it: see `taut_gains`.
        """
        arms, lengths = self.tendon_moment_arms(q), self.tendon_lengths(q)
        v = np.zeros(self.nv) if v is None else vector("v", v, self.nv)
        gain, _ = taut_gains(self, lengths, arms @ v)
        slope, _ = taut_slopes(self, lengths, arms @ v)
        springs = self.stiffness
        if self.joint_curves is not None:
            springs = springs + self.joint_curves.tangents(self.coordinates(q) - self.rest, v)[0]
        return (
            np.diag(springs)
            + arms.T @ (slope[:, None] * arms)
            + np.tensordot(gain * (lengths - self.tendon_rest), self.tendon_hessians(q), 1)
        )

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """Joint coordinates (n,) of a configuration.

        A continuous joint has one angle in (-π, π]. A floating base has its position and its
        rotation vector. Every other joint has its number in q.
        """

    def configuration(self, coordinates: np.ndarray) -> np.ndarray:
        """Configuration q (nq,) of joint coordinates (n,): the inverse of `coordinates`."""

    def link_poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Pose (4, 4) in the world of every link."""

    def link_jacobian(self, q: np.ndarray, link: str) -> np.ndarray:
        """Jacobian (6, n) of a link's frame, in the world's axes at the frame's origin.

        The first three rows give the velocity of the origin (m/s), the others the angular velocity
        (rad/s). A force f and a torque τ at the origin, in the world's axes, are the joint force
        Jᵀ (f, τ).

        Raises
        ------
        InputError
            For a link that the robot does not have, besides a wrong q.
        """

    def link_velocity(self, q: np.ndarray, v: np.ndarray, link: str) -> np.ndarray:
        """Velocity of a link's origin and its angular velocity (6,), in the world's axes.

        It is ``link_jacobian(q, link) @ v``.
        """
        return self.link_jacobian(q, link) @ vector("v", v, self.nv)

    def measure(self, state: State, u: np.ndarray) -> softdyn.sensing.Measurement:
        """The readings of the robot's sensors without errors, and their derivatives.

        Parameters
        ----------
        state : State
            The robot's state.
        u : array_like, (m,)
            Input, on which tensions and accelerations depend.

        Raises
        ------
        InputError
            For a wrong shape or a number that is not finite, or for a sensor of a tendon, link or
            joint that the robot does not have.
        """
        import softdyn  # its public names; the dynamics stand below the sensors and import none

        return softdyn.sensing.measure(self, state, u)

    def integrate(self, q: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """q ⊕ dv (nq,): the configuration after the displacement dv (n,)."""


def taut_gains(
    model: SoftModel, lengths: np.ndarray, rates: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping (tendons,) that act; both are zero for a slack tendon without tension.

    They are secants: the stretch and the rate times them are the forces, where a spring or a damper
    is not linear, too. A tendon that may be slack has the tension max(0, k (ℓ - rest) + d ℓ̇).

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    lengths, rates : ndarray, (tendons,)
        Tendon lengths ℓ and their rates ℓ̇.
    """
    gain, damping = model.tendon_stiffness, model.tendon_damping
    if model.tendon_curves is not None:
        more = model.tendon_curves.secants(lengths - model.tendon_rest, rates)
        gain, damping = gain + more[0], damping + more[1]
    if not model.tendon_slack.any():
        return gain, damping
    loose = gain * (lengths - model.tendon_rest) + damping * rates <= 0
    loose &= model.tendon_slack
    return np.where(loose, 0.0, gain), np.where(loose, 0.0, damping)


def taut_slopes(
    model: SoftModel, lengths: np.ndarray, rates: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives (tendons,) of the tendons' forces by lengths and rates; else `taut_gains`."""
    if model.tendon_curves is None:
        return taut_gains(model, lengths, rates)
    # a tendon that can be slack is linear
    more = model.tendon_curves.tangents(lengths - model.tendon_rest, rates)
    curved = np.any([*model.tendon_curves.spring, *model.tendon_curves.damper], axis=0)
    gain, damping = taut_gains(model, lengths, rates)
    return (
        np.where(curved, model.tendon_stiffness + more[0], gain),
        np.where(curved, model.tendon_damping + more[1], damping),
    )


def check_model(value: Any) -> SoftModel:
    """Return `value` if it is a model.

    Raises
    ------
    InputError
        If it is none, for example a robot's name or file.
    """
    # a Protocol's isinstance looks for every attribute, a quarter of a solver's time
    if SoftModel not in type(value).__mro__ and not isinstance(value, SoftModel):
        raise InputError("model", "a model, from softdyn.load(…)", repr(value))
    return value


def check_state(model: SoftModel, state: Any) -> None:
    """Refuse anything but a State of this robot, or of an equal copy of its description.

    Raises
    ------
    InputError
        It says which robot the state is of.
    """
    if not isinstance(state, State):
        raise InputError("state", "a State, from model.state(q, v)", repr(state))
    if state.model is model:
        return
    own, other = model.robot, state.model.robot
    if other is not own and other.digest != own.digest:
        got = f"one of {other.path}" + " with another rig" * (other.path == own.path)
        raise InputError("state", f"a state of {own.path}", got)


@dataclass(frozen=True, eq=False, repr=False)
class State:
    """Terms of M q̈ + C q̇ + D q̇ + K + g = B u + F at (q, v); paper, eq. (1), with F.

    Arrays are read-only. F is the sum of one's own forces, zero without any (`Force`).

    `SoftModel.state` makes States. The constructor and `dataclasses.replace` check the shapes and
    copy the arrays as read-only ones; the numbers need not be finite.

    Attributes
    ----------
    model : SoftModel
        The robot's model.
    q, v : ndarray, (nq,), (n,)
        Configuration and velocity (rad, m; per second).
    M : ndarray, (n, n)
        Mass matrix, armatures of joints and tendons included.
    bias : ndarray, (n,)
        C q̇ + g.
    K : ndarray, (n,)
        Forces of joint springs and elastic tendons, without slack ones.
    D : ndarray, (n, n)
        Damping of joints and tendons, without slack ones.
    B : ndarray, (n, m)
        Input matrix, Σ gear · (∂ℓ/∂q)ᵀ, with the area at q of a chamber whose area changes.
    h : ndarray, (n,)
        C q̇ + D q̇ + K + g - F.
    J, Jdot : ndarray, (3, n)
        Linear Jacobian of the tip in the world's axes and its time derivative, so that
        ÿ = J q̈ + J̇ q̇ is the classical acceleration.
    y, ydot : ndarray, (3,)
        Tip position and velocity in the world (m, m/s).
    lengths : ndarray, (tendons,)
        Tendon lengths.
    moment_arms : ndarray, (tendons, n)
        ∂ℓ/∂q.

    Raises
    ------
    InputError
        For arrays of other shapes, text, complex numbers and the like.
    """

    model: SoftModel
    q: np.ndarray
    v: np.ndarray
    M: np.ndarray
    bias: np.ndarray
    K: np.ndarray
    D: np.ndarray
    B: np.ndarray
    h: np.ndarray
    J: np.ndarray
    Jdot: np.ndarray
    y: np.ndarray
    ydot: np.ndarray
    lengths: np.ndarray
    moment_arms: np.ndarray

    def __post_init__(self) -> None:
        # Compiled kernels trust shapes and memory layouts. A wrong shape would let them read beyond
        # an array; another layout would make Numba compile them again.
        varies = _inputs_vary(self.model)
        for name, shape in _shapes(self.model).items():
            value = array(name, getattr(self, name), shape, finite=False)
            if name == "B" and varies:
                value = np.asfortranarray(value)  # the layout of the model's own B
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        return f"<State of {self.model.name!r}: tip at {' '.join(f'{x:.4f}' for x in self.y)} m>"

    def __str__(self) -> str:
        model, at = self.model, text.numbers(self.y)
        speed = float(np.linalg.norm(self.ydot))
        moves = f"moving at {speed:.4g} m/s" if self.v.any() else "at rest"
        coordinates = model.coordinates(self.q)
        return "\n  ".join((
            f"State of {model.name}: tip at {at} m, {moves}",
            *text.coordinate_lines(model.robot, model.joint_names, coordinates, self.v),
            *text.length_lines(model.robot, self.lengths),
        ))  # fmt: skip

    @staticmethod
    def trusted(**terms: Any) -> State:
        """Make a State from its model and read-only arrays by name, without any check.

        Further terms, such as `g` and `F`, may be given; they are then not computed on first use.
        """
        state = object.__new__(State)
        state.__dict__.update(terms)
        return state

    def __reduce__(self) -> tuple[Any, ...]:
        # unpickled arrays are writable, and B has another memory layout
        return State._restored, (self.__dict__,)

    @staticmethod
    def _restored(terms: dict[str, Any]) -> State:
        known = {name: terms[name] for name in terms if name not in State.__match_args__}
        for value in known.values():  # C and g too, if they were computed
            value.flags.writeable = False
        state = State(**{name: terms[name] for name in State.__match_args__})
        state.__dict__.update(known)
        return state

    @cached_property
    def C(self) -> np.ndarray:
        """Coriolis matrix (n, n) with Ṁ - 2C skew-symmetric, computed on first use."""
        return self.model.coriolis(self.q, self.v)

    @cached_property
    def g(self) -> np.ndarray:
        """Gravity force (n,); computed on first use unless `SoftModel.state` gave it."""
        return self.model.gravity(self.q)

    @cached_property
    def F(self) -> np.ndarray:
        """Sum (n,) of the forces of one's own; computed on first use unless it was given."""
        return self.model.forces_at(self.q, self.v)


class StateBatch:
    """The States of k configurations and velocities, from `SoftModel.states`.

    ``states[i]`` is the i-th State, and a loop over them gives each. Arrays are read-only.

    Attributes
    ----------
    model : SoftModel
        The robot's model.
    q, v, M, bias, K, D, B, h, J, Jdot, y, ydot, lengths, moment_arms : ndarray, (k, …)
        The terms of `State` with a leading k. `g` (k, n), too, computed on first use where
        `SoftModel.states` did not give it.
    """

    model: SoftModel
    q: np.ndarray
    v: np.ndarray
    M: np.ndarray
    bias: np.ndarray
    K: np.ndarray
    D: np.ndarray
    B: np.ndarray
    h: np.ndarray
    J: np.ndarray
    Jdot: np.ndarray
    y: np.ndarray
    ydot: np.ndarray
    lengths: np.ndarray
    moment_arms: np.ndarray

    def __init__(self, model: SoftModel, terms: dict[str, np.ndarray]) -> None:
        self.model, self._names = model, tuple(terms)
        vars(self).update(terms)

    @classmethod
    def of(cls, model: SoftModel, states: Sequence[State]) -> StateBatch:
        """Stack States of one model."""
        terms = {
            name: np.array([getattr(one, name) for one in states]).reshape(len(states), *shape)
            for name, shape in _shapes(model).items()
        }
        for value in terms.values():
            value.flags.writeable = False
        return cls(model, terms)

    @cached_property
    def g(self) -> np.ndarray:
        """Gravity force g (k, n)."""
        return np.array([one.g for one in self]).reshape(self.v.shape)

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, number: int) -> State:
        terms = {name: getattr(self, name)[number] for name in self._names}
        if not terms["B"].flags.f_contiguous and _inputs_vary(self.model):
            terms["B"] = np.asfortranarray(terms["B"])  # the layout of the model's own B
            terms["B"].flags.writeable = False
        return State.trusted(model=self.model, **terms)

    def __iter__(self) -> Iterator[State]:
        return (self[k] for k in range(len(self)))

    def __repr__(self) -> str:
        return f"<{len(self)} States of {self.model.name!r}>"


def check_batch(model: SoftModel, Q: Any, V: Any) -> tuple[np.ndarray, np.ndarray]:
    """k configurations (k, nq) and velocities (k, n) as new arrays.

    Raises
    ------
    InputError
        For a wrong shape or a number that is not finite.
    """
    Q = array("Q", Q, (length("Q", Q), model.nq))
    return Q, array("V", V, (len(Q), model.nv))


def _inputs_vary(model: SoftModel) -> bool:
    """Whether B depends on q."""
    return model.tendons.spatial or any(one.area_growth for one in model.robot.actuators)


def _shapes(model: SoftModel) -> dict[str, tuple[int, ...]]:
    n, m, tendons = model.nv, model.nu, len(model.robot.tendons)
    vectors = dict.fromkeys(("v", "bias", "K", "h"), (n,))
    return {
        "q": (model.nq,), **vectors, "M": (n, n), "D": (n, n), "B": (n, m),
        "J": (3, n), "Jdot": (3, n), "y": (3,), "ydot": (3,),
        "lengths": (tendons,), "moment_arms": (tendons, n),
    }  # fmt: skip
