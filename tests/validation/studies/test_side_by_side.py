"""Controllers side by side from Python: the figures are those of `simulate`, the table prints."""

import numpy as np

import softdyn
from softdyn.controllers import Impedance
from softdyn.validation import benchmark, paper, simulate
from tests.support.refused import refused


class Mine:
    """A controller without any input, so that the robot sags."""

    def __init__(self, model):
        self.model = model

    def __call__(self, state, reference):
        return np.zeros(self.model.nu)


def test_own_classes_stand_beside_the_package_s(tmp_path):
    found = benchmark({"mine": Mine, "ic": Impedance}, ["finger"], thetas=[0.5], omegas=[], jobs=1)
    mine, ic = found.rows
    model = softdyn.load("finger")
    for row, make in ((mine, Mine), (ic, Impedance)):
        log = simulate(model, make(model), paper.set_point("finger", 0.5))
        assert row["sp_mean_cm"] == log.final_error_cm
    assert mine["sp_mean_cm"] > ic["sp_mean_cm"]
    assert ic["paper"]["sp_mean_cm"] == 0.08
    lines = str(found).splitlines()
    assert [line.split()[1] for line in lines[1:]] == ["mine", "IC"]
    assert "| mine |" in found._repr_markdown_()
    assert found.to_dict()["rows"] == [mine, ic]


def test_what_is_no_controller_is_told():
    with refused("mine", 3):
        benchmark({"mine": 3}, ["finger"])
    with refused("controller"):
        benchmark(["no-such"], ["finger"], jobs=1)
