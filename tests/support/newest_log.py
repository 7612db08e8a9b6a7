"""A log in today's format, as tests/formats keeps one of each.

`python -m tests.support.newest_log` writes it: after a change of the format, beside the older ones.
"""

from __future__ import annotations

from pathlib import Path

import softdyn
from softdyn.validation import Log, simulate
from softdyn.validation.loop.log_checks import FORMAT
from tests.support import ROOT
from tests.support.cart import TARGET, steer

FOLDER = ROOT / "tests" / "formats"


def run() -> Log:
    """Four steps of the cart."""
    model = softdyn.load(FOLDER / "block_1.urdf")
    return simulate(model, steer, TARGET, duration=0.04, period=0.01)


def write(folder: Path) -> None:
    """Write the log as NPZ and as CSV."""
    name = f"log_{FORMAT.rpartition('-')[2]}"
    log = run()
    # neither this machine's processor nor its packages, so that equal code writes an equal file
    record = {**log.record, "processor": "any", "git": None}
    log = log.altered(record=record, versions={"softdyn": softdyn.__version__})
    log.save(folder / f"{name}.npz")
    log.to_csv(folder / f"{name}.csv")


if __name__ == "__main__":
    write(FOLDER)
