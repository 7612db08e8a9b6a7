"""The published rods: our chains against each other, the readers, and the blocks of a document."""

from __future__ import annotations

import zipfile
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import savemat

from tests.proof.field import cases, drag, published, rods
from tests.support.refused import refused


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
    with refused("data", "none"):
        published.read(tmp_path / "data", case)


def test_the_cables_pull_to_the_published_side():
    case = cases.CASES["rod"]
    tips, _ = rods.roll(case, rods.twin_of(case, case.arm(4, cases.BENDS, 0.03), 1e-3), 0.3)
    assert tips[-1, 0] < -1e-3
    assert tips[-1, 1] == pytest.approx(-tips[-1, 0], rel=1e-2)


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
