"""Wrong values for every argument of the public functions lead to an InputError that names it."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest

import softdyn
from softdyn import InputError, controllers, design, identification, statics
from softdyn.actuation import Capstan
from softdyn.description.rig import CommandKind, Sensor, SensorKind
from softdyn.description.robot import NO_FLUID
from softdyn.design import log_spiral
from softdyn.tasks import PointTask
from softdyn.validation import StateMap, Twin
from tests.support.refused import refused

MODEL = softdyn.load("finger")
REST = statics.rest(MODEL)
Q, U, TIP = MODEL.q0, np.array([-0.1, -0.1]), REST.y
RUBBING = Capstan(MODEL, np.full(len(MODEL.robot.tendons), 0.1))


def listed(generate):
    """Convert a generator to a list, because it checks its arguments only when it runs."""

    def call(**given):
        return list(generate(**given))

    call.__name__ = generate.__name__
    return call


STATICS = [
    (statics.settle, {"model": MODEL, "u": U, "start": Q}),
    (statics.balance, {"model": MODEL, "u": U, "start": Q}),
    (statics.ramp, {"model": MODEL, "u": U, "start": REST}),
    (statics.rest, {"model": MODEL}),
    (statics.approach,
     {"start": REST, "target": TIP, "steps": 1, "stay_stable": False}),
    (statics.explore, {"model": MODEL, "target": TIP, "q": Q, "u": U, "steps": 1}),
    (statics.inputs_for_tip,
     {"model": MODEL, "target": TIP, "starts": (), "guesses": (), "shapes": 0, "seed": 0,
      "seconds": 0.0}),
    (statics.inputs_for_tips,
     {"model": MODEL, "targets": [TIP], "starts": (), "shapes": 0, "rays": 0, "seed": 0,
      "seconds": 0.0}),
    (statics.inputs_for_tasks,
     {"model": MODEL, "tasks": [PointTask("tip")], "reference": softdyn.SetPoint(TIP), "starts": (),
      "rays": 0, "seed": 0, "seconds": 0.0}),
    (statics.diagnose, {"model": MODEL, "samples": 0, "seed": 0}),
    (statics.stiffness, {"model": MODEL, "q": Q, "u": U}),
    (statics.gravity_stiffness, {"model": MODEL, "q": Q}),
    (statics.residual, {"model": MODEL, "q": Q, "u": U}),
    (statics.potential, {"model": MODEL, "q": Q, "u": U}),
    (statics.zero_spectrum, {"model": MODEL, "q": Q, "u": U}),
    (statics.random_inputs, {"model": MODEL, "count": 1, "seed": 0}),
    (listed(statics.random_shapes), {"model": MODEL, "count": 1, "seed": 0}),
    (listed(statics.sample_rests), {"model": MODEL, "rays": 1, "seed": 0}),
    (listed(statics.sample_between), {"samples": [REST], "count": 0, "seed": 0}),
    (statics.spread_rests, {"model": MODEL, "count": 1, "seed": 0}),
    (statics.loop_around, {"one": REST}),
    (statics.reach_by_direction, {"rests": [REST], "axis": TIP, "side": 0.1}),
    (statics.Loop, {"centre": TIP, "a": TIP, "b": TIP, "omega": 1.0}),
    (statics.TipSearch(TIP, (REST,)).distance, {"equilibrium": REST}),
    (statics.rest_interval, {"capstan": RUBBING, "u": U}),
    (statics.rest_after, {"capstan": RUBBING, "u": U, "direction": 1.0, "start": Q}),
    (statics.follow, {"capstan": RUBBING, "inputs": [U], "start": Q}),
    (statics.Equilibrium,
     {"model": MODEL, "q": Q, "u": U, "held": REST.held, "limit_forces": REST.limit_forces,
      "stiffness": REST.stiffness}),
]  # fmt: skip

RUBBER = design.Material(0.25e6)
PLATE = design.Plate(0.02, 0.001, 0.002)
SECTION = design.Section(0.2, 0.01, RUBBER)
CABLE = design.Cable(0.0, 0.006, False, 5.0)
ARM = design.Arm((SECTION,), cables=(CABLE,))
DESIGN = [
    (design.Material, {"youngs_modulus": 1e6, "poissons_ratio": 0.4, "density": 1000.0,
                       "relaxation": (), "modulus": ""}),
    (design.Damping, {"ratio": 0.1}),
    (design.Plate, {"radius": 0.01, "thickness": 0.01, "mass": 0.01}),
    (design.Payload, {"radius": 0.01, "ahead": 0.01, "mass": 0.01}),
    (design.Mount, {"position": (0, 0, 0), "direction": (0, 0, 1), "roll": 0.0}),
    (design.Section,
     {"length": 0.2, "radius": 0.01, "material": RUBBER, "segments": 3, "freedoms": ("twist",),
      "inner_radius": 0.0, "bending_stiffness": 1.0, "torsional_stiffness": 1.0, "mass": 1.0,
      "axial_stiffness": 1.0, "shear_stiffness": 1.0,
      "rest": {}, "discs": 2, "disc": PLATE, "plate": PLATE, "name": "one"}),
    (design.Cable,
     {"angle": 0.0, "offset": 0.01, "straight": False, "max_tension": 1.0, "start": 0, "end": 0,
      "turns": 0.0, "name": "one", "stiffness": 9.0, "damping": 1.0, "rest": 0.1, "slack": True}),
    (design.Chamber,
     {"angle": 0.0, "offset": 0.01, "max_pressure": 1e5, "area": 1e-4, "start": 0, "end": 0,
      "min_pressure": 0.0, "straight": False, "name": "one"}),
    (design.CableMotor,
     {"cables": ("cable",), "command": CommandKind.LENGTH, "stiffness": 9.0, "damping": 1.0,
      "length_lower": 0.0, "length_upper": 0.1, "lag": 0.01, "rate": 1.0, "delay": 0.01,
      "armature": 0.0}),
    (design.ArmSensor,
     {"reading": Sensor("one", SensorKind.GYRO), "cables": (), "points": (0.1,)}),
    (design.Arm,
     {"sections": (SECTION,), "damping": design.Damping(0.1), "cables": (), "payload": None,
      "mount": design.Mount(), "tip": (0, 0, 0), "rule": design.midpoint, "unusual": False,
      "name": "one", "motors": (), "sensors": (), "chambers": (), "fluid": NO_FLUID}),
    (design.FingerTendon,
     {"joints": (1,), "moment_arms": (0.01,), "max_tension": 1.0, "pair": False, "name": "one"}),
    (design.Finger,
     {"lengths": (0.1,), "radius": 0.01, "density": 1000.0, "stiffness": 1.0, "damping": 1.0,
      "tendons": (), "limit": 1.0, "mount": design.Mount(), "name": "one"}),
    (design.LogSpiral,
     {"length": 0.3, "mass": 0.2, "segments": 10, "ratio": 0.9, "radius": 0.02, "stiffness": 0.1,
      "damping": 0.1, "armature": 0.0, "freedoms": ("twist",), "cable_angles": (0.0,),
      "site_fractions": (0.2,), "cable": log_spiral.PULL, "mount": design.Mount(), "name": "one"}),
    (design.urdf, {"arm": ARM}),
    (design.attach,
     {"arm": MODEL.robot, "base": MODEL.robot, "link": "tip", "at": (0.0,) * 6, "prefix": "x_",
      "name": "two", "folder": "."}),
    (design.lay_out, {"arm": ARM}),
    (design.design, {"arm": ARM}),
    (design.strain_basis, {"arm": ARM, "degree": 0}),
    (design.midpoint, {"n": 3}),
    (design.gauss_legendre, {"n": 3}),
    (design.lay_out(ARM).coefficients, {"cable": CABLE}),
    (design.lay_out(ARM).body_at, {"x": 0.1}),
]  # fmt: skip

TIMES = 0.01 * np.arange(30)
ANGLES = np.outer(np.sin(TIMES), [0.1, 0.2, 0.3, 0.4])
NAMES = tuple(f"q.{name}" for name in MODEL.joint_names)
DATA = identification.Measurements(TIMES, np.zeros((30, 2)), NAMES, ANGLES)
UNKNOWNS = identification.parameters(MODEL, "stiffness")
FITTED = {"model": MODEL, "data": DATA, "unknowns": UNKNOWNS, "step": np.inf}
IDENTIFICATION = [
    (identification.read_csv, {"path": "data.csv", "model": MODEL, "static": False}),
    (identification.output_names, {"model": MODEL}),
    (identification.read_points, {"path": "points.toml"}),
    (identification.marked, {"robot": MODEL.robot, "markers": (), "layout": None}),
    (identification.camera_unknowns, {"start": np.zeros(6)}),
    (identification.DesignFile, {"path": "arm.toml"}),
    (identification.doubts, {"found": None}),
    (identification.tested, {"found": None, "test": DATA}),
    (identification.prepared,
     {"model": MODEL, "data": DATA, "static": False, "camera": np.zeros(6), "fit_camera": False,
      "relabel": False}),
    (identification.Measurements,
     {"t": TIMES, "u": np.zeros((30, 2)), "names": NAMES, "outputs": ANGLES}),
    (DATA.part, {"begin": 0, "end": 9}),
    (DATA.joints, {"model": MODEL}),
    (identification.parameters, {"model": MODEL, "kind": "gear", "shared": False}),
    (identification.choose_unknowns, {"model": MODEL, "free": ("gear",), "shared": ("damping",)}),
    (identification.motion_columns,
     {"parameters": UNKNOWNS, "state": MODEL.state(Q, Q), "a": Q, "u": U}),
    (identification.member_values, {"model": MODEL, "unknowns": UNKNOWNS, "theta": np.ones(4)}),
    (identification.apply_values, {"model": MODEL, "unknowns": UNKNOWNS, "theta": np.ones(4)}),
    (identification.make_problem, FITTED),
    (identification.fit, {"problem": None}),
    (identification.rest_rows, {"data": DATA, "hold": 0.1}),
    (identification.fit_length, {"data": DATA, "hold_out": 0.2}),
    (identification.identify, {**FITTED, "hold_out": 0.2}),
    (identification.least_deviations,
     {**FITTED, "theta": np.ones(4), "noise": np.ones(4), "hold_out": 0.2}),
    (identification.compute_outputs,
     {"model": MODEL, "names": NAMES, "path": ANGLES, "by": np.zeros((30, 4, 0))}),
    (identification.rewrite_urdf, {"robot": MODEL.robot, "values": {}}),
]  # fmt: skip
TWIN = Twin(MODEL)
STATES = StateMap(MODEL, TWIN)
OTHERS = [
    (StateMap, {"model": MODEL, "twin": TWIN, "called": None, "turns": {}}),
    (STATES.to_twin, {"q": Q, "v": Q}),
    (STATES.from_twin, {"qpos": Q, "qvel": Q}),
    (STATES.coordinates, {"qpos": Q}),
    (STATES.velocity_map, {"qpos": Q}),
    (STATES.velocity_map_rate, {"qpos": Q, "qvel": Q}),
    (softdyn.load,
     {"source": "finger", "annotations": None, "floating": False, "repair_inertia": False}),
    (softdyn.parse, {"path": MODEL.robot.path}),
    (softdyn.build, {"robot": MODEL.robot}),
    (softdyn.reduce, {"model": MODEL, "basis": np.eye(4)}),
    (controllers.allocate, {"model": MODEL, "state": MODEL.state(Q, Q), "tau": Q}),
]  # fmt: skip
CALLS = [*STATICS, *DESIGN, *IDENTIFICATION, *OTHERS]


def called(cases):
    return [
        pytest.param(function, given, name, id=f"{function.__name__}-{name}")
        for function, given in cases
        for name in given
    ]


@pytest.mark.parametrize(("function", "given", "name"), called(CALLS))
def test_an_argument_of_another_kind_is_named(function, given, name):
    for wrong in (object(), 3 * [object()], 1j):
        with pytest.raises(InputError) as error:
            function(**{**given, name: wrong})
        assert error.value.name.startswith({"source": "robot"}.get(name, name)), error.value
        assert error.value.got != "", error.value


def test_the_table_lists_the_public_functions():
    tested = {getattr(function, "__name__", "") for function, _ in CALLS}
    tested |= {
        "distance",
        "of",
        "ReachCell",
        "TipSearch",
        "TaskSearch",
        "Diagnosis",
        "StaticsError",
        "StuckRest",
        "NoEquilibrium",
    }
    tested |= {"Design", "FREEDOMS", "Layout", "make_arm", "read"}
    tested |= {
        "Acquisition",
        "Estimate",
        "Fit",
        "FitProblem",
        "Identified",
        "KINDS",
        "MAX_ROWS",
        "Parameter",
    }
    tested |= {"Marker", "MarkerView"}
    for room in (statics, design):
        assert set(room.__all__) <= tested, room.__name__
    assert set(re.findall(r" as (\w+)", inspect.getsource(identification))) <= tested


def test_a_guess_is_a_pair():
    with refused("guesses", "(array([0., 0., 0., 0.]), array([-0.1, -0.1]), array([-0.1,…"):
        statics.inputs_for_tip(MODEL, TIP, guesses=[(Q, U, U)])


def test_a_section_knows_its_freedoms():
    for given in ({"freedoms": ("bend_x",)}, {"rest": {"bend_x": 1.0}}):
        section = design.Section(0.2, 0.01, RUBBER, **given)
        (name,) = given
        with refused(name, "'bend_x'; did you mean 'bend_z'?"):
            design.lay_out(design.Arm((section,)))
    with refused("freedoms", "none"):
        design.Section(0.2, 0.01, RUBBER, freedoms=())
    with refused("radius", "[]"):
        design.Section(0.2, [], RUBBER)


def test_a_basis_of_wrong_names_or_shape_is_refused():
    for place, matrix, joints, names in (
        ("basis.joints", np.eye(4), None, "abcd"),
        ("basis.names[0]", np.eye(4), MODEL.joint_names, [1, 2, 3, 4]),
        ("basis", "x", MODEL.joint_names, ("a",)),
        ("basis", np.eye(3), MODEL.joint_names, ("a", "b", "c")),
    ):
        with refused(place):
            softdyn.reduce(MODEL, softdyn.Basis(matrix, joints, names))


JOINTS = MODEL.joint_names


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"called": {"joint1": 0}}, ("called", "{'joint1': 0}")),
        (
            {"called": {n: k for k, n in enumerate(JOINTS)} | {"joint2": 9}},
            ("called['joint2']", 9),
        ),
        ({"turns": {"joint9": (1, 0)}}, ("turns", "'joint9'; did you mean 'joint4'?")),
        ({"turns": {"joint1": (1, 0, 0)}}, ("turns['joint1']", "(1, 0, 0)")),
        ({"turns": {"joint1": (1, "x")}}, ("turns['joint1']", "'x'")),
    ],
)
def test_a_map_of_other_joints_is_refused(given, text):
    with refused(*text):
        StateMap(MODEL, TWIN, **given)


def test_a_diverged_plant_is_still_read():
    q, v = STATES.from_twin(np.full(4, np.nan), [np.inf] * 4)
    assert np.isnan(q).all()
    assert np.isinf(v).all()


def test_data_of_another_robot_are_refused():
    other = softdyn.load("spirob")
    with refused("data", 2):
        identification.identify(other, DATA, identification.parameters(other, "stiffness"))
    names = ("q.joint1", "q.joint2", "q.joint3", "q.elbow")
    data = identification.Measurements(TIMES, np.zeros((30, 2)), names, ANGLES)
    with refused("data", "'q.elbow'"):
        identification.identify(MODEL, data, UNKNOWNS)


@pytest.mark.parametrize("step", [0, -1.0, np.nan])
def test_a_step_that_is_none_is_refused(step):
    with refused("step"):
        identification.identify(MODEL, DATA, UNKNOWNS, step=step)
