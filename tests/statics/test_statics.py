"""Equilibria and inputs: a spring pendulum solved by hand, finite differences, the settled twin."""

from __future__ import annotations

import json
import math
import pickle
import warnings

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq

import softdyn
from softdyn import SoftModel, statics
from softdyn.commands import statics as command
from softdyn.statics.equilibria import _newton
from softdyn.validation.crosschecks.rests import hold
from softdyn.validation.report import statics_figure
from tests.support.named_models import named_model
from tests.support.oracles import gradient, relative
from tests.support.refused import refused
from tests.support.robots import (
    build,
    cable,
    changed,
    hinge,
    joint,
    link,
    motor,
    robot,
    slide,
    write,
)

G = 9.81
STIFFNESS = 0.5


def pendulum_text(height: float = -0.1, stiffness: float = STIFFNESS) -> str:
    """A mass of 1 kg, 0.1 m from a joint with a spring: hanging, or upright with height > 0."""
    return hinge(
        1, f"0 0 {height}", tip=f"0 0 {height}", limit=(-1, 2), damping=0.05, stiffness=stiffness,
        pull=(-2, 2), block='<task frame="tip"/>',
    )  # fmt: skip


def pendulum(
    height: float = -0.1, stiffness: float = STIFFNESS, changes: dict[str, str] | None = None
) -> SoftModel:
    return build(changed(pendulum_text(height, stiffness), *(changes or {}).items()))


@pytest.mark.parametrize("u", [-0.3, 0.2, 1.5])
def test_pendulum_with_spring(u):
    """k q + m g r sin q = u has one solution; the slope k + m g r cos q is the stiffness."""
    model = pendulum()
    angle = brentq(lambda q: STIFFNESS * q + 0.1 * G * np.sin(q) - u, -1, 2, xtol=1e-14)
    found = statics.settle(model, [u])
    slope = STIFFNESS + 0.1 * G * np.cos(angle)
    assert found.q == pytest.approx([angle], abs=1e-9)
    assert found.stable
    assert found.eigenvalues == pytest.approx([slope])
    J = np.array([-0.1 * np.cos(angle), 0.0, 0.1 * np.sin(angle)])
    assert found.tip_compliance == pytest.approx(np.outer(J, J) / slope)
    assert found.tip_sensitivity[:, 0] == pytest.approx(J / slope)
    for array in (found.q, found.held, found.limit_forces, found.stiffness):
        assert not array.flags.writeable
    poles = np.roots([found.state.M[0, 0], 0.05, slope])
    assert np.sort_complex(found.poles) == pytest.approx(np.sort_complex(poles))


def test_upright_pendulum():
    """For m g r > k the upright equilibrium is unstable, and there are two buckled ones below."""
    model = pendulum(height=0.1)
    upright = statics.balance(model, [0.0], [1e-3])
    assert upright.q == pytest.approx([0.0], abs=1e-9)
    assert not upright.stable
    assert upright.poles[0].real > 0
    leaning = statics.settle(model, [0.0])
    angle = brentq(lambda q: STIFFNESS * q - 0.1 * G * np.sin(q), 0.5, 2, xtol=1e-14)
    # a limit stops one side before its equilibrium
    expected = angle if leaning.q[0] > 0 else -1.0
    assert leaning.q == pytest.approx([expected], abs=1e-9)
    assert leaning.stable


@pytest.mark.parametrize("u", [-0.1, 0.1])
def test_from_a_saddle_the_robot_falls_to_the_lower_side(u):
    """The energy k q²/2 + m g r cos q - u q falls faster towards the side of u."""
    model, weight = pendulum(height=0.1), 0.1 * G

    def force(q):
        return STIFFNESS * q - weight * np.sin(q) - u

    top = brentq(force, -0.7, 0.7, xtol=1e-14)
    saddle = statics.balance(model, [u], [top])
    assert not saddle.stable
    assert saddle.q == pytest.approx([top], abs=1e-9)
    assert np.sign(top) == -np.sign(u)
    fallen = statics.settle(model, [u], saddle.q).q
    expected = -1.0 if u < 0 else min(brentq(force, 0.5, 3, xtol=1e-14), 2.0)
    assert fallen == pytest.approx([expected], abs=1e-8)


def test_a_stop_takes_the_rest_of_the_force():
    model = pendulum()
    found = statics.settle(model, [-2.0])
    assert found.q == pytest.approx([-1.0])
    assert found.held.all()
    force = -STIFFNESS - 0.1 * G * np.sin(1.0) + 2.0  # K + g - u: the stop pushes up
    assert found.limit_forces == pytest.approx([force])
    assert found.residual < 1e-9
    assert found.stable
    assert found.tip_compliance == pytest.approx(np.zeros((3, 3)))


def test_inputs_for_the_pendulum_s_tip():
    """u = k q + m g r sin q holds the tip at the angle q; off the circle, the nearest point."""
    model = pendulum()
    for angle in (-0.95, 1.4):
        circle = -0.1 * np.array([np.sin(angle), 0.0, np.cos(angle)])
        for radius in (1.0, 1.5):
            search = statics.inputs_for_tip(model, radius * circle, shapes=1, seconds=math.inf)
            assert search.distance(search.nearest) == pytest.approx(0.1 * (radius - 1), abs=1e-6)
            force = STIFFNESS * angle + 0.1 * G * np.sin(angle)
            assert search.nearest.u == pytest.approx([force], abs=1e-4)


@pytest.fixture(params=["finger", "helix", "spirob", 1, 4, 6], ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def some_input(model: SoftModel, size: float = 0.02) -> np.ndarray:
    low, high = np.maximum(model.u_min, -25), np.minimum(model.u_max, 25)
    u = np.random.default_rng(5).uniform(low, high) * size
    return np.clip(u, model.u_min, model.u_max)


def test_residual_is_the_gradient_of_the_potential(model):
    rng = np.random.default_rng(0)
    q = model.configuration(
        rng.uniform(np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8))
    )
    u = some_input(model)
    expected = gradient(model, lambda x: statics.potential(model, x, u), q)
    assert relative(expected, statics.residual(model, q, u)) < 1e-7


def test_settled_robots_are_balanced_and_lowest(model):
    u = some_input(model)
    found = statics.settle(model, u)
    state = model.state(found.q, np.zeros(model.nv))
    forces = [np.abs(x).max() for x in (state.K, state.bias, state.B @ u)]
    assert found.residual <= 1e-9 * max(forces)
    assert found.stable
    at = model.coordinates(found.q)
    assert np.all(at >= model.lower - 1e-9)
    assert np.all(at <= model.upper + 1e-9)
    lower = found.held & (at < model.lower + 1e-6)
    upper = found.held & (at > model.upper - 1e-6)
    assert np.array_equal(lower | upper, found.held)
    assert np.all(found.limit_forces[lower] >= 0)
    assert np.all(found.limit_forces[upper] <= 0)
    assert np.all(found.limit_forces[~found.held] == 0)
    here = statics.potential(model, found.q, u)
    rng = np.random.default_rng(1)
    for _ in range(20):  # no point nearby is lower
        step = 1e-3 * rng.normal(size=model.nv)
        step = np.clip(at + step, model.lower, model.upper) - at
        step[found.held] = 0.0
        assert statics.potential(model, model.integrate(found.q, step), u) >= here


def test_sensitivities_are_those_of_the_settled_robot(model):
    """∂y/∂u and the tip's compliance, each against a new equilibrium after a small change."""
    u = some_input(model)
    found = statics.settle(model, u)
    step = 1e-5
    for i in range(min(model.nu, 3)):
        du = step * np.eye(model.nu)[i]
        ahead, behind = (statics.settle(model, u + s * du, found.q) for s in (1, -1))
        assert np.array_equal(ahead.held, found.held)
        expected = (ahead.y - behind.y) / (2 * step)
        assert relative(expected, found.tip_sensitivity[:, i], 1e-3) < 1e-5
    assert relative(found.tip_compliance, found.tip_compliance.T) < 1e-9
    assert np.linalg.eigvalsh(found.tip_compliance)[0] > -1e-9


def test_a_ramp_ends_where_the_slow_robot_does(model):
    """Raising the input and settling at once agree while nothing snaps."""
    u = some_input(model, 0.005)
    found, snaps = statics.ramp(model, u)
    assert found.stable
    assert np.array_equal(found.u, u)
    if snaps == 0:
        again = statics.settle(model, u, found.q)
        assert relative(again.y, found.y, 1e-3) < 1e-6


def test_a_ramp_counts_its_snaps():
    """Upright, m g r > k: k q - m g r sin q = u folds where cos q = k / m g r, a snap each way."""
    model, weight = pendulum(height=0.1), 0.1 * G
    bent = statics.settle(model, [0.0], np.array([1.5]))
    assert bent.q[0] > 1
    fold = np.arccos(STIFFNESS / weight)
    limit = STIFFNESS * fold - weight * np.sin(fold)
    before, none = statics.ramp(model, [0.98 * limit], bent)
    assert none == 0
    assert before.q[0] > fold
    after, one = statics.ramp(model, [1.5 * limit], bent)
    assert (one, after.held[0]) == (1, True)
    assert after.q == pytest.approx([-1.0])
    back, again = statics.ramp(model, [1.0], after)  # off its stop, across to the other one
    assert again == 1
    assert back.q == pytest.approx([2.0])
    _, hanging = statics.ramp(pendulum(), [0.5])
    assert hanging == 0


def test_approach_recovers_a_tip_that_is_reachable():
    """From rest exactly to the tip of an equilibrium; the branch has a single input for it."""
    model = softdyn.load("finger")
    goal, _ = statics.ramp(model, [-0.03, 0.02])
    found = statics.approach(statics.rest(model), goal.y)
    assert found.y == pytest.approx(goal.y, abs=1e-8)
    assert found.u == pytest.approx(goal.u, abs=1e-6)
    assert found.residual < 1e-9


@pytest.mark.parametrize(("robot", "size"), [("finger", 0.1), ("spirob", 0.02)])
def test_explored_equilibria_are_exact(robot, size):
    """From random shapes to the tip of a known equilibrium: the results balance, within bounds."""
    model = softdyn.load(robot)
    target = statics.settle(model, some_input(model, size)).y
    distances = []
    for q, u in statics.random_shapes(model, 3):
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # and the solver prints nothing
            try:
                found = statics.explore(model, target, q, u)
            except statics.StaticsError:
                continue
        assert found.residual < 1e-9
        assert np.all(found.u >= model.u_min)
        assert np.all(found.u <= model.u_max)
        at = model.coordinates(found.q)
        assert np.all(at >= model.lower - 1e-9)
        assert np.all(at <= model.upper + 1e-9)
        distances.append(np.linalg.norm(found.y - target))
    assert min(distances) < 1e-6


def test_rests_are_sampled_under_small_inputs_as_under_large_ones():
    """Samples cover each ray: none of the last two and a half of three decades is empty."""
    model = pendulum()
    sizes = [abs(float(one.u[0])) / 2.0 for one in statics.sample_rests(model, 15)]
    decades = np.sort(np.log10(sizes))
    assert decades[0] < -3
    assert decades[-1] > -0.1
    assert np.diff(decades).max() < 0.09


def test_newton_s_damping_is_at_most_twice_what_it_takes():
    """In (H + c diag |H_ii|) s = -r, c is at least -λ_min of the pencil, and 0 for H > 0."""
    rng = np.random.default_rng(7)
    for k in range(30):
        H, r = rng.normal(size=(3, 3)), rng.normal(size=3)
        H = H @ H.T + np.eye(3) if k < 3 else H + H.T
        size = np.abs(np.diag(H)) + 1e-6 * np.abs(H).max()
        needed = max(0.0, -eigh(H, np.diag(size), eigvals_only=True)[0])
        step = _newton(H, r, np.zeros(3))
        c = -(r + H @ step) @ step / (size * step @ step)
        np.testing.assert_allclose((H + c * np.diag(size)) @ step, -r, atol=1e-9)
        assert needed - 1e-9 <= c <= (max(2 * needed, 1e-3) if needed else 0.0) + 1e-9


def test_random_inputs_stay_within_bounds(model):
    u = statics.random_inputs(model, 200)
    assert np.all(u >= model.u_min)
    assert np.all(u <= model.u_max)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(u > 0, u / model.u_max, u / model.u_min)
    assert np.nanmax(part, axis=1, initial=0.0) == pytest.approx(min(model.nu, 1))


def test_what_is_stable_stays_in_the_twin():
    """The frozen input holds a pendulum and the finger for 10 s; upright, the pendulum falls."""
    found = statics.settle(pendulum(), [0.2])
    assert hold(found, duration=10.0).largest < 1e-8
    upright = statics.balance(pendulum(height=0.1), [0.0], [1e-3])
    assert hold(upright, duration=10.0, nudge=1e-6).final > 0.01
    model = softdyn.load("finger")
    found = statics.approach(statics.rest(model), [0.0917, 0.0, -0.2049])
    assert found.stable
    assert hold(found, duration=10.0).largest < 1e-8


def test_the_twin_settles_where_statics_says():
    """For a helix with joints on their stops, MuJoCo's damped motion from nearby ends there."""
    model = softdyn.load("helix")
    found = statics.settle(model, some_input(model))
    assert found.held.any()
    drift = hold(found, duration=2.0)
    assert drift.final < 1e-4  # the twin's stops give way by 0.02 mm each


def test_bad_arguments_are_refused():
    model = softdyn.load("finger")
    with refused("u"):
        statics.settle(model, [0.0])
    with refused("start"):
        statics.settle(model, [0.0, 0.0], [np.nan] * 4)
    with refused("target"):
        statics.inputs_for_tip(model, [0.0, 0.0])


def test_no_equilibrium_is_an_error_that_says_so():
    """Past the fold of the upright branch, Newton's method finds nothing to balance."""
    model = pendulum(height=0.1)
    with pytest.raises(statics.StaticsError, match=r"no equilibrium.*left unbalanced"):
        statics.balance(model, [0.33], [0.5])


def test_spread_rests_are_stable_and_apart():
    model = pendulum()
    samples = list(statics.sample_rests(model, 2))
    more = list(statics.sample_between(samples, 5))
    assert len(samples) == 24
    assert len(more) == 5
    assert all(one.stable for one in (*samples, *more))
    # targets off the circle and beyond its ends: each result is the closest equilibrium to a target
    angles = np.array([one.q[0] for one in (*samples, *more)])
    assert angles.min() >= -1 - 1e-9
    assert angles.max() <= 2 + 1e-9


def test_the_command_reports_every_target(tmp_path, capsys, monkeypatch):
    file = write(tmp_path, pendulum_text())
    picture = tmp_path / "map.png"
    drawn = []
    real = statics_figure.draw
    monkeypatch.setattr(statics_figure, "draw", lambda *a: (drawn.append(a), real(*a)))
    options = "--target 0.05 0 -0.0866 --rays 1 --spread 1 --shapes 1 --hold 0.1 --json -"
    arguments = options.split()
    assert command.main([str(file), *arguments, "--map", str(picture)]) == 0
    report = json.loads(capsys.readouterr().out)
    (line,) = report["targets"]
    closest = line["closest"]
    assert np.linalg.norm(np.subtract(closest["y"], line["target"])) == pytest.approx(
        closest["distance_cm"] / 100
    )
    assert closest["stable"] == (closest["smallest_eigenvalue"] > 0)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert drawn[0][2] is None  # only the paper's robots follow its ellipse


def test_the_command_leads_inputs_somewhere(tmp_path, capsys):
    file = write(tmp_path, pendulum_text())
    assert command.main([str(file), "--inputs", "0.2", "--hold", "0.1", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    angle = report["rest"]["q"][0]
    assert STIFFNESS * angle + 0.1 * G * np.sin(angle) == pytest.approx(0.2)


@pytest.mark.parametrize(
    "arguments",
    [
        ["finger", "--inputs", "1"],
        ["finger", "--inputs", "5", "5"],
        ["finger", "--map", "map.txt"],
        ["nothere"],
    ],
)
def test_the_command_refuses_bad_input(arguments, capsys):
    assert command.main(arguments) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_what_hangs_straight_down_rests_there():
    """All forces vanish there, so that rounding must not be judged relative to itself."""
    model = pendulum(stiffness=0)
    for start in (0.4, -1.0):
        found = statics.settle(model, np.zeros(model.nu), np.array([start]))
        assert found.stable
        assert abs(found.q[0]) < 1e-12
    arm = statics.rest(softdyn.load("ur5"))  # turns freely about the vertical
    assert arm.y[2] < -0.8


def test_the_error_crosses_processes():
    error = pickle.loads(pickle.dumps(statics.StaticsError("no rest", 0.25)))
    assert error.residual == 0.25
    assert str(error) == str(statics.StaticsError("no rest", 0.25))


def test_cables_that_pull_against_one_another_leave_a_rest() -> None:
    """Their forces cancel up to rounding, so their sum is no scale for the residual."""
    model = softdyn.load("spirob")
    rest = statics.settle(model, np.full(model.nu, 0.3))
    assert rest.stable
    np.testing.assert_allclose(rest.y[:2], 0.0, atol=1e-9)


# -- joints without any stiffness at q = 0 -------------------------------------------------------

# an arm of 0.2 m that leaves its joint horizontally, and a load of 0.2 kg on a winch
MOMENTS = "1e-4 1e-3 1e-3"
BARE_ARM = hinge(
    0.3, "0.1 0 0", MOMENTS, limit=(-3, 3), damping=0.01, tip="0.2 0 0", pull=(-1, 1),
    block='<task frame="tip"/>',
)  # fmt: skip
HOIST = slide(0.2, MOMENTS, axis="0 0 -1", limit=(-0.2, 0.4), damping=3, pull=(0, 30), gear=-1)


@pytest.mark.parametrize("u", [0.0, 0.1, -0.2])
def test_a_bare_arm_falls_from_the_horizontal(u):
    """-m g r cos q = u, with the slope m g r sin q, which is zero at the start."""
    model, weight = build(BARE_ARM), 0.3 * G * 0.1
    found, _ = statics.ramp(model, [u])
    angle = np.arccos(-u / weight)
    assert found.q == pytest.approx([angle])
    assert found.y == pytest.approx([0.2 * np.cos(angle), 0.0, -0.2 * np.sin(angle)])
    assert found.eigenvalues == pytest.approx([weight * np.sin(angle)])
    assert (found.stable, found.neutral) == (True, False)


@pytest.mark.parametrize(("u", "place", "firmness"), [
    (0.0, 0.4, "stable"), (1.9, 0.4, "stable"), (0.2 * G, 0.1, "neutral"), (2.0, -0.2, "stable"),
])  # fmt: skip
def test_a_hoist_rests_at_its_stops_or_anywhere(u, place, firmness):
    found = statics.settle(build(HOIST), [u], [0.1])
    assert found.q == pytest.approx([place])
    assert found.firmness == firmness
    assert found.limit_forces == pytest.approx([u - 0.2 * G])
    assert np.isnan(found.tip_compliance).all() == (firmness == "neutral")


def test_a_hoist_is_held_at_any_height():
    model, target = build(HOIST), np.array([0.0, 0.0, -0.25])
    search = statics.inputs_for_tip(model, target, shapes=2, seconds=math.inf)
    assert search.distance(search.nearest) < 1e-6
    assert search.nearest.u == pytest.approx([0.2 * G])
    assert search.nearest.neutral


def test_two_bare_slides_have_no_stiffness_but_rounding():
    """Pinocchio's gravity gradients of slides on turned links are rounding, of either sign."""
    text = robot(
        "two", link("wall"), link("beam", 1, "0.3 0 0", MOMENTS), link("load", 0.2, None, MOMENTS),
        joint("lift", "wall", "beam", "0.48 0.64 0.6", "prismatic", rpy="0.3 0.2 0.1"),
        joint("drop", "beam", "load", "0.6 0 -0.8", "prismatic", limit=(-0.2, 0.4), damping=3),
        block=(cable("t", "drop 1"), motor("t", 0, 30, -1)),
    )  # fmt: skip
    found = statics.rest(build(text))
    assert found.held.all()
    assert found.residual < 1e-9
