"""Tasks of a link's frame: a point, an orientation, a pose, a direction.

All errors, targets and rates are in the world's axes; see `rotations` for those of angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from softdyn.checks import array, unit
from softdyn.description.stated_task import TaskKind
from softdyn.dynamics.model import SoftModel, State
from softdyn.exceptions import InputError
from softdyn.tasks.link_motion import LinkKinematics, LinkMotion
from softdyn.tasks.rotations import SERIES, axis_terms, orientation_terms, pose_terms
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


@dataclass(frozen=True, eq=False)
class PointTask(FrameTask):
    """A point of a link at a point of the world: e = p - p_r (m). Its name is the link's.

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

    def evaluate(self, state: State, target: Any) -> TaskError:
        """Error against a `Reference`, or a `Target` of shape (3,)."""
        self.check(target)
        at = self.motion(state)
        return TaskError(
            at.position - target.y,
            at.velocity[:3] - target.ydot,
            at.jacobian[:3],
            at.drift[:3] - target.yddot,
        )


@dataclass(frozen=True, eq=False)
class OrientationTask(FrameTask):
    """A link's axes along given ones: e = log₃(R R_rᵀ) (rad). Its name is LINK.orientation."""

    size = 3
    units = ("rad",)
    suffix = ".orientation"
    stated = TaskKind.ORIENTATION
    goal = ("a rotation", (3, 3))

    def evaluate(self, state: State, target: Any) -> TaskError:
        """Error against a `Target` of shape (3, 3), a rotation with its ω and ω̇."""
        self.check(target)
        at = self.motion(state)
        found = _empty(3, state)
        orientation_terms(
            at.rotation, at.jacobian[3:], at.velocity[3:], at.drift[3:],
            target.y, target.ydot, target.yddot, SERIES, *found,
        )  # fmt: skip
        return found


@dataclass(frozen=True, eq=False)
class PoseTask(FrameTask):
    """A frame of a link at a given pose: log₆ about the target's origin. Its name is LINK.pose.

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

    def evaluate(self, state: State, target: Any) -> TaskError:
        """Error (6,), translation first, against a `Target` of shape (4, 4)."""
        self.check(target)
        at = self.motion(state)
        found = _empty(6, state)
        pose_terms(
            at.rotation, at.position, at.jacobian, at.velocity, at.drift,
            target.y, target.ydot, target.yddot, SERIES, *found,
        )  # fmt: skip
        return found


@dataclass(frozen=True, eq=False)
class AxisTask(FrameTask):
    """A direction of a link along one of the world, free to turn about it. Its name is LINK.axis.

    The error (rad) is the shortest turn from the target to the direction. Of its three rows two are
    independent.

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

    def evaluate(self, state: State, target: Any) -> TaskError:
        """Error against a `Target` of shape (3,), a unit vector with its two rates."""
        self.check(target)
        at = self.motion(state)
        found = _empty(3, state)
        axis_terms(
            at.rotation @ self.axis, at.jacobian[3:], at.velocity[3:], at.drift[3:],
            target.y, target.ydot, target.yddot, *found,
        )  # fmt: skip
        return found


def _empty(rows: int, state: State) -> TaskError:
    values = np.empty((3, rows))
    return TaskError(values[0], values[1], np.empty((rows, len(state.v))), values[2])


def tasks_of(model: SoftModel) -> list[Task]:
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
