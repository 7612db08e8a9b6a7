"""Targets of tasks as numbers, in a log and on its page."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import Reference
from softdyn.description.task_mark import TaskMark
from softdyn.tasks import (
    AxisTask,
    JointTask,
    OrientationTask,
    PointTask,
    PoseTask,
    StackedReference,
    Target,
)  # fmt: skip
from softdyn.tasks.marks import marks_of, numbers_at, stacked, target_row
from tests.support.refused import refused

TIP = "tip"
TASKS = [
    PointTask(TIP, (0.01, 0.0, 0.02), name="point"), OrientationTask(TIP),
    PoseTask(TIP, (0, 0.03, 0)), AxisTask(TIP, [1.0, -2.0, 0.5]), JointTask(["joint1"]),
]  # fmt: skip


def test_a_target_from_a_link_s_pose_is_fulfilled_there() -> None:
    model = softdyn.load("finger")
    marks = marks_of(TASKS)
    assert [mark.name for mark in marks] == ["point", "tip.orientation", "tip.pose", "tip.axis"]
    assert [len(mark.columns) for mark in marks] == [3, 3, 6, 3]
    rng = np.random.default_rng(3)
    for _ in range(5):
        state = model.state(rng.uniform(model.lower, model.upper), np.zeros(model.nv))
        pose = model.link_poses(state.q)[TIP]
        rows = [numbers_at(mark, pose) for mark in marks]
        goal = stacked(marks, np.concatenate(rows))
        for task in TASKS[:4]:
            np.testing.assert_allclose(task(state, goal).error, 0, atol=1e-9)
        np.testing.assert_allclose(target_row(TASKS, goal), np.concatenate(rows), atol=1e-9)
        for mark, row in zip(marks, rows, strict=True):
            mark.check(row, 1.0)


@pytest.mark.parametrize(
    ("number", "values", "place", "got"),
    [
        (0, [0.0, 2.0, 0.0], "point", [0.0, 2.0, 0.0]),
        (1, [3.0, 1.0, 0.0], "tip.orientation", [3.0, 1.0, 0.0]),
        (2, [0.0, 0.0, -2.0, 0.0, 0.0, 0.0], "tip.pose", [0.0, 0.0, -2.0]),
        (2, [0.0, 0.0, 0.0, 0.0, 0.0, 4.0], "tip.pose", [0.0, 0.0, 4.0]),
        (3, [0.0, 0.0, 0.0], "tip.axis", [0.0, 0.0, 0.0]),
        (3, [1.0, 1.0, 0.0], "tip.axis", [1.0, 1.0, 0.0]),
    ],
)
def test_numbers_that_no_mouse_drags_to_are_refused(
    number: int, values: list[float], place: str, got: list[float]
) -> None:
    with refused(f"target of '{place}'", got):
        marks_of(TASKS)[number].check(np.array(values), 1.0)


def test_a_mark_is_its_table() -> None:
    for mark in marks_of(TASKS):
        assert TaskMark.of(mark.table) == mark
    with refused("mark"):
        TaskMark.of({"name": "a", "link": "b", "kind": "axis"})
    plain = StackedReference({"point": Reference(np.ones(3)), "tip.orientation": Target(np.eye(3))})
    np.testing.assert_array_equal(target_row(TASKS[:2], plain), [1, 1, 1, 0, 0, 0])
