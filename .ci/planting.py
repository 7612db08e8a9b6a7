"""Faults planted in running code: a plugin of pytest that collects once and forks for each fault.

The project is imported and the tests are collected once. Each fault is planted in the code objects
of functions, in a fork of this process, where only the tests have to run.
"""

import ast
import gc
import inspect
import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass
from functools import _lru_cache_wrapper, partial
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType

import coverage
import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build/mutants"
TREE, LOG = FOLDER / "tree", FOLDER / "log"
RESULTS = FOLDER / "results.jsonl"  # of the running group
COMMON = ["-q", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
SHARED = "shared by "  # prefix for tests that share a fixture
ELSEWHERE = 77  # exit code of a fork whose fault is outside functions
Found = dict[str, tuple[float, list[str]]]  # test → its time (s) and lines


def plain(path: Path) -> bool:
    """Whether a file's kernels must run in Python, because compiled ones would hide the fault."""
    return "@compiled" in (TREE / path).read_text()


def interpret_kernels() -> None:
    """Run all kernels in Python, without their NumPy replacements."""
    os.environ["NUMBA_DISABLE_JIT"] = "1"
    import_module("numba").config.DISABLE_JIT = 1
    compiled = import_module("softdyn.compiled")
    compiled.COMPILES = True
    compiled.compiled_or = lambda plain, **options: compiled.compiled


@dataclass(frozen=True)
class Fault:
    """A fault to plant: its file, the file's text with it, and its lines."""

    job: str
    path: Path
    text: str
    first: int
    last: int

    def lines(self) -> set[str]:
        """The changed lines, with all lines of their statements, as not every line has code."""
        file, found = os.path.realpath(TREE / self.path), set(range(self.first, self.last + 1))
        for node in ast.walk(ast.parse((TREE / self.path).read_text())):
            if isinstance(node, ast.stmt) and not hasattr(node, "body"):
                lines = set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
                found |= lines if lines & set(range(self.first, self.last + 1)) else set()
        return {f"{file}:{line}" for line in found}

    def outside(self) -> set[str]:
        """The changed lines outside functions, which run at import."""
        file, inside = os.path.realpath(TREE / self.path), set[str]()
        for node in ast.walk(ast.parse((TREE / self.path).read_text())):
            if isinstance(node, ast.FunctionDef | ast.Lambda):
                body = node.body if isinstance(node.body, list) else [node.body]
                last = (body[-1].end_lineno or 0) + 1
                inside |= {f"{file}:{line}" for line in range(body[0].lineno, last)}
        return self.lines() - inside

    def plant(self, before: str) -> bool:
        """Exchange the code of all changed functions; False if the fault is outside functions.

        `before` is the file's text without the fault.
        """
        file = os.path.realpath(TREE / self.path)
        old, new = (_codes(text, file) for text in (before, self.text))
        changed = {key: code for key, code in new.items() if old.get(key, code) != code}
        if old.keys() != new.keys() or not changed:
            return False
        planted = set()
        gc.unfreeze()  # frozen objects are not among gc's objects
        functions = [x for x in gc.get_objects() if isinstance(x, FunctionType)]
        gc.freeze()
        for function in functions:
            code = function.__code__
            key = code.co_qualname, code.co_firstlineno
            if key in changed and os.path.realpath(code.co_filename) == file:
                if code.co_freevars != changed[key].co_freevars:
                    return False
                function.__code__ = changed[key]
                planted.add(key)
        return bool(planted)


def _codes(text: str, file: str) -> dict[tuple[str, int], CodeType]:
    """The code of all functions in a text, by name and line."""
    found: dict[tuple[str, int], CodeType] = {}
    todo = [x for x in compile(text, file, "exec").co_consts if isinstance(x, CodeType)]
    while todo:
        code = todo.pop()
        todo += [x for x in code.co_consts if isinstance(x, CodeType)]
        if code.co_flags & inspect.CO_NEWLOCALS and code.co_flags & inspect.CO_OPTIMIZED:
            found[code.co_qualname, code.co_firstlineno] = code
    return found


def forget() -> None:
    """Clear caches of tests and the project, so that each test executes all its lines."""
    for name, module in list(sys.modules.items()):
        if name.split(".")[0] in ("softdyn", "tests"):
            for kept in list(vars(module).values()):
                if isinstance(kept, _lru_cache_wrapper):
                    kept.cache_clear()


class Planter:
    """A pytest plugin that collects tests once and runs them in a fork for each fault."""

    def __init__(self, faults: list[Fault]) -> None:
        self.faults, self.failed = faults, set[str]()
        self.coverage: coverage.Coverage | None = None
        self.now = ""  # the running test

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Generator:
        """Attribute the lines of a shared fixture to all tests that may use it."""
        if self.coverage is None or fixturedef.scope == "function":
            return (yield)
        self.coverage.switch_context(SHARED + str(fixturedef.baseid))
        try:
            return (yield)
        finally:
            self.coverage.switch_context(self.now)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record failing tests."""
        if report.failed:
            self.failed.add(report.nodeid)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run all faults instead of one run of the tests."""
        gc.freeze()
        tests = {item.nodeid: item for item in session.items}
        watched = FOLDER / "watched.json"
        watched.unlink(missing_ok=True)
        forked(partial(self.watch, session, watched), 1800)
        found: Found = json.loads(watched.read_text())
        for fault in self.faults:
            begun, places = time.monotonic(), fault.lines()
            ran = {name for name, (_, lines) in found.items() if places & set(lines)}
            alone = found.keys() - {""} if "" in ran else ran
            order = sorted(alone, key=lambda name: found[name][0])
            limit = int(3 * sum(seconds for seconds, _ in found.values()) + 20)
            killed, how = False, "no test runs it"
            if ran:
                before = (TREE / fault.path).read_text()
                (TREE / fault.path).write_text(fault.text)  # for processes that tests start
                code = forked(partial(self.judge, fault, before, [tests[n] for n in order]), limit)
                if code == ELSEWHERE:  # code that runs at import needs a new process
                    code = forked(partial(judge_whole, fault, order), limit)
                (TREE / fault.path).write_text(before)
                killed, how = code != 0, f"{code}"
                said = LOG.read_text()
                imported = "ERROR collecting" not in said and "ImportError" not in said
                if code in (3, 5) or (code in (2, 4) and imported):
                    print(f"pytest ended with {code}: {fault.path}", file=sys.__stderr__)
                    continue
            with RESULTS.open("a") as file:
                print(json.dumps([fault.job, killed, LOG.read_text()[-1500:]]), file=file)
            took = time.monotonic() - begun
            what = "killed" if killed else "survived"
            print(f"{what} {fault.path}:{fault.first} {how} {took:.1f} s", file=sys.__stderr__)
        return True

    def watch(self, session: pytest.Session, target: Path) -> int:
        """Write the time and the executed lines of each test that passes without a fault."""
        files = {str(TREE / f.path) for f in self.faults}
        files |= {os.path.realpath(f) for f in files}
        files |= {str(TREE / "softdyn" / f.path) for f in self.faults}
        watch = coverage.Coverage(data_file=None, include=sorted(files), messages=False)
        watch.start()
        self.coverage = watch
        seconds: dict[str, float] = {}
        for item, following in zip(session.items, [*session.items[1:], None], strict=True):
            self.now = item.nodeid
            forget()
            watch.switch_context(item.nodeid)
            begun = time.process_time()
            item.ihook.pytest_runtest_protocol(item=item, nextitem=following)
            seconds[item.nodeid] = time.process_time() - begun
        watch.stop()
        data, lines = watch.get_data(), {name: set[str]() for name in seconds}
        for file in data.measured_files():
            for line, names in data.contexts_by_lineno(file).items():
                for name in filter(None, names):
                    known = (lines[name],) if name in lines else [
                        kept for test, kept in lines.items()
                        if test.startswith(name.removeprefix(SHARED))
                    ]  # fmt: skip
                    for kept in known:
                        kept.add(f"{os.path.realpath(file)}:{line}")
        imported = {line for fault in self.faults for line in fault.outside()}
        passed = {n: (s, sorted(lines[n])) for n, s in seconds.items() if n not in self.failed}
        found: Found = {"": (0.0, sorted(imported))} | passed
        target.write_text(json.dumps(found))
        return 0

    def judge(self, fault: Fault, before: str, items: list[pytest.Item]) -> int:
        """Return 1 if a test fails with the fault, else 0; `before` is the text without it."""
        if not fault.plant(before):
            return ELSEWHERE
        for item, following in zip(items, [*items[1:], None], strict=True):
            item.ihook.pytest_runtest_protocol(item=item, nextitem=following)
            if item.nodeid in self.failed:
                return 1
        return 0


def judge_whole(fault: Fault, order: list[str]) -> int:
    """The same as `Planter.judge`, in a new interpreter with the fault in the file."""
    start = "import planting as p; p.interpret_kernels(); " if plain(fault.path) else ""
    code = f"{start}import sys, pytest; sys.exit(pytest.main(sys.argv[1:]))"
    line = [sys.executable, "-B", "-c", code, "-x", *COMMON, *order]
    paths = f"{TREE}:{ROOT / '.ci'}"
    return subprocess.run(line, env={**os.environ, "PYTHONPATH": paths}).returncode


def forked(task: Callable[[], int], seconds: int) -> int:
    """The value of a task in a fork, which is killed after a limit of processor time."""
    own = Path("/proc/self/autogroup")  # a new session would run at ordinary priority
    priority = own.read_text().split()[-1] if own.exists() else "0"
    child = os.fork()
    if child == 0:
        os.setsid()
        with suppress(OSError):
            own.write_text(priority)
        log = os.open(LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(log, stream)
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        try:
            os._exit(task())
        except BaseException:
            traceback.print_exc()
            os._exit(1)
    # wall clock, because a waiting process uses no processor time
    left, found, status = 60.0 * seconds, 0, 0
    while not found and left > 0:
        found, status = os.waitpid(child, os.WNOHANG)
        time.sleep(0.02)
        left -= 0.02
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if not found:
        _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def run_group(tests: str, faults: list[Fault]) -> int:
    """Run all faults that the same tests should detect."""
    os.environ["PYTHONPATH"] = str(TREE)
    sys.path.insert(0, str(TREE))
    sys.dont_write_bytecode = True
    if plain(faults[0].path):
        interpret_kernels()
    return int(pytest.main([*COMMON, "-s", *shlex.split(tests)], [Planter(faults)]))
