"""The rig between a controller and its plant: drives, sensors and measured states."""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.actuation import Winches
from softdyn.checks import did_you_mean, instance, instances, number, whole
from softdyn.controllers.channels import LogChannel
from softdyn.controllers.controller import KnownRig
from softdyn.copies import Separate
from softdyn.description.rig import LONGEST_DELAY, SMALLEST_WINCH, CommandKind, Sensor
from softdyn.description.robot import MOST_FRICTION, Robot, Tendon
from softdyn.plausible import beyond_seconds, too_slow
from softdyn.safety import Surroundings
from softdyn.toml_table import TomlTable
from softdyn.validation.channels import inputs, positions, rates
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.validation.twin.readings import NoisyReadings, Readings, command_units
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.touch import Touch
from softdyn.validation.twin.twin import Twin

FROM_FILE = "file"
# numbers of random streams beside the noise of q and q̇
BIAS_STREAM, SENSOR_STREAM = 1, 2


@dataclass(frozen=True)
class Rig:
    """The rig of a run: that of the robot's file or an ideal one, and what is different from it.

    Attributes
    ----------
    lag, delay : float, optional
        Time constant (s) and delay (s) of all inputs; the file's by default. The twin rounds a
        delay up to whole plant steps. Before the first command arrives, the input is zero, or the
        one nearest to it within the bounds.
    rate : float, optional
        Largest rate of change of all commands, in their unit per second; the file's by default.
    command : str or CommandKind, optional
        ``force``, ``length`` or ``velocity``, the command of all inputs; the file's by default.
    stiffness, damping : float, optional
        Stiffness (N/m) and damping (N s/m) of every winch's cable; the file's by default.
    friction : float, optional
        Coefficient of friction of every cable that an input pulls; the file's by default.
    sensors : tuple of Sensor or mapping, optional
        The sensors; the file's by default. A mapping changes errors of the file's sensors: name →
        `noise`, `bias`, `rate`, `latency`, `resolution`, as in a `Sensor`. An observer of the run
        knows the changed values.
    plant : PlantErrors
        Differences between the plant and the model that the controller has.
    noise : float
        Noise of the q and q̇ that the controller sees, given by its effect on the tip: the root
        mean square (m) of ‖J δq‖ at q = 0. Each joint's standard deviation is the same share of its
        range (of 1 rad or 1 m without limits). The noise of q̇ is that of q over one period.
    bias : float
        Constant error of the q that the controller sees: one draw of a noise of this size (m).
    latency : float
        Age (s) of the q and q̇ that the controller sees, rounded to whole control periods.
    seed : int
        Seed of all noise, and of the bias.
    file : bool
        Whether the robot's file has the values that are not given. Otherwise they are those of an
        ideal rig: forces that act at once, no sensors.

    Raises
    ------
    InputError
        A time or a noise that is negative, an unknown command.
    """

    lag: float | None = None
    delay: float | None = None
    rate: float | None = None
    command: CommandKind | str | None = None
    stiffness: float | None = None
    damping: float | None = None
    friction: float | None = None
    sensors: tuple[Sensor, ...] | Mapping[str, Mapping[str, Any]] | None = None
    plant: PlantErrors = field(default_factory=PlantErrors)
    noise: float = 0.0
    bias: float = 0.0
    latency: float = 0.0
    seed: int = 0
    file: bool = True

    def __post_init__(self) -> None:
        for name in ("lag", "delay", "stiffness", "damping", "noise", "bias", "latency"):
            if getattr(self, name) is not None:
                time = name in ("lag", "delay", "latency")
                if time and (got := beyond_seconds(getattr(self, name))):
                    raise InputError(name, f"seconds, at most {LONGEST_DELAY:g}", got)
                number(name, getattr(self, name), lower=0.0)
        if self.friction is not None:
            number("friction", self.friction, lower=0.0, upper=MOST_FRICTION)
        if self.rate is not None:
            number("rate", self.rate, above=0.0)
        whole("seed", self.seed, lower=0)
        instance("file", self.file, bool, "true or false")
        instance("plant", self.plant, PlantErrors, "a PlantErrors")
        if isinstance(self.sensors, Mapping):
            sensors = {name: _errors_of(name, table) for name, table in self.sensors.items()}
            object.__setattr__(self, "sensors", sensors)
        elif self.sensors is not None:
            listed = instances("sensors", self.sensors, Sensor, "a Sensor")
            object.__setattr__(self, "sensors", listed)
        if self.command is not None:
            words = [kind.value for kind in CommandKind]
            if not isinstance(self.command, CommandKind) and self.command not in words:
                raise InputError("command", " or ".join(words), repr(self.command))
            object.__setattr__(self, "command", CommandKind(self.command))

    @classmethod
    def of(cls, table: Mapping[str, Any], where: str = "rig") -> Rig:
        """A rig from a table of its fields, such as a TOML file's; `plant` is a table of its own.

        Errors name `where`, the table's file.

        Raises
        ------
        InputError
            An unknown key, and whatever the fields refuse.
        """
        read = TomlTable(table, where)
        plant = read.table("plant")
        errors = PlantErrors() if plant is None else plant.make(PlantErrors)
        if isinstance(table.get("sensors"), tuple | list):
            return read.make(cls, plant=errors)
        sensors = read.table("sensors")
        changes = None if sensors is None else sensors.values
        return read.make(cls, plant=errors, sensors=changes)

    def robot(self, robot: Robot) -> Robot:
        """The robot with this rig.

        Raises
        ------
        InputError
            A length command for an input whose cable has no stiffness, or that can push.
        """
        changes: dict[str, Any] = {
            name: getattr(self, name)
            for name in ("lag", "delay", "rate", "command", "stiffness", "damping")
            if getattr(self, name) is not None
        }
        said = robot.actuators if self.file else tuple(a.ideal for a in robot.actuators)
        actuators = tuple(replace(actuator, **changes) for actuator in said)
        for actuator in actuators:
            if actuator.is_winch and (actuator.stiffness < SMALLEST_WINCH or actuator.pushes):
                expected = f"an input {actuator.name!r} that only pulls, with a cable's stiffness"
                raise InputError("command", expected, repr(self.command))
            if actuator.is_winch and any(
                tendon.armature > 0 for tendon in robot.tendons if tendon.name == actuator.tendon
            ):
                expected = f"a force, as tendon {actuator.tendon!r} has an armature"
                raise InputError("command", expected, repr(self.command))
        sensors, tendons = self._sensors(robot), self._tendons(robot)
        return replace(robot, actuators=actuators, sensors=sensors, tendons=tendons)

    def _sensors(self, robot: Robot) -> tuple[Sensor, ...]:
        """The sensors of this rig."""
        if isinstance(self.sensors, tuple):
            return self.sensors
        found = {sensor.name: sensor for sensor in robot.sensors} if self.file else {}
        for name, changes in (self.sensors or {}).items():
            if name not in found:
                expected = "a sensor of the robot's file" if self.file else "file = true"
                raise InputError(f"sensors: {name}", expected, did_you_mean(name, found))
            size = found[name].kind.size
            for key, value in changes.items():
                if isinstance(value, tuple) and len(value) not in (1, size):
                    raise InputError(f"sensors: {name}.{key}", f"1 or {size} numbers", value)
            found[name] = replace(found[name], **changes)
        return tuple(found.values())

    def _tendons(self, robot: Robot) -> tuple[Tendon, ...]:
        """The tendons with this rig's friction."""
        if self.file and self.friction is None:
            return robot.tendons
        driven = {actuator.tendon for actuator in robot.actuators}
        return tuple(
            replace(tendon, friction=(self.friction or 0.0) if tendon.name in driven else 0.0)
            for tendon in robot.tendons
        )


def _errors_of(name: str, table: Any) -> dict[str, Any]:
    """The changed errors of a sensor, as the fields of a `Sensor`."""
    read, changes = TomlTable(table, f"sensors: {name}"), dict[str, Any]()
    least = {"noise": 0.0, "bias": -math.inf, "resolution": 0.0}
    most = {"rate": math.inf, "latency": LONGEST_DELAY}
    for key, value in read.rest((*least, *most)).items():
        where = f"{read.where}.{key}"
        if key in most:
            changes[key] = number(where, value, lower=0.0, upper=most[key])
        else:
            each = value if isinstance(value, list | tuple) and value else [value]
            changes[key] = tuple(number(where, x, lower=least[key]) for x in each)
    return changes


class _Errors:
    """Noise and bias of the q and q̇ that a controller sees; see `Rig`."""

    def __init__(self, rig: Rig, model: SoftModel, period: float) -> None:
        span = model.upper - model.lower
        span = np.where(np.isfinite(span), span, 1.0)
        J = model.state(model.q0, np.zeros(model.nv)).J
        effect = float(np.linalg.norm(J * span))
        self._deviation, self._period = span * rig.noise / effect, period
        draw = np.random.default_rng((rig.seed, BIAS_STREAM)).normal(size=model.nv)
        self._bias = span * rig.bias / effect * draw
        self._random = np.random.default_rng(rig.seed)

    def __call__(self, state: State) -> State:
        """The state that the controller sees instead of `state`."""
        model = state.model
        dq, dv = self._deviation * self._random.normal(size=(2, model.nv))
        q = model.integrate(state.q, dq + self._bias)
        return model.state(q, state.v + dv / self._period)


def cable_friction(robot: Robot) -> np.ndarray | None:
    """The coefficient (tendons,) of each cable's friction; None where no cable rubs."""
    if not any(tendon.rubs for tendon in robot.tendons):
        return None
    return np.array([tendon.friction for tendon in robot.tendons])


def rig_of(value: Any) -> Rig | None:
    """The rig that an argument means: None, ``"file"`` or a `Rig`.

    Raises
    ------
    InputError
        For anything else.
    """
    if value is None or isinstance(value, Rig):
        return value
    if value == FROM_FILE:
        return Rig()
    raise InputError("rig", 'None, "file" or a Rig(…)', repr(value))


class Drivers:
    """A bound on a command's rate and a commanded velocity's lag, which MuJoCo's actuators lack.

    MuJoCo lags forces and lengths itself; its integrator has no room for a lag before it.

    Parameters
    ----------
    robot : Robot
        The robot with its rig.
    step : float
        Plant step (s).

    Attributes
    ----------
    speeds : np.ndarray of bool, (nu,)
        Whether each command is a velocity.
    prompt : bool
        Whether every command passes unchanged.
    """

    def __init__(self, robot: Robot, step: float) -> None:
        self.speeds = robot.speeds
        self._most = np.array([a.rate for a in robot.actuators]) * step
        self._kept = np.array([
            math.exp(-step / a.lag) if a.lag > 0 and speed else 0.0
            for a, speed in zip(robot.actuators, self.speeds, strict=True)
        ])  # fmt: skip
        self.prompt = bool(np.isinf(self._most).all() and not self._kept.any())

    def start(self, held: np.ndarray) -> np.ndarray:
        """Begin with commands (nu,) long held, of a velocity with its free length; return them."""
        self._command = self._limited = np.where(self.speeds, 0.0, held)
        return self._command

    def step(self, asked: np.ndarray) -> np.ndarray:
        """The commands (nu,) to MuJoCo in the next plant step."""
        self._limited = self._limited + np.clip(asked - self._limited, -self._most, self._most)
        self._command = self._kept * self._command + (1.0 - self._kept) * self._limited
        return self._command


class RiggedPlant(Separate):
    """A twin behind its rig.

    The controller's forces u become commands. A winch gets the free length at which its tension is
    the force that was asked for, at the state that the controller saw; a velocity leads there in
    one control period. `direct` sends commands instead. A bound on a command's rate acts in every
    plant step, before the delay. It is a `softdyn.validation.loop.plants.Plant`.

    Parameters
    ----------
    rig : Rig
        The rig.
    model : SoftModel
        The model that the controller has.
    period : float
        Control period (s).
    around : Surroundings, optional
        The twin's obstacles, for their names.
    options : Any
        Options of the twin.

    Attributes
    ----------
    twin : Twin
        The plant.
    readings : NoisyReadings
        Its sensors.
    channels : tuple of LogChannel
        The quantities that it records.
    settings : dict of str to Any
        The fields of a log that it states.
    command : np.ndarray, (nu,)
        The last command, in the file's units.
    sent : np.ndarray, (nu,)
        The command before the bound on its rate, and before a winch's lag of its velocity.
    alters_states : bool
        Whether the controller's q and q̇ are late, noisy or biased.
    known : KnownRig
        What a controller knows of its actuators and cables.
    lateness : float
        Of the q and q̇ that the controller sees (s).
    """

    real_time = False

    def __init__(
        self,
        rig: Rig,
        model: SoftModel,
        period: float,
        around: Surroundings | None = None,
        **options: Any,
    ) -> None:
        robot, self._model = rig.robot(model.robot), model
        self.touch: Touch | None = None
        self._winches, self._period = Winches(model, robot.actuators), period
        self._drivers, friction = self._build(rig, robot, around, options)
        self._errors = _Errors(rig, model, period) if rig.noise > 0 or rig.bias > 0 else None
        self.alters_states = self._errors is not None or rig.latency > 0
        for name in ("lag", "delay", "latency"):
            if line := too_slow(f"rig: {name}", getattr(rig, name) or 0.0, period):
                warnings.warn(line, stacklevel=2)
        self.known = KnownRig(
            max((actuator.lag for actuator in robot.actuators), default=0.0),
            max((actuator.delay for actuator in robot.actuators), default=0.0),
            friction,
        )
        late = round(rig.latency / period)
        self.lateness = late * period
        self._past: deque[State] = deque(maxlen=late + 1)
        self._zero = model.relaxed
        names, readings = [actuator.name for actuator in robot.actuators], self.readings.layout
        self.channels: tuple[LogChannel, ...] = (
            LogChannel.of("command", zip(names, command_units(robot), strict=True), held=True),
            LogChannel.of("acting", inputs(model)),
            LogChannel.of("measured", zip(readings.names, readings.units(robot), strict=True)),
            LogChannel.of("q_seen", positions(model), held=True),
            LogChannel.of("v_seen", rates(model), held=True),
        )
        if self.touch is not None:
            self.channels += (self.touch.channel,)

    def _build(
        self, rig: Rig, robot: Robot, around: Surroundings | None, options: dict[str, Any]
    ) -> tuple[Drivers, np.ndarray | None]:
        """What moves, with its readings; the drivers, and the friction (tendons,) of cables."""
        self.settings = {"contacts": options.get("contacts", False) or rig.plant.contacts}
        self.twin: Twin = rig.plant.twin(robot, rig=True, **options)
        self._states = StateMap(self._model, self.twin)
        self.readings: NoisyReadings = Readings(self.twin, (rig.seed, SENSOR_STREAM))
        self.touch = Touch.of(self.twin, around)
        rubs = self.twin.cable_friction is not None
        return Drivers(robot, self.twin.model.opt.timestep), cable_friction(robot) if rubs else None

    def _begin(self, q: np.ndarray, v: np.ndarray, t: float) -> None:
        self.twin.set_state(*self._states.to_twin(q, v), t)

    def _hold(self, lengths: np.ndarray) -> None:
        """Begin with `command`, and with free lengths (nu,), that have acted for long."""
        self.twin.hold(self.command, lengths)

    def _move(self, commands: np.ndarray, steps: int) -> None:
        self.twin.advance(commands, steps)

    def start(
        self, q: np.ndarray, v: np.ndarray, t: float = 0.0, u: np.ndarray | None = None
    ) -> None:
        """Begin in a state, with the input u (nu,) long held.

        By default u is zero, or the bound nearest to it.
        """
        self._begin(q, v, t)
        if self.touch is not None:
            self.touch.check_start()
        state = self._model.state(q, v)
        lengths = self._winches.commands(state, self._zero if u is None else u)
        self.command = self.sent = self._drivers.start(lengths)
        self._hold(lengths)
        self._past.clear()
        self._commands = np.full(len(lengths), np.nan)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """The twin's q (nq,) and v (nv,)."""
        return self._states.from_twin(self.twin.data.qpos, self.twin.data.qvel)

    def see(self, state: State) -> State:
        """The state that the controller sees instead of `state`."""
        self._past.append(state)
        late = self._past[0]
        return late if self._errors is None else self._errors(late)

    def sample(self) -> dict[str, np.ndarray]:
        """The inputs (nu,) that act now, as forces, and the sensors' readings (k,)."""
        self._refresh()
        touched = {} if self.touch is None else self.touch.sample()
        return {"acting": self.acting, "measured": self.readings()[0], **touched}

    def _refresh(self) -> None:
        """Compute the quantities of the present state that are recorded."""
        self.twin.refresh()

    @property
    def _free(self) -> np.ndarray:
        """Free length (m) of each winch that a velocity commands, (nu,)."""
        return self.twin.free_lengths

    @property
    def acting(self) -> np.ndarray:
        """The inputs (nu,) that act, as forces; after `advance` those of one plant step before."""
        return self.twin.data.actuator_force[: self.twin.nu].copy()

    def direct(self, values: np.ndarray, commanded: np.ndarray, seen: State) -> np.ndarray:
        """The forces (nu,) for values (nu,) that are commands where `commanded`, forces elsewhere.

        A command becomes the force that it gives at the state that the controller saw, `seen`; of a
        velocity, that of the present free length. The next `advance` sends the command itself.
        """
        self._commands = np.where(commanded, values, np.nan)
        lengths = np.where(self._drivers.speeds, self._free, values)
        return np.where(commanded, self._winches.tensions(seen, lengths), values)

    def advance(self, u: np.ndarray, steps: int, seen: State) -> dict[str, np.ndarray]:
        """Integrate under the command for the force u (nu,), which is computed at `seen`."""
        asked, drivers = self._winches.commands(seen, u), self._drivers
        if drivers.speeds.any():
            change = (asked - self._free) / self._period
            asked = np.where(drivers.speeds, change, asked)
        asked = np.where(np.isnan(self._commands), asked, self._commands)
        self.sent = asked
        if drivers.prompt:
            self.command = asked
            self._move(asked, steps)
            return {"command": asked}
        for _ in range(steps):
            self.command = drivers.step(asked)
            self._move(self.command, 1)
        return {"command": self.command}
