"""The reference implementation's deviations: each has its stated effect and no other."""

import json
import math
import warnings
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import InputError, Reference, State
from softdyn.commands import cli
from softdyn.controllers import Command, Impedance, find_controller
from softdyn.controllers.registry import CONTROLLERS, make_controller
from softdyn.validation import Log, StateMap, Twin, paper
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.studies.engine import case as engine
from softdyn.validation.studies.engine.case import Case, figures
from softdyn.validation.twin.plant_errors import PlantErrors
from tests.proof import reproduce
from tests.proof.paper import reproduction
from tests.proof.paper.altered_states import Linked, Stale, no_coriolis, wrong_sign
from tests.proof.paper.paper_qps import clf_qp
from tests.proof.paper.reference_laws import AngularTask, Differenced, make_law
from tests.proof.paper.reproduction import (
    CHANGES,
    REFERENCE,
    changed,
    parse,
)
from tests.proof.paper.solvers import optional
from tests.support.printed import printed, solve_quadprog, with_input

ROBOTS = ("finger", "helix", "spirob")


@pytest.fixture(scope="module")
def models():
    return {name: softdyn.load(name) for name in ROBOTS}


def random_state(model, seed, pull=0.3):
    rng = np.random.default_rng(seed)
    # prismatic joints move by millimetres, the others by tenths of a radian
    scale = np.where(model.upper < 0.1, 1e-2, 1.0)
    q = model.configuration(pull * scale * rng.standard_normal(model.nv))
    return q, scale * rng.standard_normal(model.nv)


class Spy:
    """A controller that records the states that it gets."""

    gains, guard = "gains", "guard"

    def __init__(self, model):
        self.states = []
        self._u = np.clip(np.ones(model.nu), model.u_min, model.u_max)

    def __call__(self, state, reference):
        self.states.append(state)
        return Command(self._u)


def shown(model, views, states, **options):
    spy = Spy(model)
    controller = Linked(spy, views, **options)
    for q, v in states:
        controller(model.state(q, v), None)
    return spy.states


def run(cell, name):
    """A cell with an experiment's changes."""
    case = changed(cell, name)
    model = softdyn.load(case.robot)
    return engine.run(case, model, lambda: make_controller(case.controller, model))


@pytest.fixture
def prepare(monkeypatch):
    """The arguments of `simulate` for a cell with an experiment's changes."""

    def prepare(cell, name):
        asked = {}

        def simulate(model, controller, experiment, **options):
            taken = vars(RunOptions.of(options))
            asked.update(taken | {"plant": taken["plant"] or PlantErrors()})
            asked.update(model=model, experiment=experiment)

        with monkeypatch.context() as patch:
            patch.setattr(engine, "simulate", simulate)
            run(cell, name)
        return asked

    return prepare


def read_only(state):
    arrays = [getattr(state, name) for name in (*State.__dataclass_fields__, "C", "g")]
    return not any(a.flags.writeable for a in arrays if isinstance(a, np.ndarray))


# -- views -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["finger", "helix"])
def test_wrong_sign_doubles_the_passive_forces(models, robot):
    model = models[robot]
    q, v = random_state(model, 1)
    (seen,) = shown(model, [wrong_sign], [(q, v)])
    # MuJoCo's bias less its passive forces, computed independently
    twin = Twin(model.robot)
    judge = MujocoTerms(twin, StateMap(model, twin))
    judge.set_state(q, v)
    bias, passive = judge.bias(), judge.D() @ v + judge.K()
    np.testing.assert_allclose(seen.h, bias - passive, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(seen.D @ seen.v + seen.K, -passive, rtol=1e-9, atol=1e-9)
    assert np.abs(passive).max() > 1e-3
    assert read_only(seen)


def test_no_coriolis_hands_over_the_whole_bias_as_gravity(models):
    model = models["helix"]
    q, v = random_state(model, 2)
    true = model.state(q, v)
    (seen,) = shown(model, [no_coriolis], [(q, v)])
    np.testing.assert_array_equal(seen.g, true.bias)
    assert not seen.C.any()
    assert true.C.any()
    np.testing.assert_array_equal(seen.h, true.h)
    assert not np.allclose(true.g, true.bias)
    assert read_only(seen)


def test_stale_shows_the_last_step_s_forces_and_this_step_s_jacobian(models):
    model = models["helix"]
    states = [random_state(model, seed) for seed in (3, 4, 5)]
    true = [model.state(*s) for s in states]
    seen = shown(model, [Stale()], states)
    np.testing.assert_array_equal(seen[0].M, true[0].M)  # no older state yet
    for now, before, got in zip(true[1:], true, seen[1:], strict=False):
        np.testing.assert_array_equal(got.M, before.M)
        np.testing.assert_array_equal(got.bias, before.bias)
        np.testing.assert_array_equal(got.h, before.h)
        np.testing.assert_array_equal(got.g, before.g)
        np.testing.assert_array_equal(got.C, before.C)
        passive = before.D @ before.v + before.K
        np.testing.assert_allclose(got.D @ got.v + got.K, passive, rtol=1e-12, atol=1e-12)
        for name in ("J", "Jdot", "y", "ydot", "B", "q", "v"):
            np.testing.assert_array_equal(getattr(got, name), getattr(now, name))
        assert read_only(got)


def test_views_apply_in_their_order_and_leave_the_state_alone(models):
    model = models["finger"]
    states = [random_state(model, seed) for seed in (6, 7)]
    stale_bias = model.state(*states[0]).bias
    seen = shown(model, [Stale(), no_coriolis], states)[1]
    np.testing.assert_array_equal(seen.g, stale_bias)
    state = model.state(*states[0])
    before = {name: np.array(getattr(state, name)) for name in ("M", "K", "D", "h", "bias", "g")}
    wrong_sign(no_coriolis(state))
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(state, name), value)


def test_late_gives_zero_once_and_the_rest_passes_through(models):
    model = models["spirob"]
    spy = Spy(model)
    controller = Linked(spy, [], late=True)
    state = model.state(*random_state(model, 8))
    first, second = controller(state, None), controller(state, None)
    assert not first.u.any()
    np.testing.assert_array_equal(second.u, 1.0)
    assert (controller.gains, controller.guard) == ("gains", "guard")
    assert spy.states == [state]


def test_ic_without_coriolis_is_the_formula(models):
    model = models["finger"]
    q, v = random_state(model, 9)
    state = model.state(q, v)
    target = Reference([0.1, 0.0, -0.1], [0.01, 0.0, 0.02], [0.1, 0.0, 0.0])
    u = Linked(Impedance(model), [no_coriolis])(state, target).u
    Kp = 500.0
    J, e, edot = state.J, state.y - target.y, state.ydot - target.ydot
    inertia = np.linalg.pinv(J @ np.linalg.inv(state.M) @ J.T, rcond=1e-2)
    ahead = target.yddot - Kp * e - 2 * math.sqrt(Kp) * edot - state.Jdot @ v
    torque = J.T @ inertia @ ahead + state.D @ v + state.K + state.bias
    expected = np.clip(np.linalg.pinv(state.B) @ torque, model.u_min, model.u_max)
    np.testing.assert_allclose(u, expected, rtol=1e-7, atol=1e-9)


# -- the plant and the reference -------------------------------------------------------------------


def test_friction_is_in_the_plant_only(models, prepare):
    source = models["spirob"].robot.path
    before = source.read_bytes()
    asked = prepare(Case("spirob", "ic", "set_point", 1.0), "friction")
    model = asked["model"]
    assert source.read_bytes() == before
    assert all(joint.friction == 0 for joint in model.robot.moving_joints)
    assert all(joint.friction == 0 for joint in models["spirob"].robot.moving_joints)
    plant = asked["plant"].twin(model.robot, friction=asked["plant"].rubs)
    np.testing.assert_array_equal(plant.model.dof_frictionloss, [0.1] * 27)
    assert not plant.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    q, v = random_state(model, 10)
    ours, theirs = models["spirob"].state(q, v), model.state(q, v)
    for name in ("M", "h", "B", "J"):  # the controller's model does not contain it
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_soft_stops_let_the_hanging_helix_sink(models):
    def sunk(plant):
        twin = plant.twin(models["helix"].robot, timestep=1e-3)
        twin.advance(np.zeros(9), 400)
        low, high = twin.model.jnt_range.T
        slides = twin.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        return np.maximum(low - twin.qpos, twin.qpos - high)[slides].max()

    assert sunk(PlantErrors()) < 1e-4
    assert sunk(PlantErrors(soft_stops=True)) > 2e-3


@pytest.mark.parametrize(
    ("robot", "name", "expected"),
    [
        ("finger", "plant-step", {"timestep": np.inf}),
        ("helix", "plant-step", {"timestep": np.inf}),
        ("finger", "plant-fine", {"timestep": 1e-4}),
        ("finger", "period-2ms+plant-step", {"timestep": np.inf, "period": 0.002}),
        ("helix", "contacts", {"contacts": True}),
        ("spirob", "friction", {"rubs": True}),
        ("finger", "stale", {"timestep": None, "contacts": False, "rubs": False}),
    ],
)
def test_options_of_the_plant(robot, name, expected, prepare):
    asked = prepare(Case(robot, "ic", "set_point", 1.0), name)
    errors = asked["plant"]
    found = {"contacts": errors.contacts, "rubs": errors.rubs}
    found |= {"timestep": asked["timestep"], "period": asked["experiment"].period}
    assert {key: found[key] for key in expected} == expected
    plain = Twin(robot, friction=errors.rubs).model
    plant = errors.twin(robot, friction=errors.rubs).model
    np.testing.assert_array_equal(plant.jnt_solref, plain.jnt_solref)
    np.testing.assert_array_equal(plant.body_mass, plain.body_mass)
    assert not asked["v0"].any()


def test_options_of_robot_period_and_nudge(prepare):
    case = Case("spirob", "ic", "tracking", 0.5)
    assert prepare(case, "dof48")["model"].nv == 48
    soft = prepare(case, "soft-stops")["plant"].twin("spirob").model
    assert (soft.jnt_solref == (0.02, 1.0)).all()
    case = Case("finger", "ic", "set_point", 1.5)
    assert prepare(case, "period-1ms")["experiment"].period == 0.001
    np.testing.assert_array_equal(prepare(case, "nudge")["v0"], 1e-9)


@pytest.mark.parametrize(
    ("robot", "above_ground", "start"),
    [  # the first reference point of the tracking logs that the reference implementation publishes
        ("finger", 0.24, (0.19798989873223327, 0.0, 0.15514718625761428)),
        ("helix", 0.7, (0.37123106012293744, 0.0, 0.5409009742330267)),
        ("spirob48", 0.5, (0.29168154723945083, 0.0, 0.3704504871165134)),
    ],
)
def test_ellipse_is_that_of_the_published_logs(robot, above_ground, start, prepare):
    plain = robot.removesuffix("48")
    case = Case(plain, "ic", "tracking", 0.5)
    at = prepare(case, "ellipse")["experiment"].reference
    np.testing.assert_allclose(at(0.0).y + np.array([0, 0, above_ground]), start, rtol=1e-12)
    step = 1e-4
    velocity = (at(0.3 + step).y - at(0.3 - step).y) / (2 * step)
    np.testing.assert_allclose(at(0.3).ydot, velocity, atol=1e-8)
    assert np.abs(at(0.0).y - paper.tracking(plain, 0.5).reference(0.0).y).max() > 1e-3


@pytest.mark.parametrize(
    ("robot", "name", "first"),
    [  # the first error (cm) of the set-point logs of 37d7d0f, and of 2016806
        ("finger", "ellipse", (9.47, 17.00, 25.15, 18.37)),
        ("helix", "ellipse", (46.70, 31.32, 17.43, 34.16)),
        ("spirob", "dof48+ellipse", (48.77, 34.89, 17.17, 32.74)),
        ("finger", "shifted", (19.07, 27.62, 35.03, 27.05)),
        ("helix", "shifted", (36.31, 22.20, 6.40, 23.00)),
        ("spirob", "dof48+shifted", (38.82, 25.81, 7.98, 22.82)),
    ],
)
def test_set_points_are_those_of_the_published_logs(robot, name, first, prepare):
    for theta, expected in zip(paper.THETAS, first, strict=True):
        asked = prepare(Case(robot, "ic", "set_point", theta), name)
        model = asked["model"]
        tip = model.state(model.q0, np.zeros(model.nv)).y
        found = 100 * np.linalg.norm(tip - asked["experiment"].reference(0.0).y)
        assert found == pytest.approx(expected, abs=0.0051)


def test_gains_of_another_commit(models):
    state = models["helix"].state(*random_state(models["helix"], 40))
    target = Reference(state.y + 0.01, np.zeros(3), np.zeros(3))
    case = Case("helix", "ic-qp", "set_point", 1.0)
    gains, answers = {}, {}
    for name in ("exact", "w2"):
        law = changed(case, name).law("ic-qp", models["helix"])
        gains[name], answers[name] = law.gains, law(state, target).u
    assert gains["w2"] == replace(gains["exact"], w2=0.2)
    assert gains["exact"] == CONTROLLERS["ic-qp"].published["helix"]
    assert np.abs(answers["w2"] - answers["exact"]).max() > 1e-3
    kp = changed(Case("spirob", "ic-qp", "set_point", 1.0), "kp").law("ic-qp", models["spirob"])
    assert kp.gains.Kp == 500


def test_hulls_need_the_reference_s_files(tmp_path):
    cell = Case("helix", "ic", "set_point", 1.0)
    with pytest.raises(InputError, match="files"):
        changed(cell, "hulls")
    with pytest.raises(InputError, match=r"helix_control\.xml: expected an MJCF file"):
        changed(cell, "hulls", tmp_path)
    file = tmp_path / "mujoco_models" / "helix" / "helix_control.xml"
    file.parent.mkdir(parents=True)
    file.write_text('<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>')
    assert changed(cell, "hulls", tmp_path).options["plant"].shapes == file
    finger = Case("finger", "ic", "set_point", 1.0)  # its links never meet
    assert changed(finger, "hulls").options == finger.options


@pytest.mark.parametrize("robot", ["finger", "helix"])
def test_a_differenced_jacobian_rate_is_the_rate(models, robot):
    model = models[robot]
    state = model.state(*random_state(model, 41))
    target = Reference([0.1, 0.0, 0.0], np.zeros(3), np.zeros(3))
    task = AngularTask(model)
    true, found = task(state, target), Differenced(task)(state, target)
    assert np.abs(found.Jdot - true.Jdot).max() < 1e-5 * max(1.0, np.abs(true.Jdot).max())
    assert np.any(found.Jdot != true.Jdot)
    for name in ("J", "e", "edot", "yddot"):
        np.testing.assert_array_equal(getattr(found, name), getattr(true, name))


def test_sampled_is_the_plain_mean_of_every_fifth_error():
    case = Case("finger", "ic", "set_point", 0.5)
    log = run(case, "stale+plant-step")
    errors = 100 * np.linalg.norm(log.y - log.y_ref, axis=1)
    expected = sum(errors[k] ** 2 for k in range(0, len(errors), 5)) / len(range(0, 2001, 5))
    assert figures(changed(case, "sampled"), log)["mse_cm2"] == pytest.approx(expected)
    assert figures(case, log)["mse_cm2"] == log.mse_cm2
    assert log.timestep == log.period == 0.005
    assert not log.failed


# -- the laws written out --------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["finger", "helix", "spirob"])
@pytest.mark.parametrize("name", ["soft-id-clf-qp", "ic-qp", "clf-qp", "ic", "uic"])
def test_laws_written_out_agree_with_the_condensed_ones(models, robot, name):
    model, gains = models[robot], CONTROLLERS[name].published[robot]
    ours, theirs = find_controller(name)(model), make_law(name, model, gains, {"exact"})
    for seed in range(4):
        state = model.state(*random_state(model, 20 + seed))
        target = Reference(state.y + np.array([0.02, 0.0, 0.01]), state.ydot, [0.1, 0.0, -0.1])
        expected = ours(state, target).u
        scale = max(1.0, np.abs(expected).max())
        if name == "clf-qp" and model.nu > 3:  # not unique: judged by the cost
            qp = printed(state, target, gains, clf_qp)
            best = solve_quadprog(qp, 1e-7).cost
            cost = solve_quadprog(with_input(qp, expected), 1e-7).cost
            idle = solve_quadprog(with_input(qp, 0 * expected), 1e-7).cost
            assert best - 1e-9 * idle <= cost <= best * (1 + 1e-5) + 1e-6 * idle
            continue
        np.testing.assert_allclose(theirs(state, target).u, expected, atol=2e-4 * scale)
    assert theirs.guard.not_solved == 0


@pytest.mark.parametrize("robot", ["finger", "helix"])
def test_angular_rows_are_the_tip_s_rotation(models, robot):
    model = models[robot]
    q, v = random_state(model, 30)
    task, target = AngularTask(model), Reference([0.1, 0.0, 0.0], [1.0, 0.0, 0.0])
    found = task(model.state(q, v), target)
    J, Jdot, e = found.J, found.Jdot, found.e
    assert J.shape == Jdot.shape == (6, model.nv)
    assert not np.any([e[3:], found.yddot[3:]])
    np.testing.assert_allclose(found.edot[3:], J[3:] @ v, rtol=1e-14)
    np.testing.assert_allclose(e[:3], model.state(q, v).y - target.y)
    if robot == "finger":  # planar: the joints' rates add up about y
        np.testing.assert_allclose(J[3:] @ v, [0.0, v.sum(), 0.0], atol=1e-12)
    step = 1e-6
    ahead, behind = (
        task(model.state(model.integrate(q, sign * step * v), v), target).J for sign in (1, -1)
    )
    np.testing.assert_allclose(Jdot, (ahead - behind) / (2 * step), atol=1e-5)
    # and J itself against the site's orientation
    twin = Twin(model.robot)
    states = StateMap(model, twin)

    def orientation(sign):
        twin.set_state(*states.to_twin(model.integrate(q, sign * step * v), v))
        return twin.data.site_xmat[twin.task_site].reshape(3, 3).copy()

    spin = (orientation(1) - orientation(-1)) / (2 * step) @ orientation(0).T
    np.testing.assert_allclose(J[3:] @ v, [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-6)


def test_a_missing_package_is_named():
    with pytest.raises(InputError, match="pip install cvxpy scs"):
        optional("no_such_module", "cvxpy scs")
    with pytest.raises(InputError):
        make_law(
            "id-clf-qp", softdyn.load("finger"), CONTROLLERS["ic"].published["finger"], {"exact"}
        )


# -- names -----------------------------------------------------------------------------------------


def test_names_combine_and_unknown_ones_are_refused():
    assert parse("stale+plant-step", "finger") == (CHANGES["stale"], CHANGES["plant-step"])
    for robot in ROBOTS:
        assert parse("reference", robot) == parse(REFERENCE[robot], robot)
    assert CHANGES["passive-sign"] in parse("reference", "helix")
    assert CHANGES["passive-sign"] not in parse("reference", "spirob")
    with pytest.raises(InputError, match="experiment"):
        parse("stale+nothing", "finger")


def test_cells_an_experiment_is_meant_for():
    def cells(*args):
        return {(case.robot, case.controller) for case in reproduction.cases(*args)}

    assert {robot for robot, _ in cells("passive-sign")} == {"helix"}
    assert {controller for _, controller in cells("no-coriolis")} == {"ic", "uic"}
    assert len(cells("reference")) == 15
    assert len(reproduction.cases("stale", ["finger"], ["ic"])) == 9
    assert cells("passive-sign", ["finger"], ["ic-qp"]) == {("finger", "ic-qp")}
    with pytest.raises(InputError, match="robot"):
        reproduction.cases("stale", ["panda"])


# -- the command -----------------------------------------------------------------------------------


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    """Run the command in this process: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "one_thread", lambda: None)
    monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)

    def call(*arguments):
        try:
            code = reproduce.main(list(arguments))
        except SystemExit as stop:
            code = stop.code
        return code, *capsys.readouterr()

    return call


def test_command_writes_the_table_and_reuses_it(call, tmp_path):
    arguments = [
        "stale+plant-step", "--robots", "finger", "--controllers", "ic", "--thetas", "1",
        "--omegas", "--jobs", "1", "--json", "-",
    ]  # fmt: skip
    code, text, errors = call(*arguments)
    assert (code, errors) == (0, "")
    (row,) = json.loads(text)["rows"]
    assert (row["experiment"], row["robot"], row["controller"]) == (
        "stale+plant-step", "finger", "ic",
    )  # fmt: skip
    assert row["sp_mean_cm"] < 0.01
    assert row["tt_mean_cm2"] is None
    assert row["ours"]["sp_mean_cm"] < 0.01
    assert row["paper"]["sp_mean_cm"] == 0.08
    out = tmp_path / "results" / "reproduction"
    assert "stale+plant-step | finger | IC" in (out / "table.md").read_text()
    run = out / "stale+plant-step" / "runs" / "finger" / "ic" / "set_point_1.npz"
    assert Log.load(run).timestep == 0.005
    stamp = run.stat().st_mtime_ns
    assert call(*arguments) == (0, text, "")
    assert run.stat().st_mtime_ns == stamp


@pytest.mark.parametrize(
    "arguments",
    [
        ("frictions",),
        ("stale+",),
        ("stale", "--robots", "panda"),
        ("stale", "--controllers", "lqr"),
        ("stale", "--jobs", "0"),
        ("stale", "--json", "nowhere/file.json"),
        ("hulls", "--robots", "helix"),
        ("--records", "nowhere"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(call, arguments):
    code, text, errors = call(*arguments)
    assert (code, text) == (2, "")
    assert errors.startswith("error: ")
    assert errors.count("\n") == 1


def test_list_names_every_experiment(call, tmp_path):
    code, text, _ = call("--list")
    assert code == 0
    assert [line.split()[0] for line in text.splitlines()] == [*CHANGES, "reference", "there"]
    assert not list(tmp_path.iterdir())


def test_a_shown_controller_runs_in_the_loop():
    log = run(Case("finger", "soft-id-clf-qp", "set_point", 1.0), "late")
    assert not log.u[0].any()
    assert log.u[1].any()
    assert (log.gains["Kp"], log.not_solved) == (500, 0)
