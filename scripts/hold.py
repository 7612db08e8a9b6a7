#!/usr/bin/env python3
"""How Soft ID-CLF-QP does with different horizons of its dynamics: a table against tau / eps."""

from __future__ import annotations

from typing import Any

from softdyn.commands import cli

SHARES = (0.0, 0.5, 0.8, 1.0, 1.2, 2.0)  # of eps
OMEGA = 0.5

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48). For every horizon the four set points of
the paper and one trajectory, published gains, plant as everywhere: the twin at 0.5 ms.

exit codes: 0 done; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument(
    "--shares", type=float, nargs="+", default=SHARES, metavar="S",
    help=f"horizons, as shares of eps (default: {' '.join(map(str, SHARES))})",
)  # fmt: skip
parser.add_argument("--period", type=cli.positive, metavar="S", help="default: the robot's")
parser.add_argument("--jobs", type=cli.count, default=1, metavar="N", help="processes")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run every case, print the table."""
    from softdyn.validation.processes import in_order
    from softdyn.validation.studies import paper

    cli.check_outputs(arguments.json)
    paper.setup(arguments.robot)
    cases = [
        (share, theta, omega)
        for share in arguments.shares
        for theta, omega in [(theta, None) for theta in paper.THETAS] + [(0.0, OMEGA)]
    ]
    calls = ((arguments.robot, *case, arguments.period) for case in cases)
    results = in_order(measure, calls, arguments.jobs)
    rows = []
    for share in arguments.shares:
        found = [r for r, case in zip(results, cases, strict=True) if case[0] == share]
        rows.append({"share": share, "runs": found})
    cli.write_report({"robot": arguments.robot, "rows": rows}, arguments.json, table(rows))
    return cli.PASSED


def measure(
    robot: str, share: float, theta: float, omega: float | None, period: float | None
) -> dict[str, Any]:
    """One run: its final error in cm, or its mean squared one in cm²."""
    import softdyn
    from softdyn.controllers import SoftIdClfQp
    from softdyn.controllers.programmes.horizon import default_horizon
    from softdyn.validation import simulate
    from softdyn.validation.studies import paper

    model = softdyn.load(robot)
    tau = share * default_horizon(SoftIdClfQp(model).gains)
    experiment = paper.set_point(robot, theta) if omega is None else paper.tracking(robot, omega)
    log = simulate(model, SoftIdClfQp(model, horizon=tau), experiment, period=period)
    return {
        "theta": theta if omega is None else None, "omega": omega, "tau_s": tau,
        "failed": log.failed, "reason": log.reason,
        "final_error_cm": log.final_error_cm if omega is None else None,
        "mse_cm2": log.mse_cm2 if omega is not None else None,
        "not_solved": log.not_solved,
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown: final errors at the set points, their mean, the mean squared error tracking."""
    from softdyn.validation.tables import pipes

    lines = [["τ / ε", "τ (ms)", "SP at θ = 0, 0.5, 1, 1.5 (cm)", "mean", "TT at ω = 0.5 (cm²)"]]
    for row in rows:
        *points, track = row["runs"]
        errors = [run["final_error_cm"] for run in points]
        texts = [f"{run['final_error_cm']:.2f}{'!' * run['failed']}" for run in points]
        lines.append(
            [
                f"{row['share']:g}", f"{1e3 * track['tau_s']:g}", ", ".join(texts),
                f"{sum(errors) / len(errors):.2f}",
                f"{track['mse_cm2']:.2f}{'!' * track['failed']}",
            ]
        )  # fmt: skip
    return "\n".join(pipes(lines))


main = cli.program(parser, command, __name__)
