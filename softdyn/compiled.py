"""Small numeric kernels, compiled by Numba where it is installed.

A kernel is an ordinary function on arrays in the part of NumPy that Numba knows. Without Numba, or
with ``SOFTDYN_COMPILE=0`` in the environment, the same source runs as it stands: that is the oracle
of the compiled one.

Compilation happens once, at a kernel's first call, and is announced on stderr; its result is cached
beside the source or, in a read-only installation, in the user's cache folder. It is compiled again
when any kernel of the package changes, not only when its own file does.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, update_wrapper
from pathlib import Path
from typing import Any, TypeVar

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def _numba() -> Any:
    if os.environ.get("SOFTDYN_COMPILE", "1") == "0":
        return None
    try:
        import numba
    except ImportError:
        return None
    return numba


numba = _numba()
COMPILES = numba is not None


def compiled_or(plain: Callable[..., Any], *, reorder: bool = False) -> Callable[[Kernel], Kernel]:
    """`compiled`, but `plain` runs where nothing is compiled: NumPy's calls instead of loops."""

    def choose(function: Kernel) -> Kernel:
        if COMPILES:
            return compiled(function, reorder=reorder)
        return plain  # type: ignore[return-value]

    return choose


def compiled(function: Kernel, *, reorder: bool = False) -> Kernel:
    """`function` compiled at its first call, or itself; ``.py_func`` is the source either way.

    `reorder` lets the compiler take the terms of a sum in another order, several at once, and
    round a product and a sum together. NaN and infinities remain what they are.
    """
    if numba is None:
        function.py_func = function  # type: ignore[attr-defined]
        return function
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True}
    if reorder:
        options["fastmath"] = {"reassoc", "contract"}
    try:
        kernel = numba.njit(cache=True, **options)(function)
        # Numba looks at a kernel's own file alone, and would keep what was inlined from others
        index = kernel._cache._cache_file
        folders = {Path(__file__).parent, Path(function.__code__.co_filename).parent}
        index._source_stamp = (index._source_stamp, *sorted(map(kernel_sources, folders)))
        index.save = optional(index.save)
    except RuntimeError:  # nowhere to write a cache
        kernel = numba.njit(**options)(function)
    kernel._compiler.compile = announced(kernel._compiler.compile)
    return kernel


def optional(save: Callable[..., None]) -> Callable[..., None]:
    """`save`, which gives up in silence where the disk does not let it: a cache is only a gain."""

    def save_or_not(*args: Any) -> None:
        with suppress(OSError):
            save(*args)

    return save_or_not


@cache
def kernel_sources(folder: Path) -> str:
    """A digest of the modules of a folder that hold kernels."""
    texts = (file.read_bytes() for file in sorted(folder.glob("*.py")))
    return hashlib.sha256(b"\0".join(text for text in texts if b"compiled" in text)).hexdigest()


def announced(compile_: Callable[..., Any]) -> Callable[..., Any]:
    """`compile_`, which says so the first time in a process that it has to work.

    Numba has no hook for it; what is found in a cache never gets here.
    """

    def compile_and_say(*args: Any, **options: Any) -> Any:
        say_once()
        return compile_(*args, **options)

    return update_wrapper(compile_and_say, compile_)


@cache
def say_once() -> None:
    """Tell a person at a terminal why nothing happens for a while."""
    if sys.stderr.isatty():
        print("softdyn: compiling its kernels, once (half a minute)…", file=sys.stderr, flush=True)
