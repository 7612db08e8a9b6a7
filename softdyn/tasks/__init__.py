"""Tasks: what is to be controlled, its error with two exact derivatives, and references for it.

    tasks = [PointTask("tip"), AxisTask("tip", [1, 0, 0], level=1)]
    controller = softdyn.controllers.SoftIdClfQp(model, tasks=tasks)
    reference = References({"tip": SetPoint(y), "tip.axis": Target([0, 0, -1])})

- `task`: the contract `Task`, one class with one method; a user's own task is such a class;
- `frames`: tasks of a link's frame: `PointTask`, `OrientationTask`, `PoseTask`, `AxisTask`;
- `shape`: `ShapeTask`, `JointTask` and `StrainTask`, of the whole arm;
- `targets`: targets and paths of them, stacked by the tasks' names;
- `marks`: targets as rows of numbers, for logs, pages and the mouse;
- `link_motion`: pose, Jacobian and J̇ q̇ of any link;
- `rotations`: errors of angles and their derivatives.
"""

from softdyn.tasks.frames import (
    AxisTask,
    FrameTask,
    OrientationTask,
    PointTask,
    PoseTask,
    direction_tasks,
    make_tasks,
)
from softdyn.tasks.link_motion import LinkKinematics, LinkMotion
from softdyn.tasks.shape import JointTask, ShapeTask, StrainTask
from softdyn.tasks.targets import (
    Poses,
    References,
    StackedReference,
    Target,
    Turns,
    Waypoints,
    read_path,
    read_paths,
    recorded_paths,
)
from softdyn.tasks.task import Task, TaskError, compute_errors

__all__ = [
    "AxisTask",
    "FrameTask",
    "JointTask",
    "LinkKinematics",
    "LinkMotion",
    "OrientationTask",
    "PointTask",
    "PoseTask",
    "Poses",
    "References",
    "ShapeTask",
    "StackedReference",
    "StrainTask",
    "Target",
    "Task",
    "TaskError",
    "Turns",
    "Waypoints",
    "compute_errors",
    "direction_tasks",
    "make_tasks",
    "read_path",
    "read_paths",
    "recorded_paths",
]  # fmt: skip
