#!/usr/bin/env python3
"""Test the wheel as a new user would: in a fresh environment and folder, with a user's robots.

It builds the wheel and installs only that. Then it runs every command's help and job on an arm of
24 joints and 12 cables, in an empty folder beside a user's own ``controllers/`` and
``validation/``. --all adds finger, ur5 with an overlay, and longer jobs. The exit code is 1 if a
command fails; times are printed, but not judged.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
JOINTS, LINK = 24, 0.02
OVERLAY = ("ur5", "--annotations", "examples/soft_ur5.xml")
# robot → its options, and a point that its tip can reach
ROBOTS = {
    "arm.urdf": (("arm.urdf",), ("0.1", "0.05", "-0.42")),
    "finger": (("finger",), ("0.15", "0", "-0.15")),
    "ur5": (OVERLAY, ("0.45", "0.35", "0")),
}
# Jobs of each command; {robot} stands for a robot with its options, {target} for its point. CI runs
# them only on the arm. Exit code 1 passes, too: the command ran, but a check failed or a loop did
# not settle.
JOBS = {
    "new": (
        "--examples examples", "new.toml --out new.urdf", "new.toml --converge --segments 2 4 8"
    ),
    "attach": ("new.urdf --to arm.urdf l1 --prefix soft_ --out both.urdf",),
    "identify": ("finger finger.csv --shared stiffness --out softer.urdf --html fit.html",),
    "compile": ("",),
    "check": ("{robot} --samples 2",),
    "view": ("{robot} --html view.html",),
    "statics": ("{robot} --target {target} --rays 2 --spread 2 --shapes 1 --hold 0.1",),
    "observe": ("{robot} --sensors tip=0.001 --seconds 0.05 --plot seen.png",),
    "crosscheck": ("{robot} --samples 1",),
    "export": ("{robot} --mjcf robot.xml",),
    "compare": ("{robot} robot.xml --samples 1 --html pair.html",),
    "run": (
        "{robot} best --target {target} --duration 0.3 --no-verdict --log run.npz --html run.html",
        "finger law.py:Push --theta 0.5 --duration 0.1 --no-verdict --json -",
    ),
    "rollout": ("{robot} --seconds 0.2 --html rollout.html --plot rollout.png --log rollout.csv",),
    "play": ("{robot} --target {target} --no-open",),
    "drive": ("{robot} --serve",),
    "replay": ("run.npz --html replay.html --plot replay.png",),
    "sweep": ("sweep.toml --jobs 1 --out sweep",),
    "benchmark": (
        "--robots finger --controllers ic --thetas 0.5 --omegas --no-plots --out results",
    ),
    "step-time": (
        "{robot} mpc --seconds 0.1",
        "finger law.py:Push --theta 0.5 --seconds 0.1 --json -",
    ),
}  # fmt: skip
# further jobs with --all
LONG = {
    "run": ("{robot} best --target {target}", "{robot} mpc --target {target}"),
    "sweep": ("robustness --robots finger --out robustness --jobs 1",),
    "benchmark": ("--robots finger --controllers ic soft-id-clf-qp --out results",),
}
SERVES = ("play", "drive")  # run until they are ended
# measurements of a finger: its joints under random inputs, each held for 0.1 s
DATA = """
import csv
from types import SimpleNamespace
import numpy as np
import softdyn
from softdyn.validation import simulate
model, random = softdyn.load("finger"), np.random.default_rng(0)
held = random.uniform(0.3 * model.u_min, 0.3 * model.u_max, (20, model.nu))
steps = iter(np.repeat(held, 20, axis=0))
log = simulate(
    model, lambda state, reference: SimpleNamespace(u=next(steps)),
    softdyn.SetPoint(np.zeros(3)), duration=1.0, period=0.005,
)
with open("finger.csv", "w", newline="") as file:
    rows = csv.writer(file)
    inputs = [f"u.{joint.name}" for joint in model.robot.actuators]
    rows.writerow(["t", *inputs, *(f"q.{name}" for name in model.joint_names)])
    rows.writerows(np.column_stack([log.t[:len(log.u)], log.u, log.q[:len(log.u)]]).tolist())
"""
LAW = """from types import SimpleNamespace
import numpy as np
class Push:
    def __init__(self, model):
        self.u = 0.1 * model.u_max
    def __call__(self, state, reference):
        return SimpleNamespace(u=self.u)
"""
NEW = """name = "tube"
[material]
youngs_modulus_MPa = 0.25
density_kg_m3 = 1070
[[section]]
length_mm = 200
radius_mm = 12
[[cable]]
count = 3
offset_mm = 10
routing = "channel"
max_tension_N = 5
"""
SWEEP = """robots = ["finger", "arm.urdf"]
controllers = ["best", "mpc"]

[targets]
point = [[0.1, 0.0, -0.15]]

[run]
duration = 0.1
"""


def arm() -> str:
    """A hanging arm: hinges about y and x in turn, four rings of three cables."""
    parts = ['<robot name="arm"><link name="l0"/>']
    for k in range(1, JOINTS + 1):
        z = 0 if k == 1 else -LINK
        parts.append(
            f'<link name="l{k}"><inertial><origin xyz="0 0 {-LINK / 2}"/><mass value="0.01"/>'
            '<inertia ixx="2e-6" ixy="0" ixz="0" iyy="2e-6" iyz="0" izz="1e-6"/></inertial>'
            f'<visual><origin xyz="0 0 {-LINK / 2}"/><geometry>'
            f'<cylinder radius="0.012" length="{LINK}"/></geometry></visual></link>'
            f'<joint name="j{k}" type="revolute"><origin xyz="0 0 {z}"/><parent link="l{k - 1}"/>'
            f'<child link="l{k}"/><axis xyz="{"0 1 0" if k % 2 else "1 0 0"}"/>'
            '<limit lower="-0.5" upper="0.5" effort="1" velocity="9"/><dynamics damping="0.01"/>'
            f'</joint><gazebo reference="j{k}"><springStiffness>0.2</springStiffness></gazebo>'
        )
    parts.append(
        f'<link name="tip"/><joint name="end" type="fixed"><origin xyz="0 0 {-LINK}"/>'
        f'<parent link="l{JOINTS}"/><child link="tip"/></joint><softdyn version="1">'
    )
    for c in range(12):
        angle, last = 2 * math.pi * (c % 3) / 3, JOINTS * (c // 3 + 1) // 4
        x, y = 0.012 * math.cos(angle), 0.012 * math.sin(angle)
        sites = "".join(
            f'<site link="l{k}" xyz="{x:.6f} {y:.6f} {0 if k == 0 else -LINK / 2}"/>'
            for k in range(last + 1)
        )
        parts.append(f'<tendon name="c{c}">{sites}</tendon>')
    parts += [f'<actuator name="u{c}" tendon="c{c}" gear="-1" lower="0" upper="30"/>'
              for c in range(12)]  # fmt: skip
    return "".join([*parts, '<task frame="tip"/></softdyn></robot>'])


def main() -> int:
    """Build, install, run; the number of failures decides the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="every job on every robot")
    parser.add_argument("--env", type=Path, help="an environment that has the wheel already")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        env = arguments.env.absolute() if arguments.env else install(folder)
        size = sum(f.lstat().st_size for f in env.rglob("*") if f.is_file())
        print(f"the environment takes {size / 1e6:.0f} MB")
        return check(env, project(folder / "project"), arguments.all)


def install(folder: Path) -> Path:
    """A fresh environment with the wheel and its dependencies."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    wheel_of = [*pip, "wheel", "--no-deps", "--wheel-dir", folder, ROOT]
    subprocess.run(wheel_of, check=True, env=clean)
    (wheel,) = folder.glob("softdyn-*.whl")
    (ROOT / "dist").mkdir(exist_ok=True)
    shutil.copy(wheel, ROOT / "dist")  # README.md installs it from there
    venv.create(folder / "env", with_pip=True)
    python = folder / "env" / "bin" / "python"
    subprocess.run([python, *pip[1:], "install", wheel], check=True, env=clean)
    return folder / "env"


def project(folder: Path) -> Path:
    """A user's folder with packages that have the names of ours."""
    for name in ("controllers", "validation", "urdf"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text("raise RuntimeError('not yours')\n")
    (folder / "arm.urdf").write_text(arm())
    (folder / "sweep.toml").write_text(SWEEP)
    (folder / "new.toml").write_text(NEW)
    (folder / "law.py").write_text(LAW)
    return folder


class Wheel:
    """The installed wheel, its environment and the user's folder; counts the failures."""

    def __init__(self, env: Path, folder: Path) -> None:
        self.softdyn, self.folder = env / "bin" / "softdyn", folder
        path = f"{env / 'bin'}{os.pathsep}{os.environ['PATH']}"
        clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        self.environment, self.failures = clean | {"PATH": path}, list[list[str]]()

    def run(self, words: list[str], allowed: tuple[int, ...] = (0, 1)) -> str:
        """Run one command to its end; print a line with the result."""
        began = time.perf_counter()
        process = subprocess.Popen(
            [self.softdyn, *words], cwd=self.folder, env=self.environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        if words[0] in SERVES and "--help" not in words:
            assert process.stdout is not None
            process.stdout.readline()  # it prints its address, so it serves
            process.send_signal(signal.SIGTERM)
        out, err = process.communicate()
        fine = process.returncode in allowed and "Traceback" not in err
        took = time.perf_counter() - began
        print(f"{'ok  ' if fine else 'FAIL'} {took:6.1f} s  {' '.join(words)}", flush=True)
        if not fine:
            self.failures.append(words)
            print(f"     exit code {process.returncode}: {err[-2000:]}")
        return out


def check(env: Path, folder: Path, everything: bool) -> int:
    """Run every command's help, then its jobs; print a line each."""
    wheel = Wheel(env, folder)
    names = re.findall(r"(?m)^  (\S+) ", wheel.run(["--help"], (0,)))
    if set(names) != set(JOBS):
        wheel.failures.append(["commands without a job, or jobs without a command"])
        print(f"FAIL jobs of {sorted(set(names) ^ set(JOBS))}")
    for name in names:
        wheel.run([name, "--help"], (0,))
    code = [env / "bin" / "python", "-c", DATA]
    subprocess.run(code, check=True, cwd=folder, env=wheel.environment)
    robots = ROBOTS if everything else {"arm.urdf": ROBOTS["arm.urdf"]}
    for name, jobs in JOBS.items():
        for job in (*jobs, *(LONG.get(name, ()) if everything else ())):
            for options, target in robots.values() if "{robot}" in job else [((), ())]:
                alone = name == "compare"  # it takes no overlay
                marks = {"{robot}": options[:1] if alone else options, "{target}": target}
                words = [x for word in job.split() for x in marks.get(word, (word,))]
                if alone:  # with the MJCF of the same robot
                    wheel.run(["export", *options, "--mjcf", "robot.xml"], (0,))
                wheel.run([name, *words])
    print(f"{len(names)} commands, {len(wheel.failures)} failures")
    return 1 if wheel.failures else 0


if __name__ == "__main__":
    sys.exit(main())
