"""Mimic joints: the projected dynamics against Pinocchio's own mimic joints and the twin."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn import SoftModel, UrdfError
from softdyn.description.library import find
from softdyn.description.urdf import parse
from softdyn.dynamics.coordinates import Coordinates
from softdyn.dynamics.mimic import MimicModel
from softdyn.dynamics.reduced import ReducedModel
from softdyn.dynamics.tree import TreeModel, tree_of
from softdyn.validation import StateMap, Twin, crosscheck
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.twin.free_base import step_free_rk4
from tests.support.refused import refused
from tests.support.robots import GRIPPER, changed, joint, link, load, robot, solids, weld, write


@pytest.fixture
def gripper(tmp_path: Path) -> SoftModel:
    return load(tmp_path, GRIPPER)


def test_followers_are_no_degrees_of_freedom(gripper):
    assert isinstance(gripper, MimicModel)
    assert gripper.joint_names == ("z_arm", "a_lead")
    assert (gripper.nq, gripper.nv, gripper.nu) == (2, 2, 3)
    assert sorted(joint.name for joint in gripper.robot.followers) == ["b_slide", "c_turn"]


def test_expansion_is_the_files_relation(gripper):
    q = np.array([-0.4, 0.3])
    full = dict(zip(gripper.tree.joint_names, gripper.tree.coordinates(gripper.expand(q)),
                    strict=True))  # fmt: skip
    assert full["a_lead"] == pytest.approx(0.3, abs=1e-15)
    assert full["b_slide"] == pytest.approx(-0.5 * 0.3 + 0.02, abs=1e-15)
    assert full["c_turn"] == pytest.approx(2 * 0.3 - 0.1, abs=1e-15)


def test_every_public_method_is_defined_anew():
    """Both kinds of model follow the protocol; its own methods only use the others."""
    public = {name for name, _ in inspect.getmembers(SoftModel, callable) if name[0] != "_"}
    for kind in (TreeModel, MimicModel, ReducedModel):
        own = {
            name for base in kind.__mro__[: kind.__mro__.index(SoftModel)] for name in vars(base)
        }
        shared = {"link_velocity", "measure", "potential_energy", "states", "tangent_stiffness"}
        assert public - own <= shared


def test_what_asks_for_the_engine_is_told(gripper):
    assert isinstance(gripper, SoftModel)
    assert not isinstance(gripper, TreeModel)
    assert not hasattr(gripper, "pin_model")
    with refused("model", "gripper"):
        tree_of(gripper)


def test_coefficients_of_joints_are_exact(gripper):
    """Springs, dampers and armature of followers, moved to the leader."""
    q, v = np.array([0.3, 0.1]), np.array([0.2, -0.7])
    state = gripper.state(q, v)
    tendons = gripper.tendon_moment_arms(q)
    elastic = gripper.tendon_stiffness * (gripper.tendon_lengths(q) - gripper.tendon_rest)
    joints = gripper.stiffness * (q - gripper.rest)
    np.testing.assert_allclose(state.K, joints + tendons.T @ elastic, rtol=1e-12)
    dampers = np.diag(gripper.damping) + tendons.T @ np.diag(gripper.tendon_damping) @ tendons
    np.testing.assert_allclose(state.D, dampers, rtol=1e-12)
    assert gripper.armature == pytest.approx([0.002, 0.01 * 2**2 + 0.003])


@pytest.mark.filterwarnings("ignore")
def test_pinocchios_own_mimic_joints_agree():
    path = find("panda")
    model = softdyn.load(path)
    theirs = pin.buildModelFromUrdf(str(path), True)
    assert theirs.nv == model.nv == 8
    order = [theirs.joints[theirs.getJointId(name)].idx_v for name in model.joint_names]
    data, rng = theirs.createData(), np.random.default_rng(0)
    tip = theirs.getFrameId(model.robot.task)
    for _ in range(3):
        q, v = rng.normal(size=8), rng.normal(size=8)
        other_q, other_v = np.empty(8), np.empty(8)
        other_q[order], other_v[order] = q, v
        state = model.state(q, v)
        M = np.array(pin.crba(theirs, data, other_q))
        np.testing.assert_allclose(state.M, M[np.ix_(order, order)], atol=1e-12)
        bias = pin.rnea(theirs, data, other_q, other_v, np.zeros(8))
        np.testing.assert_allclose(state.bias, bias[order], atol=1e-12)
        pin.forwardKinematics(theirs, data, other_q)
        pin.updateFramePlacements(theirs, data)
        np.testing.assert_allclose(state.y, data.oMf[tip].translation, atol=1e-13)


@pytest.mark.parametrize("floating", [False, True])
def test_the_twin_agrees(floating, tmp_path):
    model = softdyn.load(write(tmp_path, GRIPPER), floating=floating)
    result = crosscheck(model, samples=4, trajectories=not floating)
    assert result.passed, [(c.quantity, c.max_error, c.reason) for c in result.checks]


def test_a_free_base_with_followers_is_followed_by_both_engines(tmp_path):
    """Twenty Runge–Kutta steps, by our model and by `MujocoTerms` with followers."""
    model = softdyn.load(write(tmp_path, GRIPPER), floating=True)
    twin = Twin(model, limits=False)
    judge, rng = MujocoTerms(twin, StateMap(model, twin)), np.random.default_rng(2)
    q, v = model.configuration(rng.uniform(-0.3, 0.3, model.nv)), rng.uniform(-1, 1, model.nv)
    u = rng.uniform(model.u_min, model.u_max)
    judge.start(q, v, "rk4", 1e-3)
    ((coordinates, velocity),) = judge.follow([u], [20])
    for _ in range(20):
        q, v = step_free_rk4(model, q, v, u, 1e-3)
    np.testing.assert_allclose(model.coordinates(q), coordinates, atol=1e-12)
    np.testing.assert_allclose(v, velocity, atol=1e-11)


def test_omitted_rest_lengths_are_those_at_q_0(gripper):
    """There, followers are at their offsets in both engines."""
    lengths = gripper.tendon_lengths(gripper.q0)
    np.testing.assert_allclose(gripper.tendon_rest, lengths, atol=1e-14)
    assert np.abs(lengths - gripper.tree.tendon_lengths(gripper.tree.q0)).min() > 1e-3
    twin = Twin(gripper)
    np.testing.assert_allclose(twin.model.tendon_lengthspring[:, 0], lengths, atol=1e-14)
    np.testing.assert_allclose(twin.data.ten_length, lengths, atol=1e-14)


def test_the_plant_holds_followers_by_stiff_ties(gripper):
    """docs/conventions.md states how far they give way."""
    twin = Twin(gripper)
    states = StateMap(gripper, twin)
    twin.set_state(*states.to_twin([0.3, -0.2], [1.0, 2.0]))
    worst = 0.0
    for u in (1.0, -1.0, 0.5, -0.5):
        for _ in range(100):
            twin.advance(np.full(gripper.nu, u))
            q, v = states.from_twin(twin.qpos, twin.qvel)
            worst = max(worst, np.abs(states.to_twin(q, v)[0] - twin.qpos).max())
    assert 0 < worst < 1e-3


def test_a_massless_follower_moves_with_its_leader(tmp_path):
    light = changed(GRIPPER, (solids("jaw"), link("jaw")))
    assert light.count("<inertial>") == GRIPPER.count("<inertial>") - 1
    assert load(tmp_path, light).nv == 2
    with refused('<link name="jaw">', "none on or beyond joint 'b_slide'", by=UrdfError):
        load(tmp_path, light.replace('<mimic joint="a_lead" multiplier="-0.5" '
                                                   'offset="0.02"/>', ""))  # fmt: skip


def slides(*mimics: str) -> str:
    """Three masses of 1, 2 and 3 kg on vertical slides; the last two follow."""
    parts = [
        link(f"l{k}", k)
        + joint(f"s{k}", "base", f"l{k}", "0 0 1", "prismatic", at=f"0 {k} 0", inside=mimic)
        for k, mimic in zip((1, 2, 3), ("", *mimics), strict=True)
    ]
    return robot("slides", link("base"), *parts)


FIRST = '<mimic joint="s1" multiplier="2" offset="0.1"/>'


def test_a_chain_of_followers_is_composed(tmp_path):
    """q₃ = 0.5 (2 q₁ + 0.1): M = 1 + 4 · 2 + 3, g = (1 + 2 · 2 + 3) 9.81."""
    chain = load(tmp_path, slides(FIRST, '<mimic joint="s2" multiplier="0.5"/>'))
    state = chain.state([0.2], [0.0])
    np.testing.assert_allclose([state.M[0, 0], state.g[0]], [12.0, 8 * 9.81])
    poses = chain.link_poses(np.array([0.2]))
    assert [poses[f"l{k}"][2, 3] for k in (1, 2, 3)] == pytest.approx([0.2, 0.5, 0.25])
    flat = parse(write(tmp_path, slides(FIRST, '<mimic joint="s1" offset="0.05"/>')))
    assert flat == chain.robot
    assert crosscheck(chain, samples=3).passed


def test_the_file_may_state_a_chain_in_any_order(tmp_path):
    """Here the first follower follows the second one, which the file states later."""
    text = slides('<mimic joint="s3" multiplier="2"/>', '<mimic joint="s1" multiplier="-1"/>')
    model = load(tmp_path, text)
    np.testing.assert_allclose(model.state([0.0], [0.0]).M, [[1 + 4 * 2 + 3]])
    assert crosscheck(model, samples=3).passed


def test_a_leader_may_be_beyond_its_follower(tmp_path):
    """The first hinge follows the second: M = Sᵀ M_tree S with S = (2, 1)."""
    follows = '<mimic joint="second" multiplier="2" offset="0.3"/>'
    text = robot(
        "two", link("base"), link("a", 1), link("b", 2),
        joint("first", "base", "a", "1 0 0", at="0 0.2 0", inside=follows),
        joint("second", "a", "b", "1 0 0", at="0 0.2 0"),
    )  # fmt: skip
    model = load(tmp_path, text)
    assert crosscheck(model, samples=3).passed
    assert model.joint_names == ("second",)
    full = load(tmp_path, re.sub("<mimic[^>]*>", "", text))
    S, q = np.array([2.0, 1.0]), 0.4
    free, tied = full.state([2 * q + 0.3, q], [0.0, 0.0]), model.state([q], [0.0])
    np.testing.assert_allclose(tied.M[0, 0], S @ free.M @ S, rtol=1e-12)
    np.testing.assert_allclose(tied.g, [S @ free.g], rtol=1e-12)


def test_continuous_joints_lead_and_follow(tmp_path):
    """M = 0.001 + 2² · 0.002; the followers' poses do not depend on the leader's turns."""
    follows = '<mimic joint="ja" multiplier="-2" offset="0.5"/>'
    places = {"axis": "0 0 1", "kind": "continuous", "at": "0 0.2 0"}
    text = robot(
        "gears", link("base"), link("a", 0.1), link("b", 0.1, None, "1e-3 1e-3 2e-3"),
        link("c", 0.1, None, "1e-3 1e-3 0"), joint("ja", "base", "a", **places),
        joint("jb", "base", "b", **places, inside=follows), weld("b", "c", "0 0.1 0"),
    )  # fmt: skip
    model = load(tmp_path, text)
    assert (model.nq, model.nv) == (2, 1)
    moved = 0.1 * 0.1**2  # of the mass on the gear
    for angle in (0.0, 2.0, 3.1, -3.1, 3.2):
        q = model.configuration(np.array([angle]))
        np.testing.assert_allclose(model.state(q, [0.0]).M, [[0.009 + 4 * moved]])
        turn = -2 * angle + 0.5
        at = model.link_poses(q)["c"][:2, 3] - [0, 0.2]
        assert at == pytest.approx([-0.1 * np.sin(turn), 0.1 * np.cos(turn)])
    q, still = model.integrate(model.configuration([3.1]), np.array([0.2])), np.zeros(1)
    assert model.coordinates(q) == pytest.approx(3.3 - 2 * np.pi)
    twin = Twin(model)
    assert StateMap(model, twin).to_twin(q, still)[0] == pytest.approx(
        [3.3 - 2 * np.pi, -2 * (3.3 - 2 * np.pi) + 0.5]
    )
    assert crosscheck(model, samples=3).passed


def test_a_model_of_the_tree_alone_is_refused(tmp_path):
    with refused("robot"):
        TreeModel(parse(write(tmp_path, GRIPPER)))


def test_the_numbers_of_chosen_joints():
    """A continuous joint has two in q, the others one."""
    chart = Coordinates(6, np.array([0, 1, 3, 5]), np.array([False, True, True, False]), False)
    chosen = chart.numbers_of(np.array([False, True, False, True]))
    assert sorted(chosen) == [1, 2, 5]
    assert sorted(chart.numbers_of(np.ones(4, bool))) == [0, 1, 2, 3, 4, 5]
