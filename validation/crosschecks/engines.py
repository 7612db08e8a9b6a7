"""Two files of one robot, each in the engine that reads it, and the two engines compared.

A comparison works on neutral forms of the two files. `engine_errors` says how closely each engine
agrees with the neutral form of its file. `side_by_side` compares the two engines directly, as the
cross-check does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.validation.crosschecks.crosscheck import crosscheck
from softdyn.validation.crosschecks.result import CrossCheck
from softdyn.validation.mjcf.comparison.comparison import NAMED
from softdyn.validation.mjcf.comparison.drives import ONLY
from softdyn.validation.mjcf.comparison.dynamics import (
    States,
    evaluate,
    misreading,
    random_states,
    relative_errors,
)
from softdyn.validation.mjcf.comparison.neutral import Neutral
from softdyn.validation.mjcf.comparison.result import Cause
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.mjcf.scene import Scene

SORTS = mujoco.mjtTrn
TENDON = ("tendon_armature", "tendon_stiffness", "tendon_stiffnesspoly", "tendon_damping",
          "tendon_dampingpoly")  # fmt: skip
SPRINGS = ("stiffness", "damping")
SAME = 1e-9  # relative, of an engine against the neutral form


def engine_errors(
    source: str | Path | Side, *, samples: int = 8, seed: int = 0
) -> dict[str, float]:
    """Difference between the engine that reads a file and the file's neutral form.

    Parameters
    ----------
    source : str, Path or Side
        A URDF without mimic joints, for Pinocchio; an MJCF, for MuJoCo.
    samples, seed : int
        Number of random states, and their seed.

    Returns
    -------
    dict[str, float]
        Errors of ``M``, ``bias``, ``g``, for MuJoCo also of ``J``, relative to the largest entry of
        each or of M. Empty for a URDF with mimic joints or balls, because Pinocchio has other
        coordinates for them.

    Raises
    ------
    UrdfError, InputError
        For a file that cannot be used.
    """
    side = Side.of(source)
    robot = side.neutral
    balls = any(part.kind == "ball" for part in robot.parts)
    if robot.format == "urdf" and (robot.couplings or balls):
        return {}
    states = random_states(robot, samples, seed)
    if side.is_mjcf:
        return misreading(robot, side.compiled, states)
    return _pinocchio_errors(side.model, robot, states)


def side_by_side(
    a: str | Path | Side, b: str | Path | Side, *, samples: int = 8, seed: int = 0
) -> CrossCheck:
    """The URDF in Pinocchio against the MJCF in MuJoCo: every term, q̈ and trajectories.

    If only one file states armature, damping or springs, both engines take the URDF's values. So
    the engines agree where the files agree. Springs and dampers of tendons that only one file has
    are left out, and so are the lengths of these tendons. Joints that only the MJCF has stand
    still.

    Parameters
    ----------
    a, b : str, Path or Side
        A URDF and an MJCF, in any order.
    samples, seed : int
        Number of random states, and their seed.

    Raises
    ------
    UrdfError
        For a file that cannot be used.
    InputError
        Both files have one format, or the MJCF lacks joints or inputs of the URDF.
    """
    sides = sorted((Side.of(a), Side.of(b)), key=lambda side: side.is_mjcf)
    if [side.is_mjcf for side in sides] != [False, True]:
        names = ", ".join(side.path.name for side in sides)
        raise InputError("engines", "a URDF and an MJCF", names)
    urdf, mjcf = sides
    model = urdf.beside(mjcf).model
    scene = Scene(model, mjcf)
    if alone := [cause.where for cause in _tendons_alone(scene) if cause.b is None]:
        model = _without_springs(urdf, mjcf, alone)
        scene = Scene(model, mjcf)
    _settle_one_sided(scene)
    found = crosscheck(model, scene, samples=samples, seed=seed)
    # the energy contains the weight of the rest of the scene
    checks = tuple(check for check in found.checks if check.quantity != "energy")
    return replace(found, checks=checks)


def differing(pair: CrossCheck, tolerance: float = 0.0) -> list[str]:
    """Terms that differ by more than rounding or a relative tolerance; motions are left out."""
    return [
        check.quantity
        for check in pair.checks
        if check.quantity not in ("qdd", "trajectory")
        and not check.max_error <= max(NAMED, tolerance)
    ]


def _tendons_alone(scene: Scene) -> list[Cause]:
    """The causes that are a tendon of one file only."""
    return [c for c in scene.comparison.causes if c.kind == "tendon" and c.detail == ONLY]


def _without_springs(urdf: Side, mjcf: Side, names: Sequence[str]) -> SoftModel:
    """The model of a URDF without the springs and dampers of some tendons."""
    robot = urdf.beside(mjcf).robot
    tendons = tuple(
        replace(tendon, stiffness=0.0, damping=0.0, slack=False) if tendon.name in names else tendon
        for tendon in robot.tendons
    )
    return build(replace(robot, tendons=tendons))


def _settle_one_sided(scene: Scene) -> None:
    """Give the scene the URDF's values where only one of the files states any."""
    model, matched = scene.model, scene.comparison.matched
    tendons = [tendon.name for tendon in scene.robot.tendons]
    sorts = {"damping": ("dof_damping", "dof_dampingpoly"), "armature": ("dof_armature",),
             "stiffness": ("jnt_stiffness", "jnt_stiffnesspoly")}  # fmt: skip
    for cause in scene.comparison.causes:
        if not cause.alone:
            continue
        if cause.where in matched and cause.kind in sorts:
            joint = scene.joint_names.index(matched[cause.where])
            index = joint if cause.kind == "stiffness" else model.jnt_dofadr[joint]
            first, *powers = np.atleast_1d(cause.a)
            for field, value in zip(sorts[cause.kind], (first, powers or 0.0), strict=False):
                getattr(model, field)[index] = value
            _silence_drives(model, joint, (SORTS.mjTRN_JOINT, SORTS.mjTRN_JOINTINPARENT), cause)
        elif cause.kind == "tendon" and (name := cause.detail.partition(":")[0]) in SPRINGS:
            index = scene.tendons[tendons.index(cause.where)]
            getattr(model, f"tendon_{name}")[index] = np.atleast_1d(cause.a)[0]
            getattr(model, f"tendon_{name}poly")[index] = 0.0
            _silence_drives(model, index, (SORTS.mjTRN_TENDON,), cause)
        elif cause.kind == "armature" and cause.where in tendons:
            index = scene.tendons[tendons.index(cause.where)]
            model.tendon_armature[index] = cause.a
            _silence_drives(model, index, (SORTS.mjTRN_TENDON,), cause)
        elif cause.kind == "tendon" and cause.a is None and cause.where not in matched:
            for k in [k for k in range(model.ntendon) if model.tendon(k).name == cause.where]:
                _silence_drives(model, k, (SORTS.mjTRN_TENDON,), cause)
                for field in TENDON:
                    getattr(model, field)[k] = 0.0
        elif cause.kind == "gravity" and cause.where == "world":
            model.opt.gravity[:] = cause.a
        elif cause.kind == "gravity":
            model.body_gravcomp[:] = 0.0
        elif cause.where in ("opt.density", "opt.viscosity"):
            setattr(model.opt, cause.where[4:], 0.0)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _silence_drives(
    model: mujoco.MjModel, target: int, sorts: tuple[int, ...], cause: Cause
) -> None:
    """Remove the armature and damping that actuators add to their targets."""
    for k in range(model.nactuator):
        if model.actuator_trnid[k, 0] == target and any(
            model.actuator_trntype[k] == sort for sort in sorts
        ):
            if cause.kind in ("armature", "tendon"):
                model.actuator_armature[k] = 0.0
            if cause.kind in ("damping", "tendon"):
                model.actuator_damping[k] = 0.0
                model.actuator_dampingpoly[k] = 0.0


def _pinocchio_errors(model: SoftModel, robot: Neutral, states: States) -> dict[str, float]:
    """Errors of M, bias and g of the neutral form against Pinocchio."""
    names = [part.name for part in robot.parts]
    order = [names.index(name) for name in model.joint_names]
    back, terms = np.argsort(order), evaluate(robot, states)
    rows = []
    for k, v in enumerate(states.v):
        coordinates = np.array([q[k, 0] for q in states.q])[order]
        state = model.state(model.configuration(coordinates), v[order])
        rows.append((state.M[np.ix_(back, back)], state.bias[back], state.g[back]))
    M, bias, g = map(np.array, zip(*rows, strict=True))
    errors = relative_errors(terms, replace(terms, M=M, bias=bias, g=g))
    del errors["J"]
    return errors
