"""Comparisons of public files of the same robots by different authors, a row per pair.

The URDFs are those of example-robot-data. The MJCFs are searched in folders that the user names,
because their repositories are large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softdyn.description.library import example_files
from softdyn.exceptions import InputError, SoftdynError
from softdyn.validation.mjcf.comparison.comparison import compare
from softdyn.validation.mjcf.comparison.result import Comparison
from softdyn.validation.tables import Table, document
from tests.proof.mjcf.reader_survey import Readers, survey_readers

# Ends of paths, in example-robot-data or in the user's folders.
PAIRS = (
    ("urdf/a1.urdf", "unitree_a1/a1.xml"),
    ("robots/anymal.urdf", "anybotics_anymal_b/anymal_b.xml"),
    ("anymal_c_simple_description/urdf/anymal.urdf", "anybotics_anymal_c/anymal_c.xml"),
    ("urdf/go1.urdf", "unitree_go1/go1.xml"),
    ("urdf/go2.urdf", "go2/go2.xml"),
    ("urdf/g1_29dof_rev_1_0.urdf", "g1/g1_29dof.xml"),
    ("urdf/g1_29dof_with_hand_rev_1_0.urdf", "unitree_g1/g1.xml"),
    ("urdf/panda.urdf", "franka_emika_panda/panda.xml"),
    ("urdf/panda.urdf", "franka_emika_panda/panda_nohand.xml"),
    ("urdf/allegro_left_hand.urdf", "wonik_allegro/left_hand.xml"),
    ("urdf/allegro_right_hand.urdf", "wonik_allegro/right_hand.xml"),
    ("urdf/xarm7.urdf", "ufactory_xarm7/xarm7_nohand.xml"),
    ("urdf/xarm7.urdf", "ufactory_xarm7/xarm7.xml"),
    ("urdf/ur5_robot.urdf", "universal_robots_ur5e/ur5e.xml"),
    ("urdf/so101.urdf", "SO101/so101_new_calib.xml"),
    ("SO101/so101_new_calib.urdf", "SO101/so101_new_calib.xml"),
    ("SO101/so101_old_calib.urdf", "SO101/so101_old_calib.xml"),
    ("urdf/so100.urdf", "SO100/so100.urdf"),
    ("SO101/so101_new_calib.xml", "SO101/so101_old_calib.xml"),
    ("h1/h1.xml", "unitree_h1/h1.xml"),
    ("g1/g1_29dof.xml", "unitree_g1/g1.xml"),
    ("go2/go2.xml", "go2w/go2w.xml"),
    ("franka_emika_panda/panda.xml", "franka_emika_panda/panda_nohand.xml"),
)
COMMAND = "python -m tests.proof pairs DIR … --markdown docs/pairs.md"


@dataclass(frozen=True)
class PairRow:
    """One pair: its comparison, or the reason why there is none."""

    a: str
    b: str
    result: Comparison | None
    error: str = ""

    @property
    def cells(self) -> list[Any]:
        """The row of a table."""
        if self.result is None:
            return [self.a, self.b, "", "", "", self.error, ""]
        found = self.result
        largest = [c for c in found.causes if not c.one_sided][:2]
        words = "; ".join(f"{c.kind} of {c.where} {c.detail}".strip() for c in largest)
        total = len(found.matched) + max(len(names) for names in found.unmatched.values())
        return [
            self.a, self.b, f"{len(found.matched)} of {total}", found.verdict, words,
            max(found.residual.values(), default=0.0), found.seconds,
        ]  # fmt: skip


@dataclass(frozen=True)
class PairReport:
    """All pairs whose files were found, and the missing ones."""

    rows: tuple[PairRow, ...]
    missing: tuple[str, ...]
    readers: Readers

    @property
    def passed(self) -> bool:
        """Whether every pair was compared and all its differences have a cause."""
        return all(row.result is not None and row.result.explained for row in self.rows)

    @property
    def table(self) -> Table:
        """A table with a row per pair."""
        titles = ["A", "B", "joints", "verdict", "largest causes", "left", "s"]
        formats = ["", "", "", "", "", ".0e", ".1f"]
        return Table(titles, [row.cells for row in self.rows], formats)

    def to_dict(self) -> dict[str, Any]:
        """The survey as plain data."""
        rows = [
            {"a": r.a, "b": r.b, "error": r.error} if r.result is None else r.result.to_dict()
            for r in self.rows
        ]
        found = {"passed": self.passed, "rows": rows, "missing": list(self.missing)}
        return found | {"pinocchio": self.readers.to_dict()}

    def document(self) -> str:
        """A document with the tables."""
        return document(
            "# Public pairs",
            f"Made by `{COMMAND}`. [Comparison in detail](compare_reference.md) explains the "
            "causes.",
            "*left* is the largest relative error of M, bias, g and J at random states after every "
            "cause is repaired.",
            self.table.markdown(),
            "## Pinocchio's MJCF reader",
            "`pin.buildModelFromMJCF` reads every MJCF of these repositories that is a robot. The "
            "table gives the relative errors of M, bias, g and J at random states against MuJoCo, "
            "and their reason. Springs, dampers and tendons are not compared.",
            f"{self.readers.summary}.",
            self.readers.table.markdown(),
        )

    def __str__(self) -> str:
        lines = [self.table.text(), str(self.readers)]
        if self.missing:
            lines.append("not found: " + ", ".join(self.missing))
        return "\n\n".join(lines)


def survey(folders: Sequence[str], samples: int = 8, seed: int = 0) -> PairReport:
    """Compare every pair of which both files are found.

    Parameters
    ----------
    folders : sequence of str
        Folders with repositories of public MJCFs; the first file that fits is used.
    samples, seed : int
        Number of random states, and their seed.

    Raises
    ------
    InputError
        A folder does not exist, or contains no pair.
    """
    files: list[Path] = list(example_files())
    for folder in folders:
        if not Path(folder).is_dir():
            raise InputError("DIR", "a folder", folder)
        files += sorted(f for f in Path(folder).rglob("*") if f.suffix in (".xml", ".urdf"))
    rows, missing = [], []
    for pair in PAIRS:
        found = [_first(files, end) for end in pair]
        gone = [end for end, path in zip(pair, found, strict=True) if path is None]
        if gone:
            missing += gone
            continue
        try:
            a, b = (str(path) for path in found)
            rows.append(PairRow(*pair, compare(a, b, samples=samples, seed=seed)))
        except SoftdynError as error:
            rows.append(PairRow(*pair, None, str(error)))
    if not rows:
        raise InputError("DIR", "folders with public MJCFs", ", ".join(folders))
    return PairReport(tuple(rows), tuple(dict.fromkeys(missing)), survey_readers(folders))


def _first(files: list[Path], end: str) -> Path | None:
    return next((path for path in files if str(path).endswith(f"/{end}")), None)
