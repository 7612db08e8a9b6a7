"""The reference implementation's deviations: each has its stated effect and no other."""

import json
import warnings

import numpy as np
import pytest

import softdyn
from softdyn import Reference
from softdyn.commands import cli
from softdyn.controllers import Command, find_controller
from softdyn.controllers.registry import CONTROLLERS, make_controller
from softdyn.validation import Log, StateMap, Twin, paper
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.studies.engine import case as engine
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.twin.plant_errors import PlantErrors
from tests.proof import reproduce
from tests.proof.paper.altered_states import Linked, wrong_sign
from tests.proof.paper.reference_laws import make_law
from tests.proof.paper.reproduction import (
    CHANGES,
    REFERENCE,
    changed,
    parse,
)
from tests.support.exact_qps import printed, solve_quadprog, with_input
from tests.support.paper_qps import clf_qp
from tests.support.refused import refused

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


# -- the plant and the reference -------------------------------------------------------------------


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


# -- names -----------------------------------------------------------------------------------------


def test_names_combine_and_unknown_ones_are_refused():
    assert parse("stale+plant-step", "finger") == (CHANGES["stale"], CHANGES["plant-step"])
    for robot in ROBOTS:
        assert parse("reference", robot) == parse(REFERENCE[robot], robot)
    assert CHANGES["passive-sign"] in parse("reference", "helix")
    assert CHANGES["passive-sign"] not in parse("reference", "spirob")
    with refused("experiment"):
        parse("stale+nothing", "finger")


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
