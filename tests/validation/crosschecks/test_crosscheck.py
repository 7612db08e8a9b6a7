"""The cross-check passes on every kind of robot, and names differing quantities."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn.validation.crosschecks import trajectories
from softdyn.validation.crosschecks.crosscheck import (
    QUANTITIES,
    crosscheck,
    random_state,
    relative_error,
)
from softdyn.validation.crosschecks.result import CrossCheck, TrajectoryRun
from softdyn.validation.crosschecks.trajectories import damping_couples_branches, rates_of
from softdyn.validation.twin.twin import Twin
from tests.support import robots
from tests.support.command import command
from tests.support.random_robots import write_robot
from tests.support.refused import refused
from tests.support.robots import SOLID, spring

POINT = robots.inertial(0.4, "0 0.1 0.2", 0)


def link(name: str, body: str = SOLID) -> str:
    return robots.tag("link", body, name=name)


def joint(name: str, kind: str, parent: str, child: str, more: str = "", **place: str) -> str:
    place = {"at": "0.1 0.2 -0.3", "rpy": "0.4 -1.1 2.5"} | place
    return robots.joint(
        name, parent, child, kind=kind, limit=(-0.8, 1.1), effort=1, inside=more, **place
    )


DAMPER = '<dynamics damping="0.05"/>'
TREE = (  # two branches on one arm, children in anti-alphabetical order
    link("base")
    + link("arm")
    + link("z")
    + link("a")
    + joint("root", "revolute", "base", "arm", DAMPER)
    + joint("jz", "continuous", "arm", "z", axis="0.3 -0.4 1.2")
    + joint("ja", "prismatic", "arm", "a", DAMPER, axis="2 0 0")
)
MICRO = {
    "prismatic": link("base") + link("a") + joint("j", "prismatic", "base", "a", axis="1 2 3"),
    "continuous": link("base") + link("a") + joint("j", "continuous", "base", "a", DAMPER),
    "no axis element": (
        link("base")
        + link("a")
        + joint("j", "revolute", "base", "a", axis=None)
        + spring("j", 2.0, 0.3)
    ),
    "massless chain": (
        link("base")
        + link("h1", "")
        + link("h2", "")
        + link("a")
        + joint("c", "revolute", "base", "h1", DAMPER, axis="0 0 1")
        + joint("b", "prismatic", "h1", "h2", axis="0 1 0", at="0 0 0")
        + joint("a", "continuous", "h2", "a", axis="1 0 0", rpy="0 0 0")
    ),
    "massless link that branches": (
        link("base")
        + link("hub", "")
        + link("y")
        + link("b", POINT)
        + joint("turn", "continuous", "base", "hub", DAMPER)
        + joint("jy", "revolute", "hub", "y", axis="1 0 0")
        + joint("jb", "revolute", "hub", "b", axis="0 0 1", rpy="0 0 0")
        + '<softdyn version="1"><task frame="hub"/></softdyn>'
    ),
    "branching tree": TREE,
    "fixed links with inertia": (
        link("base")
        + link("a")
        + link("f")
        + link("g", POINT)
        + link("b")
        + joint("j", "revolute", "base", "a", axis="-1 0 1")
        + joint("f1", "fixed", "a", "f")
        + joint("f2", "fixed", "f", "g")
        + joint("k", "revolute", "g", "b")
    ),
    "point mass with armature": (
        link("base")
        + link("a", POINT)
        + joint("j", "revolute", "base", "a", axis="0 1 2")
        + '<softdyn version="1"><joint name="j" armature="0.02"/></softdyn>'
    ),
    "root of another name, offset": (
        link("plinth")
        + link("mount", POINT)
        + link("world")
        + joint("f", "fixed", "plinth", "mount")
        + joint("j", "revolute", "mount", "world")
    ),
    "fixed tendons: elastic, damped, coupled": (
        TREE
        + spring("ja", 30, 0.1)
        + '<softdyn version="1">'
        + '<tendon name="e" stiffness="3" rest="-1"><joint name="root" coef="2"/>'
        + '<joint name="ja" coef="-0.5"/></tendon>'
        + '<tendon name="d" damping="0.4"><joint name="jz" coef="1.5"/></tendon>'
        + '<tendon name="c" damping="0.3"><joint name="jz" coef="1"/><joint name="ja" coef="2"/>'
        + "</tendon>"
        + '<actuator name="u1" tendon="e" gear="-2" lower="0" upper="3"/>'
        + '<actuator name="u2" tendon="c" lower="-1" upper="3"/>'
        + '<actuator name="u3" tendon="c" gear="0.5" lower="-1" upper="0"/></softdyn>'
    ),
    "spatial tendons: elastic, damped, from the world": (
        TREE
        + link("tool", "")
        + joint("f", "fixed", "z", "tool")
        + '<softdyn version="1"><joint name="jz" armature="0.01"/>'
        + '<tendon name="s" stiffness="20"><site link="base" xyz="0.3 0 0"/>'
        + '<site link="arm" xyz="0 0.1 0"/><site link="arm" xyz="0.1 0 0"/>'
        + '<site link="tool" xyz="0 0 0.1"/></tendon>'
        + '<tendon name="r" stiffness="9" rest="0.2" damping="0.5"><site link="a" xyz="0 0 0"/>'
        + '<site link="base" xyz="0 0 0.6"/></tendon>'
        + '<tendon name="w"><site link="tool" xyz="0 0 0"/><site link="tool" xyz="0 0 1"/></tendon>'
        + '<actuator name="u1" tendon="s" gear="-1" lower="0" upper="3"/>'
        + '<actuator name="u2" tendon="w" lower="0" upper="3"/></softdyn>'
    ),
}


def write(folder: Path, body: str, name: str = "robot") -> Path:
    return robots.write(folder, robots.robot("micro", body), f"{name}.urdf")


@pytest.fixture
def short(monkeypatch):
    """Trajectories of 0.1 s with five inputs; they show faults at once, to 1e-11."""
    monkeypatch.setattr(trajectories, "HORIZON", 0.1)
    monkeypatch.setattr(trajectories, "HORIZON_UNDAMPED", 0.1)


def table(result) -> str:
    return "\n".join(f"{c.quantity} {c.max_error} {c.reason}" for c in result.checks)


@pytest.mark.parametrize("body", MICRO.values(), ids=MICRO)
def test_micro_robot(body, tmp_path, short):
    result = crosscheck(softdyn.load(write(tmp_path, body)), samples=4)
    assert result.passed, table(result)
    assert tuple(check.quantity for check in result.checks) == QUANTITIES


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(20))
def test_random_robot(seed, tmp_path, short):
    path = write_robot(seed, tmp_path, bodies=4)
    result = crosscheck(softdyn.load(path), samples=2, seed=seed)
    assert result.passed, table(result)


@pytest.mark.parametrize("name", ["finger", "helix", "spirob", "spirob48"])
def test_bundled_robot(name):
    result = crosscheck(softdyn.load(name), samples=3)
    assert result.passed, table(result)
    assert max(check.max_error for check in result.checks) < 1e-11
    assert {(run.name, run.scheme) for run in result.runs} == {
        (name, scheme) for name in ("free", "forced") for scheme in ("implicit", "rk4")
    }
    for ladder in result.ladders:
        orders = [rung.order for rung in ladder.rungs[1:]]
        np.testing.assert_allclose(orders, ladder.expected_order, atol=0.15)


def test_damped_robots_are_followed_for_a_second():
    runs = [r for r in crosscheck(softdyn.load("finger"), samples=1).runs if r.scheme == "implicit"]
    assert [run.duration for run in runs] == [pytest.approx(1.0)] * 2


def test_damping_that_couples_branches_is_compared_with_runge_kutta(tmp_path):
    model = softdyn.load(write(tmp_path, MICRO["fixed tendons: elastic, damped, coupled"]))
    assert damping_couples_branches(model, model.q0, np.zeros(model.nv))
    assert {run.scheme for run in crosscheck(model, samples=1).runs} == {"rk4"}
    model = softdyn.load(write(tmp_path, MICRO["fixed links with inertia"]))
    assert not damping_couples_branches(model, model.q0, np.zeros(model.nv))


def test_how_fast_a_falling_rod_moves(tmp_path):
    """A horizontal rod falls with q̈ = m g l / (I + m l²), whose square root is the rate."""
    level = robots.hinge(2, child="rod", name="j", limit=(-0.8, 1.1), effort=1)
    model = robots.load(tmp_path, level)
    rates = rates_of(model, model.q0, np.zeros(1))
    assert rates.motion == pytest.approx((2 * 9.81 * 0.1 / (1e-3 + 2 * 0.1**2)) ** 0.5)
    assert (rates.damping, rates.damped) == (0.0, False)


def test_figures_stand_below_the_ends_of_their_headings():
    runs = tuple(TrajectoryRun(name, "rk4", step, length, 1e-9, "") for name, step, length in
                 (("free", 5e-4, 1.0), ("forced", 1.2e-5, 0.125)))  # fmt: skip
    lines = str(CrossCheck("r", 1, 0, 1, 0, (), 1.0, runs, ())).splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("trajectory"))
    for heading in ("step s", "length s", "error"):
        end = lines[head].index(heading) + len(heading)
        for line in lines[head + 1 : head + 3]:
            assert line[end - 1].isdigit()
            assert not line[end:].startswith(tuple("0123456789"))


# -- faults ------------------------------------------------------------------------------------

FAULTY = (
    link("base")
    + link("arm")
    + link("hand")
    + link("tip", "")
    + joint("shoulder", "revolute", "base", "arm", '<dynamics damping="0.06" friction="0.2"/>')
    + spring("shoulder", 2.0, 0.3)
    + joint("wrist", "revolute", "arm", "hand", '<dynamics damping="0.01"/>', axis="1 0 0")
    + joint("tip_joint", "fixed", "hand", "tip", at="0.21 0.1 0")
    + '<softdyn version="1"><joint name="wrist" armature="0.004"/>'
    + '<tendon name="flexor"><joint name="shoulder" coef="0.5"/></tendon>'
    + '<tendon name="cable"><site link="base" xyz="0.5 0 0"/><site link="hand" xyz="0 0.3 0"/>'
    + '</tendon><tendon name="band" stiffness="5"><joint name="wrist" coef="0.25"/></tendon>'
    + '<actuator name="u1" tendon="flexor" gear="3" lower="-1" upper="1"/>'
    + '<actuator name="u2" tendon="cable" gear="-4" lower="0" upper="1"/>'
    + '<task frame="tip"/></softdyn>'
)
FORCES = {"qdd", "trajectory"}
FAULTS = {
    "sign of a gear": ('gear="-4"', 'gear="4"', {"B"} | FORCES),
    "sign of a coefficient": ('coef="0.5"', 'coef="-0.5"', {"length", "B"} | FORCES),
    "a site moved by 1 mm": ("0.3 0", "0.301 0", {"length", "B"} | FORCES),
    "joint stiffness": (">2.0<", ">2.02<", {"K", "energy"} | FORCES),
    "joint rest": (">0.3<", ">0.31<", {"K", "energy"} | FORCES),
    "tendon stiffness": ('stiffness="5"', 'stiffness="5.05"', {"K", "energy"} | FORCES),
    "armature": ('armature="0.004"', 'armature="0.00404"', {"M", "energy"} | FORCES),
    "damping": ('damping="0.06"', 'damping="0.0606"', {"D"} | FORCES),
    "task frame moved by 1 mm": ('xyz="0.21 0.1 0"', 'xyz="0.211 0.1 0"', {"tip", "J", "Jdot"}),
    "mass by 1 %": (
        'mass value="0.7"',
        'mass value="0.707"',
        {"M", "bias", "g", "energy"} | FORCES,
    ),
    "moment of inertia": ('izz="4e-3"', 'izz="4.1e-3"', {"M", "bias", "energy"} | FORCES),
    "sign of an axis": (
        'xyz="1 0 0"',
        'xyz="-1 0 0"',
        {"tip", "J", "Jdot", "M", "bias", "g", "length", "B", "energy"} | FORCES,
    ),
}


@pytest.mark.parametrize(("old", "new", "expected"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_named_by_the_quantities_that_see_it(old, new, expected, tmp_path, short):
    model = softdyn.load(write(tmp_path, FAULTY))
    changed = FAULTY.replace(old, new)
    assert changed != FAULTY
    result = crosscheck(model, twin=Twin(write(tmp_path, changed, "faulty")), samples=3)
    assert not result.passed
    assert set(result.failures) == expected, table(result)


def test_what_is_the_plants_alone_is_left_out(tmp_path, short):
    """Friction, limits, contacts, the integrator and its step do not influence the comparison."""
    model = softdyn.load(write(tmp_path, FAULTY))
    assert crosscheck(model, samples=2).passed
    options = {"limits": True, "contacts": True, "friction": True, "integrator": "euler"}
    changed = FAULTY.replace('friction="0.2"', 'friction="9"').replace('lower="-0.8"', 'lower="-1"')
    twin = Twin(write(tmp_path, changed, "faulty"), timestep=0.01, **options)
    before = twin.model.opt.disableflags, twin.qpos
    assert crosscheck(model, twin, samples=2).passed
    np.testing.assert_equal((twin.model.opt.disableflags, twin.qpos), before)


def test_a_fault_in_the_compiled_twin_is_seen(tmp_path, short):
    model = softdyn.load(write(tmp_path, FAULTY))
    twin = Twin(model)
    twin.model.dof_damping[0] *= 1.01
    assert set(crosscheck(model, twin, samples=2).failures) == {"D"} | FORCES


def test_a_fault_in_the_model_is_seen(tmp_path, monkeypatch, short):
    model = softdyn.load(write(tmp_path, FAULTY))
    monkeypatch.setattr(model, "kinetic_energy", lambda q, v: 0.0)
    assert crosscheck(model, samples=2).failures == ("energy",)


@pytest.mark.parametrize(
    ("old", "new", "reason", "failed"),
    [
        ('name="wrist"', 'name="elbow"', "joints", set(QUANTITIES)),
        (
            '<actuator name="u2" tendon="cable" gear="-4" lower="0" upper="1"/>',
            "",
            "2 actuators of the model, 1 of the twin",
            {"B", "qdd", "trajectory"},
        ),
        ("</softdyn>", '<tendon name="x"><joint name="wrist" coef="1"/></tendon></softdyn>',
         "shape (3,) of the model, (4,) of the twin", {"length"}),
    ],
    ids=["other joints", "fewer actuators", "more tendons"],
)  # fmt: skip
def test_a_misfit_is_a_failed_check_with_its_reason(old, new, reason, failed, tmp_path, short):
    model = softdyn.load(write(tmp_path, FAULTY))
    twin = Twin(write(tmp_path, FAULTY.replace(old, new), "faulty"))
    result = crosscheck(model, twin, samples=2)
    assert set(result.failures) == failed
    assert all(reason in check.reason for check in result.checks if not check.passed)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_nan_and_blow_up_are_failed_checks(value, tmp_path, short):
    model = softdyn.load(write(tmp_path, FAULTY))
    twin = Twin(model)
    twin.model.body_mass[2] = value
    result = crosscheck(model, twin, samples=2)
    assert not result.passed
    assert {"M", "qdd", "energy"} <= set(result.failures)
    data = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert [check["quantity"] for check in data["checks"]] == list(QUANTITIES)


def test_a_model_that_answers_nan_or_another_shape_fails(tmp_path, monkeypatch, short):
    model = softdyn.load(write(tmp_path, FAULTY))
    monkeypatch.setattr(model, "forward_dynamics", lambda q, v, u: np.full(2, np.nan))
    result = crosscheck(model, samples=2)
    reasons = {check.quantity: check.reason for check in result.checks}
    assert "of the model is not finite" in reasons["qdd"]
    assert not reasons["M"]
    monkeypatch.setattr(model, "forward_dynamics", lambda q, v, u: np.zeros(3))
    result = crosscheck(model, samples=2)
    assert "qdd" in result.failures
    assert "trajectory" in result.failures


# -- the rest ----------------------------------------------------------------------------------


def test_relative_error_compares_zeros():
    zero, one = np.zeros(2), np.ones(2)
    assert relative_error(zero, zero, 0.0) == 0.0
    assert relative_error(zero, one, 0.0) == 1.0
    assert relative_error(zero, 1e-12 * one, 1.0) == 1e-12
    assert relative_error(np.zeros((3, 0)), np.zeros((3, 0)), 1.0) == 0.0


def test_results_repeat_and_depend_on_the_seed(short):
    model = softdyn.load("finger")
    twin = Twin(model)
    a, b, c = (crosscheck(model, copy.copy(twin), samples=2, seed=s) for s in (1, 1, 2))
    assert a == b
    assert a.checks != c.checks


@pytest.mark.parametrize("samples", [0, -1, 1.5])
def test_bad_number_of_samples(samples):
    with refused("samples"):
        crosscheck(softdyn.load("finger"), samples=samples)


def test_script_prints_one_json_object(tmp_path, short):
    done = command("crosscheck", "finger", "--samples", 2, "--seed", 3, "--json", "-", cwd=tmp_path)
    assert (done.code, done.err) == (0, "")
    data = json.loads(done.out)
    assert (data["robot"], data["nv"], data["nu"], data["passed"]) == ("finger", 4, 2, True)
    assert [check["quantity"] for check in data["checks"]] == list(QUANTITIES)
    assert all(check["max_error"] <= check["tolerance"] for check in data["checks"])
    assert list(tmp_path.iterdir()) == []


def test_script_table_and_exit_codes(tmp_path, monkeypatch, capsys, short):
    from softdyn.commands import crosscheck as script  # the script, not the package's module

    assert script.main(["finger", "--samples", "1", "--json", str(tmp_path / "x.json")]) == 0
    printed = capsys.readouterr().out
    assert all(f"\n{quantity} " in printed for quantity in QUANTITIES)
    assert "agree" in printed
    assert json.loads((tmp_path / "x.json").read_text())["passed"] is True

    faulty = Twin(write(tmp_path, FAULTY.replace('gear="3"', 'gear="-3"'), "faulty"))
    monkeypatch.setattr(softdyn.validation, "Twin", lambda *_, **__: faulty)
    assert script.main([str(write(tmp_path, FAULTY)), "--samples", "1"]) == 1
    assert "FAILED: B, qdd, trajectory" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_robot"], "no_such_robot"),
        (["finger", "--samples", "0"], "--samples"),
        (["finger", "--seed", "-1"], "--seed"),
        (["finger", "--json", "/no/such/folder/x.json"], "/no/such/folder"),
    ],
)
def test_script_bad_input(arguments, message, tmp_path):
    code, out, err = command("crosscheck", *arguments, cwd=tmp_path)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert message in err


# -- robots that MuJoCo cannot follow --------------------------------------------------------------


def chain(count: int, *, length: float, shrink: float = 1.0, stiffness: float = 1.0) -> str:
    """Rods of water's density, 10 times as long as thick; each is `shrink` times the one before.

    The springs are `stiffness` N m/rad at the first joint, and scale with length⁴ as the inertias
    do with length⁵.
    """
    text, offset = link("l0", ""), 0.0
    for k in range(1, count + 1):
        rod = length * shrink ** (k - 1)
        mass = 1000 * math.pi / 400 * rod**3
        moment = mass * rod**2 / 12
        text += (
            robots.link(f"l{k}", mass, f"{rod / 2} 0 0", f"{0.1 * moment} {moment} {moment}")
            + joint(f"j{k}", "revolute", f"l{k - 1}", f"l{k}", at=f"{offset} 0 0", rpy="0 0 0",
                    axis=("0 1 0", "0 0 1")[k % 2])
            + spring(f"j{k}", stiffness * shrink ** (4 * (k - 1)), 0.0)
        )  # fmt: skip
        offset = rod
    return text


ILL_CONDITIONED = chain(20, length=3.0, shrink=0.7)


@pytest.mark.parametrize(
    ("robot", "missing", "reason"),
    [
        # 1e4 N m/rad on 3e-10 kg m²: accelerations of 1e13 rad/s² at the start
        ({"count": 3, "length": 0.01, "stiffness": 1e4}, {"trajectory"}, "acceleration"),
        # 3e-17 kg m² of the last rod: MuJoCo calls a pivot of M below mjMINVAL = 1e-15 singular
        ({"count": 3, "length": 4e-4, "stiffness": 1e-11}, {"qdd", "trajectory"}, "1e-15 kg m²"),
    ],
    ids=["stiff springs", "tiny inertia"],
)
def test_a_robot_that_mujoco_cannot_follow_is_compared_by_its_terms(
    robot, missing, reason, tmp_path
):
    path = write(tmp_path, chain(**robot))
    result = crosscheck(softdyn.load(path), samples=2)
    assert {check.quantity for check in result.checks if not check.compared} == missing
    assert all(reason in check.reason for check in result.checks if not check.compared)
    assert result.passed
    assert result.verdict.startswith("the terms agree; no ")
    assert reason in result.verdict
    assert json.dumps(result.to_dict(), allow_nan=False)


def test_what_mujoco_cannot_follow_is_a_failure_beside_a_term_that_differs(tmp_path):
    """A wrong term may be why MuJoCo cannot go on."""
    tiny = chain(count=3, length=4e-4, stiffness=1e-11)
    model = softdyn.load(write(tmp_path, tiny))
    twin = Twin(write(tmp_path, tiny.replace('xyz="0.0004 0 0"', 'xyz="0.00041 0 0"'), "faulty"))
    result = crosscheck(model, twin, samples=2)
    assert {"tip", "M", "qdd", "trajectory"} <= set(result.failures)
    assert result.verdict.startswith("FAILED: ")


def test_a_scheme_that_mujoco_cannot_follow_leaves_the_other(tmp_path, monkeypatch, short):
    follow = trajectories.Race.run

    def run(race, name, scheme, share, rng):
        if scheme is trajectories.RK4:
            raise trajectories.SimulationError(0.0, "a test")
        return follow(race, name, scheme, share, rng)

    monkeypatch.setattr(trajectories.Race, "run", run)
    result = crosscheck(softdyn.load(write(tmp_path, FAULTY)), samples=2)
    assert result.passed, table(result)
    assert [(run.scheme, run.why) for run in result.runs if not run.duration] == [("rk4", "a test")]
    assert {run.scheme for run in result.runs if run.duration} == {"implicit"}


def test_accelerations_are_held_against_the_condition_of_the_mass_matrix(tmp_path):
    """Two solvers that are exact to rounding ε answer M q̈ = f within n ε cond(M).

    NumPy's own solve, by LU, is the third opinion: it is as far from the model's.
    """
    model = softdyn.load(write(tmp_path, ILL_CONDITIONED))
    result = crosscheck(model, samples=5, trajectories=False)
    assert result.passed, table(result)
    found = next(check for check in result.checks if check.quantity == "qdd")
    assert 1e-10 < found.max_error < found.tolerance <= 1e-6
    rng = np.random.default_rng(0)
    apart = 0.0
    for _ in range(5):
        q, v, u = *random_state(model, rng), np.zeros(0)
        state = model.state(q, v)
        solved = np.linalg.solve(state.M, -state.h)
        apart = max(apart, relative_error(model.forward_dynamics(q, v, u), solved, 1.0))
    assert 0.01 * found.max_error < apart < 100 * found.max_error


def test_the_condition_of_the_mass_matrix_excuses_no_wrong_acceleration(tmp_path, monkeypatch):
    model = softdyn.load(write(tmp_path, ILL_CONDITIONED))
    right = model.forward_dynamics
    monkeypatch.setattr(model, "forward_dynamics", lambda q, v, u: 1.00001 * right(q, v, u))
    assert crosscheck(model, samples=2, trajectories=False).failures == ("qdd",)
