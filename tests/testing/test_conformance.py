"""`softdyn.testing`: our own classes conform, and planted faults of a user's class are named."""

import time

import numpy as np
import pytest

import softdyn
from softdyn import InputError, Reference, SetPoint, safety, tasks, testing
from softdyn.controllers import BEYOND, CONTROLLERS, Command, Compensated, JointLimits, LogChannel
from softdyn.estimation import Ekf
from softdyn.safety.clearance import Values
from softdyn.validation import Rig, RunOptions
from softdyn.validation.loop.plants import plant_of
from tests.support.command import command
from tests.support.control_cases import robot
from tests.support.rigs import sensed


@pytest.fixture(scope="module")
def finger():
    return robot("finger")


def failed(report):
    """The names of the rules that a class breaks."""
    return [check.name for check in report.checks if not check.passed]


# -- softdyn's own classes ----------------------------------------------------------------------


@pytest.mark.parametrize("name", [*CONTROLLERS, *BEYOND])
def test_our_controllers_conform(name, finger):
    assert failed(testing.check_controller((CONTROLLERS | BEYOND)[name], finger, count=6)) == []


def test_a_wrapped_controller_conforms(finger):
    def wrapped(model):
        return Compensated(CONTROLLERS["ic"](model), model, lag=0.02, delay=0.004)

    assert failed(testing.check_controller(wrapped, finger, count=6)) == []


TIP = tasks.Target([0.0, 0.0, -1.0])


@pytest.mark.parametrize(("task", "target"), [
    (tasks.PointTask("tip"), None), (tasks.AxisTask("tip", [1, 0, 0]), TIP),
    (tasks.OrientationTask("tip"), tasks.Target(np.eye(3))),
    (tasks.PoseTask("tip"), tasks.Target(np.eye(4))),
    (tasks.JointTask(), tasks.Target(np.ones(4))),
    (tasks.PointTask("tip", axes=(0, 2)), None),
], ids=lambda value: getattr(value, "name", ""))  # fmt: skip
def test_our_tasks_conform(task, target, finger):
    assert failed(testing.check_task(task, finger, target=target)) == []


@pytest.mark.parametrize("barrier", [
    JointLimits, safety.HalfSpace([0.0, 0.0, 1.0], -1.0), safety.KeepOutSphere([0.5, 0, 0.3], 0.1),
])  # fmt: skip
def test_our_barriers_conform(barrier, finger):
    assert failed(testing.check_barrier(barrier, finger)) == []


@pytest.mark.parametrize("reference", [
    SetPoint([0.1, 0.0, -0.2]), softdyn.Ellipse(0.1, 0.2, 0.3, omega=0.5),
    tasks.Waypoints([0, 4, 10], [[0.1, 0, 0], [0.2, 0, 0], [0.1, 0, 0.1]]),
    tasks.References({"tip": softdyn.Ellipse(0.1, 0.2, 0.3, omega=0.5), "axis": TIP}),
])  # fmt: skip
def test_our_references_conform(reference, finger):
    assert failed(testing.check_reference(reference, finger)) == []


def test_our_observer_conforms():
    assert failed(testing.check_observer(Ekf, sensed("finger"))) == []


@pytest.mark.parametrize("rig", [None, Rig(lag=0.02, noise=1e-3, seed=3)])
def test_our_plants_conform(rig, finger):
    def made(model):
        return plant_of(model, RunOptions(rig=rig), 0.005, 0.0005)

    assert failed(testing.check_plant(made, finger)) == []


# -- planted faults of a user's class ---------------------------------------------------------


class Law:
    """Computed torque through the pseudoinverse of B, as a user would write it."""

    def __init__(self, model):
        self.model = model

    def __call__(self, state, reference):
        force = state.h + state.J.T @ (20 * (reference.y - state.y) - 5 * state.ydot)
        u = np.nan_to_num(np.linalg.pinv(state.B)) @ np.nan_to_num(force)
        return Command(np.clip(np.nan_to_num(u), self.model.u_min, self.model.u_max))


class GravityLaw(Law):
    """Set-point regulation: gravity and elasticity at the tip's target (Della Santina 2023)."""

    def __call__(self, state, reference):
        force = state.g + state.K + 10 * state.J.T @ (reference.y - state.y)
        u = np.linalg.lstsq(state.B, np.clip(np.nan_to_num(force), -1e6, 1e6), rcond=None)[0]
        return Command(np.clip(u, self.model.u_min, self.model.u_max))


class SlidingLaw(Law):
    """First-order sliding mode at the tip."""

    def __call__(self, state, reference):
        slide = np.nan_to_num(5 * (reference.y - state.y) - state.ydot)
        u = np.tanh(np.nan_to_num(np.clip(state.J, -9, 9).T @ np.tanh(slide)) @ state.B)
        return Command(np.clip(u * self.model.u_max, self.model.u_min, self.model.u_max))


class IntegralLaw(Law):
    """Integral action on the tip's error, with a memory that `reset` clears."""

    def __init__(self, model):
        super().__init__(model)
        self.reset(0.005)

    def reset(self, period):
        self.period, self.sum = period, np.zeros(3)

    def __call__(self, state, reference):
        error = np.clip(np.nan_to_num(reference.y - state.y), -1, 1)
        self.sum = self.sum + self.period * error
        u = np.nan_to_num(state.J @ state.B).T @ (error + self.sum)
        return Command(np.clip(np.nan_to_num(u), self.model.u_min, self.model.u_max))


class Telling(Law):
    """Computed torque that tells its error, and its speed where it is far."""

    channels = (
        LogChannel.of("errors", [(axis, "m") for axis in "xyz"]),
        LogChannel("phase", text=True),
        LogChannel("speed", units=("m/s",), gaps=True),
    )

    def values(self, state, reference):
        far = bool(np.linalg.norm(state.y - reference.y) > 0.01)
        values = {"errors": state.y - reference.y, "phase": "far" if far else "near"}
        return values | ({"speed": np.linalg.norm(state.ydot)} if far else {})

    def __call__(self, state, reference):
        answer = super().__call__(state, reference)
        return Command(answer.u, values=self.values(state, reference))


@pytest.mark.parametrize("law", [Law, GravityLaw, SlidingLaw, IntegralLaw, Telling])
def test_laws_of_a_user_conform(law, finger):
    report = testing.check(law, finger)
    assert (report.kind, failed(report)) == ("controller", [])


class TellsLess(Telling):
    def values(self, state, reference):
        return {"phase": "far"}


class TellsNan(Telling):
    def values(self, state, reference):
        return super().values(state, reference) | {"errors": np.full(3, np.nan)}


class TellsMore(Telling):
    def values(self, state, reference):
        return super().values(state, reference) | {"more": 1.0}


class TellsNarrow(Telling):
    def values(self, state, reference):
        return super().values(state, reference) | {"errors": [1.0, 2.0]}


class NamedAsTheLog(Law):
    channels = (LogChannel("measured"),)


class Unbounded(Law):
    def __call__(self, state, reference):
        return Command(10 * self.model.u_max)


class Fragile(Law):
    def __call__(self, state, reference):
        return Command(self.model.u_max * np.clip(state.ydot[:1], 0, 1))


class Shared(Law):
    def __init__(self, model):
        super().__init__(model)
        self.u = np.zeros(model.nu)

    def __call__(self, state, reference):
        self.u[:] = np.clip(np.nan_to_num(abs(state.q[0])), 0, 1) * self.model.u_max
        return Command(self.u)


class Remembers(Law):
    def __init__(self, model):
        super().__init__(model)
        self.calls = 0

    def __call__(self, state, reference):
        self.calls += 1
        return Command(self.model.u_max / (1 + self.calls))


class Unpicklable(Law):
    def __init__(self, model):
        super().__init__(model)
        self.gain = lambda value: value


class Random(Law):
    def __call__(self, state, reference):
        return Command(np.random.default_rng().uniform(self.model.u_min, self.model.u_max))


class Row(Law):
    def __call__(self, state, reference):
        return Command(self.model.u_max[None, :] * 0.1)


class Slow(Law):
    def __call__(self, state, reference):
        time.sleep(0.01)  # twice the period
        return Law.__call__(self, state, reference)


class Raises(Law):
    def __init__(self, model):
        raise KeyError("gains")


class WrongTask(tasks.PointTask):
    def evaluate(self, state, target):
        found = super().evaluate(state, target)
        return found._replace(jacobian=2 * found.jacobian)


class WrongDrift:
    rate = 5.0

    def __call__(self, state):
        b = state.model.coordinates(state.q)[:1] + 2.0
        return Values(b, np.eye(1, state.model.nv), np.ones(1), np.ones(1))


class WrongSpeed:
    def __call__(self, t):
        return Reference([t**2, 0, 0], [t, 0, 0], [1, 0, 0])


class NoReset:
    def __init__(self, model):
        self.model, self.steps = model, 0

    def reset(self):
        pass

    def step(self, t, measurements, u):
        self.steps += 1
        return self.model.state(self.model.q0 + 1e-3 * self.steps, np.zeros(self.model.nv))


class StopsOnce:
    def __init__(self, model):
        self.open, self.k = True, len(model.robot.sensors)

    def start(self):
        pass

    def read(self):
        return np.full(self.k, np.nan), np.zeros(self.k)

    def send(self, commands):
        pass

    def stop(self):
        if not self.open:
            raise OSError("closed already")
        self.open = False


class NoChannel:
    channels, settings, real_time, alters_states, sent = (), {}, False, False, np.zeros(0)

    def __init__(self, model):
        self.model = model

    def start(self, q, v, t=0.0, u=None):
        self.q, self.v = q, v

    def state(self):
        return self.q, self.v

    def sample(self):
        return {"pressure": np.zeros(1)}

    def see(self, state):
        return state

    def advance(self, u, steps, seen):
        return {}


class NarrowChannel(NoChannel):
    channels = (LogChannel.of("pressure", [("left", "Pa"), ("right", "Pa")]),)


FAULTS = [
    (Unbounded, "inputs are finite and within the bounds"),
    (TellsLess, "declared channels have values"),
    (TellsNan, "declared channels have values"),
    (TellsMore, "declared channels have values"),
    (TellsNarrow, "declared channels have values"),
    (NamedAsTheLog, "declared channels have values"),
    (Fragile, "hostile numbers give bounded inputs"),
    (Shared, "an answer does not change later"),
    (Remembers, "reset begins anew"),
    (Unpicklable, "copies and pickles go on alike"),
    (Random, "equal calls give equal answers"),
    (Row, "inputs are finite and within the bounds"),
    (Raises, "it is built"),
    (WrongTask("tip"), "jacobian is the rate's derivative by the velocity"),
    (WrongDrift, "drift is the second derivative without accelerations"),
    (WrongSpeed, "ydot is the derivative of y"),
    (NoReset, "reset begins anew"),
    (StopsOnce, "stop()"),
    (NoChannel, "states and readings of a run"),
    (NarrowChannel, "states and readings of a run"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("subject", "rule"), FAULTS, ids=lambda value: getattr(value, "__name__", "")
)
def test_a_planted_fault_is_named(subject, rule):
    model = sensed("finger") if subject in (NoReset, StopsOnce) else robot("finger")
    if subject is WrongDrift:
        subject = lambda _: WrongDrift()  # noqa: E731
        report = testing.check_barrier(subject, model)
    elif subject is WrongSpeed:
        report = testing.check_reference(WrongSpeed(), model)
    else:
        report = testing.check(subject, model)
    assert rule in failed(report), str(report)
    shown = next(check.detail for check in report.checks if check.name == rule)
    assert "expected" in shown or "Error" in shown  # the call that shows it


class NoModel:
    def __call__(self, state, reference):
        return None


def test_a_line_of_the_class_is_named_and_none_of_softdyn(finger):
    built, raised = (testing.check_controller(law, finger).checks[0] for law in (NoModel, Raises))
    assert ".py" not in built.detail
    assert "test_conformance.py" in raised.detail


def test_a_slow_law_is_named_where_there_is_a_period(finger):
    report = testing.check_controller(Slow, finger, period=0.005, count=3)
    assert failed(report) == ["a call is shorter than the period"]
    assert failed(testing.check_controller(Slow, finger, count=3)) == []


def test_a_class_without_the_methods_of_any_kind_is_refused(finger):
    class Nothing:
        pass

    with pytest.raises(InputError):
        testing.check(Nothing, finger)
    with pytest.raises(InputError):
        testing.check(Law, finger, "motor")


# -- the command ------------------------------------------------------------------------------


def test_the_command_prints_each_rule_and_fails_with_the_class(tmp_path):
    (tmp_path / "law.py").write_text(
        "from softdyn.controllers import Command, ImpedanceQp\n"
        "class Good(ImpedanceQp):\n    pass\n"
        "class Bad:\n"
        "    def __init__(self, model):\n        self.top = model.u_max\n"
        "    def __call__(self, state, reference):\n        return Command(2 * self.top)\n"
    )
    code, out, _ = command("check", "law.py:Good", cwd=tmp_path)
    assert (code, "FAILED" in out, out.count("ok ")) == (0, False, 9)
    code, out, _ = command("check", "law.py:Bad", "finger", "--json", "-", cwd=tmp_path)
    assert code == 1
    assert '"passed": false' in out
    assert command("check", "law.py:Bad", "--as", "driver", cwd=tmp_path).code == 1
    assert command("check", "law.py:Bad", "--as", "motor", cwd=tmp_path).code == 2
    assert command("check", "law.py:None", cwd=tmp_path).code == 2
    assert command("check", "finger", "helix", cwd=tmp_path).code == 2
