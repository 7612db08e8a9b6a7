"""Every controller with an input whose bounds leave it one value, or almost none to choose from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softdyn import SetPoint
from softdyn.controllers.registry import make_controller
from softdyn.validation import simulate
from tests.support import robots

LAWS = ("soft-id-clf-qp", "id-clf-qp", "clf-qp", "ic", "uic", "ic-qp", "mpc")
BOUNDS = [
    (5.0, 5.0),
    (5.0, 5.0 + 1e-9),
    (5.0, 5.000001),
    (0.0, 1e-12),
    (0.0, 1e-6),
    (-20.0, -20.0 + 1e-9),
]


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("bounds", BOUNDS, ids=str)
def test_every_step_is_solved(tmp_path: Path, name: str, bounds: tuple[float, float]) -> None:
    model = robots.load(tmp_path, robots.preloaded(*bounds))
    table = None if name == "mpc" else {"Kp": 100.0, "eps": 0.1}
    for target in (robots.PRELOADED_TIP, (-0.05, 0.0, -0.19)):
        law = make_controller(name, model, table)
        log = simulate(model, law, SetPoint(target), duration=0.3)
        assert (log.not_solved, log.fallbacks) == (0, 0)
        assert log.max_bound_violation < 1e-13 * max(1.0, *map(abs, bounds))
        assert ((log.u[:, 1] >= bounds[0]) & (log.u[:, 1] <= bounds[1])).all()


@pytest.mark.parametrize("name", LAWS)
def test_almost_locked_is_locked(tmp_path: Path, name: str) -> None:
    table = None if name == "mpc" else {"Kp": 100.0, "eps": 0.1}
    logs = []
    for upper in (5.0, 5.0 + 1e-9):
        model = robots.load(tmp_path, robots.preloaded(5.0, upper))
        law = make_controller(name, model, table)
        logs.append(simulate(model, law, SetPoint(robots.PRELOADED_TIP), duration=0.2))
    np.testing.assert_allclose(logs[1].u[:, 0], logs[0].u[:, 0], atol=1e-5)
