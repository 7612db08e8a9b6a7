"""Lengths, arms, Hessians and power of cables around round bodies: errors of random robots.

The judges are MuJoCo and central differences.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import mujoco
import numpy as np
from tqdm import tqdm

import softdyn
from softdyn.dynamics.tree import TreeModel
from softdyn.dynamics.wraps import Contact
from softdyn.validation import Twin
from softdyn.validation.crosschecks.crosscheck import crosscheck
from tests.support.oracles import gradient, rate, relative
from tests.support.wrapped_robots import wrapped_robot

# rad, m of the differences. Their error falls as its fourth power, and a state near an edge needs a
# small one: at 2e-4 the worst of 2000 states has 1e-5, at 2e-5 1e-9.
STEP = 2e-5
NEAR = 2.0  # steps
BARS = {
    "length": 1e-10, "arms outside": 1e-10, "arms inside": 1e-6, "arms, differences": 1e-7,
    "Hessians, differences": 1e-7, "power": 1e-7, "trajectory": 1e-9,
}  # fmt: skip


@dataclass
class Figures:
    """The largest errors, the number of pieces by contact, and the states that were left out.

    `inside` are the largest errors of robots with inner bends in a cross-check.
    """

    errors: dict[str, float] = field(default_factory=lambda: dict.fromkeys(BARS, 0.0))
    contacts: Counter[str] = field(default_factory=Counter)
    left_out: int = 0
    compared: int = 0
    worst: dict[str, tuple[int, int]] = field(default_factory=dict)
    inside: dict[str, float] = field(default_factory=dict)

    def note(self, quantity: str, error: float, where: tuple[int, int]) -> None:
        """Keep the largest error and its robot and state."""
        if not error <= self.errors[quantity]:
            self.errors[quantity], self.worst[quantity] = error, where

    @property
    def missed(self) -> dict[str, float]:
        """The errors beyond their bars."""
        return {name: e for name, e in self.errors.items() if not e <= BARS[name]}


def measure(seeds: range, states: int, trajectories: int = 0, bodies: int = 4) -> Figures:
    """Compare the robots of some seeds at random states, the first also along trajectories."""
    found = Figures()
    for seed in tqdm(seeds, disable=None, leave=False, unit="robot"):
        model = softdyn.build(wrapped_robot(seed, bodies))
        assert isinstance(model, TreeModel)  # they have no mimic joints
        twin, rng = Twin(model, limits=False), np.random.default_rng((seed, 1))
        low, high = np.maximum(model.lower, -1.5), np.minimum(model.upper, 1.5)
        for k in range(states):
            q = model.configuration(rng.uniform(low, high))
            _compare(found, model, twin, q, (seed, k))
            _differences(found, model, q, rng.normal(size=model.nv), (seed, k))
        follow = seed - seeds[0] < trajectories
        if trajectories and any(wrap.inside for t in model.robot.tendons for wrap in t.wraps):
            for check in crosscheck(model, samples=2, seed=seed, trajectories=follow).checks:
                error = max(check.max_error, found.inside.get(check.quantity, 0.0))
                found.inside[check.quantity] = error
        if follow:
            plain = softdyn.build(wrapped_robot(seed, bodies, inside=False))
            checks = {check.quantity: check for check in crosscheck(plain, samples=2).checks}
            found.note("trajectory", checks["trajectory"].max_error, (seed, 0))
    return found


def _compare(
    found: Figures, model: TreeModel, twin: Twin, q: np.ndarray, where: tuple[int, int]
) -> None:
    """Lengths and moment arms against MuJoCo's."""
    state, data, engine = model.state(q, np.zeros(model.nv)), twin.data, twin.model
    order = [twin.joint_names.index(name) for name in model.joint_names]
    qpos = np.zeros(model.nv)
    qpos[order] = model.coordinates(q)
    twin.set_state(qpos, np.zeros(model.nv))
    arms = np.zeros((engine.ntendon, engine.nv))
    mujoco.mju_sparse2dense(
        arms, data.ten_J.ravel(), engine.ten_J_rownnz, engine.ten_J_rowadr,
        engine.ten_J_colind.ravel(),
    )  # fmt: skip
    apart = np.abs(state.moment_arms - arms[:, order]).max(axis=1)
    found.note("length", float(np.abs(state.lengths - data.ten_length).max()), where)
    paths = model.tendons.wraps
    contacts = model.tendon_geometry(q).around.courses.contact
    found.contacts.update(Contact(contact).name for contact in contacts)
    inside = set(paths.tendon[contacts == Contact.BENT].tolist())
    for t, error in enumerate(apart):
        found.note("arms inside" if t in inside else "arms outside", float(error), where)


def _differences(
    found: Figures, model: TreeModel, q: np.ndarray, v: np.ndarray, where: tuple[int, int]
) -> None:
    """Moment arms, Hessians and power against central differences."""
    if _edges(model, q):
        found.left_out += 1
        return
    found.compared += 1
    arms, hessians = model.tendon_moment_arms(q), model.tendon_hessians(q)
    by_length = gradient(model, model.tendon_lengths, q, STEP)
    by_arms = gradient(model, model.tendon_moment_arms, q, STEP)
    found.note("arms, differences", relative(arms, by_length, 1.0), where)
    found.note("Hessians, differences", relative(hessians, by_arms, 1.0), where)
    state = model.state(q, v)
    stored = rate(model, model.potential_energy, q, v, STEP)
    pulled = rate(model, lambda at: model.tendon_lengths(at)[model.actuated], q, v, STEP)
    scale = float(np.abs(state.K * v).sum() + np.abs(state.g * v).sum())
    power = relative((state.K + state.g) @ v, stored, scale)
    found.note("power", max(power, relative(state.B.T @ v, model.gear * pulled, 1.0)), where)


def _edges(model: TreeModel, q: np.ndarray) -> bool:
    """Whether a cable touches, leaves or enters a body within two steps along any joint."""

    def here(at):
        return model.tendon_geometry(at).around.courses.contact.tolist()

    steps = np.vstack((np.eye(model.nv), -np.eye(model.nv)))
    now = here(q)
    return any(here(model.integrate(q, NEAR * STEP * step)) != now for step in steps)
