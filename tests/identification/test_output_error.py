"""Identification from MuJoCo's motion, and its parts against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg

import softdyn
from softdyn import identification
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.derivatives import mass_columns
from softdyn.dynamics.tree import tree_of
from softdyn.identification import Measurements, blocks, dynamic_fit
from softdyn.identification.data import cut, gaps, stretches
from softdyn.identification.linear import first_guess, near_file
from softdyn.identification.output_error import make_problem
from softdyn.identification.outputs import compute_outputs
from softdyn.identification.parameters import Parameter, apply_values, columns_of
from softdyn.identification.problem import Acquisition
from softdyn.identification.result import COARSE
from softdyn.identification.unknowns.kinds import Around, MotionSample
from softdyn.validation.identification.trials import Excitation, deviations, trial, twin_data
from tests.support import cart, robots
from tests.support.refused import refused

COMPLIANCE = ("stiffness", "damping")


def unknowns(model: softdyn.SoftModel, *kinds: str) -> list[Parameter]:
    return [one for kind in kinds for one in identification.parameters(model, kind)]


@pytest.fixture(scope="module")
def finger() -> softdyn.SoftModel:
    return softdyn.load("finger")


@pytest.fixture(scope="module")
def spirob() -> softdyn.SoftModel:
    return softdyn.load("spirob")


@pytest.fixture(scope="module")
def helix() -> softdyn.SoftModel:
    return softdyn.load("helix")


def residual(model, q, v, a, u):
    state, of_file = model.state(q, v), {one.name: one for one in model.robot.moving_joints}
    sizes = np.array([of_file[name].friction for name in model.joint_names])
    dry = sizes * np.tanh(v / (0.01 * (model.upper - model.lower)))
    return state.M @ a + state.h - state.B @ u + dry


@pytest.mark.parametrize("robot", ["finger", "spirob"])
def test_the_residual_s_derivatives(robot, request):
    model = request.getfixturevalue(robot)
    rng = np.random.default_rng(3)
    q, v, a = rng.uniform(-0.3, 0.3, (3, model.nv))
    u = rng.uniform(model.u_min, model.u_max)
    _, by_q, by_v, *_ = ForceBalance(model, motors=())(q, v, a, u)
    assert np.isfinite([by_q, by_v]).all()  # they scale the tolerance
    for k, e in enumerate(np.eye(model.nv) * 1e-6):
        left = (residual(model, q + e, v, a, u) - residual(model, q - e, v, a, u)) / 2e-6
        right = (residual(model, q, v + e, a, u) - residual(model, q, v - e, a, u)) / 2e-6
        assert np.allclose(by_q[:, k], left, atol=1e-6 * np.abs(by_q).max())
        assert np.allclose(by_v[:, k], right, atol=1e-6 * np.abs(by_v).max())


# numbers of Maxwell branches have no column: their torques are a part of the motion's state
COLUMNS = [
    name
    for name, kind in identification.KINDS.items()
    if not kind.rebuilds and not name.startswith("relaxation")
]
ELSEWHERE = "cable_friction", "area_growth"  # of equilibria, and of chambers


@pytest.mark.parametrize("kind", [name for name in COLUMNS if name not in ELSEWHERE])
def test_each_kind_s_column_is_a_difference_of_two_robots(kind, tmp_path):
    text = (softdyn.load("finger").robot.path).read_text()
    text = text.replace('<tendon name="', '<tendon stiffness="2" damping="0.1" name="')
    text = text.replace("<dynamics ", '<dynamics friction="1e-3" ')
    rest = '<joint name="joint1" armature="1e-3"/><sensor name="s" type="joint" joint="joint1"/>'
    text = text.replace("</softdyn>", f"{rest}</softdyn>")
    path = robots.write(tmp_path, text)
    model = softdyn.load(path)
    rng = np.random.default_rng(4)
    q, v, a = rng.uniform(-1, 1, (3, model.nv))
    u = rng.uniform(model.u_min, model.u_max)
    several = identification.parameters(model, kind)
    columns = columns_of(
        several, MotionSample(model.state(q, v), a, u, Around(model)), len(several)
    )
    nominal = np.array([one.nominal for one in several])
    for k in range(len(several)):
        step = np.zeros(len(several))
        step[k] = 1e-3 * max(abs(nominal[k]), 1)
        sides = [residual(apply_values(model, several, nominal + s * step), q, v, a, u)
                 for s in (1, -1)]  # fmt: skip
        difference = (sides[0] - sides[1]) / (2 * step[k])
        assert np.allclose(columns[:, k], difference, rtol=1e-7, atol=1e-9)


def test_the_bodies_carry_all_of_the_inertial_force(spirob):
    rng = np.random.default_rng(5)
    q, v, a = rng.uniform(-0.5, 0.5, (3, spirob.nv))
    tree = tree_of(spirob)
    whole = pin.rnea(tree.pin_model, tree.pin_data, q, v, a) - spirob.armature * a
    assert np.allclose(mass_columns(spirob, q, v, a).sum(1), whole, rtol=1e-10)


def test_outputs_of_tip_and_cables(spirob):
    rng = np.random.default_rng(7)
    path = rng.uniform(-0.3, 0.3, (2, spirob.nv))
    names = ["tip.z", f"length.{spirob.tendons.names[1]}", f"q.{spirob.joint_names[5]}"]
    by = np.broadcast_to(np.eye(spirob.nv), (2, spirob.nv, spirob.nv))
    _, slope = compute_outputs(spirob, names, path, by)
    for k, e in enumerate(np.eye(spirob.nv) * 1e-6):
        sides = [compute_outputs(spirob, names, path + s * e, by)[0] for s in (1, -1)]
        assert np.allclose(slope[:, :, k], (sides[0] - sides[1]) / 2e-6, atol=1e-7)


def test_noisy_joints_of_a_twin_tell_stiffness_and_damping(finger):
    one = trial(finger, unknowns(finger, *COMPLIANCE), [f"q.{n}" for n in finger.joint_names],
                Excitation(1.0, timestep=5e-4), 1.0, 0)  # fmt: skip
    assert np.isfinite(one.relative).all()
    assert np.abs(one.relative).max() < 0.05
    assert np.abs(one.scores).max() < 4
    assert one.found.white > 1e-3
    assert one.found.noise == pytest.approx(0.005, rel=0.15)
    assert one.found.held_out < 2


def test_without_noise_the_error_falls_with_the_step(finger):
    """The model's step matters; the plant's Runge-Kutta error at 0.1 ms is below both errors."""
    several = [one for kind in COMPLIANCE
               for one in identification.parameters(finger, kind, shared=True)]  # fmt: skip
    joints = [f"q.{n}" for n in finger.joint_names]
    errors = []
    for step in (np.inf, 2e-3):
        one = trial(finger, several, joints, Excitation(1.0, amplitude=1.0), 0.0, 6, step)
        errors.append(np.abs(one.relative).max())
        left_out = np.isnan(one.found.residuals).mean()
        assert 0.2 < left_out < 0.5  # a joint reaches its stop, without harm to the fit
    assert errors[0] < 3e-3
    assert errors[1] < min(1e-4, 0.1 * errors[0])
    assert one.found.moved > 1  # without other errors, the step's error remains


def test_the_tip_alone_until_a_joint_comes_to_its_stop(finger):
    several = [one for kind in ("stiffness", "damping", "mass")
               for one in identification.parameters(finger, kind, shared=True)]  # fmt: skip
    tip = ("tip.x", "tip.y", "tip.z")
    excitation = Excitation(1.2, rate=100.0, amplitude=1.0, timestep=5e-4)
    one = trial(finger, several, tip, excitation, 1.0, 0)
    assert np.abs(one.relative).max() < 0.1
    assert np.abs(one.scores).max() < 4
    assert one.found.noise == pytest.approx(0.001, rel=0.3)
    some = (
        "q.joint1",
        "q.joint2",
        "q.joint3",
        "tip.x",
    )  # the twin's own outputs, not all joints, so from rest, too
    seen, _ = twin_data(finger, several, some, excitation, 0.0, 0)
    at_stop = np.abs(seen.outputs[:, :3]).max(1) > 0.96 * np.pi / 2
    assert abs(np.isfinite(one.found.residuals).all(1).sum() - np.argmax(at_stop)) <= 3


def swings(seconds, dt, output, noise):
    """A cart's data in closed form, and its model with a spring four times as stiff."""
    k, d = 15.0, 0.1
    t, rng = np.arange(0, seconds, dt), np.random.default_rng(0)
    u = np.repeat(rng.uniform(-3, 3, round(seconds / 0.2)), round(0.2 / dt))
    u[0] = 0.0
    first = np.array([[0, 1, 0], [-k / cart.MASS, -d / cart.MASS, 1 / cart.MASS], [0, 0, 0]])
    step, state, path = scipy.linalg.expm(dt * first), np.zeros(3), []
    for state[2] in u:
        path.append(state[0])
        state = step @ state
    values = np.array(path) + noise * rng.standard_normal(len(t))
    model = cart.cart(stiffness=4 * k, damping=d)
    return model, Measurements(t, u[:, None], (output,), values[:, None])


def test_coloured_residuals_widen_the_intervals():
    """By the root of 1 + 2 Σ w ρ over what white noise of that size would leave."""
    model, data = swings(2.4, 0.04, "q.x", 0.0)
    noise, rng = np.zeros(len(data.t)), np.random.default_rng(2)
    for k in range(1, len(noise)):
        noise[k] = 0.8 * noise[k - 1] + 1e-3 * rng.standard_normal()
    data = replace(data, outputs=data.outputs + noise[:, None])
    model = apply_values(model, identification.parameters(model, "stiffness"), np.array([15.0]))
    several = identification.parameters(model, "stiffness")
    found = identification.identify(model, data, several, hold_out=0)
    rho, size = found.autocorrelation[:, 0], np.isfinite(found.residuals).sum()
    weights = 1 - np.arange(1, len(rho) + 1) / (len(rho) + 1)
    factor = (1 + 2 * (weights * rho)[np.abs(rho) > 2 / size**0.5].sum()) ** 0.5
    theta = np.array([found.estimates[0].value])
    white = identification.least_deviations(model, data, several, theta, found.noise, hold_out=0)
    assert factor > 1.2
    for chance, marked in ((0.2, False), (1e-3, True)):  # the probability that they are white
        one = replace(found, white=chance)
        assert ("(?)" in str(one).splitlines()[0]) == marked
        assert one.report()["parameters"][0]["white"] != marked
    assert found.estimates[0].deviation == pytest.approx(factor * white[0], rel=0.02)


def test_far_from_the_file_s_values():
    """With the file's spring, the cart is 2 swings ahead after 2 s, and 8 at the end.

    A fit that begins with 2 s of data ends at wrong parameters.
    """
    model, data = swings(8, 0.04, "tip.x", 0.001)
    data = replace(data, outputs=data.outputs + cart.LENGTH)
    several = [one for kind in (*COMPLIANCE, "mass")
               for one in identification.parameters(model, kind, shared=True)]  # fmt: skip
    found = identification.identify(model, data, several)
    for one, truth in zip(found.estimates, (0.25, 1.0, 1.0), strict=True):
        assert one.value == pytest.approx(truth, rel=0.02)
        assert abs(one.value - truth) < 4 * one.deviation


@pytest.mark.parametrize(("stiffness", "damping"), [(1e-7, 1e-8), (3e5, 300.0), (0, 0), (12, 0)])
def test_a_first_guess_off_by_decades_is_found_from_the_data(stiffness, damping):
    """The truth of the closed form is 15 N/m and 0.1 N s/m."""
    _, data = swings(3, 0.01, "q.x", 2e-5)
    model = cart.cart(stiffness=stiffness, damping=damping)
    found = identification.identify(model, data, unknowns(model, *COMPLIANCE))
    assert not found.unidentifiable
    for one, truth in zip(found.estimates, (15.0, 0.1), strict=True):
        assert abs(one.value - truth) < 3 * one.deviation
        assert one.value == pytest.approx(truth, rel=0.01)
    if damping:
        assert f"file times {found.estimates[0].value / stiffness:.3g}" in str(found)


def test_rows_at_rest_need_a_first_guess_in_the_file():
    model = cart.cart(stiffness=0, damping=0)
    push = np.linspace(-2, 2, 12)[:, None]
    data = Measurements(np.arange(12.0), push, ("q.x",), push / 20)
    with refused("stiffness x", "none of it"):
        identification.identify(
            model, data, unknowns(model, "stiffness"), acquisition=Acquisition(static=True)
        )


def test_a_gap_in_the_rows_is_stepped_through_at_their_usual_distance():
    """A force that stays, from rest: rows of 0.6 s are lost, 0.5 s after the begin."""
    t, rng = np.arange(0, 3, 0.01), np.random.default_rng(3)
    k, c, m, force = 20.0, 0.6, cart.MASS, 2.0
    decay, rate = c / (2 * m), (k / m - (c / (2 * m)) ** 2) ** 0.5
    swung = np.cos(rate * t) + decay / rate * np.sin(rate * t)
    x = force / k * (1 - np.exp(-decay * t) * swung) + 2e-5 * rng.standard_normal(len(t))
    keep = np.flatnonzero((t < 0.5) | (t > 1.1))
    data = Measurements(t, np.full((len(t), 1), force), ("q.x",), x[:, None]).rows(keep)
    assert not gaps(data).size  # the input is known in it
    model = cart.cart(stiffness=15, damping=0.4)
    found = identification.identify(model, data, unknowns(model, *COMPLIANCE))
    for one, truth in zip(found.estimates, (k, c), strict=True):
        assert one.interval[0] < truth < one.interval[1]
        assert one.half < 0.01 * truth
    assert not found.coloured


def test_a_gap_in_which_the_input_changed_cuts_the_run_and_is_said():
    model, data = swings(3, 0.01, "q.x", 2e-5)
    data = data.rows(np.flatnonzero((data.t < 1.05) | (data.t > 1.75)))
    after = int(np.searchsorted(data.t, 1.05))
    assert gaps(data).tolist() == [after - 1]
    found = identification.identify(model, data, unknowns(model, *COMPLIANCE), hold_out=0)
    assert found.fit.problem.runs == ((0, after), (after, len(data.t)))
    for one, truth in zip(found.estimates, (15.0, 0.1), strict=True):
        assert abs(one.value - truth) < 3 * one.deviation
    (line,) = identification.doubts(found)
    assert "1 gap" in line
    assert cut([(0, 30), (40, 90)], np.array([10, 60])) == [(11, 30), (40, 61), (61, 90)][1:]


def test_pieces_keep_in_step_where_the_whole_does_not(monkeypatch):
    """From a spring twice as stiff, a fit of the whole run fails, and a fit by pieces succeeds."""
    monkeypatch.setattr(dynamic_fit, "PIECE", 13)
    monkeypatch.setattr(blocks, "EVALUATIONS", 5)
    model, data = swings(4, 0.04, "q.x", 0.001)
    problem = make_problem(model, data, unknowns(model, "stiffness"), np.inf)
    assert problem.runs == ((0, 100),)
    wrong, noise = np.array([30.0]), np.array([0.001])
    ends = []
    for theta, firsts in ((wrong, problem.firsts()), problem.joined(wrong)[:2]):
        theta, _, simulated = problem.solved(theta, firsts, noise)
        ends.append((theta[0], np.std(problem.residuals(simulated))))
    assert ends[0][1] > 0.1
    assert ends[1][1] == pytest.approx(0.001, rel=0.1)
    assert ends[1][0] == pytest.approx(15.0, rel=1e-3)


@pytest.fixture(scope="module")
def moved(helix):
    """Joint data of the helix under small inputs without noise, and its true model."""
    several = unknowns(helix, *COMPLIANCE)
    joints = [f"q.{n}" for n in helix.joint_names]
    excitation = Excitation(0.25, amplitude=0.02, at_rest=True)
    data, theta = twin_data(helix, several, joints, excitation, 0.0, 0)
    return data, apply_values(helix, several, theta)


def with_noise(data, size):
    noise = size * np.random.default_rng(0).standard_normal(data.outputs.shape)
    return replace(data, outputs=data.outputs + noise)


def left(model, data, size):
    """Residuals of the true parameters with fitted first states, over the size (outputs,)."""
    exact = make_problem(model, data, (), np.inf)
    assert exact.held.sum() == 10
    _, _, simulated = exact.solved(np.zeros(0), exact.firsts(), size)
    return exact.residuals(simulated) / size


def test_first_rates_that_die_at_once_do_not_lead_the_fit_astray(moved):
    """With the true parameters only the first states are fitted, and only the noise remains.

    The helix' joints lose their velocity within 0.1 ms. Ten of them are fixed at their stops.
    """
    data, true = moved
    size = deviations(true, data.names)
    found = left(true, with_noise(data, size), size)
    count = np.isfinite(found).sum()
    assert abs(np.nansum(found**2) / count - 1) < 4 * np.sqrt(2 / count)


def test_a_stop_that_yields_is_followed_where_that_can_be_seen(moved, monkeypatch):
    """Without noise, all outputs show the micrometres by which the fixed joints move."""
    data, true = moved
    size = deviations(true, data.names)
    for one, moves in ((data, True), (with_noise(data, size), False)):
        seen = make_problem(true, one, (), np.inf)
        spread = np.ptp(seen._driven(seen.runs[0]).motion.c, axis=0)
        assert np.all((spread > 1e-9) == moves)
    followed = np.nanstd(left(true, data, size))
    monkeypatch.setattr(dynamic_fit, "CLEAR", np.inf)
    assert followed < 0.5 * np.nanstd(left(true, data, size))


def test_a_first_guess_from_the_data_and_one_within_a_factor_of_ten_of_the_file(finger):
    """Exact motion of robots whose springs are 0.01 to 100 times as stiff as in the file."""
    springs, rng = unknowns(finger, "stiffness"), np.random.default_rng(4)
    nominal = np.array([one.nominal for one in springs])
    factors = np.array([0.01, 0.5, 3.0, 100.0])
    true = apply_values(finger, springs, factors * nominal)
    q, v = rng.uniform(-0.3, 0.3, (2, 50, 4))
    u = rng.uniform(finger.u_min, finger.u_max)
    a = np.array([true.forward_dynamics(*state, u) for state in zip(q, v, strict=True)])
    names = tuple(f"q.{name}" for name in finger.joint_names)
    data = Measurements(np.arange(50.0), np.tile(u, (50, 1)), names, q)
    guess = first_guess(finger, springs, data, np.array([q, v, a]), np.zeros((50, 4), bool))
    np.testing.assert_allclose(guess, factors * nominal, rtol=1e-6)
    near = near_file(springs, guess)
    np.testing.assert_allclose(near, np.clip(factors, 0.1, 10.0) * nominal, rtol=1e-6)


def test_stretches_without_a_stop():
    stops = np.zeros((200, 3), bool)
    stops[60:70, 0] = True
    stops[10:195, 1] = True
    held, runs = stretches(stops)
    assert held.tolist() == [False, True, False]
    # only where the fixed joint stays at its stop, because arrivals bounce
    assert runs == [(14, 60), (70, 191)]
    stops[:, 1] = False
    stops[75:80, 2] = True  # 70 to 75 is too short for its own first state
    assert stretches(stops)[1] == [(0, 60), (80, 200)]
    assert stretches(np.ones((50, 2), bool))[1] == []


def test_what_scales_together_is_named(finger):
    """Stiffness, damping, masses and gears by one factor: the same motion."""
    several = [one for kind in ("stiffness", "damping", "gear")
               for one in identification.parameters(finger, kind, shared=True)]  # fmt: skip
    mass = identification.parameters(finger, "mass", shared=True)
    data_of = [f"q.{n}" for n in finger.joint_names]
    data, _ = twin_data(finger, several, data_of, Excitation(0.4, timestep=5e-4), 1.0, 2)
    found = identification.identify(finger, data, [*several, *mass])
    assert len(found.unidentifiable) == 1
    assert "together with" in found.unidentifiable[0]
    assert sum(not one.identified for one in found.estimates) == 1
    assert "NOT IDENTIFIED" in str(found)


def test_bad_requests(finger):
    with refused("kind", "'stifness'; did you mean 'stiffness'?"):
        identification.parameters(finger, "stifness")
    with refused("friction", "none of it"):
        identification.parameters(finger, "friction")
    data = Measurements(np.arange(3.0), np.zeros((3, 2)), ("tip.x",), np.eye(3)[:, :1])
    with refused("unknowns", "none"):
        identification.identify(finger, data, [])


def test_what_would_mislead_a_fit_is_refused(finger):
    stiffness = identification.parameters(finger, "stiffness")
    t, moving = np.arange(12) * 0.01, np.linspace(0.0, 0.1, 12)[:, None]
    data = Measurements(t, np.zeros((12, 2)), ("q.joint1",), moving)
    for step in (0, -1, np.nan):
        with refused("step"):
            identification.identify(finger, data, stiffness, step=step)
    shared = identification.parameters(finger, "stiffness", shared=True)
    for several in (stiffness * 2, (*stiffness, *shared)):
        with refused(
            "stiffness",
            "twice: stiffness joint1, …",
        ):
            identification.identify(finger, data, several)
    with refused("stiffness", "twice: stiffness joint1, …"):
        identification.choose_unknowns(finger, ["stiffness", "damping"], ["stiffness"])
    assert identification.choose_unknowns(finger, ["stiffness"], ["damping"])
    u = np.zeros((12, 2))
    u[5, 1] = -1.3
    with refused("u.u2", "-1.3 at t = 0.05 s: another unit?"):
        identification.identify(finger, replace(data, u=u), stiffness)
    with refused("q.joint1", 1e299):
        replace(data, outputs=1e300 * moving)
    with refused("names", "'q.joint1' twice"):
        replace(data, names=("q.joint1",) * 2, outputs=np.hstack((moving, moving)))


def test_one_dropout_does_not_silence_the_step():
    """A second at rest without samples: half of it once counted as half of every step."""
    model, data = swings(2, 0.04, "q.x", 1e-6)
    several = identification.parameters(model, "stiffness")
    gap = Measurements(
        np.append(-1.0, data.t), np.vstack(([0.0], data.u)), data.names,
        np.vstack(([0.0], data.outputs)),
    )  # fmt: skip
    plain, dropped = (identification.identify(model, one, several).moved for one in (data, gap))
    assert plain > COARSE
    assert dropped > COARSE


def test_the_zero_of_a_cable_s_length(finger):
    """The zero is found with the stiffness, but belongs to the data, not to the robot."""
    several = [*identification.parameters(finger, "stiffness", shared=True),
               *identification.parameters(finger, "offset")]  # fmt: skip
    cables = [f"length.{name}" for name in finger.tendons.names]
    one = trial(finger, several, cables, Excitation(0.5, timestep=5e-4), 1.0, 4)
    assert np.abs(one.scores).max() < 4
    assert np.abs(one.relative).max() < 0.05
    assert set(one.found.values()) == {"stiffness"}
    assert 0.9 < one.width.min() <= one.width.max() < 1.5
