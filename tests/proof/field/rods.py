"""Our rollouts of the published rods: distances between tips, convergence in joints and step."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import softdyn
from softdyn import design
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.rods.ladder import Ladder
from softdyn.validation.rollouts import threads
from softdyn.validation.twin.integrators import Integrator
from softdyn.validation.twin.twin import Twin
from tests.proof.field import drag
from tests.proof.field.cases import ALL, BENDS, PERIOD, SECONDS, UNSHEARED, UNSTRETCHED, Case

JOINTS = (5, 10, 20, 40, 80)
USUAL = 20  # joints
STEP = 1e-3  # s
STEPS = {  # scheme: steps (s), whether the material is damped; stiff dampers make RK4 unstable
    Integrator.IMPLICITFAST: ((4e-3, 2e-3, 1e-3, 5e-4), True),
    Integrator.RK4: ((2e-3, 1e-3, 5e-4, 2.5e-4), False),
}
FINEST = 1.25e-4 / 4
COARSE = 0.02  # s between the samples of these
STEPPED = 5  # joints where the step is changed: few, so that RK4 is stable
SHORT = 0.5  # s of the rollouts with changed steps
HALF = 20  # joints in each half of the rod whose strains are the others'


def twin_of(
    case: Case, arm: design.Arm, step: float, integrator: Integrator = Integrator.IMPLICITFAST
) -> Twin:
    """The twin of an arm, with the gravity of the case."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rod.urdf"
        path.write_text(design.urdf(arm), encoding="utf-8")
        twin = Twin(softdyn.load(path), timestep=step, integrator=integrator)
    twin.model.opt.gravity[:] *= case.share
    twin.model.opt.enableflags = 0  # without the energy
    twin.reset()
    return twin


def tips_of(twin: Twin, qpos: np.ndarray) -> np.ndarray:
    """Tips (samples, 3) in the world (m)."""
    found = np.empty((len(qpos), 3))
    for k, q in enumerate(qpos):
        twin.data.qpos[:] = q
        mujoco.mj_kinematics(twin.model, twin.data)
        found[k] = twin.data.site_xpos[twin.task_site]
    return found


def roll(
    case: Case, twin: Twin, seconds: float = SECONDS, period: float = PERIOD
) -> tuple[np.ndarray, float]:
    """Tips (samples, 3) in the others' frame, and the time of the rollout (s)."""
    began = time.perf_counter()
    grid = TimeGrid.plan(seconds, period, twin.model.opt.timestep)
    u = np.broadcast_to(case.tensions, (1, grid.steps, len(case.tensions)))
    (moved,) = threads.integrate(twin, grid, u)
    if moved is None:
        return np.full((grid.steps + 1, 3), np.nan), np.nan
    tips = case.in_their_frame(tips_of(twin, moved[0]))
    return tips, time.perf_counter() - began


def in_their_strains(case: Case) -> np.ndarray:
    """Tips of our rod with the strains of SoRoMoX and SoRoSim, by `softdyn.reduce`.

    It is integrated by the scheme of implicitfast: damping at the end of each step.
    """
    arm = case.arm(HALF, case.strains, case.time_constant, halves=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rod.urdf"
        path.write_text(design.urdf(arm), encoding="utf-8")
        reduced: Any = softdyn.reduce(softdyn.load(path), design.strain_basis(arm, case.degree))
    q, v, tips = np.zeros(reduced.nq), np.zeros(reduced.nv), []
    every = round(PERIOD / STEP)
    for k in range(round(SECONDS / STEP) + 1):
        state = reduced.state(q, v)
        if k % every == 0:
            tips.append(state.y)
        weight = (case.share - 1) * state.g
        force = state.B @ case.tensions - state.h - weight
        v = v + STEP * np.linalg.solve(state.M + STEP * state.D, force)
        q = q + STEP * v
    return case.in_their_frame(np.array(tips))


def measure(case: Case, theirs: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Every tip that is compared, and how ours converges."""
    tau, ours = case.time_constant, {}
    ladder = []
    for n in JOINTS:
        tips, _ = roll(case, twin_of(case, case.arm(n, BENDS, tau), STEP))
        ladder.append(tips)
        ours[f"ours, {n} joints that bend"] = tips
    for name, freedoms in (("twist, extension", UNSHEARED), ("twist, extension, shear", ALL)):
        tips, _ = roll(case, twin_of(case, case.arm(USUAL, freedoms, tau), STEP))
        ours[f"ours, {USUAL} joints, also {name}"] = tips
    ours["ours, in the strains of SoRoMoX"] = in_their_strains(case)
    joints, step = case.undamped
    undamped = twin_of(case, case.arm(joints, UNSTRETCHED, 0.0), step)
    ours[f"ours, {joints} joints, shear, PyElastica's damping"] = drag.roll(case, undamped)
    ladders = [_ladder("joints, 1 ms, to the finest", JOINTS, ladder)]
    for scheme, (steps, damped) in STEPS.items():
        arm = case.arm(STEPPED, BENDS, tau if damped else 0.0)
        runs = [
            roll(case, twin_of(case, arm, step, given), SHORT, COARSE)[0]
            for step, given in [*((step, scheme) for step in steps), (FINEST, Integrator.RK4)]
        ]
        counts = [round(SHORT / step) for step in steps]
        name = f"steps of {scheme} in {SHORT:g} s" + ("" if damped else ", undamped")
        ladders.append(_ladder(name, counts, runs[:-1], runs[-1]))
    return {"case": case, "theirs": dict(theirs), "ours": ours, "ladders": ladders}


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Root mean square distance (m) of two tips over the samples that both have."""
    n = min(len(a), len(b))
    return float(np.sqrt(np.mean(np.sum((a[:n] - b[:n]) ** 2, axis=1))))


def _ladder(
    name: str, counts: Sequence[int], tips: Sequence[np.ndarray], exact: np.ndarray | None = None
) -> Ladder:
    """Root mean square errors (m), to the exact tips or to the extrapolated ones."""
    values = np.array([each.ravel() for each in tips])
    scale = float(np.sqrt(len(tips[0])))
    return Ladder(name, tuple(counts), values, scale, None if exact is None else exact.ravel())
