"""Planted defects: `compare` must name each, with its size, and nothing else."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from lxml import etree

import softdyn
from softdyn.commands import cli
from softdyn.description.urdf import parse
from softdyn.validation.mjcf.comparison.comparison import compare
from softdyn.validation.mjcf.comparison.result import Cause
from softdyn.validation.mjcf.comparison.side import neutral
from softdyn.validation.mjcf.to_mjcf import to_mjcf
from tests.support import defects
from tests.support.random_robots import random_urdf
from tests.support.turned_frames import other_hand

EPILOG = """\
Random robots are written as a URDF, as an MJCF, and as a second URDF with turned link frames. One
to three defects are planted in one of these files, of sizes from 10 µm, 10 µrad or 1e-5 to 1 cm,
0.3 rad or 0.3. The verdict on its comparison with another file is

  named        its causes are the planted ones
  equivalent   it has no more causes than were planted, and no residual
  missed       it does not name a planted defect that alone changes an engine's q̈ by more than 1e-6;
               one cause may name both of two displacements
  false        anything else

exit codes: 0 nothing missed, nothing false; 1 otherwise; 2 bad input.
"""

LENGTH, ANGLE, SHARE, FORCE = (1e-5, 1e-2), (1e-5, 0.3), (1e-5, 0.3), (1e-4, 1.0)
SIZES = {
    "mass": SHARE, "centre": LENGTH, "inertia": ANGLE, "axis": (1, 1), "tilt": ANGLE, "zero": ANGLE,
    "pose": LENGTH, "turn": ANGLE, "displaced": LENGTH, "armature": FORCE, "friction": FORCE,
    "damping": FORCE, "base": ANGLE, "tendon": LENGTH, "actuator": (1, 1),
}  # fmt: skip
CAUSES = {"tilt": "axis", "displaced": "axis", "turn": "pose"}  # other kinds keep their names
PLACES = ("zero", "pose", "turn", "displaced", "tilt", "base", "tendon")
BODILY = ("mass", "centre", "inertia")
ROBOTIC = ("base", "tendon", "actuator")
NOTICED = 1e-6
MEASURED: dict[str, Callable[[Any, Any], float]] = {
    "mass": lambda a, b: max(a, b) / min(a, b) - 1,
    "centre": lambda a, b: float(np.linalg.norm(np.subtract(a, b))),
    "zero": lambda _, b: abs(b),
    "armature": lambda a, b: abs(a - b),
    "friction": lambda a, b: abs(a - b),
    "damping": lambda a, b: abs(a - b),
}  # the planted size, from the values of two files


@dataclass(frozen=True)
class Plant:
    """A planted defect: its kind, the number and name of its joint or body, and its size."""

    kind: str
    k: int
    where: str
    size: float

    def __str__(self) -> str:
        return f"{self.kind} {self.where} {self.size:.3g}"


@dataclass(frozen=True)
class Trial:
    """One comparison with planted defects, and its verdict."""

    name: str
    plants: tuple[Plant, ...]
    change: float
    causes: tuple[Cause, ...]
    called: str

    def __str__(self) -> str:
        found = "; ".join(f"{c.kind} {c.where} {c.detail or (c.a, c.b)}" for c in self.causes)
        plants = "; ".join(map(str, self.plants))
        return f"{self.called}: {self.name}: {plants} (q̈ {self.change:.1e}) -> {found or 'nothing'}"


@dataclass(frozen=True)
class Robot:
    """One robot, written to a folder as three different files."""

    seed: int
    texts: dict[str, str] = field(repr=False)
    folder: Path

    def path(self, hand: str) -> Path:
        """Path of one of the three files."""
        return self.folder / f"{hand}{'.xml' if hand == 'mjcf' else '.urdf'}"


def robots(count: int, seed: int, folder: Path) -> list[Robot]:
    """The first random robots with at least two joints."""
    found: list[Robot] = []
    while len(found) < count:
        text = random_urdf(seed)
        if len(defects.joints(etree.fromstring(text.encode()))) > 1:
            place = folder / str(seed)
            place.mkdir()
            found.append(Robot(seed, {"urdf": text, "other": other_hand(text, seed)}, place))
            robot = found[-1]
            robot.path("urdf").write_text(text)
            robot.path("other").write_text(robot.texts["other"])
            robot.texts["mjcf"] = to_mjcf(parse(robot.path("urdf")), shapes=False)
            robot.path("mjcf").write_text(robot.texts["mjcf"])
        seed += 1
    return found


def trial(robot: Robot, rng: np.random.Generator) -> Trial | None:
    """A comparison with one to three defects; None if they cannot be planted."""
    hands = sorted(robot.texts)
    wrong, good = rng.choice(hands), rng.choice(hands)
    table = defects.MJCF if wrong == "mjcf" else defects.URDF
    root = etree.fromstring(robot.texts[wrong].encode())
    movers = (defects.bodies if wrong == "mjcf" else defects.joints)(root)
    count = min(int(rng.choice([1, 1, 2, 3])), len(movers))
    plants = []
    for k in rng.choice(len(movers), count):
        kind = str(rng.choice([kind for kind in table if kind in SIZES]))
        low, high = np.log(SIZES[kind])
        held = movers[k].findall("joint") if wrong == "mjcf" else [movers[k]]
        name = held[-1 if kind in BODILY else 0].get("name")
        plants.append(Plant(kind, int(k), name, float(np.exp(rng.uniform(low, high)))))
    places = [(plant.kind, "" if plant.kind in ROBOTIC else plant.where) for plant in plants]
    if len(set(places)) < len(places):
        return None
    path = robot.folder / f"wrong_{robot.path(wrong).name}"
    if not _plant(robot, wrong, plants, path):
        return None
    change = _change(robot.path(wrong), path)
    files = [robot.path(good), path]
    if rng.random() < 0.5:
        files.reverse()
    result = compare(*files)
    known = _known(*(robot.path(wrong) if file == path else file for file in files))
    causes = tuple(c for c in result.causes if (c.kind, c.where) not in known)
    if wrong != "mjcf" and any(plant.kind in PLACES for plant in plants):
        # a URDF that states no rest means the length at zero, which goes along
        causes = tuple(c for c in causes if (c.kind, c.detail) != ("tendon", "rest length"))
    name = f"robot {robot.seed}, {files[0].name} {files[1].name}"
    called = _called(causes, plants, files) if result.explained else "false"
    if called == "named":
        for plant in _unnamed(causes, plants, files):
            _plant(robot, wrong, [plant], path)
            if _change(robot.path(wrong), path) > NOTICED:
                called = "missed"
    return Trial(name, tuple(plants), change, causes, called)


def _plant(robot: Robot, hand: str, plants: list[Plant], path: Path) -> bool:
    """Write one file of a robot with defects; False if the robot has no place for them.

    A turned rod may have a moment below zero by rounding, which MuJoCo refuses.
    """
    root = etree.fromstring(robot.texts[hand].encode())
    table = defects.MJCF if hand == "mjcf" else defects.URDF
    try:
        for plant in plants:
            table[plant.kind](root, plant.k, plant.size)
    except (AttributeError, IndexError, TypeError):  # the robot has no such element
        return False
    path.write_bytes(etree.tostring(root))
    try:
        return hand != "mjcf" or bool(mujoco.MjSpec.from_file(str(path)).compile())
    except ValueError:
        return False


@cache
def _known(one: Path, other: Path) -> set[tuple[str, str]]:
    """Kind and place of the causes between two files without a defect."""
    return {(cause.kind, cause.where) for cause in compare(one, other).causes}


def _called(causes: tuple[Cause, ...], plants: list[Plant], files: list[Path]) -> str:
    parts = _parts(files[0])
    found = Counter((c.kind, parts.get(c.where, "")) for c in causes)
    asked = Counter(map(_place, plants))
    if found <= asked:
        sizes = {(p.kind, p.where): p.size for p in plants}
        for cause in causes:
            size = sizes.get((cause.kind, parts.get(cause.where, "")))
            measured = MEASURED.get(cause.kind)
            if size and measured and abs(measured(cause.a, cause.b) / size - 1) > 1e-3:
                return "equivalent"
        return "named"
    return "equivalent" if found.total() <= asked.total() else "false"


def _unnamed(causes: tuple[Cause, ...], plants: list[Plant], files: list[Path]) -> list[Plant]:
    """The defects of which no cause speaks; a displacement may be part of another's cause."""
    parts = _parts(files[0])
    found = {(c.kind, parts.get(c.where, "")) for c in causes}
    moved = any(kind in PLACES for kind, _ in found)
    unnamed = [plant for plant in plants if _place(plant) not in found]
    return [plant for plant in unnamed if not (moved and plant.kind in PLACES)]


def _place(plant: Plant) -> tuple[str, str]:
    """The kind of cause for a defect, and its joint."""
    return CAUSES.get(plant.kind, plant.kind), "" if plant.kind in ROBOTIC else plant.where


def _parts(path: Path) -> dict[str, str]:
    """The joint by a joint's name or by the name of the link that it moves."""
    found: dict[str, str] = {}
    for part in neutral(path).parts:
        names = [part.name, part.link, *(name for name, _ in part.pieces)]
        found |= dict.fromkeys(names, part.name)
    return found


def _change(good: Path, wrong: Path) -> float:
    """The largest relative change of q̈, by MuJoCo for an MJCF and by Pinocchio for a URDF."""
    first, second = (_accelerations(path) for path in (good, wrong))
    size = np.abs(first).max(axis=1, initial=1e-12)
    return float((np.abs(first - second).max(axis=1, initial=0.0) / size).max())


def _accelerations(path: Path, samples: int = 4) -> np.ndarray:
    rng = np.random.default_rng(0)
    if path.suffix == ".urdf":
        model = softdyn.load(path)
        found = []
        for _ in range(samples):
            q = model.configuration(rng.uniform(-1, 1, model.nv))
            state = model.state(q, rng.uniform(-1, 1, model.nv))
            found.append(np.linalg.solve(state.M, state.B @ np.ones(model.nu) - state.h))
        return np.array(found)
    spec = mujoco.MjModel.from_xml_path(str(path))
    off = mujoco.mjtDisableBit
    spec.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
    data, found = mujoco.MjData(spec), []
    for _ in range(samples):
        data.qpos[:], data.qvel[:] = rng.uniform(-1, 1, spec.nq), rng.uniform(-1, 1, spec.nv)
        data.ctrl[:] = 1.0
        mujoco.mj_forward(spec, data)
        found.append(data.qacc.copy())
    return np.array(found)


def campaign(count: int, kinds: int, seed: int, folder: Path) -> list[Trial]:
    """Run `count` trials on some robots."""
    rng = np.random.default_rng(seed)
    some = robots(kinds, seed, folder)
    found: list[Trial] = []
    while len(found) < count:
        made = trial(some[len(found) % kinds], rng)
        if made is not None:
            found.append(made)
    return found


parser = cli.Parser(__doc__, EPILOG)
parser.option("--count", cli.count, "N", "comparisons", 500)
parser.option("--robots", cli.count, "N", "random robots", 14)
parser.add_argument("--seed", type=int, default=0, metavar="S", help="(default: 0)")


def command(arguments: cli.Arguments) -> int:
    """Print the trials that are not named, and the counts."""
    with tempfile.TemporaryDirectory() as folder:
        found = campaign(arguments.count, arguments.robots, arguments.seed, Path(folder))
    for one in found:
        if one.called != "named":
            print(one)
    total = Counter(one.called for one in found)
    print(", ".join(f"{total[word]} {word}" for word in ("named", "equivalent", "missed", "false")))
    return cli.FAILED if total["missed"] or total["false"] else cli.PASSED


main = cli.program(parser, command, __name__)
