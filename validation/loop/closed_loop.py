"""A recorded run: a controller on the analytic model drives a plant for a planned time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from softdyn import InputError, SoftModel, State
from softdyn.checks import array, beyond
from softdyn.controllers.channels import LogChannel, channels_of
from softdyn.controllers.controller import WrappingController, reset_controller
from softdyn.controllers.law import NamedLaw
from softdyn.copies import Separate
from softdyn.description.robot import input_unit
from softdyn.dynamics.model import check_model
from softdyn.validation.loop import verdict
from softdyn.validation.loop.arguments import (
    ReferenceLike,
    check_controller,
    check_robot,
    checked,
    name_of,
    nowhere,
    starting_pose,
    warn_of_fast_springs,
)
from softdyn.validation.loop.experiment import (
    DEFAULT_PERIOD,
    ROLLOUT,
    SET_POINT_DURATION,
    Experiment,
)
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.loop.loop import ControlLoop
from softdyn.validation.loop.observation import make_observer
from softdyn.validation.loop.plants import Plant, known_rig, plant_of, timestep_of
from softdyn.validation.loop.provenance import package_versions
from softdyn.validation.loop.record import (
    ControllerOutput,
    ControlStep,
    Counts,
    Recorder,
)
from softdyn.validation.loop.repeat import record_of
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.loop.time_grid import MAX_TIMESTEP, TimeGrid
from softdyn.validation.plain_data import to_plain_data
from softdyn.validation.twin.twin import SimulationError

Controller = Callable[[State, Any], ControllerOutput]
OnStep = Callable[[float, State, ControllerOutput], None]


class ClosedLoop(Separate):
    """A `ControlLoop` that follows a reference for a planned time, and its record.

    `control` reads the plant and asks the controller for the input of a period, which is clipped to
    the robot's bounds. `advance` holds it. `step` does both, `run` repeats it to the end.

    A run is *failed* when

    - an answer is not a finite (nu,) array, or a count of the controller is not a number,
    - the plant diverges: a state that is not finite, a MuJoCo warning, or a tip farther from its
      reference than twice the robot's length (each of these ends the run and is in the log), or
    - the final ‖e‖ of the tip alone is not below the initial one (nor below a micrometre).

    Parameters
    ----------
    model : SoftModel
        The robot; the twin is built from its file, by its own path.
    controller : Callable[[State, Reference], ControllerOutput]
        Returns an array u (nu,), or an object with `u` and optionally V, delta, status, and values
        of the channels that the controller declares as `channels`. These attributes are recorded if
        they exist: integers `not_solved` and `fallbacks`, a float `max_bound_violation` (of the
        controller or its `guard`), and `gains` or `parameters`. A method `reset` is called once
        before the run with the control period (s), and with the plant's rig if it has a parameter
        `rig`. An attribute `waits` is True during its calls, so that they wait for its searches.
        Its exceptions are passed on; those of a step have the run so far as their attribute
        ``log``.
    reference : Experiment or Callable[[float], Reference]
        The second is of t (s), e.g. a `SetPoint`. `nowhere` is for a rollout, in which no distance
        from a reference is judged.
    options : RunOptions, optional
        All other arguments.

    Attributes
    ----------
    loop : ControlLoop
        What is stepped.
    model, controller, name, surroundings
        As above.
    experiment : Experiment or None
        The reference, if it is one.
    reference : Callable[[float], Reference]
        The desired tip at t (s), checked.
    aims : bool
        Whether there is a reference.
    judged : bool
        Whether a run that comes no nearer to its reference has failed; `aims` if nobody changes it.
    record : dict
        The record of the run as plain data, see `repeat.record_of`.
    grid : TimeGrid
        The run's periods and plant steps.
    steps : int
        Control steps done.
    start : str
        Joints that the default start moves to their limits; empty where it is q = 0.
    done, reason : bool, str or None
        Whether the run is over; why it ended early or failed.

    Raises
    ------
    InputError
        For arguments that cannot be run, and for a reference that is not finite.
    """

    def __init__(
        self,
        model: SoftModel,
        controller: Controller,
        reference: ReferenceLike,
        options: RunOptions | None = None,
    ) -> None:
        options = RunOptions() if options is None else options
        self.model, self.controller = check_model(model), controller
        self.experiment = reference if isinstance(reference, Experiment) else None
        planned, usual = SET_POINT_DURATION, DEFAULT_PERIOD
        self._length = model.robot.length
        if isinstance(reference, Experiment):
            check_robot(model, reference)
            planned, usual = reference.duration, reference.period
            self._length = reference.length
            reference = reference.reference
        self.aims = self.judged = reference is not nowhere
        self.reference = checked(reference)
        own_step = timestep_of(model, options)
        self.grid = TimeGrid.plan(
            planned if options.duration is None else options.duration,
            usual if options.period is None else options.period,
            options.timestep,
            MAX_TIMESTEP if own_step is None else own_step,
        )
        if options.period is not None and beyond(self.grid.period, self.grid.duration):
            expected = f"at most the run's {self.grid.duration:g} s"
            raise InputError("period", expected, f"{self.grid.period:g} s")
        check_controller(controller)
        (q, v), self.start = self._start_of(options)
        warn_of_fast_springs(model, model.state(q, v), self.grid.timestep)
        plant = plant_of(model, options, self.grid.period, self.grid.timestep)
        observer = make_observer(model, options.rig, options.observer)
        self.loop = ControlLoop(model, plant, controller, observer)
        self.begin(options)
        self.name, self.surroundings = options.name or name_of(controller), options.surroundings
        self._record = Recorder(model, self.grid.times(), self.loop.channels)
        if self.surroundings is not None:
            barriers = [(name, "m") for name in self.surroundings.names]
            self._record.add(LogChannel.of("reserve", barriers))
        reset_controller(
            controller, self.grid.period, known_rig(plant, self.loop.observation is None)
        )
        self._record.declare(channels_of(controller))
        if self.loop.observation is not None:
            self.loop.observation.reset()
        self._counts = Counts(controller)
        observer = None if self.loop.observation is None else self.loop.observation.observer
        given = reference if self.experiment is None else self.experiment
        self.record = record_of(model, controller, given, options, observer)
        self.steps, self.done, self._complete = 0, False, False
        self.reason: str | None = None

    def _start_of(self, options: RunOptions) -> tuple[tuple[np.ndarray, np.ndarray], str]:
        """The state (q, v) from which these settings begin, and what is to be said of it."""
        model = self.model
        q, said = starting_pose(model, options.q0)
        v = np.zeros(model.nv) if options.v0 is None else array("v0", options.v0, (model.nv,))
        return (q, v), said

    def begin(self, options: RunOptions) -> None:
        """Put the plant in the state from which these settings begin."""
        try:
            self.plant.start(*self._start_of(options)[0])
        except SimulationError as error:
            raise InputError("q0, v0", "a state that MuJoCo can start from", error.reason) from None

    @property
    def samples(self) -> int:
        """Number of samples recorded; one more than steps once the last one is there."""
        return self._record.samples

    @property
    def plant(self) -> Plant:
        """The plant."""
        return self.loop.plant

    def control(self) -> ControlStep | None:
        """Read the plant, and ask the controller for the input of the next period.

        Returns
        -------
        ControlStep or None
            None if the run is over; `reason` says why.
        """
        if self.done:
            return None
        loop, record, k = self.loop, self._record, self.steps
        t = float(record.t[k])
        q, v = loop.read(t)
        record.put(k, q=q, v=v)
        state = loop.state
        if state is None:
            self._end(verdict.not_finite(t))
            return None
        target = self.reference(t)
        distance = record.sample(k, state.y, target.y)
        if self.surroundings is not None:
            record.put(k, reserve=self.surroundings.reserve(state))
        diverged = verdict.tip_diverged(t, distance, self._length) if self.aims else None
        if diverged is not None:
            self._end(diverged)
            return None
        seen = loop.see(t)
        record.put(k, **loop.values)
        if k == self.grid.steps:
            law = self.controller
            while isinstance(law, WrappingController):
                law = law.inner
            horizon = law.horizon if isinstance(law, NamedLaw) else 0.0
            fault = verdict.not_converged(record.error_at(0), record.error_at(k), target, horizon)
            self._end(fault if self.judged else None, complete=True)
            return None
        if "q_seen" in record.channels:
            record.put(k, q_seen=seen.q, v_seen=seen.v)
        output = loop.decide(t, target)
        try:
            u = loop.admit()
        except InputError as error:
            self._end(verdict.no_input(t, str(error)))
            return None
        record.output(k, output, u, loop.nanoseconds)
        return ControlStep(t, seen, output, u, state, loop.values.get("acting", u))

    def advance(self) -> None:
        """Hold the input of the last `control` for a control period."""
        k = self.steps
        self.steps += 1
        try:
            self._record.put(k, **self.loop.advance(self.grid.plant_steps(k)))
        except SimulationError as error:
            with np.errstate(invalid="ignore"):  # the cosine of an infinite angle
                found = self.plant.state()
            if found is not None:
                self._record.put(self.steps, q=found[0], v=found[1])
            self._end(verdict.plant_stopped(error.time, error.reason))

    def hold(self, **values: Any) -> None:
        """Record a period without a control step: the clock is late, and the last input acts on.

        Parameters
        ----------
        **values : Any
            Values of this period's sample that differ from the last one's, by channel.
        """
        if self.done or not 0 < self.steps < self.grid.steps:
            return
        k = self.steps
        self._record.repeat(k, self.reference(float(self._record.t[k])).y)
        self._record.put(k, **values)
        self.steps += 1

    def stopped(self, reason: str) -> None:
        """End the run early; `reason` is in its log."""
        last = max(self._record.samples - 1, 0)
        self.reason = f"stopped at {self._record.t[last]:.4g} s: {reason}"

    def share(self, shared: Callable[[np.ndarray], np.ndarray]) -> None:
        """Keep the record in other arrays, such as copies in memory that processes share."""
        self._record.share(shared)

    def resume_at(self, steps: int) -> None:
        """Go on from a record of so many control steps that another process has made."""
        self.steps, self.done = steps, False
        self._record.samples = steps

    def step(self) -> ControlStep | None:
        """Run one control period, `control` and `advance`; None if the run is over."""
        step = self.control()
        if step is not None:
            self.advance()
        return step

    def run(self, *, progress: bool = False, on_step: OnStep | None = None) -> Log:
        """Run all remaining control periods.

        Parameters
        ----------
        progress : bool
            Show a bar on stderr if that is a terminal.
        on_step : Callable[[float, State, ControllerOutput], None], optional
            Called with t (s), the State and the answer at every control step.

        Returns
        -------
        Log
            The run from its beginning.

        Raises
        ------
        Exception
            Any exception of the controller, the observer or the reference, and the
            KeyboardInterrupt of Ctrl-C. The exception has the run so far as its attribute ``log``.
        """
        off = None if progress else True
        with (
            self.log_in_errors(),
            tqdm(total=self.grid.steps, disable=off, leave=False, unit="step") as bar,
        ):
            while (step := self.control()) is not None:
                if on_step is not None:
                    on_step(step.t, step.state, step.output)
                self.advance()
                bar.update()
        return self.log()

    @contextmanager
    def log_in_errors(self) -> Iterator[None]:
        """Give each exception that leaves the block the run so far, as its attribute ``log``."""
        try:
            yield
        except BaseException as error:
            self.reason = verdict.stopped_by(float(self._record.t[self.steps]), error)
            with suppress(Exception):  # the log asks the controller for its gains and counts
                error.log = self.log()  # type: ignore[attr-defined]
            raise

    def log(self) -> Log:
        """The run so far; it is not complete before the last control period."""
        model, controller, experiment = self.model, self.controller, self.experiment
        (not_solved, fallbacks, violation), fault = self._counts.totals()
        reason = self.reason or fault
        steps = self.steps if self.done else max(self._record.samples - 1, 0)
        more, marks = self._record.of_tasks(steps, controller, self.reference)
        channels = [*self._record.filled(steps), *more]
        return Log(
            {channel.name: channel for channel in channels},
            u_min=model.u_min,
            u_max=model.u_max,
            u_unit=input_unit(model.robot),
            robot=model.bundled or model.name,
            controller=self.name,
            kind=experiment.kind if experiment else (None if self.aims else ROLLOUT),
            theta=experiment.theta if experiment else None,
            omega=experiment.omega if experiment else None,
            duration=self.grid.duration,
            period=self.grid.period,
            timestep=self.grid.timestep,
            length=self._length if self._length > 0 else None,
            complete=self._complete,
            failed=reason is not None,
            reason=reason,
            not_solved=not_solved,
            fallbacks=fallbacks,
            max_bound_violation=max(self.loop.guard.max_bound_violation, violation),
            gains=to_plain_data(
                getattr(controller, "gains", getattr(controller, "parameters", None))
            ),
            versions=dict(package_versions()),
            source=LoggedRobot.of(model),
            marks=marks,
            obstacles=None if self.surroundings is None else self.surroundings.table,
            start=self.start,
            record=self.record,
            **self.plant.settings,
        )

    def _end(self, reason: str | None, complete: bool = False) -> None:
        self.done, self.reason, self._complete = True, reason, complete
