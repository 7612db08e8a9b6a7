"""The rig between plant and controller: an ideal one, noise, bias, a delay."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import SetPoint
from softdyn.actuation import Winches
from softdyn.validation import Rig, simulate
from softdyn.validation.twin.rig import RiggedPlant
from softdyn.validation.twin.twin import Twin
from tests.support import robots
from tests.support.control_cases import robot
from tests.support.refused import refused


def test_an_ideal_rig_is_no_rig_to_the_bit_at_the_stops_too(tmp_path) -> None:
    """Also for a file with a rig, which `file=False` leaves out."""
    model = robots.load(tmp_path, robots.WINCHED)
    pull = lambda state, _: np.array([60.0, 0.0] if state.q[0] < 1 else [0.0, 60.0])  # noqa: E731
    plain, same, rigged = (
        simulate(model, pull, SetPoint(np.zeros(3)), duration=1.0, rig=rig)
        for rig in (None, Rig(file=False), Rig())
    )
    assert plain.q.max() > 1.19  # a stop
    np.testing.assert_array_equal(plain.q, same.q)
    np.testing.assert_array_equal(same.acting[1:], same.u)
    assert same.measured.size == 0 < rigged.measured.size
    assert np.abs(plain.q - rigged.q).max() > 0.01


def test_noise_moves_the_tip_by_its_size_and_the_velocity_by_that_over_a_period() -> None:
    model, period = robot("finger"), 0.005
    state = model.state(model.q0, np.zeros(model.nv))

    def seen(rig: Rig, count: int) -> list[softdyn.State]:
        plant = RiggedPlant(rig, model, period)
        return [plant.see(state) for _ in range(count)]

    states = seen(Rig(noise=0.001, seed=1), 2000)
    moved = np.array([one.y - state.y for one in states])
    assert np.sqrt(np.mean(np.sum(moved**2, axis=1))) == pytest.approx(0.001, rel=0.05)
    q, v = (np.array([getattr(one, name) for one in states]) for name in "qv")
    np.testing.assert_allclose(np.std(v), np.std(q - state.q) / period, rtol=0.05)
    assert abs(np.corrcoef(q[:, 0], v[:, 0])[0, 1]) < 0.1
    assert seen(Rig(), 1) == [state]
    # a bias is one draw of such a noise for a whole run, and leaves q̇ alone
    biased = [seen(Rig(bias=0.001, seed=k), 2) for k in range(200)]
    moved = np.array([run[0].y - state.y for run in biased])
    assert np.sqrt(np.mean(np.sum(moved**2, axis=1))) == pytest.approx(0.001, rel=0.2)
    for first, second in biased:
        np.testing.assert_array_equal(first.q, second.q)
        np.testing.assert_array_equal(first.v, state.v)


def test_the_plant_gets_the_delayed_input_in_the_middle_of_a_period() -> None:
    """5 ms of delay in periods of 7.5 ms: the input changes between two plant steps."""
    model = robot("finger")
    plant = RiggedPlant(Rig(delay=0.005), model, 0.0075, timestep=5e-4)
    start = model.state(model.q0, np.zeros(model.nv))
    plant.start(start.q, start.v)
    by_hand = Twin(model.robot, timestep=5e-4)
    commands = np.array([[-0.1, -0.3], [-0.2, 0.4]])
    for u in commands:
        plant.advance(u, 15, start)
    for u, steps in zip((np.zeros(2), *commands), (10, 15, 5), strict=True):
        by_hand.advance(u, steps)
    np.testing.assert_array_equal(plant.twin.qpos, by_hand.qpos)
    np.testing.assert_array_equal(plant.twin.qvel, by_hand.qvel)


def test_a_velocity_leads_to_the_free_length_in_one_period(tmp_path) -> None:
    model, period = robots.load(tmp_path, robots.WINCHED), 0.01
    rig = Rig(command="velocity", stiffness=600.0, lag=0.0, delay=0.0)
    plant = RiggedPlant(rig, model, period, timestep=5e-4)
    state = model.state(np.array([0.2, -0.1]), np.array([0.5, 0.3]))
    plant.start(state.q, state.v)
    before, u = plant.twin.free_lengths.copy(), np.array([40.0, 10.0])
    plant.advance(u, 20, state)
    wanted = Winches(model, plant.twin.robot.actuators).commands(state, u)
    assert np.abs(wanted - before).min() > 0.01
    np.testing.assert_allclose(plant.twin.free_lengths, wanted, rtol=1e-9)


@pytest.mark.parametrize("name", ["lag", "delay", "latency"])
def test_times_in_milliseconds_are_doubted(name: str) -> None:
    with refused(name, "25: in ms?"):
        Rig(**{name: 25})
    with pytest.warns(UserWarning, match=f"rig: {name} of 2 s is 400 control periods: in ms"):
        RiggedPlant(Rig(**{name: 2.0}), softdyn.load("finger"), 0.005)
