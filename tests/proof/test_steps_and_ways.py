"""The programs of steps and ways run, their iLQR goes downhill, and an LQR holds a rest."""

from __future__ import annotations

from typing import Any

import numpy as np

import softdyn
from softdyn import statics
from softdyn.controllers import MpcParameters
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.validation import simulate
from tests.proof import discrete_steps, lost_cells, shortest_way


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


def test_feedback_of_all_joints_holds_a_rest():
    model, u = softdyn.load("finger"), np.array([0.05, 0.1])
    there = statics.settle(model, u)
    rest = RestTarget(there.q, u, True, 0.0)
    feedback: Any = lost_cells.ShapeFeedback(model, rest, 0.005)
    goal, start = softdyn.SetPoint(there.y), there.q + 0.05
    held = simulate(model, feedback, goal, q0=start, duration=0.5, period=0.005)
    free = simulate(model, lambda *_: u, goal, q0=start, duration=0.5, period=0.005)
    assert held.final_error_cm < 0.5 * free.final_error_cm
