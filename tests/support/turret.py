"""A turret: an arm in a vertical plane on a continuous joint that no spring holds."""

from __future__ import annotations

BODY = (
    '<link name="{}"><inertial><origin xyz="{} 0 0"/><mass value="{}"/>'
    '<inertia ixx="1e-5" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
LIMIT = '<limit lower="-1.2" upper="1.2" effort="3" velocity="5"/>'
TURRET = (
    '<robot name="turret"><link name="base"/>'
    + BODY.format("table", 0, 0.3) + BODY.format("arm", 0.06, 0.1) + BODY.format("hand", 0.04, 0.05)
    + '<link name="tip"/>'
    '<joint name="pan" type="continuous"><parent link="base"/><child link="table"/>'
    '<axis xyz="0 0 1"/><dynamics damping="0.02"/></joint>'
    '<joint name="tilt" type="revolute"><origin xyz="0 0 0.05"/><parent link="table"/>'
    f'<child link="arm"/><axis xyz="0 1 0"/>{LIMIT}'
    '<dynamics damping="0.01" stiffness="0.6"/></joint>'
    '<joint name="wrist" type="revolute"><origin xyz="0.12 0 0"/><parent link="arm"/>'
    f'<child link="hand"/><axis xyz="0 1 0"/>{LIMIT}'
    '<dynamics damping="0.005" stiffness="0.2"/></joint>'
    '<joint name="end" type="fixed"><origin xyz="0.08 0 0"/><parent link="hand"/>'
    '<child link="tip"/></joint><softdyn version="1">'
    '<tendon name="pan_t"><joint name="pan" coef="1"/></tendon>'
    '<tendon name="flex"><joint name="tilt" coef="0.02"/><joint name="wrist" coef="0.015"/>'
    "</tendon>"
    '<actuator name="pan_m" tendon="pan_t" lower="-1" upper="1"/>'
    '<actuator name="flex_m" tendon="flex" lower="-30" upper="30"/>'
    '<task frame="tip"/></softdyn></robot>'
)  # fmt: skip
