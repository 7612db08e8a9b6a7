#!/usr/bin/env python3
"""The time of one control step, (q, v) to u, beside its floor and the paper's stack."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from softdyn.commands import cli  # beside this script

ROBOTS = ("finger", "helix", "spirob", "spirob48")
CONTROLLERS = ("soft-id-clf-qp", "id-clf-qp", "clf-qp", "ic-qp", "ic", "uic")
DRIVER = "soft-id-clf-qp"  # drives the loops that states are recorded from
EPILOG = """\
Robots and controllers as in benchmark.py. Every figure comes from the same recorded closed-loop
states, states/ROBOT.npz below --out, which are recorded where they are missing. What is inside each
figure, how the floor and the paper's stack are built: docs/real_time.md. The stack needs the extra
bench (cvxpy, SCS) and is left out without it.

Times say something only on a machine that is otherwise idle; how busy it was is in the report.

exit codes: 0 done; 2 bad input; 130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.add_argument("--controllers", nargs="+", default=CONTROLLERS, metavar="CONTROLLER")
parser.add_argument(
    "--states", type=cli.count, default=400, metavar="N", help="a robot (default: 400)"
)
parser.add_argument(
    "--rounds", type=cli.count, metavar="N", help="over all states (default: 10000 samples)"
)
parser.add_argument("--no-stack", action="store_true", help="leave the paper's stack out")
parser.add_argument("--scaling", action="store_true", help="also against n and m, on chains")
parser.add_argument("--throughput", action="store_true", help="also whole closed loops")
parser.add_argument(
    "--out", default="results/step_time", metavar="DIR", help="default: results/step_time"
)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure what is asked for, then tables and figures."""
    import softdyn
    from softdyn.controllers import find_controller
    from softdyn.validation.files import to_json, write_text
    from softdyn.validation.studies.benchmark import safe
    from softdyn.validation.timing import step_plots, step_report
    from softdyn.validation.timing.recording import recorded
    from softdyn.validation.timing.step_time import (
        SAMPLES,
        MachineLoad,
        Subject,
        measure,
        paper_stack,
    )

    out = Path(arguments.out)
    cli.make_folder(out / "states")
    cli.check_outputs(arguments.json)
    makes = {name: find_controller(name) for name in arguments.controllers}
    models = {name: softdyn.load(name) for name in dict.fromkeys(arguments.robots)}
    stack = paper_stack if not arguments.no_stack and has_stack() else None
    rounds = arguments.rounds or -(-SAMPLES // arguments.states)
    progress = Progress()

    load = MachineLoad()
    rows: list[dict[str, Any]] = []
    for name, model in models.items():
        driver = find_controller(DRIVER) if model.bundled else next(iter(makes.values()))
        progress.start(f"{name}: states", 1)
        file = out / "states" / f"{safe(name)}.npz"
        steps = recorded(model, driver, arguments.states, file).steps()
        progress.start(name, rounds)
        subjects = {
            law: Subject(model, make, steps, stack and stack(law)) for law, make in makes.items()
        }
        for law, times in measure(subjects, rounds, progress.tick).items():
            size = {"robot": name, "controller": law, "n": model.nv, "m": model.nu}
            rows.append({**size, **times.row()})
    report: dict[str, Any] = {"rows": rows}
    if arguments.scaling:
        from softdyn.validation.timing.step_scaling import scaling

        progress.start("chains", 20)
        report["scaling"] = scaling(rounds=20, tick=progress.tick)
    if arguments.throughput:
        from softdyn.validation.timing.throughput import throughput

        progress.start("closed loops", len(models))
        report["throughput"] = [throughput(model, DRIVER) for model in models.values()]
    progress.close()
    report["machine"] = step_report.machine() | load.report()

    step_plots.bars(rows, out / "step_time")
    if arguments.scaling:
        step_plots.growth(report["scaling"], out / "scaling")
    write_text(out / "step_time.md", step_report.markdown(report))
    write_text(out / "step_time.json", to_json(report) + "\n")
    where = f"\nTables, figures, states: {out}/"
    cli.write_report(report, arguments.json, step_report.text(report) + where)
    return cli.PASSED


def has_stack() -> bool:
    """Whether the extra ``bench`` is there; says so on stderr where it is not."""
    found = find_spec("cvxpy") is not None
    if not found:
        print("note: no cvxpy, so the paper's stack is left out: pip install '.[bench]'",
              file=sys.stderr)  # fmt: skip
    return found


class Progress:
    """A bar on stderr, only on a terminal."""

    def __init__(self) -> None:
        from tqdm import tqdm

        self._tqdm = tqdm
        self._bar: Any = None

    def start(self, what: str, total: int) -> None:
        """Another part of the work."""
        self.close()
        self._bar = self._tqdm(total=total, desc=what, disable=None, leave=False)

    def tick(self) -> None:
        """One step of it is done."""
        self._bar.update()

    def close(self) -> None:
        """No bar."""
        if self._bar is not None:
            self._bar.close()


main = cli.program(parser, command, __name__)
