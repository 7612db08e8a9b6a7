"""Recorded data: its rows, as the filter takes them."""

from __future__ import annotations

import numpy as np

from softdyn.estimation import Ekf, observe_data
from softdyn.estimation.recorded import read_rows
from tests.support.rigs import sensed


def test_a_row_has_the_commands_of_the_row_before(tmp_path):
    """A log's command acts from its row on; a filter needs the one that acted until its row."""
    model = sensed("finger")
    ekf = Ekf(model)
    readings = model.measure(model.state(model.q0, np.zeros(4)), np.zeros(2)).values
    inputs = np.array([[0.1, 0.0], [0.2, -0.1], [0.3, -0.2], [0.4, -0.3]])
    names = ["t", *(f"u.{one.name}" for one in model.robot.actuators)]
    names += [f"measured.{name}" for name in ekf.reading_names]
    rows = [[0.005 * k, *u, *readings] for k, u in enumerate(inputs)]
    path = tmp_path / "rows.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in [names, *rows]))
    found = read_rows(model, ekf.reading_names, path)
    sent = [np.zeros(2), *inputs[:-1]]
    assert np.array_equal(found.sent, sent)
    assert np.allclose(found.readings, readings)
    observed = observe_data(model, ekf, path)
    ekf.reset()
    alone = [ekf.step(0.005 * k, readings, u) for k, u in enumerate(sent)]
    assert np.array_equal(observed.estimates[-1].q, alone[-1].q)
