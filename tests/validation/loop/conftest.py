"""The fixture of the cart for all tests of the loop."""

import pytest

from tests.support.cart import CART, DAMPING, STIFFNESS, load


@pytest.fixture
def make_cart(tmp_path):
    def make(stiffness=STIFFNESS, damping=DAMPING, lower="-20", upper="20"):
        numbers = {"stiffness": stiffness, "damping": damping, "lower": lower, "upper": upper}
        return load(tmp_path, CART.format(**numbers))

    return make


@pytest.fixture
def cart(make_cart):
    return make_cart()
