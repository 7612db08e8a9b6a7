"""A cart on a spring, small enough for closed forms, and two controllers for it."""

from types import SimpleNamespace

import numpy as np

import softdyn
from softdyn import SetPoint

MASS, STIFFNESS, DAMPING = 0.5, 8.0, 0.3
LENGTH = 0.4
# A cart along x with the tip 0.4 m ahead of it, so that gravity does no work.
CART = """<robot name="cart">
  <link name="base"/>
  <link name="body"><inertial><mass value="0.5"/>
    <inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>
  <link name="tip"/>
  <joint name="x" type="prismatic"><parent link="base"/><child link="body"/><axis xyz="1 0 0"/>
    <limit lower="-9" upper="9" effort="1" velocity="1"/><dynamics damping="{damping}"/></joint>
  <joint name="end" type="fixed"><parent link="body"/><child link="tip"/><origin xyz="0.4 0 0"/>
  </joint>
  <gazebo reference="x"><springStiffness>{stiffness}</springStiffness></gazebo>
  <softdyn version="1">
    <tendon name="cable"><joint name="x" coef="1"/></tendon>
    <actuator name="u" tendon="cable" gear="1" lower="{lower}" upper="{upper}"/>
  </softdyn>
</robot>"""
TARGET = SetPoint([LENGTH + 0.5, 0.0, 0.0])


def load(folder, text):
    path = folder / "robot.urdf"
    path.write_text(text)
    return softdyn.load(path)


def push(force):
    return lambda state, reference: SimpleNamespace(u=np.array([force]))


def steer(state, reference):
    """Computed torque with both poles at -5: the error obeys ë + 10 ė + 25 e = 0."""
    a = reference.yddot[0] - 10 * (state.ydot - reference.ydot)[0] - 25 * (state.y - reference.y)[0]
    return SimpleNamespace(u=(state.M[0] * a + state.h) / state.B[0])
