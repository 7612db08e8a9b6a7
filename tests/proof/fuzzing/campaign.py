"""Many damaged files, loaded in a process that is replaced when it dies, and their outcomes."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from softdyn import InputError
from softdyn.description.library import BUNDLED
from softdyn.validation.files import atomic
from tests.proof.fuzzing import verdict
from tests.proof.fuzzing.inputs import Base, mutant
from tests.proof.fuzzing.verdict import Verdict

CPU_LIMIT, WALL_LIMIT = 5, 300.0  # s per input, of processor time
MEMORY = 6 * 2**30  # bytes, limit of a process' address space
DEEP = 3  # one accepted input in this many is compared term by term in both engines


class Outcome(NamedTuple):
    """The outcome of an input, and its processor time (s)."""

    number: int
    verdict: Verdict
    seconds: float


def base_files(corpus: Path) -> list[Base]:
    """The bundled robots and the corpus's own, in the order of their names.

    Raises
    ------
    InputError
        There is no URDF in ``base/``.
    """
    own = sorted(corpus.glob("base/*.urdf"))
    if not own:
        raise InputError("--corpus", "a folder with base/*.urdf", corpus)
    bundled = [BUNDLED / f"{name}.urdf" for name in ("finger", "spirob")]
    # small ones twice as often
    found = [Base(path.read_bytes()) for path in (*bundled, *own, *own)]
    # each belongs to the URDF with which its name begins
    for path in sorted(corpus.glob("base/*.xml")):
        of = path.with_name(f"{path.stem.partition('-')[0]}.urdf")
        found.append(Base(path.read_bytes(), of.read_bytes()))
    return found


def campaign(
    bases: Sequence[Any],
    seed: int,
    numbers: range,
    keep: Path | None = None,
    tick: Callable[[], Any] = lambda: None,
    worker: Callable[..., None] | None = None,
    kept: Callable[..., tuple[str, bytes]] | None = None,
) -> dict[str, Any]:
    """Judge the inputs with these numbers; returns the report.

    Parameters
    ----------
    bases : sequence of Base
        Base files, or other arguments of `worker` and `kept`.
    seed : int
    numbers : range
    keep : Path, optional
        A folder for the inputs with a finding.
    tick : callable
        Called after every input.
    worker : callable, optional
        Judges inputs in a process of its own; `work` by default, for robot files.
    kept : callable, optional
        (bases, seed, number) → suffix of a file's name, and content of an input.
    """
    kinds, refusals = Counter[str](), Counter[str]()
    findings, deep, slowest, began = [], 0, (0.0, -1), time.perf_counter()
    for index, (kind, detail, compared), seconds in in_a_process(
        bases, seed, numbers, worker or work
    ):
        kinds[kind] += 1
        deep += compared
        slowest = max(slowest, (seconds, index))
        if kind == verdict.REFUSED:
            refusals[detail] += 1
        elif kind != verdict.ACCEPTED:
            findings.append({"index": index, "kind": kind, "detail": detail})
            if keep is not None:
                ending, data = (kept or robot_file)(bases, seed, index)
                with atomic(keep / f"{seed}-{index}.{ending}") as file:
                    file.write(data)
        tick()
    return {
        "seed": seed,
        "first": numbers.start,
        "count": len(numbers),
        "bases": len(bases),
        "refused": kinds[verdict.REFUSED],
        "accepted": kinds[verdict.ACCEPTED],
        "compared_in_both_engines": deep,
        "findings": {kind: kinds[kind] for kind in verdict.FINDINGS},
        "inputs_with_findings": findings,
        "kinds_of_refusal": len(refusals),
        "refusals": dict(refusals.most_common()),
        "slowest_s": slowest[0],
        "slowest_index": slowest[1],
        "wall_s": time.perf_counter() - began,
    }


def summary(report: dict[str, Any]) -> str:
    """The counts as text."""
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


def robot_file(bases: Sequence[Base], seed: int, index: int) -> tuple[str, bytes]:
    """Suffix of the name, and content of an input."""
    base = mutant(bases, seed, index)
    return "urdf" if base.of is None else "xml", base.data


def work(pipe: Any, bases: Sequence[Base], seed: int) -> None:
    """Judge inputs by their numbers until the pipe closes: a process of `in_a_process`."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"

        def judge(index: int) -> Verdict:
            base = mutant(bases, seed, index)
            return verdict.judge(base.data, path, index % DEEP == 0, base.of)

        verdict.judge(bases[0].data, path, True)
        serve(pipe, judge)


def serve(pipe: Any, judge: Callable[[int], Verdict]) -> None:
    """Answer numbers with verdicts until the pipe closes, within limits of time and memory."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # hide the engines' warnings
    _, ceiling = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pipe.send("ready")
    while True:
        try:
            index = pipe.recv()
        except EOFError:
            return
        began = time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(began) + CPU_LIMIT + 2, ceiling))
        found = judge(index)
        seconds = time.process_time() - began
        if seconds > CPU_LIMIT:
            found = Verdict(verdict.HANG, f"{seconds:.1f} s")
        pipe.send((found, seconds))


def in_a_process(
    bases: Sequence[Any], seed: int, numbers: range, worker: Callable[..., None] = work
) -> Iterator[Outcome]:
    """The outcome of each input, by a process that is replaced when it dies."""
    context = multiprocessing.get_context("spawn")
    todo = list(numbers)[::-1]
    while todo:
        ours, theirs = context.Pipe()
        process = context.Process(target=worker, args=(theirs, bases, seed), daemon=True)
        process.start()
        theirs.close()
        try:
            ours.recv()  # ready
            while todo:
                ours.send(todo[-1])
                if not ours.poll(WALL_LIMIT):
                    late = Verdict(verdict.HANG, f"no answer within {WALL_LIMIT:g} s")
                    yield Outcome(todo.pop(), late, 0.0)
                    break
                found, seconds = ours.recv()
                yield Outcome(todo.pop(), found, seconds)
        except EOFError:
            process.join()
            yield Outcome(todo.pop(), _dead(process.exitcode), 0.0)
        finally:
            ours.close()
            process.kill()
            process.join()


def _dead(code: int | None) -> Verdict:
    """The verdict on a process that ended by itself."""
    if code == -signal.SIGXCPU:
        return Verdict(verdict.HANG, f"more than {CPU_LIMIT} s")
    return Verdict(verdict.CRASH, f"exit code {code}")
