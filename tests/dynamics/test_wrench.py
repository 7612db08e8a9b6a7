"""A constant wrench: against MuJoCo's applied force, differences, and the elastica."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipeinc, ellipkinc

import softdyn
from softdyn import InputError, SoftModel, design, statics
from softdyn.dynamics import ForceBalance, Wrench
from softdyn.dynamics.forces import differences
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin
from tests.support.arms import PROJECTIONS
from tests.support.named_models import named_model
from tests.support.oracles import gradient, relative

FORCE, TORQUE, POINT = [1.0, -2.0, 3.0], [0.3, 0.2, -0.1], [0.02, -0.01, 0.05]


JUDGED = ("finger", "helix", "spirob48", "walker", "mimic", *range(8))  # that have a twin


@pytest.fixture(params=[*JUDGED, *(name for name in PROJECTIONS if name not in JUDGED)], ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def random_configuration(model: SoftModel) -> np.ndarray:
    rng = np.random.default_rng(3)
    low, high = np.maximum(model.lower, -0.7), np.minimum(model.upper, 0.7)
    return model.configuration(rng.uniform(low, high))


@pytest.mark.parametrize("axes", ["world", "link"])
def test_its_derivative_is_that_by_differences(model, axes):
    q, v = random_configuration(model), np.zeros(model.nv)
    for link in (model.robot.task, model.robot.links[len(model.robot.links) // 2].name):
        wrench = Wrench(link, FORCE, TORQUE, POINT, axes)
        by_q, by_v = wrench.derivatives(model, q, v)
        assert relative(by_q, differences(wrench, model, q, v)[0], 1e-3) < 1e-7
        assert not by_v.any()


def test_a_force_in_the_worlds_axes_is_the_gradient_of_its_energy(model):
    q, v = random_configuration(model), np.zeros(model.nv)
    wrench = Wrench(model.robot.task, FORCE, point=POINT)
    slope = gradient(model, lambda x: wrench.energy(model, x), q)
    assert relative(-slope, wrench(model, q, v), 1e-3) < 1e-9
    for other in (Wrench("x", FORCE, axes="link"), Wrench("x", torque=TORQUE)):
        assert other.energy(model, q) is None


@pytest.mark.parametrize("model", JUDGED, indirect=True, ids=str)
@pytest.mark.parametrize("axes", ["world", "link"])
def test_mujoco_applies_the_same_force(model, axes):
    twin = Twin(model)
    judge, q = MujocoTerms(twin, StateMap(model, twin)), random_configuration(model)
    v = np.zeros(model.nv)
    judge.set_state(q, v)
    engine, data, compared = judge._model, judge._data, 0
    for body in range(1, engine.nbody):
        link = engine.body(body).name
        if link not in {one.name for one in model.robot.links}:
            continue
        turn = data.xmat[body].reshape(3, 3)
        axes_turn = turn if axes == "link" else np.eye(3)
        joint_force = np.zeros(engine.nv)
        mujoco.mj_applyFT(engine, data, axes_turn @ FORCE, axes_turn @ TORQUE,
                          data.xpos[body] + turn @ POINT, body, joint_force)  # fmt: skip
        found = Wrench(link, FORCE, TORQUE, POINT, axes)(model, q, v)
        assert relative(found, judge._map.T @ joint_force, 1e-3) < 1e-10, link
        compared += 1
    assert compared


class Drag:
    """A drag of each link by its velocity, with one coefficient a link."""

    name = "drag"

    def __init__(self, coefficients: dict[str, float]) -> None:
        self.coefficients = coefficients

    def __call__(self, model, q, v):
        total = np.zeros(model.nv)
        for link, coefficient in self.coefficients.items():
            J = model.link_jacobian(q, link)[:3]
            total -= coefficient * J.T @ (J @ v)
        return total


@pytest.mark.parametrize("model", JUDGED, indirect=True, ids=str)
def test_a_drag_is_that_of_mujocos_own_velocities(model):
    twin, rng = Twin(model), np.random.default_rng(4)
    judge, q = MujocoTerms(twin, StateMap(model, twin)), random_configuration(model)
    v = rng.normal(size=model.nv)
    judge.set_state(q, v)
    engine, data, coefficients, found = judge._model, judge._data, {}, np.zeros(judge._model.nv)
    for body in range(1, engine.nbody):
        link = engine.body(body).name
        if link not in {one.name for one in model.robot.links}:
            continue
        coefficients[link] = rng.uniform(0.1, 1.0)
        velocity, jacobian = np.zeros(6), np.zeros((3, engine.nv))
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(engine, data, kind, body, velocity, 0)
        mujoco.mj_jacBody(engine, data, jacobian, None, body)
        found -= coefficients[link] * jacobian.T @ velocity[3:]
    assert coefficients
    wet = model.with_forces(Drag(coefficients))
    assert relative(wet.forces_at(q, v), judge._map.T @ found) < 1e-12


def test_it_is_the_disturbance_at_the_tip(model):
    wet, q = model.with_forces(Wrench(model.robot.task, FORCE)), random_configuration(model)
    v, u = np.ones(model.nv), np.zeros(model.nu)
    own = ForceBalance(wet, motors=())(q, v, v, u)
    disturbed = ForceBalance(model, (softdyn.dynamics.Disturbance.TIP_FORCE,), motors=())
    other = disturbed(q, v, v, u, FORCE)
    assert relative(own.residual, other.residual) < 1e-12
    assert relative(own.by_q, other.by_q) < 1e-12


def test_two_wrenches_need_two_names():
    finger = softdyn.load("finger").with_forces(Wrench("tip", FORCE))
    with pytest.raises(InputError):
        finger.with_forces(Wrench("tip", TORQUE))
    both = finger.with_forces(Wrench("tip", TORQUE, name="other"))
    assert [one.name for one in both.forces] == ["wrench_tip", "other"]


@pytest.mark.parametrize(
    "bad", [{"force": [1, 2]}, {"axes": "body"}, {"torque": [0, 0, np.nan]}, {"link": 3}]
)
def test_bad_input_is_refused(bad):
    with pytest.raises(InputError):
        Wrench(**{"link": "tip", **bad})


def test_a_link_that_the_robot_lacks_is_named():
    with pytest.raises(softdyn.ForceError) as caught:
        softdyn.load("finger").with_forces(Wrench("tipp")).state(np.zeros(4), np.zeros(4))
    assert "'tip'" in caught.value.got


def elastica(load: float) -> tuple[float, float]:
    """Axial and transverse displacement of a cantilever's tip over its length, P L² / EI = load.

    The closed form by elliptic integrals; Mattiasson (Int. J. Numer. Methods Eng. 17, 1981)
    tabulates it.
    """

    def terms(tip_angle: float) -> tuple[float, float]:
        m = (1 + np.sin(tip_angle)) / 2
        start = np.arcsin(1 / np.sqrt(2 * m))
        whole, second = (f(np.pi / 2, m) - f(start, m) for f in (ellipkinc, ellipeinc))
        return whole, second

    angle = brentq(lambda x: terms(x)[0] - np.sqrt(load), 1e-6, np.pi / 2 - 1e-9, xtol=1e-14)
    bent = 1 - 2 * terms(angle)[1] / np.sqrt(load)
    return 1 - np.sqrt(2 * np.sin(angle) / load), bent


# load: axial and transverse displacement in Mattiasson's table, and the error at 40 joints
CANTILEVER = {1.0: (0.05643, 0.30172, 1e-4), 10.0: (0.55500, 0.81061, 3e-4)}


@pytest.mark.parametrize("load", CANTILEVER)
def test_a_cantilever_bends_as_the_elastica(load, tmp_path):
    EI, length, errors = 0.02, 0.4, []
    *table, bar = CANTILEVER[load]
    exact = elastica(load)
    np.testing.assert_allclose(exact, table, atol=6e-6)
    for joints in (20, 40, 80):
        section = design.Section(
            length, 0.01, design.Material(1e6), joints, ("bend_z",), bending_stiffness=EI
        )
        # it bends in the horizontal plane, so that its weight does not count
        arm = design.Arm((section,), mount=design.Mount((0, 0, 0), (1, 0, 0), 0.0), name="beam")
        file = tmp_path / f"{joints}.urdf"
        file.write_text(design.urdf(arm), encoding="utf-8")
        beam = softdyn.load(file)
        tip = Wrench(beam.robot.task, force=[0, load * EI / length**2, 0])
        found = statics.settle(beam.with_forces(tip), beam.relaxed)
        x, y, _ = found.y / length
        errors.append(np.array([1 - x, y]) - exact)
        assert found.stable
        if joints == 40:
            assert np.abs(errors[-1] - (np.array(table) - exact)).max() <= bar
    for coarse, fine in pairwise(errors):
        np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.05)
