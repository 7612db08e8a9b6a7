"""The fixture of the cart for all tests of the loop."""

import pytest

from tests.support.cart import text
from tests.support.robots import load


@pytest.fixture
def make_cart(tmp_path):
    def make(lower=-20, upper=20, **changes):
        return load(tmp_path, text(lower, upper, **changes))

    return make


@pytest.fixture
def cart(make_cart):
    return make_cart()
