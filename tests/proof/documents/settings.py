"""Tables of the documents that repeat settings of the code: gains, and the paper's changes."""

from __future__ import annotations

from pathlib import Path

from softdyn.controllers.registry import CONTROLLERS, label_of
from softdyn.validation.tables import Table
from tests.proof.paper.reproduction import CHANGES, ROBOTS

MEASURED = Path(__file__).parent / "measured"
"""The committed figures of the documents, apart from those of the paper's table."""
# controller → the gains that it uses
USED = {
    "clf-qp": ("Kp", "eps", "w1", "rho"),
    "soft-id-clf-qp": ("Kp", "eps", "w1", "w2", "w3", "w4", "rho"),
    "ic": ("Kp",),
    "uic": ("Kp",),
    "ic-qp": ("Kp", "eps", "w1", "w2", "w3", "w4"),
}
NAMES = ("Kp", "eps", "w1", "w2", "w3", "w4", "rho")


def changes_table() -> str:
    """The experiments of `python -m tests.proof reproduce`."""
    rows = CHANGES.items()
    lines = [[f"`{name}`", c.what, c.source or "none: a change of ours"] for name, c in rows]
    return Table(["experiment", "what changes", "source"], lines).markdown()


def gains_table() -> str:
    """The published gains that each controller uses."""
    lines = []
    for robot in ROBOTS:
        for controller, used in USED.items():
            gains = CONTROLLERS[controller].published[robot]
            values = [getattr(gains, name) if name in used else None for name in NAMES]
            lines.append([robot, label_of(controller), *values])
    formats = ["", "", *["g"] * len(NAMES)]
    return Table(["robot", "controller", *NAMES], lines, formats).markdown()
