"""Almost correct names in a block, and sites that are too close."""

import pytest

from softdyn import UrdfError
from softdyn.description.urdf import parse
from tests.support import ROOT
from tests.support.refused import refused
from tests.support.robots import cable, joint, link, robot, write


@pytest.mark.parametrize(
    ("place", "name", "slip", "element"),
    [
        ('<joint name="{}" coef', "joint1", "jiont1",
         '<softdyn><tendon name="tendon_a"><joint name="jiont1">'),
        ('<gazebo reference="{}">', "joint1", "jont1", '<gazebo reference="jont1">'),
        ('<task frame="{}"', "tip", "tpi", "<softdyn><task>"),
        (' tendon="{}"', "tendon_a", "tendona", '<softdyn><actuator name="u1">'),
    ],
)  # fmt: skip
def test_a_slip_is_answered_with_the_name(tmp_path, place, name, slip, element):
    text = (ROOT / "urdf" / "finger.urdf").read_text()
    wrong = text.replace(place.format(name), place.format(slip), 1)
    assert wrong != text
    (tmp_path / "slip.urdf").write_text(wrong)
    with refused(element, f"'{slip}'; did you mean '{name}'?", by=UrdfError):
        parse(tmp_path / "slip.urdf")


@pytest.mark.parametrize(
    "name", ["axis", "limit", "child", "mimic", "origin", "parent", "dynamics", "calibration"]
)
def test_letters_left_out_are_a_slip_one_of_four_to_six_and_two_of_more(name, tmp_path):
    text = (ROOT / "urdf" / "finger.urdf").read_text()
    for left_out in (1, 2, 3):
        slip = name[:1] + name[1 + left_out :]
        (tmp_path / "slip.urdf").write_text(text.replace("</joint>", f"<{slip}/></joint>", 1))
        if left_out > (1 if len(name) <= 6 else 2):  # another tool's element
            parse(tmp_path / "slip.urdf")
        else:
            place = f'<joint name="base_joint"><{slip}>'
            with refused(place, f"<{slip}> (misspelt?)", by=UrdfError):
                parse(tmp_path / "slip.urdf")


def test_sites_of_different_links_are_apart(tmp_path):
    """In both orders; on one link a site may occur twice."""
    links = link("a"), link("b", 1, None, 1), joint("j", "a", "b", None, "continuous")
    for first, second in ("ab", "ba", "aa"):
        tendon = cable("t", f"{first} 0.1 0 0", f"{second} 0.1 0 0", "b 0 0 0.2")
        path = write(tmp_path, robot("r", *links, block=tendon))
        if first == second:
            assert len(parse(path).tendons[0].sites) == 3
        else:
            got = f"sites of '{first}' and '{second}' at the same point"
            with refused('<softdyn><tendon name="t">', got, by=UrdfError):
                parse(path)
