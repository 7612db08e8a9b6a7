"""The file of a designed arm, compared with the engine, the twin and plain geometry."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from softdyn import design
from softdyn.validation import crosscheck
from tests.support.arms import EVERYTHING, RUBBER, loaded
from tests.support.refused import refused


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return loaded(EVERYTHING, tmp_path_factory.mktemp("arm"))


def test_two_engines_agree_about_every_kind_of_part(model):
    result = crosscheck(model, samples=4, trajectories=False)
    assert result.passed, [(c.quantity, c.max_error, c.reason) for c in result.checks]
    assert max(check.max_error for check in result.checks) < 1e-10


def test_the_layout_s_mass_matrix_is_the_engine_s(model):
    layout = design.lay_out(EVERYTHING)
    assert tuple(spring.name for spring in layout.all_springs) == model.joint_names
    M = model.state(model.q0, np.zeros(model.nv)).M
    np.testing.assert_allclose(layout.mass_matrix, M, atol=1e-12 * np.abs(M).max())


def test_where_it_is_mounted(model):
    length, tip = 0.1 + 0.004 + 0.08, np.array(EVERYTHING.tip)
    roll, pitch, yaw = 0.4, math.asin(0.5 / math.sqrt(5.25)), math.atan2(2.0, 1.0)
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    R = (
        np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    )
    np.testing.assert_allclose(R[:, 0], np.array([1, 2, -0.5]) / math.sqrt(5.25), atol=1e-12)
    y = model.state(model.q0, np.zeros(model.nv)).y
    np.testing.assert_allclose(y, [0.1, 0.2, 0.3] + R @ np.add(tip, (length, 0, 0)), atol=1e-12)


def test_masses_and_rest_are_those_of_the_parts(model):
    masses = {link.name: link.inertia.mass for link in model.robot.links}
    cone = math.pi / 3 * 0.05 * (0.015**2 + 0.015 * 0.012 + 0.012**2)
    hollow = cone + math.pi * 0.05 * 0.012**2 - math.pi * 0.1 * 0.004**2
    total = 1070 * hollow + 0.01 + 0.02 + 4 * 0.001 + 0.01
    assert sum(masses.values()) == pytest.approx(total, rel=1e-9)
    bends = [k for k, name in enumerate(model.joint_names) if name in ("bend_y_3", "bend_y_4")]
    weights = np.array([5 / 18, 8 / 18]) * 0.08
    np.testing.assert_allclose(model.rest[bends], 3.0 * weights, rtol=1e-12)
    np.testing.assert_allclose(model.damping, 0.02 * model.stiffness, rtol=1e-12)


def test_discs_and_plates_weigh_where_they_are():
    """With an almost massless rod, four discs and a plate remain: point masses, plus r²/4."""
    disc, plate = design.Plate(0.012, 1e-9, 0.1), design.Plate(0.02, 0.004, 0.3)
    rod = design.Section(0.08, 0.01, RUBBER, 3, mass=1e-12, discs=4, disc=disc, plate=plate)
    layout = design.lay_out(design.Arm((rod,), unusual=True))
    places = np.array([0.02, 0.04, 0.06, 0.08, 0.082])
    masses = np.array([0.1, 0.1, 0.1, 0.1, 0.3])
    seen = [
        (
            body.mass,
            body.mass * (x + body.com[0]),
            body.tensor[1, 1] + body.mass * (x + body.com[0]) ** 2,
        )
        for x, body in zip(layout.stations, layout.bodies, strict=True)
    ]
    own = 4 * 0.1 * 0.012**2 / 4 + 0.3 * (0.02**2 / 4 + 0.004**2 / 12)
    expected = masses.sum(), masses @ places, masses @ places**2 + own
    assert np.sum(seen, axis=0) == pytest.approx(expected, rel=1e-9)


def test_a_payload_is_a_solid_ball():
    """2/5 m r² about each axis of its own, and its mass at its centre: by sums over a grid."""
    rod, ball = design.Section(0.1, 0.01, RUBBER, 2), design.Payload(0.5, 0.02, 0.03)
    bare, laden = (
        design.lay_out(design.Arm((rod,), payload=payload, unusual=True))
        for payload in (None, ball)
    )
    grid = (np.arange(40) + 0.5) / 40 * 2 - 1
    points = np.stack(np.meshgrid(grid, grid, grid), -1).reshape(-1, 3)
    points = 0.02 * points[(points**2).sum(1) <= 1]
    points[:, 0] += 0.1 + 0.03 - laden.stations[-1]
    squares = 0.5 * np.einsum("ki,kj->ij", points, points) / len(points)
    expected = np.trace(squares) * np.eye(3) - squares
    about = [
        body.tensor + body.mass * (body.com @ body.com * np.eye(3) - np.outer(body.com, body.com))
        for body in (laden.bodies[-1], bare.bodies[-1])
    ]
    assert laden.bodies[-1].mass - bare.bodies[-1].mass == pytest.approx(0.5)
    np.testing.assert_allclose(about[0] - about[1], expected, rtol=2e-3, atol=1e-12)


def test_a_straight_cable_stays_within_its_discs_and_a_led_one_within_the_rod():
    for straight, disc, limit in ((True, 0.014, 0.014), (True, None, 0.01), (False, 0.014, 0.01)):
        plate = None if disc is None else design.Plate(disc, 0.002, 0.001)
        rod = design.Section(0.1, 0.01, RUBBER, 2, discs=4, disc=plate)
        for share, fits in ((0.99, True), (1.01, False)):
            cable = design.Cable(0.0, share * limit, straight, 1.0)
            if fits:
                assert design.urdf(design.Arm((rod,), cables=(cable,)))
                continue
            with refused("cable 'cable' in section 'section'", f"{1.01 * limit:.4g} m"):
                design.urdf(design.Arm((rod,), cables=(cable,)))


def test_a_straight_cable_is_as_long_as_its_chords(model):
    lengths = dict(zip(model.tendons.names, model.tendon_lengths(model.q0), strict=True))
    # half a turn over 80 mm in four steps, at 13 mm
    chord = math.hypot(0.02, 2 * 0.013 * math.sin(math.pi / 8))
    assert lengths["straight"] == pytest.approx(4 * chord, rel=1e-12)


def test_moment_arms_of_a_helical_channel_are_slopes_of_its_length():
    """The oracle is the curve itself, bent at one joint and measured as a polygon."""
    cable = EVERYTHING.cables[1]
    layout = design.lay_out(EVERYTHING)
    coefficients = layout.coefficients(cable)
    start, end = EVERYTHING.way(cable)
    x = np.linspace(start, end, 8001)
    curve = np.array([cable.place((s - start) / (end - start)) for s in x])
    curve[:, 0] = x
    k = 0
    for station, group in zip(layout.stations, layout.springs, strict=True):
        for spring in group:
            # the strain spread over a short piece of rod about the joint
            inside, change = np.abs(x - station) < 1e-3, []
            width = inside.sum() * (x[1] - x[0])
            for q in (1e-5, -1e-5):
                tangents = np.gradient(curve, x, axis=0)
                if spring.freedom.turns:
                    rate = np.cross(spring.freedom.axis, curve * [0, 1, 1]) / width
                else:
                    rate = np.broadcast_to(spring.freedom.axis / width, curve.shape)
                strained = tangents + q * rate * inside[:, None]
                change.append(np.trapezoid(np.linalg.norm(strained, axis=1), x))
            assert coefficients[k] == pytest.approx(
                (change[0] - change[1]) / 2e-5, rel=3e-4, abs=3e-6
            ), k
            k += 1


def test_damping_by_ratio_and_by_viscosity():
    rod = design.Section(0.2, 0.01, RUBBER, 5)
    by_ratio = design.lay_out(design.Arm((rod,), design.Damping(ratio=0.2)))
    tau = [s.damping / s.stiffness for s in by_ratio.all_springs]
    assert tau == pytest.approx([2 * 0.2 / by_ratio.rates[0]] * 10)
    by_viscosity = design.lay_out(design.Arm((rod,), design.Damping(viscosity=1000.0)))
    tau = [s.damping / s.stiffness for s in by_viscosity.all_springs]
    assert tau == pytest.approx([1000 / 0.25e6] * 10)
    # a measured EI states the modulus, four times the material's here
    measured = 4 * 0.25e6 * math.pi / 4 * 0.01**4
    rod = design.Section(0.2, 0.01, RUBBER, 5, bending_stiffness=measured)
    springs = design.lay_out(design.Arm((rod,), design.Damping(viscosity=1000.0))).all_springs
    assert [s.damping / s.stiffness for s in springs] == pytest.approx([1000 / 1e6] * 10)


@pytest.mark.parametrize("own", [{}, {"axial_stiffness": 70.0, "shear_stiffness": 20.0}])
def test_a_measured_bending_stiffness_leaves_axial_and_shear_stiffness(own):
    """EA = E π r², κ GA by Cowper's 6 (1 + ν) / (7 + 6 ν); each over its spring's length."""
    freedoms = ("bend_y", "extension", "shear_y")
    rod = design.Section(0.2, 0.01, RUBBER, 4, freedoms, bending_stiffness=2e-4, name="rod", **own)
    arm = design.Arm((rod,))
    springs = design.lay_out(arm).all_springs
    found = {s.name.rpartition("_")[0]: s.stiffness * s.weight for s in springs}
    axial, nu = own.get("axial_stiffness", 0.25e6 * math.pi * 0.01**2), 0.49
    shear = own.get("shear_stiffness", 3 * axial / (7 + 6 * nu))
    assert found["bend_y"] == pytest.approx(2e-4)
    assert found["extension"] == pytest.approx(axial)
    assert found["shear_y"] == pytest.approx(shear)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        design.urdf(arm)
    words = [str(one.message) for one in said]
    assert [word.split()[2] for word in words] == (
        [] if own else ["axial_stiffness", "shear_stiffness"]
    )
    assert all("'rod'" in word for word in words)


def test_a_profile_is_looked_at_all_along_and_cables_go_outwards():
    with refused("radius"):
        design.Section(0.2, lambda s: s - 0.5, RUBBER, 5)
    rods = tuple(design.Section(0.1, 0.01, RUBBER, 2, name=f"s{k}") for k in range(3))
    for start, end in ((0, 2), (1, 1), (0, -1), (2, 1), (1, -4)):
        cable = design.Cable(0.0, 0.005, False, 1.0, start, end)
        if (start, end) not in ((2, 1), (1, -4)):
            assert design.Arm(rods, cables=(cable,)).cables == (cable,)
        else:
            with refused("cable 'cable'"):
                design.Arm(rods, cables=(cable,))


def test_a_cable_that_meets_the_axis_bends_by_its_moment_along_the_rod(tmp_path):
    """θ = T ∫ r cos α ds / EI: here r falls linearly to 0, and tan α is 8 mm over 200 mm."""
    stiff, tension = 0.25e6 * math.pi / 4 * 0.01**4, 0.25
    rod = design.Section(0.2, 0.01, RUBBER, 20)
    expected = tension * 0.008 * 0.2 / 2 / math.hypot(1, 0.04) / stiff
    assert expected == pytest.approx(0.10178, abs=5e-6)
    for offset in ((0.008, 0.0), (0.0, 0.008), (0.004, 0.0, 0.004)):
        cable = design.Cable(math.pi / 2, offset, False, 1.0)
        model = loaded(design.Arm((rod,), cables=(cable,)), tmp_path)
        q = model.state(model.q0, model.q0).B[:, 0] * tension / model.stiffness
        bend = np.abs(q[["bend_z" in name for name in model.joint_names]]).sum()
        assert np.abs(q).sum() == pytest.approx(bend, rel=1e-12)
        if len(offset) == 2:
            assert bend == pytest.approx(expected, rel=1e-9)
        else:  # the same slope, half the offset; it meets the axis in the middle
            assert bend == pytest.approx(expected / 2, rel=2e-2)


def test_a_cable_on_the_axis_shortens_the_rod_and_bends_nothing(tmp_path):
    rod = design.Section(0.2, 0.01, RUBBER, 5, freedoms=("bend_y", "bend_z", "extension"))
    cable = design.Cable(0.0, 0.0, False, 1.0, name="central")
    model = loaded(design.Arm((rod,), cables=(cable,)), tmp_path)
    q = model.state(model.q0, model.q0).B[:, 0] / model.stiffness
    bends = np.array(["bend" in name for name in model.joint_names])
    assert not q[bends].any()
    assert q.sum() == pytest.approx(-0.2 / (0.25e6 * math.pi * 0.01**2), rel=1e-12)
    stays = design.Section(0.2, 0.01, RUBBER, 5)
    with refused("cable 'central'", "a length that bend_y, bend_z do not change"):
        design.urdf(design.Arm((stays,), cables=(cable,)))
    with refused("offset", -1e-09):
        design.Cable(0.0, (0.008, -1e-9), False, 1.0)


def test_a_straight_cable_along_the_axis_is_a_path_of_chords(tmp_path):
    rod = design.Section(0.2, 0.01, RUBBER, 5, discs=5)
    cable = design.Cable(0.0, 0.0, True, 1.0)
    model = loaded(design.Arm((rod,), cables=(cable,)), tmp_path)
    assert model.tendon_lengths(model.q0)[0] == pytest.approx(0.2, rel=1e-12)
    assert not model.state(model.q0, model.q0).B.any()
    assert model.tendon_lengths(model.q0 + 0.2)[0] < 0.2  # a bent axis, its chords are shorter
