"""References: hostile numbers are refused, derivatives are those of the path."""

import copy
import math
import pickle

import numpy as np
import pytest

from softdyn import Ellipse, InputError, Reference, SetPoint
from tests.support.refused import refused

NAN, INF = math.nan, math.inf
ELLIPSE = Ellipse(a=0.08, b=0.03, c=0.21, phi=0.7, omega=0.4, start=0.3)
HOSTILE_VECTORS = [
    [1.0, 2.0], [[1.0, 2.0, 3.0]], [1.0, 2.0, NAN], [1.0, INF, 0.0], "abc", ["1", "2", "3"], None,
    [1.0, None, 2.0], [1j, 0, 0], [[1], [2, 3], [4]], 3.0, [True, False, True],
]  # fmt: skip
HOSTILE_NUMBERS = [NAN, INF, -INF, "1", None, [1.0], 1j, True, 10**400]


@pytest.mark.parametrize("value", HOSTILE_VECTORS, ids=str)
@pytest.mark.parametrize("name", ["y", "ydot", "yddot"])
def test_reference_refuses(name, value):
    arguments = {"y": np.zeros(3), "ydot": np.zeros(3), "yddot": np.zeros(3), name: value}
    with refused(name):
        Reference(**arguments)


def test_reference_is_a_read_only_copy():
    y = np.array([1.0, 2.0, 3.0])
    reference = Reference(y, [4, 5, 6])
    y[0] = 9.0
    assert reference.y.tolist() == [1.0, 2.0, 3.0]
    assert reference.ydot.dtype == float
    assert reference.yddot.tolist() == [0.0, 0.0, 0.0]
    for array in (reference.y, reference.ydot, reference.yddot):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        reference.y = y


@pytest.mark.parametrize("again", [copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))])
@pytest.mark.parametrize("reference", [SetPoint([1, 2, 3]), ELLIPSE(0.2)])
def test_copies_stay_read_only(again, reference):
    copied = again(reference)
    assert type(copied) is type(reference)
    for name in ("y", "ydot", "yddot"):
        assert getattr(copied, name).tolist() == getattr(reference, name).tolist()
        assert not getattr(copied, name).flags.writeable


def test_set_point_is_its_own_reference():
    point = SetPoint([0.1, -0.2, 0.3])
    assert isinstance(point, Reference)
    assert point(0.0) is point(7.5) is point
    assert point.y.tolist() == [0.1, -0.2, 0.3]
    assert not point.ydot.any()
    assert not point.yddot.any()


@pytest.mark.parametrize("value", HOSTILE_VECTORS, ids=str)
def test_set_point_refuses(value):
    with pytest.raises(InputError):
        SetPoint(value)


@pytest.mark.parametrize("theta", [-1.7, 0.0, 0.5, 1.0, 1.5, 2.25])
def test_point_is_the_papers_formula(theta):
    a, b, c, phi, angle = ELLIPSE.a, ELLIPSE.b, ELLIPSE.c, ELLIPSE.phi, math.pi * theta
    x = a * math.cos(angle) * math.cos(phi) - (b * math.sin(angle) - c) * math.sin(phi)
    z = a * math.cos(angle) * math.sin(phi) + (b * math.sin(angle) - c) * math.cos(phi)
    np.testing.assert_allclose(ELLIPSE.point(theta), [x, 0.0, z], rtol=0, atol=1e-15)


def test_path_runs_through_its_points():
    for t in (-1.0, 0.0, 0.37, 12.5):
        expected = ELLIPSE.point(0.3 + 0.4 * t)
        np.testing.assert_allclose(ELLIPSE(t).y, expected, rtol=0, atol=1e-14)
    period = 2 / ELLIPSE.omega
    np.testing.assert_allclose(ELLIPSE(period).y, ELLIPSE(0.0).y, rtol=0, atol=1e-14)


@pytest.mark.parametrize("t", [-2.0, 0.0, 0.6, 3.3])
def test_derivatives_by_central_differences(t):
    h = 1e-4
    velocity = (ELLIPSE(t + h).y - ELLIPSE(t - h).y) / (2 * h)
    acceleration = (ELLIPSE(t + h).ydot - ELLIPSE(t - h).ydot) / (2 * h)
    np.testing.assert_allclose(ELLIPSE(t).ydot, velocity, rtol=0, atol=1e-8)
    np.testing.assert_allclose(ELLIPSE(t).yddot, acceleration, rtol=0, atol=1e-8)


def test_ellipse_output_is_a_read_only_reference():
    reference = ELLIPSE(np.float64(0.1))
    assert isinstance(reference, Reference)
    for array in (reference.y, reference.ydot, reference.yddot):
        assert array.shape == (3,)
        assert not array.flags.writeable


def test_resting_ellipse_has_no_velocity():
    reference = Ellipse(0.1, 0.05, 0.2, start=0.5)(3.0)
    assert not reference.ydot.any()
    assert not reference.yddot.any()


@pytest.mark.parametrize("value", HOSTILE_NUMBERS, ids=lambda v: str(v)[:9])
@pytest.mark.parametrize("name", ["a", "b", "c", "phi", "omega", "start"])
def test_ellipse_refuses(name, value):
    with refused(name):
        Ellipse(**{"a": 0.1, "b": 0.1, "c": 0.1, name: value})


@pytest.mark.parametrize(
    "changes", [{"a": 0.0}, {"b": -0.1}, {"omega": 1e200}, {"c": 1.7e308}, {"start": 1e308}]
)
def test_ellipse_refuses_no_size_and_overflow(changes):
    with pytest.raises(InputError):
        Ellipse(**{"a": 0.1, "b": 0.1, "c": 0.1, **changes})


@pytest.mark.parametrize("t", [NAN, INF, -INF, "1", None, [1.0, 2.0], 1j, 1e308 * 10])
def test_ellipse_refuses_hostile_times(t):
    for ellipse in (ELLIPSE, Ellipse(0.1, 0.1, 0.1)):
        with refused("t"):
            ellipse(t)


@pytest.mark.parametrize("theta", [NAN, INF, "0.5", None])
def test_point_refuses(theta):
    with refused("theta"):
        ELLIPSE.point(theta)
