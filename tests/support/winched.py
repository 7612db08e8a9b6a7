"""An arm with two winches, a slack brace, lag and delay, and sensors of every kind."""

from __future__ import annotations

import numpy as np

from softdyn import SetPoint, SoftModel
from softdyn.validation import Log, Rig, simulate

LINK = """<link name="{name}"><inertial><origin xyz="0.1 0 0"/><mass value="0.3"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>
<visual><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.02 0.02"/></geometry></visual></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} 0 0"/><axis xyz="0 1 0"/><dynamics damping="0.02" stiffness="0.5"/>
<limit lower="-1.2" upper="1.2" effort="9" velocity="9"/></joint>"""
SITES = """<site link="base" xyz="-0.02 0 {z}"/><site link="upper" xyz="0.1 0 {z}"/>
<site link="fore" xyz="0.15 0 {z}"/>"""
WINCH = 'command="length" stiffness="600" damping="4" lag="0.02" delay="0.0041"'
MOTOR = 'lag="0.01" delay="0.003"'

ARM = f"""<robot name="winched">{LINK.format(name="base")}
{LINK.format(name="upper")}{LINK.format(name="fore")}<link name="tip"/>
{JOINT.format(name="shoulder", parent="base", child="upper", x=0)}
{JOINT.format(name="elbow", parent="upper", child="fore", x=0.2)}
<joint name="end" type="fixed"><parent link="fore"/><child link="tip"/>
<origin xyz="0.2 0 0"/></joint>
<softdyn version="1">
<tendon name="below">{SITES.format(z=-0.02)}</tendon>
<tendon name="above" stiffness="50" damping="1" slack="true">{SITES.format(z=0.02)}</tendon>
<actuator name="flexor" tendon="below" gear="-1" lower="0" upper="60" {WINCH}/>
<actuator name="extensor" tendon="above" gear="-1" lower="0" upper="60" {MOTOR}/>
<task frame="tip"/>
<sensor name="wire" type="length" tendon="above"/>
<sensor name="load" type="tension" tendon="above"/>
<sensor name="pull" type="tension" tendon="below"/>
<sensor name="camera" type="pose" link="tip" xyz="0 0.01 0" rpy="0.3 0.2 0.1"/>
<sensor name="mark" type="position" link="upper" xyz="0.05 0 0.01"/>
<sensor name="imu" type="accelerometer" link="tip" rpy="0 0.4 0"/>
<sensor name="gyro" type="gyro" link="tip"/>
<sensor name="encoder" type="joint" joint="elbow"/>
</softdyn></robot>"""


def turns(model: SoftModel) -> Log:
    """A run in which the two motors pull in turn."""

    def law(state: object, reference: object) -> np.ndarray:
        calls.append(1)
        return np.array([20.0, 0.0] if len(calls) % 100 < 50 else [0.0, 15.0])

    calls: list[int] = []
    return simulate(model, law, SetPoint(np.zeros(3)), duration=0.4, rig=Rig(latency=0.002))
