"""The rig in both engines: inputs of winches, tensions, q̈, sensors and a trajectory.

In MuJoCo the rig is actuators with bias, activation and delay, and sensors. In the model it is
`Winches`, `SoftModel.measure`, `RigMotion`. MuJoCo has no bound on a command's rate and no lag of
a commanded velocity: those of the closed loop, `Drivers`, go before it.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

import softdyn
from softdyn.actuation import Capstan, Winches
from softdyn.description.readings import ReadingLayout
from softdyn.description.rig import Sensor, SensorKind
from softdyn.description.robot import Robot
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.motors import lag_shares
from softdyn.validation.crosschecks import trajectories
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.crosschecks.result import TrajectoryRun
from softdyn.validation.crosschecks.trajectories import IMPLICIT, Race, Scheme, Start
from softdyn.validation.twin.cable_friction import CableFriction
from softdyn.validation.twin.free_base import FreeBase
from softdyn.validation.twin.readings import Readings
from softdyn.validation.twin.rig import Drivers
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin

RIG_SCALES = {
    "inputs": "largest stiffness of a winch's cable times the length of the robot",
    "tension": "largest stiffness of a cable times the length of the robot",
    "rigged qdd": "1 rad/s²",
    "friction": "largest tension, and that times the length of the robot",
    "sensors": "1 of each unit, length of the robot, tension as above, largest q̈ times length",
    "rigged": "1 rad and 1 rad/s",
}
RIG_TOLERANCES = dict.fromkeys(RIG_SCALES, 1e-10) | {"rigged": 1e-8}
Comparison = tuple[str, np.ndarray, np.ndarray, float]  # quantity, model's, twin's, scale


def quantities_of(model: SoftModel) -> tuple[str, ...]:
    """Those of `RIG_SCALES` that the robot's file has."""
    robot = model.robot
    winds = any(actuator.is_winch for actuator in robot.actuators)
    moved = winds or any(a.lag or a.delay or a.rate < math.inf for a in robot.actuators)
    # MuJoCo integrates no damping between branches
    apart = trajectories.damping_couples_branches(
        model, model.q0, np.zeros(model.nv), _winch_damping(robot)
    )
    rubs = any(tendon.rubs for tendon in robot.tendons)
    pulled = bool(_pulled(robot))
    there = winds, pulled, pulled, rubs, bool(robot.sensors), moved and not apart
    return tuple(name for name, has in zip(RIG_SCALES, there, strict=True) if has)


def _winch_damping(robot: Robot) -> dict[str, float]:
    """Damping of the winches on each tendon."""
    found = {tendon.name: 0.0 for tendon in robot.tendons}
    for actuator in robot.actuators:
        found[actuator.tendon] += actuator.damping
    return found


def _pulled(robot: Robot) -> list[str]:
    """Tendons that can be slack, or that a winch pulls."""
    wound = {actuator.tendon for actuator in robot.actuators if actuator.is_winch}
    return [tendon.name for tendon in robot.tendons if tendon.slack or tendon.name in wound]


class RigTerms(MujocoTerms):
    """MuJoCo's terms of a robot with its rig; `place` is followed by `hold`.

    Parameters
    ----------
    model : SoftModel
        The model.
    robot : Robot
        The twin's description.
    timestep : float
        The step (s) in which delays are counted.
    """

    def __init__(self, model: SoftModel, robot: Robot, timestep: float) -> None:
        twin = Twin(robot, limits=False, rig=True, timestep=timestep)
        super().__init__(twin, StateMap(model, twin), drives=True)
        self.robot = robot
        self._twin = copy.copy(twin)  # with the model and data of the terms
        self._twin.model, self._twin.data = self._model, self._data
        self._readings = Readings(self._twin, 0)

    def hold(self, commands: np.ndarray, lengths: np.ndarray) -> None:
        """Begin with commands (nu,), and free lengths (nu,) of winches that a velocity commands."""
        self._twin.hold(commands, lengths)

    def acting(self) -> np.ndarray:
        """The inputs (nu,) that act."""
        return self._data.actuator_force[: self.nu].copy()

    def accelerations(self) -> np.ndarray:
        """q̈ (nv,) with slack tendons and the inputs that act."""
        return self._accelerations()

    def rubbing(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tensions behind the guides of cables that slide, the guides' numbers, joint forces."""
        friction = CableFriction(self._model, self._twin.robot)
        tensions, forces = friction.sliding(self._data)
        return tensions, friction.numbers, self._map.T @ forces

    def readings(self, commands: np.ndarray) -> np.ndarray:
        """The sensors' readings (k,) without errors."""
        if self.steps_itself:  # MuJoCo's own accelerations lack the followers' constraints
            self._data.qacc[:] = self._map @ self.qdd(commands) + self._rate @ self._v
            mujoco.mj_rnePostConstraint(self._model, self._data)
            mujoco.mj_sensorAcc(self._model, self._data)
        return self._readings.ideal()


class RigStates:
    """Comparisons of inputs, tensions and readings at single states.

    Parameters
    ----------
    model : SoftModel
        The model.
    robot : Robot
        The twin's description.
    """

    def __init__(self, model: SoftModel, robot: Robot) -> None:
        self.model = softdyn.build(_observed(model.robot))
        self.judge = RigTerms(self.model, _observed(robot), trajectories.STEP)
        self.winches, self.capstan = Winches(self.model), Capstan(self.model)

    def compare(
        self, q: np.ndarray, v: np.ndarray, rng: np.random.Generator
    ) -> Iterator[Comparison]:
        """The quantities at a state, under random commands."""
        model, judge = self.model, self.judge
        state, length = model.state(q, v), model.robot.length or 1.0
        commands = random_commands(self.winches, state, rng)
        judge.set_state(q, v)
        judge.hold(commands, commands)
        u = self.winches.tensions(state, commands)
        gears = np.array([abs(actuator.gear) for actuator in model.robot.actuators])
        stiff = self.winches.stiffness.max(initial=0.0)
        yield "inputs", gears * u, gears * judge.acting(), stiff * length
        qdd = model.forward_dynamics(q, v, u)
        if _pulled(model.robot):
            yield "rigged qdd", qdd, judge.accelerations(), 1.0
        if any(tendon.rubs for tendon in model.robot.tendons):
            guides = self.capstan.at(state)
            tensions, numbers, forces = judge.rubbing()
            pull = float(np.abs(guides.pull(u)).max(initial=0.0))
            yield "friction", guides.tensions(u)[numbers], tensions, pull
            yield "friction", guides.forces(u), forces, pull * length
        found = model.measure(state, u)
        theirs = found.values + found.errors_of(judge.readings(commands))
        stiff = max([stiff, 1.0, *(tendon.stiffness for tendon in model.robot.tendons)])
        scales = dict.fromkeys(SensorKind, max(length, 1.0)) | {SensorKind.TENSION: stiff * length}
        scales[SensorKind.ACCELEROMETER] = np.abs(qdd).max(initial=1.0) * length
        layout = ReadingLayout(model.robot.sensors)
        own = len(layout.sensors) - len(_pulled(model.robot))
        for k, (sensor, rows) in enumerate(zip(layout.sensors, layout.slices, strict=True)):
            quantity = "sensors" if k < own else "tension"
            yield quantity, found.values[rows], theirs[rows], scales[sensor.kind]


def _observed(robot: Robot) -> Robot:
    """The robot with prompt sensors, and one more on every tendon that can be slack."""
    prompt = [replace(sensor, rate=0.0, latency=0.0) for sensor in robot.sensors]
    more = [Sensor(f"tension:{name}", SensorKind.TENSION, tendon=name) for name in _pulled(robot)]
    return replace(robot, sensors=(*prompt, *more))


def random_commands(
    winches: Winches, state: State, rng: np.random.Generator, share: float = 1.2
) -> np.ndarray:
    """Inputs (nu,) within a share of their bounds, and free lengths that give them or slack."""
    lower, upper = trajectories.input_window(winches.model)
    u = rng.uniform(lower, upper)
    gears = np.array([abs(actuator.gear) for actuator in winches.model.robot.actuators])
    tensions = share * (1.5 * gears * np.abs(u) - 0.5 * gears * np.maximum(-lower, upper))
    stiffness = np.where(winches.winds, winches.stiffness, 1.0)
    lengths = winches.commands(state, np.clip(0.0, lower, upper)) - tensions / stiffness
    lengths = np.clip(lengths, winches.lower, winches.upper)
    return np.where(winches.winds, lengths, min(share, 1.0) * u)


class RigMotion:
    """The model behind its rig, in MuJoCo's semi-implicit steps.

    A command passes through its delay of whole steps, the bound on its rate and its lag. The lag is
    exact over a step, in which the command at its begin acts. The winches' damping is implicit
    where neither of their bounds acts.

    Parameters
    ----------
    winches : Winches
        The winches.
    start : tuple of ndarray
        q and v.
    held : ndarray, (nu,)
        The commands before the first step; free lengths of winches that a velocity commands.
    h : float
        Step (s).
    """

    def __init__(self, winches: Winches, start: Start, held: np.ndarray, h: float) -> None:
        self._winches, self._h, (self.q, self.v) = winches, h, start
        actuators = winches.model.robot.actuators
        self._speeds = winches.model.robot.speeds
        lags = np.array([a.lag for a in actuators])
        self._lagging = (lags > 0) & ~self._speeds
        self._gain = 1.0 - lag_shares(h, lags)[0]
        self._most = h * np.array([a.rate for a in actuators])
        self._held, waiting = held.copy(), np.where(self._speeds, 0.0, held)
        self._allowed, self._rate = waiting, np.zeros_like(held)
        late = [math.ceil(a.delay / h - 1e-9) for a in actuators]
        self._waiting = [deque([c] * n) for c, n in zip(waiting, late, strict=True)]

    def step(self, commands: np.ndarray) -> None:
        """Advance q and v by one step under new commands (nu,)."""
        winches, model, h = self._winches, self._winches.model, self._h
        for queue, command in zip(self._waiting, commands, strict=True):
            queue.append(command)
        arrived = np.array([queue.popleft() for queue in self._waiting])
        self._allowed = np.clip(arrived, self._allowed - self._most, self._allowed + self._most)
        arrived = self._allowed
        delayed = self._lagging | self._speeds
        state = model.state(self.q, self.v)
        rates = state.moment_arms @ state.v
        acting = winches.inputs(state.lengths, rates, np.where(delayed, self._held, arrived))
        D = state.D - state.B @ (acting.by_rate[:, None] * state.moment_arms[winches.tendon])
        a = np.linalg.solve(state.M + h * D, state.B @ acting.u - state.h)
        if model.robot.floating:
            free = FreeBase(model)
            w = free.from_velocity(self.q, self.v) + h * free.acceleration(self.q, self.v, a)
            self.q = free.integrate(self.q, h * w)
            self.v = free.velocity(self.q, w)
        else:
            self.v = self.v + h * a
            self.q = model.integrate(self.q, h * self.v)
        self._rate = self._rate + self._gain * (arrived - self._rate)
        wound = np.clip(self._held + h * self._rate, winches.lower, winches.upper)
        lagged = self._held + self._gain * (arrived - self._held)
        self._held = np.where(self._speeds, wound, lagged)


@dataclass(frozen=True, eq=False)
class RigRace(Race):
    """One robot with its rig in both engines, from one state (q, v) with commands long held."""

    winches: Winches
    held: np.ndarray

    def _ours(
        self, scheme: Scheme, step: float, inputs: Sequence[np.ndarray], holds: Sequence[int]
    ) -> Iterator[Start]:
        motion = RigMotion(self.winches, self.start, self.held, step)
        for commands, steps in zip(inputs, holds, strict=False):
            for _ in range(steps):
                motion.step(commands)
            yield self.model.coordinates(motion.q), motion.v

    def _theirs(
        self,
        scheme: Scheme,
        step: float,
        inputs: Sequence[np.ndarray],
        holds: Sequence[int],
        start: Start | None = None,
    ) -> Iterator[Start]:
        judge = self.judge
        assert isinstance(judge, RigTerms)
        judge.start(*(start or self.start), scheme.integrator, step)
        drivers = Drivers(judge.robot, step)
        judge.hold(drivers.start(self.held), self.held)
        for commands, steps in zip(inputs, holds, strict=False):
            driven = (drivers.step(commands) for _ in range(steps))
            *_, mark = judge.follow(driven, [1] * steps)
            yield mark


def compare_motion(
    model: SoftModel, robot: Robot, rng: np.random.Generator, report: Callable[[str], None]
) -> TrajectoryRun:
    """One trajectory under random commands.

    Parameters
    ----------
    model : SoftModel
        The model.
    robot : Robot
        The twin's description.
    rng : Generator
        Draws the initial state and the commands.
    report : callable
        Called with a short text about the current step.

    Raises
    ------
    SimulationError, InputError, LinAlgError
        The trajectory is no longer finite.
    """
    report("trajectory with the rig")
    start, winches = trajectories.random_start(model, rng), Winches(model)
    state = model.state(*start)
    arms = state.B / np.array([actuator.gear for actuator in model.robot.actuators])
    rates = trajectories.rates_of(model, *start, (arms * winches.stiffness) @ arms.T)
    step, holds, wanted = trajectories.plan(IMPLICIT, rates)
    share = trajectories.share_of(model, *start)
    held = random_commands(winches, state, rng, share)
    speeds = model.robot.speeds
    lengths = (random_commands(winches, state, rng, share) for _ in holds)
    # a commanded velocity leads to a drawn length within a hold
    inputs = [np.where(speeds, (c - held) / (trajectories.HOLD * step), c) for c in lengths]
    race = RigRace(
        model, RigTerms(model, robot, step), start, rates, trajectories.circles(model), winches,
        held,
    )  # fmt: skip
    return race.compare("rig", IMPLICIT, step, holds, inputs, wanted)
