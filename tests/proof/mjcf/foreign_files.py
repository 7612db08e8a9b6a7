"""Public robot files: read, exported, and compared in both engines, a row per file."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lxml import etree
from tqdm.auto import tqdm

from softdyn.exceptions import InputError, SoftdynError
from softdyn.loading import load
from softdyn.validation import crosscheck
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.mjcf.export import write_mjcf, write_urdf
from softdyn.validation.mjcf.mjcf_file import Contents
from softdyn.validation.mjcf.scene import Scene
from softdyn.validation.tables import Table, document

COMMAND = "python -m tests.proof public-files DIR … --markdown docs/public_files.md"
SAME = 1e-6  # relative: a larger difference of M, bias, g, B, K, D or q̈ is another motion
NO_MOTION = ("energy", "trajectory", "length")  # the scene has weights and tendons of its own


@dataclass(frozen=True)
class Row:
    """One file.

    Attributes
    ----------
    file : str
        Its path in its folder.
    code : int
        The exit code of its export: 2 if it is refused.
    said : str
        The verdict of the export, or the sentence of the refusal.
    lost : int
        How many properties the export lists as lost.
    worst, where : float or None, str
        The largest difference between the two engines, and its quantity or why there is none.
    """

    file: str
    code: int
    said: str
    lost: int = 0
    worst: float | None = None
    where: str = ""

    @property
    def passed(self) -> bool:
        """Whether no motion differs in silence."""
        return self.code != 0 or self.worst is None or self.worst <= SAME


@dataclass(frozen=True)
class Survey:
    """All files."""

    rows: tuple[Row, ...]

    @property
    def passed(self) -> bool:
        """Whether every file passed."""
        return all(row.passed for row in self.rows)

    @property
    def summary(self) -> str:
        """How many files there are of each kind."""
        equal, differ, refused = (sum(row.code == code for row in self.rows) for code in range(3))
        silent = sum(not row.passed for row in self.rows)
        return (
            f"{len(self.rows)} files: {equal} exported with exit code 0, {differ} with 1, {refused}"
            f" refused; {silent} with exit code 0 and another motion"
        )

    @property
    def table(self) -> Table:
        """A table with a row per file."""
        titles = ["file", "exit", "said", "lost", "worst", "in"]
        rows = [[r.file, r.code, r.said, r.lost, r.worst, r.where] for r in self.rows]
        return Table(titles, rows, ["", "d", "", "d", ".1e", ""])

    def to_dict(self) -> dict[str, Any]:
        """The survey as plain data."""
        return {"passed": self.passed, "rows": [asdict(row) for row in self.rows]}

    def document(self) -> str:
        """A document with the table."""
        return document(
            "# Public files",
            f"Made by `{COMMAND}`, in a checkout. Each MJCF is exported as a URDF, and each "
            "URDF as an MJCF.",
            "*exit* is the exit code of `softdyn export`: 1 means that the command names what "
            "differs. *lost* counts the properties that it lists. *worst* is the largest relative "
            "difference between the URDF in Pinocchio and the MJCF in MuJoCo at random states.",
            f"{self.summary}.",
            self.table.markdown(),
        )

    def __str__(self) -> str:
        return f"{self.table.text()}\n\n{self.summary}"


def survey(folders: Sequence[str], samples: int = 3, seed: int = 0) -> Survey:
    """Read and export every robot file below some folders.

    Parameters
    ----------
    folders : sequence of str
        Folders with public repositories.
    samples, seed : int
        Number of random states, and their seed.

    Raises
    ------
    InputError
        A folder does not exist, or contains no robot.
    """
    files = [(Path(one), path) for one in folders for path in _robots(Path(one))]
    if not files:
        raise InputError("DIR", "a folder with robots", ", ".join(folders))
    rows = []
    with tempfile.TemporaryDirectory() as out, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for root, path in tqdm(files, disable=None, leave=False):
            rows.append(_row(root, path, Path(out), samples, seed))
    return Survey(tuple(rows))


def _robots(root: Path) -> Iterator[Path]:
    """URDFs, MJCFs with a body or an included one, and files that are no XML."""
    for path in sorted(root.rglob("*")):
        if path.suffix.lower() not in (".urdf", ".xml") or not path.is_file():
            continue
        try:
            node = etree.parse(str(path)).getroot()
        except etree.XMLSyntaxError:
            yield path
            continue
        parts = node.iter("body", "include") if node.tag == "mujoco" else iter(())
        if node.tag == "robot" or next(parts, None) is not None:
            yield path


def _row(root: Path, path: Path, out: Path, samples: int, seed: int) -> Row:
    """Export one file and compare its engines."""
    name = str(Path(root.name) / path.relative_to(root))

    def spelt(error: SoftdynError) -> str:
        """Its sentence without the folders of this machine."""
        return str(error).replace(str(root.resolve()), "DIR").replace(f"{out}/", "")

    try:
        side = Side.of(path, Contents(root=root))
        target = out / ("robot.urdf" if side.is_mjcf else "robot.xml")
        write = write_urdf if side.is_mjcf else write_mjcf
        result, lost = write(path, target, shapes=False, root=root)
    except SoftdynError as error:
        return Row(name, 2, spelt(error))
    code = 0 if result.passed else 1
    try:
        pair = (target, side) if side.is_mjcf else (path, Side.of(target))
        worst, where = _engines(*pair, root, samples, seed)
    except SoftdynError as error:
        return Row(name, code, result.verdict, len(lost), None, f"not compared: {spelt(error)}")
    return Row(name, code, result.verdict, len(lost), worst, where)


def _engines(urdf: Path, side: Side, root: Path, samples: int, seed: int) -> tuple[float, str]:
    """The largest difference between a URDF in Pinocchio and an MJCF in MuJoCo."""
    floating = any(part.kind == "free" for part in side.neutral.parts)
    model = load(urdf, floating=floating, root=root)
    vars(side)["scene"] = side.compiled  # without contacts, whose meshes may be missing
    found = crosscheck(model, Scene(model, side), samples=samples, seed=seed, trajectories=False)
    worst = max(
        (check for check in found.checks if check.quantity not in NO_MOTION),
        key=lambda check: check.max_error,
    )
    return float(worst.max_error), worst.quantity
