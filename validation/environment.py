"""The loop as a Gymnasium environment: an agent takes the place of the controller.

Gymnasium knows it after an import of this module, which its own words for an environment can do:

    gymnasium.make("softdyn.validation.environment:softdyn/Reach-v0", robot="finger")
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import softdyn
from softdyn import InputError, SetPoint, SoftModel, State, statics
from softdyn.checks import array, instance, whole
from softdyn.controllers.policy import SENSORS, USUAL, InputScale, PolicyView
from softdyn.dynamics.model import check_model
from softdyn.exceptions import errors_in
from softdyn.files import read_toml
from softdyn.toml_table import TomlTable
from softdyn.validation.loop.arguments import starting_pose
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.loop import ControlLoop
from softdyn.validation.loop.observation import make_observer
from softdyn.validation.loop.plants import plant_of, timestep_of
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.loop.setups import setup_of
from softdyn.validation.loop.time_grid import MAX_TIMESTEP, TimeGrid
from softdyn.validation.loop.verdict import tip_diverged
from softdyn.validation.simulate import simulate
from softdyn.validation.studies.drawn_runs import DrawnRun, DrawnRuns, target_points
from softdyn.validation.studies.experiments import check_reach
from softdyn.validation.twin.twin import SimulationError

try:
    import gymnasium
    from gymnasium.spaces import Box
except ImportError:
    raise ImportError("softdyn.validation.environment needs the extra softdyn[rl]") from None

NAME = "softdyn/Reach-v0"
TARGETS = 64  # by default
SEEDS = 2**31  # of the noise of a rig
RewardOf = Callable[[State, np.ndarray, np.ndarray], float]


@dataclass(frozen=True, eq=False)
class Episode:
    """A finished or an unfinished episode; `ReachEnv.replay` runs it again.

    Attributes
    ----------
    target : ndarray, (3,)
        The target (m).
    drawn : DrawnRun
        The change, the sample, and the drawn values.
    options : dict of str to Any
        The settings of the run, as `RunOptions.of` takes them.
    inputs : ndarray, (N, nu)
        The inputs of the N periods so far, within their bounds.
    rewards : ndarray, (N,)
        The rewards.
    ended : str
        The reason of an early end; empty without one.
    """

    target: np.ndarray
    drawn: DrawnRun
    options: dict[str, Any]
    inputs: np.ndarray
    rewards: np.ndarray
    ended: str


class _Inputs:
    """A controller and its output: the input that it was given last, or the next one of rows."""

    name = "actions"

    def __init__(self, rows: np.ndarray | None = None) -> None:
        self._rows: Iterator[np.ndarray] = iter(() if rows is None else rows)
        self.u = np.zeros(0)

    def __call__(self, state: State, reference: Any) -> _Inputs:
        self.u = next(self._rows, self.u)
        return self


class ReachEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A robot's tip is to reach a target and to stay there.

    A step is a control period of `softdyn.validation.loop.ControlLoop`: the same twin, rig, delays,
    sensors and errors as in `simulate`. An action has a number in [-1, 1] for each input: -1 is the
    lower bound, 1 the upper one. Actions beyond are clipped and counted in ``info["clipped"]``;
    an action that is not finite is refused.

    An episode is *truncated* after `horizon`. It is *terminated* when the run cannot go on: the
    twin diverges, or its tip is farther from the target than twice the robot's length. Reaching the
    target does not end it. By default the reward is -‖e‖ / length. A terminated episode gets the
    reward of its last period for all periods that are left as well, so that no early end pays.

    Each episode draws its target and its errors with the generator of the environment. So equal
    seeds and equal actions give equal episodes, in any process.

    Parameters
    ----------
    robot : SoftModel or str or Path
        A model, or an argument of `softdyn.load`.
    targets : array_like (N, 3) or mapping or Callable or int, optional
        The targets of episodes (m): points; a sweep's table of `theta` and `point`; a function of
        a `numpy.random.Generator` that returns a point; or the seed of 64 tips of equilibria that
        are spread over the robot's reach. By default seed 0.
    observation : sequence of str, or ``"sensors"``
        The parts of the observation, see `softdyn.controllers.policy.PolicyView`: some of q, v, y,
        ydot, error, target, input, sensors. They are those that a controller sees, late and noisy
        with such a rig. ``"sensors"`` alone means the sensors and the target.
    reward : Callable[[State, ndarray, ndarray], float], optional
        Of the plant's state after the period, the target (3,) (m) and the input (nu,).
    horizon, period : float, optional
        Length of an episode and control period (s); 2 s, and the paper's period or 2 ms.
    randomised : mapping or str or Path, optional
        What differs from episode to episode: the tables `plant`, `rig`, `run`, `changes` and
        `samples` of a sweep, or a TOML file of them. See `DrawnRuns`. The seed of a rig's noise is
        drawn for each episode in any case.
    seed : int, optional
        Seed of the first episode, if `reset` gets none.
    render_mode : None
        There is none; `replay` gives a log with pictures.
    **options : Any
        Other settings of the run, the fields of `RunOptions`: plant, rig, observer, q0, ….

    Attributes
    ----------
    model : SoftModel
        The robot.
    grid : TimeGrid
        The control periods and plant steps of an episode.
    target : ndarray, (3,)
        The present target (m).
    episode : Episode
        The present episode so far.

    Raises
    ------
    InputError
        Unknown names, targets out of reach, a robot without inputs, and what `simulate` refuses.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        robot: SoftModel | str | Path,
        *,
        targets: Any = None,
        observation: str | Sequence[str] = USUAL,
        reward: RewardOf | None = None,
        horizon: float = 2.0,
        period: float | None = None,
        randomised: Mapping[str, Any] | str | Path | None = None,
        seed: int | None = None,
        render_mode: None = None,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            raise InputError("render_mode", "None; replay() gives a log", repr(render_mode))
        model = robot if isinstance(robot, SoftModel) else softdyn.load(robot)
        self.model, self.render_mode = check_model(model), None
        self._scale, self._seed = InputScale(model), None if seed is None else whole("seed", seed)
        for name in ("duration", "name"):
            if name in options:
                raise InputError("options", "settings of a run; horizon is its length", name)
        period = setup_of(model).period if period is None else period
        given = RunOptions.of({**options, "duration": horizon, "period": period})
        self._base = {key: one for key, one in given.table.items() if one is not None}
        own_step = timestep_of(model, given)
        most = MAX_TIMESTEP if own_step is None else own_step
        self.grid = TimeGrid.plan(horizon, period, given.timestep, most)
        self._length = model.robot.length
        table = read_toml(randomised) if isinstance(randomised, str | Path) else randomised
        where = str(randomised) if isinstance(randomised, str | Path) else "randomised"
        self._errors = DrawnRuns({} if table is None else table, model, where)
        self._targets = targets if callable(targets) else self._points_of(targets)
        self._reward, self._unit = reward, self._length or 1.0
        if reward is not None and not callable(reward):
            raise InputError("reward", "a callable (state, target, u) -> number", repr(reward))
        parts = (SENSORS, "target") if observation == SENSORS else observation
        self._given = _Inputs()
        self._loop: ControlLoop
        self._built: dict[str, Any] | None = None
        self._drawn = self._errors.draw(np.random.default_rng(0))
        self._start(self._drawn, 0)
        measured = [c for c in self._loop.plant.channels if c.name == "measured"]
        self.view = PolicyView(model, parts, sum(len(c.columns or ()) for c in measured))
        self._senses = SENSORS in self.view.parts
        self.observation_space = Box(-np.inf, np.inf, (self.view.size,), np.float64)
        self.action_space = Box(-1.0, 1.0, (model.nu,), np.float32)
        self._inputs = np.empty((self.grid.steps, model.nu))
        self._rewards = np.empty(self.grid.steps)
        self.target, self._aim = np.zeros(3), SetPoint(np.zeros(3))
        self._steps, self._over, self._ended = 0, True, ""
        self._seen = np.zeros(self.view.size)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Seed of this and the following episodes.
        options : dict, optional
            ``target``: a target (3,) (m) instead of a drawn one.

        Returns
        -------
        ndarray, dict
            The observation, and in ``info`` the target, the change, the sample, the drawn values
            and the seed of the rig.
        """
        super().reset(seed=self._seed if seed is None else seed)
        self._seed = None
        wanted = TomlTable(options or {}, "options").rest(("target",))
        drawn, noise = self._errors.draw(self.np_random), int(self.np_random.integers(SEEDS))
        target = self._target(self.np_random)
        if "target" in wanted:
            target = self._point("options: target", wanted["target"])
        self.target, self._aim, self._drawn = target, SetPoint(target), drawn
        self._steps, self._over, self._ended = 0, False, ""
        self._start(drawn, noise)
        self._given.u = self.model.relaxed
        loop = self._loop
        loop.u = self._given.u
        loop.read(0.0)
        self._observe(0.0)
        values = {name: np.array(value) for name, value in drawn.values.items()}
        info = {"target": target.copy(), "change": drawn.change, "sample": drawn.sample}
        return self._seen, {**info, "values": values, "seed": noise}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold an input for a control period.

        Parameters
        ----------
        action : ndarray, (nu,)
            In [-1, 1].

        Returns
        -------
        ndarray, float, bool, bool, dict
            Observation, reward, terminated, truncated, and in ``info`` the distance of the tip from
            the target (m), and how many components of the action were clipped.

        Raises
        ------
        InputError
            An action of another shape or that is not finite, a step after the end.
        """
        if self._over:
            raise InputError("step", "a reset before it, and after the end of an episode", "none")
        try:
            asked = np.array(action, float)
        except (TypeError, ValueError):
            asked = np.zeros(0)
        if asked.shape != (self.model.nu,) or not math.isfinite(asked @ asked):
            array("action", action, (self.model.nu,))  # raises, unless the square overflows
        loop, k = self._loop, self._steps
        self._given.u = self._scale.input(asked)
        loop.decide(k * self.grid.period, self._aim)
        u = self._inputs[k] = loop.admit()
        state = loop.state
        assert state is not None
        self._steps = k + 1
        t = self._steps * self.grid.period
        try:
            loop.advance(self.grid.plant_steps(k))
            loop.read(t)
            self._ended = "" if loop.state is not None else "a state that is not finite"
        except SimulationError as error:
            self._ended = error.reason
        if not self._ended:
            assert loop.state is not None
            state = loop.state
        away = self.target - state.y
        distance = math.sqrt(away @ away)
        if not self._ended:
            self._ended = tip_diverged(t, distance, self._length) or ""
        if not self._ended:
            self._observe(t)
        terminated = bool(self._ended)
        truncated = not terminated and self._steps == self.grid.steps
        self._over = terminated or truncated
        reward = -distance / self._unit
        if self._reward is not None:
            reward = float(self._reward(state, self.target, u))
        if terminated:
            reward += min(reward, 0.0) * (self.grid.steps - self._steps)
        self._rewards[k] = reward
        info = {"distance": distance, "clipped": np.count_nonzero(np.abs(asked) > 1.0)}
        return self._seen, reward, terminated, truncated, info

    @property
    def episode(self) -> Episode:
        """The present episode so far, as a copy."""
        n = self._steps
        options, target = dict(self._built or {}), self.target.copy()
        inputs, rewards = self._inputs[:n].copy(), self._rewards[:n].copy()
        return Episode(target, self._drawn, options, inputs, rewards, self._ended)

    def replay(self, episode: Episode | None = None) -> Log:
        """The log of an episode, by default the present one, from `simulate` with its inputs.

        Raises
        ------
        InputError
            An episode without a step.
        """
        one = self.episode if episode is None else instance("episode", episode, Episode, "Episode")
        if not len(one.inputs):
            raise InputError("episode", "one with steps", "one without")
        given = RunOptions.of(one.options)
        length = min(self.grid.duration, len(one.inputs) * self.grid.period)
        options = {**given.table, "duration": length, "name": _Inputs.name}
        options = {key: value for key, value in options.items() if value is not None}
        return simulate(self.model, _Inputs(one.inputs), SetPoint(one.target), **options)

    def _observe(self, t: float) -> None:
        """Make the observation of the present state."""
        loop = self._loop
        seen = loop.see(t)
        readings = loop.values["measured"] if self._senses else None
        self._seen = self.view(seen, self.target, loop.u, readings)

    def _start(self, drawn: DrawnRun, noise: int) -> None:
        """Put the plant at its start, and build it first where it differs from the last one."""
        table = self._options(drawn, noise)
        if table != self._built:
            with errors_in("options"):
                given = RunOptions.of(table)
                plant = plant_of(self.model, given, self.grid.period, self.grid.timestep)
                observer = make_observer(self.model, given.rig, given.observer)
                self._loop = ControlLoop(self.model, plant, self._given, observer)
            self._built = table
            self._q, _ = starting_pose(self.model, given.q0)
            still = np.zeros(self.model.nv)
            self._v = still if given.v0 is None else array("v0", given.v0, still.shape)
        try:
            self._loop.plant.start(self._q, self._v)
        except SimulationError as error:
            raise InputError("q0, v0", "a state that MuJoCo can start from", error.reason) from None
        if self._loop.observation is not None:
            self._loop.observation.reset()

    def _options(self, drawn: DrawnRun, noise: int) -> dict[str, Any]:
        """The settings of a run: the given ones, the drawn ones, and the seed of the rig."""
        table = dict(self._base)
        for name, value in drawn.options.items():
            before = table.get(name)
            if name == "rig" and isinstance(before, str):
                before = {"file": True}
            both = isinstance(value, Mapping) and isinstance(before, Mapping)
            table[name] = {**before, **value} if both and before is not None else value
        rig = table.get("rig")
        if rig is not None:
            rig = {"file": True} if isinstance(rig, str) else dict(rig)
            table["rig"] = rig if "seed" in drawn.options.get("rig", {}) else {**rig, "seed": noise}
        return table

    def _point(self, name: str, value: Any) -> np.ndarray:
        """A target (3,) within reach."""
        found = array(name, value, (3,))
        with errors_in(name):
            check_reach(self.model, found)
        return found

    def _target(self, rng: np.random.Generator) -> np.ndarray:
        """A drawn target."""
        if callable(self._targets):
            return self._point("targets", self._targets(rng))
        drawn: np.ndarray = self._targets[int(rng.integers(len(self._targets)))]
        return drawn

    def _points_of(self, given: Any) -> np.ndarray:
        """The targets (k, 3) to draw from."""
        if given is None or isinstance(given, int):
            found = statics.spread_rests(self.model, TARGETS, whole("targets", given or 0))
            points = np.array([one.y for one in found])
        elif isinstance(given, Mapping):
            points = target_points(given, self.model)
        else:
            points = np.atleast_2d(np.asarray(given))
        if not len(points):
            raise InputError("targets", "at least one point", "none")
        return np.array([self._point("targets", point) for point in points])


gymnasium.register(NAME, entry_point=f"{__name__}:{ReachEnv.__name__}")
