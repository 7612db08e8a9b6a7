"""Recorded closed-loop states on which steps are timed, kept in a file for later measurements."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel
from softdyn.arrays import read_npz
from softdyn.tasks import LinkKinematics, PointTask, StackedReference
from softdyn.validation.files import atomic, safe_filename
from softdyn.validation.loop import setups
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.simulate import simulate
from softdyn.validation.studies import experiments
from softdyn.validation.studies.study_targets import study_experiments

ROBOTS = ("finger", "helix", "spirob", "spirob48")
DRIVER = "soft-id-clf-qp"  # drives the loops from which states are recorded
DURATION = 3.0  # s, duration of every loop, transient included
TRANSIENT = 0.5  # s; half of a loop's states are taken from it
OMEGA = 0.5  # rate of the trajectory, in multiples of π rad/s


@dataclass(frozen=True, eq=False)
class RecordedStates:
    """States of closed loops and the references they followed.

    Attributes
    ----------
    q : array, (states, nq)
    v : array, (states, nv)
    y, ydot, yddot : array, (states, 3)
        The references.
    t : array, (states,)
        Time of each state in its loop (s).
    loop : array of str, (states,)
        The loop of each state: ``set_point THETA`` or ``tracking OMEGA``, or only the kind.
    digest : str
        SHA-256 of the robot's file.
    """

    q: np.ndarray
    v: np.ndarray
    y: np.ndarray
    ydot: np.ndarray
    yddot: np.ndarray
    t: np.ndarray
    loop: np.ndarray
    digest: str

    def __len__(self) -> int:
        return len(self.t)

    def steps(self) -> list[tuple[np.ndarray, np.ndarray, Reference]]:
        """(q, v, reference) of every state."""
        references = [Reference(*row) for row in zip(self.y, self.ydot, self.yddot, strict=True)]
        return list(zip(self.q, self.v, references, strict=True))

    def task_steps(
        self, model: SoftModel, tasks: Sequence[PointTask]
    ) -> list[tuple[np.ndarray, np.ndarray, Reference]]:
        """(q, v, references of points) of every state.

        The first point has the state's own reference. Each other one has its place at the last
        state of the same loop.
        """
        kinematics = LinkKinematics.of(model)
        places: dict[str, dict[str, SetPoint]] = {}
        for k in np.argsort(self.t):  # the last state of a loop stays
            end = model.state(self.q[k], self.v[k])
            places[self.loop[k]] = {
                task.name: SetPoint(kinematics(end, task.link, task.point).position)
                for task in tasks[1:]
            }
        return [
            (q, v, StackedReference({tasks[0].name: reference} | places[loop]))
            for (q, v, reference), loop in zip(self.steps(), self.loop, strict=True)
        ]

    def save(self, path: Path) -> None:
        """Write an NPZ file, complete or not at all."""
        with atomic(path) as file:
            np.savez_compressed(
                file, **{field.name: getattr(self, field.name) for field in fields(self)}
            )

    @classmethod
    def load(cls, path: Path) -> RecordedStates:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            The file is missing or has other content.
        """
        found: dict[str, Any] = {**read_npz(path, "recorded states")}
        kinds = {field.name: "f" for field in fields(cls)} | {"loop": "U", "digest": "U"}
        if {name: array.dtype.kind for name, array in found.items()} != kinds:
            raise InputError(str(path), "recorded states", "other arrays")
        count = found["t"].size
        shapes = {"t": (count,), "loop": (count,), "digest": ()}
        shapes |= dict.fromkeys(("y", "ydot", "yddot"), (count, 3))
        shapes |= {name: (count, found[name].shape[-1]) for name in ("q", "v") if found[name].ndim}
        for name, array in found.items():
            if array.shape != shapes.get(name):
                raise InputError(str(path), f"{name} of {count} states", f"shape {array.shape}")
            if kinds[name] == "f" and not np.isfinite(array).all():
                raise InputError(str(path), f"finite numbers in {name}", "others")
        return cls(**found | {"digest": str(found["digest"])})


def record(
    model: SoftModel,
    make: Callable[[SoftModel], Any],
    count: int,
    runs: Sequence[Experiment] | None = None,
    duration: float = DURATION,
) -> RecordedStates:
    """Run short closed loops against the twin and keep `count` of their states.

    Half of a loop's states come from its first `TRANSIENT`, denser towards the start, half from
    the rest, evenly.

    Parameters
    ----------
    model : SoftModel
    make : callable
        Builds the controller that drives the loops.
    count : int
        Number of states, at least one per loop. Loops that end early may give fewer.
    runs : sequence of Experiment, optional
        By default the paper's four set points from rest and one trajectory. For another robot,
        equilibria that its statics find, and a path around one of them.
    duration : float
        Duration of each loop (s).
    """
    if runs is None:
        runs = experiments_of(model)
    rows: list[tuple[Any, ...]] = []
    for i, experiment in enumerate(runs):
        share = count // len(runs) + (i < count % len(runs))
        log = simulate(model, make(model), experiment, duration=duration)
        for k in _chosen(log.steps, round(TRANSIENT / log.period), max(share, 1)):
            target = experiment.reference(float(log.t[k]))
            arrays = (log.q[k], log.v[k], target.y, target.ydot, target.yddot)
            rows.append((*arrays, log.t[k], _name(experiment)))
    q, v, y, ydot, yddot, t, loop = (np.array(column) for column in zip(*rows, strict=True))
    return RecordedStates(q, v, y, ydot, yddot, t, loop, digest_of(model))


def experiments_of(model: SoftModel) -> list[Experiment]:
    """The experiments of a robot's loops; set points come first."""
    if model.bundled not in setups.ROBOTS:
        return study_experiments(model, len(experiments.THETAS))
    setup = setups.setup_of(model)
    return [*map(setup.set_point, experiments.THETAS), setup.tracking(OMEGA)]


def recorded(
    model: SoftModel, make: Callable[[SoftModel], Any], count: int, folder: Path, robot: str
) -> RecordedStates:
    """The states in the robot's file in `folder`, or new ones if it is of another model or size.

    Parameters
    ----------
    model, make, count
        See `record`.
    folder : Path
        Folder of ROBOT.npz.
    robot : str
        Name of the robot, or path of its file.
    """
    path = folder / f"{safe_filename(robot)}.npz"
    if path.is_file():
        found = RecordedStates.load(path)
        if found.digest == digest_of(model) and len(found) == count:
            return found
    new = record(model, make, count)
    new.save(path)
    return new


def digest_of(model: SoftModel) -> str:
    """SHA-256 of the robot's file, or of its dynamics if another file has its annotations."""
    if model.robot.overlay is not None:
        return model.robot.digest
    return hashlib.sha256(model.robot.path.read_bytes()).hexdigest()


def _name(experiment: Experiment) -> str:
    values = (experiment.theta, experiment.omega)
    return " ".join([experiment.kind, *(f"{value:g}" for value in values if value is not None)])


def _chosen(steps: int, early: int, share: int) -> list[int]:
    """`share` of the steps 0 … steps - 1, or all of them if there are fewer."""
    if share >= steps:
        return list(range(steps))
    early = min(max(early, 1), steps)
    first = np.geomspace(1, early, share - share // 2) - 1
    rest = np.linspace(early - 1, steps - 1, share // 2)
    chosen = {*np.concatenate((first, rest)).round().astype(int).tolist()}
    # near the start the geometric series repeats steps: take the next free ones
    spare = (k for k in range(steps) if k not in chosen)
    return sorted([*chosen, *itertools.islice(spare, share - len(chosen))])
