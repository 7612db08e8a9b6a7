"""Hostile inputs: states and references with numbers that no sensor should send."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from softdyn import Ellipse, Reference, SoftdynError, SoftModel, State

NAN, INF, HUGE, LARGE, TINY = np.nan, np.inf, 1e300, 1e150, 5e-324
VALUES = (NAN, INF, -INF, HUGE, -HUGE, LARGE, 1e30, 1e8, -1e8, 0.0, TINY, -TINY, 1e-310, 1e-30)
# The fields of a State that a controller may read, beyond (q, v).
FIELDS = ("v", "M", "bias", "K", "D", "B", "h", "J", "Jdot", "y", "ydot")


def references() -> dict[str, Reference]:
    """Every finite hostile value in each part of a reference, and some combinations."""
    finite = [value for value in VALUES if np.isfinite(value)]
    found = {}
    for name, value in product(("y", "ydot", "yddot"), finite):
        parts = {part: np.zeros(3) for part in ("y", "ydot", "yddot")}
        parts[name] = np.full(3, value)
        found[f"reference {name} = {value:g}"] = Reference(**parts)
    found["reference, huge and tiny"] = Reference(
        *np.array([[HUGE, TINY, 0], [0, -HUGE, 1], [TINY, 0, HUGE]])
    )
    found["a fast and large ellipse"] = Ellipse(a=1e3, b=1e3, c=1e3, omega=1e6)(0.3)
    return found


def states(model: SoftModel, seed: int = 0) -> Iterator[tuple[str, State]]:
    """States that `model.state` accepts: far, fast, at the limits, straight, at rest."""
    rng = np.random.default_rng(seed)
    far, signs = rng.uniform(-1, 1, model.nv), rng.choice([-1.0, 1.0], model.nv)
    lower = np.where(np.isfinite(model.lower), model.lower, -1.0)
    upper = np.where(np.isfinite(model.upper), model.upper, 1.0)
    places = {"q = 0": 0 * far, "q denormal": TINY * signs, "lower limits": lower}
    places |= {"upper limits": upper, "inside": 0.5 * (lower + upper) + 0.2 * far * (upper - lower)}
    places |= {f"q ~ {size:g}": size * far for size in (50, 1e8, LARGE, HUGE)}
    speeds = {"at rest": 0.0, "v denormal": TINY, "v ~ 1e-310": 1e-310}
    speeds |= {f"v ~ {size:g}": size for size in (1.0, 1e2, 1e4, 1e8, 1e30, 1e100, 1e155, HUGE)}
    for (place, coordinates), (motion, speed) in product(places.items(), speeds.items()):
        try:
            with np.errstate(all="ignore"):  # the model's own arithmetic may overflow
                state = model.state(model.configuration(coordinates), speed * signs)
        except SoftdynError:
            continue
        yield f"{place}, {motion}", state


def forged(state: State) -> Iterator[tuple[str, State]]:
    """Copies of `state` with a hostile value in one entry, or in all entries, of each field."""
    for name, value, everywhere in product(FIELDS, VALUES, (False, True)):
        yield (
            f"{'all of ' if everywhere else ''}{name} = {value:g}",
            forge(state, {name: (value, everywhere)}),
        )


def forge(state: State, changes: dict[str, tuple[float, bool]]) -> State:
    """A copy of `state` with `changes`: for a field, the value and whether all entries take it."""
    fields: dict[str, Any] = {}
    for name, (value, everywhere) in changes.items():
        fields[name] = np.array(getattr(state, name))
        if everywhere:
            fields[name][...] = value
        else:
            fields[name].flat[0] = value
    return replace(state, **fields)


def degenerate(state: State) -> Iterator[tuple[str, State]]:
    """Degenerate states: J, B or M zero, of rank one, nearly of rank one, or M negative."""
    J, B, M = state.J, state.B, state.M
    yield "J = 0", replace(state, J=0 * J, Jdot=0 * J)
    yield "J of rank one", replace(state, J=np.outer([1.0, 2.0, 3.0], J[0]))
    yield "J nearly of rank one", replace(state, J=np.outer([1.0, 2.0, 3.0], J[0]) + 1e-13 * J)
    yield "B = 0", replace(state, B=0 * B)
    yield "B of rank one", replace(state, B=np.outer(B[:, 0], np.arange(1.0, B.shape[1] + 1)))
    yield "B without its first column", replace(state, B=B * (np.arange(B.shape[1]) > 0))
    yield "M = 0", replace(state, M=0 * M)
    yield "M of rank one", replace(state, M=np.outer(M[0], M[0]))
    yield "M negative", replace(state, M=-M)
    yield "no damping", replace(state, D=0 * state.D)
