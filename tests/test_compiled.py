"""Compiled kernels against their own source run by Python, and softdyn without Numba."""

from __future__ import annotations

import os
import pickle
import runpy
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import softdyn.compiled
from softdyn.controllers import CONTROLLERS
from softdyn.controllers.qps.linear_algebra import (
    add_squares,
    cholesky,
    extend,
    factor,
    jacobi_svd,
    lq,
    lu_solve,
    row_space,
)
from tests.support.control_cases import BUNDLED, MICRO, drawn, recorded, robot

pytestmark = pytest.mark.skipif(
    not softdyn.compiled.COMPILES, reason="Numba is absent: there is nothing to compare"
)

SAY_ONCE = softdyn.compiled.say_once  # the session has another in its place
INPUTS = """
import pickle, sys
import numpy as np
import softdyn, softdyn.compiled
from softdyn.controllers import CONTROLLERS
assert not softdyn.compiled.COMPILES
found = []
for which, cases in pickle.load(sys.stdin.buffer).items():
    model = softdyn.load(which)
    for name in sorted(CONTROLLERS):
        controller = CONTROLLERS[name](model)
        found += [controller(model.state(q, v), reference).u for q, v, reference in cases]
pickle.dump(np.concatenate(found), sys.stdout.buffer)
"""


def test_the_same_inputs_without_numba():
    """All controllers and robots, in a process where nothing is compiled."""
    cases = {which: (*drawn(which, 4), *recorded(which, 4)) for which in BUNDLED}
    sent = {which: [(state.q, state.v, reference) for state, reference in cases[which]]
            for which in cases}  # fmt: skip
    environment = {**os.environ, "SOFTDYN_COMPILE": "0"}
    program = [sys.executable, "-c", INPUTS]
    done = subprocess.run(
        program, input=pickle.dumps(sent), stdout=subprocess.PIPE, check=True, env=environment
    )
    found, ranges = [], []
    for which in BUNDLED:
        for name in sorted(CONTROLLERS):
            controller = CONTROLLERS[name](robot(which))
            for case in cases[which]:
                found.append(controller(*case).u)
                ranges.append(robot(which).u_max - robot(which).u_min)
    error = np.abs(np.concatenate(found) - pickle.loads(done.stdout)) / np.concatenate(ranges)
    assert error.max() < 1e-6  # the least-norm CLF-QP amplifies rounding the most


@pytest.mark.parametrize("which", BUNDLED + MICRO)
def test_bases(which):
    for state, _ in drawn(which, 4):
        row_basis = row_space(state.J)
        assert np.allclose(row_basis @ row_basis.T, np.eye(len(row_basis)), atol=1e-13)
        # it spans range(Jᵀ) up to the threshold
        left = state.J - state.J @ row_basis.T @ row_basis
        assert np.abs(left).max() <= 1e-5 * max(np.abs(state.J).max(), 1e-300)
        span, triangle, rows = factor(state.B.T)
        inverse = rows.T @ np.linalg.solve(triangle, span)
        assert np.allclose(inverse, np.linalg.pinv(state.B, rcond=1e-6), atol=1e-6)
        rows = span @ state.M
        Z, triangle = (
            np.empty((len(rows) + len(row_basis), len(state.v))),
            np.empty((len(rows),) * 2),
        )
        lq(rows, Z, triangle)
        Z = Z[: extend(Z, len(rows), row_basis)]
        assert np.allclose(Z @ Z.T, np.eye(len(Z)), atol=1e-12)
        assert np.allclose(triangle @ Z[: len(rows)], rows, atol=1e-12 * np.abs(rows).max())
        rows = np.vstack((row_basis, rows))
        assert np.allclose(rows @ Z.T @ Z, rows, atol=1e-9 * np.abs(rows).max())


@pytest.mark.parametrize("n", [1, 2, 7, 20])
def test_small_systems(n):
    rng = np.random.default_rng(n)
    A, b = rng.normal(size=(n, n)), rng.normal(size=n)
    A[0, 0] = 0.0 if n > 1 else A[0, 0]  # a pivot is needed
    x = np.linalg.solve(A, b)
    assert lu_solve(A.copy(), b)
    assert np.allclose(b, x, rtol=1e-9, atol=1e-12)
    A[-1] = 2 * A[0] if n > 1 else 0.0
    A[:, -1] = 0.0
    assert not lu_solve(A, b)

    root = rng.normal(size=(n, n + 1))
    M, right = root @ root.T + 0.1 * np.eye(n), rng.normal(size=(n, 3))
    R, half = cholesky(M, right.T.copy())
    upper = np.triu(R[:, :n])
    assert np.allclose(upper.T @ upper, M, atol=1e-12 * np.abs(M).max())
    assert np.allclose(half @ upper, right.T, atol=1e-10)


def test_squares_add_up_to_an_objective():
    rng = np.random.default_rng(1)
    H, g, value = np.zeros((5, 5)), np.zeros(5), 0.0
    x = rng.normal(size=5)
    for weight in (0.7, -0.2):
        rows, offset = rng.normal(size=(3, 5)), rng.normal(size=3)
        add_squares(H, g, weight, rows, offset)
        value += weight * (np.sum((rows @ x + offset) ** 2) - offset @ offset)
    assert x @ H @ x / 2 + g @ x == pytest.approx(value, rel=1e-12)
    assert np.array_equal(H, H.T)


@pytest.mark.parametrize("shape", [(1, 4), (3, 2), (3, 9), (2, 1), (3, 3)])
def test_turned_rows(shape):
    rng = np.random.default_rng(0)
    for scale in (1.0, 1e-9):
        rows = rng.normal(size=shape)
        rows[-1] = rows[0] + scale * rows[-1]
        turned, orthogonal = np.eye(shape[0]), rows.copy()
        jacobi_svd(orthogonal, turned)
        assert np.allclose(turned @ turned.T, np.eye(shape[0]), atol=1e-14)
        assert np.allclose(turned @ rows, orthogonal, atol=1e-14)
        sizes = np.sort(np.linalg.norm(orthogonal, axis=1))[::-1][: min(shape)]
        assert np.allclose(sizes, np.linalg.svd(rows, compute_uv=False), rtol=1e-6, atol=1e-14)
        gram = orthogonal @ orthogonal.T
        assert np.abs(gram - np.diag(np.diag(gram))).max() <= 1e-13 * np.abs(gram).max()


def test_kernels_keep_their_source():
    B = np.array([[1.0, 2.0], [0.0, 1.0], [3.0, -1.0]])
    for fast, slow in zip(factor(B.T.copy()), factor.py_func(B.T.copy()), strict=True):
        assert np.allclose(fast, slow, atol=1e-14)


def test_a_kernel_whose_folder_cannot_be_written_is_cached_for_the_user(tmp_path):
    """The second process finds what the first one compiled."""
    package = tmp_path / "package"
    package.mkdir()
    (package / "kernel.py").write_text(DOUBLE)
    (package / "__pycache__").write_text("no folder")  # which stops even root
    for cached in ("0", "1"):
        assert run_double(package, XDG_CACHE_HOME=str(tmp_path)) == ["4.0", cached]
    (file,) = tmp_path.rglob("*.kernel")
    assert package not in file.parents


# as Numba finds it in a read-only folder; permissions do not stop root
READ_ONLY = """import numba.core.caching as c
def refuse(self): raise PermissionError("read-only")
c.{}.ensure_cache_path = refuse
"""


@pytest.mark.parametrize("locator", ["InTreeCacheLocator", "_CacheLocator"])
def test_kernels_beside_a_source_that_cannot_be_written_are_read(tmp_path, locator):
    """Those of a container's image, also where no folder at all can be written."""
    package, home = tmp_path / "package", tmp_path / "home"
    package.mkdir()
    (package / "kernel.py").write_text(DOUBLE)
    assert run_double(package) == ["4.0", "0"]
    (file,) = tmp_path.rglob("*.kernel")
    made = file.stat().st_mtime_ns
    (package / "kernel.py").write_text(DOUBLE)
    (package / "start.py").write_text(READ_ONLY.format(locator) + "import kernel\n")
    for _ in range(2):
        assert run_double(package, "start", XDG_CACHE_HOME=str(home)) == ["4.0", "1"]
    assert list(tmp_path.rglob("*.kernel")) == [file]
    assert file.stat().st_mtime_ns == made


def test_a_read_only_installation_still_compiles(tmp_path):
    (tmp_path / "kernel.py").write_text(READ_ONLY.format("_CacheLocator") + DOUBLE)
    for _ in range(2):
        assert run_double(tmp_path) == ["4.0", "0"]
    assert list(tmp_path.rglob("*.kernel")) == []


def test_a_closure_is_compiled_and_not_cached(tmp_path):
    """Two kernels with one source may differ in their closure."""
    (tmp_path / "kernel.py").write_text(
        "from softdyn.compiled import compiled\ndef times(factor):\n"
        "    @compiled\n    def scale(x):\n        return factor * x\n    return scale\n"
        "print(times(2.0)(2.0), times(3.0)(2.0))\n"
    )
    for _ in range(2):
        assert run_double(tmp_path) == ["4.0", "6.0"]


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_construction_compiles_everything(name):
    """The first step of a control loop must not wait for a compiler."""
    which = "spirob"
    cases = (*drawn(which, 2), *recorded(which, 2))  # these run a controller of their own
    controller = CONTROLLERS[name](robot(which))
    compiled_before = _signatures()
    for case in cases:
        controller(*case)
    assert _signatures() == compiled_before
    assert controller.guard.fallbacks == 0


def _signatures() -> int:
    import gc

    dispatcher = softdyn.compiled.numba.core.registry.CPUDispatcher
    return sum(len(o.signatures) for o in gc.get_objects() if type(o) is dispatcher)


def test_a_changed_helper_in_another_file_is_compiled_again(tmp_path):
    """Numba's own cache only checks the file of the outer kernel."""
    (tmp_path / "outer.py").write_text(
        "from inner import inner\nfrom softdyn.compiled import compiled\n"
        "@compiled\ndef outer(x):\n    return inner(x)\nprint(outer(2.0))\n"
    )
    helper = "from softdyn.compiled import compiled\n@compiled\ndef inner(x):\n    return {} * x\n"
    for factor_, cached in ((3, 0), (3, 1), (5, 0)):
        (tmp_path / "inner.py").write_text(helper.format(factor_))
        program = "import outer; print(len(outer.outer.stats.cache_hits))"
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        shown = subprocess.run(
            [sys.executable, "-c", program],
            cwd=tmp_path, env=environment, check=True, capture_output=True, text=True,
        ).stdout.split()  # fmt: skip
        assert shown == [f"{2.0 * factor_}", str(cached)]


def test_a_full_disk_costs_the_cache_alone(tmp_path):
    (tmp_path / "kernel.py").write_text(
        "import resource\nfrom softdyn.compiled import compiled\n"
        "@compiled\ndef double(x):\n    return 2 * x\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (16, 16))\nprint(double(2.0))\n"
    )
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    program = [sys.executable, "-c", "import kernel"]
    for _ in range(2):  # leftovers of the first process must not disturb the second
        done = subprocess.run(
            program, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout, done.stderr) == (0, "4.0\n", "")


DOUBLE = (
    "from softdyn.compiled import compiled\n@compiled\ndef double(x):\n    return 2 * x\n"
    "print(double(2.0), len(double.stats.cache_hits))\n"
)


def run_double(folder, module="kernel", **environment):
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **environment}
    done = subprocess.run(
        [sys.executable, "-c", f"import {module}"],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_a_damaged_cache_is_made_anew(tmp_path, capsys):
    (tmp_path / "kernel.py").write_text(DOUBLE)

    def run():  # as a new process, but for Numba's start
        runpy.run_path(str(tmp_path / "kernel.py"), {"__name__": "kernel"}, "kernel")
        return capsys.readouterr().out.split()

    assert run() == ["4.0", "0"]
    assert run() == ["4.0", "1"]
    (file,) = tmp_path.rglob("*.kernel")
    whole = file.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    for damaged in (b"", whole[:10], whole[:middle], b"\x80garbage" * 99, flipped, whole + b"x"):
        file.write_bytes(damaged)
        assert run() == ["4.0", "0"]
        assert run() == ["4.0", "1"]
    assert list(tmp_path.rglob("*.kernel")) == [file]
    file.unlink()
    file.mkdir()
    assert run() == ["4.0", "0"]


def test_another_numba_only_loses_the_cache(tmp_path):
    """A Numba version whose caching has other classes."""
    hide = "import numba.core.caching as c\ndel c.CompileResultCacheImpl\n"
    (tmp_path / "kernel.py").write_text(hide + DOUBLE)
    assert run_double(tmp_path) == ["4.0", "0"]
    assert list(tmp_path.rglob("*.kernel")) == []


def test_numba_may_be_switched_off(tmp_path):
    code = (
        "import numpy as np, softdyn\nfrom softdyn.controllers import SoftIdClfQp\n"
        "model = softdyn.load('finger')\nlaw = SoftIdClfQp(model)\n"
        "state = model.state([0.1, 0.2, 0.1, 0.3], np.zeros(4))\n"
        "print(*law(state, softdyn.SetPoint([0.15, 0, -0.15])).u)\n"
    )
    (tmp_path / "kernel.py").write_text(code)
    plain, fast = ([float(x) for x in run_double(tmp_path, NUMBA_DISABLE_JIT=off)] for off in "10")
    assert plain == pytest.approx(fast, rel=1e-7)


@pytest.mark.skipif(not softdyn.compiled.COMPILES, reason="nothing is compiled")
def test_an_interruption_waits_for_the_compiler() -> None:
    """Otherwise it would interrupt Numba's callbacks: a traceback, or a kernel without code."""
    listener = softdyn.compiled.announce_compilation()
    event, foreign = (
        SimpleNamespace(data={"dispatcher": SimpleNamespace(py_func=SimpleNamespace(__module__=m))})
        for m in ("softdyn.x", "other.x")
    )
    before = signal.getsignal(signal.SIGINT)
    for _ in range(2):  # kernels compile the kernels that they call
        listener.on_start(event)
    listener.on_start(foreign)
    signal.raise_signal(signal.SIGINT)
    listener.on_end(foreign)
    listener.on_end(event)
    with pytest.raises(KeyboardInterrupt):
        listener.on_end(event)
    assert signal.getsignal(signal.SIGINT) == before
    listener.on_start(event)
    listener.on_end(event)  # and the warning appears once


class Later:
    """A timer that a test lets run out."""

    def __init__(self, delay, function):
        self.delay, self.function, self.waits, self.daemon = delay, function, False, False
        LATER.append(self)

    def start(self):
        self.waits = True

    def cancel(self):
        self.waits = False


LATER = []


def test_the_notice_is_said_once_on_a_machine_and_then_after_seconds(monkeypatch, capsys):
    """Later kernels are announced only where they take long."""
    dispatcher = SimpleNamespace(py_func=SimpleNamespace(__module__="softdyn.x"))
    event = SimpleNamespace(data={"dispatcher": dispatcher})
    clock = [0.0]
    monkeypatch.setattr(softdyn.compiled, "say_once", SAY_ONCE)
    monkeypatch.setattr(softdyn.compiled, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(softdyn.compiled.threading, "Timer", Later)
    for kept in (False, True):
        SAY_ONCE.cache_clear()
        monkeypatch.setattr(softdyn.compiled, "some_are_kept", lambda kept=kept: kept)
        listener = softdyn.compiled.announce_compilation.__wrapped__()
        softdyn.compiled.numba.core.event.unregister("numba:compile", listener)
        for spent in (0.0, 1.5):
            listener.on_start(event)
            waiting = [one.delay for one in LATER if one.waits]
            assert waiting == ([softdyn.compiled.PATIENCE - spent] if kept else [])
            clock[0] += 1.5
            listener.on_end(event)
            assert not any(one.waits for one in LATER)
        said = capsys.readouterr().err
        assert said.count("softdyn: compiling ") == (not kept)
        assert ("once on this machine" in said) == (not kept)
    LATER[-1].function()
    assert "compiling more of its kernels" in capsys.readouterr().err
