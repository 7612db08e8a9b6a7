"""Trees of every form for the forces of a fluid: bundled, random, with mimic joints, floating."""

import pytest

import softdyn
from softdyn import Robot
from softdyn.description.urdf import parse_text
from tests.support.random_robots import random_urdf
from tests.support.robots import GRIPPER, WALKER


@pytest.fixture(scope="module", params=["finger", "random", "mimic", "floating"])
def tree(request: pytest.FixtureRequest) -> Robot:
    if request.param == "finger":
        return softdyn.load("finger").robot
    text = {"random": random_urdf(3), "mimic": GRIPPER, "floating": WALKER}[request.param]
    return parse_text(text, path="robot.urdf", floating=request.param == "floating")
