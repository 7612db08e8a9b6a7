"""Several displacements of all sizes: each is found, and there are no false ones."""

from __future__ import annotations

import re

import numpy as np
import pytest

from softdyn.validation import compare
from tests.support import robots

INERTIA = "2e-3 1e-4 -2e-4 3e-3 3e-4 4e-3"


def robot(*joints, root="base", frames="", inertia=INERTIA):
    """URDF text of a chain: name, parent, xyz, rpy, axis, centre of mass."""
    text = robots.link(root) + frames
    for name, parent, at, rpy, axis, centre in joints:
        text += robots.link(name, 1, centre, inertia)
        text += robots.joint(
            f"{name}_joint", parent, name, axis, at=at, rpy=rpy, limit=(-3, 3), effort=1
        )
    return robots.robot("chain", text)


def compared(folder, one, other):
    """Kind, joint and text of every cause; the causes must explain all differences."""
    paths = folder / "one.urdf", folder / "other.urdf"
    for path, text in zip(paths, (one, other), strict=True):
        path.write_text(text)
    result = compare(*paths)
    assert result.explained, str(result)
    return {(cause.kind, cause.where): cause.detail for cause in result.causes}


def replaced(text, old, new):
    assert text.count(old) == 1, old
    return text.replace(old, new)


# an arm with three parallel axes, as UR's; its links lie in parallel planes
UR = robot(
    ("pan", "base", "0 0 0.1625", "0 0 0", "0 0 1", "0 -0.026 0.002"),
    ("lift", "pan", "0 0.138 0", "0 1.5707963267948966 0", "0 1 0", "0 0 0.2125"),
    ("elbow", "lift", "0 -0.131 0.425", "0 0 0", "0 1 0", "0 0 0.196"),
    ("wrist_1", "elbow", "0 0 0.3922", "0 1.5707963267948966 0", "0 1 0", "0 0.127 0"),
    ("wrist_2", "wrist_1", "0 0.127 0", "0 0 0", "0 0 1", "0 0 0.1"),
    ("wrist_3", "wrist_2", "0 0 0.1", "0 0 0", "0 1 0", "0 0.077 0"),
)


@pytest.mark.parametrize("angle", [1.5707963267948966, 3.141592653589793])
def test_half_a_millimetre_beside_a_turned_base(tmp_path, angle):
    """One height differs by 0.5 mm; this is named, and no axis counts as reversed."""
    wrong = replaced(UR, 'xyz="0 0 0.1625" rpy="0 0 0"', f'xyz="0 0 0.163" rpy="0 0 {angle}"')
    wrong = replaced(wrong, "0 -0.131 0.425", "0 -0.1303 0.4252")
    assert compared(tmp_path, UR, wrong) == {
        ("zero", "pan_joint"): f"moved {angle:+.6g} rad",
        ("pose", "pan_joint"): "moved 0.5 mm",
        ("pose", "elbow_joint"): "moved 0.728011 mm",
    }


@pytest.mark.parametrize("size", [1e-5, 5e-5, 1e-4, 3e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("turn", ["0 0 0", "0.3 -0.2 0.9"])
def test_a_joint_displaced_by_any_size_is_no_moved_zero(tmp_path, size, turn):
    """As in hands, everything that the joint carries moves along, by any distance."""
    hand = robot(
        ("knuckle", "base", "0.01 0.02 0.09", turn, "0 1 0", "0.002 -0.001 0.02"),
        ("proximal", "knuckle", "0 0 0.04", turn, "1 0 0", "0 0.003 0.022"),
        ("distal", "proximal", "0 0 0.045", "0 0 0", "1 0 0", "0.001 0 0.012"),
    )
    for old, where in (("0.01 0.02 0.09", "knuckle"), ("0 0 0.045", "distal")):
        x, y, z = map(float, old.split())
        wrong = replaced(hand, f'"{old}"', f'"{x + 0.6 * size!r} {y!r} {z + 0.8 * size!r}"')
        words = f"moved {1e3 * size:.6g} mm"
        assert compared(tmp_path, hand, wrong) == {("pose", f"{where}_joint"): words}
        assert compared(tmp_path, wrong, hand) == {("pose", f"{where}_joint"): words}


HEAD = robot(
    ("neck", "base", "0 0 0.4", "0 0 0", "0 1 0", "0 0.001 0.01"),
    ("head", "neck", "0 0 0.02", "0 0 0", "0 0 1", "0.01079 0.00005 0.11"),
)


def test_a_centre_near_its_axis_is_no_moved_zero(tmp_path):
    """A turn of 0.053 rad would bring the centre closer, but no other part."""
    wrong = replaced(HEAD, "0.01079 0.00005 0.11", "0.01082 0.00063 0.1099")
    at = wrong.index('<link name="head">')
    wrong = wrong[:at] + replaced(wrong[at:], 'izz="4e-3"', 'izz="4.02e-3"')
    found = compared(tmp_path, HEAD, wrong)
    assert {kind for kind, _ in found} == {"centre", "inertia"}
    assert found["centre", "head"] == "0.5893 mm apart"


def test_what_is_turned_is_told_by_links(tmp_path):
    """The same head with a moved zero and another centre; its frame moved along."""
    wrong = replaced(HEAD, 'xyz="0 0 0.02" rpy="0 0 0"', 'xyz="0 0 0.02" rpy="0 0 0.3"')
    wrong = replaced(wrong, "0.01079 0.00005 0.11", "0.0111 0.0001 0.11")
    found = compared(tmp_path, HEAD, wrong)
    assert found == {
        ("zero", "head_joint"): "moved +0.3 rad",
        ("centre", "head"): "0.314 mm apart",
    }


def test_zeros_that_undo_each_other_are_two_zeros(tmp_path):
    """A new calibration, for example, moves the zeros of two parallel joints."""
    wrong = replaced(
        UR, 'xyz="0 0.138 0" rpy="0 1.5707963267948966 0"', 'xyz="0 0.138 0" rpy="0 0 0"'
    )
    wrong = replaced(
        wrong,
        'xyz="0 -0.131 0.425" rpy="0 0 0"',
        'xyz="0 -0.131 0.425" rpy="0 1.5707963267948966 0"',
    )
    assert compared(tmp_path, UR, wrong) == {
        ("zero", "lift_joint"): "moved -1.5708 rad",
        ("zero", "elbow_joint"): "moved +1.5708 rad",
    }


def test_four_legs_are_no_base(tmp_path):
    """Each leg is displaced separately; a moved base would displace the neck, too."""

    def robot_with(turn):
        legs = []
        for k in range(4):
            hip = f"{0.2 * (-1) ** k} {0.1 * (-1) ** (k // 2)} 0"
            legs.append((f"hip_{k}", "base", hip, turn, "1 0 0", "0.01 0.002 -0.1"))
            legs.append((f"leg_{k}", f"hip_{k}", "0 0.05 0", "0 0 0", "0 1 0", "0.01 0 -0.1"))
        neck = ("neck", "base", "0.3 0 0.1", "0 0 0", "0 1 0", "0 0 0.1")
        head = ("head", "neck", "0 0 0.2", "0 0 0", "1 0 0", "0.03 0 0.05")
        return robot(*legs, neck, head)

    found = compared(tmp_path, robot_with("0 0 0"), robot_with("0 0 1.5707963267948966"))
    assert found == {("pose", f"hip_{k}_joint"): "turned 1.5708 rad" for k in range(4)}


def test_fingers_of_a_turned_hand_are_not_mixed_up(tmp_path):
    """Without common names and with a displaced base, the first finger still matches the first."""

    def hand(names, place):
        fingers = []
        for name, y in zip(names, (0.06, 0.015, -0.03), strict=True):
            fingers += [
                (f"{name}a", "palm", f"0.02 {y} 0.09", "0 0 0", "0 1 0", "0.002 0.001 0.02"),
                (f"{name}b", f"{name}a", "0 0 0.04", "0 0 0", "0 1 0", "0.001 0 0.02"),
            ]
        thumb = (f"{names[0]}t", "palm", "0.03 0.04 0.01", "0 0 0", "0 0 1", "0 0.03 0")
        palm = (
            f'<link name="palm"/><joint name="palm" type="fixed"><parent link="base"/>'
            f'<child link="palm"/><origin {place}/></joint>'
        )
        return robot(*fingers, thumb, frames=palm)

    one = hand("xyz", 'xyz="0 0 0"')
    other = hand("uvw", 'xyz="0.1 0.02 0.1" rpy="0 3.141592653589793 0"')
    paths = tmp_path / "one.urdf", tmp_path / "other.urdf"
    for path, text in zip(paths, (one, other), strict=True):
        path.write_text(text)
    result = compare(*paths)
    assert result.matched["xa_joint"] == "ua_joint"
    assert result.matched["zb_joint"] == "wb_joint"
    assert {cause.kind for cause in result.causes} == {"base"}


def test_a_wheel_is_no_caster(tmp_path):
    """A joint at about the same place with another axis is another joint."""
    arm = [
        ("arm_1", "base", "0 0 0.5", "0 0 0", "0 0 1", "0.05 0 0.1"),
        ("arm_2", "arm_1", "0.1 0 0.1", "0 0 0", "0 1 0", "0.1 0 0.02"),
    ]
    caster = ("caster", "base", "0.17 -0.1 -0.03", "0 0 0", "0 0 1", "0 0 -0.02")
    wheel = ("wheel", "base", "0.22 -0.22 0", "0 0 0", "0 1 0", "0 0 0")
    heavy = robot(*arm, wheel)
    at = heavy.index('<link name="wheel">')
    heavy = heavy[:at] + re.sub('mass value="1"', 'mass value="9"', heavy[at:])
    paths = tmp_path / "one.urdf", tmp_path / "other.urdf"
    for path, text in zip(paths, (robot(*arm, caster), heavy), strict=True):
        path.write_text(text)
    result = compare(*paths)
    assert result.unmatched == {"a": ["caster_joint"], "b": ["wheel_joint"]}
    assert not result.causes


def test_noise_of_rounding_hides_no_cause(tmp_path):
    """All numbers have five digits, and one joint is off by 0.1 mm."""
    rng = np.random.default_rng(0)

    def rounded(match):
        return f"{float(match[0]) * (1 + 1e-6 * rng.uniform(-1, 1)):.12g}"

    noisy = re.sub(r"-?\d\.\d{3,}", rounded, UR)
    wrong = replaced(noisy, re.search(r'"0 (-0\.13\d*)', noisy)[1], "-0.1309")
    found = compared(tmp_path, UR, wrong)
    large = {key: words for key, words in found.items() if "mm" in words and "e-" not in words}
    assert ("pose", "elbow_joint") in large
    assert large["pose", "elbow_joint"].startswith(("moved 0.1", "moved 0.099"))
    assert not {kind for kind, _ in found} & {"zero", "base"}


def test_where_on_its_axis_a_link_begins_displaces_nothing(tmp_path):
    """Parallel axes: other links begin up to 176 mm further along them, all else is 1 mm off."""
    one, other = (
        robot(
            ("pan", "base", pan, "0 0 0", "0 0 1", "0 0 0"),
            ("lift", "pan", lift, "0 0 0", "0 1 0", upper),
            ("elbow", "lift", elbow, "0 0 0", "0 1 0", fore),
            ("wrist_1", "elbow", wrist, "0 0 0", "0 1 0", centre),
            ("wrist_2", "wrist_1", last, "0 0 0", "0 0 1", "0 0 0"),
        )
        for pan, lift, upper, elbow, fore, wrist, centre, last in (
            ("0 0 0.1807", "0 0 0", "0.306 0.175 0", "0.6127 0 0", "0.28577 0.0393 0",
             "0.57155 0.17415 0", "0 0 0", "0 0 -0.11985"),
            ("0 0 0.181", "0 0.176 0", "0.3065 0 0", "0.613 -0.137 0", "0.2855 0 0",
             "0.571 0 0", "0 0.135 0", "0 0.135 -0.12"),
        )
    )  # fmt: skip
    found = compared(tmp_path, one, other)
    moved = [words for (kind, _), words in found.items() if kind != "frame"]
    assert max(float(re.search(r"([\d.]+) mm", words)[1]) for words in moved) < 1.5


def test_a_link_that_begins_elsewhere_on_its_axis_is_a_frame(tmp_path):
    """The axes lie a tenth of a nanometre apart, which is no cause."""
    arm = ("pan", "base", "0 0 0.1", "0 0 0", "0 0 1", "0 -0.026 0.002")
    one = robot(arm, ("roll", "pan", "0 0 0.3", "0 0 0", "0 0 1", "0.01 0 0.02"))
    other = robot(arm, ("roll", "pan", "0 1e-10 0.29", "0 0 0", "0 0 1", "0.01 -1e-10 0.03"))
    assert set(compared(tmp_path, one, other)) == {("frame", "roll")}
