"""Files of measurements, the file with the new numbers, and the command."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import identification, statics
from softdyn.commands import identify as command
from softdyn.identification.data import Measurements, at_stops, check_data
from softdyn.validation.identification.trials import Excitation, twin_data
from tests.support import ROOT, cart, robots
from tests.support.refused import refused
from tests.support.robots import build, changed, hinge, link, load

HEADER = "t,u.u1,u.u2,q.joint1,q.joint2,q.joint3,q.joint4"


@pytest.fixture(scope="module")
def finger():
    return softdyn.load("finger")


def test_a_tip_in_millimetres_is_said(finger):
    tip = np.array([[0.2, 0.0, np.nan], [0.21, 0.01, -0.1], [0.2, 0, -0.1]])  # a cell may be empty
    names = ("tip.x", "tip.y", "tip.z")
    check_data(finger, Measurements(np.arange(3.0), np.zeros((3, 2)), names, tip))
    given = Measurements(np.arange(3.0), np.zeros((3, 2)), names, 1e3 * tip)
    with refused("tip.x", "200 at t = 0 s: millimetres?"):
        check_data(finger, given)


def test_directions_of_static_rows_are_read_and_others_refused(finger, tmp_path):
    head, file = "u.u1,u.u2,direction.u1,direction.u2,q.joint1\n", tmp_path / "rows.csv"
    file.write_text(head + "1,-1,1,-1,0.1\n0,1,0,1,0.2\n1,1,-1,0,0.1\n")
    read = identification.read_csv(file, finger, static=True)
    np.testing.assert_array_equal(read.direction, [[1, -1], [0, 1], [-1, 0]])
    with refused("rows.csv: header", "'direction.u1'"):
        identification.read_csv(file, finger)
    file.write_text(head + 3 * "1,1,1,2,0.1\n")
    with refused("rows.csv: direction", "another number"):
        identification.read_csv(file, finger, static=True)
    file.write_text("u.u1,u.u2,direction.u1,q.joint1\n" + 3 * "1,1,1,0.1\n")
    with refused("rows.csv", "0 of them"):
        identification.read_csv(file, finger, static=True)


def test_names_of_the_finger(finger):
    inputs = [f"u.{actuator.name}" for actuator in finger.robot.actuators]
    assert HEADER.split(",") == ["t", *inputs, *(f"q.{name}" for name in finger.joint_names)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ("data.csv", "0 of them")),
        ("t,u.u1\n0,0\n", ("data.csv", "0 of them")),
        (HEADER.replace("joint4", "joint5"), ("header", "'q.joint5'; did you mean 'q.joint4'?")),
        (HEADER + ",tip.w", ("header", "'tip.w'; did you mean 'tip.z'?")),
        (HEADER + ",t", ("data.csv", "2 of them")),
        ("t,u.u1,u.u2\n0,0,0\n", ("data.csv", "1 rows of t, u.u1, u.u2")),
        (HEADER + "\n0,0,0,0,0,0\n", ("data.csv:2", 6)),
        (HEADER + "\n0,0,0,0,0,0,nan\n", ("column q.joint4", "'nan'")),
        (HEADER + "\n0,0,0,0,0,0,1e999\n", ("column q.joint4", "'1e999'")),
        (HEADER + "\n" + "0,0,0,0,0,0,0\n" * 3, ("t", "0, then 0")),
        (HEADER + "\n0,0,0,1,0,0,0\n0,0,0,0,0,0,0\n1,0,0,0,0,0,0\n", ("t", "0, then 0")),
        (HEADER + "\n0,0,0,1,0,0,0\n1,0,0,1,0,0,0\n2,0,0,1,0,0,0\n", ("data", "constant ones")),
        (HEADER + "\n0,0,0,0,0,0,0\n5,0,0,0,0,0,.1\n10,0,0,0,0,0,0\n",
         ("column t", "steps of 5: milliseconds?")),
        (HEADER.replace("t,", "t (ms),"), ("header", "'t (ms)'")),
        (HEADER + " (deg)", ("header", "'q.joint4 (deg)'")),
        (HEADER + "\n0,0,0,1,0,0,0\n1,0,0,1,40,0,0\n2,0,0,1,0,0,0\n",
         ("column q.joint2", "40: degrees?")),
    ],
)  # fmt: skip
def test_files_that_cannot_be_used(finger, tmp_path, text, message, capsys):
    path = tmp_path / "data.csv"
    path.write_text(text)
    with refused(*message):
        identification.read_csv(path, finger)
    assert command.main(["finger", str(path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_slow_samples_are_read_where_the_title_says_seconds(finger, tmp_path):
    path = tmp_path / "slow.csv"
    rows = "\n0,0,0,0,0,0,0\n5,0,0,0,0,0,.1\n10,0,0,0,0,0,0\n"
    path.write_text(HEADER.replace("t,", "t (s),") + rows)
    assert identification.read_csv(path, finger).t.tolist() == [0, 5, 10]


def wheel(kind: str) -> softdyn.SoftModel:
    return build(hinge(
        0.4, None, "2e-4 2e-4 3e-4", name="spin", child="rotor", kind=kind, axis="0 0 1",
        limit=(-6, 6), damping=6e-4, pull=(-0.1, 0.1), drive={"name": "motor"},
    ))  # fmt: skip


@pytest.mark.parametrize("written", ["unwrapped", "wrapped", "cos_and_sin", "log", "to_2_pi"])
def test_a_joint_that_turns_many_times_is_read_in_each_form(tmp_path, written):
    """q(t) = u / c (t - τ (1 - exp(-t / τ))), τ = I / c: 5 turns in 3 s."""
    model = wheel("continuous")
    t, u, c = np.arange(0, 3, 0.01), 0.01, 9e-4
    tau = 3e-4 / c
    q = u / c * (t - tau * (1 - np.exp(-t / tau)))
    cells = {
        "unwrapped": [q],
        "wrapped": [np.arctan2(np.sin(q), np.cos(q))],
        "to_2_pi": [q % (2 * np.pi)],
    }.get(written, [np.cos(q), np.sin(q)])
    head = "q.spin" if len(cells) == 1 else "q.spin.cos,q.spin.sin"
    if written == "log":  # with columns of any names beside
        cells, head = [*cells, 0 * q, 0 * q], head + ",V,log"
    rows = np.stack([t, np.full(len(t), u), *cells], 1)
    file = tmp_path / "turns.csv"
    np.savetxt(file, rows, "%.9f", ",", header=f"t,u.motor,{head}", comments="")
    data = identification.read_csv(file, model)
    assert data.names == ("q.spin",)
    np.testing.assert_allclose(data.outputs[:, 0], q, atol=1e-8)


def test_data_in_motion_need_no_equilibrium_under_the_first_input():
    """Nothing holds a wheel against its motor, and a log of it has the tip beside the angle."""
    model = wheel("continuous")
    t, names = np.linspace(0, 1, 11), ("q.spin", "tip.x", "tip.y", "tip.z")
    outputs = np.stack([t**2, 0 * t, 0 * t, 0 * t], 1)
    data = Measurements(t, np.full((11, 1), 0.01), names, outputs)
    found, acquisition = identification.prepared(model, data)
    assert found is data
    assert acquisition.view.positions
    with pytest.raises(statics.NoEquilibrium):
        identification.prepared(model, data, static=True)


@pytest.mark.parametrize(
    ("kind", "head", "cells", "wrong"),
    [
        ("continuous", "q.spin", "3.1 -1.1 1.2", ("column q.spin", "2.3 rad")),
        (
            "revolute",
            "q.spin",
            "3.1 -3.1 -3.0",
            ("column q.spin", "3.1, then -3.1: wrapped by 2 pi?"),
        ),
        (
            "continuous",
            "q.spin.cos,q.spin.sin",
            "1,0 0,0 0,1",
            ("column q.spin.cos", "0 and 0"),
        ),
        (
            "revolute",
            "q.spin.cos,q.spin.sin",
            "1,0 1,0 0,1",
            ("header", "'q.spin.cos'; did you mean 'q.spin'?"),
        ),
        (
            "continuous",
            "q.spin.cos",
            "1 0.9 0.8",
            ("header", "'q.spin.cos'; did you mean 'q.spin'?"),
        ),
    ],
)
def test_angles_that_do_not_say_how_far_a_joint_turned(tmp_path, kind, head, cells, wrong):
    model, file = wheel(kind), tmp_path / "turns.csv"
    rows = (f"{k / 100},0.01,{cell}\n" for k, cell in enumerate(cells.split()))
    file.write_text(f"t,u.motor,{head}\n" + "".join(rows))
    with refused(*wrong):
        identification.read_csv(file, model)


def test_samples_at_a_stop_and_beside_it(finger):
    """A joint leaves and meets its stop between samples, so its neighbouring samples count, too."""
    joints = np.zeros((8, 4))
    joints[3, 1], joints[6, 2], joints[7, 0] = finger.upper[1], finger.lower[2], finger.lower[0]
    expected = np.zeros((8, 4), bool)
    expected[2:5, 1] = expected[5:8, 2] = expected[6:8, 0] = True
    np.testing.assert_array_equal(at_stops(finger, joints), expected)


def test_few_rows(finger):
    """Too few rows for a spline are refused; 4 held-out rows give no test."""
    unknowns = identification.parameters(finger, "stiffness", shared=True)
    names = [f"q.{name}" for name in finger.joint_names]
    data, _ = twin_data(finger, unknowns, names, Excitation(0.1), 0.0, 3)
    assert len(data.t) == 20
    with refused("data", 4):
        identification.identify(finger, data.part(0, 4), unknowns)
    assert np.isnan(identification.identify(finger, data, unknowns).held_out)


def test_new_numbers_in_the_file(finger, tmp_path):
    """The strict parser reads them back; the rest of the file is unchanged."""
    values = {
        "stiffness": {"joint2": 0.0123}, "damping": {"joint1": 0.5}, "rest": {"joint3": 0.1},
        "gear": {"u1": -0.7}, "mass": {"joint4": 2.0},
    }  # fmt: skip
    path = robots.write(tmp_path, identification.rewrite_urdf(finger.robot, values), "new.urdf")
    new = softdyn.load(path)
    index = {name: k for k, name in enumerate(finger.joint_names)}
    for kind, (joint, value) in (("stiffness", ("joint2", 0.0123)), ("damping", ("joint1", 0.5)),
                                 ("rest", ("joint3", 0.1))):  # fmt: skip
        expected = getattr(finger, kind).copy()
        expected[index[joint]] = value
        assert np.allclose(getattr(new, kind), expected)
    assert new.robot.actuators[0].gear == -0.7
    masses = [link.inertia.mass for link in new.robot.links]
    before = [link.inertia.mass for link in finger.robot.links]
    assert sum(masses) > sum(before)
    assert sum(a != b for a, b in zip(masses, before, strict=True)) >= 1
    # a spring without a reference has its rest at zero, until one is written
    bare = tmp_path / "bare.urdf"
    text = finger.robot.path.read_text().replace("<springReference>0</springReference>", "")
    bare.write_text(text)
    path.write_text(identification.rewrite_urdf(softdyn.parse(bare), {"rest": {"joint3": 0.1}}))
    assert np.array_equal(
        softdyn.load(path).rest, np.where(np.arange(4) == index["joint3"], 0.1, 0)
    )
    # so does an armature that the file does not state
    path.write_text(identification.rewrite_urdf(finger.robot, {"armature": {"joint1": 1.0}}))
    assert np.array_equal(softdyn.load(path).armature, [1.0, 0, 0, 0])
    assert identification.rewrite_urdf(finger.robot, {}) == finger.robot.path.read_text()


def test_a_mass_s_factor_is_on_the_links_welded_to_its_body_too(tmp_path):
    text = changed(cart.text(-1, 1), (link("tip"), link("tip", 0.2, None, 1e-4)))
    before = load(tmp_path, text)
    after = load(tmp_path, identification.rewrite_urdf(before.robot, {"mass": {"x": 3.0}}))
    M, tripled = (one.state(np.zeros(1), np.zeros(1)).M[0, 0] for one in (before, after))
    assert pytest.approx(0.7) == M
    assert tripled == pytest.approx(2.1)


def test_what_a_file_of_annotations_gives_is_written_with_the_robot(tmp_path):
    overlay = ROOT / "docs" / "examples" / "soft_ur5.xml"
    arm = softdyn.load("ur5", annotations=overlay)
    joint = arm.joint_names[1]
    found = {"stiffness": {joint: 77.0}, "gear": {arm.robot.actuators[0].name: 2.5}}
    path = robots.write(tmp_path, identification.rewrite_urdf(arm.robot, found), "new.urdf")
    robot = softdyn.parse(path)
    assert next(j.stiffness for j in robot.joints if j.name == joint) == 77.0
    assert robot.actuators[0].gear == 2.5
    joints = (replace(j, stiffness=77.0) if j.name == joint else j for j in arm.robot.joints)
    assert robot == replace(arm.robot, joints=tuple(joints), actuators=robot.actuators)


def test_the_command_writes_robot_and_page(finger, tmp_path, capsys):
    unknowns = identification.parameters(finger, "stiffness", shared=True)
    names = [f"q.{name}" for name in finger.joint_names]
    data, theta = twin_data(finger, unknowns, names, Excitation(0.5, timestep=5e-4), 1.0, 3)
    path = tmp_path / "data.csv"
    table = np.column_stack((data.t, data.u, data.outputs))
    np.savetxt(path, table, delimiter=",", header=HEADER, comments="")
    out, html = tmp_path / "new.urdf", tmp_path / "page.html"
    arguments = [
        "finger",
        str(path),
        "--shared",
        "stiffness",
        "--out",
        str(out),
        "--html",
        str(html),
    ]
    assert command.main([*arguments, "--json", "-"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["parameters"]
    assert abs(found["value"] / theta[0] - 1) < 0.05
    assert softdyn.load(out).stiffness == pytest.approx(finger.stiffness * found["value"])
    assert "Identification of finger" in html.read_text()
    assert command.main(["finger"]) == 2
    assert "a file, or --twin, got neither" in capsys.readouterr().err
    assert (
        command.main(["finger", "--twin", "0.4", "--timestep", "5e-4", "--shared", "stiffness"])
        == 0
    )
    assert "truth in 95 %" in capsys.readouterr().out
