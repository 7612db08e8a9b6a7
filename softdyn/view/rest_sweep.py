"""The robot's response, from its equilibrium, to one input after the other."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from tqdm.auto import tqdm

from softdyn.description.robot import sliding
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.derivatives import stiffness as tangent_stiffness
from softdyn.dynamics.implicit_step import ImplicitStep
from softdyn.dynamics.model import SoftModel
from softdyn.view.page import Page, PlayedRun, Track, frames
from softdyn.view.scene import Figure

Item = TypeVar("Item")
STEP = 0.005  # s
SETTLE = 8.0  # s, the longest wait until the robot rests
RAMP, HOLD = 0.9, 0.5  # s
TRAVEL = 0.25  # the tip's travel over the robot's length
BEND = 0.5  # rad, the largest turn of a joint


@dataclass(frozen=True, eq=False)
class RestSweep:
    """`t` (N,), `q` (N, nq), `u` (N, nu), `y` (N, 3), and notes (time (s), text)."""

    t: np.ndarray
    q: np.ndarray
    u: np.ndarray
    y: np.ndarray
    notes: tuple[tuple[float, str], ...]


def rest_page(model: SoftModel) -> Page:
    """A page with the robot at rest and its response to one input after the other.

    A shape that cannot be shown gives a warning.
    """
    figure = Figure.with_stated_tasks(model)
    for problem in figure.problems:
        warnings.warn(problem, stacklevel=2)
    sweep = rest_sweep(model)
    moved = bool(sweep.u.any())
    track = Track(
        0,
        frames(
            model,
            sweep.t,
            sweep.q,
            sweep.u,
            sweep.y,
            sweep.y,
            np.full((len(sweep.t), figure.numbers), np.nan),
        ),
        f"one {'input' if moved else 'joint'} after the other",
        aims=False,
        full=np.abs(sweep.u).max(axis=0) if moved else None,
    )
    run = PlayedRun("", (track,), loop=True, notes=sweep.notes)
    return Page(model.bundled or model.name, (figure,), (run,))


def rest_sweep(model: SoftModel) -> RestSweep:
    """Let the robot come to rest without input, then raise and lower each input in turn.

    A robot with inputs follows its analytic dynamics. It stands where a step has no solution. The
    stiffness at rest gives the amplitudes, within the bounds: the tip moves about `TRAVEL` of the
    robot's length, and no joint turns by more than about `BEND`. A robot without inputs, or with a
    floating base, stays at q = 0 and each joint moves in turn.
    """
    if not model.nu or model.robot.floating:
        return _joints(model)
    stepper = ImplicitStep(model, ForceBalance(model, motors=()))
    zero, still, held = np.zeros(model.nu), np.zeros(model.nv), None

    def after(
        q: np.ndarray, v: np.ndarray, u: np.ndarray, held: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        found = stepper(q, v, u, np.zeros(0), STEP, held)
        return (q, still, held) if found is None else (found.q, found.v, found.held)

    q, v = model.q0, still
    for _ in _shown(range(round(SETTLE / STEP)), "the robot settles"):
        q, v, held = after(q, v, zero, held)
        if float(np.abs(v).max()) < 1e-3:
            break
    peaks = _peaks(model, q)
    rows = []
    notes: list[tuple[float, str]] = [(0.0, "rest")]
    shape = np.concatenate((_ramp(RAMP), np.ones(round(HOLD / STEP)), _ramp(RAMP)[::-1],
                            np.zeros(round(HOLD / STEP))))  # fmt: skip
    t = 0.0
    rows.append((t, q, zero, model.state(q, v).y))
    for i, actuator in enumerate(_shown(model.robot.actuators, "each input is pulled")):
        for peak in peaks[i][peaks[i] != 0]:
            kilo = f"{1e-3 * peak:.3g} kPa" if actuator.is_chamber else f"{peak:.3g}"
            notes.append((t, f"{actuator.name} = {kilo}"))
            for part in shape:
                u = zero.copy()
                u[i] = part * peak
                q, v, held = after(q, v, u, held)
                t += STEP
                rows.append((t, q, u, model.state(q, v).y))
    return _sweep(rows[::6], notes)  # 33 frames a second


def _shown(items: Sequence[Item], what: str) -> Iterable[Item]:
    """The items, with a line on a terminal that says what is computed, and how far it is."""
    found: Iterable[Item] = tqdm(items, desc=what, disable=None, leave=False)
    return found


def _peaks(model: SoftModel, q: np.ndarray) -> np.ndarray:
    """Highest and lowest value (nu, 2) of each input, from the linear response at rest."""
    state = model.state(q, np.zeros(model.nv))
    stiffness = tangent_stiffness(model, q, np.zeros(model.nu))
    # a small extra stiffness keeps the response finite if no force holds a joint
    soft = 1e-6 * float(np.abs(np.diag(stiffness)).max()) or 1.0
    response = np.linalg.lstsq(stiffness + soft * np.eye(model.nv), state.B, rcond=None)[0]
    size = TRAVEL * max(model.robot.length, 1e-3)
    travel = np.linalg.norm(state.J @ response, axis=0) / size
    turn = np.abs(response[_turning(model)]).max(axis=0, initial=0.0) / BEND
    enough = 1 / np.maximum(np.maximum(travel, turn), 1e-12)
    highest, lowest = np.clip(model.u_max, 0, enough), np.clip(model.u_min, -enough, 0)
    return np.stack((highest, lowest), axis=1)


def _turning(model: SoftModel) -> np.ndarray:
    """Whether each coordinate is an angle, (nv,) bool."""
    return ~np.array(sliding(model.robot, model.joint_names))


def _joints(model: SoftModel) -> RestSweep:
    """Move each joint of a robot without inputs out and back."""
    lower, upper = (np.clip(b, -1e3, 1e3) for b in (model.lower, model.upper))
    rest = np.clip(model.coordinates(model.q0), lower, upper)
    kinds = {joint.name: joint.kind for joint in model.robot.joints}
    reach = np.where(_turning(model), BEND, 0.1 * max(model.robot.length, 1e-3))
    rows, notes, t = [], [], 0.0
    shape = np.concatenate((_ramp(RAMP / 2), _ramp(RAMP / 2)[::-1]))[::6]
    for j, name in enumerate(model.joint_names):
        if name not in kinds:  # a coordinate of a floating base
            continue
        notes.append((t, name))
        up, down = upper[j] - rest[j], rest[j] - lower[j]
        size = min(reach[j], up) if up >= min(down, reach[j]) else -min(reach[j], down)
        for part in shape:
            x = rest.copy()
            x[j] += part * size
            q = model.configuration(x)
            rows.append((t, q, np.zeros(model.nu), model.state(q, np.zeros(model.nv)).y))
            t += 6 * STEP
    return _sweep(rows, notes)


def _ramp(seconds: float) -> np.ndarray:
    """A smooth rise from 0 to 1."""
    return (1 - np.cos(np.linspace(0, np.pi, round(seconds / STEP)))) / 2


def _sweep(rows: list, notes: list[tuple[float, str]]) -> RestSweep:
    t, q, u, y = (np.array(column) for column in zip(*rows, strict=True))
    return RestSweep(t, q, u, y, tuple(notes))
