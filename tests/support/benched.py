"""A small arm with a rig, its served rig on a clock of its own, and a driver without a socket."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import softdyn
from softdyn import SoftModel
from softdyn.description.urdf import parse_text
from softdyn.validation.bench.clock import TimeSource
from softdyn.validation.bench.served import ServedRig

LINK = """<link name="{name}"><inertial><origin xyz="0.1 0 0"/><mass value="0.2"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} 0 0"/><axis xyz="0 1 0"/><dynamics damping="0.1"/>
<limit lower="-1.2" upper="1.2" effort="9" velocity="9"/></joint>
<gazebo reference="{name}"><springStiffness>2</springStiffness></gazebo>"""
ARM = f"""<robot name="benched">{LINK.format(name="base")}
{LINK.format(name="upper")}{LINK.format(name="fore")}<link name="tip"/>
{JOINT.format(name="shoulder", parent="base", child="upper", x=0)}
{JOINT.format(name="elbow", parent="upper", child="fore", x=0.2)}
<joint name="end" type="fixed"><parent link="fore"/><child link="tip"/>
<origin xyz="0.2 0 0"/></joint>
<softdyn version="1">
<tendon name="a"><joint name="shoulder" coef="0.05"/></tendon>
<tendon name="b"><joint name="elbow" coef="0.05"/></tendon>
<actuator name="ua" tendon="a" gear="1" lower="-60" upper="60"/>
<actuator name="ub" tendon="b" gear="1" lower="-60" upper="60" lag="0.01"/>
<task frame="tip"/>
<sensor name="shoulder" type="joint" joint="shoulder" noise="3e-4" lower="-1.1" upper="1.1"/>
<sensor name="elbow" type="joint" joint="elbow" noise="3e-4"/>
<sensor name="load" type="tension" tendon="b" noise="0.5"/>
<sensor name="camera" type="position" link="tip" noise="1e-3" rate="50" latency="0.02"/>
</softdyn></robot>"""


def benched() -> SoftModel:
    return softdyn.build(parse_text(ARM, path=Path("benched.urdf")))


class Hands:
    """A clock that moves only when somebody sleeps on it, or by `pass_`."""

    def __init__(self) -> None:
        self.time = 100.0
        self.source = TimeSource(lambda: self.time, self.pass_)

    def pass_(self, seconds: float) -> None:
        self.time += seconds


class Tower:
    """The clock and the served rig that all drivers of a test share."""

    hands: Hands
    rig: ServedRig
    stops = starts = 0


class NearDriver:
    """A driver that asks a `ServedRig` of this process; each test sets `tower`."""

    tower: Tower

    def __init__(self, model: SoftModel) -> None:
        self.open = False

    def start(self) -> None:
        self.open, self.tower.starts = True, self.tower.starts + 1

    def read(self):
        return self.tower.rig.advance()

    def send(self, commands: np.ndarray) -> None:
        assert self.open
        self.tell({"send": commands.tolist()})

    def stop(self) -> None:
        self.open, self.tower.stops = False, self.tower.stops + 1
        self.tell({"stop": True})

    def tell(self, message: object) -> None:
        assert self.tower.rig.obey(json.dumps(message)) is None


def tower(model: SoftModel) -> Tower:
    """A served rig whose clock moves by hand; drivers made from now on are its own."""
    made = Tower()
    made.hands = Hands()
    made.rig = ServedRig(model, clock=made.hands.source.now)
    NearDriver.tower = made
    return made
