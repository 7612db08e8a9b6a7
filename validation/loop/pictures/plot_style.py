"""Style of all figures: fixed sizes, one colour per robot and controller, files without dates."""

from __future__ import annotations

import io
import string
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from softdyn import InputError
from softdyn.controllers import registry
from softdyn.validation.files import atomic
from softdyn.validation.loop import labels

Look = tuple[str, Any]  # colour and dashes
COLUMN, PAGE = 3.5, 7.16  # widths of one and of both columns of a two-column page (inch)
PNG_DPI = 200
SUFFIXES = (".png", ".pdf")
TIME = "Time (s)"

# Okabe and Ito's palette: colours that all common kinds of colour vision can distinguish.
BLUE, VERMILLION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, BLACK = "#56B4E9", "#CC79A7", "#000000"  # its yellow is too light for a line
GREY, BROWN, REFERENCE, NEUTRAL = "#7F7F7F", "#7A4B2A", "#BBBBBB", "#444444"
SOLID, DASHED, DASH_DOT, DOTTED = "-", (0, (5, 1.5)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1.2))
DASH_DOT_DOT, LONG = (0, (4, 1.2, 1, 1.2, 1, 1.2)), (0, (9, 2))
# colour and dashes, so that lines differ in a grey print, too
INPUTS: tuple[Look, ...] = (
    (BLUE, SOLID), (VERMILLION, DASHED), (GREEN, DASH_DOT), (ORANGE, DOTTED),
    (PURPLE, DASH_DOT_DOT), (SKY, LONG), (BLACK, SOLID), (GREY, DASHED), (BROWN, SOLID),
)  # fmt: skip
CONTROLLERS = dict(zip(registry.CONTROLLERS, INPUTS, strict=False))
ROBOTS = dict(zip(labels.ROBOTS, (*INPUTS[:3], INPUTS[4]), strict=True))
OTHERS: tuple[Look, ...] = (
    (BLACK, DASHED), (GREY, SOLID), (BROWN, DASH_DOT), (BLACK, DOTTED), (GREY, DASHED),
)  # fmt: skip
RC = {
    "font.family": "DejaVu Sans",  # a part of Matplotlib, so every machine has it
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "axes.titlesize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 3.2,
    "legend.columnspacing": 1.4,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "ytick.minor.size": 0,
    "lines.linewidth": 1.1,
    "lines.markersize": 4.5,
    "axes.unicode_minus": True,
    "pdf.fonttype": 42,  # embed fonts, so that text stays text
    "savefig.dpi": PNG_DPI,
}
FAILED: dict[str, Any] = {"marker": "x", "markersize": 5, "markeredgewidth": 1.3, "linestyle": ""}


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib's defaults with this style; the user's settings are ignored."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(RC)
        yield


def looks(shown: Iterable[str], known: Mapping[str, Look]) -> dict[str, Look]:
    """Colour and dashes of every name: its fixed ones, or the next free ones."""
    others = [name for name in dict.fromkeys(shown) if name not in known]
    return {**known} | {name: OTHERS[i % len(OTHERS)] for i, name in enumerate(others)}


def robot_title(name: str) -> str:
    """A robot's name in a figure."""
    return plain(labels.robot_title(name))


def controller_title(name: str) -> str:
    """A controller's name in a figure."""
    return plain(labels.controller_title(name))


def plain(text: str) -> str:
    """Text that Matplotlib prints literally, not as mathematics or as a hidden legend entry."""
    text = text.replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


class NotebookFigure(Figure):
    """A figure that a notebook displays."""

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        with style():
            self.savefig(content, format="png", dpi=120)
        return content.getvalue()


def panels(
    rows: int, columns: int, width: float, height: float, **options: Any
) -> tuple[Figure, list[list[Axes]]]:
    """A figure of `rows` × `columns` axes; `width` and `height` in inch."""
    layout = ConstrainedLayoutEngine(compress=True, w_pad=0.03, h_pad=0.03)
    figure = NotebookFigure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, [list(row) for row in axes]


def letter(axes: Axes, index: int, title: str) -> None:
    """Name a panel: (a), (b), … and its title."""
    axes.set_title(f"({string.ascii_lowercase[index % 26]}) {title}", loc="left")


def line(axes: Axes, x: Any, y: Any, look: Look, **options: Any) -> None:
    """Draw a line in its colour and dashes."""
    axes.plot(x, y, color=look[0], linestyle=look[1], **options)


def handle(label: str, look: Look, **options: Any) -> Line2D:
    """A line for a legend."""
    return Line2D([], [], color=look[0], linestyle=look[1], label=label, **options)


def legend_handles(
    titles: Mapping[str, str], known: Mapping[str, Look], failed: bool
) -> list[Line2D]:
    """A handle for every title, and one for the mark at the ends of `failed` runs, if any."""
    lines = [handle(title, known[name]) for name, title in titles.items()]
    mark = Line2D([], [], color=NEUTRAL, label="failed run", **FAILED)
    return [*lines, mark] if failed else lines


def legend_above(figure: Figure, handles: Sequence[Line2D]) -> None:
    """Add one legend for all panels, in a strip above them, as wide as the figure."""
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    for rows in range(1, len(handles) + 1):
        columns = -(-len(handles) // rows)
        legend = figure.legend(handles=handles, loc="outside upper center", ncols=columns)
        if legend.get_window_extent(renderer).width <= figure.bbox.width or columns == 1:
            return
        legend.remove()


def check_path(path: str | Path) -> Path:
    """Return `path` if a figure can be written in the format of its suffix.

    Raises
    ------
    InputError
        For any other suffix than .png and .pdf.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(str(path), "a file name that ends in .png or .pdf", path.suffix or "none")
    return path


def save(figure: Figure, path: Path) -> list[Path]:
    """Write `path`.pdf and `path`.png, each complete or not at all, with reproducible bytes."""
    written = []
    for kind, metadata in (("pdf", {"CreationDate": None, "ModDate": None}), ("png", {})):
        written.append(path.with_name(f"{path.name}.{kind}"))
        write_figure(figure, written[-1], metadata=metadata)
        figure.set_layout_engine("none")  # both have one layout, which takes most of the time
    return written


def write_figure(figure: Figure, path: Path, **options: Any) -> None:
    """Write a file in the format of its suffix, complete or not at all."""
    with atomic(path) as stream:
        figure.savefig(stream, format=path.suffix.lower()[1:], **options)
