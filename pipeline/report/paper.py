"""One page of paper on a motor, for a work order: what happened, three charts, what to do, and
room for the finding."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import matplotlib.dates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from pipeline.errors import UsageError
from pipeline.look.state import look_standings
from pipeline.palette import COLOURS
from pipeline.report.build import KnownMotor, ReportRequest
from pipeline.report.first_screen import FirstScreen, Line, first_screen
from pipeline.report.history import Course, MotorHistory, motor_histories
from pipeline.report.names import file_names
from pipeline.report.tables import read_tables
from pipeline.report.trends import motor_states
from pipeline.report.words import LEAKAGE_KINDS, figure, plain, sentence
from pipeline.store.atomic_files import put
from pipeline.trends.rows.motor_states import MotorState
from pipeline.trends.states.words import day

Nights = NDArray[np.datetime64]

# A4, in inches, and letters in a line of its text.
PAGE = (8.27, 11.69)
LEFT, RIGHT = 0.09, 0.95
LETTERS = 92
GREY = "#999999"
STYLE: Final[Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,
}
FINDINGS = ("worn", "sound", "not opened")


def write_paper(request: ReportRequest, motor_id: str, folder: Path) -> Path:
    """Write the page of a motor as PDF; its path.

    Raises UsageError if no table has a night of the motor, StoreError if a table is damaged or the
    file cannot be written.
    """
    history = read_tables(request.output)
    (motor,) = motor_histories(history, [motor_id])
    if not motor.nights:
        raise UsageError("unknown_motor", f"no night of motor {motor_id!r} is in the tables")
    state = motor_states(history, [motor_id], look_standings(request.output, [motor_id]))[motor_id]
    known = request.known.get(motor_id, KnownMotor(""))
    screen = first_screen(motor, state, known.paths)
    path = folder / f"{file_names([motor_id])[motor_id]}.pdf"
    title = " · ".join(part for part in (request.fleet or history.fleet, known.motor_type) if part)
    with mpl.rc_context(STYLE):
        page = page_of(motor, state, screen, known.paths, title)
        # By default the file holds the date and the version of matplotlib.
        metadata = {"CreationDate": None, "Producer": None, "Creator": "motor-leakage"}
        put(path, lambda stream: page.savefig(stream, format="pdf", metadata=metadata))
    return path


def page_of(
    motor: MotorHistory,
    state: MotorState,
    screen: FirstScreen,
    paths: Sequence[str],
    title: str,
) -> Figure:
    """The page of a motor that has some declared paths."""
    page = Figure(figsize=PAGE)
    FigureCanvasPdf(page)
    _head(page, motor, state, title)
    _charts(page, motor, screen)
    _finding(page, paths or [line.name for line in screen.changes])
    return page


def _head(page: Figure, motor: MotorHistory, state: MotorState, title: str) -> None:
    page.text(LEFT, 0.955, motor.motor_id, fontsize=20, weight="bold")
    page.text(RIGHT, 0.955, title, ha="right", color="0.35")
    known = f"known since {day(state.known_since)}; " if state.known_since else ""
    page.text(LEFT, 0.935, f"{plain(state.state)}; {known}data up to {day(motor.nights[-1])}")
    notes = "; ".join(state.notes)
    said = _wrapped(sentence(state.sentence), 80)
    page.text(LEFT, 0.915, said, fontsize=11, va="top", linespacing=1.4)
    below = 0.915 - 0.021 * (said.count("\n") + 1)
    page.text(LEFT, below, _wrapped(state.advice, 80), fontsize=11, weight="bold", va="top")
    if notes:
        page.text(LEFT, below - 0.024, _wrapped(sentence(notes)), va="top", color="0.35")


def _charts(page: Figure, motor: MotorHistory, screen: FirstScreen) -> None:
    grid = page.add_gridspec(
        3, 1, left=LEFT, right=RIGHT, top=0.80, bottom=0.27, hspace=0.32, height_ratios=(4, 3, 2)
    )
    nights = np.array(motor.nights, dtype="datetime64[D]")
    first = page.add_subplot(grid[0])
    rest = [page.add_subplot(grid[place], sharex=first) for place in (1, 2)]
    _changes(first, nights, screen)
    _leakage(rest[0], nights, screen)
    _line(rest[1], nights, Line("", None, screen.flow))
    _title(rest[1], "Drain flow as measured, mean of each night", "l/min")
    dates = matplotlib.dates.ConciseDateFormatter(rest[1].xaxis.get_major_locator())  # type: ignore[no-untyped-call]
    rest[1].xaxis.set_major_formatter(dates)
    for axes in (first, rest[0]):
        axes.tick_params(labelbottom=False)


def _changes(axes: Axes, nights: Nights, screen: FirstScreen) -> None:
    for line in screen.changes:
        _line(axes, nights, line)
    for name, level in screen.limits.items():
        dashes = "--" if name == "alarm" else ":"
        axes.plot(nights, level, dashes, color="black", lw=1, label=f"{name} ({screen.limits_of})")
    gaps = all(line.place is not None for line in screen.changes)
    _title(axes, "Gap change" if gaps else "Change of the leakage", "% of the baseline")
    if screen.changes:
        axes.legend(frameon=False, fontsize=8, loc="upper left")


def _leakage(axes: Axes, nights: Nights, screen: FirstScreen) -> None:
    if screen.paths:
        axes.stackplot(
            nights,
            [np.nan_to_num(line.course.value) for line in screen.paths],
            colors=[_colour(line) for line in screen.paths],
            labels=[line.name for line in screen.paths],
            alpha=0.8,
        )
        axes.legend(framealpha=0.9, fontsize=8, loc="upper left", ncols=2)
    else:
        _line(axes, nights, Line("", None, screen.leakage))
    now = Line("", None, screen.leakage).now
    value = f": {figure(now[0], 4)} l/min" if now else ""
    _title(axes, f"{LEAKAGE_KINDS[screen.leakage_kind].capitalize()}{value}", "l/min")


def _line(axes: Axes, nights: Nights, line: Line) -> None:
    course: Course = line.course
    colour = _colour(line)
    axes.fill_between(nights, course.lower, course.upper, color=colour, alpha=0.25, lw=0)
    axes.plot(nights, course.value, color=colour, lw=1.5, label=line.name or None)


def _colour(line: Line) -> str:
    return GREY if line.place is None else COLOURS[line.place % len(COLOURS)]


def _title(axes: Axes, title: str, unit: str) -> None:
    axes.set_title(title, loc="left", fontsize=10, weight="bold")
    axes.set_ylabel(unit)
    axes.grid(axis="y", color="0.9")


def _finding(page: Figure, paths: Sequence[str]) -> None:
    """Boxes to tick for each part, and lines to write on."""
    page.text(LEFT, 0.215, "Finding", fontsize=11, weight="bold")
    page.text(RIGHT, 0.215, "Date, name: " + "_" * 36, ha="right")
    for row, path in enumerate(paths):
        height = 0.19 - 0.021 * row
        page.text(LEFT, height, plain(path))
        for place, words in enumerate(FINDINGS):
            left = 0.30 + 0.13 * place
            page.add_artist(Rectangle((left, height - 0.001), 0.014, 0.010, fill=False, lw=0.8))
            page.text(left + 0.022, height, words)
    for height in (0.085, 0.06, 0.035):
        page.add_artist(Line2D([LEFT, RIGHT], [height, height], color="0.6", lw=0.6))


def _wrapped(text: str, letters: int = LETTERS) -> str:
    return textwrap.fill(text, letters)
