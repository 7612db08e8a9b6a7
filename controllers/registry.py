"""Controllers by name: the paper's, ours, and a user's class as FILE.py:CLASS."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftdynError, SoftModel
from softdyn.checks import did_you_mean, instance
from softdyn.controllers.clf_qp import ClfQp
from softdyn.controllers.gains import from_table
from softdyn.controllers.id_clf_qp import IdClfQp
from softdyn.controllers.impedance import Impedance, UnderactuatedImpedance
from softdyn.controllers.impedance_qp import ImpedanceQp
from softdyn.controllers.mpc import Mpc
from softdyn.controllers.soft_id_clf_qp import SoftIdClfQp
from softdyn.controllers.staged import Staged, best
from softdyn.exceptions import own_frames

# command-line name → class; these take `softdyn.controllers.Gains`
CONTROLLERS: dict[str, Any] = {
    controller.name: controller
    for controller in (SoftIdClfQp, IdClfQp, ClfQp, Impedance, UnderactuatedImpedance, ImpedanceQp)
}
# not in the paper; neither needs gains
LINK = ("lag", "delay", "friction")  # of their actuators (s), and of their cables
BEYOND: dict[str, Callable[..., Any]] = {Staged.name: best, Mpc.name: Mpc}


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
        known = [*CONTROLLERS, *BEYOND]
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
        Second argument of the class, if not None. For a controller of the paper it is a table with
        its `options` and with fields of `Gains`, which replace the published ones. A table for
        ``best`` or ``mpc`` may also have ``lag``, ``delay`` and ``friction``.
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
    where = nullcontext() if source is None else _errors_of(source)
    with where, one_line_errors(name, "a controller"):
        if parameters is None:
            return make(model, **more)
        paper = name in CONTROLLERS
        if not isinstance(parameters, Mapping) or not (paper or name in BEYOND):
            return make(model, parameters, **more)
        own = CONTROLLERS[name].options if paper else LINK
        rest = {key: value for key, value in parameters.items() if key not in own}
        options = {key: value for key, value in parameters.items() if key in own}
        gains = from_table(model, name, rest, own) if paper else rest or None
        return make(model, gains, **options, **more)


@contextmanager
def _errors_of(source: str) -> Iterator[None]:
    """Add the file of a controller's parameters to an error about them."""
    try:
        yield
    except InputError as error:
        if is_own(error.name):  # it says which line of the user's code
            raise
        raise InputError(f"{source}: {error.name}", error.expected, error.got) from None


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


def _load(path: str) -> Any:
    """Import a Python file, which may import its neighbours."""
    file = Path(path).resolve()
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if not file.is_file() or spec is None or spec.loader is None:
        raise InputError("controller", "an existing Python file", path)
    if str(file.parent) not in sys.path:
        sys.path.insert(0, str(file.parent))
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(file.stem, module)  # dataclasses look up their module here
    with one_line_errors(path, "a Python file that can be imported"):
        spec.loader.exec_module(module)
    return module
