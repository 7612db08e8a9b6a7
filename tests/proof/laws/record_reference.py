"""Record the reference implementation at every control step, in a separate environment.

It imports nothing of softdyn, because the reference's logs were made with MuJoCo 3.2.7 or older,
which softdyn does not support. With mujoco==3.2.7, cvxpy, scs==3.2.11 and pandas installed:

    python record_reference.py CHECKOUT FOLDER CELL …        e.g. helix_uic_omega0.5

CHECKOUT is https://github.com/CyPhiLab/tendon_clf at the commit to be recorded. Each cell becomes
FOLDER/CELL.npz for `reproduce.py --records`: q and v before each step, ctrl, and the target in the
reference's own world. A name that ends with _nudgeN starts with normally distributed velocities of
1e-9 (rad/s, m/s) from seed N. FOLDER/CELL.json has the engine, the run's figure (cm or cm²), that
of the checkout's own log, and the distance of their inputs.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import sys
import types
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

ROBOTS = {"finger": "tendon", "helix": "helix", "spirob48": "spirob"}
LAWS = {
    "clf-qp": "clf_qp", "soft-id-clf-qp": "id_clf_qp", "ic": "impedance", "uic": "uosc",
    "ic-qp": "impedance_QP",
}  # fmt: skip
NAMES = ("q", "v", "ctrl", "target")


def record(
    utils: Any, robot: str, law: str, target: str, nudge: int | None = None
) -> tuple[dict[str, Any], Any]:
    """Arrays by name with a row per step, and the run's log by the reference."""
    kept: dict[str, list[np.ndarray]] = {name: [] for name in NAMES}
    start, step = utils.Robot.initialize_simulation_state, utils.Robot.step_simulation

    def nudged(self: Any) -> None:
        start(self)
        if nudge is not None:
            draw = np.random.default_rng(nudge).standard_normal(self.data.qvel.size)
            self.data.qvel[:] += 1e-9 * draw

    def recorded(self: Any) -> None:
        data = self.data
        for name, value in zip(
            NAMES, (data.qpos, data.qvel, data.ctrl, data.mocap_pos[0]), strict=True
        ):
            kept[name].append(np.array(value))
        step(self)

    utils.Robot.initialize_simulation_state, utils.Robot.step_simulation = nudged, recorded
    case = {"omega": target} if target.startswith("omg") else {"target_pos": target}
    kind = "tracking" if target.startswith("omg") else "set"
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            run = utils.simulate_model(
                headless=True, control_scheme=law, model_name=robot, experiment=kind, **case
            )
    finally:
        utils.Robot.initialize_simulation_state, utils.Robot.step_simulation = start, step
    return {name: np.array(rows) for name, rows in kept.items()}, run


def read_log(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Errors (m) and inputs of a committed log; empty if it is missing."""
    if not path.is_file():
        return np.zeros(0), np.zeros((0, 0))
    lines = [line for line in path.read_text().splitlines() if line and line[0] != "#"]
    rows = list(csv.DictReader(lines))
    inputs = [name for name in rows[0] if name[0] == "u" and name[1:].isdigit()]
    errors = np.array([float(row["task_error"]) for row in rows])
    return errors, np.array([[float(row[name]) for name in inputs] for row in rows])


def figure(errors: np.ndarray, target: str) -> float:
    """The last error (cm), or the mean of its squares (cm²), of errors in m."""
    return float(np.mean((100 * errors) ** 2) if target.startswith("omg") else 100 * errors[-1])


def main(checkout: Path, folder: Path, cells: list[str]) -> None:
    """Record each cell."""
    viewer = types.ModuleType("mujoco.viewer")  # never opened, because it would need a display
    sys.modules["mujoco.viewer"] = mujoco.viewer = viewer
    sys.path.insert(0, str(checkout))
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.chdir(checkout):
        import utils  # type: ignore[import-not-found]  # the reference's

        for cell in cells:
            robot, law, case, *nudge = cell.split("_")
            value = float(case[5:])
            target = f"omg{value * 10:g}" if case[:5] == "omega" else f"pos{value * 2 + 1:g}"
            kind = "tracking" if case[:5] == "omega" else "set"
            name, law = ROBOTS[robot], LAWS[law]
            arrays, run = record(
                utils, name, law, target, *(int(each.removeprefix("nudge")) for each in nudge)
            )
            np.savez_compressed(folder / f"{cell}.npz", **arrays)
            errors, inputs = read_log(
                checkout / "results" / name / law / f"{kind}_{law}_{target}.csv"
            )
            rows = min(len(inputs), len(run["u"]))
            said = {
                "cell": cell,
                "mujoco": mujoco.__version__,
                "figure": figure(run["task_error"], target),
                "log": figure(errors, target) if rows else None,
                "apart": float(np.abs(inputs[:rows] - run["u"][:rows]).max()) if rows else None,
            }
            (folder / f"{cell}.json").write_text(json.dumps(said))
            print(said, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve(), sys.argv[3:])
