"""Friction of cables on their guides, in MuJoCo.

MuJoCo has no friction along a tendon that depends on the pull. But the friction at a guide is dry
friction against the change of the length beyond it. So each guide gets a tendon of its own, from
the guide to the far end of the cable, with MuJoCo's frictionloss. Its limit is set before every
step. With the tension T before the guide, the wrap angle φ and the coefficient μ it is
T (1 - exp(-μφ)) where the cable slides towards its driven end, and T (exp(μφ) - 1) the other way;
the two change places for a negative T. MuJoCo's solver lets such a cable stick.

Wrap angles come from MuJoCo's own positions of sites and joints, and of a cable around round bodies
from MuJoCo's points of its path. The cable beyond such a body begins at a site of the body, where
the cable leaves it. Angles, this place, the tension at the driven end and the friction that acts
are of the step before.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from softdyn.compiled import compiled
from softdyn.description.robot import (
    PathEnd,
    Robot,
    Site,
    Tendon,
    Wrap,
    driven_end,
    moving_link_of,
)
from softdyn.validation.twin.cable_course import CableCourse, Turn, turns_of
from softdyn.validation.twin.drives import anchor_name, site_name, wrap_name

LEAST = 1e-12  # N; MuJoCo has no row for a friction of zero
HIGHEST_IMPEDANCE = 0.9999  # MuJoCo's bound
# Factor on MuJoCo's inverse weights. At 1 arms creep by 0.2 mm in 10 s; at 1e-3/kg they chatter.
STIFFER = 0.1
SLIDES = 1.0 - 1e-6  # a cable slides if its friction is at least this share of the limit


class Guide(NamedTuple):
    """A guide of a cable, and the cable beyond it.

    Successive sites on one body are one guide: the cable slides there with one speed.

    Attributes
    ----------
    tendon : str
        The cable.
    name : str
        Name of the tendon beyond the guide.
    friction : float
        The coefficient μ.
    number : int
        Number of the guide's last element among all sites and joints where the robot's cables rub.
    turns : tuple of (str, str, str)
        Three sites for each element: that before it, its own, and that behind it.
    sites : tuple of str
        The last site at the guide, and the others up to the far end.
    joints : tuple of (str, float)
        The joint at the guide and the others up to the far end, with their moment arms.
    geoms : tuple of (int, str, str)
        Round bodies beyond the guide: the number of `sites` before one, its geom and its side site.
    around : tuple of Turn
        The elements of a cable around round bodies, instead of `turns`; `friction` is then 1.
    """

    tendon: str
    name: str
    friction: float
    number: int
    turns: tuple[tuple[str, ...], ...] = ()
    sites: tuple[str, ...] = ()
    joints: tuple[tuple[str, float], ...] = ()
    geoms: tuple[tuple[int, str, str], ...] = ()
    around: tuple[Turn, ...] = ()


def guides_of(robot: Robot) -> Iterator[Guide]:
    """The guides where cables can slide, tendon by tendon, each from its driven end."""
    kinds = {joint.name: joint.kind for joint in robot.joints}
    carrier, number = moving_link_of(robot), -1
    for tendon in robot.tendons:
        if tendon.wraps and tendon.rubs:
            yield from _around(robot, tendon, number)
            number += len(tendon.path) - 2
            continue
        if not tendon.friction:
            continue
        order = 1 if driven_end(robot, tendon) is PathEnd.FIRST else -1
        sites, terms = tendon.sites[::order], tendon.terms[::order]
        names = [site_name(tendon, k) for k in range(len(sites))][::order]
        turns: list[tuple[str, ...]] = []
        for k in range(1, len(sites) - 1):
            number += 1
            turns.append(tuple(names[k - 1 : k + 2]))
            if carrier[sites[k].link] != carrier[sites[k + 1].link]:
                yield Guide(
                    tendon.name, f"{tendon.name}:beyond:{k}", tendon.friction, number,
                    turns=tuple(turns), sites=tuple(names[k:]),
                )  # fmt: skip
                turns = []
        arms = [(term.joint, term.coef) for term in terms]
        for k, (joint, arm) in enumerate(arms):
            if kinds[joint] == "revolute":
                number += 1
                yield Guide(
                    tendon.name, f"{tendon.name}:beyond:{k}", tendon.friction, number,
                    joints=((joint, arm / 2), *arms[k + 1 :]),
                )  # fmt: skip


def _around(robot: Robot, tendon: Tendon, number: int) -> Iterator[Guide]:
    """The guides of a cable around round bodies; their elements count from `number` + 1."""
    forward, carrier = driven_end(robot, tendon) is PathEnd.FIRST, moving_link_of(robot)
    order = 1 if forward else -1
    path, turns = tendon.path[::order], turns_of(tendon)[::order]
    names = {id(site): site_name(tendon, k) for k, site in enumerate(tendon.sites)}
    met: list[Turn] = []
    for k, part in enumerate(path[1:-1], 1):
        assert isinstance(part, Site | Wrap)
        met.append(turns[k - 1])
        behind = path[k + 1]
        assert isinstance(behind, Site | Wrap)
        if carrier[part.link] == carrier[behind.link]:
            continue
        sites = [anchor_name(tendon, part)] if isinstance(part, Wrap) else [names[id(part)]]
        geoms = []
        for beyond in path[k + 1 :]:
            if isinstance(beyond, Wrap):
                name = wrap_name(tendon, beyond)
                geoms.append((len(sites) - 1, name, "" if beyond.side is None else name))
            else:
                sites.append(names[id(beyond)])
        yield Guide(
            tendon.name, f"{tendon.name}:beyond:{k}", 1.0, number + k, sites=tuple(sites),
            geoms=tuple(geoms), around=tuple(met),
        )  # fmt: skip
        met = []


def add_guides(spec: mujoco.MjSpec, robot: Robot, timestep: float) -> None:
    """Specify the tendons beyond the guides."""
    for guide in guides_of(robot):
        added = spec.add_tendon()
        added.name, added.limited, added.frictionloss = guide.name, 0, LEAST
        # a cable that sticks loses its speed in one step
        added.solref_friction = (-1.0, -1.0 / timestep)
        added.solimp_friction = (HIGHEST_IMPEDANCE, HIGHEST_IMPEDANCE, 1e-4, 0.5, 2.0)
        geoms = {k: names for k, *names in guide.geoms}
        for k, site in enumerate(guide.sites):
            added.wrap_site(site)
            if k in geoms:
                added.wrap_geom(*geoms[k])
        for joint, arm in guide.joints:
            added.wrap_joint(joint, arm)


class CableFriction:
    """The friction at the guides of a compiled robot, in the order of `guides_of`.

    Parameters
    ----------
    model : mujoco.MjModel
        The model, with the tendons of `add_guides`. Its friction limits change with time.
    robot : Robot
        The description.

    Attributes
    ----------
    rows : np.ndarray, (guides,)
        MuJoCo's tendons beyond the guides.
    tendon, friction, numbers : np.ndarray, (guides,)
        MuJoCo's tendon that is the cable, the coefficient μ, and `Guide.number`.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        guides = list(guides_of(robot))
        self._model = model
        self.rows = np.array([model.tendon(guide.name).id for guide in guides], int)
        self.tendon = np.array([model.tendon(guide.tendon).id for guide in guides], int)
        self.friction = np.array([guide.friction for guide in guides], float)
        self._limit = np.full(len(guides), LEAST)
        self._weights = STIFFER * model.tendon_invweight0[self.rows]
        self.numbers = np.array([guide.number for guide in guides], int)
        turns = [
            (g, *(model.site(site).id for site in turn))
            for g, guide in enumerate(guides)
            for turn in guide.turns
        ]
        hinges = [
            (g, model.joint(guide.joints[0][0]).qposadr[0])
            for g, guide in enumerate(guides)
            if guide.joints
        ]
        self._turns = np.array(turns, int).reshape(-1, 4).T
        self._hinges = np.array(hinges, int).reshape(-1, 2).T
        courses = {
            tendon.name: CableCourse(model, robot, tendon)
            for tendon in robot.tendons
            if tendon.wraps and tendon.rubs
        }
        self._courses = tuple(courses.values())
        self._around = [(g, courses[guide.tendon], guide.around) for g, guide in enumerate(guides)
                        if guide.around]  # fmt: skip

    def clear(self) -> None:
        """Forget the friction of the last step.

        A stuck cable creeps in proportion to its inverse weight. MuJoCo's own is replaced, which
        `mj_setConst` restores.
        """
        self._limit[:] = LEAST
        self._model.tendon_invweight0[self.rows] = self._weights
        self._model.tendon_frictionloss[self.rows] = LEAST

    def update(self, data: mujoco.MjData) -> None:
        """Set the limits of the next step, after a step or `mj_forward`."""
        last = data.ne + data.nf
        force = data.efc_force[last - len(self.rows) : last]
        for course in self._courses:
            course.place_anchors(data)
        _limits(self._limit, self.angles(data), self.pull(data), force, self.tendon, self.friction)
        self._model.tendon_frictionloss[self.rows] = self._limit

    def angles(self, data: mujoco.MjData) -> np.ndarray:
        """Wrap angles (guides,), rad; for a cable around round bodies Σ μ φ of the guide."""
        angles, (guides, *sites) = np.zeros(len(self.rows)), self._turns
        angles[self._hinges[0]] = np.abs(data.qpos[self._hinges[1]])
        if len(guides):
            before, here, behind = data.site_xpos[sites]
            (a, b, c), (x, y, z) = (here - before).T, (behind - here).T
            across = np.sqrt((b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2)
            np.add.at(angles, guides, np.arctan2(across, a * x + b * y + c * z))
        for g, course, turns in self._around:
            angles[g] = course.turn(data, turns)
        return angles

    def pull(self, data: mujoco.MjData) -> np.ndarray:
        """Tension at the driven end of each of MuJoCo's tendons, (tendons,).

        It is minus the actuators' forces, plus springs and dampers.
        """
        model, lengths = self._model, data.ten_length
        shortest, longest = model.tendon_lengthspring.T
        stretch = lengths - np.minimum(np.maximum(lengths, shortest), longest)
        pull: np.ndarray = model.tendon_stiffness * stretch
        pull += model.tendon_damping * data.ten_velocity
        driven = model.actuator_gear[:, 0] * data.actuator_force
        np.subtract.at(pull, model.actuator_trnid[:, 0], driven)
        return pull

    def sliding(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        """Tensions (guides,) behind the guides of sliding cables, and joint forces (MuJoCo's nv,).

        The directions are those of the present speeds.
        """
        if self._courses:
            for course in self._courses:
                course.place_anchors(data)
            mujoco.mj_fwdPosition(self._model, data)
            mujoco.mj_fwdVelocity(self._model, data)
        model, count = self._model, len(self.rows)
        direction, turns = -np.sign(data.ten_velocity[self.rows]), self.friction * self.angles(data)
        before, behind, pull = np.empty(count), np.empty(count), self.pull(data)
        for k, tendon in enumerate(self.tendon):
            first = k == 0 or tendon != self.tendon[k - 1]
            before[k] = pull[tendon] if first else behind[k - 1]
            behind[k] = before[k] * np.exp(-direction[k] * np.sign(before[k]) * turns[k])
        arms = np.zeros((model.ntendon, model.nv))
        mujoco.mju_sparse2dense(
            arms, data.ten_J.ravel(), model.ten_J_rownnz, model.ten_J_rowadr,
            model.ten_J_colind.ravel(),
        )  # fmt: skip
        return behind, arms[self.rows].T @ (before - behind)


@compiled
def _limits(limits, angles, pull, force, tendon, friction):
    """Replace the limits, given the friction that acted within them."""
    tension = 0.0
    for g in range(len(limits)):
        if g == 0 or tendon[g] != tendon[g - 1]:
            tension = pull[tendon[g]]
        turn = friction[g] * angles[g]
        # friction is positive where the cable slides towards its driven end
        inwards = force[g] >= 0.0
        if inwards == (tension >= 0.0):
            limit = abs(tension) * -np.expm1(-turn)
        else:
            limit = abs(tension) * np.expm1(turn)
        slides = abs(force[g]) >= SLIDES * limits[g]
        limits[g] = max(limit, LEAST)
        if slides:
            tension -= limit if inwards else -limit
        else:
            tension -= force[g]
