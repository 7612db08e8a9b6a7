"""Checks of arguments: valid ones become floats, invalid ones are named in the error."""

import math

import numpy as np
import pytest

from softdyn.checks import array, beyond, number, vector
from tests.support.refused import refused


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.int8(2), np.float64(2)])
def test_numbers_become_floats(value):
    result = number("x", value)
    assert result == 2.0
    assert type(result) is float


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, "2", None, True, np.True_, 2j, [2.0], np.array(2.0), 10**400]
)
def test_what_is_no_number(value):
    with refused("x"):
        number("x", value)


def test_bounds_of_numbers():
    assert number("x", 0.0, lower=0.0) == 0.0
    with refused("x", -1):
        number("x", -1, lower=0.0)
    with refused("x", 0):
        number("x", 0, above=0.0)


def test_arrays_are_read_only_copies():
    given = np.array([1.0, 2.0])
    result = array("x", given, (2,))
    given[0] = 5.0
    assert result.tolist() == [1.0, 2.0]
    assert not result.flags.writeable
    assert array("x", [[1, 2]], (1, 2)).dtype == float
    assert array("x", [], (0,)).shape == (0,)


@pytest.mark.parametrize(
    "value",
    [[1.0], [1.0, math.nan], [1.0, math.inf], "ab", ["1", "2"], None, [1, None], [1j, 2],
     [[1], [2, 3]], [True, False], 1.0, [[1.0, 2.0]]],
)  # fmt: skip
def test_what_is_no_array(value):
    for check, size in ((array, (2,)), (vector, 2)):
        with refused("x"):
            check("x", value, size)


def test_vectors_are_copies_to_write_to():
    given = np.array([1.0, 1e300])  # its square is beyond the floats
    with np.errstate(over="ignore"):
        result = vector("x", given, 2)
    result[0] = 5.0
    assert given.tolist() == [1.0, 1e300]
    assert vector("x", (1, 2), 2).dtype == float


def test_infinities_on_request():
    assert math.isinf(array("x", [math.inf], (1,), finite=False)[0])


def test_a_mask_that_hides_something_is_refused():
    hidden = np.ma.masked_array([1.0, 2.0], [True, False])
    for value in (hidden, hidden[::-1]):
        with refused("x", "a mask that hides some"):
            array("x", value, (2,))
    with refused("x", "a mask that hides some"):
        vector("x", hidden, 2)
    assert array("x", np.ma.masked_array([1.0, 2.0]), (2,)).tolist() == [1.0, 2.0]


def test_a_number_of_thousands_of_digits_is_refused():
    with refused("x", "a number of thousands of digits"):
        number("x", 10**5000)


def test_rounding_is_not_beyond_a_limit():
    assert not beyond(0.33, 0.13 + 0.11 + 0.09)
    assert not beyond(0.13 + 0.11 + 0.09, 0.33)
    assert beyond(0.3300001, 0.33)
    assert not beyond(-0.33, 0.13 + 0.11 + 0.09)
    assert beyond(1e-300, 0.0)
