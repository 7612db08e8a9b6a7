"""An arm as rigid bodies on compliant joints, straight, as numbers without a file.

Each joint has all freedoms of its section, in series. Neighbouring joints have them in opposite
order, because finite rotations about two axes do not commute. With the same order at every joint
the errors would add up to a twist of first order in the segments' length that nobody applied.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from softdyn.checks import did_you_mean, instance, number
from softdyn.description.inertia import ZERO, Inertia, Vector
from softdyn.design.cables import Cable, Chamber, Path
from softdyn.design.rods import Arm, Plate, Section
from softdyn.exceptions import InputError

PIECES = 64  # of a line in the body, for its length
SLICE = np.polynomial.legendre.leggauss(12)  # for integrals over the cross-section's profile


@dataclass(frozen=True, eq=False)
class Freedom:
    """One strain of a rod, and the joint that stands for it.

    Attributes
    ----------
    axis : ndarray, (3,)
        The joint's axis.
    turns : bool
        Whether the joint rotates; else it slides.
    rigidity : callable
        (section, s / length) → rigidity: N m² for a rotation, N for a translation.
    """

    axis: np.ndarray
    turns: bool
    rigidity: Callable[[Section, float], float]


X, Y, Z = np.eye(3)
FREEDOMS = {
    "bend_y": Freedom(Y, True, Section.bending),
    "bend_z": Freedom(Z, True, Section.bending),
    "twist": Freedom(X, True, Section.torsion),
    "extension": Freedom(X, False, Section.stretching),
    "shear_y": Freedom(Y, False, Section.shearing),
    "shear_z": Freedom(Z, False, Section.shearing),
}
"""Rotation about y or z bends the arm; translation along x stretches it."""


@dataclass(frozen=True, eq=False)
class Spring:
    """One compliant joint of the layout.

    Attributes
    ----------
    name : str
        The joint's name in the file.
    freedom : Freedom
    section : int
    at, weight : float
        Its place in the section, s / length, and the length of rod that it stands for (m).
    stiffness, damping : float
        N m/rad and N m s/rad, or N/m and N s/m.
    rest : float
        Rest position (rad or m).
    strain : str
        The name of its freedom.
    relaxation : tuple of (float, float)
        Stiffness and time (s) of each Maxwell branch.
    """

    name: str
    freedom: Freedom
    section: int
    at: float
    weight: float
    stiffness: float
    damping: float
    rest: float
    strain: str
    relaxation: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Layout:
    """Stations along the arm, with the springs at each and the body behind it.

    Attributes
    ----------
    arm : Arm
    stations : ndarray, (bodies,)
        The start of each body (m): 0 for the first, which is fixed to the base; for each other body
        the place of its joint.
    springs : tuple of tuple of Spring
        The springs at each body's joint; none for the first body.
    bodies : tuple of Inertia
        Each body in the frame of its station, whose x is the arm's axis.
    """

    arm: Arm
    stations: np.ndarray
    springs: tuple[tuple[Spring, ...], ...]
    bodies: tuple[Inertia, ...]

    @cached_property
    def ends(self) -> np.ndarray:
        """The end of each body (m)."""
        return np.append(self.stations[1:], self.arm.length)

    def place(self, s: float, offset: Sequence[float] = ZERO) -> tuple[str, Vector]:
        """The link at the distance `s` (m) along the arm, and a point of it in its axes (m).

        Parameters
        ----------
        s : float
            Distance from the arm's base.
        offset : sequence of float, (3,)
            From the middle line at `s` to the point, in the axes of the straight arm (m).
        """
        body = self.body_at(s)
        x, y, z = offset
        return f"segment_{body}", (float(s - self.stations[body] + x), float(y), float(z))

    def body_at(self, x: float) -> int:
        """The body that carries the point x of the arm."""
        return max(int(np.searchsorted(self.stations, number("x", x), side="right")) - 1, 0)

    @cached_property
    def buoyancy(self) -> tuple[float, ...]:
        """The share of each body's weight that the fluid around the arm carries.

        The volume is that of sections, discs, plates and payload. Hollows are full of the fluid.
        """
        if not self.arm.fluid.density:
            return (0.0,) * len(self.bodies)
        displaced = _masses(_of_fluid(self.arm), self.stations)
        return tuple(
            float(f"{fluid.mass / body.mass:.12g}") if body.mass else 0.0
            for fluid, body in zip(displaced, self.bodies, strict=True)
        )

    @cached_property
    def all_springs(self) -> tuple[Spring, ...]:
        """All springs from base to tip, in the order of q."""
        return tuple(spring for group in self.springs for spring in group)

    @cached_property
    def mass_matrix(self) -> np.ndarray:
        """M (n, n) of the straight arm."""
        place = [x for x, group in zip(self.stations, self.springs, strict=True) for _ in group]
        M = np.zeros((len(place), len(place)))
        axes = np.array([spring.freedom.axis for spring in self.all_springs])
        turns = np.array([spring.freedom.turns for spring in self.all_springs])
        first = 0
        for x, group, body in zip(self.stations, self.springs, self.bodies, strict=True):
            first += len(group)
            a, arm = axes[:first], x * X + body.com - np.outer(place[:first], X)
            v = np.where(turns[:first, None], np.cross(a, arm), a)
            w = np.where(turns[:first, None], a, 0.0)
            M[:first, :first] += body.mass * v @ v.T + w @ body.tensor @ w.T
        return M

    @cached_property
    def rates(self) -> np.ndarray:
        """Natural angular frequencies (n,) of the straight, weightless arm, ascending (rad/s)."""
        root = np.linalg.inv(np.linalg.cholesky(self.mass_matrix))
        stiffness = np.array([spring.stiffness for spring in self.all_springs])
        return np.sqrt(np.linalg.eigvalsh(root @ (stiffness[:, None] * root.T)))

    def coefficients(self, cable: Path) -> np.ndarray:
        """∂ℓ/∂q (n,) at q = 0 of a cable in a channel, or of a chamber in the body.

        The cable has the unit tangent t and the place p in the cross-section. A rotation about a
        changes its length by t · (a × p), a translation along a by t · a. At a constant offset the
        length is linear in the bends, so these derivatives then hold for every bend.
        """
        instance("cable", cable, (Cable, Chamber), "a Cable or a Chamber")
        start, end = self.arm.way(cable)
        found = []
        for x, group in zip(self.stations, self.springs, strict=True):
            for spring in group:
                at = (x - start) / (end - start)
                if not 0 <= at <= 1:
                    found.append(0.0)
                    continue
                h = 1e-6
                low, high = max(at - h, 0.0), min(at + h, 1.0)
                slope = (cable.place(high) - cable.place(low)) / (high - low) / (end - start)
                tangent, axis = X + slope, spring.freedom.axis
                moved = np.cross(axis, cable.place(at)) if spring.freedom.turns else axis
                found.append(float(tangent @ moved / np.linalg.norm(tangent)))
        return np.array(found)

    def length(self, line: Path) -> float:
        """Length (m) of a cable or a chamber in the straight arm."""
        start, end = self.arm.way(line)
        places = [start, *disc_places(self.arm, line)]
        at = np.array(places if line.straight else np.linspace(start, end, PIECES + 1))
        points = np.array([x * X + line.place((x - start) / (end - start)) for x in at])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def disc_places(arm: Arm, cable: Path) -> list[float]:
    """Positions of the discs of a cable's sections along the arm (m)."""
    last = cable.end % len(arm.sections)
    return [
        float(arm.starts[k] + section.length * (j + 1) / section.discs)
        for k, section in list(enumerate(arm.sections))[cable.start : last + 1]
        for j in range(section.discs)
    ]


def lay_out(arm: Arm) -> Layout:
    """Bodies and springs of an arm, at the places of its quadrature rule.

    Raises
    ------
    InputError
        For an unknown freedom.
    """
    stations = [0.0]
    springs: list[tuple[Spring, ...]] = [()]
    for k, section in enumerate(instance("arm", arm, Arm, "an Arm").sections):
        nodes, weights = arm.rule(section.segments)
        for node, weight in zip(nodes, weights, strict=True):
            stations.append(float(arm.starts[k] + node * section.length))
            springs.append(_springs(section, k, float(node), float(weight), len(springs)))
    masses = _masses(arm, np.array(stations))
    straight = Layout(arm, np.array(stations), tuple(springs), masses)
    return _damped(straight)


def _springs(
    section: Section, index: int, at: float, weight: float, count: int
) -> tuple[Spring, ...]:
    found = []
    for name in (*section.freedoms, *section.rest):
        if name not in FREEDOMS:
            where = "freedoms" if name in section.freedoms else "rest"
            raise InputError(where, " or ".join(FREEDOMS), did_you_mean(str(name), FREEDOMS))
    for name in section.freedoms:
        freedom, share = FREEDOMS[name], weight * section.length
        stiffness = freedom.rigidity(section, at) / share
        rest = section.rest.get(name, 0.0) * share
        joint = f"{name}_{count}"
        branches = section.material.branches(stiffness)
        found.append(Spring(joint, freedom, index, at, share, stiffness, 0.0, rest, name, branches))
    return tuple(found if count % 2 else reversed(found))


def _damped(layout: Layout) -> Layout:
    """The same layout with damping τ · stiffness at each joint."""
    damping, sections = layout.arm.damping, layout.arm.sections

    def time_constant(spring: Spring) -> float:
        if damping.time_constant is not None:
            return damping.time_constant
        if damping.ratio is not None:
            return 2 * damping.ratio / float(layout.rates[0])
        section = sections[spring.section]
        if spring.freedom.turns:
            modulus = section.bending(spring.at) / section.second_moment(spring.at)
        else:
            modulus = section.stretching(spring.at) / section.area(spring.at)
        return float(damping.viscosity or 0.0) / modulus

    groups = tuple(
        tuple(
            Spring(**{**vars(spring), "damping": time_constant(spring) * spring.stiffness})
            for spring in group
        )
        for group in layout.springs
    )
    return Layout(layout.arm, layout.stations, groups, layout.bodies)


# --- masses -------------------------------------------------------------------------------------


def _of_fluid(arm: Arm) -> Arm:
    """The arm with each of its solids made of the fluid around it."""
    density = arm.fluid.density

    def flooded(plate: Plate | None) -> Plate | None:
        if plate is None:
            return None
        return replace(plate, mass=density * math.pi * plate.radius**2 * plate.thickness)

    sections = tuple(
        replace(
            one, mass=None, material=replace(one.material, density=density),
            disc=flooded(one.disc), plate=flooded(one.plate),
        )
        for one in arm.sections
    )  # fmt: skip
    ball = arm.payload
    if ball is not None:
        ball = replace(ball, mass=density * 4 / 3 * math.pi * ball.radius**3)
    return replace(arm, sections=sections, payload=ball)


def _masses(arm: Arm, stations: np.ndarray) -> tuple[Inertia, ...]:
    """Inertia of each body in its station's frame."""
    bodies = [Inertia.zero() for _ in stations]

    def add(x: float, inertia: Inertia, k: int) -> None:
        bodies[k] += inertia.moved(np.eye(3), (x - stations[k]) * X)

    def carrier(x: float) -> int:
        return int(np.searchsorted(stations, x, side="right")) - 1

    ends = np.append(stations[1:], arm.length)
    for start, section in zip(arm.starts, arm.sections, strict=False):
        stop = start + section.length
        density = section.material.density
        if section.mass is not None:
            density *= section.mass / _slice(section, 0, section.length).mass
        for k, (low, high) in enumerate(zip(stations, ends, strict=True)):
            low, high = max(low, start), min(high, stop)
            if high > low:
                piece = _slice(section, low - start, high - start, density)
                add(float(start), piece, k)
        for j in range(section.discs):
            if section.disc is not None:
                x = float(start + section.length * (j + 1) / section.discs)
                add(x, _cylinder(section.disc), carrier(x))
        if section.plate is not None:
            add(stop + section.plate.thickness / 2, _cylinder(section.plate), carrier(stop))
    if arm.payload is not None:
        moment = 2 / 5 * arm.payload.mass * arm.payload.radius**2
        ball = Inertia(arm.payload.mass, arm.payload.ahead * X, moment * np.eye(3))
        add(arm.length, ball, len(stations) - 1)
    return tuple(bodies)


def _slice(section: Section, low: float, high: float, density: float | None = None) -> Inertia:
    """Inertia of the rod from low to high (m), in the frame of the section's start."""
    nodes, weights = SLICE
    # one interval between two kinks of the profile, because Gauss's rule needs a smooth integrand
    kinks = {low, high}
    for profile in (section.radius, section.inner_radius):
        if not callable(profile) and np.size(profile) > 2:
            kinks |= {section.length * x for x in np.linspace(0, 1, np.size(profile))}
    edges = sorted(x for x in kinks if low <= x <= high)
    total = Inertia.zero()
    density = section.material.density if density is None else density
    mass, first, second, axial = 0.0, 0.0, 0.0, 0.0
    for a, b in pairwise(edges):
        for node, weight in zip(nodes, weights, strict=True):
            x = a + (b - a) * (1 + node) / 2
            scale = density * weight * (b - a) / 2
            dm = scale * section.area(x / section.length)
            mass, first, second = mass + dm, first + dm * x, second + dm * x * x
            axial += scale * section.second_moment(x / section.length)
    centre = first / mass
    across = second - mass * centre * centre + axial
    return total + Inertia(mass, centre * X, np.diag([2 * axial, across, across]))


def _cylinder(plate: Plate) -> Inertia:
    """A plate about its centre."""
    return Inertia.cylinder(plate.mass, plate.radius, plate.thickness)
