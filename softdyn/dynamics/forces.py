"""Forces of one's own: a joint force F(q, q̇) that a user adds to a model.

    class Drag:
        name = "drag"

        def __call__(self, model, q, v):
            return -0.1 * v

    wet = softdyn.load("finger").with_forces(Drag())

F stands on the right side of the dynamics, M q̈ + h = B u with h = C q̇ + D q̇ + K + g - F. It acts
in every term that a `TreeModel` or a `ForceBalance` computes, and so in all that uses them.

Each call is checked here. A force gets copies of q and v that it cannot write to.
"""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from softdyn.checks import array, did_you_mean, instances, number
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import ForceError, InputError, one_line

# Central differences have an error of STEP² F''' / 6 and the rounding 1e-16 |F| / STEP. Ten times
# less, or more, costs a factor of ten or a hundred in accuracy.
STEP = 1e-6


class Force(Protocol):
    """A joint force of one's own: any class with a name and this call meets the contract.

    A force depends on its arguments and its own fields alone. It has no memory and no time. It can
    be copied and pickled. Two methods are optional:

    - ``derivatives(model, q, v) -> (by_q, by_v)``: ∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n). Without it they
      are central differences with a step of 1e-6 (rad, m; per second) along ``model.integrate``.
    - ``energy(model, q) -> float``: a potential (J) with F = -∂energy/∂q at q̇ = 0, or None.

    Attributes
    ----------
    name : str
        Its name. Forces of one model have different names.
    """

    name: str

    def __call__(self, model: SoftModel, q: np.ndarray, v: np.ndarray, /) -> Any:
        """F (n,) in the order of v (N m, N).

        Parameters
        ----------
        model : SoftModel
            The robot without its own forces. For a robot with mimic joints, and for a reduced one,
            it is the tree with all joints.
        q, v : ndarray, (nq,), (n,)
            Configuration and velocity, read-only.
        """


def check_forces(forces: Any) -> tuple[Force, ...]:
    """The forces of a model as a tuple.

    Raises
    ------
    InputError
        For a class in place of an object, for an object without a name or a call, and for two
        forces of one name.
    """
    found: tuple[Any, ...] = instances("forces", forces, object, "a force")
    names: list[str] = []
    for k, force in enumerate(found):
        place = f"forces[{k}]"
        if isinstance(force, type):
            raise InputError(place, "an object", f"the class {force.__name__}")
        name = getattr(force, "name", None)
        if not callable(force):
            raise InputError(place, "an object with __call__(model, q, v)", repr(force))
        if not isinstance(name, str) or not name:
            raise InputError(f"{place}.name", "a name", repr(name))
        if name in names:
            raise InputError(f"{place}.name", "a name that no other force has", repr(name))
        names.append(name)
    return found


def copied_forces(forces: Any) -> tuple[Force, ...]:
    """Copies of forces, so that a model does not change with the objects that it was given.

    Raises
    ------
    InputError
        As `check_forces`, and for a force that cannot be copied.
    """
    found = check_forces(forces)
    try:
        return copy.deepcopy(found)
    except Exception as error:  # a user's code may raise anything
        raise InputError("forces", "forces that can be copied", f"{error}") from None


def total_force(
    forces: Sequence[Force], model: SoftModel, q: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """The sum (n,) of all forces at (q, v), checked.

    Raises
    ------
    ForceError
        For a force that raises, that returns anything but finite numbers of shape (n,), or that
        writes to its arguments or keeps them.
    """
    total = np.zeros(model.nv)
    for force in forces:
        total += _called(force, "__call__", force, model, q, v, ((model.nv,),))[0]
    return total


def total_derivatives(
    forces: Sequence[Force], model: SoftModel, q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The sums (n, n) of all forces' ∂F/∂(q ⊕ dq) and ∂F/∂q̇, checked as in `total_force`."""
    n = model.nv
    by_q, by_v = np.zeros((n, n)), np.zeros((n, n))
    for force in forces:
        given = getattr(force, "derivatives", None)
        if given is None:
            parts = list(differences(force, model, q, v))
        else:
            parts = _called(force, "derivatives", given, model, q, v, ((n, n), (n, n)))
        by_q += parts[0]
        by_v += parts[1]
    return by_q, by_v


def differences(
    force: Force, model: SoftModel, q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n) of one force, by central differences with a step of 1e-6."""
    n = model.nv
    by_q, by_v = np.empty((n, n)), np.empty((n, n))
    for k in range(n):
        move = np.zeros(n)
        move[k] = STEP
        sides = [
            total_force((force,), model, model.integrate(q, sign * move), v) for sign in (1, -1)
        ]
        by_q[:, k] = (sides[0] - sides[1]) / (2 * STEP)
        sides = [total_force((force,), model, q, v + sign * move) for sign in (1, -1)]
        by_v[:, k] = (sides[0] - sides[1]) / (2 * STEP)
    return by_q, by_v


def total_energy(forces: Sequence[Force], model: SoftModel, q: np.ndarray) -> float:
    """The potential (J) of those forces that have one.

    Raises
    ------
    ForceError
        For an energy that raises, or that is neither a finite number nor None.
    """
    total = 0.0
    for force in forces:
        found = energy_of(force, model, q)
        total += 0.0 if found is None else found
    return total


def energy_of(force: Force, model: SoftModel, q: np.ndarray) -> float | None:
    """The potential (J) of a force; None if it has none."""
    energy = getattr(force, "energy", None)
    if energy is None:
        return None
    own = _given(q)
    try:
        found = energy(model, own)
        return None if found is None else float(array("energy", found, ()))
    except InputError as error:
        raise ForceError(force, "energy", q, error.expected, error.got) from None
    except Exception as error:  # a user's code may raise anything
        raise _raised(force, "energy", q, error) from error


def _called(
    force: Force,
    method: str,
    call: Callable[..., Any],
    model: SoftModel,
    q: np.ndarray,
    v: np.ndarray,
    shapes: tuple[tuple[int, ...], ...],
) -> list[np.ndarray]:
    """A method's arrays, new ones of these shapes; one array stands alone."""
    own_q, own_v = _given(q), _given(v)
    before = sys.getrefcount(own_q), sys.getrefcount(own_v)
    try:
        answer = call(model, own_q, own_v)
    except Exception as error:  # a user's code may raise anything
        raise _raised(force, method, q, error) from error
    parts = (answer,) if len(shapes) == 1 else answer
    try:
        if len(parts) != len(shapes):
            raise ForceError(force, method, q, f"{len(shapes)} arrays", f"{len(parts)}")
        found = [array("it", part, shape) for part, shape in zip(parts, shapes, strict=True)]
    except TypeError:  # nothing with a length
        raise ForceError(force, method, q, f"{len(shapes)} arrays", repr(answer)) from None
    except InputError as error:
        if isinstance(error, ForceError):
            raise
        raise ForceError(force, method, q, error.expected, error.got) from None
    del answer, parts
    if (sys.getrefcount(own_q), sys.getrefcount(own_v)) != before:
        raise ForceError(force, method, q, "no use of q and v after the call", "that it keeps them")
    return found


def _given(values: np.ndarray) -> np.ndarray:
    """A read-only copy, which a force may see."""
    copied = np.array(values, float)
    copied.flags.writeable = False
    return copied


def _raised(force: Force, method: str, q: np.ndarray, error: Exception) -> ForceError:
    """The error to raise for an exception in a user's code."""
    got = f"{type(error).__name__}: {error}"
    if "read-only" in got:
        return ForceError(force, method, q, "no change of q and v, which are read-only", got)
    return ForceError(force, method, q, "no error", one_line(got))


def with_number(forces: Sequence[Any], place: str, value: Any) -> list[Any]:
    """Forces with one number changed, by a place such as ``drag.size``.

    Raises
    ------
    InputError
        For a place of another form, a name that no force has, a field that is no number, and a
        value that is none.
    """
    name, dot, field = place.rpartition(".")
    names = [force.name for force in forces]
    if not dot:
        raise InputError("force", "NAME.FIELD", repr(place))
    if name not in names:
        expected = ", ".join(names) or "a force"
        raise InputError(f"force {name!r}", expected, did_you_mean(name, names))
    old = forces[names.index(name)]
    known = number_names(old)
    if field not in known:
        expected = f"a number of it, {', '.join(known) or 'which has none'}"
        raise InputError(f"force {name!r}", expected, did_you_mean(field, known))
    changed = copy.deepcopy(old)
    object.__setattr__(changed, field, number(place, value))
    return [changed if force is old else force for force in forces]


def number_names(force: Any) -> list[str]:
    """The names of a force's fields that are numbers, its own and those of its class."""
    return [name for name in dir(force) if _is_number(force, name)]


def numbers_of(force: Any) -> dict[str, float]:
    """The numbers among the fields of a force that are its own, by their names."""
    return {name: getattr(force, name) for name in vars(force) if _is_number(force, name)}


def _is_number(force: Any, name: str) -> bool:
    value = getattr(force, name, None)
    return not name.startswith("_") and isinstance(value, int | float) and value is not bool(value)
