"""Strain models: piecewise constant or polynomial strains as a basis of an arm's joints."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from softdyn.checks import number
from softdyn.description.robot import Robot
from softdyn.design.layout import lay_out
from softdyn.design.quadrature import RULES
from softdyn.design.rods import Arm
from softdyn.dynamics.reduced import Basis
from softdyn.exceptions import InputError

# a line of `arm_file.comment`
SECTION = re.compile(r"^\s*Section (.+): (\d+) joints of (.+); EI .*, from (\S+) m on\.$", re.M)
SHOWN = 1e-3  # relative, of a start in that comment, which has four digits
SAME = 1e-9  # relative to a section's length: places of joints are sums of rounded numbers


class _Section(NamedTuple):
    name: str
    segments: int
    freedoms: tuple[str, ...]


class _Joint(NamedTuple):
    """A joint of a section, at the share `at` of its length, for `weight` of it (m)."""

    name: str
    section: int
    at: float
    weight: float
    strain: str


def strain_basis(arm: Arm | Robot, degree: int = 0) -> Basis:
    """The basis of strains that are polynomials in each section, for `softdyn.reduce`.

    The strain of freedom f in a section is Σ ξ_k P_k(2 s/length - 1), with Legendre's P_k. Degree 0
    is piecewise constant curvature (PCC) if sections only bend, and piecewise constant strain (PCS)
    with twist, extension and shear. A joint at s that stands for the length w turns by w times the
    strain at s. The unit of ξ is 1/m; for extension and shear ξ has no unit.

    Parameters
    ----------
    arm : Arm or Robot
        An arm with enough joints to represent the rod, or the robot of a file that `softdyn new`
        wrote for one. Its comment has the sections, and its joints have the places. More joints
        make the reduced model slower to build, but not slower to use.
    degree : int
        Degree of the polynomials.

    Raises
    ------
    InputError
        If the degree is not below the number of joints in every section, and for a robot whose file
        does not have the sections of an arm.
    """
    number("degree", degree, lower=0)
    if isinstance(arm, Robot):
        sections, joints = _in_file(arm)
    elif isinstance(arm, Arm):
        sections = [_Section(one.name, one.segments, tuple(one.freedoms)) for one in arm.sections]
        joints = [_Joint(spring.name, spring.section, spring.at, spring.weight, spring.strain)
                  for spring in lay_out(arm).all_springs]  # fmt: skip
    else:
        raise InputError("arm", "an Arm, or the Robot of a file", type(arm).__name__)
    least = min(section.segments for section in sections)
    if int(degree) != degree or degree >= least:
        raise InputError("degree", f"a whole number below the segments, {least}", degree)
    names, columns = [], []
    for index, section in enumerate(sections):
        for strain in section.freedoms:
            for k in range(int(degree) + 1):
                legendre = np.polynomial.legendre.Legendre.basis(k)
                names.append(f"{strain}_{section.name}" + (f"_{k}" if degree else ""))
                columns.append(
                    [
                        joint.weight * float(legendre(2 * joint.at - 1))
                        if (joint.section, joint.strain) == (index, strain)
                        else 0.0
                        for joint in joints
                    ]
                )
    return Basis(np.array(columns).T, tuple(joint.name for joint in joints), tuple(names))


def _in_file(robot: Robot) -> tuple[list[_Section], list[_Joint]]:
    """The sections in the comment of an arm's file, and its joints with places and weights.

    The places of a section's joints are start + node · length, with the nodes of a rule. The rule
    is the one that fits all sections.
    """
    said = SECTION.findall(robot.comment)
    sections = [_Section(name, int(n), tuple(words.split(", "))) for name, n, words, _ in said]
    groups: dict[str, tuple[float, list[str]]] = {}  # number of a station: its place, its joints
    x = 0.0
    for joint in robot.moving_joints:
        x += joint.origin.xyz[0]
        count = joint.name.rpartition("_")[2]
        groups.setdefault(count, (x, []))[1].append(joint.name)
    stations = list(groups.values())
    if not said or len(stations) != sum(section.segments for section in sections):
        expected = "an arm's own file, as `softdyn new` wrote it"
        raise InputError("arm", expected, robot.path or robot.name)
    for rule in RULES.values():
        found, end, first = list[_Joint](), 0.0, 0
        for index, (section, (*_, start)) in enumerate(zip(sections, said, strict=True)):
            part = stations[first : first + section.segments]
            fitted = _fitted(rule, [place for place, _ in part], float(start), end)
            if fitted is None:
                break
            (begin, length), (nodes, weights) = fitted, rule(section.segments)
            for (_, names), node, weight in zip(part, nodes, weights, strict=True):
                found += [
                    _Joint(name, index, float(node), float(weight) * length,
                           name.rpartition("_")[0])
                    for name in names
                ]  # fmt: skip
            end, first = begin + length, first + section.segments
        else:
            return sections, found
    raise InputError("arm", f"joints at the places of {' or '.join(RULES)}", robot.name)


def _fitted(
    rule: Callable[[int], tuple[np.ndarray, np.ndarray]],
    places: Sequence[float],
    stated: float,
    before: float,
) -> tuple[float, float] | None:
    """Start and length of a section by the places of its joints; None if the rule has others."""
    nodes = rule(len(places))[0]
    if len(places) == 1:  # it begins where the one before it ends
        start, length = before, (places[0] - before) / float(nodes[0])
    else:
        A = np.column_stack((np.ones(len(places)), nodes))
        start, length = map(float, np.linalg.lstsq(A, places, rcond=None)[0])
    missed = np.abs(start + length * nodes - places).max()
    if missed > SAME * length or abs(start - stated) > SHOWN * stated + SAME * length:
        return None
    return start, length
