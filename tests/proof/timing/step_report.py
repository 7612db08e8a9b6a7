"""Step times as tables, and the machine on which they were measured."""

from __future__ import annotations

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from softdyn.validation.tables import Table, document

ENGINES = ("pin", "proxsuite", "daqp", "mujoco", "numpy", "numba")

STEP = (  # title, key, format
    ("Robot", "robot", ""),
    ("Controller", "controller", ""),
    ("median µs", "median_us", ".1f"),
    ("p99", "p99_us", ".0f"),
    ("p99.9", "p999_us", ".0f"),
    ("dynamics", "dynamics_us", ".1f"),
    ("assembly", "assembly_us", ".1f"),
    ("solve", "solve_us", ".1f"),
    ("floor", "floor_us", ".1f"),
    ("× floor", "floor_ratio", ".2f"),
    ("paper's stack µs", "stack_us", ".0f"),
    ("ratio", "ratio", ".0f"),
    ("as a QP", "ratio_quadratic", ".0f"),
)
TASK_ROWS = (("task rows", "task_rows", ""), *STEP[2:10], ("× 3 rows", "tip_ratio", ".2f"))


def machine() -> dict[str, Any]:
    """The time of the measurement and the machine, as far as the system reports them."""
    return {
        "measured": datetime.now(UTC).date().isoformat(),
        "processor": _processor(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in ENGINES},
    }


def step_table(rows: list[dict[str, Any]]) -> Table:
    """The table of `step_time.rows_of`."""
    several = "tip_ratio" in rows[0]
    return Table.of((*STEP[:2], *TASK_ROWS) if several else STEP, rows)


def step_text(report: dict[str, Any]) -> str:
    """The report for a terminal."""
    return f"{step_table(report['rows']).text()}\n\n{machine_text(report['machine'])}"


def step_document(report: dict[str, Any]) -> str:
    """The report as a document."""
    table = f"## One control step\n\n{step_table(report['rows']).markdown()}"
    return document("# Step times", machine_text(report["machine"]), table)


def machine_text(on: dict[str, Any]) -> str:
    """`machine` and the load during the measurement, as a sentence."""
    engines = ", ".join(f"{name} {on[name]}" for name in ENGINES if name in on)  # old records
    return (
        f"{on['measured']}, {on['processor']} ({on['cores']} cores), Python {on['python']}, "
        f"{engines}; load {on['load_before']:.1f} to {on['load_after']:.1f}, "
        f"{100 * on['cpu_share']:.0f} % of a core was ours."
    )


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "an unknown processor"
