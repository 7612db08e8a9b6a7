"""The messages of a page to a live robot, as frozen data; only this file reads and checks them.

A message is one JSON object ``{"do": NAME, ...}``. Its other members are exactly the fields of the
class of that name (`MESSAGES`). Bounds come from the robot and the menu: `Limits`. A page's server
reads the message; the robot's loop gets the checked message.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from softdyn.checks import array, number
from softdyn.description.task_mark import TaskMark
from softdyn.exceptions import InputError

if TYPE_CHECKING:
    from softdyn.dynamics.model import SoftModel  # a page's server needs no engine

LONGEST = 20_000  # bytes of a message
OPEN_LOOP = "open loop"  # the entry of the menu that applies the sliders' inputs
FARTHEST = 3.0  # distance of a point from the base, in robot lengths
SPEEDS = (0.01, 10.0)
FACTORS = (0.2, 5.0)  # of mass, stiffness, damping
LARGEST_DELAY, LARGEST_NOISE = 0.1, 0.05  # s, m


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds and choices of a message's values.

    Attributes
    ----------
    links, laws : tuple of str
        The robot's links, and the menu of controllers.
    reach : float
        Largest distance of a point from the base (m).
    lower, upper : ndarray, (nu,)
        Bounds of the inputs.
    least, most : ndarray, (nv,)
        Limits of the joints.
    marks : tuple of TaskMark
        The tasks whose targets are dragged.
    """

    links: tuple[str, ...]
    laws: tuple[str, ...]
    reach: float
    lower: np.ndarray
    upper: np.ndarray
    least: np.ndarray
    most: np.ndarray
    marks: tuple[TaskMark, ...] = ()

    @classmethod
    def of(
        cls, model: SoftModel, laws: tuple[str, ...], size: float, marks: tuple[TaskMark, ...] = ()
    ) -> Limits:
        """The limits of a robot that fits in `size` (m)."""
        links = tuple(link.name for link in model.robot.links)
        least, most = (np.clip(ends, -1e3, 1e3) for ends in (model.lower, model.upper))
        reach = FARTHEST * size
        return cls(links, laws, reach, model.u_min, model.u_max, least, most, marks)


Read = Callable[[Limits, str, Any], Any]


def _by(read: Read) -> dict[str, Read]:
    """The metadata of a field: the function that reads its value."""
    return {"read": read}


def _flag(_limits: Limits, name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError(name, "true or false", value)
    return value


def _point(limits: Limits, name: str, value: Any) -> np.ndarray:
    return _within(name, value, np.full(3, -limits.reach), np.full(3, limits.reach))


def _inputs(limits: Limits, name: str, value: Any) -> np.ndarray:
    return _within(name, value, limits.lower, limits.upper)


def _joints(limits: Limits, name: str, value: Any) -> np.ndarray:
    return _within(name, value, limits.least, limits.most)


def _targets(limits: Limits, name: str, value: Any) -> np.ndarray:
    found, at = array(name, value, (sum(len(mark.columns) for mark in limits.marks),)), 0
    for mark in limits.marks:
        end = at + len(mark.columns)
        mark.check(found[at:end], limits.reach)
        at = end
    return found


def _within(name: str, value: Any, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    found = array(name, value, lower.shape)
    # JavaScript rounds a slider's end differently, so it may be slightly outside
    margin = 1e-6 * (1 + np.abs(found))
    if (found < lower - margin).any() or (found > upper + margin).any():
        raise InputError(name, f"numbers from {lower.tolist()} to {upper.tolist()}", value)
    return np.clip(found, lower, upper)


def _between(low: float, high: float) -> Read:
    def read(_limits: Limits, name: str, value: Any) -> float:
        found = number(name, value)
        if not low <= found <= high:
            raise InputError(name, f"a number from {low:g} to {high:g}", value)
        return found

    return read


def _choice(menu: Callable[[Limits], tuple[str, ...]]) -> Read:
    def read(limits: Limits, name: str, value: Any) -> str:
        if not isinstance(value, str) or value not in menu(limits):
            raise InputError(name, f"one of {', '.join(menu(limits))}", value)
        return value

    return read


@dataclass(frozen=True, eq=False)
class SetTarget:
    """Moves the target of the tip to `y` (3,) in the world (m)."""

    y: np.ndarray = field(metadata=_by(_point))


@dataclass(frozen=True, eq=False)
class SetTargets:
    """Sets the targets of all tasks: the numbers of each, see `TaskMark`, one after the other."""

    values: np.ndarray = field(metadata=_by(_targets))


@dataclass(frozen=True, eq=False)
class SetInputs:
    """Sets the inputs (nu,) of the open loop."""

    u: np.ndarray = field(metadata=_by(_inputs))


@dataclass(frozen=True, eq=False)
class SetJoints:
    """Sets joint coordinates (nv,) of an explored robot (rad, m)."""

    x: np.ndarray = field(metadata=_by(_joints))


@dataclass(frozen=True)
class SetController:
    """Chooses a controller of the menu."""

    name: str = field(metadata=_by(_choice(lambda limits: limits.laws)))


@dataclass(frozen=True)
class Mismatch:
    """Differences of the plant from the model, and of its signals from ideal ones.

    It has factors on mass, stiffness and damping; whether links touch; the delay (s) from a state
    to its input; and the noise of q and q̇ that the controller gets, by its rms effect on the tip
    (m).
    """

    mass: float = field(default=1.0, metadata=_by(_between(*FACTORS)))
    stiffness: float = field(default=1.0, metadata=_by(_between(*FACTORS)))
    damping: float = field(default=1.0, metadata=_by(_between(*FACTORS)))
    contacts: bool = field(default=False, metadata=_by(_flag))
    delay: float = field(default=0.0, metadata=_by(_between(0.0, LARGEST_DELAY)))
    noise: float = field(default=0.0, metadata=_by(_between(0.0, LARGEST_NOISE)))


@dataclass(frozen=True, eq=False)
class Push:
    """A spring from a point (3,) in a link's frame to a point (3,) of the world (m)."""

    link: str = field(metadata=_by(_choice(lambda limits: limits.links)))
    at: np.ndarray = field(metadata=_by(_point))
    to: np.ndarray = field(metadata=_by(_point))


@dataclass(frozen=True)
class Release:
    """Ends the push."""


@dataclass(frozen=True)
class Pause:
    """Stops the clock, or lets it run."""

    on: bool = field(metadata=_by(_flag))


@dataclass(frozen=True)
class SingleStep:
    """Pauses the robot and runs one control period."""


@dataclass(frozen=True)
class Reset:
    """Puts the robot at rest, at t = 0."""


@dataclass(frozen=True)
class SetSpeed:
    """Sets the clock's largest speed in simulated seconds per second."""

    factor: float = field(metadata=_by(_between(*SPEEDS)))


@dataclass(frozen=True)
class ShowGhost:
    """Starts or ends the ghost: an observer's estimate, or the model under the same input."""

    on: bool = field(metadata=_by(_flag))


@dataclass(frozen=True)
class RecordFrames:
    """Begins a recording, or ends it; its end makes a page that replays it."""

    on: bool = field(metadata=_by(_flag))


@dataclass(frozen=True)
class FindReach:
    """Asks for the tips of stable equilibria."""


@dataclass(frozen=True)
class Lead:
    """Makes this page the commanding one; the former one then watches."""


Message = (
    SetTarget | SetTargets | SetInputs | SetJoints | SetController | Mismatch | Push | Release
    | Pause | SingleStep | Reset | SetSpeed | ShowGhost | RecordFrames | FindReach | Lead
)  # fmt: skip
DRAGS = (SetTarget, SetTargets, SetInputs, SetJoints, Push)  # each replaces the one just before it
MESSAGES: dict[str, Callable[..., Message]] = {
    "target": SetTarget, "targets": SetTargets, "inputs": SetInputs, "joints": SetJoints,
    "law": SetController, "mismatch": Mismatch, "push": Push, "release": Release, "pause": Pause,
    "step": SingleStep,
    "reset": Reset, "speed": SetSpeed, "ghost": ShowGhost, "record": RecordFrames,
    "reach": FindReach, "lead": Lead,
}  # fmt: skip
NAMES = {cls: name for name, cls in MESSAGES.items()}


def read(text: str | bytes, limits: Limits) -> Message:
    """Read and check a message.

    Parameters
    ----------
    text : str or bytes
        The message as JSON; it may come from anyone.
    limits : Limits
        The robot's limits.

    Raises
    ------
    InputError
        For any other text; the error names the member, what was expected and what was got.
    """
    if len(text) > LONGEST:
        raise InputError("message", f"at most {LONGEST} bytes", len(text))
    try:
        said = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError("message", "JSON", error) from None
    if not isinstance(said, dict):
        raise InputError("message", "a JSON object", said)
    name = said.pop("do", None)
    cls = MESSAGES.get(name) if isinstance(name, str) else None
    if cls is None:
        raise InputError("do", f"one of {', '.join(MESSAGES)}", name)
    known = {one.name: one for one in fields(cls)}  # type: ignore[arg-type]
    unknown = sorted(said.keys() - known.keys())
    if unknown:
        raise InputError(str(name), f"only {', '.join(known) or 'no members'}", unknown[0])
    found = {}
    for one in known.values():
        if one.name in said:
            label = f"{name}.{one.name}"
            found[one.name] = one.metadata["read"](limits, label, said[one.name])
        elif one.default is MISSING:
            raise InputError(str(name), f"a member {one.name}", "none")
    return cls(**found)
