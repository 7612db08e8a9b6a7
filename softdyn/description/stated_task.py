"""Tasks as a robot's file states them: ``<task>``, once for the tip or several times."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum

from softdyn.checks import did_you_mean
from softdyn.description.inertia import ZERO, Vector
from softdyn.description.strict_xml import Element

ROWS = ("x", "y", "z", "rx", "ry", "rz")
HIGHEST_LEVEL = 99


class TaskKind(Enum):
    """The quantity of a link's frame that a task controls."""

    POSITION = "position"
    ORIENTATION = "orientation"
    POSE = "pose"
    AXIS = "axis"

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows of its error, in the world's axes."""
        return {TaskKind.POSITION: ROWS[:3], TaskKind.POSE: ROWS}.get(self, ROWS[3:])


@dataclass(frozen=True)
class StatedTask:
    """A task of a link's frame; see `softdyn.tasks.make_tasks`.

    Attributes
    ----------
    frame : str
        The link.
    name : str
        Unique.
    kind : TaskKind
        The quantity.
    axes : tuple of str
        The rows of the error that count; all if empty.
    direction : tuple of float
        For the kind ``axis`` the direction in the link's frame.
    weight : float
        Weight of the squared error.
    Kp : float or None
        Own stiffness (1/s²).
    level : int
        Level of priority; 0 is the highest.
    """

    frame: str
    name: str
    kind: TaskKind = TaskKind.POSITION
    axes: tuple[str, ...] = ()
    direction: Vector = ZERO
    weight: float = 1.0
    Kp: float | None = None
    level: int = 0


def read_tasks(block: Element, links: Collection[str], expected: str) -> tuple[StatedTask, ...]:
    """The tasks of the block; `expected` is the message for a frame that is no link.

    Raises
    ------
    UrdfError
        For every misuse.
    """
    found: dict[str, StatedTask] = {}
    for element in block.children("task"):
        task = _task(element, links, expected)
        if task.name in found:
            raise element.error("a unique task name", f"a second {task.name!r}")
        found[task.name] = task
    return tuple(found.values())


def _task(element: Element, links: Collection[str], expected: str) -> StatedTask:
    element.allow("frame", "name", "kind", "axes", "direction", "weight", "Kp", "level")
    frame, given = element.one_of("frame", links, expected), element.node.get
    words = [kind.value for kind in TaskKind]
    kind = TaskKind(element.choice("kind", words, TaskKind.POSITION.value))
    usual = frame if kind is TaskKind.POSITION else f"{frame}.{kind.value}"
    axes = () if given("axes") is None else tuple(element.text("axes").split())
    for axis in axes:
        if axis not in kind.rows or axes.count(axis) > 1:
            wanted = f"axes of {', '.join(kind.rows)}, each once"
            raise element.error(wanted, did_you_mean(axis, kind.rows))
    if (kind is TaskKind.AXIS) != (given("direction") is not None):
        raise element.error('direction="…" of kind="axis" only', f'kind="{kind.value}"')
    direction = element.vector("direction", ZERO)
    if kind is TaskKind.AXIS and not any(direction):
        raise element.error("a direction that is not zero", given("direction"))
    weight, level = element.number("weight", 1.0), element.number("level", 0.0)
    Kp = None if given("Kp") is None else element.number("Kp")
    for name, value in (("weight", weight), ("Kp", 1.0 if Kp is None else Kp)):
        if value <= 0:
            raise element.error(f"{name} > 0", value)
    if level not in range(HIGHEST_LEVEL + 1):
        raise element.error(f"a whole level from 0 to {HIGHEST_LEVEL}", given("level"))
    name = usual if given("name") is None else element.text("name")
    return StatedTask(frame, name, kind, axes, direction, weight, Kp, int(level))


def only_the_tip(tasks: tuple[StatedTask, ...]) -> bool:
    """Whether these say no more than a single ``<task frame="…"/>``."""
    return all(task == StatedTask(task.frame, task.frame) for task in tasks) and len(tasks) < 2
