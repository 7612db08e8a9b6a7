"""The analytic model as the plant: of any model, also of reduced ones, which have no twin.

The model is integrated by `softdyn.dynamics.integrators.ModelMotion`, with the scheme of the twin:
``implicitfast``, or ``rk4``. Joint stops are rigid and do not bounce. Behind a rig the motors
follow `softdyn.actuation.drives.Drives`, and the readings are those of `softdyn.sensing.Sensors`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.actuation import Winches
from softdyn.actuation.drives import Drives
from softdyn.checks import array
from softdyn.controllers.channels import LogChannel
from softdyn.controllers.controller import IDEAL
from softdyn.copies import Separate
from softdyn.description import urdf_writer
from softdyn.description.readings import SampledSensor
from softdyn.description.rig import Actuator
from softdyn.description.robot import Robot
from softdyn.description.urdf import parse_text
from softdyn.dynamics.integrators import ModelMotion
from softdyn.dynamics.reduced import rebuild
from softdyn.safety import Surroundings
from softdyn.sensing import Sensors
from softdyn.validation.loop.settings import MODEL, RunOptions
from softdyn.validation.twin.integrators import Integrator
from softdyn.validation.twin.plant_errors import (
    PlantErrors,
    altered_motor,
    altered_robot,
)
from softdyn.validation.twin.readings import NoisyReadings
from softdyn.validation.twin.rig import SENSOR_STREAM, Drivers, Rig, RiggedPlant, rig_of
from softdyn.validation.twin.twin import SimulationError

SCHEMES = Integrator.IMPLICITFAST, Integrator.RK4
SAME = 1e-9  # s; times this close are one


class MovingModel(Separate):
    """A model whose state moves under held commands.

    Parameters
    ----------
    model : SoftModel
        The model.
    timestep : float
        Step (s).
    integrator : Integrator
        One of `SCHEMES`.
    actuators : tuple of Actuator, optional
        The motors that take the commands; without them commands are the inputs u.

    Attributes
    ----------
    motion : ModelMotion
        It has the present state.
    time : float
        Simulated time (s).
    """

    def __init__(
        self,
        model: SoftModel,
        timestep: float,
        integrator: Integrator,
        actuators: tuple[Actuator, ...] | None = None,
    ) -> None:
        self.motion = ModelMotion(model, timestep, rk4=integrator is Integrator.RK4)
        self.timestep, self.time, self._start, self._steps = timestep, 0.0, 0.0, 0
        self._drives = self._winches = None
        if actuators is not None:
            self._winches = Winches(model, actuators)
            speeds = self._speeds = np.array([one.is_speed for one in actuators], bool)
            # the rig's drivers bound rates, and lag a speed
            lag = np.where(speeds, 0.0, [one.lag for one in actuators])
            delay = [one.delay for one in actuators]
            rate = np.full(len(actuators), np.inf)
            self._drives = Drives(lag, delay, rate, self._winches, speeds)

    def start(self, q: np.ndarray, v: np.ndarray, t: float) -> None:
        """Begin in a state at a time (s)."""
        self.motion.start(q, v)
        self.time = self._start = t
        self._steps = 0

    def hold(self, values: np.ndarray) -> None:
        """Begin with motors that have given u, or free lengths (m), (m,) for long."""
        if self._drives is not None:
            self._drives.hold(values, self.time)

    @property
    def free_lengths(self) -> np.ndarray:
        """Free length (m) of each winch that a velocity commands, (m,); NaN of other inputs."""
        assert self._drives is not None
        return np.where(self._speeds, self._drives.commands, np.nan)

    @property
    def acting(self) -> np.ndarray:
        """The inputs (m,) that the motors give now."""
        assert self._drives is not None
        return self._inputs(self.motion.state, self._drives.commands)[0]

    def advance(self, commands: np.ndarray) -> None:
        """One step under held commands (m,).

        Raises
        ------
        SimulationError
            The step has no solution that is finite.
        """
        values = commands
        begin, self._steps = self.time, self._steps + 1
        end = self._start + self._steps * self.timestep
        if self._drives is not None:
            self._drives.send(begin, commands)
            values = self._drives.over(begin, end)
        try:
            with np.errstate(all="ignore"):
                self.motion.move(lambda state: self._inputs(state, values))
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            raise SimulationError(end, f"the model's step: {error}") from None
        self.time = end

    def _inputs(self, state: State, values: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The inputs (m,) at values of the motors, and their derivatives by v (m, n)."""
        winches = self._winches
        if winches is None or not winches.winds.any():
            return values, None
        found = winches.inputs(state.lengths, state.moment_arms @ state.v, values)
        arms: np.ndarray = state.moment_arms[winches.tendon]
        return found.u, found.by_rate[:, None] * arms


class ModelPlant(Separate):
    """A model without a rig: inputs act at once, and the controller sees the state itself.

    It is a `softdyn.validation.loop.plants.Plant`.

    Parameters
    ----------
    model : SoftModel
        The model, also the controller's.
    timestep : float
        Step (s).
    integrator : Integrator
        One of `SCHEMES`.
    """

    real_time = alters_states = False
    sent = np.zeros(0)
    channels: tuple[LogChannel, ...] = ()
    known = IDEAL

    def __init__(self, model: SoftModel, timestep: float, integrator: Integrator) -> None:
        self.moving = MovingModel(model, timestep, integrator)
        self.settings = {"contacts": False, "plant": MODEL}

    def start(
        self, q: np.ndarray, v: np.ndarray, t: float = 0.0, u: np.ndarray | None = None
    ) -> None:
        """Begin in a state."""
        self.moving.start(q, v, t)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """The model's q (nq,) and v (nv,)."""
        return self.moving.motion.q, self.moving.motion.v

    def sample(self) -> dict[str, np.ndarray]:
        """Nothing."""
        return {}

    def see(self, state: State) -> State:
        """The state itself."""
        return state

    def advance(self, u: np.ndarray, steps: int, seen: State) -> dict[str, np.ndarray]:
        """Integrate under a held input."""
        for _ in range(steps):
            self.moving.advance(u)
        return {}


class RiggedModel(RiggedPlant):
    """A model behind a rig, whose motors, sensors and plant errors are those of a `Rig`.

    Parameters are those of `RiggedPlant`; the options are `timestep` and `integrator`.
    """

    def _build(
        self, rig: Rig, robot: Robot, around: Surroundings | None, options: dict[str, Any]
    ) -> tuple[Drivers, np.ndarray | None]:
        for tendon in robot.tendons:
            if tendon.rubs:
                raise InputError("rig", f"cables without friction, because {_NO}", tendon.name)
        model, errors = with_errors(self._model, rig.plant), rig.plant
        motors = tuple(altered_motor(errors, one) for one in robot.actuators)
        self.moving = MovingModel(model, options["timestep"], options["integrator"], motors)
        self._late = ModelReadings(Sensors(model, robot.sensors), robot, self.moving, rig.seed)
        self.readings, self.settings = self._late, {"contacts": False, "plant": MODEL}
        return Drivers(robot, options["timestep"]), None

    def _begin(self, q: np.ndarray, v: np.ndarray, t: float) -> None:
        self.moving.start(q, v, t)

    def _hold(self, lengths: np.ndarray) -> None:
        self.moving.hold(lengths)
        self._late.start()

    def _move(self, commands: np.ndarray, steps: int) -> None:
        commands = array("u", commands, (len(commands),))
        for _ in range(steps):
            self.moving.advance(commands)
            self._late.keep()

    def _refresh(self) -> None:
        pass

    @property
    def _free(self) -> np.ndarray:
        return self.moving.free_lengths

    @property
    def acting(self) -> np.ndarray:
        """The inputs (nu,) that act, as forces."""
        return self.moving.acting

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """The model's q (nq,) and v (nv,)."""
        return self.moving.motion.q, self.moving.motion.v


class ModelReadings(NoisyReadings):
    """The readings of a moving model: late and sampled as the sensors are.

    A reading was taken at the first plant step that is not before its time.
    """

    def __init__(self, sensors: Sensors, robot: Robot, moving: MovingModel, seed: int) -> None:
        super().__init__(robot.sensors, (seed, SENSOR_STREAM))
        self._sensors, self._moving = sensors, moving
        self._times = [SampledSensor.of(sensor) for sensor in robot.sensors]
        self._oldest = max((one.oldest for one in self._times), default=0.0)

    def start(self) -> None:
        """Begin at the present state, which has been read for long."""
        self._past = deque([(self._moving.time, self._now())])

    def keep(self) -> None:
        """Keep the readings of the present state for those that are late."""
        if not self._oldest:
            return
        now = self._moving.time
        self._past.append((now, self._now()))
        while self._past[0][0] < now - self._oldest - SAME:
            self._past.popleft()

    def _now(self) -> np.ndarray:
        return self._sensors.measure(self._moving.motion.state, self._moving.acting).values

    def ideal(self) -> np.ndarray:
        """The readings (k,) without noise, bias and rounding."""
        if not self._oldest:
            return self._now().copy()
        found, now = np.empty(self.layout.size), self._moving.time
        for times, rows in zip(self._times, self.layout.slices, strict=True):
            at = times.own_time(now)
            past = (values for t, values in self._past if t >= at - SAME)
            found[rows] = next(past)[rows]
        return found


_NO = f'the model that plant="{MODEL}" integrates has none'


def model_plant(
    model: SoftModel, options: RunOptions, period: float, timestep: float
) -> ModelPlant | RiggedModel:
    """The plant of a run whose `plant` is the model itself.

    Parameters
    ----------
    model : SoftModel
        The controller's model.
    options : RunOptions
        The run's settings.
    period, timestep : float
        Control period and plant step (s).

    Raises
    ------
    InputError
        Settings of what the model does not have: contacts, dry friction, soft stops, solid
        obstacles, MuJoCo's other schemes.
    """
    rig, around = rig_of(options.rig), options.surroundings
    errors = PlantErrors() if rig is None else rig.plant
    solid = [] if around is None else [one.name for one in around.obstacles if one.contact]
    for name, given in (
        ("contacts", options.contacts), ("friction", options.friction),
        ("obstacles", solid and f"{solid[0]}, which is solid (contact = false is not)"),
        ("rig: plant.contacts", errors.contacts),
        ("rig: plant.friction, plant.dry_friction", errors.rubs),
        ("rig: plant.soft_stops", errors.soft_stops),
        ("rig: plant.hysteresis", errors.hysteresis),
    ):  # fmt: skip
        if given:
            raise InputError(name, f"none, because {_NO}", given)
    if options.integrator not in SCHEMES:
        expected = f'{" or ".join(SCHEMES)} with plant="{MODEL}"'
        raise InputError("integrator", expected, str(options.integrator))
    scheme = Integrator(options.integrator)
    if scheme is Integrator.RK4 and any(joint.relaxation for joint in model.robot.joints):
        expected = f'implicitfast with plant="{MODEL}" and joints that creep'
        raise InputError("integrator", expected, str(scheme))
    if rig is None:
        return ModelPlant(model, timestep, scheme)
    return RiggedModel(rig, model, period, timestep=timestep, integrator=scheme)


def with_errors(model: SoftModel, errors: PlantErrors) -> SoftModel:
    """The model of a robot with other masses, springs and dampers, and with a payload.

    Parameters
    ----------
    model : SoftModel
        Any model, also a reduced one.
    errors : PlantErrors
        The differences. Those that are not named above are ignored.
    """
    robot = altered_robot(errors, model.robot)
    if robot is model.robot:
        return model
    # the engine reads masses from the text
    found = parse_text(urdf_writer.write(robot), path=robot.path, floating=robot.floating)
    return rebuild(model, replace(found, forces=robot.forces))
