"""The Lyapunov function V along the paper's runs, and the stability of the zero dynamics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import softdyn
from softdyn import SoftModel
from softdyn.controllers import CONTROLLERS
from softdyn.statics.zero_dynamics import examine, zero_spectrum
from softdyn.validation.loop.certificate import certify
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.pictures.plot_style import (
    BLUE,
    GREY,
    PAGE,
    TIME,
    VERMILLION,
    controller_title,
    handle,
    legend_above,
    letter,
    line,
    panels,
    robot_title,
    style,
    write_figure,
)
from softdyn.validation.loop.pictures.plot_style import (
    CONTROLLERS as LOOKS,
)
from softdyn.validation.simulate import simulate
from softdyn.validation.studies import experiments

LAWS = ("soft-id-clf-qp", "id-clf-qp", "clf-qp")  # the controllers with a decrease condition
TOLERANCE = 1e-6  # of V/ε: rounding may exceed the bound by this much
POSES = 60  # samples along a run
COLUMNS = (
    ("robot", "robot", ""),
    ("law", "controller", ""),
    ("θ/π", "theta", "g"),
    ("V̇ > −V/ε + δ", "above", ".0%"),
    ("V̇ > 0", "growing", ".0%"),
    ("zero dynamics unstable", "unstable", ".0%"),
    ("largest pole (1/s)", "fastest", ".2g"),
    ("stiffness below gravity", "weak", ".0%"),
    ("least (N m/rad)", "least", ".2g"),
)


def runs(
    robot: str, laws: Sequence[str], thetas: Sequence[float], duration: float | None,
    tick: Callable[[], Any] = lambda: None,
) -> list[tuple[Log, dict[str, Any]]]:  # fmt: skip
    """Run the paper's set points, and certify each log: the log and its row of `COLUMNS`."""
    model, found = softdyn.load(robot), []
    for theta in thetas:
        for name in laws:
            law, experiment = CONTROLLERS[name](model), experiments.set_point(robot, theta)
            log = simulate(model, law, experiment, duration=duration)
            log = certify(log, model, law, experiment.reference)
            found.append((log, row(model, log)))
            tick()
    return found


def row(model: SoftModel, log: Log) -> dict[str, Any]:
    """Shares of the samples at which a condition fails, and the worst value of each kind.

    Parameters
    ----------
    model : SoftModel
        The log's robot.
    log : Log
        A run, certified.
    """
    k = poses(log)
    least = np.array([examine(model, model.coordinates(log.q[i])).least for i in k])
    poles = np.array([zero_spectrum(model, log.q[i], log.u[i])[0].real for i in k])
    rate = log.V / log.gains["eps"]
    Vdot = rates(log)
    finite = np.isfinite(Vdot)
    return {
        "robot": log.robot,
        "controller": log.controller,
        "theta": log.theta,
        "samples": int(finite.sum()),
        "above": share((Vdot + rate - log.delta > TOLERANCE * rate)[finite]),
        "growing": share((Vdot > TOLERANCE * rate)[finite]),
        "unstable": share(poles > 0),
        "fastest": float(poles.max(initial=-np.inf)),
        "weak": share(least <= 0),
        "least": float(least.min(initial=np.inf)),
    }


def rates(log: Log) -> np.ndarray:
    """V̇ (N,) of a certified log."""
    return np.full(log.steps, np.nan) if log.Vdot is None else log.Vdot


def share(wrong: np.ndarray) -> float:
    """Share of true values among the samples (k,)."""
    return float(np.mean(wrong)) if len(wrong) else float("nan")


def poses(log: Log) -> np.ndarray:
    """Samples spread over a run, denser at its beginning."""
    steps = min(log.steps, log.finite_samples)
    return np.unique(np.geomspace(1, max(steps, 1), POSES).astype(int)) - 1


def draw(path: Path, model: SoftModel, logs: Sequence[Log]) -> None:
    """Draw a column per log: V̇ ε/V with -1 + δ ε/V, poles of zero dynamics, least stiffness."""
    with style():
        figure, axes = panels(3, len(logs), PAGE, 6.0, sharex=True, sharey="row")
        for column, log in enumerate(logs):
            top, middle, low = (axes[i][column] for i in range(3))
            t, scale = log.t[: log.steps], log.gains["eps"] / log.V
            top.plot(t, rates(log) * scale, ".", ms=1.5, color=VERMILLION)
            top.plot(t, np.maximum(log.delta * scale, 0) - 1, ".", ms=1.5, color=BLUE)
            top.axhline(0, color=GREY, lw=0.8)
            top.set_yscale("symlog", linthresh=1)
            letter(top, column, f"{robot_title(log.robot)}, {controller_title(log.controller)}")
            k = poses(log)
            for i in k:
                real = zero_spectrum(model, log.q[i], log.u[i]).real
                middle.plot(np.full(len(real), log.t[i]), real, ".", ms=1.5, color=BLUE)
            middle.axhline(0, color=GREY, lw=0.8)
            middle.set_yscale("symlog", linthresh=0.1)
            least = [examine(model, model.coordinates(log.q[i])).least for i in k]
            line(low, log.t[k], least, LOOKS[log.controller])
            low.axhline(0, color=GREY, lw=0.8)
            low.set_xscale("symlog", linthresh=0.01)
            low.set_xlabel(TIME)
        axes[0][0].set_ylabel("V̇ ε / V")
        axes[1][0].set_ylabel("real parts, zero dynamics (1/s)")
        axes[2][0].set_ylabel("least ∂K + ∂g, unactuated")
        names = {"V̇ with the model's q̈": VERMILLION, "the QP's bound, −V/ε + δ": BLUE}
        legend_above(figure, [handle(name, (colour, "-")) for name, colour in names.items()])
        write_figure(figure, path)
