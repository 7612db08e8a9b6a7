"""No kernel is compiled during a closed loop: neither by the controller nor by the observer."""

from __future__ import annotations

import gc

import numpy as np
import pytest

import softdyn
import softdyn.compiled
from softdyn import SetPoint
from softdyn.controllers import CONTROLLERS, allocate
from softdyn.controllers.registry import make_controller
from softdyn.description.rig import Sensor, SensorKind
from softdyn.estimation import Ekf

pytestmark = pytest.mark.skipif(
    not softdyn.compiled.COMPILES, reason="Numba is absent: there is nothing to compile"
)
STEPS, PERIOD = 4, 0.005


def signatures() -> dict[str, int]:
    """The number of signatures of each of our kernels, compiled or read from a cache."""
    kind = softdyn.compiled.numba.core.registry.CPUDispatcher
    kernels = [each for each in gc.get_objects() if type(each) is kind]
    return {
        f"{each.__module__}.{each.__name__}": len(each.signatures)
        for each in kernels
        if each.__module__.startswith("softdyn.")
    }


@pytest.mark.parametrize("name", ["best", *sorted(CONTROLLERS)])
@pytest.mark.parametrize("which", ["finger", "spirob"])
def test_a_loop_compiles_nothing_after_its_first_step(which: str, name: str) -> None:
    """The finger has constant moment arms; SpiRob's change with q."""
    model = softdyn.load(which)
    controller = make_controller(name, model)
    tendon = model.robot.tendons[0].name
    sensors = (
        Sensor("length", SensorKind.LENGTH, tendon=tendon),
        Sensor("tip", SensorKind.POSITION, link=model.robot.task, rate=100.0, latency=0.005),
    )
    observer = Ekf(model, sensors)
    u = model.relaxed
    target = SetPoint(model.state(model.q0, np.zeros(model.nv)).y)
    controller.prepare(target)
    before: dict[str, int] = {}
    for k in range(STEPS):
        measured = model.state(0.01 * k + model.q0, 0.1 * k + np.zeros(model.nv))
        estimate = observer.step(PERIOD * k, [measured.lengths[0], *measured.y], u)
        state = model.state(estimate.q, estimate.v)
        u = controller(state, target).u
        if k == 0:
            before = signatures()
    assert signatures() == before


@pytest.mark.parametrize("which", ["finger", "spirob"])
def test_allocate_is_compiled_when_it_is_imported(which: str) -> None:
    model = softdyn.load(which)
    state, before = model.state(model.q0, np.zeros(model.nv)), signatures()
    allocate(model, state, np.ones(model.nv))
    assert signatures() == before
