#!/usr/bin/env python3
"""The wheel as a new user meets it: a fresh environment, a folder with names of ours, own robots.

Builds the wheel, installs it alone, and in an empty folder beside own ``controllers/`` and
``validation/`` asks every command for its help and lets it do its job: on finger, on ur5 with an
overlay, and on an arm of 24 joints and 12 cables. --all does every job, otherwise those that fit
into CI. Ends with 1 where one fails; times are told, never judged.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
JOINTS, LINK = 24, 0.02
OVERLAY = ("ur5", "--annotations", "examples/soft_ur5.xml")
# a robot's options, and a point that its tip can reach
ROBOTS = {
    "arm.urdf": (("arm.urdf",), ("0.1", "0.05", "-0.42")),
    "finger": (("finger",), ("0.15", "0", "-0.15")),
    "ur5": (OVERLAY, ("0.45", "0.35", "0")),
}
# what CI does; {robot} stands for a robot with its options, {target} for its point
SHORT = (
    "check {robot} --samples 2",
    "view {robot} --html view.html",
    "run {robot} best --target {target} --duration 0.3 --no-verdict --log run.npz --html run.html",
    "replay run.npz --html replay.html --plot replay.png",
)
LONG = (
    "crosscheck {robot} --samples 1",
    "statics {robot} --target {target} --rays 2 --spread 2 --shapes 1 --hold 0.1",
    "export {robot} --mjcf robot.xml",
    "run {robot} best --target {target}",
    "run {robot} mpc --target {target}",
)
ONCE = (
    "compile",
    "compare arm.urdf robot.xml --samples 1",
    "sweep sweep.toml --jobs 1 --out sweep",
    "benchmark --robots finger --controllers ic --thetas 0.5 --omegas --no-plots --out results",
    "step-time --robots arm.urdf finger --controllers best --states 8 --rounds 1 --no-stack",
    "obstacle finger --runs 1 --duration 0.2",
    "robustness --robots finger --out robustness --jobs 1",
    "worst-step --robots finger --controllers best --repeats 2",
    "new new.toml --out new.urdf",
    "reproduce --list",
    "make-robots --check",
)
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

[plant]
duration = 0.1
"""


def arm() -> str:
    """An arm that hangs down: hinges about y and x in turn, four rings of three cables."""
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
    """Build, install, ask, run; the number of failures decides."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="every job on every robot")
    parser.add_argument("--env", type=Path, help="an environment that has the wheel already")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        env = arguments.env.absolute() if arguments.env else install(folder)
        size = sum(f.lstat().st_size for f in env.rglob("*") if f.is_file())
        print(f"the environment takes {size / 1e6:.0f} MB")
        return check(env / "bin" / "softdyn", project(folder / "project"), arguments.all)


def install(folder: Path) -> Path:
    """A fresh environment with the wheel and what it asks for."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    wheel_of = [*pip, "wheel", "--no-deps", "--wheel-dir", folder, ROOT]
    subprocess.run(wheel_of, check=True, env=clean)
    (wheel,) = folder.glob("softdyn-*.whl")
    venv.create(folder / "env", with_pip=True)
    python = folder / "env" / "bin" / "python"
    subprocess.run([python, *pip[1:], "install", wheel], check=True, env=clean)
    return folder / "env"


def project(folder: Path) -> Path:
    """A user's folder, whose own packages have names of ours."""
    for name in ("controllers", "validation", "urdf"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text("raise RuntimeError('not yours')\n")
    (folder / "arm.urdf").write_text(arm())
    (folder / "sweep.toml").write_text(SWEEP)
    (folder / "new.toml").write_text(NEW)
    return folder


def check(softdyn: Path, folder: Path, everything: bool) -> int:
    """Every command's help, then the jobs; a line each."""
    path = f"{softdyn.parent}{os.pathsep}{os.environ['PATH']}"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"PATH": path}
    failures = []

    def run(words: list[str], allowed: tuple[int, ...]) -> str:
        began = time.perf_counter()
        done = subprocess.run(
            [softdyn, *words], cwd=folder, env=environment, capture_output=True, text=True
        )
        fine = done.returncode in allowed and "Traceback" not in done.stderr
        took = time.perf_counter() - began
        print(f"{'ok  ' if fine else 'FAIL'} {took:6.1f} s  {' '.join(words)}", flush=True)
        if not fine:
            failures.append(words)
            print(f"     exit code {done.returncode}: {done.stderr[-2000:]}")
        return done.stdout

    names = re.findall(r"(?m)^  (\S+) ", run([], (0,)))
    for name in names:
        run([name, "--help"], (0,))
    run(["examples", "examples"], (0,))
    robots = ROBOTS if everything else {"arm.urdf": ROBOTS["arm.urdf"]}
    for options, target in robots.values():
        for job in (*SHORT, *(LONG if everything else ())):
            marks = {"{robot}": options, "{target}": target}
            run([x for word in job.split() for x in marks.get(word, (word,))], (0, 1))
    for job in ONCE if everything else ():
        if job.startswith("compare"):
            run(["export", "arm.urdf", "--mjcf", "robot.xml"], (0,))
        run(job.split(), (0, 1))
    missing = subprocess.run([softdyn, "tune", "finger"], cwd=folder, env=environment,
                             capture_output=True, text=True)  # fmt: skip
    if missing.returncode != 2 or "softdyn[tune]" not in missing.stderr:
        failures.append(["tune without its extra"])
        print(f"FAIL tune without its extra says {missing.stderr!r}")
    print(f"{len(names)} commands, {len(failures)} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
