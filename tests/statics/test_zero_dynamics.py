"""Poles of the zero dynamics: an oscillator by hand, and the invariant zeros of a pencil."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import softdyn
from softdyn import statics
from tests.support.robots import build, cable, joint, link, motor, robot, weld

OSCILLATOR = robot(
    "pair", link("world"), link("a", 1), link("b", 0.5), link("tip"),
    joint("ja", "world", "a", "1 0 0", "prismatic", limit=(-2, 2)),
    joint("jb", "a", "b", "1 0 0", "prismatic", limit=(-2, 2), damping=0.3, stiffness=4),
    weld("a", "tip"), block=(cable("t", "ja 1"), motor("t", -9, 9), '<task frame="tip"/>'),
)  # fmt: skip


def test_a_mass_on_a_held_one():
    # the input holds the first body; the second swings on it: 0.5 s² + 0.3 s + 4 = 0
    poles = statics.zero_spectrum(build(OSCILLATOR), [0.2, 0.0], [0.0])
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(np.roots([0.5, 0.3, 4.0])))


@pytest.mark.parametrize(("robot", "rows"), [("finger", (0, 2)), ("spirob", (0, 1, 2))])
def test_poles_are_the_invariant_zeros(robot, rows):
    """Rosenbrock's pencil of ẋ = A x + B u, y = C x, all by central differences of the motion."""
    model = softdyn.load(robot)
    n, m, h = model.nv, model.nu, 1e-5
    rest, _ = statics.ramp(model, 0.1 * model.u_max * np.linspace(1.0, 1.3, m))

    def motion(x: np.ndarray) -> np.ndarray:
        q = model.integrate(rest.q, x[:n])
        return np.concatenate((x[n : 2 * n], model.forward_dynamics(q, x[n : 2 * n], x[2 * n :])))

    def tip(x: np.ndarray) -> np.ndarray:
        return model.state(model.integrate(rest.q, x[:n]), x[n : 2 * n]).y[list(rows)]

    at = np.concatenate((np.zeros(2 * n), rest.u))
    steps = h * np.eye(2 * n + m)
    AB = np.stack([motion(at + d) - motion(at - d) for d in steps], axis=1) / (2 * h)
    CD = np.stack([tip(at + d) - tip(at - d) for d in steps], axis=1) / (2 * h)
    pencil, unit = np.vstack((AB, CD)), np.zeros((2 * n + m,) * 2)
    unit[: 2 * n, : 2 * n] = np.eye(2 * n)
    pairs = scipy.linalg.eigvals(pencil, unit, homogeneous_eigvals=True)
    finite = np.abs(pairs[1]) > 1e-9 * np.abs(pairs[0])
    zeros = pairs[0][finite] / pairs[1][finite]
    poles = statics.zero_spectrum(model, rest.q, rest.u)
    assert len(poles) == 2 * (n - len(rows))
    for pole in poles:  # one of the finger's is 1e6 1/s, where differences tell a few per cent
        tolerance = 1e-6 if abs(pole) < 1e5 else 0.1
        assert np.abs(zeros - pole).min() <= tolerance * max(1.0, abs(pole)), pole
