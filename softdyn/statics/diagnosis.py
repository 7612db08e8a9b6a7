"""Explain a robot's file: joints, tendons, inputs, stiffness against gravity, doubtful numbers.

print(diagnose(softdyn.load("finger")))
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from softdyn.description.robot import input_units
from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.text import head, joint_lines, numbers, rig_lines
from softdyn.exceptions import SoftdynError, UrdfError
from softdyn.statics.cable_edges import cable_edges
from softdyn.statics.equilibria import rest
from softdyn.statics.equilibrium import Equilibrium, locked_inputs
from softdyn.statics.suspicious_values import (
    below_floor,
    fast_springs,
    light_bodies,
    suspicious_shapes,
    suspicious_values,
    unbalanced,
)
from softdyn.statics.zero_dynamics import Pose, find_boundary, sample_poses

JOINT = ("name", "kind", "lower", "upper", "stiffness", "rest", "damping", "armature")
INPUT = ("name", "tendon", "gear", "lower", "upper")


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The findings of `diagnose`; ``print`` shows them as a text.

    Attributes
    ----------
    model : SoftModel
        The robot.
    held : SoftModel or None
        The same robot with its base held, which poses and equilibrium belong to; `model` itself if
        its base is fixed. None if no joint moves while the base is held.
    poses : tuple of Pose
        All examined poses, q = 0 first; none without `held`.
    boundary : tuple of float and Pose, or None
        The point on the way from q = 0 to the weakest pose at which gravity starts to win: its
        share of the way, and the pose there.
    least : float
        The smallest eigenvalue of the tangent stiffness at q = 0 over all directions, under the
        least input; NaN without `held`. If it is negative, the robot falls from q = 0 unless
        its inputs hold it.
    equilibrium : Equilibrium or None
        The equilibrium from q = 0 under the least input; None if there is none.
    warnings : tuple of str
        Warnings from reading the file.
    doubts : tuple of str
        Numbers that look wrong, and joint angles where a cable jumps.
    notes : tuple of str
        Limits of the simulation that the robot meets, although its numbers may be right.
    """

    model: SoftModel
    held: SoftModel | None
    poses: tuple[Pose, ...]
    boundary: tuple[float, Pose] | None
    least: float
    equilibrium: Equilibrium | None
    warnings: tuple[str, ...]
    doubts: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def rest(self) -> Pose:
        """The pose q = 0."""
        return self.poses[0]

    @cached_property
    def rank(self) -> int:
        """The largest rank of B."""
        return max((pose.rank for pose in self.poses), default=0)

    @property
    def rank_drops(self) -> list[Pose]:
        """Poses where B has a smaller rank than elsewhere."""
        return [pose for pose in self.poses if pose.rank < self.rank]

    @property
    def gravity_wins(self) -> list[Pose]:
        """Poses where stiffness does not dominate."""
        return [pose for pose in self.poses if not pose.dominates]

    @cached_property
    def weakest(self) -> Pose:
        """The pose of least stiffness."""
        return min(self.poses, key=lambda pose: pose.least)

    @property
    def falls(self) -> bool:
        """Whether the robot falls from q = 0 unless its inputs hold it."""
        return self.least < 0

    @property
    def softest(self) -> dict[str, float]:
        """The unactuated direction of least stiffness at q = 0: each joint's part, if not small."""
        return {name: x for name, x in self._by_joint(self.rest.softest).items() if abs(x) > 0.05}

    def _by_joint(self, values: np.ndarray) -> dict[str, float]:
        names = () if self.held is None else self.held.joint_names
        return dict(zip(names, values.tolist(), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        model, robot = self.model, self.model.robot
        found: dict[str, Any] = {
            "robot": model.name,
            "file": str(robot.path),
            "links": len(robot.links),
            "nv": model.nv,
            "nu": model.nu,
            "task": robot.task,
            "length_m": robot.length,
            "mass_kg": sum(link.inertia.mass for link in robot.links),
            "joints": [{key: getattr(j, key) for key in JOINT} for j in robot.moving_joints],
            "tendons": list(self._tendons()),
            "inputs": [
                {key: getattr(a, key) for key in INPUT} | {"unit": unit}
                for a, unit in zip(robot.actuators, input_units(robot), strict=True)
            ],
            "floating": robot.floating,
            "poses": len(self.poses),
            "rank": self.rank,
            "unactuated": model.nv - self.rank,
            "equilibrium": self._equilibrium(),
            "warnings": list(self.warnings),
            "doubts": list(self.doubts),
            "notes": list(self.notes),
            "ignored": list(robot.ignored),
            "read": list(robot.adopted),
        }
        return found | (self._of_poses() if self.poses else {})

    def _of_poses(self) -> dict[str, Any]:
        """Rank and stiffness at the poses as plain data."""
        rest, ceases = self.rest, None
        if self.boundary is not None:
            share, pose = self.boundary
            where = self._by_joint(pose.coordinates)
            ceases = {"towards": pose.name, "share": share, "coordinates": where}
        return {
            "rank_at_rest": rest.rank,
            "rank_drops_at": [self._place(pose) for pose in self.rank_drops],
            "softest_unactuated": self.softest,
            "stiffness_at_rest": rest.least,
            "stiffness_of_all_directions_at_rest": self.least,
            "gravity_at_rest": rest.gravity.max() if len(rest.gravity) else None,
            "dominates_at_rest": rest.dominates,
            "poses_where_gravity_wins": len(self.gravity_wins),
            "weakest": self._place(self.weakest) | {"stiffness": self.weakest.least},
            "ceases": ceases,
        }

    def _place(self, pose: Pose) -> dict[str, Any]:
        where = self._by_joint(pose.coordinates)
        return {"pose": pose.name, "rank": pose.rank, "coordinates": where}

    def _equilibrium(self) -> dict[str, Any] | None:
        found = self.equilibrium
        if found is None:
            return None
        return {"u": found.u.tolist(), "tip": found.y.tolist(), "stable": found.stable}

    def _tendons(self) -> Iterator[dict[str, Any]]:
        robot = self.model.robot
        lengths = self.model.tendon_lengths(self.model.q0)
        for tendon, length in zip(robot.tendons, lengths, strict=True):
            yield {
                "name": tendon.name,
                "kind": "spatial" if tendon.sites else "fixed",
                "over": [s.link for s in tendon.sites] or [t.joint for t in tendon.terms],
                "length": float(length),
                "stiffness": tendon.stiffness,
                "slack": tendon.slack,
                "armature": tendon.armature,
                "friction": tendon.friction,
                "actuators": [a.name for a in robot.actuators if a.tendon == tendon.name],
            }

    def __str__(self) -> str:
        count = len(self.doubts)
        well = "nothing looks wrong" if self.equilibrium else "no number looks wrong"
        return "\n".join((
            head(self.model.name, self.model.robot, self.model.nv),
            "", *joint_lines(self.model.robot),
            "", *self._tendon_lines(), *rig_lines(self.model.robot),
            "", *self._static_lines(),
            *(f"read: {line}" for line in self.model.robot.adopted),
            *(f"ignored: {', '.join(found)}" for found in [self.model.robot.ignored] if found),
            *(f"warning: {text}" for text in self.warnings),
            *(f"note: {text}" for text in self.notes),
            "", *(f"doubtful: {text}" for text in self.doubts),
            f"looks wrong in {count} ways" if count else well,
        ))  # fmt: skip

    def _static_lines(self) -> Iterator[str]:
        robot = self.model.robot
        if robot.floating:
            parts = "poses and equilibrium" if self.poses else "no joint moves then, so no poses"
            yield f"a floating base: checked with the base held at its pose in the file: {parts}"
            yield (
                "  not checked: the free base, which rests nowhere without contacts; "
                f"`softdyn crosscheck {robot.path} --floating` compares its motion in two engines"
            )
            yield ""
        if self.poses:
            yield from self._actuation_lines()
            yield ""
            yield from self._stability_lines()
            yield ""
            yield self._equilibrium_line()

    def _equilibrium_line(self) -> str:
        found = self.equilibrium
        if found is None:
            return "NO equilibrium was found from q = 0 under the least input"
        given = "the least input" if found.u.any() else "no input"
        firmly = "" if found.stable else f", {found.firmness}"
        return f"rests with its tip at {numbers(found.y)} m under {given}{firmly}"

    def _tendon_lines(self) -> Iterator[str]:
        yield f"tendons: {len(self.model.robot.tendons)}"
        for t in self._tendons():
            over = t["over"] if len(t["over"]) <= 4 else [*t["over"][:2], "…", t["over"][-1]]
            spring = f", elastic {t['stiffness']:g}" if t["stiffness"] else ""
            spring += " in tension only" if t["slack"] else ""
            spring += f", friction {t['friction']:g}" if t["friction"] else ""
            yield (
                f"  {t['name']:<16}{t['kind']:<8} over {', '.join(over)}: "
                f"length {t['length']:.4g}{spring}; {', '.join(t['actuators']) or 'no input'}"
            )

    def _actuation_lines(self) -> Iterator[str]:
        model, nv, drops = self.model, len(self.rest.coordinates), self.rank_drops
        locked = locked_inputs(model)
        moving = int(model.nu - locked.sum())
        yield (
            f"actuation: {moving} {'input moves' if moving == 1 else 'inputs move'} {self.rank} of "
            f"{nv} directions, springs and gravity have the other {nv - self.rank}"
        )
        for k in np.flatnonzero(locked):
            actuator = model.robot.actuators[k]
            yield f"  {actuator.name} moves nothing: its bounds hold it at {actuator.lower:g}"
        if drops:
            some = ", ".join(f"{pose.name} (rank {pose.rank})" for pose in drops[:3])
            yield f"  fewer at {len(drops)} of {len(self.poses)} poses: {some}"
        else:
            yield f"  the same at all {len(self.poses)} poses tried"

    def _stability_lines(self) -> Iterator[str]:
        yield "stiffness against gravity, where no input acts:"
        if self.rank == len(self.rest.coordinates) and not self.rank_drops:
            yield "  every direction has an input"
            return
        rest = self.rest
        most = float(rest.gravity[0])
        change = "takes away up to" if most > 0 else "adds at least"
        parts = f"{rest.least:.3g} (gravity {change} {abs(most):.3g})"
        if rest.dominates and self.falls:
            yield (
                f"  at q = 0 gravity wins unless an input holds the robot: the smallest "
                f"stiffness is {self.least:.3g}; in directions without an input it is {parts}"
            )
        else:
            verdict = "dominates" if rest.dominates else "does NOT dominate"
            yield f"  at q = 0 stiffness {verdict}: the smallest stiffness is {parts}"
        shares = ", ".join(f"{value:+.2f} {name}" for name, value in self.softest.items())
        yield f"  softest direction: {shares}"
        yield (
            f"  gravity wins at {len(self.gravity_wins)} of {len(self.poses)} poses; "
            f"least stiffness {self.weakest.least:.3g} at {self.weakest.name}"
        )
        if self.boundary is not None:
            share, pose = self.boundary
            where = f"{100 * share:.0f} % of the way from q = 0 to {pose.name}"
            yield f"  stiffness stops dominating {where}"


def diagnose(model: SoftModel, samples: int = 100, seed: int = 0) -> Diagnosis:
    """Explain a robot and list the numbers in its file that look wrong.

    Parameters
    ----------
    model : SoftModel
        The robot. A floating base is held at its pose in the file.
    samples : int
        Number of random poses, besides q = 0 and all joints at either limit.
    seed : int
        Seed of the random poses.

    Raises
    ------
    UrdfError
        For a visual shape with an invalid number.
    """
    held: SoftModel | None = model
    robot = check_model(model).robot
    if robot.floating:
        held = None
        with suppress(UrdfError):  # no joint moves, or only the free base gives M its inertia
            held = build(replace(robot, floating=False))
    poses = () if held is None else tuple(sample_poses(held, samples, seed))
    outsize, unreadable = suspicious_shapes(robot)
    equilibrium, boundary, least = None, None, math.nan
    if held is not None:
        least = _least_stiffness(held)
        boundary = find_boundary(held, min(poses, key=lambda pose: pose.least))
        with suppress(SoftdynError), np.errstate(all="ignore"):  # some robots have none
            equilibrium = rest(held)
    fast = fast_springs(model, model.state(model.q0, np.zeros(model.nv)))
    examined = [model.q0] if held is None else [held.configuration(p.coordinates) for p in poses]
    floor = below_floor(model if held is None else held, examined)
    return Diagnosis(
        model,
        held,
        poses,
        boundary,
        least,
        equilibrium,
        (*robot.warnings, *unreadable),
        (
            *suspicious_values(robot), *unbalanced(model), *([fast] if fast else []), *outsize,
            *_unheld(model, poses), *(() if held is None else cable_edges(held)),
        ),
        (floor,) if floor else tuple(light_bodies(robot)),
    )  # fmt: skip


def _least_stiffness(model: SoftModel) -> float:
    """The smallest eigenvalue of ∂(K + g - B u)/∂q at q = 0 under the least input.

    A value within rounding of the largest is zero.
    """
    u = model.relaxed
    values = np.linalg.eigvalsh(stiffness(model, model.q0, u))
    rounding = 1e-9 * np.abs(values).max(initial=0.0)
    return float(values[0]) if abs(values[0]) > rounding else 0.0


def _unheld(model: SoftModel, poses: Sequence[Pose]) -> Iterator[str]:
    """One line about springs that gravity overcomes at every pose, where no input helps."""
    springs = bool((model.stiffness > 0).any())
    if springs and not model.nu and poses and not any(pose.dominates for pose in poses):
        yield (
            f"gravity wins at all {len(poses)} poses, and no input holds the robot: springs in "
            "N mm/rad, masses in grams, or an <actuator> that is missing?"
        )
