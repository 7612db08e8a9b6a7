"""Forces of one's own in a sweep: in every case, with numbers that vary."""

import pytest

import softdyn
from softdyn.controllers.registry import make_controller
from softdyn.validation import paper, simulate
from softdyn.validation.loop.recorded import MOTION, motion_of
from softdyn.validation.studies.engine import worker
from softdyn.validation.studies.sweep_file import read_sweep

DRAG = """
class Drag:
    name = "drag"
    size = 0.01

    def __call__(self, model, q, v):
        return -self.size * v
"""
SWEEP = """
robots = "finger"
controllers = "ic"
forces = "drag.py:Drag"
rows = ["change", "force.drag.size"]
[targets]
theta = 0.5
[run]
duration = 0.02
[force.drag]
size = 0.02
[changes]
"drag {}" = { force.drag.size = [0.05, 0.2] }
"""


@pytest.fixture
def swept(folder, written):
    (folder / "drag.py").write_text(DRAG)
    return written(SWEEP)


def test_each_case_runs_as_simulate_does_with_that_force(swept, folder):
    sizes = [case.force["drag.size"] for case in swept.cases]
    assert sizes == [0.02, 0.05, 0.2]
    assert {"none/0.02/θ = 0.5π", "drag 0.2/0.2/θ = 0.5π"} <= {*swept.cells}
    jobs = swept.jobs()
    assert len({job.fingerprint for job in jobs}) == 3
    (found,) = (worker.run(job) for job in jobs if job.case.force["drag.size"] == 0.05)
    (said,) = found.record["record"]["robot"]["forces"]
    assert said["numbers"] == {"size": 0.05}
    force = softdyn.controllers.find_controller(f"{folder / 'drag.py'}:Drag")()
    force.size = 0.05
    dry = softdyn.load("finger")
    for model, same in ((dry.with_forces(force), True), (dry, False)):
        log = simulate(model, make_controller("ic", model), paper.set_point("finger", 0.5),
                       duration=0.02)  # fmt: skip
        assert (motion_of(log) == found.record[MOTION]) == same


def test_an_edited_force_and_the_options(swept, folder):
    before = {job.case.name: job.fingerprint for job in swept.jobs()}
    (folder / "drag.py").write_text(DRAG + "# edited\n")
    after = {job.case.name: job.fingerprint for job in read_sweep(swept.path).jobs()}
    assert before.keys() == after.keys()
    assert not {*before.values()} & {*after.values()}
    (folder / "elsewhere" / "own.py").write_text(DRAG.replace("0.01", "0.03"))
    said = {"forces": ["own.py:Drag"], "force": {"drag.size": 0.4}}
    instead = read_sweep(swept.path, said)
    assert [case.force["drag.size"] for case in instead.cases] == [0.4, 0.05, 0.2]
    assert instead.forces == ("elsewhere/own.py:Drag",)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"drag.py:Drag"', '"drag"', "FILE.py:CLASS"),
        ("drag.py:Drag", "drag.py:Dreg", "a class in"),
        ('forces = "drag.py:Drag"', "", "a force"),
        ("size = 0.02", "sise = 0.02", "size"),
        ("size = 0.02", 'size = "much"', "number"),
    ],
)
def test_what_is_no_force_or_number_is_refused(old, new, expected, swept, refused):
    refused(SWEEP, old, new, expected)
