"""A run as plain data, and back: its settings, its controller and its reference.

A value is stated by the call that makes it: ``{"class": "softdyn.controllers.Gains", "with": {…}}``
for a class or function of softdyn, ``{"class": "Law", "file": …, "with": {…}}`` for one of a user's
own file, ``{"model": "robot"}`` for the controller's model, and with the rig's motors and sensors
``"rig"``. All else is named as ``{"other": …}``; it cannot be made again.
"""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import (
    SoftModel,
    actuation,
    controllers,
    dynamics,
    estimation,
    references,
    safety,
    sensing,
    tasks,
)
from softdyn.controllers.registry import find_controller
from softdyn.copies import keep_making, making_of
from softdyn.tasks.marks import recorded_targets
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.provenance import file_of, modules_of
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.twin.rig import rig_of

ROOMS = (references, controllers, tasks, safety, estimation, sensing, actuation, dynamics)
OTHERS: dict[str, Callable[..., Any]] = {
    "softdyn.tasks.recorded_targets": recorded_targets, "softdyn.validation.Experiment": Experiment,
}  # fmt: skip
ROBOT, RIG = "robot", "rig"
LARGE = 10_000  # numbers of an array; a network's weights belong into a file
DEEPEST = 12  # objects in objects, of which some may contain each other
LARGEST = 2**63


class NotRecorded:
    """A part of a run that its record names, but cannot make again.

    Parameters
    ----------
    name : str
        Its class, and why it cannot be made.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def __repr__(self) -> str:
        return f"a part that the record cannot make again: {self.name}"


class Statement:
    """Writes the parts of a run as plain data.

    Parameters
    ----------
    model : SoftModel
        The controller's model.
    options : RunOptions
        The run's settings.
    """

    def __init__(self, model: SoftModel, options: RunOptions) -> None:
        self._model = model
        rig = rig_of(options.rig)
        rigged = model.robot if rig is None else rig.robot(model.robot)
        self._models = {model.robot.digest: ROBOT} | {rigged.digest: RIG}
        self._models[model.robot.digest] = ROBOT
        self._depth = 0

    def settings(self, options: RunOptions) -> dict[str, Any]:
        """The settings, by their names; tables as `RunOptions.of` takes them."""
        return {name: self.of(value) for name, value in options.table.items()}

    def of(self, value: Any) -> Any:
        """A value as plain data."""
        if value is None or isinstance(value, bool | int):
            return value if value is None or abs(value) < LARGEST else {"other": "a large integer"}
        if isinstance(value, str):
            return str(value)
        if isinstance(value, float):
            return value if math.isfinite(value) else {"number": str(value)}
        if isinstance(value, np.ndarray | np.generic):
            large = value.size > LARGE
            shape = f"an array of shape {value.shape}"
            return {"other": shape} if large else self.of(value.tolist())
        if isinstance(value, Path):
            return file_of(value)
        if isinstance(value, Mapping):
            return {str(key): self.of(one) for key, one in value.items()}
        if isinstance(value, list | tuple):
            return [self.of(one) for one in value]
        if isinstance(value, Enum):
            return {"class": public_name(type(value)), "with": {"value": self.of(value.value)}}
        if isinstance(value, SoftModel):  # a protocol: this asks for each of its members
            return self._of_model(value)
        self._depth += 1
        try:
            return self._made(value) if self._depth < DEEPEST else {"other": _title(value)}
        except Exception:  # a property of a user's class may raise anything when it is read
            return {"other": _title(value)}
        finally:
            self._depth -= 1

    def _of_model(self, model: SoftModel) -> dict[str, Any]:
        found = self._models.get(model.robot.digest)
        return {"other": "the model of another robot"} if found is None else {"model": found}

    def _made(self, value: Any) -> dict[str, Any]:
        """An object, by the call that made it."""
        if isinstance(value, partial) or inspect.isroutine(value) or isinstance(value, type):
            return self._routine(value)
        making = making_of(value)
        maker = type(value) if making is None else making.maker
        given, unknown = self._arguments(value, maker)
        name = public_name(maker)
        if name is not None and not unknown:
            return {"class": name, "with": self.of(given)}
        if name is not None or type(value).__module__.partition(".")[0] == "softdyn":
            return {"other": _title(value)}
        return self._own(
            maker, {"with": self.of(given)} | ({"unknown": unknown} if unknown else {})
        )

    def _arguments(self, value: Any, maker: Any) -> tuple[dict[str, Any], list[str]]:
        """The arguments by name that differ from the defaults, and those that nobody kept."""
        making = making_of(value)
        try:
            signature = _signature(maker)
        except (TypeError, ValueError):
            return {}, ["the arguments"]
        if making is not None:
            bound = signature.bind(*making.arguments, **making.named).arguments
        elif is_dataclass(value):
            bound = {
                field.name: getattr(value, field.name) for field in fields(value) if field.init
            }
        else:
            named = [n for n in signature.parameters if hasattr(value, n) or n == "model"]
            bound = {n: getattr(value, n, self._model) for n in named}
        given, unknown = dict[str, Any](), list[str]()
        for name, parameter in signature.parameters.items():
            if parameter.kind is parameter.VAR_KEYWORD:
                given |= bound.get(name, {})
            elif parameter.kind is parameter.VAR_POSITIONAL:
                unknown += [name] if bound.get(name) else []
            elif name not in bound:
                if making is None:
                    unknown.append(name)
            elif not _same(bound[name], parameter.default):
                given[name] = bound[name]
        return given, unknown

    def _routine(self, value: Any) -> dict[str, Any]:
        """A function of a user's file."""
        name = getattr(value, "__qualname__", "")
        if public_name(value) is not None or not name.isidentifier() or inspect.isbuiltin(value):
            return {"other": _title(value)}
        return self._own(value, {})

    def _own(self, maker: Any, more: dict[str, Any]) -> dict[str, Any]:
        """A class or a function of a user's file."""
        path = _file_of(maker)
        if path is None or not maker.__qualname__.isidentifier():
            return {"other": _title(maker)} | more
        key = "function" if inspect.isroutine(maker) else "class"
        file = file_of(path)
        return {key: maker.__qualname__, "file": file, "modules": modules_of(path)} | more


@lru_cache(64)
def _signature(maker: Any) -> inspect.Signature:
    """The signature of a class or a function; a sweep's cases have few of them."""
    return inspect.signature(maker)


def _same(value: Any, default: Any) -> bool:
    """Whether a value is the default; a number or text from another process is another object."""
    plain = isinstance(value, str | int | float) and type(value) is type(default)
    return value is default or (plain and bool(value == default))


def public_name(maker: Any) -> str | None:
    """The name of a class or function of softdyn from which `Remaking` finds it again."""
    for name, known in OTHERS.items():
        if known is maker:
            return name
    name = getattr(maker, "__qualname__", "")
    found = (room for room in ROOMS if name.isidentifier() and getattr(room, name, None) is maker)
    return next((f"{room.__name__}.{name}" for room in found), None)


def _title(value: Any) -> str:
    """The class or function of a value."""
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__}.{named.__qualname__}"


def _file_of(maker: Any) -> str | None:
    """The Python file of a class or a function, by its code: module names repeat."""
    own = [maker, *vars(maker).values()]
    codes = [one.__code__.co_filename for one in own if hasattr(one, "__code__")]
    codes.append(getattr(sys.modules.get(maker.__module__), "__file__", None) or "")
    return next((path for path in codes if os.path.isfile(path)), None)


# -- from plain data -------------------------------------------------------------------------------


class Remaking:
    """Makes the parts of a run from the plain data that a `Statement` wrote.

    Parameters
    ----------
    models : mapping
        The models by `ROBOT` and `RIG`.
    find : Callable[[Mapping], str]
        Finds a file of a record, or raises an `InputError`.

    Attributes
    ----------
    assumed : list of str
        The classes that are made without arguments that nobody kept.
    """

    def __init__(
        self, models: Mapping[str, SoftModel], find: Callable[[Mapping[str, Any]], str]
    ) -> None:
        self._models, self._find, self.assumed = models, find, list[str]()

    def of(self, data: Any) -> Any:
        """The value that plain data states; a `NotRecorded` where it cannot be made.

        Raises
        ------
        InputError
            A file is missing, or a class refuses its arguments.
        """
        if isinstance(data, list):
            return [self.of(one) for one in data]
        if not isinstance(data, Mapping):
            return data
        if set(data) == {"number"}:
            return float(data["number"])
        if set(data) == {"model"}:
            return self._models[data["model"]]
        if "other" in data:
            return NotRecorded(data["other"])
        if "sha256" in data:
            return self._find(data)
        if "named" in data:
            return f"{self._find(data['file'])}:{data['named']}"
        if "function" in data:
            return self._own(data, data["function"])
        if "class" in data and "with" in data:
            return self._made(data)
        return {key: self.of(one) for key, one in data.items()}

    def _made(self, data: Mapping[str, Any]) -> Any:
        name, given = data["class"], {key: self.of(one) for key, one in data["with"].items()}
        missing = next((one for one in given.values() if isinstance(one, NotRecorded)), None)
        if missing is not None:
            return NotRecorded(f"{name} of {missing.name}")
        if "file" not in data:
            maker = _public(name)
            if maker is None:
                return NotRecorded(f"{name}, which this version of softdyn does not have")
            return maker(**{key: _tupled(one) for key, one in given.items()})
        maker = self._own(data, name)
        if isinstance(maker, NotRecorded):
            return maker
        if data.get("unknown"):
            self.assumed.append(f"{name} is made without {', '.join(data['unknown'])}")
        try:
            made = maker(**given)
        except TypeError as error:
            return NotRecorded(f"{name}: {error}")
        if making_of(made) is None:
            keep_making(made, maker, (), given)
        return made

    def _own(self, data: Mapping[str, Any], name: str) -> Any:
        """A class or a function of a user's file."""
        path = self._find(data["file"])
        main = sys.modules["__main__"]
        if os.path.realpath(getattr(main, "__file__", None) or "") == os.path.realpath(path):
            return getattr(main, name)  # an import would run the program again
        return find_controller(f"{path}:{name}")


def _public(name: str) -> Any:
    """The class or function of a name that `public_name` gave; None if there is none."""
    if name in OTHERS:
        return OTHERS[name]
    room, _, last = name.rpartition(".")
    return next((getattr(one, last, None) for one in ROOMS if one.__name__ == room), None)


def _tupled(value: Any) -> Any:
    """Lists as tuples, as the frozen classes of softdyn keep them."""
    return tuple(_tupled(one) for one in value) if isinstance(value, list) else value
