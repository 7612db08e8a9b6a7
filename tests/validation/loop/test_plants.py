"""Plants of one's own in the loop: with few methods, with or without a state of their own."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from softdyn import InputError
from softdyn.controllers.channels import LogChannel
from softdyn.validation import Log, rollout, simulate
from softdyn.validation.loop.loop import ControlLoop
from softdyn.validation.loop.plants import Plant
from softdyn.validation.twin.twin import SimulationError
from tests.support.cart import DAMPING, MASS, STIFFNESS, TARGET, steer
from tests.support.refused import refused


class Cart:
    """The cart by implicitfast's formulas; `shy` tells its position by a sensor alone."""

    alters_states, real_time = False, False

    def __init__(self, shy: bool, period: float = 0.01, stops: float = np.inf) -> None:
        self.shy, self.period, self.stops, self.t = shy, period, stops, 0.0
        self.sent, self.settings = np.zeros(1), {"contacts": False}
        self.channels = (
            LogChannel.of("measured", [("ruler", "m")]),
            LogChannel.of("warmth", [("motor", "K")], held=True),
        )

    def start(self, q, v, t=0.0, u=None):
        self.x, self.v, self.t = float(q[0]), float(v[0]), t

    def state(self):
        return None if self.shy else (np.array([self.x]), np.array([self.v]))

    def sample(self):
        return {"measured": np.array([self.x])}

    def see(self, state):
        return state

    def advance(self, u, steps, seen):
        h = self.period / steps
        for _ in range(steps):
            self.v += h * (u[0] - DAMPING * self.v - STIFFNESS * self.x) / (MASS + h * DAMPING)
            self.x += h * self.v
        self.t += self.period
        self.sent = u
        if self.t > self.stops:
            raise SimulationError(self.t, "the motor is hot")
        return {"warmth": 300.0 + self.t}


class Differences:
    """An observer: the velocity is the difference of two readings."""

    def reset(self):
        self.last = None

    def step(self, t, measured, sent):
        x, past = measured[0], self.last
        self.last = (t, x)
        v = 0.0 if past is None else (x - past[1]) / (t - past[0])
        return SimpleNamespace(q=np.array([x]), v=np.array([v]))


OPTIONS = {"duration": 1.0, "period": 0.01}


def test_a_plant_of_one_s_own_is_the_twin_and_records_its_quantities(cart):
    own = Cart(shy=False)
    assert isinstance(own, Plant)
    log, twin = (simulate(cart, steer, TARGET, plant=p, **OPTIONS) for p in (own, None))
    np.testing.assert_allclose(log.q, twin.q, atol=1e-13)
    np.testing.assert_array_equal(log.measured[:, 0], log.q[:, 0])
    assert log.sensor_names == ("ruler",)
    np.testing.assert_allclose(log.warmth[:, 0], 300.0 + log.t[1:], atol=1e-12)


@pytest.mark.parametrize("file", ["run.npz", "run.csv"])
def test_a_quantity_of_a_plant_is_in_its_log_s_files(cart, tmp_path, file):
    """It is declared and given by the plant alone; nothing else names it."""
    log = simulate(cart, steer, TARGET, plant=Cart(shy=False), **OPTIONS)
    log.to_csv(tmp_path / file) if file.endswith("csv") else log.save(tmp_path / file)
    again = Log.from_csv(tmp_path / file) if file.endswith("csv") else Log.load(tmp_path / file)
    np.testing.assert_array_equal(again.warmth, log.warmth)
    assert again.columns("warmth") == (("motor", "K"),)
    if file.endswith("csv"):
        assert "warmth.motor (K)" in (tmp_path / file).read_text()


def test_a_channel_may_not_hide_a_part_of_the_log(cart):
    own = Cart(shy=False)
    own.channels = (*own.channels, LogChannel("summary"))
    with refused("channels", "summary"):
        simulate(cart, steer, TARGET, plant=own, **OPTIONS)


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({"heat": 3.0}, "values of a run"), ({"warmth": [1.0, 2.0]}, "values of a run: warmth"),
        ({"warmth": "hot"}, "values of a run: warmth"),
    ],
)  # fmt: skip
def test_a_plant_s_value_of_no_channel_or_of_another_shape_is_one_line(cart, given, name):
    own = Cart(shy=False)
    own.advance = lambda u, steps, seen: given
    with pytest.raises(InputError) as caught:
        simulate(cart, steer, TARGET, plant=own, **OPTIONS)
    assert caught.value.name == name
    assert caught.value.log.steps == 0


def test_a_loop_is_stepped_without_a_record(cart):
    log = simulate(cart, steer, TARGET, plant=Cart(shy=False), **OPTIONS)
    loop = ControlLoop(cart, Cart(shy=False), steer)
    loop.plant.start(log.q[0], log.v[0])
    for k, t in enumerate(log.t[:-1].tolist()):
        loop.step(t, TARGET(t), 20)
        np.testing.assert_array_equal(loop.state.q, log.q[k])
        np.testing.assert_array_equal(loop.u, log.u[k])


def test_a_plant_without_a_state_needs_an_observer_and_the_log_has_its_estimates(cart):
    log = simulate(cart, steer, TARGET, plant=Cart(True), observer=Differences(), **OPTIONS)
    assert log.complete
    np.testing.assert_array_equal(log.q[:, 0], log.measured[:, 0])
    np.testing.assert_allclose(np.diff(log.q[:, 0]), 0.01 * log.v[1:, 0], atol=1e-12)
    with refused("observer", "none"):
        simulate(cart, steer, TARGET, plant=Cart(True), **OPTIONS)


def test_a_plant_that_stops_ends_the_run_with_its_reason(cart):
    log = simulate(cart, steer, TARGET, plant=Cart(False, stops=0.055), **OPTIONS)
    assert (log.steps, log.complete) == (6, False)
    assert log.reason.endswith("the motor is hot")
    assert np.isfinite(log.q).all()


def test_a_rollout_moves_it_too(cart):
    log = rollout(cart, [2.0], 0.5, period=0.01, plant=Cart(shy=False))
    np.testing.assert_allclose(log.q, rollout(cart, [2.0], 0.5, period=0.01).q, atol=1e-13)
    tip = " ".join(f"{x:.6g}" for x in log.y[-1])
    assert log.summary().splitlines()[:2] == [
        f"{log.robot}, rollout of 0.5 s", f"tip at the end {tip} m",
    ]  # fmt: skip


def test_an_unknown_argument_is_refused_with_the_one_that_is_meant(cart):
    with refused("options: durration", "'durration'; did you mean 'duration'?"):
        simulate(cart, steer, TARGET, durration=1.0)
    with refused("rig", "one"):
        simulate(cart, steer, TARGET, plant=Cart(False), rig="file")
