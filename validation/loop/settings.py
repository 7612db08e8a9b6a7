"""The settings of a run, declared once: the check, unit and default of each, and its forms.

Keywords of `simulate` and `rollout`, options of the commands, keys of a sweep's `[run]` and entries
of a log's record follow from this declaration. Its checks are imported when they are used, so that
the parser of a command needs neither NumPy nor MuJoCo.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from softdyn.exceptions import InputError
from softdyn.validation.twin.integrators import Integrator, integrator_of

if TYPE_CHECKING:
    from softdyn.estimation import Observer
    from softdyn.safety import Surroundings
    from softdyn.validation.twin.rig import Rig

MODEL = "model"  # the word of `plant` for the analytic model itself
SCENE = "file"  # the key of a user's MJCF in a table of `plant`
DECLARED = "setting"  # the key of a field's metadata
Check = Callable[[str, Any], Any]


@dataclass(frozen=True)
class RunSetting:
    """The declaration of one setting of a run.

    Attributes
    ----------
    help : str
        Its meaning, for the commands.
    unit : str
        Its unit, empty without one.
    check : Callable[[str, Any], Any]
        Returns the value of a setting of this name, or raises an `InputError`.
    of : Callable[[Mapping], Any], optional
        Makes the value that a table means, such as a table of a TOML file.
    table : Callable[[Any], Any], optional
        The inverse: a table of a value; other values stay as they are.
    flag : str, optional
        Its option, if this is not its name.
    option : mapping
        Other keywords of its option; ``type`` makes a value of one word. Empty for a setting that
        no command has.
    """

    help: str
    unit: str
    check: Check
    of: Callable[[Mapping[str, Any]], Any] | None
    table: Callable[[Any], Any] | None
    flag: str | None
    option: Mapping[str, Any]


def setting(
    check: Check,
    help: str,
    *,
    unit: str = "",
    of: Callable[[Mapping[str, Any]], Any] | None = None,
    table: Callable[[Any], Any] | None = None,
    flag: str | None = None,
    **option: Any,
) -> dict[str, RunSetting]:
    """The metadata of a field of `RunOptions`; see `RunSetting`."""
    return {DECLARED: RunSetting(help, unit, check, of, table, flag, MappingProxyType(option))}


def _any(name: str, value: Any) -> Any:
    return value


def _positive(name: str, value: Any) -> float:
    from softdyn.checks import number

    return number(name, value, above=0.0)


def _step(name: str, value: Any) -> float:
    from softdyn.checks import number

    return number(name, value, above=0.0, finite=False)


def _flag(name: str, value: Any) -> bool:
    from softdyn.checks import flag

    return flag(name, value)


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(name, "text", repr(value))
    return value


def _integrator(name: str, value: Any) -> Integrator:
    return integrator_of(value)


def _rig(name: str, value: Any) -> Rig | str:
    from softdyn.validation.twin.rig import rig_of

    rig_of(value)
    return value


def _around(name: str, value: Any) -> Surroundings:
    from softdyn.checks import instance
    from softdyn.safety import Surroundings

    return instance(name, value, Surroundings, "a Surroundings")


def _plant_of(table: Mapping[str, Any]) -> Any:
    from softdyn.toml_table import TomlTable
    from softdyn.validation.twin.plant_errors import PlantErrors

    if SCENE in table:  # its reader makes it
        return dict(table)
    return TomlTable(table, "plant").make(PlantErrors)


def _plant_table(value: Any) -> Any:
    from softdyn.copies import making_of
    from softdyn.validation.inputs import files_read
    from softdyn.validation.twin.plant_errors import PlantErrors
    from softdyn.validation.twin.state_map import MappedPlant

    if isinstance(value, PlantErrors):
        return vars(value)
    making = making_of(value)
    if not isinstance(value, MappedPlant) or making is None:
        return value
    path = Path(value.path)
    more = {name: one for name, one in making.named.items() if one is not None}
    others = sorted(files_read([path]) - {path.resolve()})
    return {SCENE: path, **more, **({"reads": others} if others else {})}


def _rig_table(value: Any) -> Any:
    from softdyn.validation.twin.rig import Rig

    if not isinstance(value, Rig):
        return value
    given = {name: one for name, one in vars(value).items() if one is not None}
    return given | {"plant": vars(value.plant)}


def _observer_table(value: Any) -> Any:
    from softdyn.controllers.registry import is_own
    from softdyn.validation.loop.provenance import modules_of

    if not isinstance(value, str) or not is_own(value):
        return value
    path, _, name = value.rpartition(":")
    return {"named": name, "file": Path(path), "modules": modules_of(path)}


def _name_table(value: str) -> str:
    from softdyn.validation.loop.provenance import name_shown

    return name_shown(value)


def _around_table(value: Surroundings) -> Any:
    return value.table


def _rig_of(table: Mapping[str, Any]) -> Rig:
    from softdyn.validation.twin.rig import Rig

    return Rig.of(table)


def _around_of(table: Mapping[str, Any]) -> Surroundings:
    from softdyn.safety import Surroundings

    return Surroundings.of(table)


def _number(check: Check) -> Callable[[str], float]:
    """Reads a word of a command line as a number that passes a check."""

    def read(word: str) -> float:
        found: float = check("value", float(word))
        return found

    return read


def _finite(name: str, value: Any) -> float:
    from softdyn.checks import number

    return number(name, value)


@dataclass(frozen=True, kw_only=True, eq=False)
class RunOptions:
    """The settings of a run: its arguments besides model, controller and reference.

    Attributes
    ----------
    duration, period : float, optional
        Length of the run, to the nearest plant step, and control period (s); the experiment's by
        default, 10 s and 2 ms without one. Where the period does not divide the duration, the last
        hold is shorter.
    timestep : float, optional
        Plant step (s), which must divide the period; by default the largest ≤ 0.5 ms. ``inf`` is
        one step per period.
    integrator : Integrator or str
        The twin's scheme.
    q0, v0 : np.ndarray, (nq,), (nv,), optional
        Initial state, within the joint limits; by default at rest in the configuration within the
        limits that is nearest to q = 0.
    contacts : bool
        Whether the plant's links can touch.
    friction : bool
        Whether the plant has the file's dry friction of joints, and of cables on their guides.
    plant : str, PlantErrors, MappedPlant, Plant or Callable[..., Twin], optional
        By default the twin. Otherwise ``"model"``, the analytic model itself, integrated by
        `softdyn.dynamics.integrators.ModelMotion`; the twin with some errors; a user's MJCF as a
        `softdyn.validation.Scene`, whose own contacts and friction hold, and its step if that
        divides the period; a `softdyn.validation.loop.plants.Plant`; or what makes the twin, called
        as `Twin` with the robot, timestep, contacts and friction.
    rig : Rig or str, optional
        The rig between controller and plant: None for an ideal one, ``"file"`` for that of the
        robot's file, or a `Rig`.
    observer : Observer or str, optional
        It estimates the state that the controller gets, from the rig's sensors: an
        `softdyn.estimation.Ekf`, an object of your own with ``step(t, measurements, u)``, or the
        words of `observation.make_observer`. The State has the estimate's `covariance`
        (2 nv, 2 nv), if there is one.
    surroundings : Surroundings, optional
        Obstacles around the robot: in the twin, and their reserve in the log. A controller keeps
        clear of them by its own `barriers`.
    name : str, optional
        Name of the controller in the log; its `name` or its class by default.
    """

    duration: float | None = field(default=None, metadata=setting(
        _positive, "length of the run", unit="s", metavar="S", type=_number(_positive),
    ))  # fmt: skip
    period: float | None = field(default=None, metadata=setting(
        _positive, "control period", unit="s", metavar="S", type=_number(_positive),
    ))  # fmt: skip
    timestep: float | None = field(default=None, metadata=setting(
        _step, "plant step, by default at most 0.0005", unit="s", metavar="S", type=_number(_step),
    ))  # fmt: skip
    integrator: Integrator | str = field(default=Integrator.IMPLICITFAST, metadata=setting(
        _integrator, "MuJoCo's scheme (default: %(default)s)",
        choices=tuple(scheme.value for scheme in Integrator),
    ))  # fmt: skip
    q0: Any = field(default=None, metadata=setting(
        _any, "initial joint positions, within their limits", unit="rad or m", metavar="Q",
        nargs="+", type=_number(_finite),
    ))  # fmt: skip
    v0: Any = field(default=None, metadata=setting(
        _any, "initial joint velocities", unit="rad/s or m/s", metavar="V", nargs="+",
        type=_number(_finite),
    ))  # fmt: skip
    contacts: bool = field(default=False, metadata=setting(
        _flag, "let the links touch", action="store_true",
    ))  # fmt: skip
    friction: bool = field(default=False, metadata=setting(
        _flag, "with the file's dry friction of joints, and of cables", action="store_true",
    ))  # fmt: skip
    plant: Any = field(default=None, metadata=setting(
        _any, "an MJCF that replaces the twin, or the word model for the analytic model",
        of=_plant_of, table=_plant_table, metavar="FILE",
    ))  # fmt: skip
    rig: Rig | str | None = field(default=None, metadata=setting(
        _rig, "with the rig of the robot's file; FILE changes it", of=_rig_of, table=_rig_table,
        nargs="?",
        const="file", metavar="FILE",
    ))  # fmt: skip
    observer: Observer | str | None = field(default=None, metadata=setting(
        _any, "estimate the state from the rig's sensors", table=_observer_table, nargs="?",
        const="", metavar="WHICH",
    ))  # fmt: skip
    surroundings: Surroundings | None = field(default=None, metadata=setting(
        _around, "obstacles around the robot, a TOML file", of=_around_of, table=_around_table,
        flag="--obstacles",        metavar="FILE",
    ))  # fmt: skip
    name: str | None = field(default=None, metadata=setting(
        _text, "the controller's name", table=_name_table,
    ))  # fmt: skip

    def __post_init__(self) -> None:
        for name, declared in declarations().items():
            value = getattr(self, name)
            if value is not None or default_of(name) is not None:
                object.__setattr__(self, name, declared.check(name, value))

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> RunOptions:
        """The settings from a table, such as a TOML file's, or from the keywords of a call.

        A table of `plant` becomes a `PlantErrors`, one of `rig` or `surroundings` that object.

        Raises
        ------
        InputError
            An unknown setting; the error names the one that may be meant. Also for a value that its
            object refuses.
        """
        from softdyn.toml_table import TomlTable

        declared = declarations()
        values = TomlTable(given, "options").rest(declared)
        for name, value in values.items():
            make = declared[name].of
            if make is not None and isinstance(value, Mapping):
                values[name] = make(value)
        return cls(**values)

    @property
    def table(self) -> dict[str, Any]:
        """The settings by name, of which `of` makes them again; objects of a user stay as given."""
        return {
            name: declared.table(value) if declared.table and value is not None else value
            for name, declared in declarations().items()
            for value in [getattr(self, name)]
        }


def declarations() -> dict[str, RunSetting]:
    """The declaration of every setting by its name."""
    return {part.name: part.metadata[DECLARED] for part in fields(RunOptions)}


def default_of(name: str) -> Any:
    """The default of a setting."""
    return next(part.default for part in fields(RunOptions) if part.name == name)


def make_forces(
    names: Iterable[str], numbers: Mapping[str, Any], find: Callable[[str], Callable[[], Any]]
) -> list[Any]:
    """Forces of a user's own, each built as ``CLASS()``.

    Parameters
    ----------
    names : iterable of str
        ``FILE.py:CLASS`` of each.
    numbers : mapping
        Numbers of them that are set, by ``NAME.FIELD`` with the name of the force.
    find : Callable[[str], Callable[[], Any]]
        Gives the class of each name.

    Raises
    ------
    InputError
        A class that cannot be made, and a number of a force or a field that is not there.
    """
    from softdyn.controllers.registry import one_line_errors
    from softdyn.dynamics.forces import check_forces, with_number

    found = []
    for name in names:
        with one_line_errors(name, "a force"):
            found.append(find(name)())
    found = [*check_forces(found)]
    for place, value in numbers.items():
        found = with_number(found, place, value)
    return found
