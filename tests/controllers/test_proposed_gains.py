"""Gains proposed from a model: against the controller itself, and in closed loops on own arms."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigvalsh

import softdyn
from softdyn import SetPoint, SoftModel, design, statics
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.controllers.proposed_gains import SAMPLED, SINGULAR, _Place, advice, propose
from softdyn.controllers.safety_filter import with_barriers
from softdyn.safety import KeepOutSphere, Surroundings
from softdyn.validation import simulate
from tests.support import robots
from tests.support.arms import RUBBER, loaded
from tests.support.refused import refused
from tests.support.robots import TURRET

PERIOD = 0.004
PLANE = ("bend_y",)


def arm(
    name: str, length: float, stiffness: float, pull: float, planar: bool = False
) -> design.Arm:
    """Two sections with cables to the end of each; radii and offsets grow with the length (m)."""
    rubber = replace(RUBBER, youngs_modulus=stiffness)
    freedoms = PLANE if planar else ("bend_y", "bend_z")
    count, turn = (2, 0.0) if planar else (3, 0.5)
    return design.Arm(
        sections=tuple(
            design.Section(part * length, (r0 * length, r1 * length), rubber, 2,
                           freedoms, name=section)
            for section, part, r0, r1 in (("lower", 0.55, 0.07, 0.06), ("upper", 0.45, 0.06, 0.04))
        ),
        damping=design.Damping(ratio=0.12),
        cables=tuple(
            design.Cable(2 * np.pi * k / count + shift, offset * length, False, pull, 0, end,
                         name=f"cable_{end}_{k}")
            for end, shift, offset in ((0, turn, 0.05), (1, 0.0, 0.04))
            for k in range(count)
        ),
        name=name,
    )  # fmt: skip


ARMS = {
    "27 cm": arm("middle", 0.27, 0.3e6, 12.0),
    "81 cm": arm("large", 0.81, 1.5e6, 400.0),
    "in a plane": arm("planar", 0.16, 0.5e6, 8.0, planar=True),
}


@pytest.fixture(scope="module", params=ARMS)
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SoftModel:
    return loaded(ARMS[request.param], tmp_path_factory.mktemp("arms"))


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> SoftModel:
    return loaded(ARMS["in a plane"], tmp_path_factory.mktemp("planar"))


def bent(model: SoftModel) -> statics.Equilibrium:
    """An equilibrium with room to all bounds."""
    return statics.settle(model, np.linspace(0.1, 0.4, model.nu) * model.u_max)


@pytest.mark.parametrize("horizon", [0.0, 0.03])
def test_the_linearised_controller_is_the_controller_s_own(
    model: SoftModel, horizon: float
) -> None:
    """Differences of its inputs, between bounds so wide that none acts."""
    one = bent(model)
    wide = [replace(a, lower=-1e6, upper=1e6) for a in model.robot.actuators]
    free = softdyn.build(replace(model.robot, actuators=tuple(wide)))
    small = 0.01 / model.u_max.max() ** 2  # the terms that are left out grow with w3 u
    gains = Gains(Kp=60, eps=0.1, w2=1e-3, w3=small, w4=5e-4, null_damping=12)
    controller, n, step = SoftIdClfQp(free, gains, horizon=horizon), model.nv, 1e-5

    def u(x: np.ndarray) -> np.ndarray:
        return np.array(controller(free.state(one.q + x[:n], x[n:]), SetPoint(one.y)).u)

    G, c = _Place.of(one, PERIOD).over(horizon).feedback(gains)
    np.testing.assert_allclose(u(np.zeros(2 * n)), one.u + c, rtol=0, atol=1e-8 * one.u.max())
    rng = np.random.default_rng(1)
    for x in rng.normal(size=(4, 2 * n)):
        slope = (u(step * x) - u(-step * x)) / (2 * step)
        np.testing.assert_allclose(slope, G @ x, rtol=0, atol=0.02 * np.abs(slope).max())


def test_an_own_arm_reaches_its_targets_with_proposed_gains(model: SoftModel) -> None:
    """Equilibria other than those that the gains come from: within 1 cm, and 1 % of the length."""
    proposed = propose(model, PERIOD)
    assert proposed.decay > 0
    targets, duration = statics.spread_rests(model, 4, seed=5), 14 / np.sqrt(proposed.gains.Kp)
    for one in targets:
        controller = SoftIdClfQp(model, proposed.gains)
        log = simulate(model, controller, SetPoint(one.y), duration=duration, period=PERIOD)
        assert np.linalg.norm(log.error[-1]) < 0.01 * min(1.0, model.robot.length)
    assert len(targets) == 4


def test_a_run_among_far_obstacles_is_the_one_that_the_gains_are_for(model: SoftModel) -> None:
    """Equal to the bit: an obstacle switches no horizon on."""
    gains, goal = propose(model, PERIOD).gains, SetPoint(bent(model).y)
    ball = KeepOutSphere([9.0, 9.0, 9.0], 0.1, links="all", contact=False)
    runs = []
    for around in (None, Surroundings([ball])):
        law = with_barriers(SoftIdClfQp, around)(model, gains)
        assert law.horizon == 0
        runs.append(simulate(model, law, goal, duration=0.2, period=PERIOD))
    np.testing.assert_array_equal(runs[0].u, runs[1].u)


def test_the_room_is_what_bounds_leave_of_the_input_that_holds(model: SoftModel) -> None:
    """The corner of the bounds that moves the tip most, in each direction and its opposite."""
    one = bent(model)
    corners = np.array(list(product(*zip(model.u_min, model.u_max, strict=True))))
    moves = one.state.J @ np.linalg.solve(one.state.M, one.state.B)
    values, directions = np.linalg.eigh(moves @ moves.T)
    along = directions[:, values > SINGULAR**2 * values[-1]].T @ moves @ (corners - one.u).T
    expected = min(along.max(axis=1).min(), (-along).max(axis=1).min())
    found = _Place.of(one, PERIOD).room(model.u_min, model.u_max)
    assert found == pytest.approx(expected, rel=1e-9)
    assert np.abs(one.u).min() > 0


def test_the_advice_names_a_horizon_that_is_at_fault(tmp_path: Path) -> None:
    """Eight cables, four of them to the end: more than the tip has directions."""
    sections = arm("many", 0.14, 0.3e6, 15.0)
    cables = tuple(
        design.Cable(np.pi * (2 * k + end) / 4, 0.005, False, 15.0, 0, end, name=f"cable_{end}_{k}")
        for end in (0, 1) for k in range(4)
    )  # fmt: skip
    model = loaded(replace(sections, cables=cables), tmp_path)
    one, gains = bent(model), propose(model, PERIOD).gains
    assert "horizon" not in advice(one, gains, PERIOD)
    text = advice(one, gains, PERIOD, 0.02)
    assert "horizon of 20 ms makes the loop unstable" in text
    place = _Place.of(one, PERIOD)  # the same motion under the feedback over that horizon
    G, _ = place.over(0.02).feedback(gains)
    growth = np.log(np.abs(np.linalg.eigvals(place.step + place.push @ G)).max()) / PERIOD
    assert float(re.search(r"by (\S+) 1/s", text)[1]) == pytest.approx(growth, rel=0.06)


def test_a_long_period_bounds_the_gains(planar: SoftModel) -> None:
    found = propose(planar, 0.1)
    assert found.gains.Kp == pytest.approx((SAMPLED / 0.1) ** 2)
    assert "over the control period of 0.1 s" in found.reason


def test_the_advice_names_what_to_change(planar: SoftModel) -> None:
    one, good = bent(planar), propose(planar, PERIOD).gains
    assert "hold the tip there" in advice(one, good, PERIOD)
    assert "a smaller w3" in advice(one, replace(good, w3=1e3 * good.w3), PERIOD)
    assert "too large for a period of 0.004 s" in advice(one, replace(good, Kp=1e4), PERIOD)
    assert "too large for slow modes" in advice(one, replace(good, Kp=20 * good.Kp), PERIOD / 10)


def test_a_robot_without_inputs_is_refused(tmp_path: Path) -> None:
    bare = loaded(replace(ARMS["in a plane"], cables=()), tmp_path)
    with refused("model", "none"):
        propose(bare)


def test_a_direction_without_stiffness_has_no_frequency(tmp_path: Path) -> None:
    """A turret's slowest mode is that of its arm in the plane, which the turn does not enter."""
    model = robots.load(tmp_path, TURRET)
    found = propose(model, PERIOD)
    assert found.decay > 0
    one = statics.rest(model)
    K, M = one.stiffness[1:, 1:], one.state.M[1:, 1:]
    alone = np.sqrt(eigvalsh(K, M)[0])
    assert _Place.of(one, PERIOD).frequency == pytest.approx(alone)
    assert 0.5 * alone < found.slowest <= alone
    target = statics.spread_rests(model, 1, seed=3)[0].y
    log = simulate(
        model, SoftIdClfQp(model, found.gains), SetPoint(target), duration=3.0, period=PERIOD
    )
    assert np.linalg.norm(log.error[-1]) < 0.01 * model.robot.length
