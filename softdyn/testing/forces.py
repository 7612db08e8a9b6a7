"""Conformance of a force of one's own: `softdyn.dynamics.Force`."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

from softdyn import SoftModel
from softdyn.dynamics.forces import (
    STEP,
    check_forces,
    differences,
    energy_of,
    total_derivatives,
    total_energy,
    total_force,
)
from softdyn.dynamics.projection import underlying_tree
from softdyn.testing import samples
from softdyn.testing.report import Checks, Conformance, Unmet, builds, copies, expect

TOLERANCE = 1e-4  # of a column against central differences, relative to the matrix's largest entry
ROUNDING = 1e-9  # of the force: what central differences with a step of 1e-6 may lose


def check_force(force: Any, model: SoftModel, *, count: int = 5, seed: int = 0) -> Conformance:
    """Test a force: any class with a name and ``__call__(model, q, v) -> (n,)``.

    A derivative that differs from central differences by more than 1e-4 is named by its column.

    Parameters
    ----------
    force : Any
        A class that is built as ``CLASS()``, a function that builds one, or an object.
    model : SoftModel
        The robot. The force is called with its tree, without other forces.
    count, seed : int
        Number of random states, and their seed.
    """
    checks = Checks((lambda _: force()) if builds(force) else force, model)

    def built() -> str:
        one = checks.make()
        expect(not inspect.isclass(one), "CLASS()", "an object", one)
        check_forces((one,))
        return f"{type(one).__name__}, name {one.name!r}"

    if not checks.run("it is built, with a name and a call", built):
        return checks.report("force")
    tree = underlying_tree(model)[0].unforced
    one, states = checks.make(), samples.states(tree, count + 1, seed)[1:]

    def at(k: int, other: Any = None) -> np.ndarray:
        return total_force((other or one,), tree, states[k].q, states[k].v)

    def values() -> str:
        largest = max(float(np.abs(at(k)).max(initial=0.0)) for k in range(count))
        return f"up to {largest:.3g} N m, N"

    def repeats() -> None:
        first = [at(k) for k in range(count)]
        for k in reversed(range(count)):
            expect(np.array_equal(first[k], at(k)), f"force(model, q, v) again, in state {k}",
                   f"{first[k]}", at(k))  # fmt: skip
            other = at(k, checks.make())
            expect(np.array_equal(first[k], other), f"that of a new object, in state {k}",
                   f"{first[k]}", other)  # fmt: skip

    def copied() -> None:
        for name, twin in copies(one).items():
            for k in range(count):
                expect(np.array_equal(at(k), at(k, twin)), f"{name}(force)(model, q, v)",
                       f"{at(k)}", at(k, twin))  # fmt: skip

    def derivatives() -> str:
        if getattr(one, "derivatives", None) is None:
            return "it gives none: central differences with a step of 1e-6"
        worst = 0.0
        for k, state in enumerate(states):
            given = total_derivatives((one,), tree, state.q, state.v)
            central = differences(one, tree, state.q, state.v)
            size = float(np.abs(at(k)).max(initial=0.0))
            for name, found, other in zip(("by_q", "by_v"), given, central, strict=True):
                worst = max(worst, _columns(f"derivatives(model, q, v): {name}", found, other,
                                            size, tree.joint_names))  # fmt: skip
        return f"{worst:.1e} from central differences"

    def energy() -> str:
        if energy_of(one, tree, tree.q0) is None:
            return "it has none"
        worst, still = 0.0, np.zeros(tree.nv)
        for state in states:
            sides = np.array([
                [total_energy((one,), tree, tree.integrate(state.q, s * move)) for s in (1, -1)]
                for move in STEP * np.eye(tree.nv)
            ])  # fmt: skip
            slope = (sides[:, 1] - sides[:, 0]) / (2 * STEP)
            F = total_force((one,), tree, state.q, still)
            size = max(float(np.abs(sides).max()), float(np.abs(F).max(initial=0.0)))
            worst = max(worst, _columns("-d energy(model, q)/dq", slope[None], F[None],
                                        size, tree.joint_names))  # fmt: skip
        return f"{worst:.1e} from the force at rest"

    checks.run("finite numbers of shape (n,), and arguments left alone", values)
    checks.run("equal calls give equal answers", repeats)
    checks.run("copies and pickles", copied)
    checks.run("derivatives are those by central differences", derivatives)
    checks.run("the force at rest is the energy's falling slope", energy)
    return checks.report("force")


def _columns(
    call: str, found: np.ndarray, other: np.ndarray, size: float, names: tuple[str, ...]
) -> float:
    """The largest relative difference of two matrices; `Unmet` names the worst column."""
    largest = max(float(np.abs(found).max(initial=0.0)), float(np.abs(other).max(initial=0.0)))
    error = np.abs(found - other).max(axis=0, initial=0.0)
    k = int(error.argmax())
    if error[k] > TOLERANCE * largest + ROUNDING * size:
        row = int(np.abs(found - other)[:, k].argmax())
        text = f"{call}, column {k} ({names[k]}): expected {other[row, k]:.6g} in row {row}"
        raise Unmet(f"{text}, got {found[row, k]:.6g}")
    return float(error[k]) / largest if largest else 0.0
