"""Two files of one robot: only planted defects are named, without false alarms."""

import json
import re
from collections import Counter

import mujoco
import numpy as np
import pytest
from lxml import etree

import softdyn
from softdyn.description.library import find
from softdyn.validation import compare
from tests.support import defects, pair_robots, robots
from tests.support.command import command
from tests.support.refused import refused
from tests.support.robots import slide

KEYS = {"a", "b", "matched", "causes", "residual", "passed"}


def planted(folder, text, table, *plants):
    """A file of the robot with defects (kind, joint)."""
    root = etree.fromstring(text.encode())
    for kind, k in plants:
        table[kind](root, k)
    suffix = "urdf" if root.tag == "robot" else "xml"
    path = folder / f"planted.{suffix}"
    path.write_bytes(etree.tostring(root))
    return path


@pytest.fixture
def pair(tmp_path):
    """The robot's two files."""
    paths = tmp_path / "pair.urdf", tmp_path / "pair.xml"
    for path, text in zip(paths, (pair_robots.URDF, pair_robots.MJCF), strict=True):
        path.write_text(text)
    return paths


def kinds(result):
    return Counter(cause.kind for cause in result.causes)


def test_clean_pairs(pair):
    for a in pair:
        for b in pair:
            result = compare(a, b, strict=True)
            assert result.passed, str(result)
            assert not result.causes
            assert max(result.residual.values()) < 1e-12
            assert len(result.matched) == 3


MOVES = ("mass", "centre", "inertia", "axis", "zero", "pose", "armature", "friction")


@pytest.mark.parametrize("kind", [*MOVES, "tendon", "actuator"])
@pytest.mark.parametrize("side", ["urdf", "mjcf"])
def test_a_planted_defect_is_named_and_nothing_else(tmp_path, pair, side, kind):
    urdf = side == "urdf"
    table = defects.URDF if urdf else defects.MJCF
    text = pair_robots.URDF if urdf else pair_robots.MJCF
    for k in range(3):
        wrong = planted(tmp_path, text, table, (kind, k))
        for good in pair:
            for files in ((good, wrong), (wrong, good)):
                result = compare(*files)
                assert kinds(result) == {kind: 1}, (k, str(result))
                assert result.explained
                assert result.passed == result.causes[0].one_sided


@pytest.mark.parametrize(
    "plants",
    [
        [("mass", 0), ("zero", 1), ("axis", 2)],
        [("centre", 1), ("pose", 1), ("inertia", 2)],
        [("zero", 0), ("centre", 2), ("friction", 1)],
        [("axis", 0), ("axis", 1), ("armature", 2)],
        [("pose", 0), ("mass", 0), ("inertia", 0)],
    ],
)
def test_three_at_once(tmp_path, pair, plants):
    for table, text in ((defects.URDF, pair_robots.URDF), (defects.MJCF, pair_robots.MJCF)):
        wrong = planted(tmp_path, text, table, *plants)
        for good in pair:
            result = compare(good, wrong)
            assert kinds(result) == Counter(kind for kind, _ in plants), str(result)
            assert result.explained


def test_base_and_order(tmp_path, pair):
    turned = planted(tmp_path, pair_robots.MJCF, defects.MJCF, ("base", 0))
    result = compare(pair[1], turned)
    # one joint carries all links, so that a turned base equals a turned first joint
    assert set(kinds(result)) <= {"base", "pose"}
    assert result.explained
    swapped = planted(tmp_path, pair_robots.MJCF, defects.MJCF, ("order", 0))
    for a in pair:
        result = compare(a, swapped)
        assert kinds(result) == {"order": 1} or a.suffix == ".urdf"
        assert result.explained


def test_the_values_and_effects_are_said(tmp_path, pair):
    wrong = planted(tmp_path, pair_robots.MJCF, defects.MJCF, ("mass", 2), ("zero", 0))
    result = compare(pair[0], wrong)
    found = {cause.kind: cause for cause in result.causes}
    assert found["mass"].where == "jaw"
    assert (found["mass"].a, found["mass"].b) == (0.3, pytest.approx(0.309))
    assert found["zero"].where == "lift"
    assert found["zero"].b == pytest.approx(-0.1)
    assert found["zero"].effect["tip"] > 1e-3
    assert found["mass"].effect["M"] > 1e-3
    assert [step.repaired for step in result.waterfall] == ["as is", "zero", "mass"]
    for name in ("M", "bias", "g"):
        assert result.waterfall[0].left[name] > result.waterfall[-1].left[name]


def test_a_small_share_of_the_inertia_that_changes_the_acceleration_is_named(tmp_path):
    """A heavy body turns about a light one's axis; the light one shows in q̈, but hardly in M."""
    text = (
        '<mujoco><worldbody><body><joint name="a"/><inertial pos="0 0 0" mass="1" '
        'diaginertia="{0} {0} {0}"/><body><joint name="b"/><inertial pos="0 0 0" mass="1" '
        'diaginertia="1 1 1"/></body></body></worldbody></mujoco>'
    )
    paths = tmp_path / "one.xml", tmp_path / "other.xml"
    for path, inertia in zip(paths, ("1e-3", "1.0005e-3"), strict=True):
        path.write_text(text.format(inertia))
    (cause,) = compare(*paths).causes
    assert cause.kind == "inertia"
    assert max(cause.effect[name] for name in ("M", "bias", "g", "tip")) < 1e-6
    assert cause.effect["qdd"] == pytest.approx(5e-4, rel=1e-2)


def test_a_link_fixed_to_another_is_named(tmp_path, pair):
    heavier = pair_robots.URDF.replace('<mass value="0.2"/>', '<mass value="0.206"/>')
    wrong = robots.write(tmp_path, heavier)
    for good in pair:  # the MJCF has the weight lumped into the arm
        result = compare(wrong, good)
        assert [(c.kind, c.where) for c in result.causes] == [("mass", "weight")]


def test_one_sided_fails_only_when_strict(tmp_path, pair):
    """A cable without a spring and its motor at zero change no motion; an armature does."""
    bare = tmp_path / "bare.urdf"
    text = pair_robots.URDF
    bare.write_text(text[: text.index("  <softdyn")] + "</robot>")
    result = compare(bare, pair[1])
    assert not result.passed
    assert kinds(result) == {"armature": 2, "tendon": 1, "actuator": 1}
    assert {c.kind for c in result.causes if c.one_sided} == {"tendon", "actuator"}
    assert all(cause.alone for cause in result.causes)
    light = tmp_path / "light.xml"
    light.write_text(re.sub(r' armature="[^"]*"', "", pair_robots.MJCF))
    result = compare(bare, light)
    assert result.passed
    assert kinds(result) == {"tendon": 1, "actuator": 1}
    assert not compare(bare, light, strict=True).passed


def test_joints_are_matched_by_like_names_and_by_kinematics(tmp_path, pair):
    renamed = pair_robots.MJCF
    for name, other in (("lift", "LiftJoint"), ("slide", "joint_slide"), ("swing", "x7")):
        renamed = renamed.replace(f'name="{name}"', f'name="{other}"')
    path = tmp_path / "renamed.xml"
    path.write_text(renamed)
    result = compare(pair[0], path)
    assert result.passed, str(result)
    assert result.matched == {"lift": "LiftJoint", "slide": "joint_slide", "swing": "x7"}
    assert result.how == {"lift": "like name", "slide": "like name", "swing": "kinematics"}
    # a map overrides; one that contradicts the trees, or has unknown names, is refused
    assert compare(pair[0], path, mapping={"swing": "x7"}).how["swing"] == "map"
    for mapping in (
        {"swing": "y"},
        {"y": "x7"},
        {"lift": "joint_slide"},
        {"lift": "x7", "swing": "LiftJoint"},
    ):
        with pytest.raises(softdyn.InputError):
            compare(pair[0], path, mapping=mapping)


def test_a_robot_with_and_without_its_hand(tmp_path, pair):
    root = etree.fromstring(pair_robots.MJCF.encode())
    jaw = next(body for body in root.iter("body") if body.get("name") == "jaw")
    jaw.getparent().remove(jaw)
    path = tmp_path / "handless.xml"
    path.write_bytes(etree.tostring(root))
    result = compare(pair[0], path)
    assert result.passed, str(result)
    assert result.unmatched == {"a": ["slide"], "b": []}
    # and with the hand fixed: it is welded, not left out
    held = etree.fromstring(pair_robots.MJCF.encode())
    joint = next(j for j in held.iter("joint") if j.get("name") == "slide")
    joint.getparent().remove(joint)
    path.write_bytes(etree.tostring(held))
    assert compare(pair[0], path).passed


WRAPPED = """<mujoco><worldbody><site name="from" pos="0.1 0 0.3"/><body name="arm"><joint name="j"
 axis="0 1 0"/><inertial pos="0 0 -0.2" mass="1" diaginertia="1e-2 1e-2 1e-3"/>
<geom name="pulley" type="cylinder" size="0.03 0.1" euler="90 0 0"/>
<site name="side" pos="0.1 0 0"/><site name="to" pos="0.1 0 -0.3"/></body></worldbody>
<tendon><spatial name="t"><site site="from"/><geom geom="pulley" sidesite="side"/>
<site site="to"/></spatial></tendon></mujoco>"""


@pytest.mark.parametrize(
    ("old", "new", "causes"),
    [
        ("0.03 0.1", "0.03 0.2", {}),  # a wrapped cylinder has no ends
        ('euler="90 0 0"', 'euler="-90 0 0"', {}),
        ('euler="90 0 0"', 'euler="90 0.1 0"', {"tendon": 1}),
        ("0.03 0.1", "0.031 0.1", {"tendon": 1}),
        ('type="cylinder"', 'type="sphere"', {"tendon": 1}),
        ('name="side" pos="0.1', 'name="side" pos="-0.1', {"tendon": 1}),
        (' sidesite="side"', "", {"tendon": 1}),
    ],
)
def test_what_a_tendon_wraps(tmp_path, old, new, causes):
    assert old in WRAPPED
    a, b = tmp_path / "a.xml", tmp_path / "b.xml"
    a.write_text(WRAPPED)
    b.write_text(WRAPPED.replace(old, new))
    assert kinds(compare(a, b)) == causes


def test_another_robot_is_refused(tmp_path, pair):
    still = tmp_path / "still.xml"  # it has no moving joint, so no joint lacks a partner
    still.write_text('<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>')
    for other in ("finger", still):
        result = compare(pair[0], other)
        assert not result.matched
        assert not result.passed
        assert "two robots" in str(result)
    assert compare(still, still).passed


def test_a_motor_on_a_joint_is_one_on_a_plain_tendon_over_it_alone(pair):
    """By format.md, a tendon over one joint is a motor on it; an MJCF names the joint directly."""
    ours, theirs = pair[0].read_text(), pair[1].read_text()

    def write(coef, gear, most=3.5, spring=""):
        motor = f'<motor name="m" joint="slide" gear="2" ctrlrange="-{most} {most}"/>'
        pair[1].write_text(theirs.replace("</actuator>", f"{motor}</actuator>"))
        drive = f'<tendon name="drive"{spring}><joint name="slide" coef="{coef}"/></tendon>'
        motor = f'<actuator name="m" tendon="drive" gear="{gear}" lower="-{most}" upper="{most}"/>'
        text = ours.replace("<actuator", f"{drive}<actuator", 1)
        pair[0].write_text(text.replace("</softdyn>", f"{motor}</softdyn>"))

    # the last: a motor weaker than the joint's limit of 7 N
    for numbers, expected in (
        ((1, 2), {}), ((-4, -0.5), {}), ((1, -2), {"actuator": 1}), ((-4, -0.5, 1.5), {})
    ):  # fmt: skip
        write(*numbers)
        for a, b in (pair, pair[::-1]):
            result = compare(a, b, strict=True)
            assert kinds(result) == expected, str(result)
    write(1, 2, spring=' stiffness="3"')  # a spring is more than a motor
    assert kinds(compare(*pair)) == {"tendon": 1}


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_tensor_of_nothing_is_no_warning(pair):
    """A free base alone has no inertia; there must be no warning about a ratio of tensors."""
    free = pair[0].parent / "free.xml"
    free.write_text(
        '<mujoco><worldbody><body name="base"><freejoint/><inertial pos="0 0 0" mass="1" '
        'diaginertia="1 1 1"/><body name="arm" pos="0.1 0.2 0.3"><joint name="lift" '
        'axis="0.6 0 0.8"/><geom size="0.1"/></body></body></worldbody></mujoco>'
    )
    assert not compare(pair[0], free).passed


@pytest.mark.parametrize("name", ["finger", "spirob"])
def test_bundled_robots(tmp_path, name):
    good = find(name)
    text = good.read_text(encoding="utf-8")
    rng = np.random.default_rng(0)
    count = len(defects.joints(etree.fromstring(text.encode())))
    for kind in ("zero", "axis", "armature", "actuator", *(["tendon"] * (name == "spirob"))):
        wrong = planted(tmp_path, text, defects.URDF, (kind, int(rng.integers(count))))
        assert kinds(compare(good, wrong)) == {kind: 1}
    assert compare(good, good, strict=True).passed


def test_an_impossible_inertia_is_repaired_where_asked_for(tmp_path, pair):
    broken = robots.write(tmp_path, pair_robots.URDF.replace('ixx="5e-4"', 'ixx="5e-3"'))
    with refused(
        '<link name="jaw">',
        "principal moments 0.000299979, 0.0004, 0.005…",
        by=softdyn.UrdfError,
    ):
        compare(broken, pair[1])
    result = compare(broken, pair[1], repair_inertia=True)
    assert kinds(result) == {"inertia": 1}
    (note,) = result.notes
    assert note.startswith('A: <link name="jaw">: inertia repaired')
    assert command("compare", broken, pair[1]).code == 2
    code, out, _ = command("compare", broken, pair[1], "--repair-inertia")
    assert code == 1
    assert "inertia repaired" in out


def test_of_a_long_tendon_the_changed_term_is_said(tmp_path):
    """If one term of a long sum differs, only this term is printed, so that the row stays short."""
    joints = "".join(
        f'<body pos="0.1 0 0"><joint name="joint_{k}" axis="0 1 0"/><geom size="0.05"/>'
        for k in range(17)
    )
    terms = "".join(f'<joint joint="joint_{k}" coef="{1 + k / 8}"/>' for k in range(17))
    text = f'<mujoco><worldbody>{joints}{"</body>" * 17}</worldbody><tendon><fixed name="t">{terms}'
    text += "</fixed></tendon></mujoco>"
    files = tmp_path / "a.xml", tmp_path / "b.xml"
    files[0].write_text(text)
    files[1].write_text(text.replace('coef="2.0"', 'coef="2.0001"'))
    (cause,) = compare(*files).causes
    assert (cause.kind, cause.a, cause.b) == ("tendon", "2 joint_8", "2.0001 joint_8")
    out = command("compare", *files).out
    assert max(map(len, out.splitlines()[2:])) < 120, out


def test_the_command(tmp_path, pair):
    wrong = planted(tmp_path, pair_robots.MJCF, defects.MJCF, ("mass", 1))

    def run(*words):
        return command("compare", *words)

    code, out, _ = run(*pair, "--json", "-")
    report = json.loads(out)
    assert (code, report["passed"]) == (0, True)
    assert report.keys() >= KEYS
    code, out, _ = run(pair[0], wrong, "--json", "-")
    report = json.loads(out)
    assert code == 1
    assert [(c["kind"], c["where"]) for c in report["causes"]] == [("mass", "whip")]
    assert report["causes"][0]["effect"]["M"] > 1e-6
    (tmp_path / "map.toml").write_text('swing = "nothing"')
    code, out, err = run(*pair, "--map", tmp_path / "map.toml")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert run(pair[0])[0] == 2
    code, out, _ = run(*pair)
    assert code == 0
    assert "the files agree" in out


def six_digits(text: str) -> str:
    """An MJCF as MuJoCo saves it."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compile()
    return spec.to_xml()


MANY_KINDS = """<mujoco><worldbody><site name="s" pos="0.1 0.2 0.3333333"/>
<body name="a" pos="0 0 1" euler="10 20 33"><joint name="j" axis="1 2 3" range="-33 44"
springref="7" stiffness="0.123456789" damping="0.0123456789" armature="0.00123456789"/>
<geom type="capsule" size="0.0333" fromto="0 0 0 0.3 0.1 0.02"/>
<body name="b" pos="0.123456789 0.2 0.1" quat="1 2 3 4"><joint name="k" type="slide" axis="1 1 0"/>
<geom type="box" size="0.1 0.02 0.07" euler="3 4 5" pos="0.01 0.02 0.03"/>
<site name="t" pos="0.01 0.02 0.033333333"/></body></body></worldbody>
<tendon><spatial name="c" stiffness="3.3333333" springlength="0.123456789"><site site="s"/>
<site site="t"/></spatial></tendon>
<actuator><position name="p" joint="j" kp="12.3456789" kv="0.1234567"/></actuator></mujoco>"""


def test_a_file_that_mujoco_saved_agrees_with_its_source(tmp_path, pair):
    saved = tmp_path / "saved.xml"
    saved.write_text(six_digits(pair_robots.MJCF))
    (tmp_path / "many.xml").write_text(MANY_KINDS)
    many = tmp_path / "many_saved.xml"
    many.write_text(six_digits(MANY_KINDS))
    for a, b in ((pair[0], saved), (saved, pair[1]), (tmp_path / "many.xml", many)):
        result = compare(a, b)
        assert result.passed, str(result)
        assert not result.causes
        assert result.tolerance == 1e-5
        assert 1e-7 < max(cause.printed for cause in result.within) < 5e-6  # half a unit, at most
        assert f"differences within 1e-05: {len(result.within)}, the largest " in result.verdict
    assert not compare(pair[0], saved, tolerance=0.0).passed
    code, out, _ = command("compare", pair[0], saved, "--engines", "--samples", "2")
    assert (code, "the files agree; " in out) == (0, True)


def test_a_difference_larger_than_rounding_shows_all_of_them(tmp_path, pair):
    saved = tmp_path / "saved.xml"
    saved.write_text(six_digits(pair_robots.MJCF.replace('mass="0.4"', 'mass="0.40001"')))
    result = compare(pair[0], saved)
    assert result.tolerance == 0.0
    assert {"mass", "pose"} <= set(kinds(result))
    assert f"note: {len(result.causes) - 1} of the causes within 1e-05" in str(result)
    result = compare(pair[0], saved, tolerance=1e-5)
    assert kinds(result) == {"mass": 1}
    assert {cause.kind for cause in result.within} >= {"pose"}
    assert compare(pair[0], saved, tolerance=1e-4).passed


def test_digits_do_not_excuse_what_two_exact_files_state(tmp_path, pair):
    """The other file has more than six digits, and so has this one; 8e-6 is a difference."""
    other = tmp_path / "other.xml"
    other.write_text(pair_robots.MJCF.replace('mass="0.4"', 'mass="0.4000032"'))
    assert kinds(compare(pair[1], other)) == {"mass": 1}
    assert compare(pair[1], other, tolerance=1e-5).passed
    code, out, _ = command("compare", pair[1], other, "--tolerance", "1e-5", "--json", "-")
    report = json.loads(out)
    assert (code, report["tolerance"], len(report["within"])) == (0, 1e-5, 1)
    assert report["within"][0]["printed"] == pytest.approx(8e-6, rel=1e-3)
    code, _, err = command("compare", *pair, "--tolerance", "-1")
    assert (code, err) == (2, "error: tolerance: expected a finite number >= 0, got -1.0\n")


def rope(*sites: str) -> str:
    """A load on a slide, and a cable over these sites."""
    place = {"axis": "0 0 1", "at": "0.2 0 0", "limit": (-0.1, 0.1)}
    drive = {"pull": (0, 9), "gear": -1, "drive": {"name": "pull"}}
    return slide(0.4, 1e-4, name="lift", child="load", **place, **drive, path=sites)


SITES = "base -0.2 0 0", "base 0 0 0.1", "load 0 0 0"
DRUM = """<mujoco><worldbody><site name="s" pos="-0.2 0 0"/><site name="side" pos="0 0 0.2"/>
<geom name="drum" type="cylinder" size="0.1 0.01" zaxis="0 1 0" contype="0" conaffinity="0"
mass="0"/><body name="load" pos="0.2 0 0"><joint name="lift" type="slide" axis="0 0 1"
range="-0.1 0.1" limited="true"/><inertial pos="0 0 0" mass="0.4" diaginertia="1e-4 1e-4 1e-4"/>
<site name="h"/></body></worldbody><tendon><spatial name="cable"><site site="s"/>
<geom geom="drum" sidesite="side"/><site site="h"/></spatial></tendon>
<actuator><motor name="pull" tendon="cable" gear="-1" ctrlrange="0 9"/></actuator></mujoco>"""


def test_a_site_on_the_straight_way_is_no_difference(tmp_path):
    """Two more sites between two of one link, one of them twice; a third one bends the cable."""
    a, b = tmp_path / "a.urdf", tmp_path / "b.urdf"
    a.write_text(rope(*SITES))
    idle = '<site link="base" xyz="-0.1 0 0.05"/><site link="base" xyz="-0.05 0 0.075"/>'
    b.write_text(rope(SITES[0], idle, *SITES[1:]))
    for files in ((a, b), (b, a)):
        assert compare(*files, strict=True).passed
    b.write_text(rope(SITES[0], idle.replace("0.05", "0.06"), *SITES[1:]))
    (cause,) = compare(a, b).causes
    assert (cause.kind, cause.a, cause.b) == ("tendon", "3 sites", "5 sites")
    assert cause.detail.startswith("another number of sites, length ")
    # a site of another link, on the straight way at zero only
    b.write_text(rope(*SITES[:2], "load -0.1 0 0.05", SITES[2]))
    assert kinds(compare(a, b)) == {"tendon": 1}


def test_a_cable_around_a_shape_is_called_so(tmp_path):
    a, b = tmp_path / "a.urdf", tmp_path / "b.xml"
    a.write_text(rope(*SITES))
    b.write_text(DRUM)
    (cause,) = [cause for cause in compare(a, b).causes if cause.kind == "tendon"]
    assert (cause.a, cause.b) == ("3 sites", "2 sites, cylinder of radius 0.1")
    assert cause.detail == "around a shape in one file only"
    for old, new, words in (
        (' sidesite="side"', "", "on another side of a shape"),
        ('type="cylinder"', 'type="sphere"', "around other shapes"),
        ('pos="0 0 0.2"', 'pos="0 0 -0.2"', "point 4 moved 400 mm"),
    ):
        (tmp_path / "c.xml").write_text(DRUM.replace(old, new))
        (cause,) = compare(b, tmp_path / "c.xml").causes
        assert (cause.kind, cause.detail) == ("tendon", words)
