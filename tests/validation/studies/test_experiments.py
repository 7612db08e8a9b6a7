"""The paper's experiments and table, against the text of the paper."""

import math
import re
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

import softdyn
from softdyn import Ellipse, InputError, OutOfReach, SetPoint
from softdyn.validation import paper
from tests.support.refused import refused
from tests.support.robots import WALKER, write

LENGTH = {"finger": 0.24, "helix": 0.45, "spirob": 0.50, "spirob48": 0.50}
PERIOD = {"finger": 0.005, "helix": 0.0075, "spirob": 0.002, "spirob48": 0.002}

# Rows of tab:combined_benchmark as they stand in the paper, the bold face removed.
LATEX = r"""
Finger & CLF-QP & 0.75 ± 1.05 & 6.90 ± 0.80 \\
Finger & ID-CLF-QP (ours) & 0.08 ± 0.09 & 0.53 ± 0.26 \\
Finger & IC & 0.08 ± 0.14 & 1.26 ± 0.73 \\
Finger & UIC & 0.22 ± 0.39 & 1.00 ± 0.51 \\
Finger & IC-QP & 0.07 ± 0.12 & 1.26 ± 0.71 \\
Helix & CLF-QP & Failed Convergence & Failed Convergence \\
Helix & ID-CLF-QP (ours) & 2.48 ± 1.20 & 24.14 ± 9.04 \\
Helix & IC & 2.66 ± 1.40 & 21.89 ± 6.08 \\
Helix & UIC & 3.39 ± 2.12 & 31.70 ± 7.48 \\
Helix & IC-QP & 2.48 ± 1.20 & 24.14 ± 9.04 \\
SpiRob & CLF-QP & 4.23 ± 3.98 & 255.33 ± 186.38 \\
SpiRob & ID-CLF-QP (ours) & 3.50 ± 3.71 & 19.51 ± 5.66 \\
SpiRob & IC & Failed Convergence & Failed Convergence \\
SpiRob & UIC & Failed Convergence & Failed Convergence \\
SpiRob & IC-QP & 8.93 ± 7.80 & 157.64 ± 6.48\\
"""
NAMES = {"ID-CLF-QP (ours)": "soft-id-clf-qp"}


def test_table_is_the_papers():
    seen = set()
    for line in LATEX.strip().splitlines():
        robot, controller, sp, tt = (cell.strip() for cell in line.rstrip("\\").split("&"))
        key = robot.lower(), NAMES.get(controller, controller.lower())
        row = paper.published(*key)
        assert row is not None
        for text, figures in (
            (sp, (row.sp_mean_cm, row.sp_std_cm)),
            (tt, (row.tt_mean_cm2, row.tt_std_cm2)),
        ):
            numbers = tuple(float(number) for number in re.findall(r"\d+\.\d+", text))
            assert figures == (numbers or (None, None))
        seen.add(key)
    assert seen == set(paper.TABLE)


@pytest.mark.parametrize("key", [("finger", "id-clf-qp"), ("spirob48", "ic"), ("mine", "ic")])
def test_no_row_is_none(key):
    assert paper.published(*key) is None


@pytest.mark.parametrize("robot", LENGTH)
@pytest.mark.parametrize("theta", [0, 0.5, 1.0, 1.5, -0.3])
def test_set_points_by_the_papers_formula(robot, theta):
    length, angle, phi = LENGTH[robot], theta * math.pi, math.pi / 4
    a, b = length / 3, length / 8
    c = (length if robot in ("finger", "helix") else 0.75 * length) - b
    x = a * math.cos(angle) * math.cos(phi) - (b * math.sin(angle) - c) * math.sin(phi)
    z = a * math.cos(angle) * math.sin(phi) + (b * math.sin(angle) - c) * math.cos(phi)
    experiment = paper.set_point(robot, theta=theta)
    np.testing.assert_allclose(experiment.reference(4.2).y, [x, 0, z], rtol=0, atol=1e-15)
    assert isinstance(experiment.reference, SetPoint)
    assert (experiment.robot, experiment.kind) == (robot, "set_point")
    assert (experiment.theta, experiment.omega) == (theta, None)
    assert (experiment.duration, experiment.period) == (10.0, PERIOD[robot])
    assert experiment.length == length


def test_the_fingers_last_set_point_is_at_full_reach():
    y = paper.set_point("finger", 1.5).reference(0.0).y
    assert np.linalg.norm(y) == pytest.approx(0.24, abs=1e-15)


@pytest.mark.parametrize("robot", LENGTH)
@pytest.mark.parametrize("omega", paper.OMEGAS)
def test_tracking_takes_two_cycles(robot, omega):
    experiment = paper.tracking(robot, omega=omega)
    assert experiment.duration == pytest.approx(4 * math.pi / (omega * math.pi), rel=1e-15)
    assert (experiment.kind, experiment.theta, experiment.omega) == ("tracking", None, omega)
    start, half, end = (experiment.reference(experiment.duration * x) for x in (0, 0.5, 1))
    np.testing.assert_allclose(half.y, start.y, rtol=0, atol=1e-14)
    np.testing.assert_allclose(end.y, start.y, rtol=0, atol=1e-14)
    np.testing.assert_allclose(start.y, paper.set_point(robot, 0.0).reference(0).y, atol=1e-15)
    quarter = experiment.reference(0.5 / omega)
    np.testing.assert_allclose(quarter.y, paper.set_point(robot, 0.5).reference(0).y, atol=1e-15)


def test_the_slowest_cycle_takes_twenty_seconds():
    assert paper.tracking("finger", 0.1).duration == 40.0


@pytest.mark.parametrize("robot", ["Finger", "", None, 3, "finger.urdf", ["finger"]])
def test_unknown_robots_are_refused(robot):
    for experiment in (paper.set_point, paper.tracking):
        with refused("robot"):
            experiment(robot, 0.5)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "0.5", None, [0.5], True, 1j])
def test_hostile_numbers_are_refused(value):
    with refused("theta"):
        paper.set_point("finger", theta=value)
    with refused("omega"):
        paper.tracking("finger", omega=value)
    for name in ("length", "period", "reach", "ellipse_scale"):
        with refused(name):
            paper.Setup(**{"robot": "mine", "length": 1.0, "period": 0.01, name: value})


@pytest.mark.parametrize("omega", [0.0, -0.1, 5e-324, 1e200])
def test_rates_without_two_cycles_are_refused(omega):
    with pytest.raises(InputError):
        paper.tracking("finger", omega=omega)


def test_an_own_setup():
    setup = paper.Setup("mine", 0.24, 0.005)
    smaller = paper.Setup("mine", 0.24, 0.005, ellipse_scale=0.7)
    assert smaller.ellipse() == Ellipse(0.7 * 0.08, 0.7 * 0.03, 0.21)
    finger = paper.set_point("finger", 0.5)
    assert setup.set_point(0.5).reference(0).y.tolist() == finger.reference(0).y.tolist()
    target = setup.target([0.1, 0.0, -0.1])
    assert (target.kind, target.theta, target.robot) == ("set_point", None, "mine")
    assert target.reference(9.0).y.tolist() == [0.1, 0.0, -0.1]
    with pytest.raises(InputError):
        setup.target([0.1, math.nan, 0.0])


def test_the_setup_of_a_model():
    model = softdyn.load("finger")
    assert paper.setup_of(model) is paper.setup("finger")
    other = softdyn.build(model.robot)  # the same file, not known as a bundled one
    assert paper.setup_of(other) == paper.Setup(model.name, model.robot.length, 0.002)


def test_a_robot_without_length_has_targets_only():
    setup = paper.Setup("mine", 0.0, 0.005)
    assert setup.target([1, 2, 3]).length == 0.0
    with refused("length", "0 m"):
        setup.set_point(0.5)


def test_only_a_fixed_base_limits_the_reach(tmp_path):
    """A floating robot goes where it likes, and one without a length has no reach to leave."""
    far, file = [90.0, 0.0, 0.0], write(tmp_path, WALKER)
    with refused("target", by=OutOfReach):
        paper.experiment(softdyn.load(file), target=far)
    assert paper.experiment(softdyn.load(file, floating=True), target=far).theta is None


def test_an_experiment_is_frozen():
    experiment = paper.set_point("finger", 0.0)
    with pytest.raises(FrozenInstanceError):
        experiment.duration = 1.0
    assert replace(experiment, duration=1.0).duration == 1.0


def test_an_experiment_is_one_of_three():
    model = softdyn.load("finger")
    assert paper.experiment(model, theta=0.5).theta == 0.5
    assert paper.experiment(model, theta=0.5).length == 0.24
    assert paper.experiment(model, omega=0.5, period=0.001).period == 0.001
    assert paper.experiment(model, target=[0.1, 0, 0]).theta is None
    with refused("experiment", "none of them"):
        paper.experiment(model)
