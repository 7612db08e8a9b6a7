"""`softdyn.testing.check_force`: forces that conform; planted faults, each named by its rule."""

import itertools
import json

import numpy as np
import pytest

import softdyn
from softdyn import testing
from softdyn.dynamics import Wrench
from tests.support.arms import PROJECTIONS
from tests.support.command import command

COUNTER = itertools.count()


class Cubic:
    """A cubic spring and a drag."""

    name = "cubic"

    def __call__(self, model, q, v):
        return -0.3 * model.coordinates(q) ** 3 - 0.1 * v

    def derivatives(self, model, q, v):
        return -0.9 * np.diag(model.coordinates(q) ** 2), -0.1 * np.eye(model.nv)

    def energy(self, model, q):
        return 0.075 * np.sum(model.coordinates(q) ** 4)


class Default:
    name = "default"

    def __call__(self, model, q, v):
        return -0.1 * v


class NoName:
    def __call__(self, model, q, v):
        return -v


class Short(Default):
    def __call__(self, model, q, v):
        return -v[1:]


class Infinite(Default):
    def __call__(self, model, q, v):
        return v / 0.0 if v.any() else v


class Writes(Default):
    def __call__(self, model, q, v):
        v *= -0.1
        return v


class Keeps(Default):
    def __call__(self, model, q, v):
        self.q = q
        return -v


class Remembers(Default):
    def __init__(self):
        self.calls = 0

    def __call__(self, model, q, v):
        self.calls += 1
        return -v * self.calls


class HasTime(Default):
    def __call__(self, model, q, v):
        return -v * (1 + next(COUNTER))


class Unpicklable(Default):
    def __init__(self):
        self.law = lambda v: -v

    def __call__(self, model, q, v):
        return self.law(v)


class WrongByQ(Cubic):
    def derivatives(self, model, q, v):
        by_q, by_v = super().derivatives(model, q, v)
        by_q[:, 2] *= 1.001
        return by_q, by_v


class WrongByV(Cubic):
    def derivatives(self, model, q, v):
        by_q, by_v = super().derivatives(model, q, v)
        by_v[0, 1] = 1e-4
        return by_q, by_v


class WrongEnergy(Cubic):
    def energy(self, model, q):
        return -super().energy(model, q)


FAULTS = {
    NoName: "it is built, with a name and a call",
    Short: "finite numbers of shape (n,), and arguments left alone",
    Infinite: "finite numbers of shape (n,), and arguments left alone",
    Writes: "finite numbers of shape (n,), and arguments left alone",
    Keeps: "finite numbers of shape (n,), and arguments left alone",
    Remembers: "equal calls give equal answers",
    HasTime: "equal calls give equal answers",
    Unpicklable: "copies and pickles",
    WrongByQ: "derivatives are those by central differences",
    WrongByV: "derivatives are those by central differences",
    WrongEnergy: "the force at rest is the energy's falling slope",
}


def failed(report):
    return [check.name for check in report.checks if not check.passed]


@pytest.mark.parametrize("force", [Cubic, Default, Wrench("tip", [1, 2, 3]),
                                   Wrench("tip", [1, 2, 3], [1, 2, 3], axes="link")],
                         ids=["exact", "default", "wrench", "following"])  # fmt: skip
def test_forces_that_conform(force):
    finger = softdyn.load("finger")
    assert testing.kind_of(force) == "force"
    assert failed(testing.check(force, finger)) == []


def test_the_force_of_a_projected_robot_is_checked_on_its_tree(tmp_path):
    for build in PROJECTIONS.values():
        assert failed(testing.check_force(Cubic, build(tmp_path))) == []


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_planted_fault_is_named(fault):
    with np.errstate(all="ignore"):
        report = testing.check_force(fault, softdyn.load("finger"))
    assert FAULTS[fault] in failed(report), str(report)


@pytest.mark.parametrize(("fault", "column"), [(WrongByQ, 2), (WrongByV, 1)])
def test_a_wrong_derivative_is_named_by_its_column(fault, column):
    finger = softdyn.load("finger")
    report = testing.check_force(fault, finger)
    (shown,) = [check.detail for check in report.checks if not check.passed]
    assert f"column {column} ({finger.joint_names[column]})" in shown


def test_the_command_knows_a_force_by_its_call(tmp_path):
    file = tmp_path / "own.py"
    file.write_text(
        "class Drag:\n    name = 'drag'\n"
        "    def __call__(self, model, q, v):\n        return -0.1 * v\n"
    )
    code, out, _ = command("check", f"{file}:Drag", "finger", "--json", "-")
    found = json.loads(out)
    assert (code, found["kind"], found["passed"]) == (0, "force", True)
