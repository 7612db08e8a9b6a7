"""Hostile MJCF files lead to one line and exit code 2; no file outside their folder is opened."""

import builtins
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn.validation.crosschecks.engines import engine_errors
from softdyn.validation.mjcf.comparison.comparison import compare
from softdyn.validation.mjcf.comparison.dynamics import States, evaluate
from softdyn.validation.mjcf.comparison.side import neutral
from softdyn.validation.mjcf.mjcf_file import read_mjcf
from tests.support import pair_robots
from tests.support.forked import forked
from tests.support.refused import refused

BODY = '<body><joint name="j"/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/>{}</body>'
WORLD = "<mujoco><worldbody>{}</worldbody></mujoco>"
GOOD = WORLD.format(BODY.format(""))
MESH = (
    '<mujoco><compiler {}/><asset><mesh name="m" file="{}"/></asset><worldbody>'
    '<body><joint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
)
ATTACH = (
    '<mujoco><asset><model name="m" file="{}"/></asset><worldbody><body>{}</body></worldbody>'
    "</mujoco>"
)
SECRET = "<mujoco><worldbody/></mujoco>"

HOSTILE = {
    "truncated": GOOD[:-20],
    "another root": "<sdf/>",
    "dtd": '<!DOCTYPE m [<!ENTITY e "x">]>' + GOOD,
    "entity": '<!DOCTYPE m [<!ENTITY e SYSTEM "../secret.xml">]><mujoco>&e;</mujoco>',
    "nan": GOOD.replace('mass="1"', 'mass="nan"'),
    "inf": GOOD.replace('pos="0 0 1"', 'pos="0 -inf 1"'),
    "overflow": GOOD.replace('mass="1"', 'mass="1e999"'),
    "too large": GOOD.replace('mass="1"', 'mass="1e60"'),
    "text": GOOD.replace('mass="1"', 'mass="heavy"'),
    "no mass": GOOD.replace('mass="1"', 'mass="0"'),
    "include itself": '<mujoco><include file="hostile.xml"/></mujoco>',
    "include loop": '<mujoco><include file="loop.xml"/></mujoco>',
    "include nothing": '<mujoco><include file="nothing.xml"/></mujoco>',
    "include above": '<mujoco><include file="../secret.xml"/></mujoco>',
    "include absolute": '<mujoco><include file="{folder}/secret.xml"/></mujoco>',
    "include through a link": '<mujoco><include file="link.xml"/></mujoco>',
    "mesh above": MESH.format("", "../secret.stl"),
    "mesh folder above": MESH.format('meshdir=".."', "secret.stl"),
    "mesh absolute": MESH.format("", "{folder}/secret.stl"),
    "mesh folder absolute": MESH.format('meshdir="{folder}"', "secret.stl"),
    "mesh of nothing": MESH.format("", "nothing.stl"),
    "copies": WORLD.format(f'<replicate count="1000000">{BODY.format("")}</replicate>'),
    "copies of copies": WORLD.format(
        '<replicate count="999"><replicate count="999">' + BODY.format("") + "</replicate>"
        "</replicate>"
    ),
    "deep": WORLD.format("<body>" * 5000 + "</body>" * 5000),
    "plugin": "<mujoco><extension><plugin plugin='x'/></extension></mujoco>",
    "attached model": '<mujoco><asset><model name="m" file="../secret.xml"/></asset></mujoco>',
    "attached through a link": '<mujoco><asset><model file="link.xml"/></asset></mujoco>'.replace(
        "</mujoco>", '<worldbody><attach model="link"/></worldbody></mujoco>'
    ),
    "attached to itself": ATTACH.format("hostile.xml", "<attach model='m'/>"),
    "attached nothing": ATTACH.format("nothing.xml", "<attach model='m'/>"),
    "attached unknown": ATTACH.format("good.xml", "<attach model='n'/>"),
    "attached body of no name": ATTACH.format("good.xml", "<attach model='m' body='x'/>"),
    "attached to the assets": ATTACH.format("good.xml", "").replace(
        "</asset>", "<attach model='m'/></asset>"
    ),
    "attached copies": ATTACH.format("good.xml", "<attach model='m' prefix='a'/>" * 65),
    "attached in copies": ATTACH.format(
        "good.xml", "<replicate count='9'><attach model='m'/></replicate>"
    ),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    """A new folder, with secret files beside it."""
    robot = tmp_path / "robot"
    robot.mkdir()
    (tmp_path / "secret.xml").write_text(SECRET)
    (tmp_path / "secret.stl").write_bytes(b"solid\nendsolid\n")
    (robot / "good.xml").write_text(GOOD)
    (robot / "link.xml").symlink_to(tmp_path / "secret.xml")
    (robot / "loop.xml").write_text('<mujoco><include file="loop.xml"/></mujoco>')
    return robot


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files_are_refused(folder, monkeypatch, case):
    path = folder / "hostile.xml"
    path.write_text(HOSTILE[case].replace("{folder}", str(folder.parent)))
    opened = []
    real = Path.open
    monkeypatch.setattr(
        Path, "open", lambda self, *a, **k: (opened.append(self.resolve()), real(self, *a, **k))[1]
    )
    monkeypatch.setattr(builtins, "open", None)
    with pytest.raises(softdyn.UrdfError) as caught:
        neutral(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 2000
    assert all(file.is_relative_to(folder) for file in opened)


@pytest.mark.parametrize(
    "element",
    [
        '<composite type="cable"',
        '<plugin plugin="mujoco.elasticity.cable"',
        '<flexcomp name="cloth"',
    ],
)
def test_what_cannot_be_compared_is_named(folder, element):
    path = folder / "robot.xml"
    inside = f"<extension>{element}/></extension>" if "plugin" in element else ""
    world = "" if inside else f"<worldbody><body>{element}/></body></worldbody>"
    path.write_text(f"<mujoco>{inside}{world}</mujoco>")
    with pytest.raises(softdyn.UrdfError) as caught:
        neutral(path)
    assert str(caught.value).endswith(f"got {element}>")


def test_a_million_bodies(folder):
    path = folder / "hostile.xml"
    path.write_text(WORLD.format("<body/>" * 1_000_000))
    with refused("<body>", "more", by=softdyn.UrdfError):
        neutral(path)
    path.write_text(WORLD.format(BODY.format("") * 1100).replace(' name="j"', ""))
    with refused("<worldbody>", 1101, by=softdyn.UrdfError):
        neutral(path)


def test_the_command_says_it_in_one_line(folder):
    path = folder / "hostile.xml"
    path.write_text(HOSTILE["include above"])
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = forked("compare", "finger", path, cwd=folder, **pipes)
    out, err = process.communicate()
    assert (process.returncode, out, err.count("\n")) == (2, "", 1)
    assert "hostile.xml" in err
    assert "include" in err
    assert not (folder / "MUJOCO_LOG.TXT").exists()


def test_includes_defaults_and_meshes_below_the_folder(folder):
    (folder / "parts").mkdir()
    (folder / "parts" / "body.xml").write_text(
        "<mujocoinclude><worldbody>" + BODY.format('<geom mesh="m" type="mesh"/>')
        + "</worldbody></mujocoinclude>"
    )  # fmt: skip
    path = folder / "robot.xml"
    # the mesh is only visual, so it may be missing: the inertia is given
    path.write_text(
        '<mujoco><asset><mesh name="m" file="gone.stl"/></asset>'
        '<default><joint axis="0 1 0" damping="3" range="-90 45"/></default>'
        '<include file="parts/body.xml"/></mujoco>'
    )
    part = neutral(path).parts[0]
    assert part.axis.tolist() == [0, 1, 0]
    assert part.damping == 3
    assert part.lower == pytest.approx(-1.5707963267948966)


def test_inertia_from_a_mesh(folder):
    """A tetrahedron's volume and centre."""
    (folder / "tetra.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    path = folder / "robot.xml"
    path.write_text(MESH.format("", "tetra.obj").replace("<mesh ", '<mesh inertia="exact" '))
    body = neutral(path).parts[0].inertia
    assert body.mass == pytest.approx(1000 / 6)
    assert body.com == pytest.approx([0.25, 0.25, 0.25])


def test_what_stands_in_a_world_is_no_robot(folder):
    """A comparison leaves out free boxes and floors of a scene."""
    (folder / "robot.xml").write_text(pair_robots.MJCF)
    scene = folder / "scene.xml"
    scene.write_text(
        '<mujoco><include file="robot.xml"/><worldbody><geom type="plane" size="1 1 1"/>'
        '<body pos="1 0 0"><freejoint name="box"/><geom size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    result = softdyn.validation.compare(folder / "robot.xml", scene)
    assert result.passed, str(result)
    assert result.unmatched == {"a": [], "b": ["box"]}


def test_an_attached_model_is_what_mujoco_makes_of_it(folder):
    (folder / "part").mkdir()
    (folder / "part/m.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    (folder / "part/hand.xml").write_text(
        '<mujoco><default><default class="k"><joint armature="3"/></default></default><asset>'
        '<mesh name="m" file="m.obj"/></asset><worldbody><body name="palm" euler="30 0 0">'
        '<joint name="j" class="k" range="-10 20"/><geom type="mesh" mesh="m" mass="0.3"/>'
        '<body pos="0 0 1"><geom size="0.1"/></body></body><geom size="0.2"/></worldbody></mujoco>'
    )
    path = folder / "robot.xml"
    path.write_text(
        '<mujoco><compiler angle="radian"/><asset><model name="h" file="part/hand.xml"/></asset>'
        '<worldbody><body name="b"><joint name="j" range="-1 1"/><geom size="1"/>'
        '<frame pos="0 0 1"><attach model="h" body="palm" prefix="l_"/></frame>'
        '<body name="c"><joint name="k"/><attach model="h" prefix="r_"/></body></body></worldbody>'
        "</mujoco>"
    )
    flat = folder / "part/flat.xml"
    mujoco.mj_saveLastXML(str(flat), mujoco.MjModel.from_xml_path(str(path)))
    result = compare(flat, path)
    assert result.matched == {name: name for name in ("j", "l_j", "k", "r_j")}
    assert max(result.waterfall[0].left.values()) < 1e-5  # MuJoCo writes XML with six digits
    assert neutral(path).parts[3].upper == pytest.approx(np.radians(20))


@pytest.mark.parametrize("changes", ['settotalmass="5"', 'boundmass="0.2"', 'boundinertia="0.01"'])
@pytest.mark.parametrize("fuse", ["true", "false"])
def test_masses_that_the_compiler_changes_are_mujoco_s(folder, changes, fuse):
    path = folder / "robot.xml"
    path.write_text(
        f'<mujoco><compiler {changes} fusestatic="{fuse}"/><worldbody><body name="table">'
        '<geom size="0.1"/></body><body name="arm"><joint axis="0 1 0"/><inertial pos="0.1 0 0" '
        'mass="1" diaginertia="1e-3 2e-3 2e-3"/><body name="weld" pos="1 0 0"><inertial pos="0 0 0"'
        ' mass="0.5" diaginertia="1e-3 2e-3 2e-3"/><body name="frame"/></body></body></worldbody>'
        "</mujoco>"
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    body = int(model.jnt_bodyid[0])
    part = neutral(path).parts[0]
    assert part.inertia.mass == pytest.approx(model.body_subtreemass[body], rel=1e-12)
    assert max(engine_errors(path, samples=2).values()) < 1e-12
    data, M = mujoco.MjData(model), np.zeros((1, 1))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    ours = evaluate(neutral(path), States((np.zeros((1, 1)),), np.zeros((1, 1)))).M[0]
    assert ours == pytest.approx(M, rel=1e-12)


DRUM = """<body name="drum"><joint name="j" axis="0 1 0"/>
  <inertial pos="0 0 -0.2" mass="1" diaginertia="1e-2 1e-2 1e-3"/>
  <geom name="pulley" type="cylinder" size="0.03 0.1" euler="90 0 0"/>
  <site name="from" pos="0.1 0 0.3"/><site name="to" pos="0.1 0 -0.3"/></body>"""
ROPE = '<tendon><spatial><site site="{0}"/><geom geom="{1}"/><site site="{2}"/></spatial></tendon>'


def test_a_tendon_wraps_a_copied_or_attached_shape(folder):
    path = folder / "robot.xml"
    path.write_text(
        f'<mujoco><worldbody><replicate count="2" offset="1 0 0">{DRUM}</replicate></worldbody>'
        f"{ROPE.format('from0', 'pulley1', 'to1')}</mujoco>"
    )
    (rope,) = neutral(path).cables
    assert [point.around for point in rope.path][1] == "cylinder of radius 0.03"
    (folder / "drum.xml").write_text(f"<mujoco><worldbody>{DRUM}</worldbody></mujoco>")
    path.write_text(
        '<mujoco><asset><model name="d" file="drum.xml"/></asset><worldbody><site name="w"/><frame>'
        '<attach model="d" body="drum" prefix="a_"/></frame></worldbody>'
        f"{ROPE.format('w', 'a_pulley', 'a_to')}</mujoco>"
    )
    (rope,) = neutral(path).cables
    assert [point.around for point in rope.path][1] == "cylinder of radius 0.03"


def test_so_many_models_may_be_attached(folder):
    """64, counted through all levels: a file of 30 lines could hold millions."""
    (folder / "one.xml").write_text(GOOD)
    pairs = "".join(f'<attach model="m" prefix="{k}_"/>' for k in range(2))
    (folder / "two.xml").write_text(ATTACH.format("one.xml", pairs))
    path = folder / "many.xml"
    for count, more in ((20, 4), (20, 5)):  # each of the 20 attaches two
        text = "".join(f'<attach model="two" prefix="{k}__"/>' for k in range(count))
        text += "".join(f'<attach model="one" prefix="{k}___"/>' for k in range(more))
        path.write_text(
            '<mujoco><asset><model name="one" file="one.xml"/><model name="two" file="two.xml"/>'
            f"</asset><worldbody><body>{text}</body></worldbody></mujoco>"
        )
        if more == 4:
            assert read_mjcf(path).attached
        else:
            with refused('<attach model="one">', "more", by=softdyn.UrdfError):
                read_mjcf(path)
