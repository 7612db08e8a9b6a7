"""One run on a real rig: the loop, the clock, the fail-safe and the watchdog."""

from __future__ import annotations

import copy
import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from softdyn import InputError, SoftModel, State
from softdyn.actuation import Winches
from softdyn.checks import array, number
from softdyn.dynamics.model import check_model
from softdyn.estimation import Ekf, Observer
from softdyn.exceptions import one_line
from softdyn.validation.bench.clock import MONOTONIC, Deadlines, TimeSource
from softdyn.validation.bench.driver import Driver, another, check_driver
from softdyn.validation.bench.fail_safe import FailSafe, RigLimits, Stop, StopCause
from softdyn.validation.bench.plant import RealRig, SeeingObserver, rest_pose
from softdyn.validation.bench.signals import Signals, limited
from softdyn.validation.bench.watchdog import STOP, Watchdog, shared
from softdyn.validation.files import save_somewhere
from softdyn.validation.loop.arguments import ReferenceLike, nowhere
from softdyn.validation.loop.closed_loop import ClosedLoop, Controller
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.record import ControlStep
from softdyn.validation.loop.settings import RunOptions

SWITCH = 1e-4  # s; another thread gives the interpreter back after so long
COLLECT = 1.0  # s between two collections of garbage, in the idle part of a period
IDLE = 0.5  # of a period that must be left for one
WARM = 20  # calls of copies of observer and controller before the run
SHOWN = 0.2  # s between two looks of the progress bar


@dataclass(frozen=True)
class DriveResult:
    """A run on a rig.

    Attributes
    ----------
    log : Log
        Its record.
    cause : StopCause
        The cause for which it stopped.
    reason : str
        The same in a sentence; empty at the planned end.
    error : BaseException or None
        An exception of the user's code that stopped it.
    finished : bool
        Whether it came to its planned end, even if the driver's `stop` failed afterwards.
    """

    log: Log
    cause: StopCause
    reason: str
    error: BaseException | None = None
    finished: bool = False


def drive(
    model: SoftModel,
    controller: Controller,
    reference: ReferenceLike,
    driver: Driver,
    observer: Observer | None = None,
    period: float = 0.005,
    duration: float = 10.0,
    **options: Any,
) -> Log:
    """Run a controller on a real rig, and record what happens: a `Drive` in one call.

    Parameters
    ----------
    model : SoftModel
        The robot, with its rig in the file.
    controller : Callable[[State, Reference], ControllerOutput]
        As for `softdyn.validation.simulate`. It is prepared for the reference before the run.
    reference : Experiment or Callable[[float], Reference]
        The second is of t (s), e.g. a `SetPoint`.
    driver : Driver
        The rig's driver.
    observer : Observer, optional
        It estimates the state from the readings; an `Ekf` of the file's sensors by default.
    period, duration : float
        Control period and length of the run (s).
    **options : Any
        `limits`, `name`, `watchdog`, `hold` and `log_to` of `Drive`.

    Returns
    -------
    Log
        The run, whatever has stopped it; `Log.reason` says what, unless it is the planned end.

    Raises
    ------
    InputError
        For arguments that cannot be run.
    """
    return (
        Drive(model, controller, reference, driver, observer, period, duration, **options).run().log
    )


class Drive:
    """A run on a real rig, made ready before it begins.

    The constructor opens nothing. It prepares the controller for the reference. The estimate begins
    where the arm rests: at the equilibrium under the relaxed input. `run` calls copies
    of controller and observer, so that everything is compiled. Then it starts the driver, keeps the
    period, and always ends with ``driver.stop()``. A `stop` that does not return is interrupted
    after 2 s, and tried a second time.

    Parameters
    ----------
    model, controller, reference, driver, observer, period, duration
        As for `drive`.
    limits : RigLimits
        When the run must stop, and its ramps.
    name : str, optional
        The controller's name in the log.
    watchdog : bool
        Whether a process of its own relaxes the rig if this one dies or blocks. It *kills* this
        process if it is late by `RigLimits.late` and a whole period.
    hold : array_like, (nu,), or Callable[[], ndarray], optional
        Commands in the file's units, sent instead of the controller's: constant, or those of each
        period.
    log_to : str or Path, optional
        A file; if the watchdog has to act, it writes the log up to there.
    source : TimeSource
        The clock; readings are stamped by it.

    Attributes
    ----------
    loop : ClosedLoop
        The loop.
    clock : Deadlines
        Its clock.
    observer : Observer
        The observer of the state.

    Raises
    ------
    InputError
        For arguments that cannot be run: no sensors, no driver, a period that is not positive.
    """

    def __init__(
        self,
        model: SoftModel,
        controller: Controller,
        reference: ReferenceLike,
        driver: Driver,
        observer: Observer | None = None,
        period: float = 0.005,
        duration: float = 10.0,
        *,
        limits: RigLimits | None = None,
        name: str | None = None,
        watchdog: bool = True,
        hold: Any = None,
        log_to: str | Path | None = None,
        source: TimeSource = MONOTONIC,
    ) -> None:
        self.limits = RigLimits() if limits is None else limits
        self._driver = check_driver(driver)
        self._model = check_model(model)
        self._log_to = log_to
        number("period", period, above=0.0)
        if not model.robot.sensors:
            raise InputError("model", "a file with <sensor> elements, which a rig reads", "none")
        safe = self._safe = FailSafe(model, self.limits, period)
        if hold is not None and not callable(hold):
            hold = array("hold", hold, (model.nu,))
        self._rig = RealRig(model, driver, safe, period, controller, hold, source)
        inner = Ekf(model) if observer is None else observer
        seeing = SeeingObserver(inner, self._rig, safe)
        self._spare = another(driver, model) if watchdog else None
        options = RunOptions(
            duration=duration, period=period, plant=self._rig, observer=seeing, name=name,
            q0=rest_pose(model),
        )  # fmt: skip
        if hasattr(controller, "prepare") and reference is not nowhere:
            aim = reference.reference if isinstance(reference, Experiment) else reference
            controller.prepare(aim)
        self.loop = loop = ClosedLoop(model, controller, reference, options)
        # before the end of the ramp the commands are not yet those of the controller
        loop.judged &= loop.grid.steps * period > self.limits.ramp
        self._actors, self.observer = (controller, inner), inner
        self.clock, self._now = Deadlines(period, source), source.now

    def _warm(self) -> None:
        """Let copies of observer and controller work, so that nothing is compiled in the run.

        It follows the fork of the watchdog: the first use of a page of memory after it is slow.
        """
        model, rig, period = self._model, self._rig, self.loop.grid.period
        state = model.state(model.q0, np.zeros(model.nv))
        readings = np.asarray(model.measure(state, rig.relaxed))
        with suppress(Exception):  # a user's object that cannot be copied is not called
            controller, observer = copy.deepcopy(self._actors)
            seeing = SeeingObserver(observer, rig, self._safe)
            for k in range(WARM):
                rig.read.new = readings
                rig.read.stamps = np.full(len(readings), rig.begin + (k - 1) * period)
                seen = seeing.step(k * period, readings, rig.sent)
                controller(model.state(seen.q, seen.v), self.loop.reference(0.0))
        rig.read.clear()
        self._safe.clear()

    def run(
        self,
        *,
        progress: bool = False,
        on_step: Callable[[ControlStep], None] | None = None,
        signals: Signals | None = None,
    ) -> DriveResult:
        """Run to the planned end, or until something stops it.

        Parameters
        ----------
        progress : bool
            Show a bar on stderr if that is a terminal.
        on_step : Callable[[ControlStep], None], optional
            Called after each control step, in the idle part of its period.
        signals : Signals, optional
            Those that the caller hears already, and goes on to hear after the run.
        """
        heard = Signals() if signals is None else signals
        error: BaseException | None = None
        cause, reason = StopCause.END, ""
        with heard.heard():
            watchdog = self._watchdog()
            try:
                with _quiet_interpreter(), self._progress(progress):
                    try:
                        heard.interrupting(partial(self._open, heard, watchdog))
                        self._steps(heard, watchdog, on_step)
                        self._relax(heard, watchdog)
                    except Stop as stop:
                        cause, reason = stop.cause, stop.reason
                        error = stop.__cause__
                    except KeyboardInterrupt:  # raised by hand, in a thread without signals
                        cause, reason = StopCause.CTRL_C, StopCause.CTRL_C.value
                    except BaseException as fault:
                        cause, error = StopCause.CONTROLLER, fault
                        reason = one_line(f"controller: {type(fault).__name__}: {fault}", 300)
                    finally:
                        left = self._stop(watchdog)
            finally:
                if watchdog is not None:
                    watchdog.end()
        finished = cause is StopCause.END
        if left is not None:  # whatever else has stopped the run: the rig may still pull
            failed = f"stop(): {left}; relax the rig by hand"
            if finished:
                cause, error = StopCause.DRIVER, left
            reason = one_line("; ".join(filter(None, (reason, failed))), 300)
        return DriveResult(self.log(cause, reason), cause, reason, error, finished)

    def _open(self, heard: Signals, watchdog: Watchdog | None) -> None:
        """Warm up, start the driver, and wait for the first readings."""
        self._warm()
        heard.check()
        if watchdog is not None:
            watchdog.opening()
        self._rig.open(heard.check)

    def log(self, cause: StopCause, reason: str) -> Log:
        """The run so far, with what has stopped it."""
        if cause is not StopCause.END:
            self.loop.stopped(reason)
        return self.loop.log()

    def _stop(self, watchdog: Watchdog | None) -> BaseException | None:
        """Relax the rig; a second try if the first fails."""
        self._count()
        if watchdog is not None:
            watchdog.stopping()
        for _ in range(2):
            try:
                limited(self._driver.stop, STOP)
            except BaseException as error:
                fault = error
            else:
                return None
        return fault

    def _steps(
        self,
        heard: Signals,
        watchdog: Watchdog | None,
        on_step: Callable[[ControlStep], None] | None,
    ) -> None:
        """All control periods."""
        loop, clock = self.loop, self.clock
        collect = self._now() + COLLECT
        while True:
            for _ in range(self._wait(heard, watchdog)):
                loop.hold(clock=np.nan, missed=1.0)
            step = loop.control()
            if step is None:
                break
            loop.advance()
            self._count()
            if on_step is not None:
                on_step(step)
            if self._now() > collect and clock.left > IDLE * clock.period:
                gc.collect()
                collect = self._now() + COLLECT
        self._count()
        if loop.steps < loop.grid.steps:
            raise Stop(self._why(), loop.reason or "")

    def _wait(self, heard: Signals, watchdog: Watchdog | None) -> int:
        """Wait for the next period; the number of those that are left out before it."""
        clock, rig = self.clock, self._rig
        before = clock.missed
        left_out = clock.wait()
        self._alive(heard, watchdog)
        self._safe.deadlines(clock.in_a_row)
        rig.begin, rig.late = clock.begin, clock.late
        rig.missed = clock.missed - before - left_out
        rig.leave_out(left_out)
        return left_out

    def _why(self) -> StopCause:
        """The cause of an end that the loop itself has decided."""
        try:
            self.loop.loop.admit()
        except InputError:
            return StopCause.COMMAND
        return StopCause.DIVERGED

    def _alive(self, heard: Signals, watchdog: Watchdog | None) -> None:
        """Give the heartbeat; stop after a signal, or without the watchdog."""
        heard.check()
        if watchdog is not None and not watchdog.beat():
            raise Stop(StopCause.WATCHDOG, "the watchdog's process has ended")

    def _relax(self, heard: Signals, watchdog: Watchdog | None) -> None:
        """Let the commands fall, for `RigLimits.ramp` seconds after the planned end."""
        loop, rig = self.loop.loop, self._rig
        steps, done = round(self.limits.ramp / self.clock.period), 0
        u = loop.u
        self._safe.falling = True
        rig.leave_out(1)  # the one at the planned end
        while done < steps:
            done += 1 + self._wait(heard, watchdog)
            loop.read(rig.time)
            assert loop.seen is not None
            rig.send(u, max(1.0 - done / steps, 0.0), loop.seen)

    # -- what another process sees -------------------------------------------------------------

    def _watchdog(self) -> Watchdog | None:
        """The watchdog, with the run's record in shared memory."""
        self._counted = np.zeros(1, np.int64)
        if self._spare is None:
            return None
        if self._log_to is not None:
            self._counted = shared(self._counted)
            self.loop.share(shared)
        late = self.clock.period + max(self.limits.late, self.clock.period)
        return Watchdog(self._spare, late, self._save)

    def _count(self) -> None:
        self._counted[0] = self.loop.samples

    def _save(self, reason: str) -> None:
        """Write the log in the watchdog's process."""
        if self._log_to is None or not self._counted[0]:
            return
        self.loop.resume_at(int(self._counted[0]))
        log, path = self.log(StopCause.WATCHDOG, reason), str(self._log_to)
        try:
            path, lost = save_somewhere(log.to_csv if path.endswith(".csv") else log.save, path)
        except InputError as error:
            said = f"error: {error}; the log is lost"
        else:
            said = f"wrote {path}: the run up to t = {log.t[-1]:.4g} s"
            said += f"; error: {lost}" if lost else ""
        print(said, file=sys.stderr, flush=True)

    @contextmanager
    def _progress(self, shown: bool) -> Iterator[None]:
        """A bar in a thread of its own."""
        if not shown or not sys.stderr.isatty():
            yield
            return
        over = Event()

        def show() -> None:
            with tqdm(total=self.loop.grid.steps, leave=False, unit="step") as bar:
                while not over.wait(SHOWN):
                    bar.update(self.loop.steps - bar.n)

        thread = Thread(target=show, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


class _Held:
    """A controller and its output: the forces u (nu,) that constant commands give."""

    name = "constant commands"

    def __init__(self, model: SoftModel, commands: np.ndarray) -> None:
        self._winches, self._commands, self.u = Winches(model), commands, np.zeros(model.nu)
        self._forces = ~model.robot.speeds

    def __call__(self, state: State, reference: Any) -> _Held:
        """The forces at a state; those of velocities are not known."""
        forces = self._winches.tensions(state, self._commands)
        self.u = np.where(self._forces, forces, 0.0)
        return self


def hold_commands(model: SoftModel, commands: Any, driver: Driver, **options: Any) -> Drive:
    """A run in which a rig gets constant commands, after their ramp.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    commands : array_like, (nu,)
        Forces, free lengths (m) or velocities, as the file's motors state.
    driver : Driver
        The rig's driver.
    **options : Any
        Those of `Drive`.

    Raises
    ------
    InputError
        As for `Drive`, and for commands beyond the bounds of their motors.
    """
    values = array("hold", commands, (model.nu,))
    winches = Winches(model)
    bounds = zip(model.robot.actuators, values, winches.lower, winches.upper, strict=True)
    for actuator, value, lower, upper in bounds:
        if not actuator.is_speed and not lower <= value <= upper:
            expected = f"a command of {actuator.name!r} from {lower:g} to {upper:g}"
            raise InputError("hold", expected, f"{value:g}")
    return Drive(model, _Held(model, values), nowhere, driver, hold=values, **options)


@contextmanager
def _quiet_interpreter() -> Iterator[None]:
    """Collect no garbage by itself, and let other threads give way soon."""
    switch, on = sys.getswitchinterval(), gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH)
    try:
        yield
    finally:
        sys.setswitchinterval(switch)
        gc.unfreeze()
        if on:
            gc.enable()
