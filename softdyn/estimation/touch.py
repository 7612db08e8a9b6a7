"""Which link is touched: a likelihood ratio of a constant force on each link against none.

For each link a filter estimates a force at its centre of mass, with the prior N(0, P₀). Over the
tested span it ends at f̂ with the covariance P. The readings alone then have the information
Λ = P⁻¹ - P₀⁻¹, and twice the logarithm of the generalised likelihood ratio (Willsky and Jones 1976)
of a constant force against none is

    (P⁻¹ f̂)ᵀ Λ⁺ P⁻¹ f̂.

Without a force it is chi-squared with the rank of Λ as its degrees of freedom, if the filter is
consistent. The links share the rate of false alarms equally (Bonferroni). The most likely link is
the one whose filter gives the readings the largest likelihood: the least ΣNIS + ln det(P₀ P⁻¹), up
to terms that all filters share.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from softdyn.checks import array, number
from softdyn.description.rig import Sensor
from softdyn.description.robot import Joint, Link, Origin, Robot
from softdyn.description.urdf_writer import write
from softdyn.dynamics.model import SoftModel
from softdyn.estimation.balance import Disturbance
from softdyn.estimation.ekf import FROM_FILE, Ekf
from softdyn.estimation.parameters import EkfParameters
from softdyn.exceptions import InputError
from softdyn.loading import load_text

LEVEL = 0.01  # the default rate of false alarms
SHOWN = 1e-3  # of 1 / P₀; directions with less information are not tested
CONSTANT = 1e9  # s, the memory of a force that does not change
POINT = "softdyn.touched"  # a link's point in its filter's robot


@dataclass(frozen=True, eq=False)
class TouchTest:
    """A test of each link for a constant force.

    Attributes
    ----------
    links : tuple of str
        The links that the sensors show.
    statistics : ndarray, (L,)
        Twice the logarithm of each link's likelihood ratio.
    ranks : ndarray of int, (L,)
        Its degrees of freedom.
    chances : ndarray, (L,)
        The chance of a larger statistic without a force.
    misfits : ndarray, (L,)
        -2 times the logarithm of each link's likelihood, above the least one.
    forces : ndarray, (L, 3)
        The force (N) on each link, in the world's axes, if it alone is touched.
    false_alarms : float
        The rate of false alarms over all links.
    """

    links: tuple[str, ...]
    statistics: np.ndarray
    ranks: np.ndarray
    chances: np.ndarray
    misfits: np.ndarray
    forces: np.ndarray
    false_alarms: float

    @property
    def touched(self) -> str | None:
        """The most likely link, or None without an alarm."""
        if not np.any(self.chances < self.false_alarms / len(self.links)):
            return None
        return self.links[int(np.argmin(self.misfits))]

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain data."""
        columns = (self.statistics, self.ranks, self.chances, self.misfits, self.forces)
        rows = zip(self.links, *(column.tolist() for column in columns), strict=True)
        names = ("link", "statistic", "rank", "chance", "misfit", "force_N")
        return {
            "touched": self.touched, "false_alarms": self.false_alarms,
            "links": [dict(zip(names, row, strict=True)) for row in rows],
        }  # fmt: skip

    def __str__(self) -> str:
        width = max(4, *(len(name) for name in self.links))
        lines = [f"{'link':{width}}  statistic  rank     chance    misfit  force (N)"]
        lines += [
            f"{row['link']:{width}}  {row['statistic']:9.1f}  {row['rank']:4}  "
            f"{row['chance']:9.2g}  {row['misfit']:8.1f}  "
            + " ".join(f"{part:.3g}" for part in row["force_N"])
            for row in self.to_dict()["links"]
        ]
        found = "no link" if self.touched is None else self.touched
        return "\n".join([*lines, f"touched: {found} ({self.false_alarms:g} false alarms)"])


def find_touch(
    model: SoftModel,
    t: np.ndarray,
    readings: np.ndarray,
    u: np.ndarray,
    sensors: str | Iterable[Sensor] = FROM_FILE,
    *,
    parameters: EkfParameters | None = None,
    begin: float = 0.0,
    false_alarms: float = LEVEL,
) -> TouchTest:
    """Test recorded data for a constant force on some link, from `begin` to the end.

    Parameters
    ----------
    model : SoftModel
        The robot.
    t : array_like, (N,)
        Times (s).
    readings : array_like, (N, k)
        The sensors' readings, NaN for one that is not there.
    u : array_like, (N, nu)
        The commands that had been sent before each time, as `Ekf.step` takes them.
    sensors, parameters
        As of `Ekf`; `tip_force` is the deviation P₀ of each component.
    begin : float
        Time (s) from which the force may act; the filters only follow the robot before.
    false_alarms : float
        Rate of false alarms over all links.

    Raises
    ------
    InputError
        As `Ekf` does; arrays of other shapes, a time after the end, a rate outside (0, 1), a robot
        on whose links the sensors show no force.
    """
    t = array("t", t, (np.size(t),))
    rows = array("readings", readings, (len(t), *np.shape(readings)[1:]), finite=False)
    sent = array("u", u, (len(t), model.nu), finite=False)
    if number("false_alarms", false_alarms, above=0.0) >= 1:
        raise InputError("false_alarms", "a number < 1", repr(false_alarms))
    if not np.any(t > number("begin", begin)):
        raise InputError("begin", f"a time before the last one, {t[-1]:g} s", repr(begin))
    given = replace(EkfParameters() if parameters is None else parameters, memory=CONSTANT)
    chosen: tuple[Any, ...] = model.robot.sensors if sensors == FROM_FILE else tuple(sensors)
    found = []
    for link in model.robot.links:
        if link.mass > 0:
            text = write(_with_point(model.robot, link))
            own = load_text(text, path=model.robot.path)
            observer = Ekf(own, chosen, [Disturbance.TIP_FORCE], parameters=given)
            part = _statistic(observer, t, rows, sent, begin)
            if part[1] > 0:
                found.append((link.name, *part))
    if not found:
        raise InputError("sensors", "some that show a force on a link", "none that does")
    names, statistics, ranks, misfits, forces = zip(*found, strict=True)
    return TouchTest(
        names, np.array(statistics), np.array(ranks), chdtrc(ranks, statistics),
        np.array(misfits) - min(misfits), np.array(forces), false_alarms,
    )  # fmt: skip


def _with_point(robot: Robot, link: Link) -> Robot:
    """The robot whose task is a link's centre of mass."""
    fixed = Joint(POINT, "fixed", link.name, POINT, Origin(xyz=link.origin.xyz))
    return replace(
        robot,
        links=(*robot.links, Link(POINT)),
        joints=(*robot.joints, fixed),
        task=POINT,
        tasks=(),
    )


def _statistic(
    observer: Ekf, t: np.ndarray, readings: np.ndarray, sent: np.ndarray, begin: float
) -> tuple[float, int, float, np.ndarray]:
    """The statistic, its rank, the misfit, and the force (3,) that the readings alone show."""
    name, prior = Disturbance.TIP_FORCE.value, observer.parameters.tip_force
    observer.suppose(name, 0.0)
    waits, nis = True, 0.0
    for at, row, command in zip(t, readings, sent, strict=True):
        if waits and at >= begin:
            observer.suppose(name, prior)
            waits = False
        estimate = observer.step(at, row, command)
        nis += 0.0 if waits else estimate.nis
    inverse = np.linalg.inv(observer.covariance_of(name))
    values, axes = np.linalg.eigh(inverse - np.eye(3) / prior**2)
    seen = values > SHOWN / prior**2
    shown = axes[:, seen].T @ (inverse @ estimate.disturbances[name])
    force = axes[:, seen] @ (shown / values[seen])
    misfit = nis + np.linalg.slogdet(inverse * prior**2)[1]
    return float(np.sum(shown**2 / values[seen])), int(seen.sum()), float(misfit), force
