"""Small robots with mimic joints and for floating bases, used by several tests."""

from __future__ import annotations

from pathlib import Path

SOLID = (
    '<inertial><origin xyz="0.05 -0.02 0.1" rpy="0.3 -0.8 2"/><mass value="0.7"/>'
    '<inertia ixx="2e-3" ixy="1e-4" ixz="-2e-4" iyy="3e-3" iyz="3e-4" izz="4e-3"/></inertial>'
)
LIMIT = '<limit lower="-0.8" upper="1.1" effort="1" velocity="1"/>'


def joint(name: str, kind: str, parent: str, child: str, more: str = "") -> str:
    """A joint with an offset, about an oblique axis."""
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0.1 0.2 -0.3" rpy="0.4 -1.1 2.5"/>'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="0.3 -0.4 1.2"/>'
        f"{'' if kind in ('fixed', 'continuous') else LIMIT}{more}</joint>"
    )


DAMPER = '<dynamics damping="0.3"/>'
# An arm with a hinge that a slide and a continuous joint follow, one of them beyond the hinge.
GRIPPER = (
    f'<robot name="gripper"><link name="base">{SOLID}</link><link name="arm">{SOLID}</link>'
    f'<link name="finger">{SOLID}</link><link name="jaw">{SOLID}<!--jaw--></link>'
    f'<link name="wheel">{SOLID}</link>'
    + joint("z_arm", "revolute", "base", "arm", DAMPER)
    + joint("a_lead", "revolute", "arm", "finger", DAMPER)
    + joint("b_slide", "prismatic", "arm", "jaw",
            '<mimic joint="a_lead" multiplier="-0.5" offset="0.02"/><dynamics damping="2"/>')
    + joint("c_turn", "continuous", "finger", "wheel",
            '<mimic joint="a_lead" multiplier="2" offset="-0.1"/>')
    + '<gazebo reference="b_slide"><springStiffness>30</springStiffness>'
    "<springReference>0.1</springReference></gazebo>"
    '<gazebo reference="a_lead"><springStiffness>2</springStiffness></gazebo>'
    '<softdyn version="1"><joint name="c_turn" armature="0.01"/>'
    '<joint name="a_lead" armature="0.003"/><joint name="z_arm" armature="0.002"/>'
    '<tendon name="band" stiffness="4" damping="0.1"><joint name="b_slide" coef="3"/>'
    '<joint name="z_arm" coef="0.5"/></tendon>'
    '<tendon name="cable" stiffness="9"><site link="arm" xyz="0.3 0 0"/>'
    '<site link="jaw" xyz="0 0.1 0"/><site link="wheel" xyz="0.2 0 0.1"/></tendon>'
    '<actuator name="u1" tendon="band" gear="2" lower="-1" upper="3"/>'
    '<actuator name="u2" tendon="cable" gear="-1" lower="0" upper="3"/>'
    '<actuator name="u3" tendon="band" lower="-1" upper="1"/>'
    '<task frame="wheel"/></softdyn></robot>'
)  # fmt: skip
# A trunk with two legs (one a continuous joint), a spring, a damper and a cable.
FLOATING = (
    f'<robot name="walker"><link name="trunk">{SOLID}</link><link name="pack">{SOLID}</link>'
    f'<link name="z">{SOLID}</link><link name="a">{SOLID}</link>'
    + joint("weld", "fixed", "trunk", "pack")
    + joint("jz", "continuous", "pack", "z", DAMPER)
    + joint("ja", "revolute", "trunk", "a", DAMPER)
    + '<gazebo reference="ja"><springStiffness>2</springStiffness>'
    "<springReference>0.3</springReference></gazebo>"
    '<softdyn version="1"><joint name="jz" armature="0.01"/>'
    '<tendon name="cable" stiffness="9" rest="0.2"><site link="trunk" xyz="0.3 0 0"/>'
    '<site link="z" xyz="0 0.1 0"/><site link="a" xyz="0.2 0 0.1"/></tendon>'
    '<actuator name="u" tendon="cable" gear="-1" lower="0" upper="3"/>'
    '<task frame="a"/></softdyn></robot>'
)


def write(folder: Path, text: str) -> Path:
    """Write the file of a robot."""
    path = folder / "micro.urdf"
    path.write_text(text, encoding="utf-8")
    return path
