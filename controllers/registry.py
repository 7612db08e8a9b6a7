"""Controllers by name: the paper's, ours, and a user's class as FILE.py:CLASS."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftdynError
from softdyn.controllers.clf_qp import ClfQp
from softdyn.controllers.id_clf_qp import IdClfQp
from softdyn.controllers.impedance import Impedance, UnderactuatedImpedance
from softdyn.controllers.impedance_qp import ImpedanceQp
from softdyn.controllers.mpc import Mpc
from softdyn.controllers.soft_id_clf_qp import SoftIdClfQp
from softdyn.controllers.staged import Staged, best

# command-line name → class; these take `softdyn.controllers.Gains`
CONTROLLERS: dict[str, Callable[..., Any]] = {
    controller.name: controller
    for controller in (SoftIdClfQp, IdClfQp, ClfQp, Impedance, UnderactuatedImpedance, ImpedanceQp)
}
# beyond the paper; neither needs gains
BEYOND: dict[str, Callable[..., Any]] = {Staged.name: best, Mpc.name: Mpc}


def find_controller(name: str) -> Callable[..., Any]:
    """The class behind a command-line name, or behind FILE.py:CLASS.

    Raises
    ------
    InputError
        No such name, file or class, or a file that cannot be imported.
    """
    if name in CONTROLLERS:
        return CONTROLLERS[name]
    if name in BEYOND:
        return BEYOND[name]
    file, colon, kind = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        expected = f"{', '.join([*CONTROLLERS, *BEYOND])} or FILE.py:CLASS"
        raise InputError("controller", expected, repr(name))
    cls = getattr(_load(file), kind, None)
    if not callable(cls):
        raise InputError("controller", f"a class in {file}", repr(kind))
    return cls


def own_error(name: str, expected: str, error: Exception) -> InputError:
    """What the code of FILE.py (or FILE.py:CLASS) raised, and in which line of it."""
    file = name.partition(".py")[0] + ".py"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename.endswith(file)]
    line = f" in line {frames[-1].lineno}" if frames else ""
    return InputError(name, expected, f"{type(error).__name__}{line}: {error}")


@contextmanager
def blamed(name: str, expected: str) -> Iterator[None]:
    """What a user's own controller raises inside becomes one line, see `own_error`."""
    try:
        yield
    except SoftdynError:
        raise
    except Exception as error:  # a user's code may raise anything
        if not is_own(name):
            raise
        raise own_error(name, expected, error) from error


def is_own(name: str) -> bool:
    """Whether a controller's name is a user's FILE.py:CLASS."""
    return ".py:" in name


def _load(path: str) -> Any:
    """The module in a Python file, which may import its neighbours."""
    file = Path(path).resolve()
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if not file.is_file() or spec is None or spec.loader is None:
        raise InputError("controller", "an existing Python file", path)
    if str(file.parent) not in sys.path:
        sys.path.insert(0, str(file.parent))
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(file.stem, module)  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # a user's code may raise anything
        raise own_error(path, "a Python file that can be imported", error) from error
    return module
