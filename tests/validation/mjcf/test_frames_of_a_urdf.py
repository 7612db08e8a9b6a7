"""Frames survive `export --urdf`: bodies off their joints, sites, sites of cables.

The oracle is MuJoCo's own kinematics of the source at random configurations.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn.validation import compare, crosscheck
from softdyn.validation.mjcf import export
from softdyn.validation.mjcf.scene import Scene

# Several joints in one body, each in a place of its own, with ref and springref; a cable on sites.
MULTI = """<mujoco model="multi">
  <compiler angle="degree" eulerseq="zyx"/>
  <worldbody>
    <site name="post" pos="0.3 0 1"/>
    <body name="pelvis" pos="0 0 1" euler="10 20 30">
      <joint name="tx" type="slide" axis="1 0 0" range="-1 1"/>
      <joint name="rz" axis="0 0 1" pos="0.02 0.01 0" ref="15" range="-60 90" stiffness="3"
        springref="20" damping="0.1"/>
      <joint name="pelvis" axis="0 1 0.2" pos="-0.03 0 0.04" range="-60 60" armature="0.002"/>
      <inertial pos="0.01 0.02 0.03" mass="1.5"
        fullinertia="0.01 0.012 0.015 0.001 -0.0005 0.0003"/>
      <site name="hip" pos="0.1 0 0"/>
      <body name="thigh" pos="0.1 0 -0.1" xyaxes="0 1 0 -1 0 0">
        <joint name="k1" axis="0 0 1" pos="0.01 0 0"/>
        <inertial pos="0 0 -0.05" mass="0.4" diaginertia="0.002 0.002 0.0005"/>
        <body name="pad" pos="0 0.02 -0.1" euler="0 0 40"><site name="eye" euler="5 6 7"/></body>
        <site name="foot" pos="0 0 -0.2" euler="0 45 0"/>
      </body>
    </body>
  </worldbody>
  <tendon><spatial name="strap" stiffness="20"><site site="hip"/><site site="foot"/></spatial>
  </tendon>
</mujoco>"""


def test_every_body_and_site_is_a_link_in_its_place(tmp_path: Path) -> None:
    source, target = tmp_path / "multi.xml", tmp_path / "multi.urdf"
    source.write_text(MULTI)
    compared, _ = export.write_urdf(source, target)
    assert compared.passed, compared.verdict
    model = softdyn.load(target)
    engine = mujoco.MjModel.from_xml_path(str(source))
    data = mujoco.MjData(engine)
    address = [engine.joint(name).qposadr[0] for name in model.joint_names]
    random = np.random.default_rng(0)
    for _ in range(3):
        q = random.uniform(-0.5, 0.5, model.nv)
        configuration = model.configuration(q)
        data.qpos[address] = q
        mujoco.mj_kinematics(engine, data)
        placed = model.link_poses(configuration)
        frames = [(engine.body(k).name, data.xpos[k], data.xmat[k]) for k in range(1, engine.nbody)]
        frames += [(engine.site(k).name, data.site_xpos[k], data.site_xmat[k])
                   for k in range(engine.nsite)]  # fmt: skip
        assert {name for name, *_ in frames} == {
            "pelvis", "thigh", "pad", "post", "hip", "foot", "eye",
        }  # fmt: skip
        for name, position, rotation in frames:
            np.testing.assert_allclose(placed[name][:3, 3], position, atol=1e-12)
            np.testing.assert_allclose(placed[name][:3, :3], rotation.reshape(3, 3), atol=1e-12)


@pytest.mark.parametrize("where", ["pos", "none"])
def test_only_a_body_off_its_joint_becomes_a_link_of_its_own(where: str, tmp_path: Path) -> None:
    source, target = tmp_path / "one.xml", tmp_path / "one.urdf"
    offset = 'pos="0 0 0.1"' if where == "pos" else ""
    source.write_text(
        f'<mujoco><worldbody><body name="arm"><joint name="turn" axis="0 1 0" {offset}/>'
        '<inertial pos="0 0 -0.1" mass="1" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody>'
        "</mujoco>"
    )
    compared, _ = export.write_urdf(source, target)
    assert compared.passed
    links = {link.name for link in softdyn.parse(target).links}
    assert links == ({"world", "turn_link", "arm"} if where == "pos" else {"world", "arm"})


def test_a_moved_body_frame_is_still_a_difference(tmp_path: Path) -> None:
    from softdyn.validation import compare

    source, target = tmp_path / "multi.xml", tmp_path / "multi.urdf"
    source.write_text(MULTI)
    export.write_urdf(source, target)
    text = target.read_text()
    weld = next(line for line in text.splitlines() if 'name="thigh_weld"' in line)
    x = weld.split('xyz="')[1].split()[0]
    target.write_text(text.replace(weld, weld.replace(x, str(float(x) + 0.01))))
    found = compare(source, target, samples=2)
    assert not found.passed
    assert {cause.kind for cause in found.causes if not cause.one_sided} == {"frame"}


def test_sites_that_export_makes_for_cables_do_not_come_back_as_links(tmp_path: Path) -> None:
    export.write_mjcf("helix", tmp_path / "helix.xml", shapes=False)
    compared, _ = export.write_urdf(tmp_path / "helix.xml", tmp_path / "helix.urdf", shapes=False)
    assert compared.passed
    links = [link.name for link in softdyn.parse(tmp_path / "helix.urdf").links]
    assert not [name for name in links if ":" in name]


def test_a_muscle_is_named_among_the_losses(tmp_path: Path) -> None:
    source = tmp_path / "muscle.xml"
    source.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j" axis="0 1 0" range="-57 57"/>'
        '<geom size="0.02" pos="0.1 0 0"/></body></worldbody>'
        '<actuator><muscle name="m" joint="j" lengthrange="-1 1"/></actuator></mujoco>'
    )
    compared, lost = export.write_urdf(source, tmp_path / "muscle.urdf")
    assert not compared.passed
    (line,) = [line for line in lost if "'m'" in line]
    assert "muscle" in line
    assert "activation" in line


def test_a_turned_site_makes_the_files_differ(tmp_path):
    """A task of the kind orientation would have another target."""
    text = (
        '<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><inertial pos="0 0 -0.1" mass="1"'
        ' diaginertia="1e-3 1e-3 1e-3"/><site name="tip" pos="0 0 -0.2" euler="0 0 {}"/></body>'
        "</worldbody></mujoco>"
    )
    paths = [tmp_path / f"{angle}.xml" for angle in (0, 30)]
    for path, angle in zip(paths, (0, 30), strict=True):
        path.write_text(text.format(angle))
    found = compare(*paths)
    assert not found.passed
    assert [(cause.kind, cause.where) for cause in found.causes] == [("frame", "tip")]
    result, _ = export.write_urdf(paths[1], tmp_path / "out.urdf")
    assert result.passed


def test_a_site_with_the_name_of_a_body_leaves_the_body_its_name(tmp_path):
    source = tmp_path / "robot.xml"
    source.write_text(
        '<mujoco><option><flag gravity="disable"/></option><worldbody>'
        '<body name="shin" pos="0 0 1">'
        '<joint name="j" axis="0 1 0" pos="0 0 0.1"/><inertial pos="0 0 -0.1" mass="1"'
        ' diaginertia="1e-3 1e-3 1e-3"/><site name="shin" pos="0 0 -0.2"/></body>'
        "</worldbody></mujoco>"
    )
    result, _ = export.write_urdf(source, tmp_path / "out.urdf")
    assert result.passed, str(result)
    model = softdyn.load(tmp_path / "out.urdf")
    assert model.link_poses(model.q0)["shin"][2, 3] == pytest.approx(1.0)
    # gravity that the file switches off is off in the engines, too
    found = crosscheck(model, Scene(model, source), samples=2, trajectories=False)
    assert found.passed, str(found)


def test_a_free_body_beside_a_floating_robot_is_left_out_by_name(tmp_path):
    source = tmp_path / "robot.xml"
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>'
    source.write_text(
        f'<mujoco><worldbody><body name="ball"><freejoint name="rolls"/>{inertial}</body>'
        f'<body name="torso"><freejoint name="root"/>{inertial}<body name="leg" pos="0 0 -1">'
        f'<joint name="hip" axis="0 1 0"/>{inertial}</body></body></worldbody></mujoco>'
    )
    result, lost = export.write_urdf(source, tmp_path / "out.urdf")
    assert result.passed, str(result)
    assert any("'rolls'" in line for line in lost)
    model = softdyn.load(tmp_path / "out.urdf", floating=True)
    assert sum(link.mass for link in model.robot.links) == 2.0
