"""The same unknowns from the same data by MuJoCo's own identification, `mujoco.sysid`.

From our fit it only takes the stretches without a stop and the weights of the outputs. The motion
is MuJoCo's rollout of the twin, and derivatives, optimiser and intervals are MuJoCo's own. It
starts from the file's values and the smoothed first states. The first states are unknowns, too,
because their measurement noise would shift a stiffness by many deviations.
"""

from __future__ import annotations

import copy
import importlib
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy.stats import norm

import softdyn
from softdyn import InputError, SoftModel
from softdyn.commands import cli
from softdyn.identification import (
    Estimate,
    Identified,
    Measurements,
    Parameter,
    choose_unknowns,
    fit_length,
    identify,
    member_values,
    read_csv,
)
from softdyn.identification.dynamic_fit import DynamicFit
from softdyn.validation.identification.trials import (
    Excitation,
    plant_steps,
    scale_mass,
    twin_data,
)
from softdyn.validation.identification.twin_report import outputs_of
from softdyn.validation.tables import Table
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import SimulationError, Twin

EPILOG = """\
MuJoCo's identification (extra `sysid`) fits the same unknowns to the same data as ours: DATA, as
`softdyn identify` reads it, or --twin S seconds of a twin, seed by seed. It needs measurements of
all joints and of nothing else, equal time steps, and no joint that stays at a stop.

exit codes: 0 fitted by both; 2 bad input.
"""
LONGEST = 1e-3  # s, longest step, even if the Runge-Kutta method is stable with longer ones
UNFINISHED = 0.1  # of a deviation
UNEVEN = 0.01  # of a sample time: largest difference of times from equal steps
FACTOR = 100.0  # of the file's values, or rad, m: bounds for MuJoCo's optimiser


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument("data", metavar="DATA", nargs="?", help="CSV")
parser.add_argument("--free", nargs="+", metavar="KIND", help="default: stiffness damping")
parser.add_argument("--shared", nargs="+", default=[], metavar="KIND")
parser.option("--hold-out", cli.finite, "PART", "last part of the data, for neither fit", 0.2)
parser.add_argument("--twin", type=cli.positive, metavar="S", help="seconds of the twin's data")
parser.option("--noise", cli.finite, "X", "noise of the twin", 1.0)
parser.option("--seeds", cli.count, "N", "number of twins", 1)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Fit by both programs, and report both."""
    if (arguments.data is None) == (arguments.twin is None):
        raise InputError("DATA", "a file, or --twin", "both" if arguments.data else "neither")
    model = softdyn.load(arguments.robot)
    unknowns = choose_unknowns(model, arguments.free or (), arguments.shared)
    if arguments.data is not None:
        several = [read_csv(arguments.data, model)]
    else:
        how = (model, unknowns, outputs_of(model, "joints"), Excitation(arguments.twin))
        several = [twin_data(*how, arguments.noise, seed)[0] for seed in range(arguments.seeds)]
    opinions = []
    for data in several:
        check(model, data, unknowns, arguments.hold_out)
        found = identify(model, data, unknowns, hold_out=arguments.hold_out)
        opinions.append(second_opinion(model, data, unknowns, found, arguments.hold_out))
    report = {"robot": model.name, "opinions": [one.report() for one in opinions]}
    cli.write_report(report, arguments.json, "\n\n".join(map(str, opinions)))
    return cli.PASSED


def _of_joint(field: str) -> Callable[[mujoco.MjModel, str, float], None]:
    def write(model: mujoco.MjModel, name: str, value: float) -> None:
        getattr(model.joint(name), field)[0] = value

    return write


def _of_tendon(field: str) -> Callable[[mujoco.MjModel, str, float], None]:
    def write(model: mujoco.MjModel, name: str, value: float) -> None:
        getattr(model, field)[model.tendon(name).id] = value

    return write


def _gear(model: mujoco.MjModel, name: str, value: float) -> None:
    model.actuator(name).gear[0] = value


WRITERS: dict[str, Callable[[mujoco.MjModel, str, float], None]] = {
    "stiffness": _of_joint("stiffness"),
    "damping": _of_joint("damping"),
    "rest": _of_joint("qpos_spring"),
    "armature": _of_joint("armature"),
    "mass": scale_mass,
    "gear": _gear,
    "tendon_stiffness": _of_tendon("tendon_stiffness"),
    "tendon_damping": _of_tendon("tendon_damping"),
}


def written(plant: mujoco.MjModel, values: dict[str, dict[str, float]]) -> mujoco.MjModel:
    """A copy of the twin's model with these values, by kind (of `WRITERS`) and member."""
    changed = copy.copy(plant)
    for kind, members in values.items():
        for name, value in members.items():
            WRITERS[kind](changed, name, value)
    if "mass" in values:
        mujoco.mj_setConst(changed, mujoco.MjData(changed))
    return changed


@dataclass(frozen=True, eq=False)
class Opinion:
    """Our and MuJoCo's estimates of what ours identified; other parameters keep the file's value.

    Attributes
    ----------
    ours, theirs : tuple of Estimate
        Estimates of the same parameters; MuJoCo's deviations are its intervals over 1.96.
    unidentified : tuple of str
        Labels of the parameters that ours did not identify.
    left : float
        Largest change of their estimates by another Gauss-Newton step, in their deviations. It is
        near zero if MuJoCo's optimiser has converged.
    """

    ours: tuple[Estimate, ...]
    theirs: tuple[Estimate, ...]
    unidentified: tuple[str, ...]
    left: float

    @property
    def differences(self) -> np.ndarray:
        """MuJoCo's values less ours (P,) in our standard deviations."""
        pairs = zip(self.theirs, self.ours, strict=True)
        return np.array([(b.value - a.value) / a.deviation for b, a in pairs])

    def report(self) -> list[dict[str, Any]]:
        """The figures as plain data."""
        rows = zip(self.ours, self.theirs, self.differences, strict=True)
        return [
            {"label": a.parameter.label, "value": a.value, "interval": a.interval,
             "mujoco": b.value, "mujoco_interval": b.interval, "difference": float(difference)}
            for a, b, difference in rows
        ]  # fmt: skip

    def __str__(self) -> str:
        titles = ["", "ours", "95 %", "MuJoCo's", "95 %", "difference"]
        rows = [
            [a.parameter.label, a.value, _interval(a), b.value, _interval(b), difference]
            for a, b, difference in zip(self.ours, self.theirs, self.differences, strict=True)
        ]
        table = Table(titles, rows, ["", ".6g", ">", ".6g", ">", "+.2f"])
        lines = [table.text(), "difference: in our standard deviations"]
        held = "not identified, held at the file's value"
        lines += [f"{held}: {label}" for label in self.unidentified]
        if self.left > UNFINISHED:
            lines.append(
                f"MuJoCo's optimiser stopped {self.left:.2g} deviations before convergence"
            )
        return "\n".join(lines)


def _interval(one: Estimate) -> str:
    low, high = one.interval
    return f"{low:.6g} … {high:.6g}"


def check(
    model: SoftModel, data: Measurements, unknowns: Sequence[Parameter], hold_out: float = 0.2
) -> DynamicFit:
    """The data of both fits: the part that is not held out, divided into stretches.

    Parameters
    ----------
    model, data, unknowns, hold_out
        As for `identify`.

    Raises
    ------
    InputError
        MuJoCo's identification cannot solve the problem (the error names why), or the extra is not
        installed.
    """
    kinds = {one.kind.name for one in unknowns} - set(WRITERS)
    if kinds:
        expected = f"no kinds but {', '.join(WRITERS)}"
        raise InputError("second opinion", expected, ", ".join(sorted(kinds)))
    joints = [f"q.{name}" for name in model.joint_names]
    if set(data.names) != set(joints):
        expected = f"all joints measured and nothing else: {', '.join(joints)}"
        raise InputError("second opinion", expected, ", ".join(data.names))
    even = np.linspace(data.t[0], data.t[-1], len(data.t))
    off = float(np.abs(data.t - even).max() / np.diff(even).mean())
    if off > UNEVEN:
        raise InputError("second opinion", "times in equal steps", f"{off:.2g} of a step off")
    part = data.part(0, fit_length(data, hold_out))
    problem = DynamicFit.of(model, part, tuple(unknowns), np.inf)
    if problem.held.any():
        held = [model.joint_names[j] for j in np.flatnonzero(problem.held)]
        expected = "joints that leave their stops"
        raise InputError("second opinion", expected, ", ".join(held))
    _sysid()
    return problem


def second_opinion(
    model: SoftModel,
    data: Measurements,
    unknowns: Sequence[Parameter],
    found: Identified,
    hold_out: float = 0.2,
) -> Opinion:
    """MuJoCo's identification of the parameters that ours identified.

    Parameters
    ----------
    model, data, unknowns, hold_out
        As for `identify`.
    found : Identified
        The result of `identify`.

    Raises
    ------
    InputError
        See `check`.
    SimulationError
        MuJoCo's rollout of the file's values diverges.
    """
    problem = check(model, data, unknowns, hold_out)
    sysid = _sysid()
    ours = tuple(one for one in found.estimates if one.identified)
    identified = [one.parameter for one in ours]
    sample = float(np.ptp(data.t)) / (len(data.t) - 1)
    steps = max(plant_steps(each, sample, LONGEST) for each in (model, found.model))
    # no stops, as in our fit: the stretches have none, but a motion far from the measured one may
    timestep = sample / steps
    twin = Twin(model.robot, timestep=timestep, integrator="rk4", limits=False, friction=True)
    twin.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    twin.model.opt.enableflags = 0  # the energy is not needed and costs time
    size = np.array(
        [abs(one.nominal) or 1.0 for one in identified]
    )  # so that one difference step fits all
    low = np.maximum([one.kind.lower for one in identified] / size, -FACTOR)
    start = np.array([one.nominal for one in identified]) / size
    unknown = sysid.ParameterDict()
    unknown.add(sysid.Parameter("theta", start, low, np.full(len(identified), FACTOR)))

    def build(parameters: Any) -> mujoco.MjModel:
        values = member_values(model, identified, parameters["theta"].value * size)
        return written(twin.model, values)

    runs = []
    for k in range(len(problem.runs)):
        unknown.add(_first(sysid, problem, k))
        runs.append(_residual(sysid, problem, k, twin, model, steps, found.noise, build))

    def residual(x: np.ndarray, parameters: Any) -> tuple[list[np.ndarray], list, list]:
        # column by column, because a rollout stores every step's state, and there are many columns
        several = x.reshape(len(x), -1)
        left = [np.column_stack([run(one, parameters) for one in several.T]) for run in runs]
        return [each.reshape(-1, *x.shape[1:]) for each in left], [], []

    if not np.isfinite(np.concatenate(residual(unknown.as_vector(), unknown)[0])).all():
        raise SimulationError(0.0, "a rollout of the file's values that diverges")
    best, result = sysid.optimize(
        unknown, residual, verbose=False, output=io.StringIO(), x_scale="jac", xtol=1e-5, eps=1e-6
    )
    at_best = residual(result.x, best.copy())[0]
    _, half = sysid.calculate_intervals(at_best, result.jac)
    deviations = half[: len(identified)] * size / norm.ppf(0.975)
    next_ = np.linalg.lstsq(result.jac, np.concatenate(at_best))[0][: len(identified)] * size
    theirs = tuple(
        replace(one, value=float(value), half=float(norm.ppf(0.975) * deviation))
        for one, value, deviation in zip(ours, best["theta"].value * size, deviations, strict=True)
    )
    unidentified = tuple(one.parameter.label for one in found.estimates if not one.identified)
    return Opinion(ours, theirs, unidentified, float(np.abs(next_ / deviations).max()))


def _first(sysid: Any, problem: DynamicFit, k: int) -> Any:
    """The first state (2 n,) of a run, near the smoothed one.

    It must stay near, because strongly damped velocities do not show in the outputs, and far away
    the motion differs (see `Problem.blocks`).
    """
    near, wide = problem.firsts()[k], 3 * np.concatenate(problem.wide())
    return sysid.Parameter(f"first {k}", near, near - wide, near + wide)


def _residual(
    sysid: Any, problem: DynamicFit, k: int, twin: Twin, model: SoftModel, steps: int,
    noise: np.ndarray, build: Callable[[Any], mujoco.MjModel],
) -> Callable[[np.ndarray, Any], np.ndarray]:  # fmt: skip
    """Residuals of one run: data minus MuJoCo's rollout, over the noise, all outputs in a row."""
    begin, end = problem.runs[k]
    data, dofs = problem.data.part(begin, end), StateMap(model, twin).dofs
    order = [model.joint_names.index(name.removeprefix("q.")) for name in data.names]
    u = np.repeat(data.u, steps, axis=0)[: (len(data.t) - 1) * steps + 1]
    times = np.arange(len(u)) * twin.model.opt.timestep
    measured = sysid.TimeSeries(data.t, data.outputs)

    def rollout(*, param_dicts: Sequence[Any], initial_states: Any, **rest: Any) -> Any:
        states = []
        for one in param_dicts:
            position, rate = np.zeros((2, twin.model.nv))
            position[dofs], rate[dofs] = np.split(one[f"first {k}"].value, 2)
            states.append(sysid.create_initial_state(twin.model, position, rate))
        return sysid.sysid_rollout(initial_states=states, **rest)

    def compare(
        parameters: Any, predicted: Any, measured: Any, model: Any, all_: bool, state: np.ndarray
    ) -> tuple[np.ndarray, Any, Any]:
        path = np.vstack((np.split(parameters[f"first {k}"].value, 2)[0],
                          state[steps - 1 :: steps, 1 + dofs]))[:, order]  # fmt: skip
        out = sysid.TimeSeries(measured.times, path)
        return (measured.data - path) / noise, out, measured

    run = sysid.SystemTrajectory(
        twin.model,
        sysid.TimeSeries(times, u),
        measured,
        sysid.create_initial_state(twin.model, twin.rest),
        None,
    )

    def residual(x: np.ndarray, parameters: Any) -> np.ndarray:
        found: np.ndarray = sysid.model_residual(
            x, parameters, build, run, compare, rollout, n_threads=1, resample_true=False
        )[0]
        return found

    return residual


def _sysid() -> Any:
    """`mujoco.sysid`; without the extra it can be imported, but is empty."""
    # imported by its name: MuJoCo only types this part, and mypy would take it for the whole
    sysid = importlib.import_module("mujoco.sysid")
    if not hasattr(sysid, "optimize"):
        raise InputError("second opinion", "the extra softdyn[sysid]", "not installed")
    return sysid


main = cli.program(parser, command, __name__)
