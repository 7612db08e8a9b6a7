"""Errors of an emulation of the reference implementation: one step at a time, at recorded states.

A record holds state and input of the reference implementation at every control step of a run. At
each recorded state, the emulated controller computes its input, and the emulated plant takes one
step under the recorded input. Errors do not accumulate, because every step starts from a recorded
state. So the table shows the errors of the emulation itself.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from softdyn import InputError, SoftModel
from softdyn.controllers.registry import make_controller
from softdyn.validation.loop.labels import experiment_title
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.sources import load_model
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.validation.twin.state_map import StateMap
from tests.proof.paper.reproduction import changed

# A record's robot → the robot in the grid, the changes of its commit, the base's height (m), and
# how the inputs enter its controls: finger's and helix's are spread over joint motors, SpiRob's
# pull down.
ROBOTS: Mapping[str, tuple[str, str, float, list[int], float]] = {
    "finger": ("finger", "reference+jdot", 0.24, [0, 2], 1.0),
    "helix": ("helix", "reference+w2+jdot", 0.7, [0, 1, 2, 12, 13, 14, 24, 25, 26], 1.0),
    "spirob48": ("spirob", "reference+shifted+jdot", 0.5, [0, 1, 2], -1.0),
}
KINDS = {"theta": "set_point", "omega": "tracking"}
SAME_INPUT, SAME_STATE = 1e-6, 1e-9  # of the input's range; rad, rad/s, m, m/s
COLUMNS = (
    ("Robot", "robot", ""), ("Controller", "controller", ""), ("Run", "run", ""),
    ("Experiment", "experiment", ""), ("Steps", "steps", ""), ("Target", "target_m", ".0e"),
    ("u median", "input_median", ".1e"), ("max", "input_max", ".1e"),
    ("at", "input_worst_step", "d"), ("> 1e-6", "input_off", "d"), ("SCS", "solver_max", ".1e"),
    ("v median", "state_median", ".1e"), ("max", "state_max", ".1e"),
    ("at", "state_worst_step", "d"), ("> 1e-9", "state_off", "d"), ("Touching", "touching", "d"),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """A recorded run of the reference implementation.

    Attributes
    ----------
    case : Case
        The cell of the grid to which the run belongs.
    experiment : str
        The names of `reproduction.CHANGES` that its commit contains.
    robot : str
        The bundled robot that has its joints, in its order.
    q, v : np.ndarray, (steps, nv)
        State before each step.
    u : np.ndarray, (steps, nu)
        The input of that step, with our sign.
    targets : np.ndarray, (steps, 3)
        Reference of the tip, relative to our base (m).
    """

    case: Case
    experiment: str
    robot: str
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    targets: np.ndarray


def read_run(path: Path) -> RecordedRun:
    """A record from a file named ROBOT_CONTROLLER_theta… or omega…, in multiples of π.

    Raises
    ------
    InputError
        The name has another form, or the file lacks q, v, ctrl or target.
    """
    robot, controller, case = [*path.stem.split("_"), "", "", ""][:3]
    kind = KINDS.get(case[:5], "")
    try:
        value = float(case[5:])
        name, experiment, base, columns, sign = ROBOTS[robot]
        with np.load(path) as file:
            q, v, ctrl, target = (file[n] for n in ("q", "v", "ctrl", "target"))
        cell = Case(name, controller, kind, value)
        targets = target - np.array([0.0, 0.0, base])
        return RecordedRun(cell, experiment, robot, q, v, sign * ctrl[:, columns], targets)
    except (KeyError, ValueError, IndexError, OSError, zipfile.BadZipFile) as error:
        raise InputError(str(path), "a recorded run ROBOT_CONTROLLER_thetaT.npz", error) from None


def records(folder: Path) -> list[RecordedRun]:
    """All records of a folder.

    Raises
    ------
    InputError
        There are no records, or one cannot be read.
    """
    found = sorted(folder.glob("*.npz"))
    if not found:
        raise InputError(str(folder), "recorded runs, *.npz", "none")
    return [read_run(path) for path in found]


def row(record: RecordedRun, experiment: str, files: Path | None = None) -> dict[str, Any]:
    """One-step differences of a record under an experiment.

    Parameters
    ----------
    record : RecordedRun
    experiment : str
        Names of `reproduction.CHANGES`, joined by ``+``.
    files : Path, optional
        The reference's own files, for ``hulls``.

    Returns
    -------
    dict
        ``input_…`` are differences of the input relative to its range, from the second step on,
        because the first input is zero. ``state_…`` are differences of the next state (rad, rad/s,
        m, m/s). ``…_off`` counts differences above 1e-6 and 1e-9, ``touching`` the steps with
        contacts. With ``scs``, ``solver_max`` is the distance of its answers from the exact ones at
        the same states.
    """
    case = changed(record.case, experiment, files)
    model = load_model(record.robot)
    if len(record.q[0]) != model.nv or not model.u_min.size == record.u.shape[1]:
        raise InputError("record", f"a run of {record.robot}", f"{record.q.shape[1]} joints")
    u, target = inputs(record, case, model)
    found = np.abs((u - record.u) / (model.u_max - model.u_min)).max(axis=1)[1:]
    own = None  # distance of the record's solver from the exact answer
    if "scs" in experiment.split("+"):
        exact = "+".join(name for name in experiment.split("+") if name != "scs")
        exact_u, _ = inputs(record, changed(record.case, exact, files), model)
        own = float(np.abs((u - exact_u) / (model.u_max - model.u_min)).max())
    states, touching = state_differences(record, case, model)
    return {
        "robot": record.robot,
        "controller": record.case.controller,
        "run": experiment_title(record.case.kind, record.case.value),
        "experiment": experiment,
        "steps": len(record.q),
        "target_m": target,
        **_summary("input", found, SAME_INPUT, first=1),
        "solver_max": own,
        **_summary("state", states, SAME_STATE, first=0),
        "touching": touching,
    }


def inputs(record: RecordedRun, case: Case, model: SoftModel) -> tuple[np.ndarray, float]:
    """Inputs of the emulated controller (steps, nu), and the distance of its targets (m)."""
    plan = case.experiment(model)
    law = case.law(case.controller, model) if case.law else make_controller(case.controller, model)
    law = case.around(law) if case.around else law
    answers, far = np.zeros_like(record.u), 0.0
    for k in range(len(answers)):
        at = plan.reference(k * plan.period)
        far = max(far, float(np.abs(at.y - record.targets[k]).max()))
        answers[k] = law(model.state(record.q[k], record.v[k]), at).u
    return answers, far


def state_differences(record: RecordedRun, case: Case, model: SoftModel) -> tuple[np.ndarray, int]:
    """Differences (steps - 1,) of the emulated next state from the recorded; steps with contacts.

    MuJoCo's solver starts from its last solution, as it does in a run.
    """
    grid, errors = case.grid(model), RunOptions.of(case.options).plant or PlantErrors()
    twin = errors.twin(model.robot, timestep=grid.timestep)
    states, data = StateMap(model, twin), twin.data
    found, touching = np.zeros(len(record.q) - 1), 0
    for k in range(len(found)):
        data.qpos[:], data.qvel[:] = states.to_twin(record.q[k], record.v[k])
        data.ctrl[:] = np.clip(record.u[k], model.u_min, model.u_max)
        mujoco.mj_step(twin.model, data, grid.plant_steps(0))
        touching += data.ncon > 0
        q, v = states.from_twin(data.qpos, data.qvel)
        found[k] = max(np.abs(q - record.q[k + 1]).max(), np.abs(v - record.v[k + 1]).max())
    return found, touching


def _summary(name: str, found: np.ndarray, same: float, first: int) -> dict[str, Any]:
    return {
        f"{name}_median": float(np.median(found)),
        f"{name}_max": float(found.max()),
        f"{name}_worst_step": int(found.argmax()) + first,
        f"{name}_off": int((found > same).sum()),
    }
