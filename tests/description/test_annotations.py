"""Names in a block that are nearly right."""

import pytest

from softdyn import UrdfError
from softdyn.description.urdf import parse
from tests.support import ROOT


@pytest.mark.parametrize(
    ("place", "name", "slip"),
    [
        ('<joint name="{}" coef', "joint1", "jiont1"),
        ('<gazebo reference="{}">', "joint1", "jont1"),
        ('<task frame="{}"', "tip", "tpi"), (' tendon="{}"', "tendon_a", "tendona"),
    ],
)  # fmt: skip
def test_a_slip_is_answered_with_the_name(tmp_path, place, name, slip):
    text = (ROOT / "urdf" / "finger.urdf").read_text()
    wrong = text.replace(place.format(name), place.format(slip), 1)
    assert wrong != text
    (tmp_path / "slip.urdf").write_text(wrong)
    with pytest.raises(UrdfError, match=f"got '{slip}'; did you mean '{name}'\\?"):
        parse(tmp_path / "slip.urdf")
