"""The verdict on one input: refused in one line, accepted and read correctly, or a finding."""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softdyn import SoftdynError, SoftModel, build, parse
from softdyn.description.robot import Robot
from softdyn.exceptions import UrdfError
from softdyn.validation import StateMap, Twin
from softdyn.validation.crosschecks.crosscheck import relative_error
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from tests.proof.fuzzing.second_reading import differences

REFUSED, ACCEPTED = "refused", "accepted"
LOST, EXCEPTION, ENGINES, MESSAGE = "lost content", "exception", "engines differ", "message"
CRASH, HANG = "crash", "hang"  # detected from outside the process
FINDINGS = (CRASH, HANG, LOST, EXCEPTION, ENGINES, MESSAGE)
LONGEST_MESSAGE = 1500
# Engines are compared only where rounding cannot hide a difference, with this tolerance.
LARGEST, SMALLEST, CONDITION, TOLERANCE = 1e3, 1e-9, 1e8, 1e-7
TERMS = ("M", "bias", "K", "D", "B")  # compared terms, besides the tip
LARGEST_TREE = 60  # links; MuJoCo takes seconds to compile the largest ones


class Verdict(NamedTuple):
    """`kind` is one of the constants above; `deep` says whether both engines were compared."""

    kind: str
    detail: str = ""
    deep: bool = False


def judge(data: bytes, path: Path, deep: bool, of: bytes | None = None) -> Verdict:
    """Write an input to `path`, load it as a user would, and look for errors.

    Parameters
    ----------
    data : bytes
        A URDF, or the annotations of the URDF `of`.
    path : Path
        The file to which it is written.
    deep : bool
        Whether an accepted robot is also built in MuJoCo and compared term by term.
    of : bytes, optional
    """
    path.write_bytes(data)
    urdf = path
    if of is not None:
        urdf = path.with_suffix(".base")
        urdf.write_bytes(of)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            warnings.simplefilter("error", RuntimeWarning)
            robot = parse(urdf, annotations=None if of is None else path)
            lost = differences(robot, data) if of is None else differences(robot, of, data)
            return Verdict(LOST, "; ".join(lost)[:1000]) if lost else _judge(robot, deep)
    except SoftdynError as error:
        return _refusal(error, (path, urdf))
    except Exception as error:
        return Verdict(EXCEPTION, f"{type(error).__name__}: {error}"[:500])


def _refusal(error: SoftdynError, paths: tuple[Path, ...]) -> Verdict:
    text = str(error)
    if len(text.splitlines()) != 1 or len(text) > LONGEST_MESSAGE:
        return Verdict(MESSAGE, text[:500])
    if not (isinstance(error, UrdfError) and text.startswith(tuple(map(str, paths)))):
        return Verdict(MESSAGE, f"names no file: {text[:500]}")
    return Verdict(REFUSED, template(error))


def template(error: UrdfError) -> str:
    """The text of a refusal without its variable parts: the tags, and the expected value."""
    tags = "".join(re.findall(r"<[\w{}:.-]*", error.element)) or error.element
    return re.sub(r"'[^']*'|\d+", "…", f"{tags} expected {error.expected}")[:150]


def _judge(robot: Robot, deep: bool) -> Verdict:
    model = build(robot)
    state = model.state(model.q0, np.zeros(model.nv))
    terms = {name: getattr(state, name) for name in ("M", "h", "B", "J", "D", "y")}
    broken = [name for name, value in terms.items() if not np.isfinite(value).all()]
    if broken:
        return Verdict(EXCEPTION, f"{', '.join(broken)} not finite at rest")
    if not deep or len(robot.links) > LARGEST_TREE:
        return Verdict(ACCEPTED)
    differs = compare_engines(model)
    return Verdict(ENGINES, differs, True) if differs else Verdict(ACCEPTED, "", True)


def compare_engines(model: SoftModel) -> str:
    """Terms of the dynamics in which MuJoCo differs, at one random state; "" if none."""
    rng = np.random.default_rng(0)
    twin = Twin(model, limits=False)
    other = MujocoTerms(twin, StateMap(model, twin))
    low, high = np.clip(model.lower, -1, 1), np.clip(model.upper, -1, 1)
    q = model.configuration(rng.uniform(low, high))
    state = model.state(q, rng.uniform(-1, 1, model.nv))
    if not _comparable(model, state.M):
        return ""
    other.set_state(state.q, state.v)
    pairs = {name: (getattr(state, name), getattr(other, name)()) for name in TERMS}
    pairs["tip"] = state.y, other.tip()
    scales = {"tip": model.robot.length, "bias": float(np.abs(state.M).max())}
    errors = {name: relative_error(*pair, max(scales.get(name, 0.0), 1e-9))
              for name, pair in pairs.items()}  # fmt: skip
    return ", ".join(f"{k} by {error:.1e}" for k, error in errors.items() if not error <= TOLERANCE)


def _comparable(model: SoftModel, M: np.ndarray) -> bool:
    """Whether the robot's numbers are moderate enough for a precise comparison."""
    robot = model.robot
    sizes = [*(abs(x) for j in robot.joints for x in (*j.origin.xyz, j.stiffness, j.damping))]
    sizes += [abs(x) for link in robot.links for x in (link.inertia.mass, *link.inertia.com)]
    sizes += [abs(x) for t in robot.tendons for s in t.sites for x in s.xyz]
    sizes += [x for t in robot.tendons for x in (t.stiffness, t.damping)]
    masses = [link.inertia.mass for link in robot.links if link.inertia.mass > 0]
    if max(sizes, default=0.0) >= LARGEST or min(masses, default=1.0) <= SMALLEST:
        return False  # rounding may make the diagonal of M negative
    scale = np.sqrt(np.diag(M))
    condition = float(np.linalg.cond(M / np.outer(scale, scale)))
    return math.isfinite(condition) and condition < CONDITION
