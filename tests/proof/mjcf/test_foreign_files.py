"""The survey of public files: what is read, refused, and never different in silence."""

from __future__ import annotations

from tests.proof.mjcf.foreign_files import survey
from tests.support import pair_robots


def test_each_file_is_a_row(tmp_path):
    (tmp_path / "good.xml").write_text(pair_robots.MJCF)
    (tmp_path / "good.urdf").write_text(pair_robots.URDF)
    (tmp_path / "broken.urdf").write_text("<robot")
    (tmp_path / "part.xml").write_text("<mujocoinclude/>")
    found = survey([str(tmp_path)], samples=1)
    rows = {row.file.partition("/")[2]: row for row in found.rows}
    assert sorted(rows) == ["broken.urdf", "good.urdf", "good.xml"]
    assert rows["broken.urdf"].code == 2
    assert str(tmp_path) not in rows["broken.urdf"].said
    assert rows["good.urdf"].code == 0
    assert rows["good.urdf"].worst < 1e-9
    assert found.passed
