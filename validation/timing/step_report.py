"""Step times as tables, and the machine on which they were measured."""

from __future__ import annotations

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from softdyn.validation.tables import Table, document

ENGINES = ("pin", "proxsuite", "mujoco", "numpy", "numba")

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
THROUGHPUT = (
    ("Robot", "robot", ""),
    ("simulated s", "simulated_s", ".0f"),
    ("wall s", "wall_s", ".2f"),
    ("loops/s", "loops_per_s", ".2f"),
    ("× real time", "times_real_time", ".1f"),
    ("set-up s", "setup_s", ".3f"),
    ("state", "state_s", ".3f"),
    ("controller", "controller_s", ".3f"),
    ("MuJoCo", "mujoco_s", ".3f"),
    ("bookkeeping", "bookkeeping_s", ".3f"),
)


def machine() -> dict[str, Any]:
    """The time of the measurement and the machine, as far as the system reports them."""
    return {
        "measured": datetime.now(UTC).date().isoformat(),
        "processor": _processor(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in ENGINES},
    }


def step_tables(report: dict[str, Any]) -> dict[str, Table]:
    """The tables of a report, by heading."""
    several = "tip_ratio" in report["rows"][0]
    columns = (*STEP[:2], *TASK_ROWS) if several else STEP
    found = {"One control step": Table.of(columns, report["rows"])}
    if "throughput" in report:
        found["Closed loops"] = Table.of(THROUGHPUT, report["throughput"])
    return found


def step_text(report: dict[str, Any]) -> str:
    """Aligned tables for a terminal."""
    return "\n\n".join([*(t.text() for t in step_tables(report).values()), _machine(report)])


def step_document(report: dict[str, Any]) -> str:
    """The tables with headings."""
    parts = [f"## {title}\n\n{t.markdown()}" for title, t in step_tables(report).items()]
    return document("# Step times", _machine(report), *parts)


def _machine(report: dict[str, Any]) -> str:
    on = report["machine"]
    engines = ", ".join(f"{name} {on[name]}" for name in ENGINES)
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
