"""Pinocchio's own reader on every MJCF of some folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softdyn.exceptions import SoftdynError
from softdyn.validation.mjcf.comparison.result import QUANTITIES
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.tables import Table
from tests.proof.mjcf.readers import ReaderVerdict, pinocchio_reads


@dataclass(frozen=True)
class Readers:
    """The verdicts on every MJCF of some folders."""

    verdicts: tuple[ReaderVerdict, ...]
    refused: tuple[str, ...]

    @property
    def exact(self) -> int:
        """Number of files that Pinocchio reads correctly."""
        return sum(verdict.exact for verdict in self.verdicts)

    def __str__(self) -> str:
        return "\n\n".join([self.summary, self.table.text()])

    @property
    def table(self) -> Table:
        """The files that are not read exactly; files with the same reason share a row."""
        groups: dict[str, list[ReaderVerdict]] = {}
        for verdict in self.verdicts:
            if not verdict.exact:
                groups.setdefault(verdict.why, []).append(verdict)
        rows = []
        for why, group in groups.items():
            files = ", ".join(verdict.file for verdict in group[:2])
            files += f" and {len(group) - 2} more" if len(group) > 2 else ""
            found = group[0].result
            figures: list[Any] = [""] * len(QUANTITIES)
            if found is not None and found.waterfall and not group[0].includes:
                figures = [found.waterfall[0].left[name] for name in QUANTITIES]
            rows.append([files, *figures, why])
        formats = ["", *[".0e"] * len(QUANTITIES), ""]
        return Table(["files", *QUANTITIES, "why"], rows, formats)

    @property
    def summary(self) -> str:
        """The counts in one line."""
        return (
            f"{len(self.verdicts)} MJCFs that MuJoCo reads: {self.exact} exact in Pinocchio, "
            f"{len(self.verdicts) - self.exact} not; {len(self.refused)} not asked"
        )

    def to_dict(self) -> dict[str, Any]:
        """The survey as plain data."""
        verdicts = [verdict.to_dict() for verdict in self.verdicts]
        return {"exact": self.exact, "files": verdicts, "refused": list(self.refused)}


def survey_readers(folders: Sequence[str]) -> Readers:
    """Read every MJCF in the folders that is a complete robot."""
    verdicts, refused = [], []
    for folder in folders:
        for path in sorted(Path(folder).rglob("*.xml")):
            label = "/".join(path.parts[-2:])
            try:
                if not (side := Side(path)).is_mjcf:
                    continue
                verdict = pinocchio_reads(side, label)
            except SoftdynError:
                refused.append(label)
                continue
            if verdict.result is None or verdict.result.matched or verdict.result.unmatched["a"]:
                verdicts.append(verdict)
    return Readers(tuple(verdicts), tuple(refused))
