"""Published tips of four rollouts, of three codes: github.com/tud-phi/soromox, paper_results."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.io import loadmat

from softdyn import InputError
from tests.proof.field.cases import PERIOD, SECONDS, Case

SECTION = "secIVa_benchmarking_sequential_cpu"
PYELASTICA, SOROMOX, SOROSIM = "PyElastica", "SoRoMoX", "SoRoSim"


def section(folder: str | Path, name: str = SECTION) -> Path:
    """The folder of a section of the paper's results.

    Raises
    ------
    InputError
        It is not there.
    """
    for found in (Path(folder) / "paper_results" / name, Path(folder) / name):
        if found.is_dir():
            return found
    raise InputError(str(folder), f"a folder with paper_results/{name}", "none")


def read(folder: str | Path, case: Case) -> Mapping[str, np.ndarray]:
    """Tip (samples, 3) by code, every `PERIOD` seconds, in the others' frame (m)."""
    data = section(folder) / "data"
    stem = "end_effector_position_"
    tables = {
        PYELASTICA: _xlsx(data / f"{stem}{case.pyelastica}_pyelastica.xlsx"),
        SOROMOX: _csv(data / f"{stem}{case.soromox}_soromox.csv"),
        SOROSIM: _mat(data / f"{stem}{case.soromox}_sorosim.mat"),
    }
    t = np.arange(round(SECONDS / PERIOD)) * PERIOD  # one of the tables ends a step early
    return {
        name: np.column_stack([np.interp(t, table[:, 0], x) for x in table[:, 1:].T])
        for name, table in tables.items()
    }


def _csv(path: Path) -> np.ndarray:
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    # t, x, z of a planar robot
    return np.insert(table, 2, 0.0, axis=1) if table.shape[1] == 3 else table


def _mat(path: Path) -> np.ndarray:
    found = loadmat(path)
    return np.column_stack((found["t"].ravel(), found["Pos_EE_all"].T))


def _xlsx(path: Path) -> np.ndarray:
    """The numbers of a workbook's only sheet, whose first row has titles."""
    with zipfile.ZipFile(path) as book:
        sheet = ElementTree.fromstring(book.read("xl/worksheets/sheet1.xml"))
    space = re.match(r"\{.*\}", sheet.tag)
    name = space[0] if space else ""
    rows = [
        [cell.findtext(f"{name}v") for cell in row.iter(f"{name}c")]
        for row in sheet.iter(f"{name}row")
    ]
    return np.array(rows[1:], float)
