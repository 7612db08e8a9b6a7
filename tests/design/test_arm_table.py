"""`softdyn new`: it writes a file from a table, or reports the error in one line."""

from __future__ import annotations

import copy
import json
import tomllib
from pathlib import Path

import pytest

from softdyn import design, parse
from softdyn.commands import new
from tests.support.arms import THREE_SECTIONS
from tests.support.refused import refused


def test_the_command_writes_a_file_that_the_strict_parser_takes(tmp_path: Path, capsys):
    source = tmp_path / "arm.toml"
    source.write_text(THREE_SECTIONS)
    assert new.main([str(source), "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    robot = parse(tmp_path / "arm.urdf")
    assert (len(robot.moving_joints), len(robot.actuators)) == (24, 12)
    assert robot.length == pytest.approx(report["length_m"]) == pytest.approx(0.3)
    masses = sum(link.inertia.mass for link in robot.links)
    assert masses == pytest.approx(report["mass_kg"])
    # three frusta, by their formula
    frusta = [(0.12, 20, 17), (0.1, 17, 14), (0.08, 14, 11)]
    volume = sum(3.141592653589793 / 3e6 * h * (a * a + a * b + b * b) for h, a, b in frusta)
    assert masses == pytest.approx(1070 * volume, rel=1e-12)


def test_units_are_units():
    table = tomllib.loads(THREE_SECTIONS)
    other = copy.deepcopy(table)
    other["material"] = {"youngs_modulus_kPa": 250, "density_g_cm3": 1.07}
    for section in other["section"]:
        section["length_m"] = section.pop("length_mm") / 1000
        section["radius_cm"] = [r / 10 for r in section.pop("radius_mm")]
    one, two = design.make_arm(table), design.make_arm(other)
    assert design.lay_out(one).rates == pytest.approx(design.lay_out(two).rates, rel=1e-9)


WRONG = {
    "no segments": ("segments = 4", "segments = 0", ("[[section]] 1: segments", 0)),
    "more than a file may have": (
        "segments = 4",
        "segments = 257",
        ("[[section]] 1: segments", 257),
    ),
    "negative radius": ("[20, 17]", "[20, -17]", ("[[section]] 1: radius", -0.017)),
    "m for mm": ("length_mm", "length_m", ("section 'section_1': length", "120: in mm?")),
    "mm for m": (
        "length_mm = ",
        "length_mm = 0.00",
        ("section 'section_1': length", "1.2e-06: in m, not in mm?"),
    ),
    "no unit of an optional key": (
        "= 0.25",
        "= 0.25\ndensity = 1000",
        ("[material]: density", "'density'; did you mean 'density_kg_m3'?"),
    ),
    "E 1e3 too large": (
        "= 0.25",
        "= 250",
        ("cable 'base_1': bend at max_tension, by Young's modulus and radius", 0.00142),
    ),
    "pull 1e2 too large": (
        "max_tension_N = 20",
        "max_tension_N = 2500",
        ("cable 'base_1': max_tension", 48),
    ),
    "pull 1e3 too large": (
        "max_tension_N = 20",
        "max_tension_N = 20000",
        (
            "cable 'base_1': bend at max_tension, by Young's modulus and radius",
            "1.42e+03",
        ),
    ),
    "E 1e6 too large": (
        "= 0.25",
        "= 250000",
        ("section 'section_1': sqrt(E / density)", "1.53e+04"),
    ),
    "E 1e3 too small": ("= 0.25", "= 0.00025", ("section 'section_1': Young's modulus",)),
    "E 1e6 too small": (
        "= 0.25",
        "= 0.00000025",
        ("section 'section_1': Young's modulus",),
    ),
    "cable outside": (
        "[15, 12]",
        "[25, 12]",
        ("cable 'base_1' in section 'section_1'", "0.025 m"),
    ),
    "not a number": ("ratio = 0.15", "ratio = nan", ("[damping]: ratio", "nan")),
    "slip of the pen": (
        "radius_mm = [20",
        "raduis_mm = [20",
        ("[[section]] 1: raduis_mm", "'raduis_mm'; did you mean 'radius_mm'?"),
    ),
    "slip in a table": (
        "[damping]",
        "[dampnig]",
        ("dampnig", "'dampnig'; did you mean 'damping'?"),
    ),
    "no unit": (
        "length_mm = 120",
        "length = 120",
        ("[[section]] 1: length", "'length'; did you mean 'length_m'?"),
    ),
    "two units": (
        "length_mm = 120",
        "length_mm = 120\nlength_m = 1",
        ("[[section]] 1: length_m", "length_mm too"),
    ),
    "unsaid routing": ('routing = "channel"\nto', "to", ("[[cable]] 1", "none")),
    "no such section": ('to = "section_1"', 'to = "hand"', ("[[cable]] 1: to", "'hand'")),
    "no discs": (
        '"channel"',
        '"discs"',
        ("cable 'base_1' in section 'section_1'", "a section without discs"),
    ),
    "nothing": (THREE_SECTIONS, "", ("arm.toml", "nothing")),
    "solid inside out": (
        "[20, 17]",
        "[20, 17]\ninner_radius_mm = 18",
        ("[[section]] 1: inner_radius", "0.018…"),
    ),
    "no name": ('"base"', "'a<b'", ("[[cable]] 1: name", "'a<b_1'")),
    "two dampings": (
        "ratio = 0.15",
        "ratio = 0.15\ntime_constant_s = 1",
        ("[damping]: damping", "ratio and time_constant"),
    ),
    "no modulus": (
        "youngs_modulus_MPa = 0.25",
        "",
        ("[material]", "none"),
    ),
    "squeezed": (
        "= 0.25",
        "= 0.25\npoissons_ratio = 0.7",
        ("[material]: poissons_ratio", 0.7),
    ),
}


@pytest.mark.parametrize(("old", "wrong", "message"), WRONG.values(), ids=WRONG)
def test_bad_input_is_one_line(old, wrong, message):
    text = THREE_SECTIONS.replace(old, wrong, 1)
    assert text != THREE_SECTIONS
    with refused(*message) as caught:
        design.read(tomllib.loads(text), "arm.toml")
    assert str(caught.value).startswith("")
    assert "\n" not in str(caught.value)


def test_a_mount_hangs_down_unless_it_says_otherwise():
    arm = design.make_arm(tomllib.loads(THREE_SECTIONS + "[mount]\nposition_m = [0.1, 0, 0]\n"))
    assert arm.mount.position == (0.1, 0, 0)
    assert arm.mount.direction == design.make_arm(tomllib.loads(THREE_SECTIONS)).mount.direction
    assert arm.mount.direction == (0, 0, -1)


def test_unusual_numbers_may_be_meant():
    text = THREE_SECTIONS.replace("= 0.25", "= 250", 1)
    assert design.read(tomllib.loads("unusual = true\n" + text)).text


def test_a_file_of_another_hand_is_replaced_only_if_it_is_named(tmp_path: Path, capsys):
    source, out = tmp_path / "arm.toml", tmp_path / "arm.urdf"
    source.write_text(THREE_SECTIONS)
    out.write_text("mine")
    assert new.main([str(source)]) == 2
    assert "arm.urdf: expected no file, or --out to replace it" in capsys.readouterr().err
    assert out.read_text() == "mine"
    assert new.main([str(source), "--out", str(out)]) == 0
    source.write_text(THREE_SECTIONS.replace("segments = 4", "segments = 5", 1))
    assert new.main([str(source)]) == 0  # its own
    assert len(parse(out).moving_joints) > 24


def test_nothing_is_written_for_bad_input(tmp_path: Path, capsys):
    source = tmp_path / "arm.toml"
    source.write_text(THREE_SECTIONS.replace("segments = 4", "segments = 0", 1))
    assert new.main([str(source)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.toml"]
    assert new.main([str(source), "--out", str(source)]) == 2
