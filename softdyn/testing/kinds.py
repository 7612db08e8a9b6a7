"""The kind of a user's class, by the methods that it has."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.testing.controllers import check_controller
from softdyn.testing.forces import check_force
from softdyn.testing.functions import check_barrier, check_reference, check_task
from softdyn.testing.observers import check_observer
from softdyn.testing.report import Conformance
from softdyn.testing.rigs import PLANT, check_driver, check_plant
from softdyn.validation.bench.driver import METHODS

KINDS: dict[str, Callable[..., Conformance]] = {
    "controller": check_controller,
    "plant": check_plant,
    "driver": check_driver,
    "task": check_task,
    "barrier": check_barrier,
    "observer": check_observer,
    "reference": check_reference,
    "force": check_force,
}
# the first kind whose methods are all there; a callable without them is told by its parameters
BY_METHODS = {
    "driver": METHODS, "plant": PLANT, "observer": ("step",), "task": ("evaluate",)
}  # fmt: skip


def kind_of(subject: Any) -> str:
    """The kind of a class or an object, one of `KINDS`.

    Raises
    ------
    InputError
        If its methods fit no kind.
    """
    for kind, methods in BY_METHODS.items():
        if all(callable(getattr(subject, name, None)) for name in methods):
            return kind
    call = getattr(subject, "__call__", None)  # noqa: B004
    if inspect.isclass(subject):
        call = vars(subject).get("__call__") or getattr(subject, "__call__", None)  # noqa: B004
    own = "__call__" in {name for cls in _classes(subject) for name in vars(cls)}
    if call is not None and own:
        names = [name for name in inspect.signature(call).parameters if name != "self"]
        if len(names) == 3:
            return "force"
        if len(names) >= 2:
            return "controller"
        if hasattr(subject, "rate") or _annotated(subject, "rate"):
            return "barrier"
        return "reference"
    expected = "methods of a " + ", ".join(KINDS)
    raise InputError("class", expected, getattr(subject, "__name__", type(subject).__name__))


def check(subject: Any, model: SoftModel, kind: str | None = None, **more: Any) -> Conformance:
    """RuleResult a user's class as one of `KINDS`, by default as what its methods say.

    Parameters
    ----------
    subject : Any
        A class that is built as ``CLASS(model)``, a function that builds one, or an object.
    model : SoftModel
        The robot.
    kind : str, optional
        One of `KINDS`.
    **more : Any
        Further arguments of the kind's function.

    Raises
    ------
    InputError
        For another kind, or a class whose methods fit none.
    """
    kind = kind_of(subject) if kind is None else kind
    if kind not in KINDS:
        raise InputError("kind", " or ".join(KINDS), kind)
    return KINDS[kind](subject, model, **more)


def _classes(subject: Any) -> tuple[type, ...]:
    cls = subject if inspect.isclass(subject) else type(subject)
    return tuple(one for one in cls.__mro__ if one is not object)


def _annotated(subject: Any, name: str) -> bool:
    """Whether a class states an attribute, or sets it in its constructor."""
    for cls in _classes(subject):
        made = cls.__dict__.get("__init__")
        code = getattr(made, "__code__", None)
        if name in inspect.get_annotations(cls) or (code is not None and name in code.co_names):
            return True
    return False
