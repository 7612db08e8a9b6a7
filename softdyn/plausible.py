"""Rules for numbers that are valid and not plausible: ratios to weight, stiffness and period.

A wrong unit changes a ratio by 10³ or 10⁶, whatever the robot's size. `softdyn check` reports what
these rules find, `softdyn new` refuses it, and a rig's times are held against the control period.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from softdyn.description.rig import LONGEST_DELAY

WEIGHT = 1e4
"""m g L Σ 1/k of an arm of weight m g, length L and springs k: 8 times its sag over its length."""
BEND = 0.03, 300.0
"""Angle (rad) by which a pull alone bends the weightless arm. The upper bound is for design."""
STRONG = 100.0, 30.0
"""A pull is too strong if it bends the weightless arm by more than this (rad), and if its moment is
more than so many times that of the arm's weight about its base."""
PRESSURE = 500.0, 1e7
"""Largest pressure (Pa) of a chamber: a soft balloon, a hydraulic muscle."""
VACUUM = 101325.0
"""The pressure (Pa) of the air; no gauge pressure is further below 0."""
SLOW = 1.0, 100.0
"""A rig's time is doubtful if it is more than this (s), and so many control periods."""


def too_heavy(weight: float) -> bool:
    """Whether m g L Σ 1/k, the weight against the springs, is not plausible."""
    return weight > WEIGHT


def too_strong(bend: float, moment: float) -> bool:
    """Whether a pull is not plausible.

    Parameters
    ----------
    bend : float
        Angle (rad) by which it alone bends the weightless arm.
    moment : float
        Its largest moment over that of the arm's weight, m g L.
    """
    return bend > STRONG[0] and moment > STRONG[1]


def implausible_pressures(name: str, lower: float, upper: float) -> Iterator[str]:
    """One line for each bound (Pa) of a chamber's pressure that is not plausible."""
    largest = max(-lower, upper)
    if 0 < largest < PRESSURE[0]:
        yield f"{name}: a pressure of at most {largest:g} Pa: in kPa or bar?"
    if largest > PRESSURE[1]:
        yield f"{name}: a pressure of {largest:.3g} Pa, {largest / 1e5:.3g} bar: in another unit?"
    if lower < -VACUUM:
        yield f"{name}: a gauge pressure of {lower:g} Pa, below a vacuum of {-VACUUM:g} Pa"


def emptied_chambers(
    arms: np.ndarray,
    stiffness: np.ndarray,
    forces: np.ndarray,
    growths: Sequence[Sequence[float]],
    lengths: Sequence[float],
) -> Iterator[tuple[int, str, str]]:
    """Inputs whose area is not above 0 at a stretch λ that all inputs together reach.

    The robot is weightless, and its moment arms are constant. A joint without a spring does not
    move.

    Parameters
    ----------
    arms : ndarray, (m, n)
        Moment arms of the tendon of each input (m/rad, m/m).
    stiffness : ndarray, (n,)
        Stiffness of each joint.
    forces : ndarray, (2, m)
        Least and largest force of each input along its tendon (N).
    growths : sequence of sequence of float, (m,)
        The coefficients g of A(λ) / A(1) = 1 + g₁ (λ - 1) + g₂ (λ - 1)² + …; none of an input
        that has none.
    lengths : sequence of float, (m,)
        Length of each tendon at λ = 1 (m).

    Yields
    ------
    The number of the input, what is expected, and what was got.
    """
    firm = stiffness > 0
    for k, (growth, length) in enumerate(zip(growths, lengths, strict=True)):
        if not growth:
            continue
        moved = arms[:, firm] @ (arms[k, firm] / stiffness[firm]) * forces / length
        low, high = 1.0 + moved.min(axis=0).sum(), 1.0 + moved.max(axis=0).sum()
        at = np.linspace(low, high, 201)
        share = np.polynomial.polynomial.polyval(at - 1.0, (1.0, *growth))
        if share.min() <= 0:
            expected = f"an area > 0 at stretches from {low:.3g} to {high:.3g}, which inputs reach"
            least = int(np.argmin(share))
            yield k, expected, f"{share[least]:.3g} times that of rest at {at[least]:.3g}"


def too_slow(name: str, value: float, period: float) -> str | None:
    """One line about a time (s) of a rig, if it is not plausible with this control period (s)."""
    if not (value > SLOW[0] and value > SLOW[1] * period):
        return None
    return f"{name} of {value:g} s is {value / period:.3g} control periods: in ms?"


def beyond_seconds(value: object) -> str | None:
    """A word of doubt about a time (s) that is longer than the longest delay, else None."""
    if isinstance(value, int | float) and value > LONGEST_DELAY:
        return f"{value:g}: in ms?"
    return None
