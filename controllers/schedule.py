"""Two sets of gains for one law: to approach a target, and to stay with it.

What moves an arm fast over half its length chatters when the target is near, and what holds it
calmly takes long to arrive. `controllers/schedules/ROBOT.toml` has the tuned ones of the bundled
robots, from `scripts/tune.py`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.checks import number
from softdyn.controllers.gains import Gains

FOLDER = Path(__file__).parent / "schedules"
OWN = ("horizon", "u_ref")  # of a stage's table, beside the gains


@dataclass(frozen=True)
class Stage:
    """What `SoftIdClfQp` takes: gains, horizon (s), the input that costs nothing."""

    gains: Gains
    horizon: float = 0.0
    u_ref: float = 0.0

    def __post_init__(self) -> None:
        number("horizon", self.horizon, lower=0.0)
        number("u_ref", self.u_ref)


@dataclass(frozen=True)
class Schedule:
    """Which stage acts when.

    Attributes
    ----------
    approach, stay : Stage
        The stages.
    arrive : float
        `stay` takes over when the tip has been within this distance (m) of the target...
    dwell : float
        ... for this time (s).
    leave : float
        `approach` takes over beyond this distance (m).

    Raises
    ------
    InputError
        A distance that is not positive, `leave` not larger than `arrive`, a negative time.
    """

    approach: Stage
    stay: Stage
    arrive: float
    leave: float
    dwell: float

    def __post_init__(self) -> None:
        number("arrive", self.arrive, above=0.0)
        number("leave", self.leave, above=self.arrive)
        number("dwell", self.dwell, lower=0.0)


def make_schedule(table: Mapping[str, Any]) -> Schedule:
    """A `Schedule` from the tables of a TOML file: ``[approach]`` and ``[stay]`` with the fields of
    `Gains`, ``horizon`` and ``u_ref``, and the other attributes.

    Raises
    ------
    InputError
        Tables or numbers that are missing, unknown or out of range.
    """
    names = [field.name for field in fields(Schedule)]
    if sorted(table) != sorted(names):
        raise InputError("gains", f"a schedule: {', '.join(names)}", ", ".join(table) or "nothing")
    stages = {name: _stage(name, table[name]) for name in names[:2]}
    return Schedule(**{**table, **stages})


def tuned(model: SoftModel) -> Schedule | None:
    """The schedule of a bundled robot; None where there is none."""
    file = FOLDER / f"{model.bundled}.toml"
    if model.bundled is None or not file.is_file():
        return None
    return make_schedule(tomllib.loads(file.read_text()))


def _stage(name: str, table: Any) -> Stage:
    allowed = [*(field.name for field in fields(Gains)), *OWN]
    if not isinstance(table, Mapping) or "Kp" not in table or set(table) - set(allowed):
        raise InputError(name, f"a table with Kp and any of {', '.join(allowed[1:])}", table)
    own = {key: value for key, value in table.items() if key in OWN}
    return Stage(Gains(**{key: value for key, value in table.items() if key not in OWN}), **own)
