"""One rollout of a clamped rod in PyElastica; runs in the peers' environment, without softdyn.

    python pyelastica_rod.py CASE.json OUT.npz

The case has the numbers of the published scripts. `cables` are ours, because the modules `tendon`
and `muscles` that a script imports are not published. Other keys are not in the scripts: with a
`time_constant` the rod is viscous; with `whole_cables` cables begin at the clamp; with
`half_clamped` half of the first element is in the clamp; `stretch` multiplies the stiffness of
extension. PyElastica bends between elements only, so a rod that begins at the clamp is rigid for
half an element; and its cross-section, and with it the bending stiffness, changes with the stretch.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version
from typing import Any

import elastica as ea
import numba
import numpy as np

VERSION = version("pyelastica")


class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
    """The modules that a rod needs."""


class Damped(Simulator):
    """PyElastica 0.3.3 collects dampers, but never applies them."""

    def constrain_rates(self, time: float) -> None:
        """Constrain the rates, then damp them, as earlier versions did."""
        super().constrain_rates(time)
        for damp in self._feature_group_damping:
            damp(time=time)


class Cables(ea.NoForces):
    """Cables in channels at a constant offset from the axis, pulled with constant tensions."""

    def __init__(self, offsets: np.ndarray, tensions: np.ndarray, whole: bool) -> None:
        super().__init__()
        self.given = offsets, tensions, whole

    def apply_forces(self, system: Any, time: float = 0.0) -> None:
        """Add the cables' forces on the nodes and torques on the elements."""
        pull(
            *self.given, system.position_collection, system.director_collection,
            system.external_forces, system.external_torques,
        )  # fmt: skip


@numba.njit(cache=True)
def pull(
    offsets: np.ndarray, tensions: np.ndarray, whole: bool, x: np.ndarray, Q: np.ndarray,
    forces: np.ndarray, torques: np.ndarray,
) -> None:  # fmt: skip
    """A cable is a chain of straight pieces between points that are fixed to the elements.

    The points lie at the elements' middles; with `whole`, also at the clamp and at the tip. Without
    it a cable is one element shorter, as in the published rollout.
    """
    n = Q.shape[2]
    first, last = (0, n + 1) if whole else (1, n)
    for c in range(len(tensions)):
        points = np.empty((n + 2, 3))
        for k in range(first, last + 1):
            e = min(max(k - 1, 0), n - 1)
            for i in range(3):
                at = 0.5 * (x[i, e] + x[i, e + 1])
                if k == 0:
                    at = x[i, 0]
                elif k == n + 1:
                    at = x[i, n]
                points[k, i] = at + Q[0, i, e] * offsets[c, 0] + Q[1, i, e] * offsets[c, 1]
        for k in range(max(first, 1), last + 1):
            e = min(k - 1, n - 1)
            f = np.zeros(3)
            for other in (k - 1, k + 1):
                if first <= other <= last:
                    way = points[other] - points[k]
                    f += tensions[c] * way / np.sqrt(np.sum(way**2))
            for i in range(3):
                if k == n + 1:
                    forces[i, n] += f[i]
                else:
                    forces[i, e] += 0.5 * f[i]
                    forces[i, e + 1] += 0.5 * f[i]
            along = Q[2, 0, e] * f[0] + Q[2, 1, e] * f[1] + Q[2, 2, e] * f[2]
            one = Q[0, 0, e] * f[0] + Q[0, 1, e] * f[1] + Q[0, 2, e] * f[2]
            two = Q[1, 0, e] * f[0] + Q[1, 1, e] * f[1] + Q[1, 2, e] * f[2]
            torques[0, e] += offsets[c, 1] * along
            torques[1, e] -= offsets[c, 0] * along
            torques[2, e] += offsets[c, 0] * two - offsets[c, 1] * one


class Viscosity(ea.NoForces):
    """Kelvin-Voigt damping: the strains at rest follow the strains' rates, B (k + tau dk/dt)."""

    def __init__(self, time_constant: float, time_step: float) -> None:
        super().__init__()
        self.factor = time_constant / time_step
        self.before: tuple[np.ndarray, np.ndarray] | None = None

    def apply_forces(self, system: Any, time: float = 0.0) -> None:
        """Set the strains at rest for the next step."""
        if self.before is not None:
            system.rest_kappa[:] = self.factor * (self.before[0] - system.kappa)
            system.rest_sigma[:] = self.factor * (self.before[1] - system.sigma)
        self.before = system.kappa.copy(), system.sigma.copy()


def build(case: dict[str, Any]) -> tuple[Any, Any, Any]:
    """The rod, its simulator and the stepper."""
    made = Damped() if VERSION.startswith("0.") else Simulator()
    simulator, n, dt = made, case["elements"], case["dt"]
    E = case["youngs_modulus"]
    inside = case["length"] / (2 * n - 1) if case.get("half_clamped") else 0.0
    rod = ea.CosseratRod.straight_rod(
        n_elements=n, start=np.array([0.0, 0, -inside]), direction=np.array([0.0, 0, 1]),
        normal=np.array([0.0, 1, 0]), base_length=case["length"] + inside,
        base_radius=np.full(n, case["radius"]), density=case["density"], youngs_modulus=E,
        shear_modulus=E / (2 * (1 + case["poissons_ratio"])),
    )  # fmt: skip
    rod.shear_matrix[2, 2] *= case.get("stretch", 1.0)
    simulator.append(rod)
    simulator.constrain(rod).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    if case.get("damping"):
        simulator.dampen(rod).using(
            ea.AnalyticalLinearDamper, damping_constant=case["damping"], time_step=dt
        )
    simulator.add_forcing_to(rod).using(ea.GravityForces, acc_gravity=np.array(case["gravity"]))
    if case.get("cables"):
        # offsets in x and y of the world, in the rod's axes (normal, binormal)
        axes = rod.director_collection[:2, :, 0]
        offsets = np.array([axes @ np.array([*cable, 0.0]) for cable in case["cables"]])
        simulator.add_forcing_to(rod).using(
            Cables, offsets, np.array(case["tensions"]), bool(case.get("whole_cables"))
        )
    if case.get("time_constant"):
        simulator.add_forcing_to(rod).using(Viscosity, case["time_constant"], dt)
    simulator.finalize()
    return rod, simulator, ea.PositionVerlet()


def run(case: dict[str, Any], seconds: float) -> tuple[np.ndarray, float]:
    """t, x, y, z of the tip every `sample` seconds (samples, 4), and the time it took (s)."""
    rod, simulator, stepper = build(case)
    dt = case["dt"]
    every, t, rows = round(case["sample"] / dt), 0.0, [(0.0, *rod.position_collection[:, -1])]
    began = time.perf_counter()
    for k in range(1, round(seconds / dt) + 1):
        t = stepper.step(simulator, t, dt)
        if k % every == 0:
            rows.append((t, *rod.position_collection[:, -1]))
    return np.array(rows), time.perf_counter() - began


def main() -> None:
    """Compile on a short run, then time the whole one as often as the case says."""
    with open(sys.argv[1], encoding="utf-8") as file:
        case = json.load(file)
    _, compiling = run(case, 20 * case["dt"])
    tips, walls = [], []
    for _ in range(case.get("runs", 1)):
        found, wall = run(case, case["seconds"])
        tips.append(found)
        walls.append(wall)
    np.savez(sys.argv[2], tip=tips[0], wall=walls, compiling=compiling, version=VERSION)


if __name__ == "__main__":
    main()
