"""The result of a comparison; its text is the table that the command prints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from softdyn.validation.mjcf.comparison.dynamics import QUANTITIES
from softdyn.validation.tables import Table

SHOWN = ("M", "bias", "g", "tip")  # the effects on the motion without inputs
# effects in the table: title, name; those after the first three only where there are some
EFFECTS = (
    ("M", "M"), ("g", "g"), ("tip", "tip"), ("inputs", "B"), ("rest", "rest"), ("forces", "forces"),
)  # fmt: skip
ALWAYS = 3
CAUSE_TITLES = ("kind", "where", "A", "B", "")
ROUNDING = 1e-5  # relative: two files with six significant digits differ by so much at most
EXPLAINED = 1e-9  # largest residual after the repair of all causes
WIDEST = 48  # characters of a value in the table; JSON has the full value


@dataclass(frozen=True)
class Cause:
    """One cause of a difference between the robots.

    Attributes
    ----------
    kind, where : str
        Kind of the cause, and the joint, link, tendon or actuator of A.
    a, b : Any
        The files' values; None if a file states none.
    effect : dict[str, float]
        Relative change at random states of ``M``, ``bias``, ``g``, of the ``tip`` (of the robot's
        extent) and of q̈ (``qdd``, for any force); of the ``value`` if it affects none of these. Of
        the matrix ``B`` from inputs to joint forces, of the tip at ``rest`` under weight and
        springs (of the extent), and of q̈ by ``forces`` of springs, dampers and dry friction.
    detail : str
        The difference in words.
    one_sided : bool
        Whether only one file, or only its format, states it, and the motion does not depend on it.
    alone : bool
        Whether only one file, or only its format, states it.
    printed : float
        Relative difference of the values as files print them; see `compare`'s tolerance. Infinite
        for what is no number.
    """

    kind: str
    where: str
    a: Any
    b: Any
    effect: dict[str, float]
    detail: str
    one_sided: bool
    printed: float = math.inf
    alone: bool = False

    @property
    def weight(self) -> float:
        """The largest effect on the motion without inputs and springs."""
        return max((v for key, v in self.effect.items() if key in SHOWN), default=0.0)

    @property
    def largest(self) -> float:
        """The largest effect, which sorts the causes."""
        return max(self.weight, *(self.effect.get(name, 0.0) for _, name in EFFECTS[ALWAYS:]))

    def to_dict(self) -> dict[str, Any]:
        """The cause as plain data; figures that are not finite are None."""
        return {
            "kind": self.kind,
            "where": self.where,
            "a": self.a,
            "b": self.b,
            "effect": {key: _finite(value) for key, value in self.effect.items()},
            "detail": self.detail,
            "one_sided": self.one_sided,
            "printed": _finite(self.printed),
        }


@dataclass(frozen=True)
class RepairStep:
    """The remaining difference after a repair: relative errors of `QUANTITIES`."""

    repaired: str
    left: dict[str, float]


@dataclass(frozen=True)
class Worst:
    """The state at which a quantity differs most: relative error, coordinates by joint of A."""

    quantity: str
    error: float
    q: dict[str, list[float]]


@dataclass(frozen=True)
class Comparison:
    """Whether two files describe one robot, and their differences.

    Attributes
    ----------
    a, b : str
        The files.
    matched : dict[str, str]
        Joints of A → joints of B.
    how : dict[str, str]
        Joint of A → how it was matched: map, name, like name, kinematics, base.
    unmatched : dict[str, list[str]]
        Joints that only ``a`` or only ``b`` has.
    causes : tuple of Cause
        Causes, the largest effect first, one-sided ones last.
    waterfall : tuple of RepairStep
        The difference before any repair, then after the repair of each kind of cause in turn.
    residual : dict[str, float]
        Relative errors after all repairs.
    strict : bool
        Whether properties that only one file states fail, too.
    notes : tuple of str
        Parts that the comparison leaves out, with the prefix ``A:`` or ``B:``.
    seconds : float
        Time of the comparison (s).
    turns : dict[str, tuple[float, float]]
        Joint of A → sense and zero, if B's differ: q of A = sense · q of B + zero.
    worst : tuple of Worst
        The random states at which the files differ most before any repair.
    tolerance : float
        Largest relative difference of values that count as equal.
    within : tuple of Cause
        Differences within the tolerance; they are no causes.
    """

    a: str
    b: str
    matched: dict[str, str]
    how: dict[str, str]
    unmatched: dict[str, list[str]]
    causes: tuple[Cause, ...]
    waterfall: tuple[RepairStep, ...]
    residual: dict[str, float]
    strict: bool
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    turns: dict[str, tuple[float, float]] = field(default_factory=dict)
    worst: tuple[Worst, ...] = ()
    tolerance: float = 0.0
    within: tuple[Cause, ...] = ()

    @property
    def explained(self) -> bool:
        """Whether nothing is left after the repair of all causes."""
        alike = bool(self.matched) or not any(self.unmatched.values())
        return alike and all(v <= EXPLAINED for v in self.residual.values())

    @property
    def passed(self) -> bool:
        """Whether the files agree: no cause changes the motion, or what both files state.

        One-sided causes count with `strict` only.

        Then both files must also have all joints, and the same parts left out.
        """
        failing = [cause for cause in self.causes if self.strict or not cause.one_sided]
        partial = self.strict and (any(self.unmatched.values()) or not self.same_notes)
        return self.explained and not failing and not partial

    @property
    def same_notes(self) -> bool:
        """Whether the same parts were left out of both files."""
        ours, theirs = ({n[3:] for n in self.notes if n.startswith(s)} for s in ("A: ", "B: "))
        return ours == theirs

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data; figures that are not finite are None."""
        return {
            "a": self.a,
            "b": self.b,
            "passed": self.passed,
            "explained": self.explained,
            "matched": self.matched,
            "matched_by": self.how,
            "unmatched": self.unmatched,
            "causes": [cause.to_dict() for cause in self.causes],
            "tolerance": self.tolerance,
            "within": [cause.to_dict() for cause in self.within],
            "waterfall": [
                {"repaired": step.repaired, **{k: _finite(v) for k, v in step.left.items()}}
                for step in self.waterfall
            ],
            "residual": {key: _finite(value) for key, value in self.residual.items()},
            "turns": {
                joint: {"sense": sense, "zero": zero} for joint, (sense, zero) in self.turns.items()
            },
            "worst": [
                {"quantity": w.quantity, "error": _finite(w.error), "q": w.q} for w in self.worst
            ],
            "strict": self.strict,
            "notes": list(self.notes),
            "seconds": self.seconds,
        }

    @property
    def verdict(self) -> str:
        """The answer in one line."""
        if not self.matched and not self.explained:
            return "no joint of one file matches one of the other: two robots"
        if not self.explained:
            return "UNEXPLAINED: the files differ by more than the causes found"
        kinds = list(dict.fromkeys(c.kind for c in self.causes if not c.one_sided))
        apart = list(dict.fromkeys(c.kind for c in self.causes if c.one_sided))
        words = f"the files differ: {', '.join(kinds)}" if kinds else "the files agree"
        if apart:
            words += f"; only one states {', '.join(apart)}"
        if self.within:
            worst = max(self.within, key=lambda cause: cause.printed)
            words += (
                f"; differences within {self.tolerance:g}: {len(self.within)}, the largest "
                f"{worst.printed:.2g} ({worst.kind} of {worst.where})"
            )
        return words

    def __str__(self) -> str:
        renamed = [f"{p} = {q}" for p, q in self.matched.items() if p != q]
        head = f"A: {self.a}\nB: {self.b}\n{len(self.matched)} joints matched"
        if renamed:
            head += ": " + ", ".join(renamed)
        for side, names in self.unmatched.items():
            if names:
                head += f"\nonly in {side.upper()}: {', '.join(names)}"
        parts = [head]
        for one_sided, title in (
            (False, "causes"),
            (True, "stated by one file only, without effect on the motion"),
        ):
            causes = [cause for cause in self.causes if cause.one_sided == one_sided]
            rows = _grouped(causes) if one_sided else [_row(cause) for cause in causes]
            if rows:
                kept = [k for k in range(len(EFFECTS)) if k < ALWAYS or any(row[k] for row in rows)]
                titles = [*(EFFECTS[k][0] for k in kept), *CAUSE_TITLES]
                formats = [*[".1e"] * len(kept), *[""] * len(CAUSE_TITLES)]
                rows = [[*(row[k] for k in kept), *row[len(EFFECTS) :]] for row in rows]
                parts.append(f"{title}\n{Table(titles, rows, formats).text()}")
        if self.waterfall:
            left = [("error left in", "", ""), *((name, name, ".1e") for name in QUANTITIES)]
            steps = ({"": step.repaired, **step.left} for step in self.waterfall)
            parts.append(Table.of(left, steps).text())
        parts += [f"note: {note}" for note in self.notes]
        small = sum(c.printed <= ROUNDING and not c.one_sided for c in self.causes)
        if small and self.tolerance < ROUNDING:
            parts.append(
                f"note: {small} of the causes within {ROUNDING:g}, the rounding of six digits; "
                f"--tolerance {ROUNDING:g} leaves them out"
            )
        parts.append(self.verdict)
        return "\n\n".join(parts)


def _row(cause: Cause) -> list[Any]:
    figures = [cause.effect.get(name) or None for _, name in EFFECTS]
    return [*figures, cause.kind, cause.where, _value(cause.a), _value(cause.b), cause.detail]


def _grouped(causes: list[Cause]) -> list[list[Any]]:
    """One row for equal values that only one file states, with their largest effect."""
    groups: dict[tuple[str, ...], list[Cause]] = {}
    for cause in causes:
        plain = cause.kind not in ("tendon", "actuator")
        values = (_value(cause.a), _value(cause.b)) if plain else ("", "")
        key = (cause.kind, *values, str(cause.a is None), str(cause.b is None))
        groups.setdefault(key, []).append(cause)
    rows = []
    for group in groups.values():
        row = _row(group[0])
        if len(group) > 1:
            row[len(EFFECTS) + 1] = f"{len(group)}: {group[0].where} …"
        rows.append(row)
    return rows


def _value(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        shown = [_value(item) for item in value[:3]]
        return " ".join(shown) + (" …" if len(value) > 3 else "")
    text = str(value)
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 2]} …"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
