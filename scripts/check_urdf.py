#!/usr/bin/env python3
"""What a robot's file amounts to, and what in it looks wrong."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn import SoftModel
    from softdyn.statics.diagnosis import Pose

EPILOG = """\
ROBOT is a path to an annotated URDF, a bundled name (finger, helix, spirob, spirob48), or the name
of a robot of example-robot-data.

Explains joints, springs, tendons and inputs; how many directions the inputs move and at which poses
fewer; whether stiffness dominates gravity in the directions that no input moves (the paper's
sufficient condition for stable zero dynamics) and at which pose it ceases to; and numbers that are
legal but look wrong. Poses: q = 0, all joints at either limit, and --samples random ones.

exit codes: 0 the file is sound, whatever it amounts to; 1 some numbers look wrong; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument(
    "--samples", type=cli.count, default=100, metavar="N", help="random poses (default: 100)"
)
cli.add_robot_options(parser)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Load, examine, report."""
    import warnings

    from softdyn import InputError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they are in the report
        model = cli.load_robot(arguments)
    if arguments.floating or model.robot.followers:
        what = "a floating base" if arguments.floating else "mimic joints"
        raise InputError("robot", "a fixed base and independent joints", what)
    report = examine(model, arguments.samples)
    cli.write_report(report, arguments.json, summary(report))
    return cli.FAILED if report["doubts"] else cli.PASSED


def examine(model: SoftModel, samples: int) -> dict[str, Any]:
    """Everything the command says, as plain data."""
    from softdyn.statics import diagnosis

    robot = model.robot
    seen = list(diagnosis.poses(model, samples, seed=0))
    rest, rank = seen[0], max(pose.rank for pose in seen)
    weak = min(seen, key=lambda pose: pose.least)
    fails = [pose for pose in seen if not pose.dominates]
    limit = diagnosis.ceases(model, weak)
    outsize, unreadable = diagnosis.shape_doubts(robot)
    return {
        "robot": model.name,
        "file": str(robot.path),
        "links": len(robot.links),
        "nv": model.nv,
        "nu": model.nu,
        "task": robot.task,
        "length_m": robot.length,
        "mass_kg": sum(link.inertia.mass for link in robot.links),
        "joints": [
            {
                "name": joint.name,
                "kind": joint.kind,
                "lower": joint.lower,
                "upper": joint.upper,
                "stiffness": joint.stiffness,
                "rest": joint.rest,
                "damping": joint.damping,
                "armature": joint.armature,
            }
            for joint in robot.moving_joints
        ],
        "tendons": [
            {
                "name": tendon.name,
                "kind": "spatial" if tendon.sites else "fixed",
                "over": [s.link for s in tendon.sites] or [t.joint for t in tendon.terms],
                "length": float(length),
                "stiffness": tendon.stiffness,
                "actuators": [a.name for a in robot.actuators if a.tendon == tendon.name],
            }
            for tendon, length in zip(robot.tendons, model.tendon_lengths(model.q0), strict=True)
        ],
        "inputs": [
            {"name": a.name, "tendon": a.tendon, "gear": a.gear, "lower": a.lower, "upper": a.upper}
            for a in robot.actuators
        ],
        "poses": len(seen),
        "rank_at_rest": rest.rank,
        "rank": rank,
        "rank_drops_at": [place(model, pose) for pose in seen if pose.rank < rank],
        "unactuated": model.nv - rank,
        "softest_unactuated": direction(model, rest),
        "stiffness_at_rest": rest.least,
        "gravity_at_rest": rest.gravity.max() if len(rest.gravity) else None,
        "dominates_at_rest": rest.dominates,
        "poses_where_gravity_wins": len(fails),
        "weakest": place(model, weak) | {"stiffness": weak.least},
        "ceases": None
        if limit is None
        else {
            "towards": limit.towards,
            "share": limit.share,
            "coordinates": dict(zip(model.joint_names, limit.coordinates.tolist(), strict=True)),
        },
        "warnings": [*robot.warnings, *unreadable],
        "doubts": [*diagnosis.doubts(robot), *outsize],
    }


def place(model: SoftModel, pose: Pose) -> dict[str, Any]:
    """A pose as plain data."""
    coordinates = dict(zip(model.joint_names, pose.coordinates.tolist(), strict=True))
    return {"pose": pose.name, "rank": pose.rank, "coordinates": coordinates}


def direction(model: SoftModel, pose: Pose) -> dict[str, float]:
    """The unactuated direction of least stiffness: the joints with a share of it."""
    pairs = zip(model.joint_names, pose.softest.tolist(), strict=True)
    return {name: share for name, share in pairs if abs(share) > 0.05}


def summary(report: dict[str, Any]) -> str:
    """The same for people."""
    return "\n".join(
        [
            f"{report['robot']}: {report['links']} links, {report['nv']} degrees of freedom, "
            f"{report['nu']} inputs, {report['mass_kg']:.4g} kg, "
            f"{report['length_m']:.4g} m from base to tip {report['task']!r}",
            *_joints(report),
            *_tendons(report),
            *_actuation(report),
            *_stability(report),
            *(f"warning: {text}" for text in report["warnings"]),
            "",
            *(f"doubtful: {text}" for text in report["doubts"]),
            f"looks wrong in {len(report['doubts'])} ways"
            if report["doubts"]
            else "nothing looks wrong",
        ]
    )


def _joints(report: dict[str, Any]) -> list[str]:
    joints = report["joints"]
    kinds = Counter(joint["kind"] for joint in joints)
    lines = ["", "joints: " + ", ".join(f"{n} {kind}" for kind, n in kinds.items())]
    sprung = [joint for joint in joints if joint["stiffness"] > 0]
    lines.append(f"  {len(sprung)} with a spring{_range([j['stiffness'] for j in sprung])}")
    damped = [joint["damping"] for joint in joints if joint["damping"] > 0]
    lines.append(f"  {len(damped)} with a damper{_range(damped)}")
    if len(joints) <= 12:
        for j in joints:
            lines.append(
                f"  {j['name']:<22} {j['kind']:<11}[{j['lower']:.4g}, {j['upper']:.4g}]  "
                f"stiffness {j['stiffness']:g} at {j['rest']:g}, damping {j['damping']:g}"
            )
    return lines


def _range(values: list[float]) -> str:
    if not values:
        return ""
    low, high = min(values), max(values)
    return f": {low:g}" if low == high else f": {low:g} to {high:g}"


def _tendons(report: dict[str, Any]) -> list[str]:
    lines = ["", f"tendons: {len(report['tendons'])}"]
    for t in report["tendons"]:
        over = t["over"] if len(t["over"]) <= 4 else [*t["over"][:2], "…", t["over"][-1]]
        pulled = ", ".join(t["actuators"]) or "no input"
        spring = f", elastic {t['stiffness']:g}" if t["stiffness"] else ""
        lines.append(
            f"  {t['name']:<16}{t['kind']:<8} over {', '.join(over)}: "
            f"length {t['length']:.4g}{spring}; {pulled}"
        )
    return lines


def _actuation(report: dict[str, Any]) -> list[str]:
    lines = [
        "",
        f"actuation: {report['nu']} inputs move {report['rank']} of {report['nv']} directions, "
        f"springs and gravity have the other {report['unactuated']}",
    ]
    drops = report["rank_drops_at"]
    if drops:
        names = ", ".join(f"{drop['pose']} (rank {drop['rank']})" for drop in drops[:3])
        lines.append(f"  fewer at {len(drops)} of {report['poses']} poses: {names}")
    else:
        lines.append(f"  the same at all {report['poses']} poses tried")
    return lines


def _stability(report: dict[str, Any]) -> list[str]:
    lines = ["", "stiffness against gravity, where no input acts:"]
    if report["unactuated"] == 0 and not report["rank_drops_at"]:
        return [*lines, "  every direction has an input"]
    verdict = "dominates" if report["dominates_at_rest"] else "does NOT dominate"
    share = ", ".join(
        f"{value:+.2f} {name}" for name, value in report["softest_unactuated"].items()
    )
    lines += [
        f"  at q = 0 stiffness {verdict}: least {report['stiffness_at_rest']:.3g} in all, "
        f"gravity takes up to {report['gravity_at_rest']:.3g}",
        f"  softest direction: {share}",
        f"  gravity wins at {report['poses_where_gravity_wins']} of {report['poses']} poses; "
        f"least stiffness {report['weakest']['stiffness']:.3g} at {report['weakest']['pose']}",
    ]
    if report["ceases"] is not None:
        lines.append(
            f"  it ceases to dominate {100 * report['ceases']['share']:.0f} % of the way from "
            f"q = 0 to {report['ceases']['towards']}"
        )
    return lines


main = cli.program(parser, command, __name__)
