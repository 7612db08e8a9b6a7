"""A hanging arm of two joints with a cable that pulls, and one that keeps a constant preload."""

from __future__ import annotations

from pathlib import Path

import softdyn
from softdyn import SoftModel

LINK = """<link name="{name}"><inertial><origin xyz="0 0 -0.1"/><mass value="0.1"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 {z}"/><axis xyz="0 1 0"/><limit lower="{lower}" upper="1" effort="1" velocity="1"/>
<dynamics damping="0.02" stiffness="0.5"/></joint>"""
TARGET = (0.02, 0.0, -0.199)


def text(lower: float = 5.0, upper: float = 5.0, *, elbow: float = -1.0) -> str:
    """The arm's URDF with the preload's bounds (N) and the elbow's lower limit (rad)."""
    return f"""<robot name="arm"><link name="base"/><link name="tip"/>
{LINK.format(name="a")}{LINK.format(name="b")}
{JOINT.format(name="j1", parent="base", child="a", z=0, lower=-1)}
{JOINT.format(name="j2", parent="a", child="b", z=-0.1, lower=elbow)}
<joint name="end" type="fixed"><parent link="b"/><child link="tip"/><origin xyz="0 0 -0.1"/></joint>
<softdyn version="1">
<tendon name="left"><joint name="j1" coef="0.02"/><joint name="j2" coef="0.01"/></tendon>
<tendon name="right"><joint name="j1" coef="-0.02"/><joint name="j2" coef="-0.02"/></tendon>
<actuator name="pull" tendon="left" gear="-1" lower="0" upper="20"/>
<actuator name="preload" tendon="right" gear="-1" lower="{lower!r}" upper="{upper!r}"/>
<task frame="tip"/></softdyn></robot>"""


def load(folder: Path, *bounds: float, elbow: float = -1.0) -> SoftModel:
    """The arm from its file."""
    path = folder / "arm.urdf"
    path.write_text(text(*bounds, elbow=elbow))
    return softdyn.load(path)
