"""Maxwell branches against hereditary integrals and the exact solution of a linear joint."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import softdyn
from softdyn import InputError, UrdfError, design
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.dynamics.mimic import build
from softdyn.dynamics.relaxation import Branches, without_branches
from softdyn.statics.suspicious_values import fast_springs
from softdyn.validation import PlantErrors, Twin, compare, crosscheck, rollout
from tests.support import robots
from tests.support.command import command
from tests.support.robots import GRIPPER, hinge
from tests.support.robots import build as build_text

SPRING, DAMPER, INERTIA = 2.0, 0.05, 0.01  # N m/rad, N m s/rad, kg m²
BRANCHES = ((0.6, 0.2), (0.3, 0.05))


def creeping(robot: softdyn.Robot, share: float = 0.25, time: float = 1.5) -> softdyn.Robot:
    joints = [
        replace(one, relaxation=((share * one.stiffness, time),)) if one.stiffness else one
        for one in robot.joints
    ]
    return replace(robot, joints=tuple(joints))


def one_joint() -> softdyn.SoftModel:
    """A joint about the vertical, with a unit gear on its angle."""
    numbers = " ".join(f"{k} {time}" for k, time in BRANCHES)
    return build_text(hinge(
        1, "0 0 0", f"1 1 {INERTIA}", axis="0 0 1", limit=(-3, 3), damping=DAMPER, stiffness=SPRING,
        pull=(-9, 9), block=f'<joint name="hinge" relaxation="{numbers}"/>',
    ))  # fmt: skip


def deflection(t: float, torque: float) -> float:
    """The joint's angle at t (s) after a step of torque, by the exponential of a matrix."""
    A, n = np.zeros((2 + len(BRANCHES),) * 2), len(BRANCHES)
    A[0, 1] = 1.0
    A[1] = [-SPRING / INERTIA, -DAMPER / INERTIA, *[-1 / INERTIA] * n]
    for j, (k, time) in enumerate(BRANCHES, 2):
        A[j, 1], A[j, j] = k, -1 / time
    rest = np.linalg.solve(A, np.eye(len(A))[1] * -torque / INERTIA)
    return float((rest - expm(A * t) @ rest)[0])


def test_the_torque_of_a_motion_in_lines_is_the_hereditary_integral() -> None:
    model, h = one_joint(), 0.01
    q = np.cumsum(np.random.default_rng(1).normal(size=200))
    twin, branches, z = Twin(model, timestep=h), Branches.of(model), np.zeros(len(BRANCHES))
    for before, after in pairwise(q):
        twin.memory.follow(np.full(len(BRANCHES), before), np.array([after]))
        z = branches.decay(h) * z + branches.gain(h) * (branches.rates[:, 0] * (after - before))
    ends = h * np.arange(1, len(q))
    exact = [
        np.diff(q) / h @ (k * time * (np.exp((ends - ends[-1]) / time)
                                      - np.exp((ends - h - ends[-1]) / time)))
        for k, time in BRANCHES
    ]  # fmt: skip
    assert twin.memory.torque == pytest.approx(exact, abs=1e-12)
    assert z == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize(("scheme", "order", "most"), [("implicitfast", 1, 2e-3), ("rk4", 4, 1e-8)])
def test_a_step_of_torque_on_one_joint_converges(scheme: str, order: int, most: float) -> None:
    model, torque, times = one_joint(), 1.5, (0.02, 0.1, 0.5)
    final = torque / SPRING
    worst = []
    for h in (1e-3, 5e-4):
        twin, errors, at = Twin(model, timestep=h, integrator=scheme), [], 0.0
        for t in times:
            twin.advance(np.array([torque]), round((t - at) / h))
            errors.append(abs(twin.qpos[0] - deflection(t, torque)) / final)
            at = t
        worst.append(max(errors))
    assert worst[1] < most
    assert worst[0] / worst[1] == pytest.approx(2**order, rel=0.1)


def test_hysteresis_follows_dahl_s_equation() -> None:
    width, largest = 0.1, 9.0
    twin = PlantErrors(hysteresis=width).twin(build(without_branches(one_joint()).robot))
    limit, path = width * largest / 2, [0.0, 2.0, -2.0, 0.1, -0.3, 2.0]
    z, found, exact = 0.0, [], []
    for before, after in pairwise(path):
        sign = np.sign(after - before)
        slope = lambda q, z, s=sign: SPRING * (1 - s * z / limit)  # noqa: E731
        z = solve_ivp(slope, (before, after), [z], rtol=1e-10, atol=1e-12).y[0, -1]
        for a, b in pairwise(np.linspace(before, after, 8)):
            twin.memory.follow(np.array([a]), np.array([b]))
        found.append(twin.memory.torque[0])
        exact.append(z)
    assert found == pytest.approx(exact, abs=1e-8)
    assert found[0] == pytest.approx(limit, rel=1e-3)
    with pytest.raises(InputError):
        PlantErrors(hysteresis=-0.1)


def test_rest_state_and_export_are_those_of_the_relaxed_spring(tmp_path: Path) -> None:
    plain, soft = softdyn.load("finger"), build(creeping(softdyn.load("finger").robot))
    q, v = np.full(plain.nq, 0.2), np.full(plain.nv, 0.3)
    ours, theirs = plain.state(q, v), soft.state(q, v)
    for name in ("M", "K", "D", "h", "B"):
        assert (getattr(ours, name) == getattr(theirs, name)).all()
    assert soft.robot.digest != plain.robot.digest
    twin = Twin(one_joint())
    twin.advance(np.array([1.5]), 8000)
    assert twin.qpos == pytest.approx([1.5 / SPRING], abs=1e-6)
    assert twin.memory.torque == pytest.approx([0.0, 0.0], abs=1e-6)
    assert crosscheck(soft, samples=3, trajectories=False).passed
    urdf = robots.write(tmp_path, write(soft.robot))
    assert softdyn.load(urdf).robot.joints == soft.robot.joints
    found = compare(urdf, softdyn.load("finger").robot.path)
    assert {one.where for one in found.causes} == {f"relaxation of {n}" for n in soft.joint_names}
    done = command("export", str(urdf), "--mjcf", str(tmp_path / "soft.xml"))
    assert done.err.count("its branches of relaxation") == soft.nv


def test_a_rollout_and_the_model_as_the_plant_creep_too() -> None:
    model = one_joint()
    u, twin = np.full((50, 1), 1.5), Twin(model)
    twin.advance(u[0], 200)
    for plant in (None, "model"):
        log = rollout(model, u, 0.1, period=2e-3, timestep=5e-4, plant=plant)
        assert log.q[-1] == pytest.approx(twin.qpos, abs=1e-12)


def test_followers_creep_and_a_copied_twin_has_its_own_torques() -> None:
    twin = Twin(build(creeping(parse_text(GRIPPER, path=Path("gripper.urdf")))))
    twin.advance(np.array([1.0, 0.0, 0.0]), 200)
    assert len(twin.memory.torque) == 2
    assert np.abs(twin.memory.torque).min() > 1e-6
    again = twin.__copy__()
    again.reset()
    assert again.memory.torque.any() != twin.memory.torque.any()


def test_a_fast_mode_meets_the_instantaneous_stiffness() -> None:
    soft = one_joint()
    instant = SPRING + sum(k for k, _ in BRANCHES)
    assert Branches.of(soft).matrix == pytest.approx(np.array([[instant - SPRING]]))
    # the step that 4 m + 2 h d - h² k > 0 allows with the branches, and without
    limits = [(DAMPER + np.sqrt(DAMPER**2 + 4 * k * INERTIA)) / k for k in (instant, SPRING)]
    state = soft.state(soft.q0, np.zeros(1))
    assert fast_springs(soft, state, 0.99 * limits[0]) is None
    assert "2.9" in (fast_springs(soft, state, 1.01 * limits[0]) or "")
    assert limits[1] > 1.1 * limits[0]


def test_a_prony_series_makes_the_branches_of_an_arm() -> None:
    series = ((0.15, 0.8), (0.1, 12.0))

    def arm(**words: Any) -> softdyn.SoftModel:
        material = design.Material(0.25e6, **words)
        section = design.Section(length=0.2, radius=0.01, material=material, segments=2)
        return build(parse_text(design.urdf(design.Arm((section,))), path=Path("arm.urdf")))

    plain, instant = arm(), arm(relaxation=series, modulus="instantaneous")
    relaxed = arm(relaxation=series, modulus="relaxed")
    assert instant.stiffness == pytest.approx(0.75 * plain.stiffness)
    assert (relaxed.stiffness == plain.stiffness).all()
    for model in (instant, relaxed):
        total = np.diag(Branches.of(model).matrix) + model.stiffness
        assert total == pytest.approx(model.stiffness / 0.75)
        assert {time for j in model.robot.joints for _, time in j.relaxation} == {0.8, 12.0}
    for bad in (
        {"relaxation": ((0.6, 1.0), (0.4, 2.0)), "modulus": "relaxed"},
        {"relaxation": ((0.1, 0.0),), "modulus": "relaxed"},
        {"relaxation": series * 2, "modulus": "relaxed"},
        {"relaxation": series},
    ):
        with pytest.raises(InputError):
            arm(**bad)


@pytest.mark.parametrize("numbers", ["1 0", "1 -2", "1", "1 2 3", "1 1 2 2 3 3 4 4", "-1 2"])
def test_bad_branches_of_a_file_are_refused(numbers: str) -> None:
    text = write(one_joint().robot)
    with pytest.raises(UrdfError):
        parse_text(text.replace("0.6 0.2 0.3 0.05", numbers), path=Path("one.urdf"))
