"""The rig in an MJCF: commands, lag and delay of its actuators, slack tendons, sensors.

A winch of the format is MuJoCo's position actuator, or its integrating velocity actuator. With gear
a, gain G, constant bias b₀ and bias slope b its free length is c = -(G w + b₀) / (a b) for the
input or activation w, its stiffness -a² b. So its command is w = unit · (c - offset) with
unit = -a b / G and offset = -b₀ / (a b).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from softdyn.description.rig import CommandKind
from softdyn.validation.mjcf.compiled_fields import value_of
from softdyn.validation.twin.drives import FIRST_PARTS, UNBOUNDED, tag_of

Numbers = tuple[float, ...]
ROUNDING = 1e-9
DIGITS = 8  # of a delay in seconds; files may state a hair less than whole steps
# fields of an actuator that its command and lag state
STATED = ("actuator_biastype", "actuator_biasprm", "actuator_dyntype", "actuator_dynprm")
WINDS = (int(mujoco.mjtTrn.mjTRN_TENDON), int(mujoco.mjtTrn.mjTRN_JOINT))
# a winch's in `Motor.rig`
CABLE = ("stiffness", "damping", "length_lower", "length_upper", "unit", "offset")
ABSENT = {
    "rate": math.inf, "length_lower": -math.inf, "length_upper": math.inf, "unit": 1.0,
}  # fmt: skip
COMMANDS = {
    int(mujoco.mjtDyn.mjDYN_NONE): CommandKind.LENGTH,
    int(mujoco.mjtDyn.mjDYN_FILTEREXACT): CommandKind.LENGTH,
    int(mujoco.mjtDyn.mjDYN_INTEGRATOR): CommandKind.VELOCITY,
}

# MuJoCo's elements, or the first two of a reading → kind of the format's
READ = {tuple(map(tag_of, parts)): kind.value for kind, parts in FIRST_PARTS.items()}


@dataclass(frozen=True)
class NeutralSensor:
    """A sensor. A frame on a link that it has is among the robot's frames.

    Attributes
    ----------
    kind : str
        As in the format, or MuJoCo's names of types.
    target : str
        ``tendon:name`` or ``joint:name``, empty for a frame.
    more : dict[str, Numbers]
        Rate, latency, noise, bias and resolution, where they are not 0.
    """

    kind: str
    target: str
    more: dict[str, Numbers] = field(default_factory=dict)


def rig_of(model: mujoco.MjModel, k: int, more: dict[str, Numbers]) -> dict[str, Any] | None:
    """Command, lag and delay of an actuator, as `Motor.rig`; None for one with another law.

    The fields that they state are removed from `more`.
    """
    found = _command(model, k)
    if found is None:
        return None
    for name in STATED if found else ():
        more.pop(name, None)
    if "actuator_delay" in more and not any(more.get("actuator_history", (0.0,))[1:]):
        more.pop("actuator_history", None)  # without interpolation it is only the delay's memory
        found["delay"] = round(more.pop("actuator_delay")[0], DIGITS)
    return found


def _command(model: mujoco.MjModel, k: int) -> dict[str, Any] | None:
    """Command and lag of an actuator; None for one with another law."""
    gear, gain = value_of(model, "actuator_gear", k)[0], float(model.actuator_gainprm[k, 0])
    dynamics, bias = model.actuator_dyntype[k], model.actuator_biastype[k]
    fixed = model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
    unbiased, still = bias == mujoco.mjtBias.mjBIAS_NONE, dynamics == mujoco.mjtDyn.mjDYN_NONE
    if fixed and unbiased and still:
        return {}
    if not fixed or model.actuator_ctrlnum[k] != 1:
        return None
    found: dict[str, Any] = {}
    if dynamics == mujoco.mjtDyn.mjDYN_FILTEREXACT:
        found["lag"] = float(model.actuator_dynprm[k, 0])
    if unbiased:
        return found or None
    constant, slope, brake, *others = map(float, model.actuator_biasprm[k])
    winds = model.actuator_trntype[k] in WINDS and not any(others)
    affine = bias == mujoco.mjtBias.mjBIAS_AFFINE
    if not (winds and affine and gain and gear and slope < 0 and brake <= 0):
        return None
    if int(dynamics) not in COMMANDS:
        return None
    if constant:
        if COMMANDS[int(dynamics)] is CommandKind.VELOCITY:
            return None
        found["offset"] = -constant / (slope * gear)
    found |= {"command": COMMANDS[int(dynamics)].value, "stiffness": -slope * gear**2}
    if brake:
        found["damping"] = -brake * gear**2
    if abs((unit := -slope * gear / gain) - 1) > ROUNDING:
        found["unit"] = unit
    return found


def bound(rig: dict[str, Any], more: dict[str, Numbers], inputs: tuple[float, float]) -> None:
    """Add the bounds of a winch's free length; those of a velocity are told as the field."""
    lengths = inputs
    if rig["command"] == CommandKind.VELOCITY.value:
        lengths = more.pop("actuator_actrange", (-math.inf, math.inf))  # type: ignore[assignment]
        if np.isfinite(inputs).any():
            more["actuator_ctrlrange"] = inputs
    ends = sorted(x / rig.get("unit", 1.0) for x in lengths)
    for name, length in zip(("lower", "upper"), ends, strict=True):
        if abs(length) < UNBOUNDED:
            rig[f"length_{name}"] = length + rig.get("offset", 0.0)


def about_joint(rig: dict[str, Any], coefficient: float) -> dict[str, Any]:
    """A winch's rig in its joint's coordinate q, where its tendon's length is coefficient · q."""
    if "command" not in rig or coefficient in (0.0, 1.0):
        return rig
    ends = sorted(rig.get(name, ABSENT[name]) / coefficient for name in CABLE[2:4])
    found = rig | dict(zip(CABLE[2:4], ends, strict=True))
    found |= {name: rig[name] * coefficient**2 for name in CABLE[:2] if name in rig}
    found["unit"] = rig.get("unit", 1.0) * coefficient
    if "offset" in rig:
        found["offset"] = rig["offset"] / coefficient
    return {name: value for name, value in found.items() if ABSENT.get(name) != value}


def slack_of(model: mujoco.MjModel) -> dict[int, int]:
    """Tendon → the actuator that is its spring and damper in tension, as the twin has them."""
    found: dict[int, int] = {}
    for k in range(model.nactuator):
        tendon, bias = int(model.actuator_trnid[k, 0]), model.actuator_biasprm[k]
        own = model.tendon_stiffness, model.tendon_stiffnesspoly, model.tendon_damping
        if (
            model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_TENDON
            and model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
            and model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE
            and not (model.actuator_gainprm[k, 0] or bias[3:].any())
            and max(bias[1], bias[2]) <= 0 > min(bias[1], bias[2])
            and value_of(model, "actuator_gear", k)[0] == -1
            and model.actuator_forcelimited[k]
            and model.actuator_forcerange[k, 0] == 0
            and model.actuator_forcerange[k, 1] >= UNBOUNDED
            and not any(values[tendon].any() for values in own)
            and not model.tendon_dampingpoly[tendon].any()
        ):
            found[tendon] = k
    return found


def spring_of(
    model: mujoco.MjModel, t: int, pulls: dict[int, int], damped: bool
) -> tuple[float, float, tuple[float, float], bool]:
    """Stiffness, damping, rest lengths of a tendon, and whether it can be slack.

    A damper of MuJoCo's own, such as an actuator's (`damped`), acts on a slack tendon too.
    """
    if t in pulls:
        constant, slope, brake = map(float, model.actuator_biasprm[pulls[t], :3])
        rest = constant / slope if slope else 0.0
        return -slope, -brake, (rest, rest), True
    stiffness, damping = float(model.tendon_stiffness[t]), float(model.tendon_damping[t])
    low, high = map(float, model.tendon_lengthspring[t])
    path = model.wrap_type[model.tendon_adr[t]] != mujoco.mjtWrap.mjWRAP_JOINT
    slack = low < high and low <= (0.0 if path else -UNBOUNDED) and stiffness > 0
    slack &= not (damping or damped or model.tendon_stiffnesspoly[t].any())
    return stiffness, damping, (high, high) if slack else (low, high), slack


def sensors_of(stated: Iterable[tuple[str, dict[str, str]]]) -> dict[str, NeutralSensor]:
    """Sensors by name, from elements of a file; the parts ``name:0`` … of a reading are one."""
    groups: dict[str, list[tuple[str, dict[str, str]]]] = {}
    for tag, words in stated:
        stem, _, number = words.get("name", tag).rpartition(":")
        name = stem if stem and number.isdigit() else words.get("name", tag)
        groups.setdefault(name, []).append((tag, words))
    found = {}
    for name, parts in groups.items():
        tags, words = tuple(tag for tag, _ in parts), parts[0][1]
        kind = READ.get(tags[:2], READ.get(tags, " ".join(tags)))
        ends = (f"{sort}:{words[sort]}" for sort in ("tendon", "joint") if sort in words)
        interval, delay = _first(words.get("interval")), _first(words.get("delay"))
        more: dict[str, Numbers] = {"rate": (1.0 / interval,)} if interval > 0 else {}
        more |= {"latency": (round(delay, 8),)} if delay > 0 else {}
        found[name] = NeutralSensor(kind, next(ends, ""), more)
    return found


def _first(text: str | None) -> float:
    """The first number of an attribute; 0 without one."""
    try:
        return float((text or "").split()[0])
    except (IndexError, ValueError):
        return 0.0
