"""Two sets of gains for one controller: one to approach a target, one to stay there.

Gains that move an arm fast over half its length chatter near the target, and gains that hold it
calmly arrive late. `controllers/schedules/ROBOT.toml` holds the tuned gains of a bundled robot; a
search found them once (CMA-ES, on other targets than the paper's).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softdyn import SoftModel
from softdyn.checks import number
from softdyn.controllers.gains import Gains
from softdyn.dynamics.model import check_model
from softdyn.exceptions import errors_in
from softdyn.files import read_toml
from softdyn.toml_table import TomlTable

FOLDER = Path(__file__).parent / "schedules"


@dataclass(frozen=True)
class Stage:
    """Arguments of a `SoftIdClfQp`: gains, horizon (s), the input that has no cost."""

    gains: Gains
    horizon: float = 0.0
    u_ref: float = 0.0

    def __post_init__(self) -> None:
        number("horizon", self.horizon, lower=0.0)
        number("u_ref", self.u_ref)


@dataclass(frozen=True)
class Schedule:
    """Two stages, and the conditions to switch between them.

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
        For a distance that is not positive, a `leave` not larger than `arrive`, a negative time.
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
    """A `Schedule` from the content of a TOML file.

    ``[approach]`` and ``[stay]`` have the fields of `Gains`, ``horizon`` and ``u_ref``. The other
    keys are the other attributes of `Schedule`.

    Raises
    ------
    InputError
        For tables or numbers that are missing, unknown or out of range.
    """
    read = TomlTable(table, "gains")
    return read.make(Schedule, **{one: _stage(read.needed(one)) for one in ("approach", "stay")})


def tuned(model: SoftModel) -> Schedule | None:
    """The tuned schedule of a bundled robot; None if it has none, and for any other robot."""
    file = FOLDER / f"{check_model(model).bundled}.toml"
    return make_schedule(read_toml(file)) if file.is_file() else None


def _stage(table: TomlTable) -> Stage:
    own = {key: table.number(key, default=0.0) for key in ("horizon", "u_ref")}
    with errors_in(table.where):
        return Stage(table.make(Gains), **own)
