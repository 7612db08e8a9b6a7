"""A page of two files of one robot: both in one scene, differences in colour, the worst states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from softdyn.description.visuals import Rgba
from softdyn.validation.mjcf.comparison.matching import plain_name
from softdyn.validation.mjcf.comparison.neutral import WORLD, Neutral, NeutralTendon
from softdyn.validation.mjcf.comparison.result import Cause, Comparison, Worst
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.report.drawing import ModelDrawing, RobotDrawing, drawing_of
from softdyn.view.page import Page, PlayedRun, Track

PLAIN = (0.72, 0.74, 0.77, 1.0)
DIFFERS = (0.84, 0.37, 0.0, 1.0)  # Okabe and Ito's vermillion
VALUES = (0.94, 0.89, 0.26, 1.0)
ALONE = (0.49, 0.31, 0.66, 1.0)
GREY = "#b8bdc4"
LEGEND = "orange: changes M, gravity or a tip; yellow: another value; violet: no partner"
GAP = 1.3  # between robots side by side, in sizes of the larger one
MOVE, HOLD, RATE = 0.8, 1.6, 25  # s, s, frames a second
MOST = 4  # states shown
ROWS = 12  # causes listed


def pair_page(one: Side, other: Side, found: Comparison) -> Page:
    """The page of a comparison.

    Parameters
    ----------
    one, other : Side
        The files. A URDF gets a floating base if the other file's robot has one.
    found : Comparison
        Their differences.
    """
    sides = one.beside(other), other.beside(one)
    a, names = sides[0].neutral, found.matched
    numbers = [{part.name: k for k, part in enumerate(side.neutral.parts)} for side in sides]
    task = next((side.robot.task for side in sides if not side.is_mjcf), "")
    plain = [drawing_of(side, task) for side in sides]
    colours: tuple[dict[int, Rgba], dict[int, Rgba]] = ({}, {})
    cables: tuple[dict[str, Rgba], dict[str, Rgba]] = ({}, {})
    # the largest effect comes last, so that its colour remains
    for cause in reversed(found.causes):
        if cause.one_sided:
            continue
        colour = DIFFERS if cause.weight else VALUES
        for k in _parts(a, cause):
            there = WORLD if k == WORLD else numbers[1].get(names.get(a.parts[k].name, ""))
            colours[0][k] = colour
            if there is not None:
                colours[1][there] = colour
        tendons = _tendons([drawing.robot for drawing in plain], names, cause)
        for drawing, parts, ropes, own in zip(plain, colours, cables, tendons, strict=True):
            for tendon in own:
                if tendon.name in drawing.drawn:
                    ropes[tendon.name] = colour
                else:  # a sum of joints without a path
                    joints = (part.name for part in drawing.robot.parts)
                    parts |= {k: colour for k, name in enumerate(joints) if name in tendon.terms}
    for place, key in enumerate(("a", "b")):
        colours[place].update({numbers[place][joint]: ALONE for joint in found.unmatched[key]})
    drawings = [
        drawing.painted(paint, PLAIN, ropes)
        for drawing, paint, ropes in zip(plain, colours, cables, strict=True)
    ]
    states = _states(found.worst)
    times = [k * (MOVE + HOLD) - (MOVE if k else 0.0) for k in range(len(states))]
    motion = []
    for drawing, key in zip(drawings, ("a", "b"), strict=True):
        called = {name: names[name] if key == "b" else name for name in names}
        poses = [
            drawing.coordinates({called[name]: q.get(name, [0.0]) for name in names})
            for _, q in states
        ]
        motion.append(_frames(np.array(poses)))
    marks = tuple((t, text) for t, (text, _) in zip(times, states, strict=True))
    apart = GAP * max(drawing.size for drawing in drawings)
    runs = []
    for title, offset, opacity in (("side by side", apart, 1.0), ("in one place", 0.0, 0.45)):
        tracks = tuple(_tracks(found, drawings, motion, offset, opacity))
        runs.append(PlayedRun(title, tracks, loop=True, notes=marks))
    return Page(
        f"{drawings[0].name} and {drawings[1].name}", drawings, tuple(runs), rows=_rows(found)
    )


def _tracks(
    found: Comparison, drawings: Sequence[ModelDrawing | RobotDrawing], motion: list[np.ndarray],
    offset: float, opacity: float,
) -> Iterator[Track]:  # fmt: skip
    for k, (key, drawing) in enumerate(zip(("a", "b"), drawings, strict=True)):
        yield Track(
            k, motion[k], f"{key.upper()}: {drawing.robot.path.name}", note=drawing.problem,
            colour=GREY, opacity=opacity if k else 1.0, offset=(k * offset, 0.0, 0.0),
            aims=False,
        )  # fmt: skip


def _parts(robot: Neutral, cause: Cause) -> Iterator[int]:
    """The parts that a cause concerns: of a joint, link or frame, or of an actuator on a joint."""
    on = {f"joint:{part.name}": part.name for part in robot.parts}
    called = {motor.name: on.get(motor.target, "") for motor in robot.motors}
    where = called.get(cause.where, "") if cause.kind == "actuator" else cause.where
    # a coupling names two joints, a feature its field and the joint
    names = {where, *where.split(" and "), where.rpartition(" of ")[2]}
    for k, part in enumerate(robot.parts):
        if names & {part.name, part.link, *(name for name, _ in part.pieces)}:
            yield k
            if cause.kind != "coupling":
                return
    if where in robot.frames:
        yield robot.frames[where].part


def _tendons(
    robots: Sequence[Neutral], joints: Mapping[str, str], cause: Cause
) -> list[list[NeutralTendon]]:
    """The tendons of each robot that a cause concerns, by their names or sums of joints.

    `joints` maps the joints of the first robot to those of the second one.
    """
    if cause.kind not in ("tendon", "actuator", "armature", "friction"):
        return [[] for _ in robots]
    names = {plain_name(cause.where)}
    if cause.kind == "actuator":
        names = {
            plain_name(motor.target.removeprefix("tendon:"))
            for robot in robots
            for motor in robot.motors
            if plain_name(motor.name) in names and motor.target.startswith("tendon:")
        }
    found = [[cable for cable in robot.cables if plain_name(cable.name) in names]
             for robot in robots]  # fmt: skip
    sums = [{joints.get(name, name): c for name, c in cable.terms.items()} for cable in found[0]]
    if not found[1]:
        found[1] = [cable for cable in robots[1].cables if cable.terms and cable.terms in sums]
    return found


def _states(worst: tuple[Worst, ...]) -> list[tuple[str, dict[str, list[float]]]]:
    """Zero, then the states at which the files differ most, each with its worst quantity."""
    found: list[tuple[str, dict[str, list[float]]]] = [("zero", {})]
    for state in worst:
        words = f"{state.quantity} {100 * state.error:.3g} % apart"
        for k, (text, q) in enumerate(found):
            if q == state.q:
                found[k] = (f"{text}, {words}", q)
                break
        else:
            found.append((words, state.q))
    return found[: MOST + 1]


def _frames(poses: np.ndarray) -> np.ndarray:
    """Frames that move from pose to pose (states, freedoms), with a pause at each."""
    rows, t = [], 0.0
    steps = round(MOVE * RATE)
    for k, pose in enumerate(poses):
        before = poses[k - 1] if k else pose
        for part in (1 - np.cos(np.linspace(0, np.pi, steps + 1)[1:])) / 2 if k else ():
            t += 1 / RATE
            rows.append([t, *(before + part * (pose - before)), *[0.0] * 6])
        if not k:
            rows.append([t, *pose, *[0.0] * 6])
        if len(poses) > 1:
            t += HOLD
            rows.append([t, *pose, *[0.0] * 6])
    return np.array(rows, np.float32)


def _rows(found: Comparison) -> tuple[tuple[str, ...], ...]:
    """Rows of the largest causes, with the verdict as their title."""
    causes = [cause for cause in found.causes if not cause.one_sided]
    rows = [(cause.kind, f"{cause.where} {cause.detail}".strip()) for cause in causes[:ROWS]]
    if len(causes) > ROWS:
        rows.append(("…", f"{len(causes) - ROWS} more"))
    if rows or any(found.unmatched.values()):
        rows.append(("", LEGEND))
    return ((found.verdict,), *(rows or [("no cause", "changes the motion")]))
