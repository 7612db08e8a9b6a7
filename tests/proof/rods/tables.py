"""Designed arms compared with closed forms: the tables of docs/rods.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from softdyn import InputError, SoftModel, design, statics
from softdyn.design.quadrature import RULES, Rule
from softdyn.validation.rods.arms import frequencies, model_of, tip
from softdyn.validation.rods.ladder import Ladder
from softdyn.validation.tables import Table
from tests.proof.rods import closed_forms
from tests.proof.rods.closed_forms import Rod

ROD = Rod(1.0, 0.01, 1e10, 0.3, 1e-2)
"""A rod of negligible weight, for statics."""
SLENDER = Rod(1.0, 0.001, 1e9, 0.3, 1e3)
STOCKY = Rod(1.0, 0.01, 1e7, 0.3, 1e3)
THICK = Rod(1.0, 0.1, 1e10, 0.3, 1e-2)
OFFSET = 0.8
"""Offset of a cable, relative to the radius."""
LEVEL = design.Mount(direction=(1.0, 0.0, 0.0))


def arm_of(
    rod: Rod,
    segments: int,
    rule: Rule,
    freedoms: tuple[str, ...] = ("bend_y",),
    cable: design.Cable | None = None,
    discs: int = 0,
) -> design.Arm:
    """A horizontal rod."""
    material = design.Material(rod.modulus, rod.ratio, rod.density)
    section = design.Section(rod.length, rod.radius, material, segments, freedoms, discs=discs)
    cables = (cable,) if cable else ()
    return design.Arm((section,), cables=cables, mount=LEVEL, rule=rule, unusual=True)


@dataclass(frozen=True)
class Case:
    """A figure with a closed form.

    Attributes
    ----------
    name : str
    measure : callable
        Joints, rule → the figure.
    exact : ndarray
        The closed form.
    scale : float
        Scale to which errors are relative.
    """

    name: str
    measure: Callable[[int, Rule], np.ndarray]
    exact: np.ndarray
    scale: float

    def ladder(self, counts: Sequence[int], rule: Rule) -> Ladder:
        """The figure at several numbers of joints."""
        values = np.array([np.atleast_1d(self.measure(n, rule)) for n in counts])
        return Ladder(self.name, tuple(counts), values, self.scale, np.atleast_1d(self.exact))


def cases() -> list[Case]:
    """Every closed form with which designed arms are compared."""
    small = closed_forms.tip_compliance(ROD)
    found = [
        Case("small force at the tip (Euler–Bernoulli)", _compliance(ROD, ("bend_y",)),
             np.array(small), small),
        *_vibrations("Rayleigh, r/L 0.001", SLENDER),
        *_vibrations("Rayleigh, r/L 0.01", STOCKY),
    ]  # fmt: skip
    for degrees in (45, 83):
        force, (along, across) = closed_forms.elastica(ROD, math.radians(degrees))
        name = f"dead force, tip at {degrees}° (elastica)"
        found.append(Case(name, _loaded(force), np.array([along, 0, -across]), ROD.length))
    for degrees, between in ((60, False), (90, False), (90, True), (180, False)):
        found.append(_channel(degrees, between))
    thick = closed_forms.timoshenko_compliance(THICK)
    shear = _compliance(THICK, ("bend_y", "shear_z"))
    found.append(Case("small force, r/L 0.1 (Timoshenko)", shear, np.array(thick), thick))
    return found


def tip_under(model: SoftModel, force: np.ndarray) -> np.ndarray:
    """Equilibrium (3,) of the tip under a constant force (3,) on it and no input (N, m).

    Newton's method on K + g - Jᵀf = 0 in ten steps of load; ∂(Jᵀf)/∂q by differences.
    """
    q, still, h = np.array(model.q0), np.zeros(model.nv), 1e-5

    def pull(at: np.ndarray, f: np.ndarray) -> np.ndarray:
        return model.state(at, still).J.T @ f

    for share in np.linspace(0.1, 1, 10):
        f = share * force
        for _ in range(50):
            state = model.state(q, still)
            r = state.K + state.bias - state.J.T @ f
            if np.abs(r).max() < 1e-11 * np.abs(force).max():
                break
            steps = [h * e for e in np.eye(model.nv)]
            turned = [(pull(q + d, f) - pull(q - d, f)) / (2 * h) for d in steps]
            q = q - np.linalg.solve(model.tangent_stiffness(q) - np.transpose(turned), r)
        else:
            raise InputError("force", "one that the arm can hold", force)
    return model.state(q, still).y


def run(counts: Sequence[int], only: Iterable[Case] | None = None) -> dict[str, list[Ladder]]:
    """Run a ladder of every case, by rule."""
    chosen = cases() if only is None else list(only)
    return {name: [case.ladder(counts, rule) for case in chosen] for name, rule in RULES.items()}


def disc_excess(counts: Sequence[int], degrees: float = 60.0) -> list[float]:
    """Relative excess bending by straight cables between n discs, at n midpoint joints."""
    found = []
    for n in counts:
        cable = design.Cable(math.pi, OFFSET * ROD.radius, True, 1e6)
        model = model_of(arm_of(ROD, n, RULES["midpoint"], cable=cable, discs=n))
        tension = math.radians(degrees) * ROD.EI / (OFFSET * ROD.radius * ROD.length)
        angle = float(np.sum(statics.ramp(model, np.array([tension]))[0].q))
        found.append(abs(angle) / math.radians(degrees) - 1)
    return found


def fastest(counts: Sequence[int], rule: Rule) -> list[float]:
    """Ratio of the fastest mode to the first, which decides the plant's step."""
    layouts = [design.lay_out(arm_of(STOCKY, n, rule)) for n in counts]
    return [float(layout.rates[-1] / layout.rates[0]) for layout in layouts]


def rod_tables(found: Mapping[str, list[Ladder]]) -> str:
    """The tables of docs/rods.md, from what `run` returns."""
    counts = next(iter(found.values()))[0].counts
    numbers = [f"n = {n}" for n in counts]
    forms = [".1e"] * len(counts)
    parts = []
    for rule, ladders in found.items():
        rows = [
            [one.name, *one.errors, "exact" if one.order is None else one.order] for one in ladders
        ]
        speeds = (f"{x:.0f}" for x in fastest(counts, RULES[rule]))
        rows.append(["fastest mode over the first", *speeds, ""])
        table = Table([f"joints by {rule}", *numbers, "order"], rows, ["", *forms, ".1f"])
        parts.append(table.markdown())
    excess = [
        "angle of the tip, more than with a channel that bends by 60°",
        *(f"{x:+.1%}" for x in disc_excess(counts)),
    ]
    parts.append(Table(["straight cables between n discs", *numbers], [excess]).markdown())
    share = 1 - closed_forms.tip_compliance(THICK) / closed_forms.timoshenko_compliance(THICK)
    parts.append(f"Without `shear`, the rod of r/L 0.1 is {share:.1%} too stiff.")
    return "\n\n".join(parts)


# --- the figures --------------------------------------------------------------------------------


def _compliance(rod: Rod, freedoms: tuple[str, ...]) -> Callable[[int, Rule], np.ndarray]:
    def measure(n: int, rule: Rule) -> np.ndarray:
        found = statics.rest(model_of(arm_of(rod, n, rule, freedoms)))
        return found.tip_compliance[2, 2]

    return measure


def _vibrations(name: str, rod: Rod) -> list[Case]:
    @cache
    def found(n: int, rule: Rule) -> np.ndarray:
        return frequencies(model_of(arm_of(rod, n, rule)), 3)

    def measure(k: int) -> Callable[[int, Rule], np.ndarray]:
        return lambda n, rule: found(n, rule)[k]

    exact = closed_forms.rayleigh_frequencies(rod)
    return [
        Case(f"frequency {k + 1} ({name})", measure(k), exact[k], float(exact[k])) for k in range(3)
    ]


def _loaded(force: float) -> Callable[[int, Rule], np.ndarray]:
    return lambda n, rule: tip_under(model_of(arm_of(ROD, n, rule)), np.array([0, 0, -force]))


def _channel(degrees: float, between: bool) -> Case:
    """A cable in a channel; between the two axes of the joints, or across one."""
    side = math.pi * (0.75 if between else 1.0)
    offset, angle = OFFSET * ROD.radius, math.radians(degrees)
    tension = angle * ROD.EI / (offset * ROD.length)
    cable = design.Cable(side, offset, False, 2 * tension)
    freedoms = ("bend_y", "bend_z") if between else ("bend_y",)
    along, across = closed_forms.arc(ROD, angle)
    exact = np.array([along, -across * math.sin(side), across * math.cos(side)])
    name = f"cable in a channel, {degrees}°{' between the axes' if between else ''}"

    def measure(n: int, rule: Rule) -> np.ndarray:
        return tip(model_of(arm_of(ROD, n, rule, freedoms, cable)), [tension])

    return Case(f"{name} (constant curvature)", measure, exact, ROD.length)
