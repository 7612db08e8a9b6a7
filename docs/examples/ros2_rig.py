"""A driver of a rig behind ROS 2 topics: a skeleton that was not run, as no test here has ROS.

source /opt/ros/…/setup.bash
softdyn drive ROBOT CONTROLLER --driver ros2_rig.py:Ros2Rig --target X Y Z

`softdyn drive` keeps the loop and its clock. This node has a thread of its own, which only keeps
the newest messages, so that read() never waits.

- /cable_states, sensor_msgs/JointState, from the node of your motors: its names are the file's
  actuators, its position is the length of the tendon in m, its effort the tension in N.
- /tip, geometry_msgs/PointStamped, from your cameras: the point in the frame of the robot's root.
- /cable_commands, sensor_msgs/JointState, to the node of your motors: position, velocity or effort,
  as the file's motors state. /cable_relax, std_msgs/Empty: let all cables go slack.
"""

import math
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

FIELDS = {"force": "effort", "length": "position", "velocity": "velocity"}


class Ros2Rig:
    """Topics with lengths and tensions of cables, and the tip from cameras."""

    def __init__(self, model):
        robot = model.robot
        self.motors = [motor.name for motor in robot.actuators]
        self.kinds = [FIELDS[motor.command.value] for motor in robot.actuators]
        tendons = [motor.tendon for motor in robot.actuators]
        first = 0
        self.rows: dict[Any, int] = {}  # the place of each reading: of (motor, field), or "tip"
        for sensor in robot.sensors:
            kind = sensor.kind.value
            if kind in ("length", "tension"):
                field = "position" if kind == "length" else "effort"
                self.rows[self.motors[tendons.index(sensor.tendon)], field] = first
            elif kind == "position":
                self.rows["tip"] = first
            first += sensor.kind.size
        self.node: Any = None
        self.size, self.lock = first, threading.Lock()

    def start(self):
        rclpy.init()
        self.node = rclpy.create_node("softdyn_rig")
        self.clear()
        newest = qos_profile_sensor_data  # the newest message, and none again that was lost
        self.node.create_subscription(JointState, "/cable_states", self.cables, newest)
        self.node.create_subscription(PointStamped, "/tip", self.tip, newest)
        self.out = self.node.create_publisher(JointState, "/cable_commands", newest)
        self.relax = self.node.create_publisher(Empty, "/cable_relax", 10)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()

    def read(self):
        with self.lock:
            found = self.values, self.stamps
            self.clear()
        return found

    def send(self, commands):
        message = JointState()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.name = self.motors
        for name in ("position", "velocity", "effort"):
            there = zip(self.kinds, commands, strict=True)
            setattr(message, name, [float(c) if kind == name else math.nan for kind, c in there])
        self.out.publish(message)

    def stop(self):
        if self.node is None:  # not started, or stopped before
            return
        self.relax.publish(Empty())
        time.sleep(0.01)  # until it has left; the motors' node must relax by itself, too
        self.executor.shutdown()
        self.thread.join()
        self.node.destroy_node()
        self.node = None
        rclpy.shutdown()

    def cables(self, message):
        """Keep lengths and tensions."""
        at = self.measured(message.header.stamp)
        with self.lock:
            for k, name in enumerate(message.name):
                for field in ("position", "effort"):
                    row = self.rows.get((name, field))
                    if row is not None:
                        self.values[row], self.stamps[row] = getattr(message, field)[k], at

    def tip(self, message):
        """Keep the tip; a lost marker is NaN, which is no reading."""
        row, point = self.rows["tip"], message.point
        with self.lock:
            self.values[row : row + 3] = [point.x, point.y, point.z]
            self.stamps[row : row + 3] = [self.measured(message.header.stamp)] * 3

    def measured(self, stamp):
        """A ROS stamp on the clock of time.monotonic()."""
        age = self.node.get_clock().now().nanoseconds * 1e-9 - stamp.sec - stamp.nanosec * 1e-9
        return time.monotonic() - age

    def clear(self):
        """Nothing is new."""
        self.values, self.stamps = [math.nan] * self.size, [math.nan] * self.size
