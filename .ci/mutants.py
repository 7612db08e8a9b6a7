"""Mutation testing by cosmic-ray: a seeded sample, kept between runs. `make mutants`.

Faults are planted one at a time in build/mutants/tree, a copy of the last commit. For each fault
those tests run that .ci/mutants.toml names for its file and that execute its lines. Results go to a
session of cosmic-ray, build/mutants/session.sqlite, so that an interrupted run can continue.

python .ci/mutants.py continue, or begin: draw the sample, then run it
    python .ci/mutants.py --draw     only draw the sample
    python .ci/mutants.py --again    run the survivors in the code and tests of the current commit
    python .ci/mutants.py --report   the figures and the survivors
"""

import ast
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from difflib import unified_diff
from importlib import import_module
from itertools import zip_longest
from pathlib import Path

from cosmic_ray.commands.init import init
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome, WorkerOutcome, WorkResult
from planting import FOLDER, RESULTS, ROOT, TREE, Fault, plain, run_group

PLAN = tomllib.loads((ROOT / ".ci/mutants.toml").read_text())
COMMIT, DRAWN = FOLDER / "commit", FOLDER / "drawn.json"
SESSION, AGAIN = FOLDER / "session.sqlite", FOLDER / "again.json"


def sources() -> list[Path]:
    """The files in which faults are planted, from the root."""
    files = (f for name in PLAN["sources"] for f in sorted((TREE / name).glob("**/*.py")))
    return [f.relative_to(TREE) for f in files if f.name not in PLAN["skipped"]]


def silent_lines(path: Path) -> set[tuple[int, int]]:
    """Places (line, column) at which a fault changes nothing that a test should check.

    These are annotations, texts of error messages (all of a `raise`), decorators, which decide how
    a function is compiled, cached or typed, and code for type checkers only.
    """
    spans: list[ast.AST] = []
    text = (TREE / path).read_text()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.AnnAssign | ast.arg) and node.annotation:
            spans.append(node.annotation)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            spans += node.decorator_list
            spans += [node.returns] if getattr(node, "returns", None) else []
        if isinstance(node, ast.Raise) or (
            isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        ):
            spans.append(node)
    found = set()
    widths = [len(line) + 1 for line in text.splitlines()]
    for span in spans:
        for line in range(span.lineno, span.end_lineno + 1):
            first = span.col_offset if line == span.lineno else 0
            last = span.end_col_offset if line == span.end_lineno else widths[line - 1]
            found |= {(line, column) for column in range(first, last)}
    return found


def drawn(mutations: Iterable[MutationSpec], count: int) -> list[MutationSpec]:
    """A sample: `count` places in the code, each with one of the possible faults.

    The draw in one file is independent of the other files, except for its size.
    """
    places: dict[tuple, tuple[bytes, MutationSpec]] = {}
    for mutation in mutations:
        path, operator = str(mutation.module_path), mutation.operator_name
        kind = "_".join(operator.split("_")[:2])
        place = (path, kind, mutation.start_pos)
        told = f"{PLAN['seed']} {path} {operator} {mutation.occurrence}"
        digest = hashlib.sha256(told.encode()).digest()
        if place not in places or digest < places[place][0]:
            places[place] = digest, mutation
    chosen = sorted(
        places.items(), key=lambda x: hashlib.sha256(f"{PLAN['seed']} {x[0]}".encode()).digest()
    )
    return [mutation for _, (_, mutation) in chosen[:count]]


def last_commit() -> str:
    """Name of the last commit."""
    line = ["git", "rev-parse", "--short", "HEAD"]
    return subprocess.run(line, cwd=ROOT, stdout=-1, text=True, check=True).stdout.strip()


def unpack(commit: str) -> None:
    """Make TREE a copy of a commit."""
    shutil.rmtree(TREE / "tests", ignore_errors=True)
    for old in (f for name in PLAN["sources"] for f in (TREE / name).rglob("*.py")):
        old.unlink()  # keep compiled kernels
    TREE.mkdir(parents=True, exist_ok=True)
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, stdout=-1, check=True).stdout
    subprocess.run(["tar", "-x", "-C", TREE], input=archive, check=True)


def draw(session: WorkDB) -> None:
    """Fill a session with the sample."""
    init(sources(), session, {})
    every = list(session.work_items)
    silent = {path: silent_lines(path) for path in sources()}
    told = [
        item
        for item in every
        if (m := item.mutations[0]).start_pos not in silent[m.module_path]
        and not any(name in m.operator_name for name in PLAN["left_out"])
    ]
    sample = {id(m) for m in drawn((item.mutations[0] for item in told), PLAN["count"])}
    session.clear()
    session.add_work_items([item for item in every if id(item.mutations[0]) in sample])
    print(f"{len(every)} faults, {len(told)} that a test should see: {len(sample)}")


def selection(path: Path) -> str:
    """Pytest's arguments for a file: the tests that should detect a fault in it."""
    names = [name for name in PLAN["tests"] if str(path).startswith(name)]
    if not names:
        raise SystemExit(f"{path}: no tests are named for it in .ci/mutants.toml")
    return str(PLAN["tests"][max(names, key=len)])


def groups(faults: Iterable[Fault]) -> list[tuple[str, list[Fault]]]:
    """Faults, grouped by the tests that should detect them."""
    found: dict[tuple[str, bool], list[Fault]] = {}
    for fault in faults:
        found.setdefault((selection(fault.path), plain(fault.path)), []).append(fault)
    slow_last = sorted(found.items(), key=lambda x: (x[0][1], "controllers" in x[0][0], -len(x[1])))
    return [(tests, members) for (tests, _), members in slow_last]


def take_results(session: WorkDB, faults: Iterable[Fault]) -> None:
    """Write the results of groups into the session."""
    diffs = {fault.job: fault for fault in faults}
    for line in RESULTS.read_text().splitlines() if RESULTS.exists() else ():
        job, killed, said = json.loads(line)
        fault, outcome = diffs[job], TestOutcome.KILLED if killed else TestOutcome.SURVIVED
        lines = ((TREE / fault.path).read_text().splitlines(), fault.text.splitlines())
        names = f"a/{fault.path}", f"b/{fault.path}"
        diff = "\n".join(unified_diff(*lines, *names, lineterm=""))
        session.set_result(job, WorkResult(WorkerOutcome.NORMAL, said, outcome, diff))
    RESULTS.unlink(missing_ok=True)


def drawn_faults(session: WorkDB) -> list[Fault]:
    """All drawn faults; they are cached in a file, because finding their places is slow."""
    if DRAWN.exists():
        return [Fault(job, Path(path), *rest) for job, path, *rest in json.loads(DRAWN.read_text())]
    found = []
    for item in session.work_items:
        (m,) = item.mutations
        operator = get_operator(m.operator_name)(**m.operator_args)
        text = mutate_code((TREE / m.module_path).read_text(), operator, m.occurrence)
        found.append(Fault(item.job_id, m.module_path, text, m.start_pos[0], m.end_pos[0]))
    found.sort(key=lambda fault: (str(fault.path), fault.first))
    told = [[f.job, str(f.path), f.text, f.first, f.last] for f in found]
    DRAWN.write_text(json.dumps(told))
    return found


def run(session: WorkDB) -> None:
    """Run the rest of a session."""
    everything = drawn_faults(session)
    take_results(session, everything)
    done = {job for job, _ in session.results}
    for tests, faults in groups(fault for fault in everything if fault.job not in done):
        print(f"{len(faults)} faults: {tests}", file=sys.stderr, flush=True)
        child = os.fork()
        if child == 0:
            os._exit(run_group(tests, faults))
        os.waitpid(child, 0)
        take_results(session, faults)


def survivors(session: WorkDB) -> Iterator[tuple[str, Path, str]]:
    """Job, file and diff of each fault that no test detected."""
    results = dict(session.results)
    for item in session.work_items:
        result = results.get(item.job_id)
        if result is not None and not result.is_killed:
            yield item.job_id, item.mutations[0].module_path, result.diff


def run_again(session: WorkDB) -> None:
    """Plant the survivors in the current code, by their diffs."""
    unpack(last_commit())
    found = json.loads(AGAIN.read_text()) if AGAIN.exists() else {}
    faults = []
    for job, path, diff in survivors(session):
        before = (TREE / path).read_text()
        patch = ["patch", "-p1", "--no-backup-if-mismatch", "-r", "-"]
        planted = subprocess.run(patch, cwd=TREE, input=diff + "\n", text=True, stdout=-1)
        after = (TREE / path).read_text()
        (TREE / path).write_text(before)
        pairs = zip_longest(before.splitlines(), after.splitlines())
        lines = [k for k, (old, new) in enumerate(pairs, 1) if old != new]
        if planted.returncode or not lines:
            found[job] = "gone"
        elif found.get(job) != "killed":
            faults.append(Fault(job, path, after, lines[0], lines[-1]))
    RESULTS.unlink(missing_ok=True)
    for tests, members in groups(faults):
        child = os.fork()
        if child == 0:
            os._exit(run_group(tests, members))
        os.waitpid(child, 0)
        for line in RESULTS.read_text().splitlines():
            job, killed, _ = json.loads(line)
            found[job] = "killed" if killed else "survived"
        AGAIN.write_text(json.dumps(found))
    RESULTS.unlink(missing_ok=True)


def report(session: WorkDB) -> None:
    """Print the number of detected faults, and the survivors."""
    seen = json.loads(AGAIN.read_text()) if AGAIN.exists() else {}
    rooms: Counter[tuple[str, str]] = Counter()
    results = dict(session.results)
    for item in session.work_items:
        room = str(item.mutations[0].module_path.parent)
        result = results.get(item.job_id)
        first = "left" if result is None else "killed" if result.is_killed else "survived"
        rooms[room, first] += 1
        rooms[room, "later"] += first == "survived" and seen.get(item.job_id) == "killed"
    columns = ("killed", "later", "survived", "left")
    print(f"{'':28}", *(f"{name:>9}" for name in columns))
    for room in [*sorted({room for room, _ in rooms}), ""]:
        row = [
            sum(n for (r, c), n in rooms.items() if c == name and room in (r, ""))
            for name in columns
        ]
        print(f"{room or 'all':28}", *(f"{n:9}" for n in row))
    for job, path, diff in survivors(session):
        if seen.get(job) != "killed":
            lines = [x for x in diff.splitlines()[2:] if x[:1] in "+-@"]
            print(f"\n{path} {job[:8]} {seen.get(job, '')}", *lines, sep="\n")


def main() -> None:
    """Run one of the commands above."""
    task = next(iter(sys.argv[1:]), "")
    FOLDER.mkdir(parents=True, exist_ok=True)
    if not COMMIT.exists():
        SESSION.unlink(missing_ok=True)
        COMMIT.write_text(last_commit())
    unpack(COMMIT.read_text())
    os.chdir(TREE)
    os.environ["OMP_NUM_THREADS"] = "1"
    for name in PLAN["loaded"]:  # before any fork
        import_module(name)
    begun = SESSION.exists()
    with use_db(SESSION) as session:
        if not begun:
            draw(session)
        if task == "--report":
            report(session)
        elif task == "--again":
            run_again(session)
        elif task != "--draw":
            run(session)


if __name__ == "__main__":
    main()
