"""The programs of steps and ways run, and their iLQR goes downhill."""

from __future__ import annotations

import numpy as np

import softdyn
from softdyn.controllers import MpcParameters
from tests.proof import discrete_steps, shortest_way


def test_steps_of_a_random_robot_are_compared(capsys):
    assert discrete_steps.main(["--robots", "2", "--states", "1", "--steps", "2"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows[0].startswith("A and B: 2 random robots, 1 states each")
    assert max(map(float, rows[2].split())) < 1e-7


def test_the_plan_of_the_full_model_is_better_than_its_first_guess():
    model = softdyn.load("finger")
    solver = shortest_way._Ilqr(model, softdyn.SetPoint([0.15, 0.0, -0.1]), MpcParameters())
    start, u = (model.q0, np.zeros(4), np.zeros(2)), np.zeros((12, 2))
    found = solver.solve(start, u, 4, 1e-3)
    assert found.cost < 0.9 * solver.forward(start, u).cost
    assert (np.abs(found.u) <= model.u_max).all()
    again = solver.forward(start, found.u)
    assert again.cost == np.float64(found.cost)
