"""The controllers that a page offers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from softdyn import SoftModel
from softdyn.controllers import registry
from softdyn.controllers.safety_filter import with_barriers
from softdyn.safety import Surroundings

Make = Callable[[SoftModel], Any]


def menu_of(
    model: SoftModel, own: Mapping[str, Make] | None = None, around: Surroundings | None = None
) -> dict[str, Make]:
    """Controllers by name: a user's own, and the registry's, which keep clear of obstacles."""
    ours = {**registry.CONTROLLERS, **registry.BEYOND} if model.nu else {}
    known = {name: with_barriers(make, around) for name, make in ours.items()}
    return {**(own or {}), **{k: v for k, v in known.items() if k not in (own or {})}}


def make_law(name: str, make: Make, model: SoftModel, **arguments: Any) -> tuple[Any, bool]:
    """A controller of the menu, and whether it is ours."""
    law = registry.make_controller(name, model, cls=make, **arguments)
    return law, type(getattr(law, "inner", law)).__module__.startswith("softdyn.")
