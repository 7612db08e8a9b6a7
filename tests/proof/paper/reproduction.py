"""Differences of the paper's reference implementation from the paper, one change at a time.

A change modifies a `Case`; our code stays the same. It alters the `State` that the controller sees,
the plant or the period, or it solves the paper's QP as the reference does (`reference_laws`).
Changes combine with ``+``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import Ellipse, InputError, Reference, SetPoint, SoftModel
from softdyn.controllers.registry import CONTROLLERS
from softdyn.validation.loop import setups
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.studies import benchmark
from softdyn.validation.studies.benchmark_table import benchmark_cells
from softdyn.validation.studies.engine import executors, worker
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.tables import Table, document
from softdyn.validation.twin.plant_errors import PlantErrors
from tests.proof.paper import reference_laws
from tests.proof.paper.altered_states import (
    AlteredStates,
    Stale,
    View,
    always,
    no_coriolis,
    wrong_sign,
)
from tests.proof.paper.borrowed import BorrowedPlant

QP = ("clf-qp", "soft-id-clf-qp", "ic-qp")
CLOSED = ("ic", "uic")
PAPER = ("clf-qp", "soft-id-clf-qp", "ic", "uic", "ic-qp")
ROBOTS = ("finger", "helix", "spirob")
TITLES = (
    "Experiment", "Robot", "Controller", "SP (cm)", "SP, ours", "SP, paper", "TT (cm²)",
    "TT, ours", "TT, paper", "Failed runs",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Moved:
    """A reference moved by a vector (3,) (m)."""

    inner: Callable[[float], Reference]
    by: np.ndarray

    def __call__(self, t: float) -> Reference:
        """The reference at t (s)."""
        at = self.inner(t)
        return Reference(at.y + self.by, at.ydot, at.yddot)


# The ellipse's length (m) if it is not the robot's: SpiRob's, whose base is 0.50 m high
SPIROB_LENGTH = {"set_point": 0.48, "tracking": 0.45}
PHI = math.pi / 4


def reference_target(
    robot: str, experiment: Experiment, shift: tuple[float, float] = (0.0, 0.0)
) -> Callable[[float], Reference]:
    """The reference of the tip in the logs of the reference implementation.

    b is L/6, not the paper's L/8. SpiRob's L is 0.48 m at set points and 0.45 m in trajectories.
    Its ellipse starts at this height above the ground, not at the base at 0.50 m. `shift` moves the
    ellipse along its axes a and b (m).
    """
    setup = setups.setup(robot)
    length = SPIROB_LENGTH[experiment.kind] if robot.startswith("spirob") else setup.length
    (a, b), (cos, sin) = shift, (math.cos(PHI), math.sin(PHI))
    by = np.array([a * cos - b * sin, 0.0, a * sin + b * cos + length - setup.length])
    ellipse = Ellipse(
        a=length / 3, b=length / 6, c=setup.reach * length - length / 6,
        omega=experiment.omega or 0.0,
    )  # fmt: skip
    if experiment.theta is None:
        return Moved(ellipse, by)
    return SetPoint(ellipse.point(experiment.theta) + by)


def shifted_target(robot: str, experiment: Experiment) -> Callable[[float], Reference]:
    """The target in the repository's last versions: 0.1 m back, and 0.05 m up except for SpiRob."""
    return reference_target(robot, experiment, (-0.1, 0.0 if robot.startswith("spirob") else 0.05))


def another_law(
    name: str, model: SoftModel, options: tuple[str, ...], gains: Mapping[str, float]
) -> Any:
    """A controller of `reference_laws` with the published gains, some of them replaced."""
    own = replace(CONTROLLERS[name].published[model.bundled or ""], **gains)
    return reference_laws.make_law(name, model, own, options)


@dataclass(frozen=True)
class Change:
    """One difference of a run from ours, and the cells for which it is meant.

    Attributes
    ----------
    what : str
        A description of one line.
    source : str
        Where the reference implementation has it; empty for a change of our own.
    robots, controllers : tuple of str
        The robots and controllers with which it runs by default.
    case, options, plant : mapping
        The fields that differ, of the `Case`, its options and its `PlantErrors`.
    views, late
        Fields of `AlteredStates`.
    law : str
        The option of `reference_laws` for the controller: "exact" (QPs solved by Goldfarb–Idnani,
        three task rows), "angular" (the same with three more rows for the tip's angular velocity),
        "difference", "thresholds", "mass", "scs", "clf".
    gains : mapping
        Gains that replace the published ones. The controller is then one of `reference_laws`.
    hulls : bool
        Whether links touch as in the reference's own model files.
    """

    what: str
    source: str = ""
    robots: tuple[str, ...] = ROBOTS
    controllers: tuple[str, ...] = PAPER
    case: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    plant: Mapping[str, Any] = field(default_factory=dict)
    views: tuple[Callable[[], View], ...] = ()
    late: bool = False
    law: str = ""
    gains: Mapping[str, float] = field(default_factory=dict)
    hulls: bool = False


CHANGES = {
    "passive-sign": Change(
        "springs and dampers enter h with the wrong sign (helix)", "`passive_sign` in `robot.py`",
        ("helix",), views=(partial(always, wrong_sign),),
    ),
    "no-coriolis": Change(
        "C = 0 and g is the whole bias (IC, UIC)", "`get_coriolis_and_gravity`",
        controllers=CLOSED, views=(partial(always, no_coriolis),),
    ),
    "stale": Change(
        "M, bias and passive forces are one control step older than J",
        "`mj_step`, then `mj_kinematics` only", views=(Stale,),
    ),
    "plant-step": Change(
        "one `implicitfast` step per control period", "model files", options={"timestep": math.inf}
    ),
    "plant-fine": Change("plant steps of 0.1 ms", robots=("finger",), options={"timestep": 1e-4}),
    "soft-stops": Change(
        "MuJoCo's default joint limits", "model files", ("helix", "spirob"),
        plant={"soft_stops": True},
    ),
    "contacts": Change(
        "links touch (our primitives, which are slimmer)", "model files", ("helix", "spirob"),
        plant={"contacts": True},
    ),
    "hulls": Change(
        "links touch with the convex hulls of the reference's meshes (`--files`), those next to "
        "the base too; one contact point a pair", "model files", ("helix", "spirob"), hulls=True,
    ),
    "friction": Change(
        "0.1 N m of dry friction a joint, in the plant alone (SpiRob)", "model file",
        ("spirob",), plant={"dry_friction": 0.1},
    ),
    "dof48": Change(
        "24 universal joints (SpiRob; paper: 27 DOF)", "model file", ("spirob",),
        case={"robot": "spirob48"},
    ),
    "ellipse": Change(
        "an ellipse with b = L/6 (paper: L/8); SpiRob with L = 0.48 m at set points, 0.45 m in "
        "trajectories, 2 and 5 cm lower", "`utils.py`; the first errors of all logs",
        case={"target": reference_target},
    ),
    "shifted": Change(
        "`ellipse`, moved by -0.1 m along its long axis (finger and helix: 0.05 m along the short "
        "one too)", "`utils.py` from cba95dc on", case={"target": shifted_target},
    ),
    "late": Change(
        "the first input is zero, because M and bias are not computed yet", "logs", late=True
    ),
    "sampled": Change(
        "TT is the plain mean of every fifth sample, t = 0 included: the initial error weighs "
        "five steps", "`plot.py`", case={"reference_sampling": True},
    ),
    "period-1ms": Change("control period 1 ms", robots=("finger",), options={"period": 0.001}),
    "period-2ms": Change(
        "control period 2 ms", robots=("finger", "helix"), options={"period": 0.002}
    ),
    "period-5ms": Change(
        "control period 5 ms", robots=("helix", "spirob"), options={"period": 0.005}
    ),
    "nudge": Change("initial velocities of 1e-9", robots=("finger",), case={"nudge": 1e-9}),
    "exact": Change("the textbook QP on another exact solver", controllers=QP, law="exact"),
    "angular": Change(
        "the tip's angular velocity is regulated to zero too: six task rows (helix, SpiRob)",
        "`task_dim` in `robot.py`", ("helix", "spirob"), law="angular",
    ),
    "thresholds": Change(
        "IC and UIC: singular values of J M⁻¹ Jᵀ below 1e-2 count as zero where its determinant "
        "is below 1e-2, those of UIC's projection below 1e-8 (ours: rank of J, B at 1e-6)",
        "impedance controllers", controllers=CLOSED, law="thresholds",
    ),
    "mass-orthogonal": Change(
        "the actuated rows with T_u M-orthogonal to B, not null(Bᵀ)",
        controllers=("soft-id-clf-qp", "ic-qp"), law="mass",
    ),
    "jdot": Change(
        "J̇ by a difference over 1 µs", "`compute_jacobian_derivative`", law="difference"
    ),
    "w2": Change(
        "w₂ = 0.2 in the helix' QPs (paper and db75230: 0.1)", "`reg_qdd` at 37d7d0f",
        ("helix",), ("soft-id-clf-qp", "ic-qp"), gains={"w2": 0.2},
    ),
    "kp": Change(
        "K_p = 500 in SpiRob's IC-QP (paper and db75230: 2000)", "`robot.py` at 37d7d0f",
        ("spirob",), ("ic-qp",), gains={"Kp": 500.0},
    ),
    "scs": Change(
        "the QP through cvxpy and SCS, default tolerances", "`prob.solve(solver=cp.SCS)`",
        controllers=QP, law="scs",
    ),
    "clf-objective": Change(
        "CLF-QP with V̇² and ‖u‖₁² in its cost, through SCS", "`clf_qp.py`",
        ("finger", "spirob"), ("clf-qp",), law="clf",
    ),
}  # fmt: skip
# The reference's files that state the contacts; the links of its finger never touch.
HULLS = {
    "helix": "mujoco_models/helix/helix_control.xml",
    "spirob48": "mujoco_models/spirob/spirob.xml",
}

# All changes of the reference implementation, by robot; `{law}` depends on the controller.
_COMMON = "ellipse+sampled+late+stale+no-coriolis+plant-step+soft-stops+contacts+thresholds"
REFERENCE = {
    "finger": _COMMON,
    "helix": f"passive-sign+{_COMMON}+angular",
    "spirob": f"dof48+friction+{_COMMON}+angular",
}
# Only its task and its plant, with our controller.
_TASK = "ellipse+sampled+plant-step"
THERE = {
    "finger": _TASK,
    "helix": f"{_TASK}+soft-stops+hulls",
    "spirob": f"{_TASK}+soft-stops+contacts+friction",
}
ALIASES = {
    "reference": "all changes of each robot (exact QPs; +scs for its solver)",
    "there": "its targets, sampling and plant with our controller (SpiRob of 27 DOF)",
}


def parse(name: str, robot: str) -> tuple[Change, ...]:
    """The changes of an experiment's name, e.g. ``stale+plant-step``, for one of the robots.

    Raises
    ------
    InputError
        An unknown name.
    """
    found: list[Change] = []
    for part in name.split("+"):
        if part in ALIASES:
            found += parse({"reference": REFERENCE, "there": THERE}[part][robot], robot)
        elif part in CHANGES:
            found.append(CHANGES[part])
        else:
            known = ", ".join([*CHANGES, *ALIASES])
            raise InputError("experiment", f"one of {known}, or some joined by +", repr(part))
    return tuple(found)


def cases(
    name: str,
    robots: Iterable[str] | None = None,
    controllers: Iterable[str] | None = None,
    thetas: Sequence[float] | None = None,
    omegas: Sequence[float] | None = None,
) -> list[Case]:
    """The cells for which an experiment is meant, or the requested ones."""
    found: list[Case] = []
    wanted = tuple(controllers) if controllers is not None else None
    for robot in ROBOTS if robots is None else robots:
        if robot not in ROBOTS:
            raise InputError("robot", f"one of {', '.join(ROBOTS)}", repr(robot))
        changes = parse(name, robot)
        whole = name.split("+")[0] in ALIASES  # of every robot and controller
        if robots is None and not whole and any(robot not in c.robots for c in changes):
            continue
        own = [c for c in PAPER if whole or all(c in change.controllers for change in changes)]
        found += benchmark.grid([robot], own if wanted is None else wanted, thetas, omegas)
    return found


def changed(cell: Case, name: str, files: Path | None = None) -> Case:
    """A cell of the grid with an experiment's changes; `files` is the reference's folder.

    Raises
    ------
    InputError
        The name is unknown, or it needs the reference's files, which are not given.
    """
    case, gains = cell, dict[str, float]()
    changes = parse(name, cell.robot)
    for change in changes:
        plant = {**case.options.get("plant", {}), **change.plant}
        options = {**case.options, **change.options} | ({"plant": plant} if plant else {})
        case = replace(case, **change.case, options=options)
        gains |= change.gains
    views = tuple(view for change in changes for view in change.views)
    late = any(change.late for change in changes)
    if views or late:
        case = replace(case, around=AlteredStates(views, late))
    if any(change.hulls for change in changes) and case.robot in HULLS:
        if files is None:
            raise InputError("files", "the reference's folder, which hulls needs", None)
        errors = RunOptions.of(case.options).plant or PlantErrors()
        borrowed = BorrowedPlant.of(errors, files / HULLS[case.robot])
        case = replace(case, options={**case.options, "plant": borrowed})
    # a robot's list also holds changes of other controllers
    laws = tuple(c.law for c in changes if c.law and cell.controller in c.controllers)
    if not laws and not gains:
        return case
    return replace(case, law=partial(another_law, options=laws, gains=gains))


def labelled(wanted: Iterable[tuple[str, Case]], files: Path | None = None) -> dict[str, Case]:
    """Experiments and cells as cases by ``experiment/robot/controller/cell``."""
    return {f"{name}/{benchmark.label(c)}": changed(c, name, files) for name, c in wanted}


def run_experiments(
    wanted: Sequence[tuple[str, Case]], folder: Path, jobs: int = -1, files: Path | None = None
) -> None:
    """Run the cases that are missing or out of date in `folder`; a bar on a terminal."""
    asked = {  # check all of them before the first one runs
        name: worker.jobs_of(
            [changed(cell, name, files) for cell in cells], names=[c.name for c in cells], log=True
        )
        for name, cells in _by_name(wanted).items()
    }
    for name, cases in asked.items():
        executors.follow(benchmark.store(folder / name).run(cases, executors.strict(jobs)), cases)


def _by_name(wanted: Iterable[tuple[str, Case]]) -> dict[str, list[Case]]:
    found: dict[str, list[Case]] = {}
    for name, cell in wanted:
        found.setdefault(name, []).append(cell)
    return found


def reproduction_rows(
    wanted: Iterable[tuple[str, Case]], folder: Path, grid: Path
) -> list[dict[str, Any]]:
    """The table: one row per experiment, robot and controller, with our and the paper's figures."""
    found = []
    for name, mine in _by_name(wanted).items():
        ours = {(r["robot"], r["controller"]): r for r in benchmark.benchmark_rows(mine, grid)}
        for row in benchmark.benchmark_rows(mine, folder / name):
            key = row["robot"], row["controller"]
            found.append({"experiment": name, **row, "ours": ours[key]})
    return found


def reproduction_table(rows: list[dict[str, Any]]) -> Table:
    """Each experiment's figures, with ours and the paper's after them."""
    return Table(TITLES, [_reproduction_cells(row) for row in rows])


def _reproduction_cells(row: dict[str, Any]) -> list[str]:
    robot, controller, sp, sp_paper, _, tt, tt_paper, *_, failed = benchmark_cells(row)
    _, _, our_sp, _, _, our_tt, *_ = benchmark_cells(row["ours"])
    # no run of a kind: nothing to show
    points = (sp, our_sp, sp_paper) if row["set_points_cm"] else ("-",) * 3
    rates = (tt, our_tt, tt_paper) if row["trajectories_cm2"] else ("-",) * 3
    return [row["experiment"], robot, controller, *points, *rates, failed]


def reproduction_document(rows: list[dict[str, Any]]) -> str:
    """The table, then the figure of every run and the reasons of failed runs."""
    lines = []
    for row in rows:
        runs = {cell_title("set_point", float(k)): v for k, v in row["set_points_cm"].items()}
        runs |= {cell_title("tracking", float(k)): v for k, v in row["trajectories_cm2"].items()}
        shown = ", ".join(f"{k}: {'-' if v is None else f'{v:.3g}'}" for k, v in runs.items())
        lines.append(f"- {row['experiment']}, {row['robot']}, {row['controller']}: {shown}")
        lines += [f"  - {f['value']:g}π: {f['reason']}" for f in row["failed"]]
    return document("# Reproduction", reproduction_table(rows).markdown(), "\n".join(lines))
