"""Chambers under pressure: closed forms, a volume by its own quadrature, MuJoCo, and misuse."""

from __future__ import annotations

import math
import tomllib
import warnings
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest

from softdyn import InputError, SoftModel, design, statics
from softdyn.description.readings import ReadingLayout
from softdyn.description.robot import Robot
from softdyn.description.urdf import parse_text
from softdyn.design import Arm, Cable, CableMotor, Chamber, Damping, Material, Mount, Section
from softdyn.sensing import Sensors
from softdyn.validation import Rig, rollout
from softdyn.validation.mjcf import export
from tests.support import robots
from tests.support.arms import loaded
from tests.support.refused import refused

LENGTH, RADIUS, EI, EA = 0.1, 0.0125, 2e-3, 40.0
PRESSURE, AREA, OFFSET = 8e4, 4e-5, 0.008
LEVEL = Mount(direction=(1.0, 0.0, 0.0))
"""Bends about the vertical axis, and extensions of an arm that lies level, feel no gravity."""


def arm(segments: int = 20, freedoms: tuple[str, ...] = ("bend_z",), **words: object) -> Arm:
    """A section with one chamber, beside its axis unless said otherwise."""
    section = Section(
        LENGTH, RADIUS, Material(2e5), segments, freedoms,
        bending_stiffness=EI, axial_stiffness=EA, mass=0.05,
    )  # fmt: skip
    given = {"angle": math.pi / 2, "offset": OFFSET, "max_pressure": 1e5, "area": AREA}
    one = Chamber(**given | words)  # type: ignore[arg-type]
    return Arm((section,), Damping(ratio=0.2), chambers=(one,), mount=LEVEL)


def pressed(model: SoftModel, *pressures: float) -> np.ndarray:
    """The configuration at rest under pressures (Pa)."""
    return statics.settle(model, np.array(pressures)).q


def test_one_chamber_bends_a_section_by_p_a_r_over_ei(tmp_path: Path) -> None:
    """The arc's curvature is exact at each joint; the tip's place converges with their number."""
    curvature = PRESSURE * AREA * OFFSET / EI
    turn = curvature * LENGTH
    errors = []
    for segments in (5, 10, 20, 40):
        model = loaded(arm(segments), tmp_path)
        q = pressed(model, PRESSURE)
        assert abs(q.sum()) / LENGTH == pytest.approx(curvature, rel=5e-3)
        along, across = math.sin(turn) / curvature, (1 - math.cos(turn)) / curvature
        y = model.state(q, np.zeros(model.nv)).y
        # a chamber at arm's -y pushes its own side longer, so the tip moves to +y
        errors.append(float(np.linalg.norm(y - (along, across, 0.0))) / LENGTH)
    assert errors[2] < 5e-4
    assert all(fine < coarse / 3 for coarse, fine in pairwise(errors))


def test_a_chamber_on_the_axis_stretches_a_section_by_p_a_over_ea(tmp_path: Path) -> None:
    model = loaded(arm(10, ("extension",), offset=0.0), tmp_path)
    assert pressed(model, PRESSURE).sum() == pytest.approx(LENGTH * PRESSURE * AREA / EA, rel=1e-9)
    hollow = loaded(arm(10, ("extension",), offset=0.0, min_pressure=-9e4), tmp_path)
    assert pressed(hollow, -6e4).sum() == pytest.approx(-LENGTH * 6e4 * AREA / EA, rel=1e-9)


def _body_volume(model: SoftModel, parts: Arm, q: np.ndarray) -> float:
    """The volume of a round tube in a bent and stretched body: ∫∫ (1 + ε + κ · y) dA ds.

    Each joint's strain is spread over the piece of rod that it stands for. Gauss's rule over the
    radius and even angles integrate the tube's circle.
    """
    (one,), layout = parts.chambers, design.lay_out(parts)
    radius = math.sqrt(one.section_area / math.pi)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    r, dr = radius * (1 + nodes) / 2, radius * weights / 2
    angles = np.arange(8) * math.pi / 4
    points = [one.place(0.5) + ri * np.array([0.0, math.cos(a), math.sin(a)])
              for ri in r for a in angles]  # fmt: skip
    areas = [ri * di * math.pi / 4 for ri, di in zip(r, dr, strict=True) for _ in angles]
    order = {name: k for k, name in enumerate(model.joint_names)}
    volume = sum(areas) * LENGTH
    for spring in layout.all_springs:
        strain = q[order[spring.name]] / spring.weight
        axis = spring.freedom.axis
        for point, area in zip(points, areas, strict=True):
            grown = np.cross(axis, point)[0] if spring.freedom.turns else axis[0]
            volume += area * strain * grown * spring.weight
    return volume


def _disc_volume(model: SoftModel, parts: Arm, q: np.ndarray) -> float:
    """The volume of bellows: straight pieces between points of discs, by the links' poses."""
    (one,) = parts.chambers
    tendon = next(t for t in model.robot.tendons if t.name == one.name)
    poses = model.link_poses(q)
    points = [poses[s.link][:3, :3] @ s.xyz + poses[s.link][:3, 3] for s in tendon.sites]
    return one.section_area * float(sum(np.linalg.norm(b - a) for a, b in pairwise(points)))


@pytest.mark.parametrize("straight", [False, True])
def test_the_work_of_the_pressure_is_p_times_the_change_of_the_volume(
    straight: bool, tmp_path: Path
) -> None:
    parts = arm(4, ("bend_y", "bend_z", "extension"), straight=straight)
    if straight:
        (section,) = parts.sections
        led = Section(**vars(section) | {"discs": 4})
        parts = Arm((led,), parts.damping, chambers=parts.chambers, mount=LEVEL)
    model = loaded(parts, tmp_path)
    random = np.random.default_rng(1)
    ends = (
        0.25
        * random.normal(size=(2, model.nv))
        * np.where(["extension" in name for name in model.joint_names], 0.01, 1.0)
    )
    nodes, weights = np.polynomial.legendre.leggauss(24)
    step, work = ends[1] - ends[0], 0.0
    for node, weight in zip(nodes, weights, strict=True):
        q = ends[0] + (1 + node) / 2 * step
        force = model.state(q, np.zeros(model.nv)).B @ [PRESSURE]
        work += weight / 2 * float(force @ step)
    volume = _disc_volume if straight else _body_volume
    first, last = (volume(model, parts, q) for q in ends)
    assert abs(last - first) > 1e-8
    assert work == pytest.approx(PRESSURE * (last - first), rel=1e-9)


def test_the_same_pressures_in_mujoco_bend_the_exported_arm_the_same(tmp_path: Path) -> None:
    parts = arm(6, ("bend_y", "bend_z", "extension"))
    file = robots.write(tmp_path, design.urdf(parts), "arm.urdf")
    export.write_mjcf(file, tmp_path / "arm.xml", shapes=False)
    model = loaded(parts, tmp_path)
    q = pressed(model, PRESSURE)
    judge = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(judge)
    data.ctrl[:] = PRESSURE
    places = [judge.joint(name).qposadr[0] for name in model.joint_names]
    stiffness = model.tangent_stiffness(q)
    found = q.copy()
    for _ in range(20):  # Newton's method on MuJoCo's own forces
        data.qpos[places] = found
        mujoco.mj_forward(judge, data)
        force = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
        found = found + np.linalg.solve(stiffness, force[places])
    assert np.abs(force).max() < 1e-10
    np.testing.assert_allclose(found, q, atol=1e-9)


VALVE = """\
[[sensor]]
type = "pressure"
name = "gauge"
noise_Pa = 0
resolution_kPa = 0
[[sensor]]
type = "pressure"
name = "bar"
chambers = ["base"]
bias_bar = 0.1
"""


def test_a_pressure_follows_its_valve_in_the_twin(tmp_path: Path) -> None:
    """A step through a first-order lag: p (1 - exp(-(t - delay)/τ)), and the bias of a gauge."""
    text = TEXT.replace("rate_kPa_s = 400\n", "") + VALVE
    model = robots.load(tmp_path, design.read(tomllib.loads(text), "arm.toml").text)
    u = np.array([0.0, 8e4, 0.0, 3e4, -2e4])
    names = [f"gauge_{name}" for name in ("base_1", "base_2", "base_3", "long")]
    log = rollout(model, u, 0.2, period=0.005, timestep=5e-4, rig=Rig(seed=0))
    columns = list(ReadingLayout(model.robot.sensors).names)
    seen = {name: log.measured[:, columns.index(name)] for name in columns}
    late = np.maximum(log.t - 0.005, 0.0)
    for name, p in zip(names, u[1:4], strict=False):
        expected = p * (1 - np.exp(-late / 0.05))
        np.testing.assert_allclose(seen[name], expected, atol=0.02 * 8e4)
    assert seen["gauge_long"][-1] == pytest.approx(-2e4)
    np.testing.assert_allclose(seen["bar_base_1"] - seen["gauge_base_1"], 1e4)
    assert ReadingLayout(model.robot.sensors).units(model.robot)[-1] == "Pa"
    row = columns.index("gauge_base_1")
    state = model.state(model.q0, np.zeros(model.nv))
    assert model.measure(state, u).values[row] == 8e4
    more = [model.measure(state, u + step).values[row] for step in np.eye(model.nu)]
    assert np.array(more) - 8e4 == pytest.approx([0, 1, 0, 0, 0])
    _, by_state = Sensors(model).predict(model.q0, np.zeros(model.nv), u)
    assert not by_state[row].any()


TEXT = """\
name = "pushed"
[material]
youngs_modulus_kPa = 200
[[section]]
name = "low"
length_mm = 60
radius_mm = 12
inner_radius_mm = 3
segments = 4
bending_stiffness_Nm2 = 2e-3
[[section]]
name = "up"
length_mm = 60
radius_mm = 12
inner_radius_mm = 3
segments = 4
bending_stiffness_Nm2 = 2e-3
[[cable]]
name = "rope"
offset_mm = 11
routing = "channel"
max_tension_N = 5
[[chamber]]
section = "low"
name = "base"
count = 3
offset_mm = 7.5
radius_mm = 3
max_pressure_kPa = 120
[[chamber]]
name = "long"
angle_deg = 60
offset_mm = 8
area_mm2 = 20
max_pressure_bar = 1
min_pressure_kPa = -60
[[valve]]
chambers = ["base"]
lag_ms = 50
rate_kPa_s = 400
delay_ms = 5
[[sensor]]
type = "length"
cables = ["long", "rope"]
"""


def robot(text: str) -> Robot:
    return parse_text(design.read(tomllib.loads(text), "arm.toml").text, path=Path("arm.urdf"))


def test_chambers_of_a_table_stand_behind_its_cables() -> None:
    found = robot(TEXT)
    rope, base, *_, long = found.actuators
    names = ["rope", "base_1", "base_2", "base_3", "long"]
    assert [one.name for one in found.actuators] == names
    assert [one.is_chamber for one in found.actuators] == [False, True, True, True, True]
    assert rope.gear == -1
    assert base.gear == pytest.approx(math.pi * 9e-6)
    assert (base.lower, base.upper) == (0, 120e3)
    assert (base.lag, base.rate, base.delay) == (0.05, 400e3, 0.005)
    assert long.is_ideal
    assert (long.gear, long.lower, long.upper) == pytest.approx((20e-6, -60e3, 1e5))
    spans = {t.name: {term.joint for term in t.terms} for t in found.tendons}
    assert max(int(name.rpartition("_")[2]) for name in spans["base_1"]) == 4
    assert max(int(name.rpartition("_")[2]) for name in spans["long"]) == 8
    assert [sensor.tendon for sensor in found.sensors] == ["long", "rope"]


WRONG = {
    "no area": ("radius_mm = 3\nmax", "max", ("[[chamber]] 1", "none")),
    "two areas": ("area_mm2 = 20", "area_mm2 = 20\nradius_mm = 2", ("[[chamber]] 2: area", "both")),
    "an area of zero": ("area_mm2 = 20", "area_mm2 = 0", ("[[chamber]] 2: area", 0.0)),
    "a negative radius": ("radius_mm = 3\nmax", "radius_mm = -3\nmax",
                          ("[[chamber]] 1: radius", -0.003)),
    "bar for kPa": ("max_pressure_bar = 1\n", "max_pressure_bar = 120\n",
                    ("chamber 'long': pressure", "a pressure of 1.2e+07 Pa, …")),
    "bar for Pa": ("max_pressure_kPa = 120", "max_pressure_Pa = 1.2",
                   ("chamber 'base_1': pressure", "a pressure of at most 1.2 Pa…")),
    "kPa for Pa": ("max_pressure_kPa = 120", "max_pressure_Pa = 120",
                   ("chamber 'base_1': pressure", "a pressure of at most 120 Pa…")),
    "below a vacuum": ("min_pressure_kPa = -60", "min_pressure_kPa = -600",
                       ("chamber 'long': pressure", "a gauge pressure of …")),
    "crossed bounds": ("min_pressure_kPa = -60", "min_pressure_kPa = 600",
                       ("[[chamber]] 2: min_pressure", "600000 and 100000 Pa")),
    "no unit": ("max_pressure_kPa", "max_pressure",
                ("[[chamber]] 1: max_pressure", "'max_pressure'…")),
    "too many by their circles": ("count = 3", "count = 8", ("section 'low': chambers", "5.74 mm")),
    "too many by their areas": ("area_mm2 = 20", "area_mm2 = 400",
                                ("section 'low': chambers", "484.8 mm²")),
    "through the wall": ("offset_mm = 7.5", "offset_mm = 9.5",
                         ("section 'low': chambers", "its outer edge at 12.5 mm")),
    "in the bore": ("offset_mm = 7.5", "offset_mm = 5",
                    ("section 'low': chambers", "its inner edge at 2 mm")),
    "an unknown section": ('section = "low"', 'section = "lo"',
                           ("[[chamber]] 1: section", "'lo'; did you mean 'low'?")),
    "a section and an end": ('section = "low"', 'section = "low"\nto = "up"',
                             ("[[chamber]] 1: to", "'to'")),
    "a valve of a cable": ('["base"]', '["rope"]', ("[[valve]] 1: chambers", "'rope'")),
    "a valve alone": (TEXT[TEXT.index("[[chamber]]") : TEXT.index("[[valve]]")], "",
                      ("[[valve]] 1", "none")),
    "a gauge on a cable": ("[[sensor]]\ntype = \"length\"\ncables = [\"long\", \"rope\"]",
                           "[[sensor]]\ntype = \"pressure\"\nchambers = [\"rope\"]",
                           ("[[sensor]] 1: chambers", "'rope'")),
    "two valves": ('["base"]\n', '["base", "base_1"]\n[[valve]]\n', ("motors", 2)),
    "one name": ('name = "long"', 'name = "rope"',
                 ("arm.toml", "rope, base_1, base_2, base_3, rope")),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "wrong"), WRONG.values(), ids=WRONG)
def test_misuse_is_one_line(old: str, new: str, wrong: tuple) -> None:
    text = TEXT.replace(old, new, 1)
    assert text != TEXT
    with refused(*wrong) as caught:
        design.read(tomllib.loads(text), "arm.toml")
    assert str(caught.value).startswith("arm.toml: ")
    assert "\n" not in str(caught.value)


def test_a_stiffness_that_counts_large_hollows_as_full_is_said() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        design.read(tomllib.loads(TEXT), "arm.toml")
    text = TEXT.replace("bending_stiffness_Nm2 = 2e-3\n", "", 1)
    with pytest.warns(UserWarning, match="section 'low': .* counts its chambers as full, 24.7 %"):
        design.read(tomllib.loads(text), "arm.toml")


def test_a_chamber_has_no_winch() -> None:
    winch = CableMotor(("chamber",), design.cables.CommandKind.LENGTH, stiffness=900.0)
    with pytest.raises(InputError) as caught:
        Arm(arm().sections, chambers=arm().chambers, motors=(winch,))
    assert caught.value.got == "a winch"


def test_an_arm_without_chambers_has_the_file_of_before() -> None:
    cable = Cable(0.3, 0.01, False, 5.0)
    parts = Arm(arm().sections, cables=(cable,), mount=LEVEL)
    assert "chamber" not in design.urdf(parts)
    assert "unit" not in design.urdf(parts)
