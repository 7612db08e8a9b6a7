"""A tendon-driven finger: rigid bones on hinges with springs, tendons with given moment arms."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from softdyn.checks import flag, instance, instances, number
from softdyn.description.inertia import Inertia
from softdyn.description.robot import (
    MOST_FRICTION,
    ZERO,
    Joint,
    JointTerm,
    Site,
    Tendon,
    Vector,
    Wrap,
)
from softdyn.description.urdf_writer import write
from softdyn.design.cables import Profile, along, check_name, check_profile
from softdyn.design.chain import (
    GENERATED,
    X_TO_Z,
    Chain,
    Input,
    collision,
    cylinder,
    mesh,
    visual,
)  # fmt: skip
from softdyn.design.rods import Mount
from softdyn.exceptions import InputError

COLORS = {"dark": (0.18, 0.2, 0.24), "bone": (0.78, 0.75, 0.69)}
FORWARD = Mount(direction=(1.0, 0.0, 0.0))
HINGE: Vector = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class FingerTendon:
    """A tendon over hinges, with given moment arms or around pulleys.

    Around pulleys it runs through the middle of each bone that it passes, and around the pulley at
    each of its hinges. It lifts off a pulley below if the finger bends far enough.

    Attributes
    ----------
    joints : tuple of int
        Numbers of the hinges, 1 at the base.
    moment_arms : tuple of float
        Moment arm at each hinge (m); none with pulleys.
    max_tension : float
        Largest tension (N).
    pair : bool
        Whether an antagonist pulls the other way, so that the input has both signs. A cable around
        pulleys has none.
    name : str
    pulleys : tuple of float
        Radius of the pulley at each hinge (m). The cable runs below it, so that its pull bends the
        finger down, or above it if the radius is negative.
    friction : float
        Coefficient of friction on the pulleys and in the bones.
    """

    joints: tuple[int, ...]
    moment_arms: tuple[float, ...]
    max_tension: float
    pair: bool = False
    name: str = "flexor"
    pulleys: tuple[float, ...] = ()
    friction: float = 0.0

    def __post_init__(self) -> None:
        check_name(self.name)
        for name in ("joints", "moment_arms", "pulleys"):
            for k, value in enumerate(instances(name, getattr(self, name), object, "a number")):
                number(f"{name}[{k}]", value)
        number("max_tension", self.max_tension, above=0.0)
        number("friction", self.friction, lower=0.0, upper=MOST_FRICTION)
        if bool(self.pulleys) == bool(self.moment_arms):
            got = "both" if self.pulleys else "neither"
            raise InputError(f"tendon {self.name!r}", "moment_arm or pulley", got)
        if flag("pair", self.pair) and self.pulleys:
            expected = "no antagonist of a cable around pulleys, but a tendon of its own"
            raise InputError(f"tendon {self.name!r}", expected, "pair")


@dataclass(frozen=True)
class Finger:
    """Bones in a row, each on a hinge about y; a positive angle bends the finger down.

    Attributes
    ----------
    lengths : tuple of float
        Lengths of the bones (m), from base to tip.
    radius : Profile
        Radius from base to tip (m).
    density : float
        Density of the solid round bones (kg/m³).
    stiffness, damping : float or tuple of float
        Stiffness and damping of the hinges (N m/rad, N m s/rad).
    tendons : tuple of FingerTendon
    limit : float
        Largest angle of a hinge to either side (rad).
    mount : Mount
    name : str
    """

    lengths: tuple[float, ...]
    radius: Profile
    density: float
    stiffness: float | tuple[float, ...]
    damping: float | tuple[float, ...]
    tendons: tuple[FingerTendon, ...]
    limit: float = math.pi / 2
    mount: Mount = FORWARD
    name: str = "finger"

    def __post_init__(self) -> None:
        bones = instances("lengths", self.lengths, object, "a length (m)")
        if not bones:
            raise InputError("lengths", "at least one", "none")
        for k, value in enumerate(bones):
            number(f"lengths[{k}]", value, above=0.0)
        for name in ("density", "limit"):
            number(name, getattr(self, name), above=0.0)
        check_profile("radius", self.radius, above=0.0)
        instance("mount", self.mount, Mount, "a Mount")
        instance("name", self.name, str, "a text")
        for name in ("stiffness", "damping"):
            values = getattr(self, name)
            given = values if isinstance(values, tuple) else (values,) * len(self.lengths)
            if len(given) != len(self.lengths):
                raise InputError(name, f"one number, or {len(self.lengths)}", len(given))
            for value in given:
                number(name, value, lower=0.0)
            object.__setattr__(self, name, given)
        for tendon in instances("tendons", self.tendons, FingerTendon, "a FingerTendon"):
            bad = [j for j in tendon.joints if j not in range(1, len(self.lengths) + 1)]
            given = tendon.moment_arms or tendon.pulleys
            if bad or len(set(tendon.joints)) != len(given):
                expected = f"hinges from 1 to {len(self.lengths)}, none twice, and an arm for each"
                raise InputError(f"tendon {tendon.name!r}", expected, tendon.joints)
            for j, radius in zip(tendon.joints, tendon.pulleys, strict=False):
                room = min(self.lengths[max(j - 2, 0)], self.lengths[j - 1]) / 2
                if not 0 < abs(radius) < room:
                    expected = f"a radius below {room:g} m, half a bone at hinge {j}, not 0"
                    raise InputError(f"pulley of tendon {tendon.name!r}", expected, radius)


def urdf(finger: Finger) -> str:
    """The annotated URDF of a finger; its looks are in ``meshes/phalanx.stl``."""
    chain = Chain(finger.name, f"\n  {GENERATED}\n", COLORS)
    total, gone = sum(finger.lengths), 0.0
    base = along(finger.radius, 0.0)
    palm = (visual(cylinder(1.5 * base, base), "dark", (-1.5 * base, 0.0, 0.0), X_TO_Z),)
    chain.add("palm", None, palm, (), finger.mount.position, finger.mount.angles)
    offset: Vector = ZERO
    for i, length in enumerate(finger.lengths, 1):
        r = along(finger.radius, (gone + length / 2) / total)
        mass = finger.density * math.pi * r * r * length
        k = i - 1
        hinge = Joint(
            f"hinge_{i}", "revolute", direction=HINGE,
            lower=-finger.limit, upper=finger.limit,
            stiffness=finger.stiffness[k],  # type: ignore[index]  # __post_init__ made tuples
            damping=finger.damping[k],  # type: ignore[index]
        )  # fmt: skip
        looks = (
            visual(cylinder(1.1 * r, 2.2 * r), "dark", ZERO, (math.pi / 2, 0.0, 0.0)),
            visual(mesh("phalanx", (length, r, r)), "bone"),
            collision(cylinder(0.9 * r, 0.7 * length), (length / 2, 0.0, 0.0), X_TO_Z),
        )
        body = Inertia.cylinder(mass, r, length, length / 2)
        chain.add(f"bone_{i}", body, looks, [hinge], offset)
        offset, gone = (length, 0.0, 0.0), gone + length
    for tendon in finger.tendons:
        if tendon.pulleys:
            chain.pull(_around_pulleys(finger, tendon), Input(-1.0, (0, tendon.max_tension)))
            continue
        pairs = zip(tendon.joints, tendon.moment_arms, strict=True)
        terms = tuple(JointTerm(f"hinge_{j}", -arm) for j, arm in pairs)
        least = -tendon.max_tension if tendon.pair else 0
        chain.pull(Tendon(tendon.name, terms), Input(-1.0, (least, tendon.max_tension)))
    return write(chain.finish(offset, gravity=finger.mount.gravity))


def _around_pulleys(finger: Finger, tendon: FingerTendon) -> Tendon:
    """The path of a cable through the middle of its bones and around the pulleys between them."""
    radius = dict(zip(tendon.joints, tendon.pulleys, strict=True))
    first, last = min(radius), max(radius)
    before = "palm" if first == 1 else f"bone_{first - 1}"
    middle = -finger.lengths[0] / 2 if first == 1 else finger.lengths[first - 2] / 2
    sites, wraps = [Site(before, (middle, 0.0, 0.0))], []
    for j in range(first, last + 1):
        if j in radius:
            side = (0.0, 0.0, -2.0 * radius[j])
            pulley = Wrap(f"bone_{j}", ZERO, abs(radius[j]), len(sites) - 1, HINGE, side)
            wraps.append(replace(pulley, length=abs(radius[j])))
        sites.append(Site(f"bone_{j}", (finger.lengths[j - 1] / 2, 0.0, 0.0)))
    return Tendon(tendon.name, sites=tuple(sites), friction=tendon.friction, wraps=tuple(wraps))
