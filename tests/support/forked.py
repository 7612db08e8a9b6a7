"""A command in a process of its own, a fork of this one: it need not import softdyn again.

The processor time of a new interpreter is 2 to 5 s, that of a fork is 0.1 s. A test of what an
interpreter does before the command begins, such as closed streams, needs a new one.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Mapping
from functools import partial
from typing import Any

from softdyn.commands.__main__ import main

TEMPORARY = os.path.realpath(tempfile.gettempdir())


def forked(*words: object, env: Mapping[str, str] | None = None, **more: Any) -> subprocess.Popen:
    """Start ``softdyn WORD …``, with more variables in its environment.

    Parameters
    ----------
    *words : object
    env : mapping, optional
    **more
        Arguments of `subprocess.Popen`: pipes and the folder.
    """
    work = partial(_work, [str(word) for word in words], dict(env or {}))
    # the work never returns, so that no other program replaces the fork
    return subprocess.Popen([sys.executable], preexec_fn=work, text=True, **more)


def _work(words: list[str], env: Mapping[str, str]) -> None:
    code = 1
    try:
        faulthandler.disable()  # its file is closed now
        os.closerange(3, os.sysconf("SC_OPEN_MAX"))  # Popen waits until one of these is closed
        gc.freeze()  # a collection of all that the fork inherits would hold the loop up
        gc.enable()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.stdin = os.fdopen(0, closefd=False)
        sys.stdout, sys.stderr = (
            os.fdopen(number, "w", encoding="utf-8", buffering=1, closefd=False)
            for number in (1, 2)
        )
        warnings.resetwarnings()
        for quiet in (DeprecationWarning, ImportWarning, ResourceWarning):  # as in a new one
            warnings.simplefilter("ignore", quiet)
        warnings.showwarning = _show
        warnings._showwarnmsg_impl = lambda said: _show(said.message, said.category)
        os.environ.update(env)
        tempfile.tempdir = None  # the environment may name another one
        sys.path.insert(0, os.getcwd())
        for name, module in list(sys.modules.items()):  # users' files, which may be others now
            file = os.path.realpath(getattr(module, "__file__", None) or "/")
            if file.startswith(TEMPORARY) or name.startswith("softdyn.examples."):
                del sys.modules[name]
        code = main(words)
    except SystemExit as stop:
        code = int(stop.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except OSError:
                code = code or 1
        os._exit(code)


def _show(message: Any, category: type[Warning], *_: object) -> None:
    sys.stderr.write(warnings.formatwarning(message, category, "", 0))
