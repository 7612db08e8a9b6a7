"""Damaged logs, stores, summaries and TOML files: refused in one line, or read correctly.

A base is a complete file of its kind. An input is the base after one to three changes, of its bytes
or of its content: a value of a JSON or TOML file, an entry or an array of an NPZ file. An accepted
file is read a second time by other means (`json`, `tomllib`, `numpy.load`). Content that the reader
lost is a finding. A store must return exactly the content that it wrote, or nothing.
"""

from __future__ import annotations

import io
import json
import random
import re
import tomllib
import warnings
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import softdyn
from softdyn import InputError, SetPoint, SoftdynError
from softdyn.controllers import SoftIdClfQp, schedule
from softdyn.description.task_mark import TaskMark
from softdyn.files import read_toml
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.simulate import simulate
from softdyn.validation.studies import sweep_file
from softdyn.validation.studies.engine import worker
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.store import Store
from softdyn.validation.studies.engine.worker import CaseResult
from tests.proof.fuzzing import campaign
from tests.proof.fuzzing.arm_table import ARM, read_arm
from tests.proof.fuzzing.inputs import changed_bytes
from tests.proof.fuzzing.verdict import (  # fmt: skip
    ACCEPTED,
    EXCEPTION,
    LONGEST_MESSAGE,
    LOST,
    MESSAGE,
    REFUSED,
    Verdict,
)

VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**63, 10**40, -0.0, 1e-320, 1e308, 123.456, float("nan"),
    float("inf"), "", "0.5", "x" * 5000, "a\nb", "\ud800", "\0", "../x", [], {}, [[1]], {"a": None},
)  # fmt: skip
TEXTS = (
    b"null", b"NaN", b"1e999", b"-Infinity", b"9" * 5000, b"[" * 10_000, b'{"a":' * 10_000, b"{}",
    b"[]", b'""', b"\xff\xfe", b"\0", b"", b"0x10", b"1_000", b"1979-05-27", b"inf", b"nan",
    b"123.456", b'"\\ud800"', b",", b":", b"=", b"\n[plant]\n", b"\nKp = 3\n",
)  # fmt: skip
SHAPED: tuple[tuple[int, ...], ...] = (
    (),
    (0,),
    (10**12,),
    (10**6, 10**6),
    (2**62, 4),
    (3, 3),
    (-1,),
)
DTYPES = ("<f8", ">f8", "<f4", "<i8", "<U5", "|b1", "|O", "<c16", "|S3")
SWEEP = """robots = ["finger"]
controllers = ["soft-id-clf-qp", "ic-qp"]
logs = true
[targets]
theta = [0, 0.5]
omega = { from = 0.1, to = 0.4, count = 3 }
[gains]
Kp = [100, 500]
eps = { from = 0.01, to = 0.1, count = 3, spacing = "log" }
[run]
duration = [0.5]
[plant]
contacts = [false, true]
"""
# writes the content of a damaged file to a folder, reads it, returns the lost content
Reader = Callable[[bytes, Path], str]


@dataclass(frozen=True)
class Kind:
    """A base file, the change of its content, and the reader that a user would call."""

    name: str
    base: bytes
    change: Callable[[random.Random, bytes], bytes]
    read: Reader


def kinds() -> list[Kind]:
    """A log, a store's result and step times, a sweep, a schedule, an arm."""
    model = softdyn.load("finger")
    law = SoftIdClfQp(model)
    log = simulate(model, law, SetPoint([0.1, 0.0, -0.1]), duration=0.02)
    log = log.altered(step_us=np.full(log.steps, 50.0))  # the same in every process
    (job,) = worker.jobs_of([Case("finger", "ic", "set_point", 0.5)])
    ended = CaseResult({"outcome": "done", "reason": None, "mse_cm2": 1.5, "failed": False},
                    step_us=log.step_times_us)  # fmt: skip
    toml = (schedule.FOLDER / "spirob.toml").read_bytes()
    with TemporaryDirectory() as name:
        folder = Path(name)
        log.save(folder / "log.npz")
        store = Store(folder, times="times")
        store.save(job, ended)
        result = store.result_path(job.name).read_bytes()
        times = (folder / "times" / f"{job.name}.json").read_bytes()
        npz = (folder / "log.npz").read_bytes()
    return [
        Kind("log.npz", npz, change_npz, read_log),
        Kind("result.json", result, change_json, Stored("runs", result)),
        Kind("times.json", times, change_json, Stored("times", times)),
        Kind("sweep.toml", SWEEP.encode(), change_text, read_sweep),
        Kind("schedule.toml", toml, change_text, read_schedule),
        Kind("arm.toml", ARM.encode(), change_text, read_arm),
    ]


def mutant(bases: Sequence[Kind], seed: int, index: int) -> tuple[Kind, bytes]:
    """The input number `index` of a seed, and its kind; independent of all other inputs."""
    rng = random.Random(f"{seed}:{index}")
    kind = rng.choices(bases, (4, 1, 1, 2, 2, 2))[0]
    data = kind.base
    for _ in range(rng.choice((1, 1, 2, 3))):
        data = rng.choice((kind.change, kind.change, changed_bytes))(rng, data)
    return kind, data


def judge(kind: Kind, data: bytes, folder: Path) -> Verdict:
    """Write an input, read it as a user would, and look for errors."""
    path = folder / kind.name
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            lost = kind.read(data, path)
            return Verdict(LOST, f"{kind.name}: {lost}"[:500]) if lost else Verdict(ACCEPTED)
    except SoftdynError as error:
        text = str(error)
        if len(text.splitlines()) != 1 or len(text) > LONGEST_MESSAGE:
            return Verdict(MESSAGE, text[:500])
        if str(path) not in text and kind.read is not read_schedule:
            return Verdict(MESSAGE, f"names no file: {text[:500]}")
        return Verdict(REFUSED, template(kind.name, text))
    except Exception as error:
        return Verdict(EXCEPTION, f"{kind.name}: {type(error).__name__}: {error}"[:500])


def template(name: str, text: str) -> str:
    """The text of a refusal without its variable parts."""
    expected = text.partition("expected ")[2].partition(", got ")[0]
    return re.sub(r"'[^']*'|\d+", "…", f"{name} expected {expected}")[:100]


# -- readers, and the content that they lost
# ---------------------------------------------------------------


def read_log(data: bytes, path: Path) -> str:
    """Read a log; it must equal NumPy's reading, also after it is saved again."""
    path.write_bytes(data)
    log = Log.load(path)
    with np.load(path) as file:
        about = json.loads(str(file["about"]))
        arrays = {name: file[name] for name in about["channels"]}
    log.report()
    log.summary()
    log.save(path)
    again = Log.load(path)
    for name, value in arrays.items():
        if not all(_same_bytes(getattr(read, name), value) for read in (log, again)):
            return name
    # a path is written relative to its folder, or as the name of a bundled file
    about["source"] = LoggedRobot(**about["source"] | {"path": log.source.path})
    about["marks"] = tuple(TaskMark.of(table) for table in about["marks"])
    about |= {name: np.array(about[name]) for name in ("u_min", "u_max")}
    for name in about.keys() - {"format", "channels"}:
        for read in (log, again):
            if repr(getattr(read, name)) != repr(about[name]):
                return name
    return ""


def _same_bytes(one: np.ndarray, other: np.ndarray) -> bool:
    return one.tobytes() == other.tobytes() and one.shape == other.shape


@dataclass(frozen=True)
class Stored:
    """Reads a store's file in `part`; it must equal the one in `base`, or count as missing."""

    part: str
    base: bytes

    def __call__(self, data: bytes, path: Path) -> str:
        """Read the file; return the lost content."""
        store = Store(path.parent, times="times")
        file = path.parent / self.part / path.name
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(data)
        ask = store.result if self.part == "runs" else store.step_times
        found = ask(path.stem)
        if found is None:
            raise InputError(str(path), "a result", "none")
        content = json.loads(self.base)
        del content["sha256"]
        return "" if repr(sorted(found.items())) == repr(sorted(content.items())) else "an edit"


def read_sweep(data: bytes, path: Path) -> str:
    """Read a sweep; it must have every robot, controller, target and parameter of the file."""
    path.write_bytes(data)
    sweep = sweep_file.read_sweep(path)
    table = tomllib.loads(data.decode())
    groups = {group: table.get(group, {}) for group in ("gains", "run", "plant", "rig")}
    said = {f"{group}.{name}" for group, values in groups.items() for name in values}
    said |= {"ellipse_scale"} & set(table)
    checks = {
        "robots": [*sweep.robots] == table["robots"],
        "controllers": [*sweep.controllers] == table["controllers"],
        "targets": {a.name for a in sweep.targets} == set(table["targets"]) - {"equilibria"},
        "changes": len(sweep.changes) > len(table.get("changes", {})),
        "axes": {axis.name for axis in sweep.axes} == said,
        "logs": sweep.logs is table.get("logs", False),
        "keys": set(table) <= {*sweep_file.KEYS},
    }
    for name, values in [*table["targets"].items(), *groups["gains"].items()]:
        if isinstance(values, list):
            axes = (*sweep.targets, *sweep.axes)
            (axis,) = (a for a in axes if a.name.rpartition(".")[2] == name)
            checks[name] = [*map(float, axis.values)] == [*map(float, values)]
    return ", ".join(name for name, right in checks.items() if not right)


def read_schedule(data: bytes, path: Path) -> str:
    """Read a schedule; it must have every number of the file."""
    path.write_bytes(data)
    table = read_toml(path)
    found = asdict(schedule.make_schedule(table))
    for name, value in table.items():
        if isinstance(value, dict):
            stage = found[name] | found[name]["gains"]
            if any(stage[key] != number for key, number in value.items()):
                return name
        elif found[name] != value:
            return name
    return ""


# -- changes of content ------------------------------------------------------------------------


def change_json(rng: random.Random, data: bytes) -> bytes:
    """Change a value, a name or the nesting of JSON; other files get another text."""
    try:
        content = json.loads(data)
        _change_tree(rng, content)
        return json.dumps(content, indent=2).encode()
    except (ValueError, TypeError, RecursionError):
        return change_text(rng, data)


def change_text(rng: random.Random, data: bytes) -> bytes:
    """Replace a word by one of `TEXTS` or by another word of the file; or double a line."""
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    if rng.random() < 0.2:
        return b"\n".join([*lines[:at], lines[at], lines[at], *lines[at + 1 :]])
    words = lines[at].split(b" ")
    new = rng.choice(TEXTS) if rng.random() < 0.7 else rng.choice(data.split() or [b""])
    words[rng.randrange(len(words))] = new
    return b"\n".join([*lines[:at], b" ".join(words), *lines[at + 1 :]])


def _change_tree(rng: random.Random, content: Any) -> None:
    """Change one place of nested lists and dictionaries."""
    places = _places(content)
    if not places:
        return
    parent, key = rng.choice(places)
    roll = rng.random()
    if roll < 0.15:
        del parent[key]
    elif roll < 0.3 and isinstance(parent, dict):
        parent[rng.choice(("x", "", key.upper() + "s"))] = parent.pop(key)
    elif roll < 0.4:
        other, name = rng.choice(places)
        parent[key] = json.loads(json.dumps(other[name]))
    elif roll < 0.6 and type(parent[key]) in (int, float):
        parent[key] *= rng.choice((-1, 0, 1.1, 1e3, 1e-3, 1e300))
    else:
        parent[key] = rng.choice(VALUES)


def _places(content: Any) -> list[tuple[Any, Any]]:
    keys = content if isinstance(content, dict) else range(len(content)) \
        if isinstance(content, list) else ()  # fmt: skip
    return [place for key in list(keys) for place in ((content, key), *_places(content[key]))]


def change_npz(rng: random.Random, data: bytes) -> bytes:
    """Change, remove or rename an entry, or write a false header; the file is written anew."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = {i.filename: archive.read(i) for i in archive.infolist() if i.file_size < 1e6}
    except Exception:  # damaged before
        return changed_bytes(rng, data)
    if not entries:
        return data
    name = rng.choice(["about.npy" if rng.random() < 0.4 else rng.choice([*entries])])
    content = entries.get(name, b"")
    roll = rng.random()
    if roll < 0.08:
        entries.pop(name, None)
    elif roll < 0.16:
        entries[rng.choice((*entries, "x.npy", "../x.npy", "t"))] = content
    elif roll < 0.3:
        entries[name] = _header(rng) + content[128:]
    else:
        entries[name] = _changed_array(rng, name, content)
    file = io.BytesIO()
    method = rng.choice((0, 8, 8, 8, 12, 14))
    with zipfile.ZipFile(file, "w") as archive:
        for entry, part in entries.items():
            # a fixed date, 1980, so that the bytes are reproducible
            archive.writestr(zipfile.ZipInfo(entry), part, method)
    return file.getvalue()


def _header(rng: random.Random) -> bytes:
    file = io.BytesIO()
    head = {"descr": rng.choice(DTYPES), "fortran_order": rng.random() < 0.3,
            "shape": rng.choice(SHAPED)}  # fmt: skip
    np.lib.format.write_array_header_1_0(file, head)
    return file.getvalue()


def _variants(array: np.ndarray) -> list[np.ndarray]:
    """The array in other shapes and types."""
    if not array.ndim or array.dtype.kind != "f":
        return [array[None], np.zeros(3)]
    shapes = [array[..., :-1], array.T, array[::-1], array[None], np.concatenate((array, array))]
    return [*shapes, *(array.astype(kind) for kind in ("U", ">f8", "f4"))]


def _changed_array(rng: random.Random, name: str, content: bytes) -> bytes:
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
        if name == "about.npy":
            about = json.loads(array.item())
            _change_tree(rng, about)
            array = np.array(json.dumps(about))
        elif array.dtype.kind == "f" and array.size and rng.random() < 0.7:
            array = array.copy()
            array.flat[rng.randrange(array.size)] = rng.choice(
                (0.0, -1.0, 1e-320, 1e300, np.nan, np.inf, -np.inf, 123.456)
            )
        else:
            array = rng.choice(_variants(array))
        file = io.BytesIO()
        np.lib.format.write_array(file, np.asarray(array), version=(1, 0), allow_pickle=False)
        return file.getvalue()
    except Exception:  # damaged before
        return changed_bytes(rng, content)


# -- the campaign ------------------------------------------------------------------------------


def kept(bases: Sequence[Kind], seed: int, index: int) -> tuple[str, bytes]:
    """Name and content of an input, for a folder of findings."""
    kind, data = mutant(bases, seed, index)
    return kind.name, data


def work(pipe: Any, bases: Sequence[Kind], seed: int) -> None:
    """Judge inputs by their numbers: a process of `campaign.in_a_process`."""
    with TemporaryDirectory() as name:
        campaign.serve(pipe, lambda index: judge(*mutant(bases, seed, index), Path(name)))
