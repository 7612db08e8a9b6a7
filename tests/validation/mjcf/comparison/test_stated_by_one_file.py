"""A comparison fails by a statement of one file alone if that changes the motion, and only then.

The right values are worked out by hand for one or two joints.
"""

import pytest

from softdyn.validation import compare
from softdyn.validation.mjcf import export
from tests.support.command import command
from tests.support.robots import cable, hinge, joint, link, motor, robot

OTHER = """<mujoco><compiler angle="radian"/><option {option}></option><worldbody><body name="rod">
<joint name="hinge" axis="{axis}" range="{range}" {joint}/>
<inertial pos="0.1 0 0" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody></mujoco>"""
UP, ACROSS = "0 0 1", "0 1 0"
# the change, the joint's axis, and kind of the cause
ALONE = {
    # a hinge upright feels nothing of gravity along its axis, and 0.5 · 9.81 · 0.1 N m across it
    "gravity across": ({"option": 'gravity="0 -9.81 0"'}, UP, "gravity"),
    "the moon's gravity": ({"option": 'gravity="0 0 -1.62"'}, ACROSS, "gravity"),
    "gravity that only a load would feel": ({"option": 'gravity="0 0 -1.62"'}, UP, "gravity"),
    # ten times the rod's own 6e-3 kg m²
    "armature": ({"joint": 'armature="0.06"'}, UP, "armature"),
    "dry friction": ({"joint": 'frictionloss="0.1"'}, UP, "friction"),
    "damping": ({"joint": 'damping="0.01"'}, UP, "damping"),
    "a spring": ({"joint": 'stiffness="0.2"'}, UP, "stiffness"),
    "a cubic spring": ({"joint": 'stiffness="0 0 5"'}, UP, "stiffness"),
    "water": ({"option": 'density="1000"'}, UP, "fluid"),
    "no stops": ({"option": '><flag limit="disable"/', "range": "-1 1"}, UP, "feature"),
}
SUMS = robot(
    "two", link("base"), link("a", 0.1, "0.05 0 0", 2e-4), link("b", 0.1, "0.05 0 0", 1e-4),
    joint("j1", "base", "a"), joint("j2", "a", "b", at="0.1 0 0"),
    block=(cable("sum", "j1 1", "j2 1"), motor("sum", -2, 2, name="pull")),
)  # fmt: skip
SUMMED = """<mujoco><compiler angle="radian"/><worldbody>
<body name="a"><joint name="j1" axis="0 1 0" range="-1 1"/>
<inertial pos="0.05 0 0" mass="0.1" diaginertia="2e-4 2e-4 2e-4"/>
<body name="b" pos="0.1 0 0"><joint name="j2" axis="0 1 0" range="-1 1"/>
<inertial pos="0.05 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body></body></worldbody>
<tendon><fixed name="sum" {tendon}><joint joint="j1" coef="1"/><joint joint="j2" coef="1"/></fixed>
</tendon><actuator><motor name="{name}" tendon="sum" gear="{gear}" ctrlrange="{ends}"/></actuator>
</mujoco>"""
MOTOR = {"tendon": "", "name": "pull", "gear": 1, "ends": "-2 2"}


@pytest.fixture
def files(tmp_path):
    return tmp_path / "a.urdf", tmp_path / "b.xml"


def compared(files, texts, **options):
    for file, text in zip(files, texts, strict=True):
        file.write_text(text)
    return compare(*files, **options)


def pendulum(files, axis, *, strict=False, **changes):
    values = {"option": "", "joint": "", "range": "-1 1"} | changes
    texts = hinge(0.5, child="rod", axis=axis), OTHER.format(axis=axis, **values)
    return compared(files, texts, strict=strict)


def test_files_without_such_a_change_agree(files):
    result = pendulum(files, UP)
    assert result.passed
    assert {(c.kind, c.one_sided) for c in result.causes} == {("effort", True)}
    assert not pendulum(files, UP, strict=True).passed


@pytest.mark.parametrize("name", ALONE)
def test_what_one_file_states_fails_if_it_moves_the_robot(files, name):
    changes, axis, kind = ALONE[name]
    result = pendulum(files, axis, **changes)
    assert not result.passed
    assert result.explained
    (cause,) = [cause for cause in result.causes if not cause.one_sided]
    assert cause.kind == kind
    assert cause.alone
    assert result.verdict.startswith(f"the files differ: {kind}")
    code, out, _ = command("compare", *files)
    assert (code, f"the files differ: {kind}" in out) == (1, True)


@pytest.mark.parametrize(
    ("tendon", "field"),
    [
        ('armature="0.004"', "armature"),  # M is 3.7e-3 and 3.5e-4 kg m² at zero
        ('frictionloss="0.1"', "friction"),
        ('stiffness="3" springlength="0"', "stiffness"),
        ('damping="0.1"', "damping"),
        ('limited="true" range="-0.5 0.5"', "tendon_range"),  # the joints' sum reaches 2 rad
    ],
)
def test_what_only_one_file_s_tendon_has_fails(files, tendon, field):
    result = compared(files, (SUMS, SUMMED.format(**MOTOR | {"tendon": tendon})))
    assert not result.passed
    causes = [cause for cause in result.causes if not cause.one_sided]
    assert all(cause.where == "sum" for cause in causes)
    assert any(field in f"{cause.kind} {cause.detail}" for cause in causes), causes


def test_a_range_that_no_state_reaches_does_not_act(files):
    far = SUMMED.format(**MOTOR | {"tendon": 'limited="true" range="-2.1 2.1"'})
    result = compared(files, (SUMS, far))
    assert result.passed
    assert "tendon_range" in {cause.detail for cause in result.causes if cause.one_sided}
    assert not compare(*files, strict=True).passed


@pytest.mark.parametrize(("gear", "ends"), [(2, "-1 1"), (-1, "-2 2"), (2, "-2 2")])
def test_actuators_of_other_names_on_one_tendon_are_compared(files, gear, ends):
    """A unit input pulls twice as hard, or the other way."""
    result = compared(
        files, (SUMS, SUMMED.format(**MOTOR | {"name": "m1", "gear": gear, "ends": ends}))
    )
    assert not result.passed
    (cause,) = [cause for cause in result.causes if not cause.one_sided]
    assert (cause.kind, cause.where) == ("actuator", "pull")
    assert "gear" in cause.detail
    same = compared(files, (SUMS, SUMMED.format(**MOTOR | {"name": "m1"})))
    assert same.passed
    assert not [cause for cause in same.causes if cause.kind == "actuator"]


def test_a_tendon_of_another_name_is_known_by_its_sum(files):
    texts = SUMS, SUMMED.format(**MOTOR).replace('"sum"', '"flexor"')
    assert compared(files, texts).passed
    assert not [c for c in compare(*files).causes if c.kind in ("tendon", "actuator")]
    reverse = SUMMED.format(**MOTOR | {"gear": -1, "name": "m"}).replace('"sum"', '"flexor"')
    (cause,) = [c for c in compared(files, (SUMS, reverse)).causes if not c.one_sided]
    assert (cause.kind, cause.where, cause.detail) == ("actuator", "pull", "gear")


def test_a_motor_s_name_does_not_pair_it_with_another_target(files):
    """Two motors have each other's names: the inputs are in another order, the forces are equal."""
    two = '<actuator name="pull" tendon="sum" lower="-2" upper="2"/>'
    urdf = SUMS.replace(
        two,
        '<tendon name="one"><joint name="j1" coef="1"/></tendon>'
        f'{two}<actuator name="turn" tendon="one" lower="-2" upper="2"/>',
    )
    mjcf = SUMMED.format(**MOTOR | {"name": "turn"})
    one = '<fixed name="one"><joint joint="j1" coef="1"/></fixed></tendon>'
    motor = "</actuator>"
    mjcf = mjcf.replace("</tendon>", one).replace(
        motor, f'<motor name="pull" tendon="one" gear="1" ctrlrange="-2 2"/>{motor}'
    )
    result = compared(files, (urdf, mjcf))
    assert result.passed
    assert not [cause for cause in result.causes if cause.kind == "actuator"]


def test_an_export_that_loses_what_carries_the_load_fails(tmp_path):
    """A bob of 0.3 kg hangs on a cable of 0.3 m, which a URDF cannot state."""
    file = tmp_path / "leash.xml"
    file.write_text(
        '<mujoco><worldbody><site name="top"/><body name="bob" pos="0.1 0 0">'
        '<joint name="x" type="slide" axis="1 0 0" range="-1 1"/>'
        '<joint name="z" type="slide" axis="0 0 1" range="-1 1"/>'
        '<inertial pos="0 0 0" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/><site name="loop"/></body>'
        '</worldbody><tendon><spatial name="leash" limited="true" range="0 0.3"><site site="top"/>'
        '<site site="loop"/></spatial></tendon></mujoco>'
    )
    result, lost = export.write_urdf(file, tmp_path / "leash.urdf")
    assert not result.passed
    assert any("tendon_range" in line for line in lost)
    assert "tendon" in {cause.kind for cause in result.causes if not cause.one_sided}
