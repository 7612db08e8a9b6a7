"""The map from a controller's inputs to the actuators of another file, by their forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softdyn.exceptions import InputError
from softdyn.validation.mjcf.comparison.matching import plain_name
from softdyn.validation.mjcf.comparison.neutral import Motor, Neutral, NeutralTendon


@dataclass(frozen=True, eq=False)
class InputMap:
    """Input or force = matrix u, (theirs, ours); `idle` names the actuators that no input drives.

    The result is the input of an actuator without a law, and the force of any other.
    """

    matrix: np.ndarray
    idle: tuple[str, ...]


def map_inputs(
    ours: Neutral,
    theirs: Neutral,
    matched: dict[str, str],
    turns: dict[str, tuple[float, float]],
    obstacles: Sequence[str],
) -> InputMap:
    """Find for each input of the model the actuator of the scene, and the scale between them.

    An actuator of the same name is preferred. Otherwise it is one on the same cable, or on the only
    joint of a fixed tendon. The scale gives each input the force that it has in the model. If the
    sums of a fixed tendon are not proportional, it is the tension of the tendon of the same name.

    Parameters
    ----------
    ours, theirs : Neutral
        The model's file, and the scene.
    matched, turns : dict
        Joints that match, and their senses, from a comparison.
    obstacles : sequence of str
        For each of the scene's actuators the reason why it cannot make a given force, or "".

    Raises
    ------
    InputError
        The scene has no actuator for an input, or the actuator cannot make a given force.
    """
    matrix = np.zeros((len(theirs.motors), len(ours.motors)))
    joints = {b: a for a, b in matched.items()}
    scale = {b: turns.get(a, (1.0, 0.0))[0] for b, a in joints.items()}
    own = {motor.name: _pull(motor, ours, {}, {}) for motor in ours.motors}
    found = {motor.name: _pull(motor, theirs, joints, scale) for motor in theirs.motors}
    for k, motor in enumerate(ours.motors):
        fits = [
            i
            for i, other in enumerate(theirs.motors)
            if _ratio(own[motor.name], found[other.name]) is not None
        ]
        fits.sort(
            key=lambda i: (
                plain_name(theirs.motors[i].name) != plain_name(motor.name), bool(obstacles[i]), i
            )
        )  # fmt: skip
        free = [i for i in fits if not matrix[i].any()]
        where = f"{theirs.path}: actuator for {motor.name!r}"
        if not free:
            got = "; ".join(f"{m.name!r} on {m.target}" for m in theirs.motors) or "none"
            raise InputError(where, f"one on {motor.target}", got)
        chosen = theirs.motors[free[0]]
        if obstacle := obstacles[free[0]]:
            expected = "an actuator whose force is linear in its command, as a motor's or a servo's"
            raise InputError(where, expected, f"{chosen.name!r}, {obstacle}")
        matrix[free[0], k] = _ratio(own[motor.name], found[chosen.name])
    idle = tuple(m.name for i, m in enumerate(theirs.motors) if not matrix[i].any())
    return InputMap(matrix, idle)


Pull = tuple[dict[str, float], NeutralTendon | None, float]


def _pull(motor: Motor, robot: Neutral, joints: dict[str, str], scale: dict[str, float]) -> Pull:
    """Generalized force of a unit input: on joints by our names, or along a cable."""
    kind, _, name = motor.target.partition(":")
    if kind == "joint":
        return {joints.get(name, name): motor.gear * scale.get(name, 1.0)}, None, motor.gear
    cable = next((c for c in robot.cables if kind == "tendon" and c.name == name), None)
    if cable is None or cable.path:
        return {}, cable, motor.gear
    terms = {joints.get(j, j): motor.gear * c * scale.get(j, 1.0) for j, c in cable.terms.items()}
    return terms, cable, motor.gear


def _ratio(ours: Pull, theirs: Pull) -> float | None:
    """Their input that makes the force of our unit input; None if none does."""
    if ours[0] and theirs[0]:
        mine, other = ours[0], theirs[0]
        if mine.keys() != other.keys():
            return _of_one_cable(ours, theirs)
        ratios = np.array([mine[joint] / other[joint] if other[joint] else 0.0 for joint in mine])
        if np.allclose(ratios, ratios[0], rtol=1e-3) and ratios.all():
            return float(ratios[0])
    return _of_one_cable(ours, theirs)


def _of_one_cable(ours: Pull, theirs: Pull) -> float | None:
    """Their input that pulls as hard on the cable of the same name; None for two cables.

    The cable's arms may differ, as those of a path do.
    """
    first, second = (pull[1] for pull in (ours, theirs))
    if first is None or second is None or not theirs[2]:
        return None
    if bool(first.path) != bool(second.path) or plain_name(first.name) != plain_name(second.name):
        return None
    return ours[2] / theirs[2]


def map_cables(
    ours: Neutral, theirs: Neutral, matched: dict[str, str], turns: dict[str, tuple[float, float]]
) -> np.ndarray:
    """The scene's tendon for each tendon of the model (tendons,): by name, or by its joints."""
    joints = {b: a for a, b in matched.items()}
    scale = {b: turns.get(a, (1.0, 0.0))[0] for b, a in joints.items()}
    terms = [
        {joints.get(j, j): scale.get(j, 1.0) * c for j, c in cable.terms.items()}
        for cable in theirs.cables
    ]
    found = []
    for cable in ours.cables:
        name = plain_name(cable.name)
        like = [k for k, other in enumerate(theirs.cables) if plain_name(other.name) == name]
        like += [k for k in range(len(terms)) if cable.terms and cable.terms == terms[k]]
        found.append(like[0] if like else -1)
    return np.array(found, int)
