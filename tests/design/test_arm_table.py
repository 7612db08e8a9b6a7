"""`softdyn new`: it writes a file from a table, or reports the error in one line."""

from __future__ import annotations

import copy
import json
import tomllib
from pathlib import Path

import pytest

from softdyn import InputError, design, parse
from softdyn.commands import new
from tests.support.arms import THREE_SECTIONS


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
    "no segments": ("segments = 4", "segments = 0", r"\[\[section\]\] 1: segments: .*, got 0"),
    "more than a file may have": ("segments = 4", "segments = 257", "from 1 to 256, got 257"),
    "negative radius": ("[20, 17]", "[20, -17]", r"radius: expected a finite number > 0, got -0.0"),
    "m for mm": ("length_mm", "length_m", r"length: expected 0.001 to 20 m .*: in mm\?$"),
    "mm for m": ("length_mm = ", "length_mm = 0.00", r"length: .*in m, not in mm\?$"),
    "no unit of an optional key": (
        "= 0.25",
        "= 0.25\ndensity = 1000",
        r"density: expected density_kg_m3 or density_g_cm3, ",
    ),
    "E 1e3 too large": ("= 0.25", "= 250", "'base_1': bend at max_tension, by Young's modulus"),
    "pull 1e2 too large": (
        "max_tension_N = 20",
        "max_tension_N = 2500",
        "'base_1': max_tension: expected at most 30 times the moment of the arm's weight",
    ),
    "pull 1e3 too large": (
        "max_tension_N = 20",
        "max_tension_N = 20000",
        "'base_1': bend at max_tension",
    ),
    "E 1e6 too large": ("= 0.25", "= 250000", "expected at most 14000 m/s"),
    "E 1e3 too small": ("= 0.25", "= 0.00025", "Young's modulus: expected 5000 to"),
    "E 1e6 too small": ("= 0.25", "= 0.00000025", "Young's modulus: expected 5000 to"),
    "cable outside": ("[15, 12]", "[25, 12]", "an offset inside the body, at most 0.02 m"),
    "not a number": ("ratio = 0.15", "ratio = nan", r"\[damping\]: ratio: expected a finite"),
    "slip of the pen": (
        "radius_mm = [20",
        "raduis_mm = [20",
        "raduis_mm: .*did you mean 'radius_mm'",
    ),
    "slip in a table": (
        "[damping]",
        "[dampnig]",
        "dampnig: .*did you mean 'damping'",
    ),
    "no unit": ("length_mm = 120", "length = 120", "length: expected length_mm or length_cm"),
    "two units": ("length_mm = 120", "length_mm = 120\nlength_m = 1", "expected one unit"),
    "unsaid routing": ('routing = "channel"\nto', "to", r"1: expected routing, got none"),
    "no such section": ('to = "section_1"', 'to = "hand"', "to: expected section_1 or section_2"),
    "no discs": ('"channel"', '"discs"', "expected discs that lead it"),
    "nothing": (THREE_SECTIONS, "", r"expected \[\[section\]\]"),
    "solid inside out": ("[20, 17]", "[20, 17]\ninner_radius_mm = 18", "less than the radius"),
    "no name": ('"base"', "'a<b'", r"\[\[cable\]\] 1: name: expected letters, digits"),
    "two dampings": ("ratio = 0.15", "ratio = 0.15\ntime_constant_s = 1", "ratio and time_const"),
    "no modulus": (
        "youngs_modulus_MPa = 0.25",
        "",
        r"\[material\]: expected youngs_modulus_MPa or .*, got none",
    ),
    "squeezed": ("= 0.25", "= 0.25\npoissons_ratio = 0.7", "poissons_ratio: expected a number"),
}


@pytest.mark.parametrize(("old", "wrong", "message"), WRONG.values(), ids=WRONG)
def test_bad_input_is_one_line(old, wrong, message):
    text = THREE_SECTIONS.replace(old, wrong, 1)
    assert text != THREE_SECTIONS
    with pytest.raises(InputError, match=message) as caught:
        design.read(tomllib.loads(text), "arm.toml")
    assert str(caught.value).startswith("arm.toml: ")
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
