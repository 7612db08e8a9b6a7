"""Presets of `softdyn new`: their files have the stated numbers, in both engines."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn.commands import new
from softdyn.design.log_spiral import LogSpiral
from softdyn.validation import crosscheck
from tests.support.refused import refused

SPIRAL = """\
name = "spiral"
[log_spiral]
length_mm = 300
segments = 4
ratio = 0.82
radius_mm = 20
mass_g = 120
joint_stiffness_Nm_rad = 0.05
joint_damping_Nms_rad = 0.005
joint_armature_kgm2 = 0.0005
max_tension_N = 20
"""
FINGER = """\
name = "index"
[finger]
lengths_mm = [45, 30, 25]
radius_mm = [9, 7]
density_kg_m3 = 1100
joint_stiffness_Nm_rad = [0.05, 0.04, 0.03]
joint_damping_Nms_rad = 0.002
[[tendon]]
joints = [1, 2, 3]
moment_arm_mm = [7, 6, 5]
max_tension_N = 20
[[tendon]]
joints = [1]
moment_arm_mm = [7]
max_tension_N = 10
pair = true
"""


def written(text: str, folder: Path) -> softdyn.SoftModel:
    (folder / "robot.toml").write_text(text)
    assert new.main([str(folder / "robot.toml"), "--out", str(folder / "robot.urdf")]) == 0
    return softdyn.load(folder / "robot.urdf")


def test_a_log_spiral(tmp_path):
    model = written(SPIRAL, tmp_path)
    assert (model.nv, model.nu) == (9, 3)
    assert (tmp_path / "meshes" / "spiral.stl").stat().st_size > 1000
    np.testing.assert_allclose(model.state(model.q0, np.zeros(9)).y, [0, 0, -0.3], atol=1e-12)
    masses = [link.inertia.mass for link in model.robot.links if link.inertia.mass]
    assert sum(masses) == pytest.approx(0.12)
    assert masses[2] / masses[1] == pytest.approx(0.82**3)
    assert crosscheck(model, samples=2, trajectories=False).passed
    np.testing.assert_array_equal(model.armature, 0.0005)
    bare = written(SPIRAL.replace("joint_armature_kgm2 = 0.0005\n", ""), tmp_path)
    np.testing.assert_array_equal(bare.armature, 0.0)
    for freedom in ("extension", "bned_y"):
        with refused("freedoms"):
            LogSpiral(0.3, 0.12, 4, 0.82, 0.02, 0.05, 0.005, freedoms=("bend_y", freedom))


def test_a_finger(tmp_path):
    model = written(FINGER, tmp_path)
    state = model.state(model.q0, np.zeros(3))
    np.testing.assert_allclose(state.y, [0.1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(state.B.T, [[7e-3, 6e-3, 5e-3], [7e-3, 0, 0]], rtol=1e-12)
    np.testing.assert_array_equal(model.u_min, [0, -10])
    np.testing.assert_allclose(model.stiffness, [0.05, 0.04, 0.03])
    # the last bone: a cylinder of the radius at its middle, turned about its end
    r = 0.009 - 0.002 * 87.5 / 100
    mass = 1100 * math.pi * r * r * 0.025
    assert state.M[2, 2] == pytest.approx(mass * (r * r / 4 + 0.025**2 / 3))
    assert crosscheck(model, samples=2, trajectories=False).passed


def test_a_finger_with_pulleys(tmp_path):
    """While a cable touches its pulleys, their radii are its moment arms."""
    text = FINGER.replace("moment_arm_mm = [7, 6, 5]", "pulley_mm = [8, -6, 5]")
    model = written(text, tmp_path)
    (cable, plain) = model.robot.tendons
    assert [wrap.radius for wrap in cable.wraps] == [0.008, 0.006, 0.005]
    assert not plain.wraps
    for q in (model.q0, np.array([-0.3, 0.2, -0.1])):
        np.testing.assert_allclose(-model.tendon_moment_arms(q)[0], [8e-3, -6e-3, 5e-3], rtol=1e-9)


@pytest.mark.parametrize(
    ("text", "old", "wrong", "message"),
    [
        (FINGER, "moment_arm_mm = [7, 6, 5]", "", "expected moment_arm or pulley, got neither"),
        (FINGER, "moment_arm_mm = [7, 6, 5]", "pulley_mm = [8, 16, 5]", "a radius below 0.015 m"),
        (FINGER, "moment_arm_mm = [7]", "pulley_mm = [7]", "no antagonist of a cable around"),
        (SPIRAL, "ratio = 0.82", "ratio = -0.82", "[log_spiral]: ratio: expected a finite number"),
        (
            SPIRAL,
            "segments = 4",
            "segments = 1",
            "segments: expected a whole number from 2 to 1000",
        ),
        (SPIRAL, "mass_g", "mas_g", "expected mass_g or mass_kg, got 'mas_g'; did you mean"),
        (FINGER, "[1, 2, 3]", "[1, 2, 4]", "hinges from 1 to 3"),
        (FINGER, "[1, 2, 3]", "[1, 2.5, 3]", "hinges from 1 to 3"),
        (FINGER, "0.03]", "]", "expected one number, or 3"),
        (FINGER, "[finger]", "[fingr]", "or [finger], got 'fingr'; did you mean 'finger'?"),
    ],
)
def test_bad_input_is_one_line(text, old, wrong, message, tmp_path, capsys):
    (tmp_path / "robot.toml").write_text(text.replace(old, wrong, 1))
    assert new.main([str(tmp_path / "robot.toml")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
