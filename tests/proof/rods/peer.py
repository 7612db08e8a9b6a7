"""The same rod in an independent code: SoRoMoX's piecewise constant strain model (extra `peers`).

Its strains are those of `softdyn.design.strain_basis`, so that M, C q̇, g, K and the tip can be
compared directly at the same coordinates. They differ by the discretisation of the chain, which
vanishes with growing n.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import root

import softdyn
from softdyn import InputError, design, statics
from softdyn.validation.rods.arms import model_of, refined
from softdyn.validation.rods.ladder import Ladder
from softdyn.validation.tables import Table

RUBBER = design.Material(0.25e6, 0.49, 1070.0)
ARM = design.Arm(
    (
        design.Section(0.12, 0.012, RUBBER, 5, ("bend_y", "bend_z", "twist"), name="low"),
        design.Section(0.08, 0.009, RUBBER, 5, ("bend_y", "bend_z", "twist"), name="high"),
    ),
    design.Damping(time_constant=0.01),
    mount=design.Mount(direction=(1.0, 0.0, 0.0)),
    name="two_sections",
)
STRAINS = ("twist", "bend_y", "bend_z", "extension", "shear_y", "shear_z")
"""In the peer's order."""
TIPS = ("tip", "tip at rest")
QUANTITIES = ("M", "C v", "g", "K", *TIPS)
ROUNDS = 200
MOST = 42
"""Joints in each section of `ARM` that a file may hold."""


def build(arm: design.Arm) -> tuple[Any, list[str]]:
    """The peer's model of a horizontal arm, and the names of its coordinates.

    Raises
    ------
    InputError
        The extra is not installed.
    """
    try:
        import jax

        jax.config.update("jax_enable_x64", True)
        from soromox.systems.components import LinkSpec
        from soromox.systems.pcs.pcs import PCS
        from soromox.systems.pcs.structures import PCSStructure
    except ImportError as error:
        raise InputError("--peer", "the extra softdyn[peers]", error) from None
    links, kept, names = [], [], []
    for section in arm.sections:
        radius, material = section.radius, section.material
        links.append(
            LinkSpec.circular(
                length=section.length, radius=radius, density=material.density,
                reference_strain=[0.0, 0, 0, 1, 0, 0], young_modulus=material.youngs_modulus,
                poisson_ratio=material.poissons_ratio,
            )
        )  # fmt: skip
        kept += [strain in section.freedoms for strain in STRAINS]
        names += [f"{s}_{section.name}" for s in STRAINS if s in section.freedoms]
    structure = PCSStructure(num_gauss_points=12, strain_selector=kept)
    model = PCS.from_links(
        links, structure=structure, gravity=jax.numpy.array([0.0, 0, -9.81]),
        base_pose=jax.numpy.array([0.0, 0, 0, 1, 0, 0, 0]),  # scalar last, then position
    )  # fmt: skip
    return model, names


def compare(counts: Sequence[int], arm: design.Arm = ARM, seed: int = 0) -> dict[str, Any]:
    """Ladders of our terms relative to the peer's at one random state, and the time of each.

    Parameters
    ----------
    counts : sequence of int
        Joints in each section.
    arm : Arm
        A horizontal arm of uniform sections.
    seed : int
        Seed of the state.
    """
    import jax

    peer, names = build(arm)
    rng = np.random.default_rng(seed)
    xi, rate = 6.0 * rng.normal(size=len(names)), 6.0 * rng.normal(size=len(names))
    start = time.perf_counter()
    terms = jax.jit(
        lambda q, v: (
            peer.inertia_matrix(q), peer.coriolis_matrix(q, v) @ v, peer.gravitational_force(q),
            peer.elastic_force(q), peer.forward_kinematics(q, jax.numpy.array(arm.length)),
        )
    )  # fmt: skip
    theirs = [np.asarray(x) for x in jax.block_until_ready(terms(xi, rate))]
    compiling = time.perf_counter() - start
    theirs[4] = _position(theirs[4])
    theirs.append(_sag(terms, len(names)))
    ours: dict[str, list[np.ndarray]] = {}
    reduced: Any = None
    for n in counts:
        fine = refined(arm, n)
        reduced = softdyn.reduce(model_of(fine), design.strain_basis(fine))
        order = [reduced.joint_names.index(name) for name in names]
        q, v = np.empty(len(names)), np.empty(len(names))
        q[order], v[order] = xi, rate
        state = reduced.state(q, v)
        found = (
            state.M[np.ix_(order, order)], (state.bias - state.g)[order], state.g[order],
            state.K[order], state.y, statics.settle(reduced, np.zeros(0)).y,
        )  # fmt: skip
        for name, value in zip(QUANTITIES, found, strict=True):
            ours.setdefault(name, []).append(np.ravel(value))
    ladders = []
    for (name, values), exact in zip(ours.items(), theirs, strict=True):
        scale = arm.length if name in TIPS else float(np.linalg.norm(exact))
        ladders.append(Ladder(name, tuple(counts), np.array(values), scale, np.ravel(exact)))
    full = reduced.full
    at = reduced.expand(q), reduced.S @ v
    return {
        "ladders": ladders,
        "compiling_s": compiling,
        "peer_us": _median(lambda: jax.block_until_ready(terms(xi, rate))),
        "state_us": _median(lambda: full.state(*at)),
        "reduced_us": _median(lambda: reduced.state(q, v)),
        "peer_coordinates": len(names),
        "joints": full.nv,
    }


def peer_table(found: dict[str, Any]) -> str:
    """The comparison as a table and a line of times."""
    ladders: list[Ladder] = found["ladders"]
    counts = ladders[0].counts
    table = Table(
        ["against the peer", *(f"n = {n}" for n in counts), "order"],
        [[one.name, *one.errors, one.order] for one in ladders],
        ["", *[".1e"] * len(counts), ".1f"],
    )
    times = (
        f"One evaluation: peer {found['peer_us']:.0f} µs at {found['peer_coordinates']}"
        f" coordinates, after {found['compiling_s']:.0f} s of compiling;"
        f" `state` {found['state_us']:.0f} µs at {found['joints']} joints,"
        f" reduced {found['reduced_us']:.0f} µs."
    )
    return f"{table.markdown()}\n\n{times}"


def _sag(terms: Callable[..., Any], size: int) -> np.ndarray:
    """Tip (3,) of the peer at equilibrium under its weight: g + K = 0, in four steps of load."""
    xi, still = np.zeros(size), np.zeros(size)
    for share in (0.25, 0.5, 0.75, 1.0):

        def left(q: np.ndarray, share: float = share) -> np.ndarray:
            _, _, g, K, _ = terms(q, still)
            return share * np.asarray(g) + np.asarray(K)

        found = root(left, xi, tol=1e-12)
        xi = found.x
    return _position(np.asarray(terms(xi, still)[4]))


def _position(pose: np.ndarray) -> np.ndarray:
    return pose[:3, 3] if pose.shape == (4, 4) else pose[:3]


def _median(call: Callable[[], Any]) -> float:
    """Median time of a call (µs)."""
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times))
