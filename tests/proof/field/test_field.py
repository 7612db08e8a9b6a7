"""The published rods: our chains against each other, the readers, and the blocks of a document."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import savemat

from softdyn import InputError
from tests.proof.field import cases, drag, newest, page, published, rods
from tests.support.command import left_as_it_was


def test_the_readers_take_each_format_and_frame(tmp_path):
    data = tmp_path / "paper_results" / published.SECTION / "data"
    data.mkdir(parents=True)
    stem, case = data / "end_effector_position_", cases.CASES["planar"]
    t = np.array([0.0, 1.0, 3.0])
    rows = np.column_stack((t, t, 0 * t, 2 * t))
    cells = "".join("<row>" + "".join(f"<c><v>{x}</v></c>" for x in row) + "</row>" for row in rows)
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    with zipfile.ZipFile(f"{stem}planar_pyelastica.xlsx", "w") as book:
        book.writestr(
            "xl/worksheets/sheet1.xml",
            f'<worksheet xmlns="{space}"><sheetData><row><c><v>0</v></c></row>{cells}'
            "</sheetData></worksheet>",
        )
    np.savetxt(f"{stem}planar_pcs_soromox.csv", rows[:, [0, 1, 3]], delimiter=",", header="t,x,z")
    savemat(f"{stem}planar_pcs_sorosim.mat", {"t": t[:, None], "Pos_EE_all": rows[:, 1:].T})
    found = published.read(tmp_path, case)
    expected = np.arange(300)[:, None] * 0.01 * np.array([1.0, 0, 2])
    assert list(found) == [published.PYELASTICA, published.SOROMOX, published.SOROSIM]
    for tip in found.values():
        assert tip == pytest.approx(expected, abs=1e-12)
    with pytest.raises(InputError, match="a folder with paper_results"):
        published.read(tmp_path / "data", case)


def test_gravity_across_the_rod_is_in_the_others_frame():
    case = cases.CASES["spatial"]
    twin = rods.twin_of(case, case.arm(3, cases.BENDS, case.time_constant), 1e-3)
    tips, _ = rods.roll(case, twin, 0.1)
    assert tips[0] == pytest.approx([0, 0, 0.6], abs=1e-12)
    assert tips[-1, 0] == pytest.approx(tips[-1, 1], abs=1e-12)
    assert -0.2 < tips[-1, 0] < -0.01
    # free fall of the tip at first: 1.5 g for a rigid rod, more for a soft one
    assert 0.5 * 9.81 * 0.01**2 < -tips[1, 0] < 2 * 9.81 * 0.01**2


def test_the_cables_pull_to_the_published_side():
    case = cases.CASES["rod"]
    tips, _ = rods.roll(case, rods.twin_of(case, case.arm(4, cases.BENDS, 0.03), 1e-3), 0.3)
    assert tips[-1, 0] < -1e-3
    assert tips[-1, 1] == pytest.approx(-tips[-1, 0], rel=1e-2)


def test_the_reduced_rod_begins_as_the_whole_one(monkeypatch):
    monkeypatch.setattr(rods, "SECONDS", 0.1)
    monkeypatch.setattr(rods, "HALF", 4)
    case = cases.CASES["spatial"]
    reduced = rods.in_their_strains(case)
    whole, _ = rods.roll(case, rods.twin_of(case, case.arm(8, cases.ALL, 0.03), 1e-3), 0.1)
    assert rods.distance(reduced, whole) < 0.1 * np.abs(whole - whole[0]).max()


def test_drag_takes_energy_and_none_changes_nothing(monkeypatch):
    monkeypatch.setattr(drag, "SECONDS", 0.2)
    case = cases.CASES["planar"]
    arm = case.arm(3, cases.BENDS, 0.0)

    def moved(constant: float) -> np.ndarray:
        dragged = replace(case, drag=constant)
        return drag.roll(dragged, rods.twin_of(case, arm, 5e-4))

    free, _ = rods.roll(case, rods.twin_of(case, arm, 5e-4), 0.2)
    assert moved(0.0) == pytest.approx(free, abs=1e-12)
    assert abs(moved(1.0)[-1, 0]) < 0.9 * abs(free[-1, 0])


def test_a_block_is_replaced_and_nothing_else(tmp_path):
    begin = "<!-- generated: python -m tests.proof field rod -->"
    (tmp_path / "page.md").write_text(f"before\n{begin}\nold\n<!-- end rod -->\nafter\n")
    tips = {name: np.zeros((5, 3)) for name in ("PyElastica", "SoRoMoX", "SoRoSim")}
    found = {"ours": {"ours, 20 joints that bend": np.ones((5, 3))}}
    page.write(tmp_path / "page.md", "rod", "new", tips, found)
    text = (tmp_path / "page.md").read_text()
    assert text.startswith(f"before\n{begin}\n\nnew\n\n![")
    assert text.endswith("<!-- end rod -->\nafter\n")
    assert (tmp_path / "field_rod.png").stat().st_size > 1000
    with pytest.raises(InputError, match="one block between"):
        page.write(tmp_path / "page.md", "planar", "new", tips, found)


def test_one_line_for_a_wrong_folder(capsys, tmp_path):
    from tests.proof.__main__ import main

    with left_as_it_was():
        assert main(["field", "rod", "--data", str(tmp_path)]) == 2
    assert "expected a folder with paper_results/secIVa" in capsys.readouterr().err


def test_the_newest_versions_need_an_interpreter(capsys, tmp_path):
    from tests.proof.__main__ import main

    with left_as_it_was():
        assert main(["field", "newest", "--data", str(tmp_path)]) == 2
    assert "expected an interpreter with pyelastica and soromox" in capsys.readouterr().err


def test_a_rod_with_the_newest_versions_has_ours_with_two_steps_and_theirs(monkeypatch):
    theirs = cases.CASES["planar"].in_their_frame(np.zeros((300, 3)))
    names = (published.PYELASTICA, published.SOROMOX)
    monkeypatch.setattr(published, "read", lambda *_: dict.fromkeys(names, theirs))
    monkeypatch.setattr(newest, "_pyelastica", lambda *_: ("1", theirs, 0.5))
    monkeypatch.setattr(newest, "_soromox", lambda *_: ("2", theirs + np.array([3e-3, 0, 0]), 0.6))
    monkeypatch.setattr(rods, "USUAL", 3)
    rows = newest.measure("planar", cases.CASES["planar"], SimpleNamespace(data="", runs=1))
    assert [row[1] for row in rows] == [
        "ours, 3 joints, 1 ms", "ours, 3 joints, 0.1 ms", "PyElastica 1", "SoRoMoX 2"
    ]  # fmt: skip
    assert 0 < rows[0][3] < 5
    assert rows[2][2] == 0
    assert rows[3][2] == pytest.approx(3.0)
