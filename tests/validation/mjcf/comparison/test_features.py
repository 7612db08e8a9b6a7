"""Features of MuJoCo that change its motion: comparisons and exports name all of them."""

import json

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn.validation import compare
from softdyn.validation.crosschecks import engines
from softdyn.validation.mjcf import compiled_fields, export
from softdyn.validation.mjcf.comparison.finding import force
from tests.support.command import command
from tests.support.mjcf_features import PAIRS, Pair, edited, texts
from tests.support.robots import cable, hinge

STEPS, HOLD = 30, 7  # in each of the motions, and under one input
# Every field of the installed MuJoCo except these is read, or has a reason in the table. A new
# field must be added here, to the fields that are read, or to the table.
TOLD = """
    actuator_actearly actuator_actrange actuator_biasprm actuator_biastype actuator_cranklength
    actuator_ctrlspec actuator_delay actuator_dynprm actuator_dyntype actuator_forcerange
    actuator_gainprm actuator_gaintype actuator_history actuator_lengthrange body_mocapid
    dof_solimp dof_solref eq_solimp eq_solref geom_fluid geom_pos geom_quat geom_size geom_type
    jnt_actfrcrange jnt_actgravcomp jnt_margin jnt_solimp jnt_solref jnt_springyield
    tendon_actfrcrange tendon_frictionloss tendon_margin tendon_range tendon_solimp_fri
    tendon_solimp_lim tendon_solref_fri tendon_solref_lim tendon_springyield tree_sleep_policy
    opt.density opt.noslip_iterations opt.sleep_tolerance opt.viscosity opt.wind
    mjDSBL_CONSTRAINT mjDSBL_EQUALITY mjDSBL_FRICTIONLOSS mjDSBL_LIMIT mjDSBL_SPRING mjDSBL_DAMPER
    mjDSBL_CLAMPCTRL mjDSBL_ACTUATION mjDSBL_REFSAFE mjENBL_SLEEP mjENBL_DIAGEXACT
"""


def accelerations(text):
    """MuJoCo's own q̈ along some motions."""
    model = mujoco.MjModel.from_xml_string(text)
    data, rng, found = mujoco.MjData(model), np.random.default_rng(0), []
    for _ in range(6):
        mujoco.mj_resetData(model, data)
        mujoco.mj_integratePos(model, data.qpos, rng.uniform(-1.2, 1.2, model.nv), 1.0)
        data.qvel[:] = rng.uniform(-1, 1, model.nv)
        inputs = rng.uniform(-5, 5, (STEPS, 8))
        for k in range(STEPS):
            data.ctrl[:] = inputs[k // HOLD, : model.nu]
            mujoco.mj_step(model, data)
            found.append(data.qacc.copy())
    return np.array(found)


@pytest.fixture
def files(tmp_path):
    return tmp_path / "a.xml", tmp_path / "b.xml"


def write(files, pair: Pair):
    for file, text in zip(files, texts(pair), strict=True):
        file.write_text(text)


@pytest.mark.parametrize("name", PAIRS)
def test_a_feature_that_changes_the_motion_is_told(files, name):
    pair = PAIRS[name]
    write(files, pair)
    before, after = (accelerations(file.read_text()) for file in files)
    assert np.abs(before - after).max() > 1e-6 * np.abs(before).max()
    for a, b in (files, files[::-1]):
        result = compare(a, b, strict=True, samples=2)
        assert not result.passed
        assert result.explained
        said = [f"{c.kind} {c.where} {c.detail} {c.a} {c.b}" for c in result.causes]
        assert any(pair.said in words for words in said), said
        # one change gives one cause; but a servo's range is a joint's largest force as well, and
        # a shape has several numbers
        kinds = [cause.kind for cause in result.causes]
        assert len(kinds) == 1 or set(kinds) in ({"fluid"}, {"actuator", "effort"}), said
    assert compare(files[1], files[1], strict=True, samples=1).passed


def test_the_command_tells_what_a_spring_is(files):
    write(files, PAIRS["joint stiffness polynomial"])
    code, out, _ = command("compare", *files)
    assert code == 1
    assert "stiffness  turn   1 0 0  1 2 3" in out
    assert "the files differ: stiffness" in out


POLYNOMIAL = """<mujoco><compiler angle="radian"/><worldbody><body name="a">
<inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/><joint name="j" axis="0 1 0"
type="{kind}" range="-0.5 0.8" stiffness="{stiffness}" damping="{damping}"/></body></worldbody>
<tendon><fixed name="t" springlength="0" stiffness="{tendon}" damping="{brake}">
<joint joint="j" coef="2"/></fixed></tendon></mujoco>"""
CUBIC = """<mujoco><compiler angle="radian"/><worldbody><body name="a">
<inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
<joint name="j" axis="0 1 0" range="-1 1" stiffness="0 0 5"/></body></worldbody></mujoco>"""
URDF_TYPES = {"hinge": "revolute", "slide": "prismatic"}


def sprung(files, kind="hinge", **values):
    stated = {"stiffness": "0.6", "damping": "0.02", "tendon": "3", "brake": "0.2"}
    plain = {"stiffness": values.pop("plain_stiffness", "0.6"), "damping": "0.02"}
    urdf = files[0].with_suffix(".urdf")
    urdf.write_text(hinge(
        0.2, "0 0 -0.1", 1e-4, name="j", child="a", kind=URDF_TYPES[kind], limit=(-0.5, 0.8),
        **plain, block=cable("t", "j 2", stiffness=3, damping=0.2, rest=0),
    ))  # fmt: skip
    files[1].write_text(POLYNOMIAL.format(kind=kind, **stated | values))
    return urdf, files[1]


@pytest.mark.parametrize(
    ("kind", "values", "cause", "words"),
    [
        ("hinge", {"stiffness": "0.6 0 4"}, "stiffness", "0.48 against 2.528 N m at 0.8 rad"),
        ("slide", {"stiffness": "0.6 0 4"}, "stiffness", "0.48 against 2.528 N at 0.8 m"),
        ("hinge", {"damping": "0.02 0.01"}, "damping", "0.02 against 0.03 N m at 1 rad/s"),
        ("hinge", {"stiffness": "0 0 4"}, "stiffness", "0.48 against 2.048 N m at 0.8 rad"),
        ("slide", {"tendon": "3 1"}, "tendon", "stiffness: "),
        ("slide", {"brake": "0.2 0 1"}, "tendon", "damping: 0.2 against 1.2 N at 1 m/s"),
    ],
)
def test_a_polynomial_spring_differs_from_a_linear_one(files, kind, values, cause, words):
    """Both files state a force, with one linear part, but the forces differ."""
    pair = sprung(files, kind, **values)
    for a, b in (pair, pair[::-1]):
        result = compare(a, b)
        (found,) = [c for c in result.causes if c.kind != "effort"]
        assert (found.kind, found.one_sided, result.passed) == (cause, False, False)
        if a is pair[0]:
            assert words in found.detail
    assert command("compare", *pair).code == 1


def test_a_polynomial_that_only_the_mjcf_states_changes_the_motion(files):
    pair = sprung(files, stiffness="0 0 4", plain_stiffness="0")
    result = compare(*pair)
    (cause,) = [c for c in result.causes if c.kind == "stiffness"]
    assert (cause.alone, cause.one_sided, result.passed) == (True, False, False)
    assert "0 against 2.048 N m at 0.8 rad" in cause.detail


def test_a_cubic_spring_is_written_into_a_urdf(files):
    """MuJoCo's own torque at 0.6 rad is 5 · 0.6³ N m stronger than without the spring."""
    source, target = files[0], files[0].with_suffix(".urdf")
    source.write_text(CUBIC)
    model = mujoco.MjModel.from_xml_path(str(source))
    data = mujoco.MjData(model)
    data.qpos[0] = 0.6
    mujoco.mj_forward(model, data)
    assert data.qfrc_passive[0] == pytest.approx(-5 * 0.6**3)
    assert command("export", source, "--urdf", target).code == 0
    K = softdyn.load(target).state([0.6], [0.0]).K
    assert pytest.approx([5 * 0.6**3]) == K


def test_a_negative_damper_is_lost_in_a_urdf_and_the_export_fails(files):
    source, target = files[0], files[0].with_suffix(".urdf")
    source.write_text(CUBIC.replace('stiffness="0 0 5"', 'damping="0.1 0 -0.001"'))
    code, out, err = command("export", source, "--urdf", target)
    assert code == 1
    assert "below zero" in err
    assert "the files differ: damping" in out


def test_two_polynomials_that_meet_at_the_limit_differ(files):
    """4 x³ and 2.56 x are equal at 0.8 rad, and nowhere between."""
    pair = sprung(files, stiffness="0 0 4", plain_stiffness="2.56")
    (cause,) = [c for c in compare(*pair).causes if c.kind == "stiffness"]
    assert cause.effect["value"] > 0.1


def test_the_forces_of_a_comparison_are_mujoco_s(files):
    _, mjcf = sprung(files, stiffness="0.6 2 4", damping="0.02 0.01 0.3")
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    model.tendon_stiffness[:] = model.tendon_damping[:] = 0.0
    data = mujoco.MjData(model)
    for x, v in ((0.7, 2.0), (-0.4, -1.5)):
        data.qpos[0], data.qvel[0] = x, v
        mujoco.mj_forward(model, data)
        assert force("stiffness", (0.6, 2.0, 4.0), x) == pytest.approx(-data.qfrc_spring[0])
        assert force("damping", (0.02, 0.01, 0.3), v) == pytest.approx(-data.qfrc_damper[0])


def test_every_field_is_read_or_told_or_has_a_reason():
    told = {name for name in compiled_fields.fields() if not compiled_fields.why_not_unread(name)}
    assert told == set(TOLD.split())


def test_the_tables_name_what_there_is():
    known = set(compiled_fields.fields())
    assert not set(compiled_fields.READ) - known
    for field, switches in compiled_fields.SWITCHES.items():
        assert {field, *switches} <= known
    for names in compiled_fields.WITHOUT_EFFECT.values():
        for pattern in names:
            found = [name for name in known if compiled_fields.fnmatchcase(name, pattern)]
            assert found, pattern
            assert not set(found) & set(compiled_fields.READ), pattern


def test_a_file_that_says_nothing_tells_nothing():
    assert compiled_fields.unread_fields(compiled_fields.default_model()) == {}


FULL = """<mujoco>{}<worldbody><site name="w" pos="0.1 0.2 0.3"/>
  <body name="a" gravcomp="0.7" pos="0 0 1"><joint name="h" axis="0 1 0"/>
    <joint name="s" type="slide" axis="0 0.6 0.8"/><geom size="0.1" pos="0.2 0 0"/>
    <site name="sa" pos="0.3 0.1 0"/>
    <body pos="0.4 0 0" gravcomp="-0.5"><joint type="ball"/>
      <geom type="box" size="0.1 0.2 0.05" pos="0.1 0.05 0"/><site name="sb" pos="0.2 0.1 -0.2"/>
      <body gravcomp="2" pos="0.1 0.1 0.3"><geom size="0.1"/></body></body></body>
  <body pos="1 1 1" gravcomp="0.3"><freejoint/><geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0"/>
    <site name="sf" pos="0.3 0.2 0.1"/></body></worldbody>
  <tendon><fixed name="t" armature="0.5"><joint joint="h" coef="2"/><joint joint="s" coef="-1"/>
    </fixed><spatial name="u" armature="0.8"><site site="w"/><site site="sa"/><site site="sb"/>
    <pulley divisor="3"/><site site="sb"/><site site="sf"/></spatial></tendon>
  <actuator><motor joint="h" gear="3" armature="0.1"/><motor joint="h" gear="2" armature="0.2"/>
    <motor tendon="u" gear="2" armature="0.2"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    "options",
    [
        "",
        '<option gravity="1 2 3"/>',
        '<option><flag gravity="disable"/></option>',
        '<option><flag spring="disable" damper="disable"/></option>',  # and with them gravcomp
    ],
)
def test_armature_and_gravcomp_are_in_our_terms_as_in_mujoco_s(tmp_path, options):
    file = tmp_path / "full.xml"
    file.write_text(FULL.format(options))
    assert max(engines.engine_errors(file).values()) < 1e-14


def test_an_engine_that_disagrees_fails_the_command(files, monkeypatch):
    for file in files:
        file.write_text(FULL.format(""))
    words = ("compare", *files, "--engines", "--samples", "1")
    assert command(*words).code == 0
    monkeypatch.setattr(engines, "engine_errors", lambda *_, **__: {"M": 0.89, "g": 1e-16})
    code, out, _ = command(*words)
    assert code == 1
    assert "FAILED: A's engine disagrees in M" in out
    code, out, _ = command(*words, "--json", "-")
    assert json.loads(out)["passed"] is False


def test_notes_that_differ_fail_when_strict(files):
    inner = files[0].parent / "inner.xml"
    inner.write_text('<mujoco><worldbody><body name="z"><joint name="j"/><geom size="0.1"/></body>'
                     "</worldbody></mujoco>")  # fmt: skip
    files[0].write_text(
        '<mujoco><asset><model name="inner" file="inner.xml"/></asset><worldbody><frame>'
        '<attach model="inner" body="z" prefix=""/></frame></worldbody></mujoco>'
    )
    files[1].write_text(inner.read_text())
    assert compare(*files).passed
    assert not compare(*files, strict=True).passed
    assert compare(files[0], files[0], strict=True).passed


@pytest.mark.parametrize("name", PAIRS)
def test_an_export_tells_what_it_leaves_out(files, name):
    write(files, PAIRS[name])
    target = files[0].parent / "out.urdf"
    found = []
    for file in files:
        _, lost = export.write_urdf(file, target)
        found.append((set(lost), target.read_text()))
    (lost, text), (other, changed) = found
    if lost == other and text == changed:
        # an object that is left out as a whole has no further lines
        words = {"ball range": "wrist", "tendon springlength": "cable", "tendon pulley": "cable",
                 "actuator gain": "'more'", "site motor's site": "'jet'"}  # fmt: skip
        sorts = {"servo": "'servo'", "site": "'jet'", "ball": "'spin'"}
        word = words.get(name) or sorts.get(name.split()[0]) or f"equality {name.split(chr(39))[0]}"
        assert any(word in line for line in lost), (word, lost)


def test_edits_go_to_one_element():
    with pytest.raises(AssertionError):
        edited("<mujoco/>", {"joint": {"range": "0 1"}})
