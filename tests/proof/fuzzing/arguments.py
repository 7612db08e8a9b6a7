"""Damaged command lines, run in this process as a user would run them.

A base is a working command line, in a folder with the files that it names. An input is the base
after one to three changes of its words. A command must either succeed and write every requested
file, or report the error in one line and write no file. A slow command is interrupted as by Ctrl-C
and must end at once. Commands that run for minutes or open servers only read their arguments.
"""

from __future__ import annotations

import importlib
import json
import os
import random
import re
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.proof.fuzzing import campaign
from tests.proof.fuzzing.verdict import (
    ACCEPTED,
    EXCEPTION,
    LONGEST_MESSAGE,
    LOST,
    MESSAGE,
    REFUSED,
    Verdict,
)

# s of processor time and of wall clock until an interrupt; the latter for a pipe that nobody reads
PATIENCE, WAITING = 0.7, 10.0
OUTPUTS = ("json", "log", "html", "mjcf", "urdf", "out", "plot", "markdown")
ENDS = (0, 1, 2, 130)  # defined exit codes
WORDS = (
    "", "-", "--", "-1", "0", "-0.0", "nan", "inf", "-inf", "1e999", "1e-320", "1e308", "9" * 5000,
    "0x10", "1_000", " 1", "1.5", "１", "٣", "½", "true", "a\nb", "x" * 5000, "\udcff", "%s", "{0}",
    "..", ".", "/", "/dev/null", "/dev/full", "/dev/stdout", "/nonexistent/x", "down/x.json",
    "folder", "pipe", "arm.urdf", "log.npz", "gains.toml", "mine.py", "mine.py:Leaves",
    "mine.py:Odd", "mine.py:", ":", "finger", "finger.urdf", "none.urdf", "best", "mpc", "ic",
    "--help", "--json", "--json=", "--floating", "--theta", "@file", "🦾", "C:\\x",
)  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A command line that works.

    Attributes
    ----------
    module : str
        Module of the command, with `parser` and `main`.
    words : tuple of str
    files : mapping
        Name → content of the files in the folder where it runs.
    runs : bool
        Whether it runs; otherwise it only reads its arguments.
    options : tuple of str
        Options that a change may add.
    """

    module: str
    words: tuple[str, ...]
    files: Mapping[str, bytes] = field(default_factory=dict)
    runs: bool = False
    options: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the command."""
        return self.module.rpartition(".")[2]


def mutant(bases: Sequence[Line], seed: int, index: int) -> tuple[Line, list[str]]:
    """The input number `index` of a seed; independent of all others."""
    rng = random.Random(f"{seed}:{index}")
    line = rng.choices(bases, [2 if base.runs else 1 for base in bases])[0]
    words = list(line.words)
    for _ in range(rng.choice((1, 1, 2, 3))):
        change(rng, words, line.options)
    return line, [word.replace("\0", "") for word in words]  # no argument has a zero byte


def change(rng: random.Random, words: list[str], options: Sequence[str]) -> None:
    """Replace, damage, delete, double, swap or join words, or add an option."""
    at = rng.randrange(len(words) + 1)
    kind = rng.randrange(9)
    if kind == 0 and options:
        words[at:at] = [rng.choice(options), rng.choice(WORDS)][: rng.choice((1, 2))]
    elif at == len(words) or kind == 1:
        words.insert(at, rng.choice(WORDS))
    elif kind == 2:
        del words[at]
    elif kind == 3:
        words.insert(at, words[at])
    elif kind == 4:
        other = rng.randrange(len(words))
        words[at], words[other] = words[other], words[at]
    elif kind == 5:
        words[at : at + 2] = ["=".join(words[at : at + 2])]
    elif kind == 6 and words[at]:
        cut = rng.randrange(len(words[at]))
        words[at] = words[at][:cut] + rng.choice(("", "e", "-", ".", "\xff")) + words[at][cut + 1 :]
    else:
        words[at] = rng.choice(WORDS)


def judge(line: Line, words: Sequence[str], folder: Path) -> Verdict:
    """Run a line in a new folder, and look for errors."""
    (folder / "folder").mkdir(parents=True)
    for name, content in line.files.items():
        (folder / name).write_bytes(content)
    os.mkfifo(folder / "pipe")
    os.chdir(folder)
    before = _files(folder)
    code, said = _run(line, list(words))
    if isinstance(code, str):
        return Verdict(EXCEPTION, f"{line.name}: {code}"[:500])
    lines = [text for text in said.splitlines() if not text.startswith("warning: ")]
    if "Traceback" in said or code not in ENDS:
        return Verdict(EXCEPTION, f"{line.name}: code {code}: {said}"[-500:])
    after = _files(folder)
    if code == 2:
        message = lines[0] if lines else ""
        one = len(lines) == 1 and message.startswith("error: ")
        if not one or len(message) > LONGEST_MESSAGE:
            return Verdict(MESSAGE, f"{line.name}: {said}"[:500])
        if after != before:
            return Verdict(LOST, f"{line.name}: refused, but wrote {set(after) ^ set(before)}")
        expected = re.sub(r"'[^']*'|\d+", "…", message.partition("expected ")[2] or message[7:])
        return Verdict(REFUSED, f"{line.name} {expected.partition(', got ')[0]}"[:100])
    lost = _lost(line, words) if code == 0 and line.runs and said != "help" else ""
    return Verdict(LOST, f"{line.name}: {lost}"[:500]) if lost else Verdict(ACCEPTED)


def _files(folder: Path) -> dict[str, int]:
    """Sizes of the files in a folder."""
    return {str(p.relative_to(folder)): p.stat().st_size for p in folder.rglob("*") if p.is_file()}


def _run(line: Line, words: list[str]) -> tuple[int | str, str]:
    """Exit code of a line, or its exception, and its text on stderr."""
    module = importlib.import_module(line.module)
    kept, said = [os.dup(number) for number in (1, 2)], Path("../said").resolve()
    outputs = [os.open(os.devnull, os.O_WRONLY), os.open(said, os.O_RDWR | os.O_CREAT | os.O_TRUNC)]
    streams, handler = (sys.stdout, sys.stderr), signal.getsignal(signal.SIGINT)
    try:
        for number, output in enumerate(outputs, 1):
            os.dup2(output, number)
            os.close(output)
        sys.stdout, sys.stderr = (
            os.fdopen(os.dup(n), "w", encoding="utf-8", errors="backslashreplace") for n in (1, 2)
        )
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGVTALRM, lambda *_: signal.raise_signal(signal.SIGINT))
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
        signal.setitimer(signal.ITIMER_VIRTUAL, PATIENCE)
        signal.setitimer(signal.ITIMER_REAL, WAITING)
        code: int | str = module.main(words) if line.runs else _read(module.parser, words)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else f"exit with {end.code!r}"
        if code == 0:
            return 0, "help"
    except BaseException as error:
        code = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGINT, handler)
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.close()
        sys.stdout, sys.stderr = streams
        for number, output in enumerate(kept, 1):
            os.dup2(output, number)
            os.close(output)
    return code, said.read_text("utf-8", "replace")


def _read(parser: Any, words: list[str]) -> int:
    parser.parse_args(words)
    return 0


def _lost(line: Line, words: Sequence[str]) -> str:
    """A requested file that a command has not written."""
    asked = vars(importlib.import_module(line.module).parser.parse_args(words))
    for name in OUTPUTS:
        target = asked.get(name)
        if not target or str(target) == "-":
            continue
        path = Path(target)
        if path.is_relative_to("/dev"):  # the streams of this process may be files
            continue
        if not path.exists():
            return f"--{name} {target} is not there"
        if path.is_file() and not path.stat().st_size:
            return f"--{name} {target} is empty"
        if name == "json" and path.is_file():
            json.loads(path.read_bytes())
    return ""


# -- the campaign ------------------------------------------------------------------------------


def kept(bases: Sequence[Line], seed: int, index: int) -> tuple[str, bytes]:
    """Name and content of an input, for a folder of findings."""
    line, words = mutant(bases, seed, index)
    return f"{line.name}.json", json.dumps(words).encode()


def work(pipe: Any, bases: Sequence[Line], seed: int) -> None:
    """Judge inputs by their numbers: a process of `campaign.in_a_process`."""
    with TemporaryDirectory() as name:

        def in_a_folder(index: int) -> Any:
            with TemporaryDirectory(dir=name) as folder:
                try:
                    return judge(*mutant(bases, seed, index), Path(folder) / "here")
                finally:
                    os.chdir(name)

        for number, line in enumerate(bases):  # load kernels and modules before any clock runs
            judge(line, line.words, Path(name) / f"first-{number}" / "here")
        os.chdir(name)
        campaign.serve(pipe, in_a_folder)
