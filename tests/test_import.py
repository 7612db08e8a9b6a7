"""Modules that `import softdyn` and `softdyn.load` import at once or at their first use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import softdyn

HEAVY = (
    "mujoco", "matplotlib", "meshcat", "tornado", "proxsuite", "trimesh", "yourdfpy",
    "scipy.optimize",
)  # fmt: skip


def loaded(statements: str) -> set[str]:
    """The modules of a fresh interpreter after `statements`."""
    program = f"{statements}\nimport sys; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    return set(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())


@pytest.mark.parametrize("statement", ["", "softdyn.State, softdyn.parse, softdyn.build"])
def test_the_package_needs_no_judge_no_plots_and_no_server(statement):
    modules = loaded(f"import softdyn\n{statement}")
    assert modules.isdisjoint(HEAVY)
    assert ("pinocchio" in modules) == bool(statement)  # `--help` answers without an engine


def test_a_model_needs_neither_scipy_spatial_nor_the_judge():
    modules = loaded("import softdyn\nmodel = softdyn.load('finger')\nmodel.state(model.q0, [0]*4)")
    assert modules.isdisjoint((*HEAVY, "scipy.spatial"))


def test_live_pages_need_no_judge_and_their_server_no_engine():
    room = "softdyn.view.live"
    folder = Path(softdyn.__file__).parent / "view" / "live"
    every = ", ".join(f"{room}.{path.stem}" for path in folder.glob("[a-z]*.py"))
    modules = loaded(f"import {room}, {every}")
    assert f"{room}.explorer" in modules
    assert modules.isdisjoint(("mujoco", "softdyn.validation"))
    assert loaded(f"import {room}.server").isdisjoint(("pinocchio", "numba", "scipy"))


def test_a_closed_loop_needs_no_mjcf_reader_and_no_figures():
    modules = loaded("import softdyn.validation.loop.closed_loop")
    rooms = {name.split(".")[2] for name in modules if name.startswith("softdyn.validation.")}
    assert rooms.isdisjoint({"mjcf", "report", "studies", "live"})


def test_a_sweep_and_its_figure_need_no_statistics_of_scipy():
    """Their import takes a tenth of the time of a sweep of short cases."""
    modules = loaded(
        "from softdyn.validation.studies import sweep_file, sweep_report\n"
        "from softdyn.validation.report import sweep_figure"
    )
    assert "matplotlib" in modules
    assert "scipy.stats" not in modules


@pytest.mark.parametrize("statements", [
    "from softdyn.controllers import SoftIdClfQp\nlaw = SoftIdClfQp(model)\n"
    "law(model.state(model.q0, [0] * 4), softdyn.SetPoint([0.1, 0, -0.1]))",
    "from softdyn.controllers.registry import make_controller\nmake_controller('best', model)",
    "softdyn.statics.rest(model)",
])  # fmt: skip
def test_a_control_step_needs_no_optimiser_of_scipy(statements):
    """Its import would take longer than the rest of a controller's start."""
    modules = loaded(f"import softdyn\nmodel = softdyn.load('finger')\n{statements}")
    assert modules.isdisjoint(("mujoco", "scipy.optimize", "scipy.stats"))
