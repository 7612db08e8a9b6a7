"""Trajectories of one's own: a path in a CSV file, a class in a Python file."""

import math
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import InputError
from softdyn.tasks import read_path
from softdyn.validation import paper
from softdyn.validation.loop.trajectories import read_trajectory
from tests.support.refused import refused

CLASS = """
import math
from softdyn import Reference

class Line:
    duration = 0.5

    def __init__(self, model):
        self.start = model.state(model.q0, model.coordinates(model.q0) * 0).y

    def __call__(self, t):
        return Reference(self.start + [0, 0, -0.02 * t], [0, 0, -0.02], [0, 0, 0])

class Broken(Line):
    def __call__(self, t):
        return Reference([0.1, 0, 1 / (0.25 - t) if t > 0.2 else 0], [0, 0, 0], [0, 0, math.inf])

class Raising(Line):
    def __call__(self, t):
        raise ZeroDivisionError("thirteen")

class Wordless(Line):
    duration = "long"
"""


def circle(count=49, period=2.0, centre=(0.19, 0.0, -0.02), radius=0.02):
    """Times, points of a circle in the xz-plane at even angles, closed."""
    t = np.linspace(0.0, period, count)
    angle = 2 * math.pi * t / period
    turn = np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    return t, np.asarray(centre) + radius * turn


@pytest.fixture
def written(tmp_path):
    def write(t, points, header="t (s),x (m),y (m),z (m)", name="path.csv"):
        rows = [",".join(map(repr, map(float, row))) for row in np.column_stack([t, points])]
        (tmp_path / name).write_text("\n".join([header, *rows]) + "\n")
        return tmp_path / name

    return write


def test_a_path_of_a_file_repeats_with_the_rates_of_the_circle_that_it_samples(written):
    """Against the circle's own derivatives, inside the period and where it closes."""
    path = read_path(written(*circle()), periodic=True)
    rate = math.pi  # 2π in 2 s
    for t in (0.0, 0.013, 0.77, 1.999, 2.0, 2.001, 5.3, 200.25):
        c, s = math.cos(rate * t), math.sin(rate * t)
        found = path(t)
        np.testing.assert_allclose(found.y, [0.19 + 0.02 * c, 0, -0.02 + 0.02 * s], atol=1e-9)
        expected = 0.02 * rate * np.array([-s, 0, c])
        np.testing.assert_allclose(found.ydot, expected, atol=2e-7)
        expected = 0.02 * rate**2 * np.array([-c, 0, -s])
        np.testing.assert_allclose(found.yddot, expected, atol=2e-5)


def test_a_path_of_a_file_runs_once_and_rests_at_both_ends(written):
    t, points = circle()
    path = read_path(written(t, points))
    for k in (0, 7, 48):
        np.testing.assert_allclose(path(t[k]).y, points[k], atol=1e-15)
    for end in (0.0, 2.0, 3.0):
        assert np.abs([path(end).ydot, path(end).yddot]).max() < 1e-12
    np.testing.assert_array_equal(path(3.0).y, path(2.0).y)


def test_a_trajectory_is_an_experiment_for_any_robot(written, tmp_path):
    model = softdyn.load("finger")
    file = written(*circle())
    once = paper.trajectory(model, file)
    assert (once.kind, once.duration, once.period) == ("tracking", 2.0, 0.005)
    assert paper.trajectory(model, file, periodic=True, period=0.01).duration == 4.0
    (tmp_path / "own_path.py").write_text(CLASS)
    own = read_trajectory(f"{tmp_path}/own_path.py:Line", model)
    assert own.duration == 0.5
    start = model.state(model.q0, np.zeros(model.nv)).y
    np.testing.assert_allclose(own.reference(0.5).y, start - [0, 0, 0.01], atol=1e-15)


@pytest.mark.parametrize(
    ("header", "change", "periodic", "message"),
    [
        ("t,x,y", None, False, "expected 3 cells, got 4"),
        ("t,x,y,w", None, False, "path.csv: expected one column z, got 0"),
        ("t (ms),x,y,z", None, False, "path.csv: header: expected t in s"),
        ("t,x (cm),y,z", None, False, "path.csv: header: expected x in m"),
        ("t,x,y,z", ("2.0,", "1.0,"), False, "path.csv: times: expected two increasing times"),
        ("t,x,y,z", ("\n0.0,", "\n0.01,"), False, "path.csv: t: expected 0 in the first row"),
        ("t,x,y,z", ("2.0,0.21", "2.0,0.22"), True, "path.csv: values: expected a last waypoint"),
        ("t,x,y,z", ("2.0,0.21", "2.0,nan"), True, "path.csv:50: column x: expected a finite"),
        ("t,x,y,z", ("2.0,0.21", "2.0,21"), False, "expected three finite numbers in m, within"),
    ],
)
def test_a_path_that_cannot_be_used_is_refused(written, header, change, periodic, message):
    file = written(*circle(), header=header)
    if change is not None:
        assert change[0] in file.read_text()
        file.write_text(file.read_text().replace(*change))
    with pytest.raises(InputError) as caught:
        paper.trajectory(softdyn.load("finger"), file, periodic=periodic)
    assert message in str(caught.value)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Broken", "own_path.py:Broken: yddot: expected finite numbers"),
        ("Raising", "own_path.py:Raising: expected a trajectory, got ZeroDivisionError in line"),
        ("Wordless", "own_path.py:Wordless: duration: expected a finite number > 0"),
        ("Lines", "expected a class in"),
    ],
)
def test_a_class_that_cannot_be_used_is_refused(tmp_path, name, message):
    (tmp_path / "own_path.py").write_text(CLASS)
    with pytest.raises(InputError) as caught:
        read_trajectory(f"{tmp_path}/own_path.py:{name}", softdyn.load("finger"))
    assert message in str(caught.value)
    with refused("periodic"):
        read_trajectory(Path(f"{tmp_path}/own_path.py:Line"), softdyn.load("finger"), periodic=True)


def test_a_run_along_a_path_of_a_file_can_be_repeated(written, tmp_path):
    from softdyn.controllers import Impedance
    from softdyn.validation import simulate
    from tests.support.command import command

    model = softdyn.load("finger")
    goal = paper.trajectory(model, written(*circle()), periodic=True)
    controller = Impedance(model, Impedance.published["finger"])
    simulate(model, controller, goal, duration=0.05).save(tmp_path / "run.npz")
    done = command("run", "--from", tmp_path / "run.npz", "--no-verdict")
    assert done.code == 0, done.err
    assert "equal to the bit" in done.out
