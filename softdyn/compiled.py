"""Small numeric kernels, compiled by Numba where it is installed.

A kernel is an ordinary function on arrays in the part of NumPy that Numba knows. Without Numba, or
with ``SOFTDYN_COMPILE=0`` in the environment, the same source runs as it stands: that is the oracle
of the compiled one.

Compilation happens once, at a kernel's first call, and is announced on stderr; its result is cached
beside the source or, in a read-only installation, in the user's cache folder.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache, update_wrapper
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


def plainly(plain: Callable[..., Any]) -> Callable[[Kernel], Kernel]:
    """`compiled`, but `plain` runs where nothing is compiled: NumPy's calls instead of loops."""

    def choose(function: Kernel) -> Kernel:
        return compiled(function) if COMPILES else plain  # type: ignore[return-value]

    return choose


def compiled(function: Kernel) -> Kernel:
    """`function` compiled at its first call, or itself; ``.py_func`` is the source either way."""
    if numba is None:
        function.py_func = function  # type: ignore[attr-defined]
        return function
    options = {"error_model": "numpy", "nogil": True}
    try:
        kernel = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # nowhere to write a cache
        kernel = numba.njit(**options)(function)
    kernel._compiler.compile = announced(kernel._compiler.compile)
    return kernel


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
