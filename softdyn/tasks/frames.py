"""Tasks of a link's frame: a point, an orientation, a pose, a direction.

All errors, targets and rates are in the world's axes; see `rotations` for those of angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from softdyn.checks import array, unit
from softdyn.description.stated_task import TaskKind
from softdyn.dynamics.model import SoftModel, State
from softdyn.exceptions import InputError
from softdyn.tasks.link_motion import ZERO, LinkKinematics, LinkMotion
from softdyn.tasks.rotations import axis_terms, pose_terms
from softdyn.tasks.targets import Target
from softdyn.tasks.task import Task, TaskError, check_target


@dataclass(frozen=True, eq=False)
class FrameTask(Task):
    """A task of a link's frame.

    Attributes
    ----------
    link : str
        The link.
    """

    link: str

    suffix = ""
    stated: ClassVar[TaskKind | None] = None  # its name in a robot's file
    point = (0.0, 0.0, 0.0)
    goal: ClassVar[tuple[str, tuple[int, ...]]] = ("a point", (3,))  # kind and shape of its target

    def __post_init__(self) -> None:
        if not isinstance(self.link, str):
            raise InputError("link", "the name of a link", repr(self.link))
        if not self.name:
            object.__setattr__(self, "name", self.link + self.suffix)
        super().__post_init__()

    def motion(self, state: State) -> LinkMotion:
        """The motion of the task's frame."""
        return LinkKinematics.of(state.model)(state, self.link, self.point)

    def check(self, target: Any) -> None:
        """Refuse a target of another kind.

        Raises
        ------
        InputError
            It names the task, and says what its target must be.
        """
        check_target(self, target, *self.goal)


def frame_error(task: FrameTask, state: State, target: Any) -> TaskError:
    """The error of a task of a `stated` kind, all rows of it.

    Raises
    ------
    InputError
        For a target of another kind, or a link that the robot does not have.
    """
    size = task.size or 0
    values, jacobian = np.empty((3, size)), np.empty((size, len(state.v)))
    stack = FrameStack((task,), [(0, row, row) for row in range(size)])
    stack.take(0, target)
    stack.fill(state, values, jacobian)
    return TaskError(values[0], values[1], jacobian, values[2])


@dataclass(frozen=True, eq=False)
class PointTask(FrameTask):
    """A point of a link at a point of the world: e = p - p_r (m). Its name is the link's.

    Its target is a `Reference`, or a `Target` of shape (3,).

    Attributes
    ----------
    point : array_like, (3,)
        The point in the link's frame (m).
    """

    point: Any = (0.0, 0.0, 0.0)

    size = 3
    units = ("m",)
    stated = TaskKind.POSITION

    def __post_init__(self) -> None:
        point = tuple(array("point", self.point, (3,)).tolist())
        object.__setattr__(self, "point", point)
        super().__post_init__()

    @property
    def plain(self) -> bool:
        """Whether it is the whole position of the link's origin, without an own weight or gain."""
        alone = self.point == (0.0, 0.0, 0.0) and self.axes is None and self.target is None
        return alone and self.Kp is None and bool(np.all(np.equal(self.weight, 1.0)))

    @property
    def takes_plain(self) -> bool:
        """True: a plain `Reference` is a point's target."""
        return True

    evaluate = frame_error


@dataclass(frozen=True, eq=False)
class OrientationTask(FrameTask):
    """A link's axes along given ones: e = log₃(R R_rᵀ) (rad). Its name is LINK.orientation.

    Its target is a `Target` of shape (3, 3), a rotation with its ω and ω̇.
    """

    size = 3
    units = ("rad",)
    suffix = ".orientation"
    stated = TaskKind.ORIENTATION
    goal = ("a rotation", (3, 3))
    evaluate = frame_error


@dataclass(frozen=True, eq=False)
class PoseTask(FrameTask):
    """A frame of a link at a given pose: log₆ about the target's origin. Its name is LINK.pose.

    The error (6,) has the translation first. Its target is a `Target` of shape (4, 4).

    Attributes
    ----------
    point : array_like, (3,)
        Origin of the frame in the link's (m).
    """

    point: Any = (0.0, 0.0, 0.0)

    size = 6
    units = ("m", "m", "m", "rad")
    suffix = ".pose"
    stated = TaskKind.POSE
    goal = ("a pose", (4, 4))

    def __post_init__(self) -> None:
        point = tuple(array("point", self.point, (3,)).tolist())
        object.__setattr__(self, "point", point)
        super().__post_init__()

    evaluate = frame_error


@dataclass(frozen=True, eq=False)
class AxisTask(FrameTask):
    """A direction of a link along one of the world, free to turn about it. Its name is LINK.axis.

    The error (rad) is the shortest turn from the target to the direction. Of its three rows two are
    independent. Its target is a `Target` of shape (3,), a unit vector with its two rates.

    Attributes
    ----------
    axis : array_like, (3,)
        The direction in the link's frame. Without a target in the reference, the same numbers are
        the direction in the world.
    """

    axis: Any

    size = 3
    units = ("rad",)
    suffix = ".axis"
    stated = TaskKind.AXIS
    goal = ("a direction", (3,))

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", unit("axis", self.axis))
        if self.target is None:
            object.__setattr__(self, "target", Target(self.axis))
        super().__post_init__()

    def check(self, target: Any) -> None:
        """Refuse also a vector that is no unit vector."""
        super().check(target)
        if not abs(target.y @ target.y - 1) < 1e-6:
            expected = "a unit vector"
            raise InputError(f"target of {self.name!r}", expected, repr(target.y.tolist()))

    evaluate = frame_error


class FrameStack:
    """The errors of several tasks of frames.

    Parameters
    ----------
    tasks : sequence of FrameTask
        Tasks of a `stated` kind.
    rows : sequence of (int, int, int)
        The rows to be filled, task by task: the task's index, the row of its error, and that of the
        arrays.
    """

    def __init__(self, tasks: Sequence[FrameTask], rows: Sequence[tuple[int, int, int]]) -> None:
        self._tasks, self._given = tuple(tasks), tuple(rows)
        # of each task the rows of its error, and those of the arrays
        self._rows = [
            np.array([(i, j) for task, i, j in rows if task == k], int).reshape(-1, 2).T
            for k in range(len(self._tasks))
        ]
        count = len(self._tasks)
        # the targets: poses and rotations, and before their rates points and directions
        self._poses, self._motions = np.zeros((count, 4, 4)), np.zeros((count, 3, 6))
        self._held: list[Any] = [None] * count
        self._kinematics: LinkKinematics | None = None
        self._places: Any = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return FrameStack, (self._tasks, self._given)

    def take_from(self, reference: Any) -> None:
        """Check and copy the targets of a reference, unless they are those of the last one.

        Raises
        ------
        InputError
            For a target that is missing or of another kind.
        """
        for k, task in enumerate(self._tasks):
            target = task.target_in(reference)
            if target is not self._held[k]:
                self.take(k, target)

    def take(self, k: int, target: Any) -> None:
        """Check and copy the target of task k.

        Raises
        ------
        InputError
            For a target of another kind.
        """
        self._tasks[k].check(target)
        goal, y = self._motions[k], target.y
        first = 3 if y.shape == (3, 3) else 0
        if y.ndim == 1:
            goal[0, :3] = y
        else:
            self._poses[k, : len(y), : len(y)] = y
        goal[1, first : first + len(target.ydot)] = target.ydot
        goal[2, first : first + len(target.yddot)] = target.yddot
        self._held[k] = target

    @np.errstate(all="ignore")  # a decorator
    def fill(self, state: State, values: np.ndarray, jacobian: np.ndarray) -> None:
        """Write error, rate and drift of the rows into `values` (3, r), and J (r, n).

        Raises
        ------
        InputError
            For a link that the robot does not have.
        """
        kinematics = LinkKinematics.of(state.model)
        if kinematics is not self._kinematics:
            self._places = kinematics.places([(task.link, task.point) for task in self._tasks])
            self._kinematics = kinematics
        motions = kinematics.motions(state, self._places)
        for k, (task, rows) in enumerate(zip(self._tasks, self._rows, strict=True)):
            found, by_q = self._terms(k, task, LinkMotion(*(each[k] for each in motions)))
            values[:, rows[1]], jacobian[rows[1]] = found[:, rows[0]], by_q[rows[0]]

    def _terms(self, k: int, task: FrameTask, at: LinkMotion) -> tuple[np.ndarray, np.ndarray]:
        """Error, rate and drift (3, rows) of a task, and its Jacobian (rows, n)."""
        goal, pose = self._motions[k], self._poses[k]
        if task.stated is TaskKind.POSITION:
            found = np.stack((at.position, at.velocity[:3], at.drift[:3]))
            return found - goal[:, :3], at.jacobian[:3]
        if task.stated is TaskKind.AXIS:
            return axis_terms(at, getattr(task, "axis", ZERO), *goal[:, :3])
        if task.stated is TaskKind.POSE:
            return pose_terms(at, pose, goal[1], goal[2])
        pose[:3, 3] = at.position
        found, by_q = pose_terms(at, pose, goal[1], goal[2])
        return found[:, 3:], by_q[3:]


def make_tasks(model: SoftModel) -> list[Task]:
    """The tasks that the robot's file states; the position of the tip if it states none."""
    found: list[Task] = []
    for stated in model.robot.tasks:
        axes = [stated.kind.rows.index(axis) for axis in stated.axes] or None
        common: dict[str, Any] = {
            "name": stated.name, "weight": stated.weight, "Kp": stated.Kp, "level": stated.level,
            "axes": axes,
        }  # fmt: skip
        if stated.kind is TaskKind.AXIS:
            found.append(AxisTask(stated.frame, stated.direction, **common))
        else:
            found.append(OF_KIND[stated.kind](stated.frame, **common))
    return found or [PointTask(model.robot.task)]


def direction_tasks(model: SoftModel) -> list[Task]:
    """The tip's position, and the arm's direction there; a third of its length counts as 1 rad.

    Raises
    ------
    InputError
        For a robot whose tip lies in its base.
    """
    tip = model.robot.task
    offsets = [joint.origin.xyz for joint in model.robot.chain(tip) if any(joint.origin.xyz)]
    if not offsets:
        raise InputError("robot", "a tip away from its base", model.robot.name)
    return [PointTask(tip), AxisTask(tip, offsets[-1], weight=0.1 * model.robot.length**2)]


OF_KIND: dict[TaskKind, type[PointTask | OrientationTask | PoseTask]] = {
    one.stated: one for one in (PointTask, OrientationTask, PoseTask)
}
