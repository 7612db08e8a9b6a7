"""Helpers that tests share, by what they hold.

Robots: `robots` (small ones and their pieces), `named_models` (by a name, for tests over many),
`random_robots`, `wrapped_robots`, `cable_chains`, `long_chains`, `pair_robots` (a URDF and an MJCF
of one robot), `arms` (of tables), `cart` (closed forms), `rigs`, `bench`, `control_cases`.

Oracles: `oracles` (differences), `step_differences`, `wrap_errors`, `creep_decays`,
`neutral_terms`, `paper_qps`, `qp_solvers`, `exact_qps`, `predictive_cost`.

Faults: `misuses` (of the format), `defects`, `mjcf_features`, `turned_frames`, `hostile_states`,
`rig_processes`, `dying_worker`, `public_reports`.

Commands, files, pages: `command`, `browser`, `logs`, `newest_log`, `sweeps`, `dynamixel_bus`,
`public_objects`, `promised_names`, `rig_tables`.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = ROOT / "scripts"
CORPUS = ROOT / "tests" / "corpus"
PATIENCE = 900.0  # s until a wait counts as endless, however busy the machine is
