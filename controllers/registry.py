"""Controllers by name: the paper's, ours, and a user's class as FILE.py:CLASS."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

from softdyn import InputError, SoftdynError, SoftModel
from softdyn.checks import did_you_mean, instance
from softdyn.controllers.clf_qp import ClfQp
from softdyn.controllers.gains import from_table
from softdyn.controllers.id_clf_qp import IdClfQp
from softdyn.controllers.impedance import Impedance, UnderactuatedImpedance
from softdyn.controllers.impedance_qp import ImpedanceQp
from softdyn.controllers.law import NamedLaw
from softdyn.controllers.mpc import Mpc
from softdyn.controllers.soft_id_clf_qp import SoftIdClfQp
from softdyn.controllers.staged import Best
from softdyn.copies import keep_making, making_of
from softdyn.exceptions import own_frames

# A new controller of the package gets a line here. All else that commands, tables and figures ask
# of it are attributes of its class.
_LAWS: tuple[type[NamedLaw], ...] = (
    SoftIdClfQp,
    IdClfQp,
    ClfQp,
    Impedance,
    UnderactuatedImpedance,
    ImpedanceQp,
    Best,
    Mpc,
)
# command-line name → class
LAWS: dict[str, Any] = {law.name: law for law in _LAWS}
# those that need gains on a robot without published ones
CONTROLLERS: dict[str, Any] = {name: law for name, law in LAWS.items() if law.needs_gains}
BEYOND: dict[str, Callable[..., Any]] = {
    name: law.factory or law for name, law in LAWS.items() if not law.needs_gains
}


def in_table() -> tuple[str, ...]:
    """The names of the controllers of the benchmark, in its order."""
    shown = [law for law in LAWS.values() if law.order is not None]
    return tuple(law.name for law in sorted(shown, key=lambda law: law.order))


def label_of(name: str) -> str:
    """A controller's name in tables and figures; any other name is unchanged."""
    return (name in LAWS and LAWS[name].label) or name


def keys_of(name: str) -> tuple[str, ...]:
    """The keys of a table of parameters of a controller of the package."""
    law = LAWS[name]
    own = () if law.parameter_class is None else fields(law.parameter_class)
    return (*(field.name for field in own), *law.options)


def find_controller(name: str) -> Callable[..., Any]:
    """The class of a command-line name, or of FILE.py:CLASS.

    Raises
    ------
    InputError
        If there is no such name, file or class, or if the file cannot be imported.
    """
    if instance("controller", name, str, "a name, or FILE.py:CLASS") in CONTROLLERS:
        return CONTROLLERS[name]
    if name in BEYOND:
        return BEYOND[name]
    file, colon, kind = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        known = [*LAWS]
        expected = f"{', '.join(known)} or FILE.py:CLASS"
        raise InputError("controller", expected, did_you_mean(name, known))
    module = _load(file)
    cls = getattr(module, kind, None)
    if not callable(cls):
        known = [
            name for name, value in vars(module).items()
            if callable(value) and getattr(value, "__module__", "") == module.__name__
        ]  # fmt: skip
        listed = f": {', '.join(known)}" if known else ""
        raise InputError("controller", f"a class in {file}{listed}", did_you_mean(kind, known))
    return cls


def make_controller(
    name: str,
    model: SoftModel,
    parameters: Any = None,
    cls: Callable[..., Any] | None = None,
    source: str | None = None,
    **more: Any,
) -> Any:
    """A controller for one run, by its name.

    Parameters
    ----------
    name : str
        A name as for `find_controller`.
    model : SoftModel
    parameters : Any
        Second argument of the class, if not None. For a controller of the package it may be a table
        with the class's `options` and with fields of its `parameter_class`; those of `Gains`
        replace the published ones.
    cls : Callable, optional
        The class of the name, if it is known already.
    source : str, optional
        The file that the parameters are from, which an error about them names.
    more : Any
        Further arguments of the class by their names, such as its `tasks`.

    Raises
    ------
    InputError
        If there is no such controller, if it refuses the parameters, or if a user's class raises an
        error.
    """
    make = find_controller(name) if cls is None else cls
    where = nullcontext() if source is None else _errors_of(source, more)
    with where, one_line_errors(name, "a controller"):
        arguments, options = _arguments(name, model, parameters)
        made = make(model, *arguments, **options, **more)
    if making_of(made) is None:
        keep_making(made, make, (model, *arguments), {**options, **more})
    return made


def _arguments(name: str, model: SoftModel, parameters: Any) -> tuple[tuple[Any, ...], Any]:
    """The arguments of a class besides the model, from a table of its parameters."""
    if parameters is None:
        return (), {}
    law = LAWS.get(name)
    if not isinstance(parameters, Mapping) or law is None:
        return (parameters,), {}
    rest = {key: value for key, value in parameters.items() if key not in law.options}
    options = {key: value for key, value in parameters.items() if key in law.options}
    gains: Any = rest or None
    if law.needs_gains:
        gains = from_table(model, law.published, rest, law.options)
    return (gains,), options


@contextmanager
def _errors_of(source: str, others: Collection[str]) -> Iterator[None]:
    """Add the file of a controller's parameters to an error about them, not about `others`."""
    try:
        yield
    except InputError as error:
        if error.name in others or is_own(error.name):  # or it says the line of the user's code
            raise
        raise error.about(f"{source}: {error.name}") from None


@contextmanager
def one_line_errors(name: str, expected: str) -> Iterator[None]:
    """Turn errors of the user's code in FILE.py into an `InputError` that names the line.

    Ctrl-C passes unchanged, and so do errors of softdyn, of its own controllers, and of the user's
    code while it runs (see `softdyn.exceptions.own_code_errors`).
    """
    try:
        yield
    except (SoftdynError, GeneratorExit, KeyboardInterrupt):
        raise
    except BaseException as error:  # a user's code may raise anything
        file, own, _ = name.partition(".py")
        if not own or own_frames(error) is not None:
            raise
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if Path(frame.filename).stem == Path(file).name]
        line = f" in line {lines[-1]}" if lines else ""
        raise InputError(name, expected, f"{type(error).__name__}{line}: {error}") from error


def is_own(name: str) -> bool:
    """Whether a controller's name is a user's FILE.py:CLASS."""
    return ".py:" in name


class _Loaded(NamedTuple):
    """A user's file that was imported: its content, its module, modules of the files beside it."""

    content: bytes
    module: Any
    beside: dict[str, Any]

    @property
    def current(self) -> bool:
        """Whether the modules of the files beside it are still those that it could import."""
        return all(sys.modules.get(name) is module for name, module in self.beside.items())


_LOADED: dict[Path, _Loaded] = {}


def _load(path: str) -> Any:
    """Import a Python file, which may import its neighbours; the same module while it is unchanged.

    Pickle finds a class in `sys.modules` by the file's name. So the latest of several files of one
    name stands there, but never instead of a module that was imported otherwise.
    """
    file = Path(path).resolve()
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if not file.is_file() or spec is None or spec.loader is None:
        raise InputError("controller", "an existing Python file", path)
    before, content, kept = sys.modules.get(file.stem), file.read_bytes(), _LOADED.get(file)
    free = before is None or any(before is one.module for one in _LOADED.values())
    if kept is not None and kept.content == content and kept.current:
        if free:
            sys.modules[file.stem] = kept.module
        return kept.module
    if str(file.parent) not in sys.path:
        sys.path.insert(0, str(file.parent))
    module = importlib.util.module_from_spec(spec)
    if free:
        sys.modules[file.stem] = module  # dataclasses look up their module here
    with one_line_errors(path, "a Python file that can be imported"):
        spec.loader.exec_module(module)
    names = [one.stem for one in file.parent.glob("*.py") if one != file]
    near = {name: sys.modules[name] for name in names if name in sys.modules}
    _LOADED[file] = _Loaded(content, module, near)
    return module
