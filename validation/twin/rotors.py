"""The part of tendons' armatures in the mass matrix that MuJoCo leaves out.

A tendon of the armature m and the moment arms α adds m α αᵀ to M. MuJoCo stores M in the sparsity
of the tree, in which two joints on different branches have no entry. It drops such entries, and
keeps the force m α (q̇ᵀ H q̇) whole. So for a tendon that couples branches its own q̈ is wrong.
"""

from __future__ import annotations

import mujoco
import numpy as np


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """M (nv, nv) after ``mj_fwdPosition``, with the entries that MuJoCo leaves out."""
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    if (armatures := _armatures(model)).any():
        arms = np.zeros((model.ntendon, model.nv))
        sparse = model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
        mujoco.mju_sparse2dense(arms, data.ten_J, *sparse)
        M += _apart(model) * (arms.T @ (armatures[:, None] * arms))
    return M


def coupling_tendons(model: mujoco.MjModel) -> list[str]:
    """Names of the tendons with an armature that couples joints on different branches."""
    found, turning = [], np.flatnonzero(_armatures(model))
    apart = _apart(model) if len(turning) else np.zeros((0, 0), bool)
    for t in map(int, turning):
        columns = model.ten_J_colind[model.ten_J_rowadr[t] :][: model.ten_J_rownnz[t]]
        if apart[np.ix_(columns, columns)].any():
            found.append(model.tendon(t).name)
    return found


def _armatures(model: mujoco.MjModel) -> np.ndarray:
    """Each tendon's armature (tendons,), and that of the actuators on it."""
    found = model.tendon_armature.copy()
    for k in np.flatnonzero(model.actuator_armature):
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_TENDON:
            found[model.actuator_trnid[k, 0]] += (
                model.actuator_gear[k, 0] ** 2 * model.actuator_armature[k]
            )
    return found


def _apart(model: mujoco.MjModel) -> np.ndarray:
    """Whether two degrees of freedom (nv, nv) are on different branches."""
    above = np.eye(model.nv, dtype=bool)
    for k, parent in enumerate(model.dof_parentid):
        if parent >= 0:
            above[k] |= above[parent]
    found: np.ndarray = ~(above | above.T)
    return found
