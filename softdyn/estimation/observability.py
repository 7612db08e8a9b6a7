"""How well and how fast sensors show a robot's state, at an equilibrium and along a run.

The filter itself answers, with its stops, rates and latencies: it gets the readings of a robot that
rests, without noise, from a start that is wrong in every joint. Its Riccati recursion gives the
expected errors. A second filter without readings gives the errors that the model alone leaves. With
their covariances P and P₀ of q, a direction x is seen if xᵀ P x < xᵀ P₀ x / 4. Along a run the
readings have noise: a filter that knows little follows it into wrong shapes while the robot moves,
and no equilibrium shows this. The process noise stays at `EkfParameters.process` in both filters,
because readings without noise would lower that of one. So their errors are those of a model that
lacks forces. A third filter, with `EkfParameters.least_process`, gives the error where the model is
right.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import eigh

from softdyn.actuation import Winches
from softdyn.checks import number
from softdyn.description.rig import Sensor
from softdyn.description.robot import sliding
from softdyn.dynamics.balance import Disturbance
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.stops import Stops
from softdyn.estimation.arrivals import sensor_channels
from softdyn.estimation.ekf import FROM_FILE, Ekf
from softdyn.estimation.parameters import EkfParameters
from softdyn.sensing import Sensors
from softdyn.statics import Equilibrium

WRONG = 0.2  # rad, and share of a slide's range: the start is as wrong in every joint
WITHIN = 3.0  # deviations of the tip; an error that stays within them is forgotten
SEEN = 0.25  # of the variance that the model alone leaves


@dataclass(frozen=True, eq=False)
class Observability:
    """The expected errors of a robot's state, and how fast they fall.

    Attributes
    ----------
    joint_names : tuple of str
        The order of the joints.
    blind, deviations : ndarray, (nv,)
        Expected error of each joint (rad, m) at the end, without readings and with them.
    seen, free : int
        Directions of q that the sensors show, of those that no stop holds.
    tip, tip_if_right : float
        Expected error of the tip (m), ‖·‖; and where the model is right.
    links : dict of str to float
        Expected error of each link's origin (m).
    t, tip_error, shape_error : ndarray, (N,)
        Time (s), and from the wrong start the tip's error (m) and the largest of the joints' errors
        (rad, m).
    forgotten : float or None
        The time (s) after which the tip's error stays within 3 of its deviations; None for never.
    """

    joint_names: tuple[str, ...]
    blind: np.ndarray
    deviations: np.ndarray
    seen: int
    free: int
    tip: float
    tip_if_right: float
    links: dict[str, float]
    t: np.ndarray
    tip_error: np.ndarray
    shape_error: np.ndarray
    forgotten: float | None

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain data."""
        joints = zip(self.joint_names, self.blind, self.deviations, strict=True)
        return {
            "joints": [
                {"joint": name, "without_sensors": float(blind), "deviation": float(deviation)}
                for name, blind, deviation in joints
            ],
            "seen": self.seen, "free": self.free, "tip_mm": 1e3 * self.tip,
            "tip_if_right_mm": 1e3 * self.tip_if_right,
            "links_mm": {name: 1e3 * error for name, error in self.links.items()},
            "wrong_start_forgotten_s": self.forgotten,
            "tip_error_mm": 1e3 * float(self.tip_error[-1]),
            "shape_error": float(self.shape_error[-1]),
        }  # fmt: skip

    def __str__(self) -> str:
        width = max(len(name) for name in self.joint_names)
        lines = ["expected error at the end (rad; m of a joint that slides)"]
        lines += [f"{'joint':{width}}  without sensors  with them"]
        lines += [
            f"{name:{width}}  {blind:15.4g}  {deviation:9.4g}"
            for name, blind, deviation in zip(
                self.joint_names, self.blind, self.deviations, strict=True
            )
        ]
        late = f"{self.t[-1]:g} s: {1e3 * self.tip_error[-1]:.3g} mm at the tip are left"
        when = f"not within {late}" if self.forgotten is None else f"after {self.forgotten:.3g} s"
        return "\n".join([
            *lines,
            f"the sensors see {self.seen} of {self.free} free directions",
            f"expected error of the tip: {1e3 * self.tip_if_right:.3g} mm where the model is "
            f"right, {1e3 * self.tip:.3g} mm where it lacks forces",
            f"here a start that is wrong by {WRONG:g} rad in every joint is forgotten {when}",
        ])  # fmt: skip


def observe(
    rest: Equilibrium,
    sensors: str | Iterable[Sensor] = FROM_FILE,
    disturbances: Iterable[Disturbance | str] = (),
    *,
    parameters: EkfParameters | None = None,
    period: float = 0.002,
    seconds: float = 1.0,
) -> Observability:
    """How well and how fast sensors show the state at an equilibrium.

    Parameters
    ----------
    rest : Equilibrium
        The equilibrium, from `softdyn.statics`.
    sensors, disturbances, parameters
        As of `softdyn.estimation.Ekf`.
    period, seconds : float
        Time between steps, and of the whole (s).

    Raises
    ------
    InputError
        As `softdyn.estimation.Ekf` does; a time that is not positive.
    """
    model, u = rest.model, rest.u
    steps = max(round(number("seconds", seconds, above=0.0) / number("period", period, above=0)), 1)
    truth = model.state(rest.q, np.zeros(model.nv))
    commands = np.where(model.robot.speeds, 0.0, Winches(model).commands(truth, u))
    return observe_run(
        model, period * np.arange(steps + 1), [truth] * (steps + 1), u, [commands] * (steps + 1),
        sensors, disturbances, parameters=parameters,
    )  # fmt: skip


def observe_run(
    model: SoftModel,
    t: np.ndarray,
    states: Sequence[State],
    u: np.ndarray,
    commands: Sequence[np.ndarray],
    sensors: str | Iterable[Sensor] = FROM_FILE,
    disturbances: Iterable[Disturbance | str] = (),
    *,
    parameters: EkfParameters | None = None,
    seed: int | None = None,
) -> Observability:
    """How well and how fast sensors show the state along a run.

    Parameters
    ----------
    model : SoftModel
        The robot.
    t : ndarray, (N,)
        Times of the steps (s).
    states : sequence of State, (N,)
        The robot's states then.
    u : ndarray, (nu,)
        Inputs before the run.
    commands : sequence of ndarray, (N,)
        Commands (nu,) that each step was reached with; the first is not used.
    sensors, disturbances, parameters
        As of `softdyn.estimation.Ekf`.
    seed : int, optional
        Of the sensors' noise; none by default.

    Raises
    ------
    InputError
        As `softdyn.estimation.Ekf` does.
    """
    chosen: tuple[Any, ...] = model.robot.sensors if sensors == FROM_FILE else tuple(sensors)
    start, disturbances, none = states[0].q, tuple(disturbances), np.zeros(model.nv)
    usual = EkfParameters() if parameters is None else parameters
    loud = replace(usual, least_process=usual.process)
    calm = replace(usual, process=min(usual.process, usual.least_process))
    seeing, blinded, trusting = (
        Ekf(model, chosen, disturbances, parameters=noise, start=(at, none))
        for at, noise in ((_wrong(model, start), loud), (start, loud), (start, calm))
    )
    reader, rng = Sensors(model, chosen), np.random.default_rng(seed)
    ideal = np.array([reader.measure(state, u).values for state in states])
    readings, steps = np.empty_like(ideal), len(t)
    for channel in sensor_channels(model, chosen):
        own, which = np.unique([channel.times.own_time(now) for now in t], return_inverse=True)
        for column, variance in zip(channel.rows, channel.variance, strict=True):
            noise = rng.normal(size=len(own)) * (0.0 if seed is None else np.sqrt(variance))
            readings[:, column] = (np.interp(own, t, ideal[:, column]) + noise)[which]
    for observer in (seeing, blinded, trusting):
        observer.reset(u=u)
    tips, shapes = np.empty(steps), np.empty(steps)
    for k, state in enumerate(states):
        found = seeing.step(t[k], readings[k], commands[k])
        trusted = trusting.step(t[k], readings[k], commands[k])
        blind = blinded.step(t[k], np.full(len(ideal[k]), np.nan), commands[k])
        tips[k] = np.linalg.norm(model.state(found.q, found.v).y - state.y)
        shapes[k] = np.abs(model.coordinates(found.q) - model.coordinates(state.q)).max()
    n, truth = model.nv, states[-1]
    P, P0 = found.covariance[:n, :n], blind.covariance[:n, :n]
    deviation, least = (
        float(np.sqrt(np.trace(truth.J @ one.covariance[:n, :n] @ truth.J.T)))
        for one in (found, trusted)
    )
    outside = np.flatnonzero(tips > WITHIN * deviation)
    last = outside[-1] + 1 if len(outside) else 0
    free = (np.diag(P0) > 0) & (np.diag(P) > 0)
    ratios = eigh(P[np.ix_(free, free)], P0[np.ix_(free, free)], eigvals_only=True)
    return Observability(
        joint_names=model.joint_names, blind=np.sqrt(np.diag(P0)), deviations=np.sqrt(np.diag(P)),
        seen=int((ratios < SEEN).sum()), free=int(free.sum()), tip=deviation,
        tip_if_right=least, links=_link_errors(model, truth.q, P),
        t=t - t[0], tip_error=tips, shape_error=shapes,
        forgotten=None if last >= steps else float(t[last] - t[0]),
    )  # fmt: skip


def _wrong(model: SoftModel, q: np.ndarray) -> np.ndarray:
    """The configuration with every joint displaced by `WRONG`, within its limits."""
    span = np.array(sliding(model.robot, model.joint_names)) * (model.upper - model.lower)
    turns = np.where(span > 0, WRONG * np.minimum(span, 1.0), WRONG)
    at = model.coordinates(q)
    away = np.where(at + turns <= model.upper, turns, -turns)
    return model.integrate(q, Stops.of(model).within(at + away) - at)


def _link_errors(model: SoftModel, q: np.ndarray, P: np.ndarray) -> dict[str, float]:
    """Expected error (m) of each link's origin under the covariance P (nv, nv) of q."""
    found = {}
    for link in model.robot.links:
        J = model.link_jacobian(q, link.name)[:3]
        found[link.name] = float(np.sqrt(max(np.trace(J @ P @ J.T), 0.0)))
    return found
