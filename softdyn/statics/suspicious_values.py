"""Find valid numbers in a robot's file that look wrong, and name the likely cause of each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
from scipy.linalg import eigh

from softdyn.description.meshes import Mesh
from softdyn.description.robot import Ball, Joint, Robot, Tendon, moving_bodies
from softdyn.description.visuals import triangles, visuals
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.projection import Projection, underlying_tree
from softdyn.dynamics.relaxation import Branches
from softdyn.plausible import WEIGHT, implausible_pressures, too_heavy, too_strong

PLANT_STEP = 5e-4  # s, the coarsest plant step of the closed loops
FLOOR = 1e-15  # kg m² or kg: mjMINVAL, below which MuJoCo calls a pivot of M singular

DENSE, LIGHT = (
    25_000.0,
    1.0,
)  # kg/m³; denser than gold, or lighter than any solid foam: probably a unit error
SMALLEST, LARGEST = 1e-4, 50.0  # m from the root to the farthest joint or tip
DEGREES = 3 * 2 * math.pi  # rad: three turns
OUTSIZE = 20.0  # width of a mesh over the robot's length
UNIT = (1.0, 1 / 6)  # kg m²: ones, and a cube of 1 kg and 1 m
BULKY = 3.0  # radius of gyration over the distance to the next joint


def suspicious_values(robot: Robot) -> tuple[str, ...]:
    """One line for each number that looks wrong; shapes are left out."""
    return (*_sizes(robot), *_limits(robot), *_defaults(robot), *_bodies(robot), *_springs(robot))


def suspicious_shapes(robot: Robot) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """One line for each mesh that looks too large, and one for each shape that cannot be read.

    Raises
    ------
    UrdfError
        For a shape with an invalid number.
    """
    shapes, unreadable = visuals(robot)
    size = max(robot.length, *(float(np.linalg.norm(j.origin.xyz)) for j in robot.joints), 0.05)
    widest: dict[str, float] = {}
    for shape in shapes:
        if isinstance(shape.shape, Mesh):
            extent = float(np.ptp(triangles(shape).reshape(-1, 3), axis=0).max())
            widest[shape.link] = max(extent, widest.get(shape.link, 0.0))
    found = (
        f"link {link!r}: its mesh is {extent:.2g} m wide, the robot {size:.2g} m long: "
        f'a mesh in mm without scale="0.001 0.001 0.001"?'
        for link, extent in widest.items()
        if extent > OUTSIZE * size
    )
    return tuple(found), unreadable


def fast_springs(model: SoftModel, state: State, timestep: float = PLANT_STEP) -> str | None:
    """One line about the mode of springs that plant steps (s) cannot follow, if there is one.

    A plant step h takes springs explicitly and damping implicitly:

        (M + h D) (v' - v) = -h (K q + D v),   q' = q + h v'.

    A mode q ∝ zᵏ has (m + h d) z² + (h² k - h d - 2 m) z + m = 0 with m, d, k = x* (M, D, K) x, and
    |z| ≤ 1 if h² k ≤ 4 m + 2 h d. So the step is stable if 4 M + 2 h D - h² K is positive. K has
    the Maxwell branches too, k₀ = k∞ + Σ k, because a fast mode meets them all.
    """
    h, K = timestep, np.diag(model.stiffness) + Branches.of(model).matrix
    if not K.any():
        return None
    try:
        shares, modes = eigh(h * h * K, 4 * state.M + 2 * h * state.D)
    except np.linalg.LinAlgError:  # damping so large that M is rounding beside it
        return None
    if not shares[-1] > 1:
        return None
    mode = modes[:, -1]
    stiffness = np.diag(K)
    worst = int(np.argmax(stiffness * mode**2))
    rate = math.sqrt(float((mode @ K @ mode) / (mode @ state.M @ mode)))
    return (
        f"joint {model.joint_names[worst]!r}: a stiffness of {stiffness[worst]:g} swings at "
        f"{rate:.2g} rad/s, too fast for plant steps of {timestep:g} s: other units than "
        "N m/rad or N/m, too little inertia, or too little damping?"
    )


def below_floor(model: SoftModel, configurations: Iterable[np.ndarray]) -> str | None:
    """One line about inertias that MuJoCo calls singular, if there are any.

    MuJoCo factorizes M = Lᵀ Δ L from the tips to the root. It refuses a Δ_i below mjMINVAL: the
    inertia about joint i of what it carries, with the joints beyond it free to yield.

    Parameters
    ----------
    configurations : iterable of ndarray, (nq,)
        Those examined.
    """
    tree, _ = underlying_tree(model)
    least, name = math.inf, ""
    for q in configurations:
        q = model.expand(q) if isinstance(model, Projection) else q
        M = tree.state(q, np.zeros(tree.nv)).M
        try:
            pivots = np.diag(np.linalg.cholesky(M[::-1, ::-1]))[::-1] ** 2
        except np.linalg.LinAlgError:  # a follower without inertia, which its leader carries
            continue
        if pivots.min() < least:
            least, name = float(pivots.min()), tree.joint_names[int(np.argmin(pivots))]
    if least >= FLOOR:
        return None
    return (
        f"joint {name!r}: its inertia of {least:.2g} (kg m² or kg) is below MuJoCo's floor of "
        f"{FLOOR:g}: no simulation is possible, and `softdyn crosscheck` compares the terms alone; "
        "an armature, or the same robot in larger units of length, is above it"
    )


def unbalanced(model: SoftModel) -> Iterator[str]:
    """One line for a weight and for each pull that do not fit the springs (`softdyn.plausible`)."""
    robot, state = model.robot, model.state(model.q0, np.zeros(model.nv))
    turning = {joint.name for joint in robot.moving_joints if joint.kind != "prismatic"}
    turns = np.array([name in turning for name in model.joint_names], bool)
    bending = turns & (model.stiffness > 0)
    moment = 9.81 * robot.length * sum(link.inertia.mass for link in robot.links)
    if not bending.any() or not moment > 0:
        return
    compliance = 1 / model.stiffness[bending]
    masses = _carried(robot)
    carried = np.array([masses.get(name, 0.0) for name in model.joint_names])[bending]
    if too_heavy(weight := 9.81 * robot.length * float(carried @ compliance)):
        yield (
            f"the weight is {weight:.2g} times the stiffness (g L Σ m/k, at most {WEIGHT:g}): "
            "springs in N mm/rad, or masses in grams?"
        )
    torques = np.abs(state.B[bending]) * np.maximum(np.abs(model.u_min), np.abs(model.u_max))
    for actuator, pull in zip(robot.actuators, torques.T, strict=True):
        bend, share = float(pull @ compliance), float(pull.max()) / moment
        if too_strong(bend, share):
            yield (
                f"actuator {actuator.name!r}: its full pull bends the arm by {bend:.2g} rad, with "
                f"{share:.2g} times the moment of the arm's weight: a bound in another unit than N?"
            )


def light_bodies(robot: Robot) -> Iterator[str]:
    """One line for each moving body below MuJoCo's least inertia; points are left out."""
    for name, body in moving_bodies(robot).items():
        most = float(np.linalg.eigvalsh(body.tensor)[-1])
        if body.mass > 0 and 0 < most < FLOOR:
            yield (
                f"link {name!r}: its inertia of {most:.2g} kg m² is below MuJoCo's least one of "
                f"{FLOOR:g}: MuJoCo refuses such a body, and `softdyn export --mjcf` writes a "
                "larger inertia; is it in other units?"
            )


def _carried(robot: Robot) -> dict[str, float]:
    """The mass (kg) beyond each joint; a leader carries its followers' too.

    A soft arm on an industrial robot does not bend under the weight of that robot.
    """
    found: dict[str, float] = {}
    for link in robot.links:
        above = {j.name if j.mimic is None else j.mimic.leader for j in robot.chain(link.name)}
        for name in above:
            found[name] = found.get(name, 0.0) + link.mass
    return found


def _size(robot: Robot) -> float:
    """The way to the tip or the largest joint offset (m); 0 if all joints are at the base."""
    offsets = [float(np.linalg.norm(joint.origin.translation)) for joint in robot.joints]
    return max([robot.length, *offsets])


def _sizes(robot: Robot) -> Iterator[str]:
    size = _size(robot)
    if size > LARGEST:
        yield f"a size of {size:g} m: lengths in mm? URDF wants metres"
    if 0 < size < SMALLEST:
        yield f"a size of {size:g} m: lengths in km or mm scaled twice? URDF wants metres"
    slides = any(joint.kind == "prismatic" for joint in robot.chain(robot.task))
    if robot.length == 0 and not slides and not robot.floating:
        yield (
            f"the tip {robot.task!r} sits at the base, no joint offset is on the way to it: "
            '<task frame="…"/> names another link'
        )


def _limits(robot: Robot) -> Iterator[str]:
    for joint in robot.moving_joints:
        if joint.mimic is not None:  # a follower's limits are not used
            continue
        span = max(abs(joint.lower), abs(joint.upper))
        if joint.kind == "revolute" and span > DEGREES:
            yield f"joint {joint.name!r} turns up to {span:g} rad: limits in degrees?"
        if joint.kind == "prismatic" and math.isfinite(span) and span > 10 * max(robot.length, 0.1):
            yield f"joint {joint.name!r} slides up to {span:g} m: limits in mm?"
        if joint.lower == joint.upper:
            yield f"joint {joint.name!r} cannot move: lower = upper = {joint.lower:g}"
        elif not joint.lower <= 0 <= joint.upper:
            yield f"joint {joint.name!r} is beyond its limits at q = 0, the pose in the file"


def _defaults(robot: Robot) -> Iterator[str]:
    """One line for each link with the numbers of a CAD program that was told no material."""
    for link in robot.links:
        xx, xy, xz, yy, yz, zz = link.moments
        equal = xx == yy == zz and not any((xy, xz, yz))
        if link.mass == 1 and equal and any(abs(xx - one) < 1e-3 for one in UNIT):
            yield (
                f"link {link.name!r}: 1 kg and {xx:g} kg m² about each axis: a CAD program's "
                "default, without a material?"
            )


def _bodies(robot: Robot) -> Iterator[str]:
    bodies = moving_bodies(robot)
    masses = [body.mass for body in bodies.values() if body.mass > 0]
    heaviest, size = max(masses, default=0.0), _size(robot)
    farthest = max((float(np.linalg.norm(body.com)) for body in bodies.values()), default=0.0)
    extent = size or farthest  # without any joint offset, the centres of mass tell the size
    if heaviest > 200 * max(1.0, size**3):
        yield f"a body of {heaviest:g} kg in a robot of {size:.2g} m: masses in grams?"
    for name, body in bodies.items():
        if body.mass <= 0:
            continue
        # squared semi-axes of a solid ellipsoid with these moments a, b, c: 5 (b + c - a) / 2m
        moments = np.linalg.eigvalsh(body.tensor)
        squares = 2.5 / body.mass * (moments.sum() - 2 * moments)
        axes = np.sqrt(np.maximum(squares, 0.0))
        gyration = math.sqrt(float(moments.max()) / body.mass)
        if extent and gyration > BULKY * extent:
            yield (
                f"link {name!r}: its inertia is that of a body {gyration:.2g} m wide, the robot "
                f"is {extent:.2g} m long: inertia in g mm² or kg mm²?"
            )
        volume = 4 / 3 * math.pi * float(np.prod(axes))
        if volume > 0 and not LIGHT < body.mass / volume < DENSE:
            yield (
                f"link {name!r}: as a solid ellipsoid it would weigh "
                f"{body.mass / volume:.2g} kg/m³: mass and inertia do not match"
            )
        com = float(np.linalg.norm(body.com))
        if com > (BULKY * max(size, 0.01) if size else LARGEST):
            yield f"link {name!r}: its centre of mass is {com:g} m away from its joint"


def _springs(robot: Robot) -> Iterator[str]:
    free = [joint for joint in robot.moving_joints if joint.mimic is None]
    springs: list[Joint | Tendon | Ball] = [*free, *robot.tendons, *robot.balls]
    elastic = any(part.stiffness > 0 or any(part.stiffness_poly) for part in springs)
    moving = [actuator for actuator in robot.actuators if actuator.lower < actuator.upper]
    if not elastic and 0 < len(moving) < len(free):
        yield (
            "no springs at all: only gravity holds the directions without an input; write stiffness"
            " in <gazebo><springStiffness>, or in a file for --annotations"
        )
    for tendon in robot.tendons:
        pulled = any(actuator.tendon == tendon.name for actuator in robot.actuators)
        springs_of = tendon.stiffness, tendon.damping, *tendon.stiffness_poly, *tendon.damping_poly
        if not pulled and not any(springs_of) and not tendon.armature:
            yield f"tendon {tendon.name!r} does nothing: no actuator, no stiffness, no damping"
    damped = {_first(joint) for joint in robot.moving_joints if joint.damping > 0}
    for joint in robot.moving_joints:
        if (
            joint.mimic is None
            and joint.stiffness > 0
            and not joint.lower <= joint.rest <= joint.upper
        ):
            yield f"joint {joint.name!r}: its spring rests at {joint.rest:g}, beyond its limits"
        if (least := _least_slope(joint)) < 0:
            yield (
                f"joint {joint.name!r}: its spring turns within its limits, down to {least:.3g}"
                f" {_unit(joint)}: it pushes the joint away from there"
            )
        if joint.stiffness > 0 and _first(joint) not in damped:
            yield f"joint {joint.name!r} has a spring and no damping: it will oscillate for ever"
    for ball in robot.balls:
        if ball.stiffness > 0 and ball.damping == 0:
            yield f"ball {ball.name!r} has a spring and no damping: it will oscillate for ever"
    for actuator in robot.actuators:
        tendon = next(t for t in robot.tendons if t.name == actuator.tendon)
        if actuator.gear == 0 or actuator.lower == actuator.upper == 0:
            yield f"actuator {actuator.name!r} can do nothing: its gear or both bounds are 0"
        if actuator.is_chamber:
            yield from implausible_pressures(
                f"actuator {actuator.name!r}", actuator.lower, actuator.upper
            )
            continue
        if tendon.sites and actuator.gear > 0:
            yield f"actuator {actuator.name!r} pushes its cable: cables carry a gear < 0"
        if tendon.sites and actuator.gear < 0 and actuator.lower < 0:
            yield f"actuator {actuator.name!r} may push its cable: its lower bound is below 0"


def _first(joint: Joint) -> str:
    """The joint that determines this one's position: its leader, or itself."""
    return joint.name if joint.mimic is None else joint.mimic.leader


def _least_slope(joint: Joint) -> float:
    """The least slope (N m/rad, N/m) of a joint's spring within finite limits."""
    k1, k2 = joint.stiffness_poly
    if not (k1 or k2) or not math.isfinite(joint.upper - joint.lower):
        return joint.stiffness
    ends = joint.lower - joint.rest, joint.upper - joint.rest
    places = [*ends, min(max(-k1 / (3 * k2), ends[0]), ends[1])] if k2 else ends
    return min(joint.stiffness + (2 * k1 + 3 * k2 * s) * s for s in places)


def _unit(joint: Joint) -> str:
    return "N/m" if joint.kind == "prismatic" else "N m/rad"
