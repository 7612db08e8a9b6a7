"""Objects of every public class, made as by a user, each with a function that uses it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import softdyn
from softdyn import Reference, SetPoint, controllers, design, estimation, safety, statics, tasks
from softdyn.actuation import Capstan, Winches
from softdyn.controllers import BEYOND, CONTROLLERS, Gains
from softdyn.description.readings import ReadingLayout, SampledSensor
from softdyn.loading import load_text
from softdyn.sensing import Sensor, SensorKind, Sensors
from softdyn.validation import Rig, Scene, StateMap, Twin, paper, simulate
from softdyn.validation.channels import every_run
from softdyn.validation.environment import ReachEnv
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.validation.twin.rig import RiggedPlant
from softdyn.view.rest_sweep import rest_page
from tests.support import ROOT
from tests.support.control_cases import drawn, robot
from tests.support.rigs import sensed

LAWS = {**CONTROLLERS, **BEYOND}
STILL, PUSH = np.zeros(4), np.full(2, 0.1)
ARM = design.Arm(
    (design.Section(0.1, 0.02, design.Material(1e6), 3, disc=design.Plate(0.02, 1e-3, 1e-3)),),
    cables=(design.Cable(0.0, 0.015, False, 20.0),), payload=design.Payload(0.01, 0.01),
    motors=(design.CableMotor(("cable",), lag=0.01),),
    sensors=(design.ArmSensor(Sensor("end", SensorKind.POSITION), points=(0.1,)),),
)  # fmt: skip


def failed_problem(model: Any, state: Any, goal: Any) -> Any:
    """The problem of a fallback."""
    law = CONTROLLERS["soft-id-clf-qp"](model)
    law(replace(state, h=np.full(model.nv, np.inf)), goal)
    return law.failed_problem


class Uses:
    """Ways to use an object once more; each returns what a user gets from it."""

    def __init__(self) -> None:
        self.model = robot("finger")
        (self.state, self.goal), (self.other, _), *_ = drawn("finger")
        self.moving = drawn("spirob")[2][0]
        self.observed = sensed("finger", rate=60.0, latency=0.03)
        read = Sensors(self.observed)
        self.readings = read.measure(self.observed.state(self.state.q, self.state.v), PUSH).values

    def look(self, data: Any) -> list[Any]:
        """Data has nothing to use."""
        return [data]

    def control(self, law: Any) -> list[Any]:
        """Two commands."""
        return [law(state, self.goal).u for state in (self.state, self.other)]

    def estimate(self, ekf: Any) -> list[Any]:
        """The next nine estimates."""
        begin = np.nan_to_num(ekf._timeline.time, nan=0.0)
        rows = self.readings + 1e-3 * np.arange(9)[:, None]
        return [ekf.step(begin + 0.005 * (k + 1), row, k * PUSH) for k, row in enumerate(rows)]

    def act(self, env: Any) -> list[Any]:
        """An episode of two periods."""
        first = env.reset(seed=3)[0]
        return [first, *(env.step(np.full(2, 0.5))[0] for _ in range(2)), env.episode.inputs]

    def drive(self, plant: Any) -> list[Any]:
        """One control period of a plant behind a rig."""
        seen = plant.see(self.model.state(*plant.state()))
        return [seen.q, *plant.advance(PUSH, 10, seen).values(), *plant.sample().values()]

    def advance(self, twin: Any) -> list[Any]:
        """Ten steps of a twin or a scene."""
        twin.advance(PUSH, 10)
        return [twin.data.qpos.copy(), twin.data.qvel.copy()]

    def step(self, loop: Any) -> list[Any]:
        """One step of a closed loop."""
        loop.step()
        return [loop.steps, loop.plant.state()[0]]

    def at_state(self, of_state: Any) -> list[Any]:
        """Barriers."""
        return [list(of_state(self.state))]

    def at_goal(self, task: Any) -> list[Any]:
        """A task's error."""
        return [list(task(self.state, self.goal))]

    def along(self, path: Any) -> list[Any]:
        """Targets of a path."""
        return [path(t) for t in (0.0, 0.3, 2.0)]


def recorded(model: Any, readings: np.ndarray) -> estimation.ObservedData:
    """A filter's results over three rows of a file."""
    ekf = estimation.Ekf(model)
    inputs = [f"u.{actuator.name}" for actuator in model.robot.actuators]
    names = ["t", *inputs, *(f"measured.{name}" for name in ekf.reading_names)]
    rows = [[0.005 * k, *PUSH, *readings] for k in range(3)]
    with TemporaryDirectory() as folder:
        path = Path(folder, "rows.csv")
        path.write_text("\n".join(",".join(map(str, row)) for row in [names, *rows]))
        return estimation.observe_data(model, ekf, path)


def objects(uses: Uses) -> list[tuple[Any, Callable[[Any], list[Any]]]]:
    """Every object, with a way to use it."""
    model, observed, state, goal = uses.model, uses.observed, uses.state, uses.goal
    rest, tip, run = statics.rest(model), model.robot.task, paper.set_point("finger", 0.5)
    basis = design.strain_basis(ARM)
    arm = load_text(design.design(ARM).text, path="arm.urdf")
    law = CONTROLLERS["soft-id-clf-qp"](model)
    ekf, other = (estimation.Ekf(observed, disturbances=("tip_force",)) for _ in range(2))
    plant = RiggedPlant(Rig(lag=0.02, noise=1e-3), model, 0.005)
    plant.start(model.q0, np.zeros(4))
    rig = Rig(lag=0.02, sensors=observed.robot.sensors)
    options = RunOptions(duration=0.1, rig=rig, observer=other)
    loop = ClosedLoop(model, CONTROLLERS["ic"](model), run, options)
    walls = [safety.HalfSpace([1.0, 0.0, 0.0], -1.0)]
    walls += [safety.KeepOutBox([2.0, 0.0, 0.0], [1.0, 1.0, 1.0], links="all")]
    walls += [safety.KeepOutSphere([2.0, 0.0, 0.0], 0.1)]
    walls += [safety.LinkPairs(pairs=[("link1", "link3")])]
    pose, ones = tasks.Target(np.eye(4)), tasks.Target(np.ones(4))
    spread = tasks.PoseTask(tip, weight=[1.0, 1.0, 1.0, 0.1, 0.1, 0.1], target=pose)
    spot = tasks.Target(np.eye(1, 3))
    stage = controllers.Stage(Gains(Kp=1.0))
    line = tasks.Waypoints([0, 1], [[0.1, 0, 0], [0.2, 0, 0]])
    turns = tasks.Turns([0, 1], [np.eye(3)] * 2)
    kinematics, sensors = tasks.LinkKinematics(model), Sensors(observed)
    estimates = uses.estimate(estimation.Ekf(observed, disturbances=("tip_force",)))
    network = controllers.PolicyNetwork([(np.full((2, 11), 0.1), np.zeros(2))])
    env = ReachEnv(model, targets=[[0.1, 0.0, -0.1]], horizon=0.02, seed=1)
    env.reset()
    finger = design.FingerTendon((1,), (0.01,), 10.0)
    data = [
        model, softdyn.load("spirob48"), arm, softdyn.reduce(arm, basis), model.robot, state, goal,
        model.robot.fluid,
        SetPoint([0.1, 0, 0.1]), Reference([0.1, 0, 0.1], yddot=[0.0, 0.0, 1.0]), basis,
        # controllers
        Gains(Kp=1.0), controllers.MpcParameters(), stage,
        controllers.Schedule(stage, stage, arrive=0.1, leave=0.2, dwell=0.1), law(state, goal),
        controllers.TaskReport("tip", 0, controllers.TaskCondition.MET, 3, 0.0),
        controllers.RestTargets(model), failed_problem(model, state, goal),
        # design
        ARM, *ARM.sections, *ARM.cables, *ARM.motors, *ARM.sensors, ARM.payload, ARM.mount,
        ARM.damping, ARM.sections[0].material, ARM.sections[0].disc, design.design(ARM),
        design.Chamber(0.0, 0.01, 1e5, area=1e-4), network, env.episode,
        design.lay_out(ARM), finger, design.Finger((0.1,), 0.01, 1000.0, 1.0, 0.1, (finger,)),
        design.LogSpiral(0.3, 0.1, 5, 0.9, 0.02, 1.0, 0.1),
        # estimation
        estimation.EkfParameters(), ekf.counts, estimates[-1],
        estimation.observe(rest, observed.robot.sensors, seconds=0.01),
        recorded(observed, uses.readings),
        # safety, sensing, actuation
        controllers.JointLimits(model), options, PlantErrors(), every_run(model)[0],
        safety.Surroundings(walls[:2]), *observed.robot.sensors, sensors.components,
        sensors.measure(observed.state(state.q, state.v), PUSH), Capstan(model, 0.1).at(state),
        # statics
        rest, statics.diagnose(model, samples=2), statics.TipSearch(rest.y, (rest,)),
        statics.Loop(rest.y, [0.01, 0, 0], [0, 0, 0.01], 1.0),
        statics.rest_after(Capstan(model, 0.1), np.zeros(2), 1.0),
        statics.TaskSearch((tasks.PointTask(tip),), SetPoint(rest.y), (rest,)),
        *statics.reach_by_direction([rest], [1, 0, 0], 0.1),
        # tasks
        tasks.Target(np.eye(3)), tasks.StackedReference({"tip": goal}), kinematics(state, tip),
        tasks.PointTask(tip)(state, goal),
        # validation
        run, rig, Case("finger", "ic", "set_point", 0.5), rest_page(model),
        StateMap(model, Twin(model)), simulate(model, law, run, duration=0.02),
    ]  # fmt: skip
    point = [tasks.PointTask(tip), tasks.AxisTask(tip, [1, 2, 3])]
    return [
        *((one, uses.look) for one in data),
        *((make(model), uses.control) for make in LAWS.values()),
        (controllers.Compensated(CONTROLLERS["ic"](model), model, delay=0.02), uses.control),
        (controllers.SafetyFilter(CONTROLLERS["ic"](model), model, walls[:2]), uses.control),
        (CONTROLLERS["soft-id-clf-qp"](model, tasks=point), uses.control),
        (controllers.Mpc(model, lag=0.02, delay=0.012), uses.control),
        (controllers.Staged(robot("spirob")), lambda one: [one(uses.moving, goal).u]),
        (controllers.InputGuard(model.u_min, model.u_max), lambda one: [one.admit(PUSH)]),
        (controllers.PolicyController(model, network), uses.control), (env, uses.act),
        (ekf, uses.estimate), (plant, uses.drive), (loop, uses.step),
        (Twin(model), uses.advance),
        (Scene(model, ROOT / "docs/examples/finger_scene.xml"), uses.advance),
        *((wall, uses.at_state) for wall in walls),
        (spread, lambda one: [list(one(state, one.target))]),
        (tasks.OrientationTask(tip), lambda one: [list(one.evaluate(state, turns(0.0)))]),
        *((one, uses.at_goal) for one in point),
        (tasks.JointTask(), lambda one: [list(one.evaluate(state, ones))]),
        (tasks.ShapeTask([0.1]), lambda one: [list(one.evaluate(state, spot))]),
        (tasks.StrainTask(basis), uses.look),
        (ReadingLayout(observed.robot.sensors), uses.look), (SampledSensor(60.0, 0.03), uses.look),
        (line, uses.along), (turns, uses.along), (tasks.Poses(line, turns), uses.along),
        (tasks.References({"tip": line, "turn": turns}), uses.along),
        (softdyn.Ellipse(0.1, 0.1, 0.1, omega=0.1), uses.along),
        (kinematics, lambda one: [one(state, tip)]),
        (sensors, lambda one: [one.measure(observed.state(state.q, state.v), PUSH)]),
        (Winches(model), lambda one: [one.tensions(state, PUSH)]),
        (Capstan(robot("spirob"), 0.1), lambda one: [one.at(uses.moving).forces(np.ones(3))]),
    ]  # fmt: skip
