"""What the paper's reference implementation does otherwise, one change at a time.

A change stands around our code, never in it: a controller that is shown another `State`, another
plant for `simulate`, an edited copy of the robot's file, another period, or the paper's programme
solved as the reference solves it (`reference_laws`). Changes combine with ``+``.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np

import softdyn
from softdyn import Ellipse, InputError, Reference, SoftModel, State
from softdyn.controllers import Command, find_controller
from softdyn.controllers.gains import PUBLISHED
from softdyn.validation import simulate
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.log import Log
from softdyn.validation.oracles import reference_laws
from softdyn.validation.processes import in_processes
from softdyn.validation.studies import benchmark, paper
from softdyn.validation.studies.benchmark import Case
from softdyn.validation.twin.twin import Twin

View = Callable[[State], State]
QP = ("clf-qp", "soft-id-clf-qp", "ic-qp")
CLOSED = ("ic", "uic")
PAPER = ("clf-qp", "soft-id-clf-qp", "ic", "uic", "ic-qp")
ROBOTS = ("finger", "helix", "spirob")
# MuJoCo's own defaults of solref and solimp
SOFT_SOLREF, SOFT_SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)


# -- what a controller is shown --------------------------------------------------------------------


def seen(state: State, **changes: Any) -> State:
    """A copy of `state` with other terms, read-only; `C` and `g` too, which it computes itself."""
    own: dict[str, Any] = {name: changes.pop(name) for name in ("C", "g") if name in changes}
    for value in (*changes.values(), *own.values()):
        value.flags.writeable = False
    copy = replace(state, **changes)
    vars(copy).update(own)
    return copy


def wrong_sign(state: State) -> State:
    """Springs and dampers enter h with the wrong sign: doubled where they should be cancelled."""
    return seen(state, K=-state.K, D=-state.D, h=state.bias - state.D @ state.v - state.K)


def no_coriolis(state: State) -> State:
    """C = 0, and what is called gravity is the whole bias C q̇ + g."""
    return seen(state, C=np.zeros_like(state.M), g=np.array(state.bias))


class Stale:
    """M, bias and passive forces are those of the last control step; J, B and the tip are not."""

    def __init__(self) -> None:
        self._last: State | None = None

    def __call__(self, state: State) -> State:
        """What the controller sees instead of `state`."""
        last, self._last = self._last or state, state
        passive = last.h - last.bias
        return seen(
            state,
            M=np.array(last.M), bias=np.array(last.bias), h=np.array(last.h),
            K=passive - state.D @ state.v,  # so that D q̇ + K is the old passive force
            g=np.array(last.g), C=np.array(last.C),
        )  # fmt: skip


class Shown:
    """A controller that sees each state through views; its gains and counts are the inner one's.

    A `late` one answers its first state with zero input.
    """

    def __init__(self, controller: Any, views: Iterable[View] = (), *, late: bool = False) -> None:
        self._controller, self._views, self._late = controller, tuple(views), late
        self.gains, self.guard = controller.gains, controller.guard

    def __call__(self, state: State, reference: Any) -> Any:
        """The inner controller's answer to the state it is shown."""
        for view in self._views:
            state = view(state)
        if self._late:
            self._late = False
            return Command(np.clip(np.zeros(state.model.nu), state.model.u_min, state.model.u_max))
        return self._controller(state, reference)


# -- another plant ---------------------------------------------------------------------------------


class SoftTwin(Twin):
    """The twin with MuJoCo's default softness of joint limits and dry friction."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.model.jnt_solref[:], self.model.jnt_solimp[:] = SOFT_SOLREF, SOFT_SOLIMP
        self.model.dof_solref[:], self.model.dof_solimp[:] = SOFT_SOLREF, SOFT_SOLIMP


def with_friction(source: Path, target: Path, friction: float) -> None:
    """Copy a robot's file, every moving joint with dry friction (N m or N)."""
    tree = ElementTree.parse(source)
    for joint in tree.getroot().findall("joint"):
        if joint.get("type") == "fixed":
            continue
        dynamics = joint.find("dynamics")
        if dynamics is None:
            dynamics = ElementTree.SubElement(joint, "dynamics")
        dynamics.set("friction", repr(friction))
    tree.write(target, encoding="utf-8", xml_declaration=True)


# -- another reference -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Lowered:
    """A reference moved down by `drop` (m)."""

    inner: Callable[[float], Reference]
    drop: float

    def __call__(self, t: float) -> Reference:
        """The reference at t (s)."""
        at = self.inner(t)
        return Reference(at.y - [0.0, 0.0, self.drop], at.ydot, at.yddot)


def reference_ellipse(robot: str, omega: float) -> Lowered:
    """The ellipse that the reference implementation's own tracking logs follow.

    Read off the `xd_log` of its published `results/`: b is L/6, not the paper's L/8, and SpiRob's
    L is 0.45 m, about a point 0.45 m, not 0.50 m, above the ground.
    """
    length = {"finger": 0.24, "helix": 0.45}.get(robot, 0.45)
    reach = paper.setup(robot).reach
    a, b = length / 3, length / 6
    drop = 0.0 if robot in ("finger", "helix") else 0.05
    return Lowered(Ellipse(a=a, b=b, c=reach * length - b, omega=omega), drop)


# -- the experiments -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Change:
    """One way in which a run differs from ours, and the cells it is meant for.

    Attributes
    ----------
    what : a line for people.
    robots, controllers : where it is run unless asked otherwise.
    views : makes the views of one run.
    plant_step : plant step (s); ``inf`` for one step a control period.
    late : whether the first input is zero.
    sampled : whether TT is the plain mean over every fifth control step, t = 0 included.
    nudge : added to every initial velocity (rad/s, m/s).
    ellipse : whether trajectories run on the reference's ellipse.
    law : asks `reference_laws` for the controller: "exact" (QPs on Goldfarb–Idnani, three task
        rows), "angular" (the same with the tip's angular velocity as three more), "scs", "clf".
    """

    what: str
    robots: tuple[str, ...] = ROBOTS
    controllers: tuple[str, ...] = PAPER
    views: tuple[Callable[[], View], ...] = ()
    plant_step: float | None = None
    period: float | None = None
    soft_stops: bool = False
    contacts: bool = False
    friction: float = 0.0
    robot: str | None = None
    ellipse: bool = False
    late: bool = False
    sampled: bool = False
    nudge: float = 0.0
    law: str | None = None


CHANGES = {
    "passive-sign": Change(
        "passive forces with the wrong sign in h", ("helix",), views=(lambda: wrong_sign,)
    ),
    "no-coriolis": Change(
        "C = 0 and the whole bias for g", controllers=CLOSED, views=(lambda: no_coriolis,)
    ),
    "stale": Change("M, bias and passive forces one control step old", views=(Stale,)),
    "plant-step": Change("the plant takes one step a control period", plant_step=math.inf),
    "plant-fine": Change("plant steps of 0.1 ms", ("finger",), plant_step=1e-4),
    "soft-stops": Change("MuJoCo's default joint limits", ("helix", "spirob"), soft_stops=True),
    "contacts": Change("links touch", ("helix", "spirob"), contacts=True),
    "friction": Change("0.1 N m of dry friction in the plant alone", ("spirob",), friction=0.1),
    "dof48": Change("SpiRob of 48 DOF, the reference's file", ("spirob",), robot="spirob48"),
    "ellipse": Change("trajectories on the ellipse of the reference's logs", ellipse=True),
    "late": Change("the first control step gives zero input", late=True),
    "sampled": Change("TT as the plain mean of every fifth sample, t = 0 included", sampled=True),
    "period-1ms": Change("control period 1 ms", ("finger",), period=0.001),
    "period-2ms": Change("control period 2 ms", ("finger", "helix"), period=0.002),
    "period-5ms": Change("control period 5 ms", ("helix", "spirob"), period=0.005),
    "nudge": Change("initial velocities of 1e-9", ("finger",), nudge=1e-9),
    "exact": Change("the textbook programme on another exact solver", controllers=QP, law="exact"),
    "angular": Change(
        "the tip's angular velocity regulated to zero as well", ("helix", "spirob"), law="angular"
    ),
    "scs": Change("the programme through cvxpy and SCS", controllers=QP, law="scs"),
    "clf-objective": Change(
        "the reference's CLF-QP, with V̇² and ‖u‖₁² in the objective, through SCS",
        ("finger", "spirob"), ("clf-qp",), law="clf",
    ),
}  # fmt: skip

# What the reference implementation has, robot by robot; `{law}` depends on the controller.
_COMMON = "ellipse+sampled+late+stale+no-coriolis+plant-step+soft-stops+contacts"
REFERENCE = {
    "finger": _COMMON,
    "helix": f"passive-sign+{_COMMON}+angular",
    "spirob": f"dof48+friction+{_COMMON}+angular",
}
ALIASES = {"reference": "all of it, as each robot has it (exact QPs; +scs for its solver)"}


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
            found += parse(REFERENCE[robot], robot)
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
    thetas: Iterable[float] = paper.THETAS,
    omegas: Iterable[float] = paper.OMEGAS,
) -> list[Case]:
    """The cells an experiment is meant for, or those asked for."""
    found: list[Case] = []
    thetas, omegas = tuple(thetas), tuple(omegas)
    wanted = tuple(controllers) if controllers is not None else None
    for robot in robots if robots is not None else ROBOTS:
        if robot not in ROBOTS:
            raise InputError("robot", f"one of {', '.join(ROBOTS)}", repr(robot))
        changes = parse(name, robot)
        whole = name.split("+")[0] in ALIASES  # of every robot and controller
        if robots is None and not whole and any(robot not in c.robots for c in changes):
            continue
        own = [c for c in PAPER if whole or all(c in change.controllers for change in changes)]
        found += benchmark.grid([robot], own if wanted is None else wanted, thetas, omegas)
    return found


# -- running ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Setting:
    """What one run takes: the arguments of `simulate`."""

    model: SoftModel
    controller: Shown
    experiment: Experiment
    options: dict[str, Any]


def prepare(case: Case, name: str, folder: Path) -> Setting:
    """The setting of a case with an experiment's changes; an edited robot lies in `folder`."""
    changes = parse(name, case.robot)
    robot = next((c.robot for c in changes if c.robot), case.robot)
    friction = max(c.friction for c in changes)
    model = softdyn.load(robot)
    gains = PUBLISHED[robot][case.controller]
    if friction:
        copy = folder / f"{robot}.urdf"
        with_friction(model.robot.path, copy, friction)
        model = softdyn.load(copy)
    setup = paper.setup(robot)
    setup = replace(setup, period=next((c.period for c in changes if c.period), setup.period))
    experiment = (setup.set_point if case.kind == "set_point" else setup.tracking)(case.value)
    if case.kind == "tracking" and any(c.ellipse for c in changes):
        experiment = replace(experiment, reference=reference_ellipse(robot, case.value))
    step = next((c.plant_step for c in changes if c.plant_step), None)
    laws = {c.law for c in changes if c.law}
    if laws:
        controller = reference_laws.make_law(case.controller, model, gains, laws)
    else:
        controller = find_controller(case.controller)(model, gains)
    return Setting(
        model,
        Shown(
            controller,
            [view() for c in changes for view in c.views],
            late=any(c.late for c in changes),
        ),
        experiment,
        {
            "timestep": None if step is None else min(step, setup.period),
            "v0": np.full(model.nv, sum(c.nudge for c in changes)),
            "contacts": any(c.contacts for c in changes),
            "friction": friction > 0,
            "twin": SoftTwin if any(c.soft_stops for c in changes) else Twin,
        },
    )


def run(case: Case, name: str) -> Log:
    """One case with an experiment's changes."""
    with TemporaryDirectory() as folder:
        s = prepare(case, name, Path(folder))
        return simulate(s.model, s.controller, s.experiment, name=case.controller, **s.options)


def run_all(
    wanted: list[tuple[str, Case]], folder: Path, jobs: int = -1
) -> Iterator[tuple[str, Case]]:
    """Run what is missing or out of date below `folder`; yields as they finish."""
    prints = {pair: fingerprint(*pair) for pair in wanted}
    missing = []
    for name, case in wanted:
        if benchmark.is_fresh(case, folder / name, prints[name, case]):
            yield name, case
        else:
            missing.append((name, case, folder, prints[name, case]))
    yield from in_processes(run_case, missing, jobs)


def run_case(name: str, case: Case, folder: Path, print_: str) -> tuple[str, Case]:
    """Run one case and write its files where `benchmark.rows` finds them."""
    log = run(case, name)
    tt = mse_cm2(log, sampled=any(c.sampled for c in parse(name, case.robot)))
    benchmark.save_case(case, log, folder / name, print_, mse_cm2=tt)
    return name, case


def mse_cm2(log: Log, *, sampled: bool) -> float:
    """TT of a run (cm²): ours, or the reference's, which logs every fifth step and averages."""
    if not sampled or not log.complete:
        return log.mse_cm2
    return 1e4 * float(np.mean(np.sum(log.error[::5] ** 2, axis=1)))


def fingerprint(name: str, case: Case) -> str:
    """A hash of all that a run depends on."""
    oracles = sorted(Path(reference_laws.__file__).parent.glob("*.py"))
    code = [file.read_bytes().hex() for file in (Path(__file__), *oracles)]
    text = json.dumps([name, benchmark.fingerprint(case), *code])
    return hashlib.sha256(text.encode()).hexdigest()


def rows(wanted: list[tuple[str, Case]], folder: Path, grid: Path) -> list[dict[str, Any]]:
    """The table: one row an experiment, robot and controller, ours and the paper's beside it."""
    found = []
    for name in dict.fromkeys(name for name, _ in wanted):
        mine = [case for other, case in wanted if other == name]
        ours = {(r["robot"], r["controller"]): r for r in benchmark.rows(mine, grid)}
        for row in benchmark.rows(mine, folder / name):
            key = row["robot"], row["controller"]
            found.append({"experiment": name, **row, "ours": ours[key]})
    return found
