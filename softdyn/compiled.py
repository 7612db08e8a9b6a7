"""Small numeric kernels, compiled by Numba if it is installed.

A kernel is an ordinary function on arrays in the part of NumPy that Numba knows. Without Numba, or
with ``SOFTDYN_COMPILE=0`` in the environment, Python runs the same source. Tests compare the two.

A kernel is compiled once, at its first call, and a line on stderr announces it. The result is
cached beside the source. In a read-only installation the results beside the source are read, and
new ones are cached in the user's cache folder. A kernel is compiled again when any kernel of the
package changes, because kernels may be inlined in others.
"""

from __future__ import annotations

import glob
import hashlib
import os
import pickle
import secrets
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from multiprocessing import current_process
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def _numba() -> Any:
    if os.environ.get("SOFTDYN_COMPILE", "1") == "0":
        return None
    try:
        import numba
    except ImportError:
        return None
    return None if getattr(numba.config, "DISABLE_JIT", 0) else numba  # NUMBA_DISABLE_JIT=1


numba = _numba()
COMPILES = numba is not None
CACHES: list[KernelCache] = []
PATIENCE = 2.0  # s of compiling without a message, if some kernels are compiled already


def compiled_or(plain: Callable[..., Any], *, reorder: bool = False) -> Callable[[Kernel], Kernel]:
    """Like `compiled`; but without Numba run `plain`, which calls NumPy instead of loops."""

    def choose(function: Kernel) -> Kernel:
        if COMPILES:
            return compiled(function, reorder=reorder)
        return plain  # type: ignore[return-value]

    return choose


def compiled(function: Kernel, *, reorder: bool = False, inline: bool = False) -> Kernel:
    """Compile `function` at its first call; without Numba return it. ``.py_func`` is its source.

    `reorder` lets the compiler add the terms of a sum in another order, several at once, and round
    a product and a sum together. NaN and infinities keep their meaning. `inline` copies the
    function into the kernels that call it.
    """
    if numba is None:
        function.py_func = function  # type: ignore[attr-defined]
        return function
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
    if inline:
        options["inline"] = "always"
    if reorder:
        options["fastmath"] = {"reassoc", "contract"}
    announce_compilation()
    kernel = numba.njit(**options)(function)
    # for a closure, or without these classes of Numba, every process compiles the kernel
    with suppress(RuntimeError, AttributeError):
        kernel._cache = KernelCache(function)
        CACHES.append(kernel._cache)
    return kernel


class KernelCache:
    """A cache of one kernel's compiled signatures, in a file with a checksum.

    Numba's dispatchers use it in place of `numba.core.caching.FunctionCache`. Numba's own cache has
    three defects here. It checks only the kernel's own source file, so it keeps outdated code that
    was inlined from other files. It has no checksum, so a damaged file leads to an error or to
    wrong code. It ignores the files beside the source if their folder is not writable.

    Parameters
    ----------
    function : Callable
        The kernel's source.

    Attributes
    ----------
    writable : bool
        Whether there is a folder for new results.

    Raises
    ------
    RuntimeError
        For a closure, because the source does not hold its values.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        if function.__closure__ is not None:
            raise RuntimeError("a kernel with a closure is not cached")
        form, beside = _numba_forms()
        self._form = form(function)
        locator = self._form.locator
        self.cache_path, self.writable = locator.get_cache_path(), not isinstance(locator, beside)
        self._stem = self._form.filename_base
        file = Path(function.__code__.co_filename)
        name = f"{self._stem}-{kernel_sources(file)[:16]}.kernel"
        self._path = Path(self.cache_path, name)
        self._beside = file.parent / "__pycache__" / name

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The compiled signature, ready to be called; None if none was saved."""
        context.refresh()
        key = signature, context.codegen().magic_tuple()
        for path in dict.fromkeys((self._path, self._beside)):
            if (found := _read(path).get(key)) is not None:
                return self._form.rebuild(context, found)
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Save a signature; do nothing if the disk refuses."""
        if not self.writable or not self._form.check_cachable(result):
            return
        new = {(signature, result.codegen.magic_tuple()): self._form.reduce(result)}
        content = numba.core.serialize.dumps(_read(self._path) | new)
        part = self._path.with_name(f"{self._path.name}.{secrets.token_hex(8)}")
        with suppress(OSError):
            try:
                part.write_bytes(hashlib.sha256(content).digest() + content)
                part.replace(self._path)
            finally:
                part.unlink(missing_ok=True)
            for old in self._path.parent.glob(f"{glob.escape(self._stem)}-*.kernel"):
                if old != self._path:
                    old.unlink(missing_ok=True)

    @property
    def has_neighbours(self) -> bool:
        """Whether the cache already holds a kernel of the same sources."""
        end = f"*{self._path.name.removeprefix(self._stem)}"
        return any(any(path.parent.glob(end)) for path in (self._path, self._beside))

    def flush(self) -> None:
        """Delete the cache file."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)


def _read(path: Path) -> dict[Any, Any]:
    """The compiled signatures in a file; none if it is missing or damaged."""
    with suppress(OSError):
        content = path.read_bytes()
        if hashlib.sha256(content[32:]).digest() == content[:32]:
            found: dict[Any, Any] = pickle.loads(content[32:])
            return found
    return {}


@cache
def _numba_forms() -> tuple[Any, Any]:
    """Numba's form of compiled results, and its locator where no folder is writable."""
    caching = numba.core.caching

    class Beside(caching.InTreeCacheLocator):  # type: ignore[name-defined]
        """The folder beside the source, writable or not."""

        def ensure_cache_path(self) -> None:
            pass

    class Form(caching.CompileResultCacheImpl):  # type: ignore[name-defined]
        _locator_classes = (*caching.CompileResultCacheImpl._locator_classes, Beside)

    return Form, Beside


def kernel_sources(file: Path) -> str:
    """A digest of Numba's version and of all modules whose kernels this file may call."""
    package = Path(__file__).parent
    beside = file.resolve().parent
    ours = [(package / room).resolve() for room in ("dynamics", "estimation", "controllers")]
    inside = any(beside.is_relative_to(folder) for folder in ours)
    return _digest(tuple(ours) if inside else (beside,))


@cache
def _digest(folders: tuple[Path, ...]) -> str:
    files = [Path(__file__), *(f for folder in folders for f in sorted(folder.rglob("*.py")))]
    texts = (file.read_bytes() for file in files)
    sources = b"\0".join(text for text in texts if b"compiled" in text)
    return hashlib.sha256(numba.__version__.encode() + sources).hexdigest()


@cache
def announce_compilation() -> Any:
    """Print a line when Numba compiles one of our kernels; a cache hit prints nothing.

    Ctrl-C takes effect after the compilation: inside Numba it would end in a traceback, or leave
    half a kernel.
    """

    class Listener(numba.core.event.Listener):  # type: ignore[name-defined]
        running, interrupted = 0, False
        spent = began = 0.0
        later: threading.Timer | None = None
        before: Any = None

        def ours(self, event: Any) -> bool:
            module: str = event.data["dispatcher"].py_func.__module__
            return module.startswith("softdyn.")

        def on_start(self, event: Any) -> None:
            if not self.ours(event):
                return
            known = some_are_kept()
            if not known:
                say_once()
            if threading.current_thread() is threading.main_thread():  # others cannot set handlers
                if not self.running:
                    self.before = signal.signal(signal.SIGINT, self.note)
                    self.began = perf_counter()
                    if known:  # a few more kernels rarely take long
                        self.later = threading.Timer(max(PATIENCE - self.spent, 0), say_once)
                        self.later.daemon = True
                        self.later.start()
                self.running += 1

        def note(self, *_: object) -> None:
            self.interrupted = True

        def on_end(self, event: Any) -> None:
            if not self.ours(event) or threading.current_thread() is not threading.main_thread():
                return
            self.running -= 1
            if not self.running:
                self.spent += perf_counter() - self.began
                if self.later is not None:
                    self.later.cancel()
                signal.signal(signal.SIGINT, self.before or signal.SIG_DFL)
                if self.interrupted:
                    self.interrupted = False
                    signal.raise_signal(signal.SIGINT)

    listener = Listener()
    numba.core.event.register("numba:compile", listener)
    return listener


@cache
def some_are_kept() -> bool:
    """Whether a kernel was compiled before this process; only the first call looks."""
    return any(cache.has_neighbours for cache in CACHES)


@cache
def say_once() -> None:
    """Say why the program pauses; only one of many processes says it."""
    if sys.stderr is None or not current_process().name.endswith(("MainProcess", "-1")):
        return
    what = "its kernels, in every process: no folder is writable"
    if any(cache.writable for cache in CACHES):
        what = (
            "its kernels, once on this machine: some seconds for a controller, a minute for all "
            "(`softdyn compile` does it beforehand)"
        )
    if some_are_kept():
        what = "more of its kernels, needed here for the first time"
    print(f"softdyn: compiling {what}", file=sys.stderr, flush=True)
