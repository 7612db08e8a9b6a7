"""A controller gets lag, delay and friction of the plant that it will drive."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel
from softdyn.controllers import (
    Compensated,
    Mpc,
    SafetyFilter,
    SoftIdClfQp,
    Staged,
    best,
)
from softdyn.safety import HalfSpace
from softdyn.validation import Rig, paper, simulate
from softdyn.validation.loop.plants import IdealPlant
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin

DOCS = Path(__file__).parents[2] / "docs"
GAINS = SoftIdClfQp(softdyn.load("finger")).gains
GOAL = paper.set_point("finger", theta=0.5)
FAR = HalfSpace([0.0, 0.0, 1.0], -5.0)
LAG, DELAY, LATE = 0.02, 0.01, 0.005  # s; the control period of the finger is 5 ms


@pytest.fixture(scope="module")
def lagging() -> SoftModel:
    """The finger with motors that lag, late cables that rub, in its file."""
    robot = softdyn.load("finger").robot
    actuators = tuple(replace(a, lag=LAG, delay=DELAY) for a in robot.actuators)
    tendons = tuple(replace(t, friction=0.1) for t in robot.tendons)
    return softdyn.build(replace(robot, actuators=actuators, tendons=tendons))


def inputs(model: SoftModel, law: Any, **options: Any) -> np.ndarray:
    return simulate(model, law, GOAL, duration=0.1, **options).u


MAKES = {
    "mpc": Mpc,
    "best": best,
    "compensated": lambda model, **link: Compensated(SoftIdClfQp(model, GAINS), model, **link),
    "filtered": lambda model, **link: SafetyFilter(Mpc(model, **link), model, [FAR]),
}


@pytest.mark.parametrize("make", MAKES.values(), ids=MAKES)
def test_a_controller_knows_the_plant_and_not_the_file(make: Any, lagging: SoftModel) -> None:
    ideal = {"lag": 0.0, "delay": 0.0, "friction": 0.0}
    np.testing.assert_array_equal(
        inputs(lagging, make(lagging)), inputs(lagging, make(lagging, **ideal))
    )
    real = {"lag": 0.05, "delay": DELAY + LATE, "friction": 0.1}
    rig = Rig(lag=0.05, latency=LATE)
    law = make(lagging)  # one controller after the other plant
    inputs(lagging, law)
    np.testing.assert_array_equal(
        inputs(lagging, law, rig=rig), inputs(lagging, make(lagging, **real), rig=rig)
    )


@pytest.mark.parametrize("make", MAKES.values(), ids=MAKES)
def test_what_the_user_gave_is_kept(make: Any, lagging: SoftModel) -> None:
    given = {"lag": 0.01, "delay": 0.0, "friction": 0.0}
    law = make(lagging, **given)
    inner = getattr(law, "inner", law)
    link = inner if isinstance(inner, Mpc) else law
    simulate(lagging, law, GOAL, duration=0.02)
    assert (link.actuation.lag, link.actuation.delay) == (0.01, 0.0)
    simulate(lagging, law, GOAL, duration=0.02, rig="file")
    assert (link.actuation.lag, link.actuation.delay) == (0.01, 0.0)
    assert not link._pulls.rubs


def test_without_a_plant_the_file_says_it(lagging: SoftModel) -> None:
    law = best(lagging)
    assert (law.actuation.lag, law.actuation.delay, law._pulls.rubs) == (LAG, DELAY, True)
    simulate(lagging, law, GOAL, duration=0.02)
    assert (law.actuation.lag, law.actuation.delay, law._pulls.rubs) == (0.0, 0.0, False)
    law.reset(0.005)
    assert (law.actuation.lag, law.actuation.delay, law._pulls.rubs) == (LAG, DELAY, True)


def test_friction_of_the_plant_alone(lagging: SoftModel) -> None:
    law = best(lagging)
    simulate(lagging, law, GOAL, duration=0.02, friction=True)
    assert law._pulls.rubs
    assert law.actuation.lag == 0.0


def test_an_observer_makes_up_for_late_states(lagging: SoftModel) -> None:
    law = best(lagging)
    simulate(lagging, law, GOAL, duration=0.02, rig=Rig(latency=LATE))
    assert law.actuation.delay == DELAY + LATE


def test_a_tuned_schedule_serves_actuators_that_act_at_once() -> None:
    model = softdyn.load("spirob")
    law = best(model)
    goal = paper.set_point("spirob", theta=0.5)
    kinds: list[tuple[dict[str, Any], type]] = [
        ({}, Staged), ({"rig": Rig(lag=0.01)}, Mpc), ({"rig": Rig(friction=0.1)}, Compensated),
        ({"rig": Rig()}, Staged),
    ]  # fmt: skip
    for options, kind in kinds:
        log = simulate(model, law, goal, duration=0.02, **options)
        assert type(law.inner) is kind
        assert log.controller == "best"


@pytest.mark.parametrize("given", [{}, {"rig": Rig(lag=LAG, delay=DELAY, latency=LATE)}])
def test_a_user_s_controller_may_ask_for_the_rig(given: dict[str, Any]) -> None:
    class Plain:
        told: Any = None

        def reset(self, period: float) -> None:
            self.told = period

        def __call__(self, state: Any, reference: Any) -> np.ndarray:
            return np.zeros(2)

    class Asking(Plain):
        def reset(self, period: float, rig: Any = None) -> None:
            self.told = period, rig.lag, rig.delay, rig.friction

    model = softdyn.load("finger")
    wanted = (LAG, DELAY + LATE, None) if given else (0.0, 0.0, None)
    for law in (Plain(), Asking()):
        wrapped = SafetyFilter(law, model, [FAR])
        for one in (law, wrapped):
            law.told = None
            simulate(model, one, GOAL, duration=0.02, **given)
            assert law.told == (0.005 if type(law) is Plain else (0.005, *wanted))


def test_a_plant_that_says_nothing_is_the_file_s(lagging: SoftModel) -> None:
    engine = Twin(lagging)
    own = IdealPlant(engine, StateMap(lagging, engine), False)
    own.known = None  # type: ignore[assignment]
    law = best(lagging)
    simulate(lagging, law, GOAL, duration=0.02, plant=own)
    assert law.actuation.lag == LAG


def test_a_scene_has_its_own_lag(lagging: SoftModel, tmp_path: Path) -> None:
    text = (DOCS / "examples" / "finger_scene.xml").read_text()
    law = best(lagging)
    for lag in (0.0, 0.03):
        file = tmp_path / "finger.xml"
        dynamics = f'dyntype="filterexact" dynprm="{lag}"' if lag else ""
        file.write_text(text.replace("<motor ", f"<general {dynamics} "))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the file's lag is another
            simulate(lagging, law, GOAL, duration=0.02, plant=file)
        assert law.actuation.lag == lag
