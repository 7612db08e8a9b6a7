"""Write the robot's file with identified numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from softdyn.checks import instance, number
from softdyn.description.robot import Robot, moving_link_of
from softdyn.description.urdf_writer import write
from softdyn.exceptions import InputError
from softdyn.identification.unknowns.kinds import KINDS


def rewrite_urdf(robot: Robot, values: Mapping[str, Mapping[str, float]]) -> str:
    """The text of the robot's URDF with `values`, rounded to 12 digits.

    Parameters
    ----------
    robot : Robot
        The robot with its old numbers.
    values : mapping
        Values by kind (of `KINDS`) and member, as from `member_values`. A mass is a factor of the
        body that the joint of that name moves, with all links fixed to it.
    """
    instance("robot", robot, Robot, "a Robot")
    if not isinstance(values, Mapping):
        raise InputError("values", "numbers by kind and member", repr(values))
    for kind, members in values.items():
        if kind not in KINDS or not isinstance(members, Mapping):
            raise InputError(f"values[{kind!r}]", f"one of {', '.join(KINDS)}", repr(members))
        for name, value in members.items():
            number(f"values[{kind!r}][{name!r}]", value)
        if kind == "force":  # a force of one's own stands in no file
            continue
        if kind == "mass":
            robot = _scaled(robot, members)
        else:
            rounded = {name: _rounded(value) for name, value in members.items()}
            robot = KINDS[kind].amended(robot, rounded)
    return write(robot)


def _scaled(robot: Robot, factors: Mapping[str, float]) -> Robot:
    """Multiply mass and moments of each link by the factor of the joint that moves it."""
    moving, joints = moving_link_of(robot), {joint.child: joint.name for joint in robot.joints}
    links = []
    for link in robot.links:
        if (factor := factors.get(joints.get(moving[link.name], ""))) is not None:
            moments = tuple(_rounded(factor * moment) for moment in link.moments)
            link = replace(link, mass=_rounded(factor * link.mass), moments=moments)
        links.append(link)
    return replace(robot, links=tuple(links))


def _rounded(value: float) -> float:
    return float(f"{value:.12g}")
