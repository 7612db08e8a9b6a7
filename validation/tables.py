"""The one writer of tables: columns for a terminal, Markdown, LaTeX, HTML and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

Column = tuple[str, str, str]
"""Title, key of the rows, format; a column without a format holds text."""

_TEX = str.maketrans({
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "_": r"\_", "&": r"\&", "%": r"\%",
    "#": r"\#", "$": r"\$", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "\n": " ",
    "±": r"$\pm$", "²": "$^2$", "µ": r"$\mu$", "π": r"$\pi$", "θ": r"$\theta$", "ω": r"$\omega$",
})  # fmt: skip


@dataclass(frozen=True)
class Table:
    """Titled columns and rows of values.

    A cell is its value in the column's format. Text stays as it is, and None is a dash.

    Attributes
    ----------
    titles : sequence of str
        Empty for a table without a title line.
    rows : sequence of sequence
        Values in the order of the titles.
    formats : sequence of str
        One format per column, empty for text, which is the default. `text` aligns the other columns
        on the right.
    """

    titles: Sequence[str]
    rows: Sequence[Sequence[Any]]
    formats: Sequence[str] = ()

    @classmethod
    def of(cls, columns: Iterable[Column], rows: Iterable[Mapping[str, Any]]) -> Table:
        """A table with these columns, from rows that hold their keys."""
        titles, keys, formats = zip(*columns, strict=True)
        return cls(titles, [[row[key] for key in keys] for row in rows], formats)

    @property
    def lines(self) -> list[list[str]]:
        """The titles, if there are any, then the cells of every row."""
        made = [list(self.titles)] if self.titles else []
        for row in self.rows:
            formats = self.formats or [""] * len(row)
            made.append([_cell(x, form) for x, form in zip(row, formats, strict=True)])
        return made

    def text(self) -> str:
        """Aligned columns for a terminal."""
        columns = []
        for k, column in enumerate(zip(*self.lines, strict=True)):
            width = max(map(len, column))
            right = self.formats and self.formats[k]
            columns.append([x.rjust(width) if right else x.ljust(width) for x in column])
        return "\n".join("  ".join(line).rstrip() for line in zip(*columns, strict=True))

    def markdown(self) -> str:
        """A Markdown table; every cell is on one line and shown literally."""
        made = [" | ".join(inline(cell).replace("|", r"\|") for cell in line)
                for line in self.lines]  # fmt: skip
        made[1:1] = [" | ".join("---" for _ in self.titles)]
        return "\n".join(f"| {line} |" for line in made)

    def latex(self, sides: str, above: Sequence[tuple[str, int]] = (), note: str = "") -> str:
        """A booktabs table, with a rule above each new first cell where some have several lines.

        Parameters
        ----------
        sides : str
            The columns of the tabular, such as ``lcc``.
        above : sequence of (str, int)
            A line above the titles: texts, and the number of columns that each stands over.
        note : str
            A last line below the table, in small print.
        """
        titles, *lines = ([cell.translate(_TEX) for cell in line] for line in self.lines)
        made = [rf"\begin{{tabular}}{{{sides}}}", r"\toprule", *_above(above)]
        made.append(" & ".join(titles) + r" \\")
        grouped = len({line[0] for line in lines}) < len(lines)
        for k, (line, new) in enumerate(_grouped(lines)):
            made += [r"\midrule"] if k == 0 or (new and grouped) else []
            made.append(" & ".join(line if new else ["", *line[1:]]) + r" \\")
        made.append(r"\bottomrule")
        if note:
            width = rf"\multicolumn{{{len(self.titles)}}}{{p{{0.9\linewidth}}}}"
            made.append(rf"{width}{{\footnotesize {note.translate(_TEX)}}} \\")
        return "\n".join([*made, r"\end{tabular}"]) + "\n"

    def html(self, bad: Sequence[Collection[int]]) -> str:
        """A table whose rows with a new first cell are of class ``first``.

        Parameters
        ----------
        bad : sequence of collection of int
            For each row the columns of class ``bad``.
        """
        titles, *lines = ([escape(cell) for cell in line] for line in self.lines)
        made = ["<tr><th>" + "</th><th>".join(titles) + "</th></tr>"]
        for (line, new), marked in zip(_grouped(lines), bad, strict=True):
            classes = [' class="bad"' if k in marked else "" for k in range(len(line))]
            cells = (f"<td{kind}>{x}</td>" for kind, x in zip(classes, line, strict=True))
            made.append(('<tr class="first">' if new else "<tr>") + "".join(cells) + "</tr>")
        return "<table>" + "\n".join(made) + "\n</table>"

    def csv(self) -> str:
        """The values as CSV: numbers in full, None as an empty field."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.titles)
        for row in self.rows:
            writer.writerow([str(x).lower() if isinstance(x, bool) else x for x in row])
        return out.getvalue()


def document(*blocks: str) -> str:
    """Headings, paragraphs and tables as Markdown; empty blocks are left out."""
    return "\n\n".join(filter(None, blocks)) + "\n"


def inline(text: Any) -> str:
    """Text on one line that Markdown shows as it is."""
    return " ".join(str(text).split()).replace("<", "&lt;")


def _above(heads: Sequence[tuple[str, int]]) -> Iterator[str]:
    """A line of heads over several columns each, and a rule below each of them."""
    if not any(text for text, _ in heads):
        return
    cells, rules, first = [], [], 1
    for text, width in heads:
        cells.append(rf"\multicolumn{{{width}}}{{c}}{{{text.translate(_TEX)}}}")
        rules += [rf"\cmidrule(lr){{{first}-{first + width - 1}}}"] if text else []
        first += width
    yield " & ".join(cells) + r" \\"
    yield "".join(rules)


def _cell(value: Any, form: str) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else format(value, form)


def _grouped(lines: Iterable[Sequence[str]]) -> Iterator[tuple[Sequence[str], bool]]:
    """Each line, and whether its first cell differs from the one above."""
    above = None
    for line in lines:
        yield line, line[0] != above
        above = line[0]
