"""Causes in the bodies: mass, centre of mass, inertia, link by link if possible."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from softdyn.description.inertia import Inertia
from softdyn.validation.mjcf.comparison.finding import Finding, differ, share
from softdyn.validation.mjcf.comparison.matching import plain_name
from softdyn.validation.mjcf.comparison.neutral import Neutral, Part

NOTHING = 1e-12  # m, and relative


def find_body(a: Neutral, b: Neutral, k: int) -> Iterator[Finding]:
    """Findings on mass, centre and inertia of part k; by link if both files have the same links."""
    one, other = a.parts[k], b.parts[k]
    if _alike(one.inertia, other.inertia):
        return
    ours, theirs = _pieces(one), _pieces(other)
    if ours.keys() == theirs.keys() and len(ours) > 1:
        for key in ours:
            yield from _piece(k, key, *ours[key], theirs[key][1], a.extent(k))
        return
    where = one.link or one.name
    if (blamed := _one_piece(k, one, other, a.extent(k))) is not None:
        yield from blamed
        return
    yield from _differences(
        where, one.inertia, other.inertia, lambda inertia: _lump(k, inertia), a.extent(k)
    )


def _pieces(part: Part) -> dict[str, tuple[str, Inertia]]:
    """Pieces by plain name; the part's own link has none, because the joint matches it."""
    return {
        "" if name == part.link else plain_name(name): (name, piece) for name, piece in part.pieces
    }


def _lump(k: int, inertia: Inertia) -> Callable[[Neutral], Neutral]:
    def repair(robot: Neutral) -> Neutral:
        part = robot.parts[k]
        return robot.with_part(k, replace(part, pieces=((part.link, inertia),)))

    return repair


def _piece(
    k: int, key: str, name: str, one: Inertia, other: Inertia, extent: float
) -> Iterator[Finding]:
    """Findings on one of several links that are fixed to each other."""

    def put(inertia: Inertia) -> Callable[[Neutral], Neutral]:
        def repair(robot: Neutral) -> Neutral:
            part = robot.parts[k]
            pieces = tuple(
                (label, inertia if plain == key else piece)
                for plain, (label, piece) in _pieces(part).items()
            )
            return robot.with_part(k, replace(part, pieces=pieces))

        return repair

    yield from _differences(name, one, other, put, extent)


def _alike(one: Inertia, other: Inertia, slack: float = 1e-12) -> bool:
    """Whether two bodies are equal up to rounding."""
    length = float(np.linalg.norm(one.com)) + 1e-3
    scale = float(np.linalg.norm(one.tensor)) + one.mass * (1e-3 * length) ** 2
    return (
        abs(one.mass - other.mass) <= slack * one.mass
        and float(np.linalg.norm(one.com - other.com)) * bool(one.mass) <= slack * length
        and float(np.linalg.norm(one.tensor - other.tensor)) <= slack * scale
    )


def _welded(k: int, rest: Inertia, piece: Inertia) -> Callable[[Neutral], Neutral]:
    return _lump(k, rest + piece)


def _same_centre(one: Inertia, other: Inertia) -> bool:
    gap = float(np.linalg.norm(one.com - other.com))
    return gap <= 1e-9 * (float(np.linalg.norm(one.com)) + 1e-3)


def _one_piece(k: int, one: Part, other: Part, extent: float) -> list[Finding] | None:
    """The finding on one link that explains how two lumped bodies differ; None if none does."""
    for part, whole, swapped in ((one, other.inertia, False), (other, one.inertia, True)):
        if len(part.pieces) < 2:
            continue
        for index, (name, piece) in enumerate(part.pieces):
            rest = sum((p for m, (_, p) in enumerate(part.pieces) if m != index), Inertia.zero())
            gained = whole.mass - part.inertia.mass
            moment = whole.mass * whole.com - part.inertia.mass * part.inertia.com
            if piece.mass <= 0:
                continue
            heavier = replace(piece, mass=piece.mass + gained)
            if abs(heavier.mass) <= NOTHING * whole.mass:  # the other file has no such link
                heavier = replace(heavier, mass=0.0)
            if _same_centre(rest + heavier, whole):
                # its mass explains the centre; the rest of the tensor's difference is its own
                gap = whole.tensor - (rest + heavier).tensor
                heavier = replace(heavier, tensor=heavier.tensor + gap)
            shifted = replace(piece, com=piece.com + moment / piece.mass)
            for changed in (heavier, shifted):
                if changed.mass >= 0 and _alike(rest + changed, whole, 1e-9):
                    pair = (changed, piece) if swapped else (piece, changed)
                    where = name or part.link or part.name
                    return list(_differences(where, *pair, partial(_welded, k, rest), extent))
    return None


def _differences(
    where: str,
    one: Inertia,
    other: Inertia,
    put: Callable[[Inertia], Callable[[Neutral], Neutral]],
    extent: float,
) -> Iterator[Finding]:
    """Findings on mass, centre, inertia of one body; `put` turns an inertia into a repair."""
    if abs(one.mass - other.mass) > NOTHING * max(one.mass, other.mass):
        change = f"{100 * (other.mass / one.mass - 1):+.3g} %" if one.mass else "of nothing"
        kept = Inertia(one.mass, other.com, other.tensor)
        printed = differ(one.mass, other.mass)
        yield Finding("mass", where, (one.mass, other.mass), change, put(kept), printed=printed)
    gap = float(np.linalg.norm(one.com - other.com))
    if one.mass and gap > NOTHING:
        values = vector(one.com), vector(other.com)
        kept = Inertia(one.mass, one.com, other.tensor)
        yield Finding(
            "centre", where, values, f"{1e3 * gap:.4g} mm apart", put(kept),
            printed=share(gap, extent),
        )  # fmt: skip
    scale = float(np.linalg.norm(one.tensor))
    if (gap := float(np.linalg.norm(one.tensor - other.tensor))) > NOTHING * scale:
        tensors = _tensor(one), _tensor(other)
        change = _turned_or_scaled(one, other) if one.mass else "of nothing"
        yield Finding("inertia", where, tensors, change, put(one), printed=share(gap, scale))


def _tensor(body: Inertia) -> list[float]:
    """xx, yy, zz, xy, xz, yz about the centre, in the root's axes."""
    t = body.tensor
    return vector(np.array([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]]))


def _turned_or_scaled(one: Inertia, other: Inertia) -> str:
    """Whether a tensor was turned, scaled, or differs otherwise."""
    first, second = np.linalg.eigvalsh(one.tensor), np.linalg.eigvalsh(other.tensor)
    if np.allclose(first, second, rtol=1e-6, atol=1e-9 * abs(first).max()):
        return "turned"
    ratio = float(np.trace(other.tensor) / np.trace(one.tensor)) if first.any() else 0.0
    slack = 1e-9 * abs(second).max()
    if ratio and np.allclose(ratio * one.tensor, other.tensor, rtol=1e-6, atol=slack):
        return f"scaled by {ratio:.6g}"
    gap = np.linalg.norm(other.tensor - one.tensor) / (np.linalg.norm(one.tensor) or 1.0)
    return f"{100 * gap:.3g} % apart"


def vector(values: np.ndarray) -> list[float]:
    """An array as plain numbers."""
    return [float(value) for value in values]
