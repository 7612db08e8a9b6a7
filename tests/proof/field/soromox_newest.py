"""A published rod of constant strains with SoRoMoX 0.5, in its environment, without softdyn.

    python soromox_newest.py planar|spatial SECONDS RUNS OUT.npz

The numbers are those of the published scripts, which need an older SoRoMoX. There parameters were
arrays of the whole robot; now each link has its own, and the base's pose belongs to the model.
"""

from __future__ import annotations

import sys
import time
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from diffrax import Tsit5
from soromox.systems import PCS, PlanarPCS, SystemState
from soromox.systems.components import LinkSpec

jax.config.update("jax_enable_x64", True)
G, LENGTH, RADIUS, SHEAR, YOUNG, DENSITY = 9.81, 0.3, 0.03, 3.333333e5, 1e6, 1000.0
CASES = {
    "planar": (PlanarPCS, [0.0, 1, 0], [2.0, 1e3, 1e3], [-G, 0], [np.pi / 2, 0, 0], np.s_[:, 1:]),
    "spatial": (
        PCS, [0.0, 0, 0, 1, 0, 0], [2.0, 2, 2, 1e3, 1e3, 1e3], [-G, -G, 0],
        # the scalar of a quaternion was its first number, and is its last one
        [0.5, -0.5, 0.5, 0.5, 0, 0, 0], np.s_[:, :3, 3],  # of a homogeneous matrix
    ),
}  # fmt: skip


def main() -> None:
    """Roll once to compile, then as often as asked."""
    name, seconds, runs, out = sys.argv[1], float(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
    family, straight, damping, gravity, base, place = CASES[name]
    link = LinkSpec.circular(
        length=LENGTH, radius=RADIUS, density=DENSITY, reference_strain=straight,
        young_modulus=YOUNG, shear_modulus=SHEAR,
        damping=jnp.diag(1e-2 * LENGTH * jnp.array(damping)),
    )  # fmt: skip
    robot = family.from_links([link, link], gravity=jnp.array(gravity), base_pose=jnp.array(base))
    n = 2 * len(straight)
    start = SystemState(t=0.0, y=jnp.zeros(2 * n))
    walls = []
    for _ in range(runs + 1):
        began = time.perf_counter()
        rolled = robot.rollout_to(
            initial_state=start, u=jnp.zeros(n), t1=seconds, solver_dt=1e-4, save_dt=1e-2,
            solver=Tsit5(), max_steps=None,
        )  # fmt: skip
        jax.block_until_ready(rolled.y)
        walls.append(time.perf_counter() - began)
    tip = jax.jit(lambda q: robot.forward_kinematics(q, s=jnp.array(2 * LENGTH)))
    poses = np.array(jax.vmap(tip)(rolled.y[:, :n]))
    tips = poses[place]
    if tips.shape[1] == 2:  # x, z of a planar robot
        tips = np.insert(tips, 1, 0.0, axis=1)
    np.savez(out, tip=tips, wall=walls[1:], version=version("soromox"))


if __name__ == "__main__":
    main()
