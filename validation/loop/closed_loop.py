"""One closed loop: a controller on the analytic model drives the MuJoCo twin."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from softdyn import InputError, SoftModel, State
from softdyn.checks import array, beyond
from softdyn.controllers.controller import guard_of, waiting
from softdyn.copies import Separate
from softdyn.description.robot import input_unit
from softdyn.dynamics.model import check_model
from softdyn.estimation import Observer
from softdyn.safety import Surroundings
from softdyn.validation.loop import verdict
from softdyn.validation.loop.arguments import (
    ReferenceLike,
    check_controller,
    check_robot,
    checked,
    mapped_plant,
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
from softdyn.validation.loop.log_checks import ESTIMATED, RIGGED
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.loop.observation import Observation
from softdyn.validation.loop.record import (
    ControllerOutput,
    ControlStep,
    Counts,
    Recorder,
    package_versions,
)
from softdyn.validation.loop.time_grid import MAX_TIMESTEP, TimeGrid
from softdyn.validation.plain_data import to_plain_data
from softdyn.validation.twin.rig import Rig, RiggedPlant, check_rig, rig_of
from softdyn.validation.twin.settings import Integrator
from softdyn.validation.twin.state_map import MappedPlant, Plant, StateMap
from softdyn.validation.twin.twin import SimulationError, Twin

Controller = Callable[[State, Any], ControllerOutput]
OnStep = Callable[[float, State, ControllerOutput], None]


class ClosedLoop(Separate):
    """A controller and its plant, run one control period at a time.

    At the beginning of a period, `control` gives the twin's state to `model.state` and then to the
    controller, and clips the answer to the robot's bounds. `advance` holds this input while MuJoCo
    integrates with ``implicitfast`` and joint limits. `step` does both, `run` repeats it to the
    end.

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
        Returns an array u (nu,), or an object with `u` and optionally V, delta, status. These
        attributes are recorded if they exist: integers `not_solved` and `fallbacks`, a float
        `max_bound_violation` (of the controller or its `guard`), and `gains` or `parameters`. A
        method `reset` is called once before the run with the control period (s). An attribute
        `waits` is True during its calls, so that they wait for its searches. Its exceptions are
        passed on; those of a step have the run so far as their attribute ``log``.
    reference : Experiment or Callable[[float], Reference]
        The second is of t (s), e.g. a `SetPoint`. `nowhere` is for a rollout, in which no distance
        from a reference is judged.
    duration, period : float, optional
        Length of the run, to the nearest plant step, and control period (s); the experiment's by
        default, 10 s and 2 ms without one. Where the period does not divide the duration, the last
        hold is shorter.
    timestep : float, optional
        Plant step (s), which must divide the period; by default the largest ≤ 0.5 ms.
    integrator : Integrator or str
        The twin's scheme.
    q0, v0 : np.ndarray, (nq,), (nv,), optional
        Initial state, within the joint limits; by default at rest in the configuration within the
        limits that is nearest to q = 0.
    contacts : bool
        Whether the plant's links can touch.
    friction : bool
        Whether the plant has the file's dry friction of joints, and of cables on their guides.
    twin : Callable[..., Twin]
        Makes the plant, called as `Twin` with the robot, timestep, contacts and friction.
    plant : str, Path or MappedPlant, optional
        A user's MJCF file, or its `Scene`, which replaces the twin. Its own contacts and friction
        hold, and its step if that divides the period. A warning is given if the file differs from
        the model's.
    rig : Rig or str, optional
        The rig between controller and plant: None for an ideal one, ``"file"`` for that of the
        robot's file, or a `Rig`.
    observer : Observer, optional
        It estimates the state that the controller gets, from the rig's sensors: an
        `softdyn.estimation.Ekf`, or an object of your own with ``step(t, measurements, u)``. The
        State has the estimate's `covariance` (2 nv, 2 nv), if there is one.
    surroundings : Surroundings, optional
        Obstacles around the robot: in the twin, and their reserve in the log.
    name : str, optional
        Name of the controller in the log; its `name` or its class by default.

    Attributes
    ----------
    model, controller, name, surroundings
        As above.
    plant : Plant
        The twin, or the user's own plant.
    plant_file : str or None
        Name of the user's file that is the plant, None where it is the twin.
    experiment : Experiment or None
        The reference, if it is one.
    reference : Callable[[float], Reference]
        The desired tip at t (s), checked.
    aims : bool
        Whether there is a reference.
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
        *,
        duration: float | None = None,
        period: float | None = None,
        timestep: float | None = None,
        integrator: Integrator | str = Integrator.IMPLICITFAST,
        q0: np.ndarray | None = None,
        v0: np.ndarray | None = None,
        contacts: bool = False,
        friction: bool = False,
        twin: Callable[..., Twin] = Twin,
        plant: str | Path | MappedPlant | None = None,
        rig: Rig | str | None = None,
        observer: Observer | None = None,
        surroundings: Surroundings | None = None,
        name: str | None = None,
    ) -> None:
        self.model, self.controller = check_model(model), controller
        self.experiment = reference if isinstance(reference, Experiment) else None
        planned, usual = SET_POINT_DURATION, DEFAULT_PERIOD
        self._length = model.robot.length
        if isinstance(reference, Experiment):
            check_robot(model, reference)
            planned, usual = reference.duration, reference.period
            self._length = reference.length
            reference = reference.reference
        self.aims = reference is not nowhere
        self.reference = checked(reference)
        own = None if plant is None else mapped_plant(model, plant, contacts or friction)
        self.grid = TimeGrid.plan(
            planned if duration is None else duration,
            usual if period is None else period,
            timestep,
            MAX_TIMESTEP if own is None else own.timestep,
        )
        if period is not None and beyond(self.grid.period, self.grid.duration):
            expected = f"at most the run's {self.grid.duration:g} s"
            raise InputError("period", expected, f"{self.grid.period:g} s")
        check_controller(controller)
        if not isinstance(name, str | None):
            raise InputError("name", "text", repr(name))
        q, self.start = starting_pose(model, q0)
        v = np.zeros(model.nv) if v0 is None else array("v0", v0, (model.nv,))
        warn_of_fast_springs(model, model.state(q, v).M, self.grid.timestep)
        self.plant: Plant
        self._rig: RiggedPlant | None = None
        options: dict[str, Any] = {"contacts": contacts, "friction": friction}
        options |= {"timestep": self.grid.timestep}
        if surroundings is not None:
            if own is not None:
                raise InputError("obstacles", "none beside a plant of your own", own.path.name)
            options["obstacles"] = surroundings.obstacles
        if integrator != Integrator.IMPLICITFAST:
            options["integrator"] = integrator
        if (wanted := rig_of(rig)) is not None:
            check_rig(own, twin)
            self._rig = RiggedPlant(wanted, model, self.grid.period, **options)
            self.plant = self._rig.twin
            self._states, self.plant_file = StateMap(model, self.plant), None
        elif own is None:
            self.plant = twin(model.robot, **options)
            self._states, self.plant_file = StateMap(model, self.plant), None
        else:
            own.timestep, contacts = self.grid.timestep, own.contacts
            self.plant, self._states, self.plant_file = own, own.states, own.path.name
        try:
            self.plant.set_state(*self._states.to_twin(q, v))
        except SimulationError as error:
            raise InputError("q0, v0", "a state that MuJoCo can start from", error.reason) from None
        self.name, self._contacts = name or name_of(controller), contacts
        self._guard = guard_of(controller, model)
        self._record = Recorder(model, self.grid.times(), self._guard)
        self.surroundings = surroundings
        if surroundings is not None:
            self._record.extra(("reserve",), barriers=len(surroundings.names))
        if hasattr(controller, "reset"):
            controller.reset(self.grid.period)
        if self._rig is not None:
            self._record.extra(RIGGED, sensors=len(self._rig.readings.names))
            self._rig.start(model.state(q, v))
        self._observe = None if observer is None else Observation(observer, model, self._rig)
        if self._observe is not None:
            self._observe.reset()
            if self._observe.units:
                self._record.extra(ESTIMATED, disturbances=len(self._observe.units))
        self._counts = Counts(controller)
        self.steps, self.done, self._complete = 0, False, False
        self.reason: str | None = None

    def control(self) -> ControlStep | None:
        """Read the plant, and ask the controller for the input of the next period.

        Returns
        -------
        ControlStep or None
            None if the run is over; `reason` says why.
        """
        if self.done:
            return None
        model, controller, record, k = self.model, self.controller, self._record, self.steps
        t = float(record.t[k])
        q, v = self._read_plant()
        if not math.isfinite(q @ q + v @ v):
            self._end(verdict.not_finite(t))
            return None
        began = perf_counter_ns()
        state = model.state(q, v)
        spent = perf_counter_ns() - began
        target = self.reference(t)
        distance = record.sample(k, state.y, target.y)
        if self.surroundings is not None:
            record.put(k, reserve=self.surroundings.reserve(state))
        diverged = verdict.tip_diverged(t, distance, self._length) if self.aims else None
        if diverged is not None:
            self._end(diverged)
            return None
        seen = state if self._rig is None else self._see(k, state)
        if k == self.grid.steps:
            fault = verdict.not_converged(record.error[0], record.error[k], target)
            self._end(fault if self.aims else None, complete=True)
            return None
        if self._observe is not None:
            spent = self._observe.nanoseconds
        with waiting(controller):
            began = perf_counter_ns()
            output = controller(seen, target)
            spent += perf_counter_ns() - began
        fault = record.output(k, output, spent)
        if fault is not None:
            self._end(verdict.no_input(t, fault))
            return None
        acting = record.u[k] if self._rig is None else self._rig.acting
        return ControlStep(t, seen, output, record.u[k], state, acting)

    def advance(self) -> None:
        """Integrate the plant over a control period under the input of the last `control`."""
        k = self.steps
        self.steps += 1
        try:
            if self._rig is None:
                self.plant.advance(self._record.u[k], self.grid.plant_steps(k))
            else:
                command = self._rig.advance(self._record.u[k], self.grid.plant_steps(k))
                self._record.put(k, command=command)
        except SimulationError as error:
            with np.errstate(invalid="ignore"):  # the cosine of an infinite angle
                self._read_plant()
            self._end(verdict.plant_stopped(error.time, error.reason))

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
        (not_solved, fallbacks, violation), fault = self._counts.told()
        reason = self.reason or fault
        steps = self.steps if self.done else max(self._record.samples - 1, 0)
        recorded: dict[str, Any] = {**self._record.arrays(steps)}
        if self._rig is not None:
            recorded |= self._rig.columns()
        if self._observe is not None:
            units = self._observe.units
            recorded |= {"disturbance_names": (*units,), "disturbance_units": (*units.values(),)}
        recorded |= self._record.task_errors(steps, controller, self.reference)
        if self.surroundings is not None:
            recorded["obstacles"] = self.surroundings.table
        return Log(
            **recorded,
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
            joint_names=model.joint_names,
            contacts=self._contacts,
            complete=self._complete,
            failed=reason is not None,
            reason=reason,
            not_solved=not_solved,
            fallbacks=fallbacks,
            max_bound_violation=max(self._guard.max_bound_violation, violation),
            gains=to_plain_data(
                getattr(controller, "gains", getattr(controller, "parameters", None))
            ),
            versions=dict(package_versions()),
            source=LoggedRobot.of(model),
            plant=self.plant_file,
            start=self.start,
        )

    def _see(self, k: int, state: State) -> State:
        """The state that the controller sees; record it, the acting inputs and the readings."""
        assert self._rig is not None
        acting, measured = self._rig.sample()
        if self._observe is None:
            seen = self._rig.see(state)
        else:
            t = float(self._record.t[k])
            seen = self._rig.show(self._observe(t, measured, self._rig.sent))
            if self._observe.units:
                estimated = zip(ESTIMATED, self._observe.disturbances, strict=True)
                self._record.put(k, **dict(estimated))
        self._record.put(k, acting=acting, measured=measured)
        if k < self.grid.steps:
            self._record.put(k, q_seen=seen.q, v_seen=seen.v)
        return seen

    def _end(self, reason: str | None, complete: bool = False) -> None:
        self.done, self.reason, self._complete = True, reason, complete

    def _read_plant(self) -> tuple[np.ndarray, np.ndarray]:
        """Read the plant's state q (nq,), v (nv,) and record it as sample `steps`."""
        q, v = self._states.from_twin(self.plant.data.qpos, self.plant.data.qvel)
        self._record.q[self.steps], self._record.v[self.steps] = q, v
        return q, v
