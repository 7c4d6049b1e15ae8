"""Empty figures, pens and files, the same bytes on every machine.

Only matplotlib's object interface is used, never pyplot: no screen, no global state.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from pipeline.arrays import Array
from pipeline.palette import COLOURS
from pipeline.store.atomic_files import put

ImageFormat = Literal["png", "svg"]
Dashes: TypeAlias = str | tuple[int, tuple[int, ...]]

# Line style, mark and hatch say the same as the colour, for print in black and white.
DASHES: tuple[Dashes, ...] = (
    "-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 3)),
)  # fmt: skip
MARKS = ("o", "s", "^", "D", "v", "P", "X")
HATCHES = ("", "///", "...", "\\\\\\", "xx", "--", "++")
MAP_COLOURS = "cividis"  # even in lightness: readable without colours too

DOTS_PER_INCH = 150
PANEL_INCHES = (4.6, 4.2)
MARK_COLOUR = "#8c2d04"
QUIET = "#555555"

# Width of a letter in each of the texts around the panels, on average and a little over.
_TITLE_INCHES, _NOTE_INCHES, _MARK_INCHES = 0.115, 0.067, 0.1
_LEFT = 0.08
_NARROWEST = 1.4
_TITLE: dict[str, Any] = {"ha": "left", "fontsize": 12, "fontweight": "bold"}
_NOTE: dict[str, Any] = {"ha": "left", "fontsize": 8, "color": QUIET}
_MARK: dict[str, Any] = {
    "ha": "right", "va": "top", "fontsize": 10, "fontweight": "bold", "color": MARK_COLOUR,
    "gid": "placeholder",
    "bbox": {"boxstyle": "round", "facecolor": "#fff4e5", "edgecolor": MARK_COLOUR},
}  # fmt: skip

# On top of matplotlib's own defaults: what a user has in a matplotlibrc plays no part.
STYLE: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"],  # matplotlib brings it along
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.8,
    "legend.fontsize": 8.5,
    "legend.framealpha": 0.9,
    "hatch.linewidth": 0.6,
    "savefig.dpi": DOTS_PER_INCH,
    # Names come from files: a $ in them is a $, no formula.
    "text.parse_math": False,
    # Ids in an SVG are drawn at random otherwise.
    "svg.hashsalt": "motor-leakage",
    "svg.fonttype": "path",
}


class Pen(NamedTuple):
    """Colour, line style, mark and hatch of one thing, the same in every figure."""

    colour: str
    dashes: Dashes
    mark: str
    hatch: str


def pen(place: int) -> Pen:
    """The pen of the n-th path or gap; after seven they come round again."""
    place %= len(COLOURS)
    return Pen(COLOURS[place], DASHES[place], MARKS[place], HATCHES[place])


@contextmanager
def drawing() -> Iterator[None]:
    """The style within which figures are made and saved."""
    with mpl.rc_context(), warnings.catch_warnings():
        mpl.rcdefaults()
        mpl.rcParams.update(STYLE)
        # A script that the font has not is drawn as boxes, which is no reason to say more.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def new_figure(title: str, panels: int, *, note: str, mark: str = "") -> tuple[Figure, list[Axes]]:
    """Make an empty figure with its panels side by side."""
    width, height = PANEL_INCHES[0] * max(panels, _NARROWEST), PANEL_INCHES[1] + 0.8
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    room = width - (_MARK_INCHES * (len(mark) + 4) if mark else 0.0)
    figure.suptitle(_wrapped(title, room / _TITLE_INCHES), x=_LEFT / width, **_TITLE)
    figure.supxlabel(_wrapped(note, width / _NOTE_INCHES), x=_LEFT / width, **_NOTE)
    if mark:
        figure.text(1.0 - _LEFT / width, 1.0 - _LEFT / height, mark, **_MARK)
    axes = figure.subplots(1, panels, squeeze=False)
    return figure, list(axes[0])


def _wrapped(text: str, letters: float) -> str:
    """A text in lines of at most some letters; its own line breaks stay."""
    return "\n".join(textwrap.fill(line, max(20, int(letters))) for line in text.splitlines())


def line(
    axes: Axes, x: Array, y: Array, place: int, name: str | None = None, dashes: str | None = None
) -> None:
    """Draw a curve with the pen of the n-th path; `dashes` instead of its own."""
    style = pen(place)
    axes.plot(x, y, color=style.colour, linestyle=dashes or style.dashes, label=name)


def dots(axes: Axes, x: Array, y: Array, place: int, name: str | None = None) -> None:
    """Draw points with the pen of the n-th path."""
    style = pen(place)
    axes.plot(x, y, color=style.colour, marker=style.mark, linestyle="", label=name)


def label(axes: Axes, title: str, x: str, y: str) -> None:
    """Name a panel and its axes."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def plain_ticks(axes: Axes, which: Literal["x", "y"]) -> None:
    """Write the ticks of a logarithmic axis as numbers, at 1, 2 and 5 of each decade."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def save(figure: Figure, path: Path, image_format: ImageFormat) -> None:
    """Write a figure whole or not at all; the same figure gives the same bytes."""
    # By default the file holds the date and the version of matplotlib.
    metadata = {"Software": None} if image_format == "png" else {"Date": None, "Creator": None}
    put(path, lambda stream: figure.savefig(stream, format=image_format, metadata=metadata))
