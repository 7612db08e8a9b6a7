#!/usr/bin/env python3
"""Fuzzing: thousands of damaged robot files, each loaded in a process that may die of it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn.validation.fuzzing.inputs import Base

CORPUS = Path(__file__).resolve().parents[1] / "tests" / "corpus"
CPU_LIMIT, WALL_LIMIT = 5, 60.0  # s an input; the processor's time counts, whatever else it does
MEMORY = 6 * 2**30  # bytes of address space a process may have
DEEP = 3  # one input in so many, where it is accepted, is compared term by term in both engines

EPILOG = """\
Each input is a file of the corpus after a few random changes (validation/fuzzing/inputs.py), wholly
determined by --seed and its number. It is loaded as a user's file would be, in a process of its
own that is killed after 5 s of processor time. A finding is

  crash            the process died
  hang             it took longer than 5 s
  exception        anything but a softdyn error, or terms that are not finite at rest
  message          an error that is not one line, or names no file
  lost content     accepted, but a second reading of the file by another parser says otherwise
  engines differ   accepted, but MuJoCo computes another robot (one input in three is asked)

Inputs behind findings are written to --out.

exit codes: 0 no finding; 1 some; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument(
    "--count", type=cli.count, default=1000, metavar="N", help="inputs (default: 1000)"
)
parser.add_argument("--seed", type=int, default=0, metavar="S", help="(default: 0)")
parser.add_argument("--first", type=int, default=0, metavar="I", help="number of the first one")
parser.add_argument(
    "--corpus", type=Path, default=CORPUS, metavar="DIR", help="where base files are"
)
parser.add_argument("--out", type=Path, metavar="DIR", help="folder for inputs with a finding")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Fuzz, count, report."""
    from tqdm import tqdm

    if arguments.out is not None:
        cli.make_folder(arguments.out)
    bases = base_files(arguments.corpus)
    numbers = range(arguments.first, arguments.first + arguments.count)
    kinds: Counter[str] = Counter()
    refusals: Counter[str] = Counter()
    findings: list[dict[str, Any]] = []
    deep, began, slowest = 0, time.perf_counter(), (0.0, -1)
    results = in_a_process(bases, arguments.seed, numbers)
    with tqdm(results, total=len(numbers), disable=None, leave=False, unit="file") as bar:
        for index, (kind, detail, compared), seconds in bar:
            kinds[kind] += 1
            deep += compared
            slowest = max(slowest, (seconds, index))
            if kind == "refused":
                refusals[detail] += 1
            elif kind != "accepted":
                findings.append({"index": index, "kind": kind, "detail": detail})
                if arguments.out is not None:
                    keep(arguments.out, bases, arguments.seed, index)
    from softdyn.validation.fuzzing.verdict import FINDINGS

    report = {
        "seed": arguments.seed,
        "first": arguments.first,
        "count": arguments.count,
        "bases": len(bases),
        "refused": kinds["refused"],
        "accepted": kinds["accepted"],
        "compared_in_both_engines": deep,
        "findings": {kind: kinds[kind] for kind in FINDINGS},
        "inputs_with_findings": findings,
        "kinds_of_refusal": len(refusals),
        "refusals": dict(refusals.most_common()),
        "slowest_s": slowest[0],
        "slowest_index": slowest[1],
        "wall_s": time.perf_counter() - began,
    }
    cli.write_report(report, arguments.json, summary(report))
    return cli.FAILED if findings else cli.PASSED


def base_files(corpus: Path) -> list[Base]:
    """The bundled robots and the corpus's own, in the order of their names."""
    from softdyn import InputError
    from softdyn.description.library import BUNDLED
    from softdyn.validation.fuzzing.inputs import Base

    own = sorted(corpus.glob("base/*.urdf"))
    if not own:
        raise InputError("--corpus", "a folder with base/*.urdf", corpus)
    bundled = [BUNDLED / f"{name}.urdf" for name in ("finger", "spirob")]
    urdfs = [
        Base(path.read_bytes()) for path in (*bundled, *own, *own)
    ]  # small ones twice as often
    overlays = sorted(corpus.glob("base/*.xml"))  # each of the URDF named first in its name
    of = [corpus / "base" / f"{path.stem.partition('-')[0]}.urdf" for path in overlays]
    pairs = zip(overlays, of, strict=True)
    return urdfs + [Base(path.read_bytes(), urdf.read_bytes()) for path, urdf in pairs]


Outcome = tuple[int, tuple[str, str, bool], float]


def in_a_process(
    bases: list[Base], seed: int, numbers: range, worker: Callable[..., None] | None = None
) -> Iterator[Outcome]:
    """(number, verdict, seconds) of each input, by a process that is replaced when it dies."""
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    todo = list(numbers)[::-1]
    while todo:
        ours, theirs = context.Pipe()
        process = context.Process(target=worker or work, args=(theirs, bases, seed), daemon=True)
        process.start()
        theirs.close()
        try:
            ours.recv()  # ready
            while todo:
                ours.send(todo[-1])
                if not ours.poll(WALL_LIMIT):
                    yield todo.pop(), ("hang", f"no answer within {WALL_LIMIT:g} s", False), 0.0
                    break
                verdict, seconds = ours.recv()
                yield todo.pop(), verdict, seconds
        except EOFError:
            process.join()
            yield todo.pop(), dead(process.exitcode), 0.0
        finally:
            ours.close()
            process.kill()
            process.join()


def dead(code: int | None) -> tuple[str, str, bool]:
    """The verdict on a process that ended by itself."""
    import signal

    if code == -signal.SIGXCPU:
        return "hang", f"more than {CPU_LIMIT} s", False
    return "crash", f"exit code {code}", False


def work(pipe: Any, bases: list[Base], seed: int) -> None:
    """Judge inputs by their numbers until the pipe closes."""
    import os
    import resource
    import tempfile
    from time import process_time

    from softdyn.validation.fuzzing.inputs import mutant
    from softdyn.validation.fuzzing.verdict import judge

    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # the engines' own complaints
    _, ceiling = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        judge(bases[0].data, path, True)
        pipe.send("ready")
        while True:
            try:
                index = pipe.recv()
            except EOFError:
                return
            base = mutant(bases, seed, index)
            began = process_time()
            resource.setrlimit(resource.RLIMIT_CPU, (int(began) + CPU_LIMIT + 2, ceiling))
            verdict = judge(base.data, path, index % DEEP == 0, base.of)
            seconds = process_time() - began
            if seconds > CPU_LIMIT:
                pipe.send((("hang", f"{seconds:.1f} s", False), seconds))
            else:
                pipe.send(((verdict.kind, verdict.detail, verdict.deep), seconds))


def keep(folder: Path, bases: list[Base], seed: int, index: int) -> None:
    """Write an input to `folder`."""
    from softdyn.validation.files import atomic
    from softdyn.validation.fuzzing.inputs import mutant

    base = mutant(bases, seed, index)
    with atomic(folder / f"{seed}-{index}.{'urdf' if base.of is None else 'xml'}") as file:
        file.write(base.data)


def summary(report: dict[str, Any]) -> str:
    """The counts for people."""
    lines = [
        f"{report['count']} inputs from number {report['first']} of seed {report['seed']}, "
        f"{report['bases']} base files, {report['wall_s']:.0f} s",
        f"refused {report['refused']}, in {report['kinds_of_refusal']} ways",
        f"accepted {report['accepted']}, "
        f"{report['compared_in_both_engines']} of them compared in both engines",
        f"slowest {report['slowest_s']:.2f} s, number {report['slowest_index']}",
    ]
    lines += [f"{kind:<16}{number}" for kind, number in report["findings"].items()]
    for found in report["inputs_with_findings"][:20]:
        lines.append(f"  {found['index']}: {found['kind']}: {found['detail'][:200]}")
    return "\n".join(lines)


main = cli.program(parser, command, __name__)
