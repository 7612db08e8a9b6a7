"""Every argument of the public functions, given what it cannot be: an InputError that names it."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import softdyn
from softdyn import InputError, design, statics
from softdyn.design import log_spiral

MODEL = softdyn.load("finger")
REST = statics.rest(MODEL)
Q, U, TIP = MODEL.q0, np.array([-0.1, -0.1]), REST.y
LIMITS = (MODEL.lower, MODEL.upper)


def listed(generate):
    """The same as a list, as a generator checks its arguments when it is asked."""

    def call(**given):
        return list(generate(**given))

    call.__name__ = generate.__name__
    return call


STATICS = [
    (statics.settle, {"model": MODEL, "u": U, "start": Q}),
    (statics.balance, {"model": MODEL, "u": U, "start": Q, "soft": None}),
    (statics.ramp, {"model": MODEL, "u": U, "start": REST}),
    (statics.rest, {"model": MODEL}),
    (statics.approach,
     {"start": REST, "target": TIP, "steps": 1, "soft": None, "stay_stable": False}),
    (statics.explore, {"model": MODEL, "target": TIP, "q": Q, "u": U, "steps": 1}),
    (statics.inputs_for_tip,
     {"model": MODEL, "target": TIP, "starts": (), "guesses": (), "shapes": 0, "seed": 0,
      "seconds": 0.0}),
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
    (statics.Loop, {"centre": TIP, "a": TIP, "b": TIP, "omega": 1.0}),
    (statics.HardStops.of, {"model": MODEL}),
    (statics.SoftStops, {"weight": np.ones(4), "lower": LIMITS[0], "upper": LIMITS[1]}),
    (statics.TipSearch(TIP, (REST,)).distance, {"equilibrium": REST}),
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
    (design.Material, {"youngs_modulus": 1e6, "poissons_ratio": 0.4, "density": 1000.0}),
    (design.Damping, {"ratio": 0.1}),
    (design.Plate, {"radius": 0.01, "thickness": 0.01, "mass": 0.01}),
    (design.Payload, {"radius": 0.01, "ahead": 0.01, "mass": 0.01}),
    (design.Mount, {"position": (0, 0, 0), "direction": (0, 0, 1), "roll": 0.0}),
    (design.Section,
     {"length": 0.2, "radius": 0.01, "material": RUBBER, "segments": 3, "freedoms": ("twist",),
      "inner_radius": 0.0, "bending_stiffness": 1.0, "torsional_stiffness": 1.0, "mass": 1.0,
      "rest": {}, "discs": 2, "disc": PLATE, "plate": PLATE, "name": "one"}),
    (design.Cable,
     {"angle": 0.0, "offset": 0.01, "straight": False, "max_tension": 1.0, "start": 0, "end": 0,
      "turns": 0.0, "name": "one"}),
    (design.Arm,
     {"sections": (SECTION,), "damping": design.Damping(0.1), "cables": (), "payload": None,
      "mount": design.Mount(), "tip": (0, 0, 0), "rule": design.midpoint, "unusual": False,
      "name": "one"}),
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
    (design.lay_out, {"arm": ARM}),
    (design.design, {"arm": ARM}),
    (design.strain_basis, {"arm": ARM, "degree": 0}),
    (design.midpoint, {"n": 3}),
    (design.gauss_legendre, {"n": 3}),
    (design.lay_out(ARM).coefficients, {"cable": CABLE}),
    (design.lay_out(ARM).body_at, {"x": 0.1}),
]  # fmt: skip
CALLS = [*STATICS, *DESIGN]


def called(cases):
    return [
        pytest.param(function, given, name, id=f"{function.__name__}-{name}")
        for function, given in cases
        for name in given
    ]


@pytest.mark.parametrize(("function", "given", "name"), called(CALLS))
def test_an_argument_of_another_kind_is_named(function, given, name):
    for wrong in (object(), [object()], 1j):
        with pytest.raises(InputError) as error:
            function(**{**given, name: wrong})
        assert error.value.name.startswith(name), error.value
        assert error.value.got != "", error.value


def test_the_table_lists_the_public_functions():
    tested = {getattr(function, "__name__", "") for function, _ in CALLS}
    tested |= {"distance", "of", "HardStops", "TipSearch", "Diagnosis", "StaticsError"}
    tested |= {"Design", "FREEDOMS", "Layout", "arm_of", "read"}
    for room in (statics, design):
        public = {name for name in room.__all__ if not inspect.ismodule(getattr(room, name))}
        assert public <= tested, room.__name__


def test_stops_of_another_robot_are_refused():
    stops = statics.SoftStops(np.ones(3), -np.ones(3), np.ones(3))
    with pytest.raises(InputError, match=r"^soft: expected stops of 4 joints, got of 3$"):
        statics.balance(MODEL, U, Q, stops)
    with pytest.raises(InputError, match=r"^guesses: expected pairs \(q, u\)"):
        statics.inputs_for_tip(MODEL, TIP, guesses=[(Q, U, U)])


def test_a_section_knows_its_freedoms():
    for given in ({"freedoms": ("bend_x",)}, {"rest": {"bend_x": 1.0}}):
        section = design.Section(0.2, 0.01, RUBBER, **given)
        (name,) = given
        with pytest.raises(InputError, match=rf"^{name}: .*'bend_x'; did you mean 'bend_"):
            design.lay_out(design.Arm((section,)))
    with pytest.raises(InputError, match=r"^freedoms: expected at least one, got none$"):
        design.Section(0.2, 0.01, RUBBER, freedoms=())
    with pytest.raises(InputError, match=r"^radius: expected a number, or numbers from end"):
        design.Section(0.2, [], RUBBER)
