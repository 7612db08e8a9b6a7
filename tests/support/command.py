"""Run a command as `softdyn NAME …` or `python -m tests.proof NAME …`, in this process.

A new process takes seconds to start.
"""

from __future__ import annotations

import io
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from softdyn.commands import __main__ as softdyn
from softdyn.commands import cli
from softdyn.validation.bench import supervisor
from tests.proof import __main__ as programs


class Done(NamedTuple):
    """The result of a command."""

    code: int
    out: str
    err: str


@contextmanager
def left_as_it_was() -> Iterator[None]:
    """Restore the settings that a command changes for the rest of its process."""
    with (
        patch.object(cli, "one_thread"),
        patch.object(supervisor, "supervised", lambda work, *codes: work()),
        patch.object(warnings, "formatwarning", warnings.formatwarning),
    ):
        hears = signal.getsignal(signal.SIGINT)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, hears)


def of_itself(err: str) -> str:
    """A process' text on stderr, without the notice of a cold cache."""
    return "".join(
        line for line in err.splitlines(True) if not line.startswith("softdyn: compiling ")
    )


def command(*words: object, cwd: Path | str = ".") -> Done:
    """Run a command in the folder `cwd`."""
    return _run(softdyn.main, words, cwd)


def proof(*words: object, cwd: Path | str = ".") -> Done:
    """Run a program of the proof in the folder `cwd`."""
    return _run(programs.main, words, cwd)


def _run(main: Callable[[list[str]], int], words: Sequence[object], cwd: Path | str) -> Done:
    out, err = io.StringIO(), io.StringIO()
    with chdir(cwd), left_as_it_was(), redirect_stdout(out), redirect_stderr(err):
        try:
            code = main([str(word) for word in words])
        except SystemExit as stop:
            code = int(stop.code or 0)
    return Done(code, out.getvalue(), err.getvalue())
