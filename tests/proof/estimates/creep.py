"""Controllers and springs that creep, or have hysteresis: docs/creep.md."""

from __future__ import annotations

from typing import Any

from softdyn.commands import cli

EPILOG = """\
The springs of the plant are plain, creep (a share of 20 % of the instantaneous stiffness relaxes in
1.5 s) or have hysteresis (10 % of the largest torque of one input). Each run holds one target, an
equilibrium of the plain robot, for a minute; runs with plain springs last 5 s. The controllers see
the state, or with an observer its estimate from the lengths of the paths (0.5 mm of noise at 1 kHz)
and a camera (1 mm at 60 Hz, 30 ms late). The arm of three sections and the chamber arm are those of
docs/examples, with the gains of `softdyn check --gains` for `soft-id-clf-qp`. Each row goes to
tests/proof/documents/measured/creep.json as soon as it is there; then `python -m tests.proof
tables` writes the table.

exit codes: 0 done; 2 bad input.
"""
ROBOTS, ARMS = ("finger", "three_sections", "chamber_arm"), ("three_sections", "chamber_arm")
PLANTS = ("plain", "creep", "hysteresis")
WAYS = LAW, SEES, BLIND, KNOWS = (
    "soft-id-clf-qp", "best", "best, observer", "best, observer of branches",
)  # fmt: skip
SHARE, TIME, HYSTERESIS = 0.2, 1.5, 0.1
EARLY, LONG, AVERAGED = 5.0, 60.0, 0.5  # s
PERIOD, THETA = 0.01, 0.5  # s, of the arms; of the finger's set point (π)
SENSORS = "lengths=0.0005@1000,tip=0.001@60+0.03"
COLUMNS = (
    ("robot", "robot", ""),
    ("springs", "plant", ""),
    ("controller", "controller", ""),
    ("error after 5 s (mm)", "early_mm", ".2f"),
    ("after 60 s (mm)", "late_mm", ".2f"),
    ("farthest from its place at 5 s (mm)", "drift_mm", ".2f"),
)

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robots", nargs="*", metavar="ROBOT", help=f"default: {', '.join(ROBOTS)}")
parser.add_argument("--plants", nargs="+", default=PLANTS, metavar="SPRINGS")
parser.add_argument("--ways", nargs="+", type=cli.count, metavar="N", help="controllers, from 1")


def command(arguments: cli.Arguments) -> int:
    """Run all cases; the row of each is written when it is done."""
    from softdyn import InputError
    from tests.proof.documents.measured_rows import replace_rows
    from tests.proof.documents.settings import MEASURED

    order = [f"{r}, {p}, {w}" for r in ROBOTS for p in PLANTS for w in WAYS]
    for words, known in ((arguments.robots, ROBOTS), (arguments.plants, PLANTS)):
        for word in words:
            if word not in known:
                raise InputError("ROBOT or SPRINGS", " or ".join(known), word)
    ways = [WAYS[k - 1] for k in arguments.ways or range(1, len(WAYS) + 1)]
    for plant in arguments.plants:
        for robot in arguments.robots or ROBOTS:
            for way in ways:
                if way == KNOWS and plant != "creep":  # these springs have no branches
                    continue
                row = {"case": f"{robot}, {plant}, {way}", "robot": robot, "plant": plant,
                       "controller": way} | run(robot, plant, way)  # fmt: skip
                replace_rows(MEASURED / "creep.json", "case", [row["case"]], [row], order)
                print(row, flush=True)
    return cli.PASSED


def load(robot: str, *, creeps: bool) -> Any:
    """The robot's model; with `creeps` each spring has a branch, and the relaxed one stays."""
    from dataclasses import replace
    from pathlib import Path

    import softdyn
    from softdyn import design
    from softdyn.description.urdf import parse_text
    from softdyn.dynamics.mimic import build
    from softdyn.files import read_toml
    from tests.support import ROOT

    if robot in ARMS:
        arm = design.make_arm(read_toml(ROOT / "docs" / "examples" / f"{robot}.toml"))
        model = build(parse_text(design.urdf(arm), path=Path(f"{robot}.urdf")))
    else:
        model = softdyn.load(robot)
    if not creeps:
        return model
    branch = SHARE / (1 - SHARE)
    joints = tuple(
        replace(one, relaxation=((branch * one.stiffness, TIME),) if one.stiffness else ())
        for one in model.robot.joints
    )
    return build(replace(model.robot, joints=joints), model.bundled)


def run(robot: str, plant: str, way: str) -> dict[str, float | None]:
    """The errors (mm) of one run after 5 s and 60 s, and its drift (mm).

    The drift is the largest distance of the tip, between 5 s and 60 s, from its mean place before
    5 s. With an observer it includes what noise of the sensors moves.
    """
    import numpy as np

    from softdyn import SetPoint, statics
    from softdyn.commands.observe import sensors_of
    from softdyn.controllers import SoftIdClfQp, best
    from softdyn.controllers.proposed_gains import propose
    from softdyn.validation import PlantErrors, Rig, paper, simulate

    model = load(robot, creeps=plant == "creep")
    if robot in ARMS:
        goal: Any = SetPoint(statics.spread_rests(model, 1)[0].y)
        period, gains = PERIOD, None if way != LAW else propose(model, PERIOD).gains
    else:
        goal, period, gains = paper.set_point(robot, theta=THETA), None, None
    errors = PlantErrors(hysteresis=HYSTERESIS if plant == "hysteresis" else 0.0)
    sensors = sensors_of(model, SENSORS)
    law = SoftIdClfQp(model, gains) if way == LAW else best(model)
    names = ("relaxation",) if way == KNOWS else ()
    options: dict[str, Any] = {"rig": Rig(sensors=sensors, seed=0, plant=errors)}
    if way in (BLIND, KNOWS):
        options["observer"] = ",".join(names)
    if period is not None:
        options["period"] = period
    seconds = EARLY if plant == "plain" else LONG
    log = simulate(model, law, goal, duration=seconds, **options)

    def mean(end: float) -> Any:
        return log.y[(log.t > end - AVERAGED) & (log.t <= end + 1e-9)].mean(0)

    target, after = log.y_ref[-1], log.y[log.t >= EARLY]
    found: dict[str, float | None] = dict.fromkeys(("early_mm", "late_mm", "drift_mm"))
    found["early_mm"] = 1e3 * float(np.linalg.norm(mean(EARLY) - target))
    if seconds == LONG and log.t[-1] > LONG - 1:
        found["late_mm"] = 1e3 * float(np.linalg.norm(mean(LONG) - target))
        found["drift_mm"] = 1e3 * float(np.linalg.norm(after - mean(EARLY), axis=1).max())
    return found


main = cli.program(parser, command, __name__)
