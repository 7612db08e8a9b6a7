"""Several tasks in a file: read, written, equal, and as tasks of the library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import softdyn
from softdyn.description.stated_task import StatedTask, TaskKind
from softdyn.description.urdf_writer import write
from softdyn.tasks import AxisTask, PointTask, PoseTask, make_tasks
from tests.support import robots
from tests.support.misuses import ARM

PLAIN = '<task frame="wheel"/>'
SEVERAL = (
    '<task frame="pad" kind="pose" level="1"/>'
    '<task frame="wheel" axes="z x" weight="0.5" Kp="30"/>'
    '<task name="up" frame="wheel" kind="axis" direction="0 0.6 0.8" axes="rx" level="2"/>'
)


def parsed(folder, text: str = ARM) -> softdyn.Robot:
    path = robots.write(folder, text, "arm.urdf")
    return softdyn.parse(path)


def test_a_plain_task_is_the_tip_alone(tmp_path) -> None:
    robot = parsed(tmp_path)
    assert (robot.task, robot.tasks) == ("wheel", ())
    spelled = '<task name="wheel" frame="wheel" kind="position" weight="1" level="0"/>'
    same = parsed(tmp_path, ARM.replace(PLAIN, spelled))
    assert same == robot
    assert same.digest == robot.digest
    (only,) = make_tasks(softdyn.build(robot))
    assert isinstance(only, PointTask)
    assert only.plain


def test_several_tasks_are_read_and_written(tmp_path) -> None:
    text = ARM.replace(PLAIN, SEVERAL)
    robot = parsed(tmp_path, text)
    assert robot.task == "pad"
    assert robot.tasks == (
        StatedTask("pad", "pad.pose", TaskKind.POSE, level=1),
        StatedTask("wheel", "wheel", axes=("z", "x"), weight=0.5, Kp=30.0),
        StatedTask("wheel", "up", TaskKind.AXIS, ("rx",), (0.0, 0.6, 0.8), level=2),
    )
    assert parsed(tmp_path, write(robot)) == robot
    assert robot.digest != replace(robot, tasks=()).digest
    block = text[text.index("<softdyn") : text.index("</softdyn>")] + "</softdyn>"
    assert parsed(tmp_path, text.replace(block, block.replace("\n", ""))) == robot


def test_tasks_of_the_file_are_tasks_of_the_library(tmp_path) -> None:
    model = softdyn.build(parsed(tmp_path, ARM.replace(PLAIN, SEVERAL)))
    pose, point, up = make_tasks(model)
    assert isinstance(pose, PoseTask)
    assert (pose.link, pose.name, pose.level) == ("pad", "pad.pose", 1)
    assert isinstance(point, PointTask)
    assert (point.axes, point.weight, point.Kp) == ((2, 0), 0.5, 30.0)
    assert isinstance(up, AxisTask)
    assert (up.axes, up.level) == ((0,), 2)
    np.testing.assert_allclose(up.axis, (0, 0.6, 0.8))
