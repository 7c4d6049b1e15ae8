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
from pipeline.palette import COLOURS
from pipeline.report.build import KnownMotor, ReportRequest
from pipeline.report.history import Course, MotorHistory, motor_histories
from pipeline.report.motor_page import gap_changes
from pipeline.report.names import file_names
from pipeline.report.status import standing_states
from pipeline.report.tables import read_tables
from pipeline.report.words import plain, sentence
from pipeline.store.atomic_files import put
from pipeline.trends.rows.motor_states import MotorState
from pipeline.trends.sentences import day

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
    (state,) = standing_states(request.output, [motor_id])
    known = request.known.get(motor_id, KnownMotor(""))
    path = folder / f"{file_names([motor_id])[motor_id]}.pdf"
    title = " · ".join(part for part in (request.fleet or history.fleet, known.motor_type) if part)
    with mpl.rc_context(STYLE):
        page = page_of(motor, state, known.paths, title)
        # By default the file holds the date and the version of matplotlib.
        metadata = {"CreationDate": None, "Producer": None, "Creator": "motor-leakage"}
        put(path, lambda stream: page.savefig(stream, format="pdf", metadata=metadata))
    return path


def page_of(motor: MotorHistory, state: MotorState, paths: Sequence[str], title: str) -> Figure:
    """The page of a motor that has some declared paths."""
    page = Figure(figsize=PAGE)
    FigureCanvasPdf(page)
    gaps = gap_changes(motor, paths)
    _head(page, motor, state, title)
    _charts(page, motor, gaps)
    _finding(page, paths or [path for path, _, _ in gaps])
    return page


def _head(page: Figure, motor: MotorHistory, state: MotorState, title: str) -> None:
    page.text(LEFT, 0.955, motor.motor_id, fontsize=20, weight="bold")
    page.text(RIGHT, 0.955, title, ha="right", color="0.35")
    page.text(LEFT, 0.935, f"{plain(state.state)}; data up to {day(motor.nights[-1])}")
    notes = "; ".join(state.notes)
    said = _wrapped(sentence(state.sentence), 80)
    page.text(LEFT, 0.915, said, fontsize=11, va="top", linespacing=1.4)
    below = 0.915 - 0.021 * (said.count("\n") + 1)
    page.text(LEFT, below, _wrapped(state.advice, 80), fontsize=11, weight="bold", va="top")
    if notes:
        page.text(LEFT, below - 0.024, _wrapped(sentence(notes)), va="top", color="0.35")


def _charts(page: Figure, motor: MotorHistory, gaps: Sequence[tuple[str, int, Course]]) -> None:
    grid = page.add_gridspec(
        3, 1, left=LEFT, right=RIGHT, top=0.80, bottom=0.27, hspace=0.32, height_ratios=(4, 2, 3)
    )
    nights = np.array(motor.nights, dtype="datetime64[D]")
    leakage = page.add_subplot(grid[0])
    evidence, changes = (page.add_subplot(grid[place], sharex=leakage) for place in (1, 2))
    leakage.plot(nights, motor.flow.value, color=GREY, lw=1.0, label="drain flow, measured")
    _line(leakage, nights, motor.leakage, COLOURS[0], "leakage")
    _shade_baselines(leakage, motor)
    leakage.legend(framealpha=0.9, fontsize=8, loc="upper left", ncols=2)
    _title(leakage, "Leakage at the motor's own conditions, with its 95 % interval", "l/min")
    limit = motor.watched("evidence_limit")
    evidence.plot(nights, motor.watched("evidence"), color=COLOURS[0], lw=1.2)
    evidence.plot(nights, limit, "--", color="black", lw=1.0)
    if np.isfinite(limit).any():
        evidence.set_ylim(-2.0, 2.5 * float(np.nanmax(limit)))
    _title(evidence, "Evidence of a change; dashed: told from here on", "ln R")
    for path, place, course in gaps:
        _line(changes, nights, course, COLOURS[place % len(COLOURS)], plain(path))
    if gaps:
        changes.legend(frameon=False, fontsize=8, loc="upper left", ncols=2)
    _title(changes, "Gap changes by each night's own fit", "% of the baseline")
    dates = matplotlib.dates.ConciseDateFormatter(changes.xaxis.get_major_locator())  # type: ignore[no-untyped-call]
    changes.xaxis.set_major_formatter(dates)
    for axes in (leakage, evidence):
        axes.tick_params(labelbottom=False)


def _shade_baselines(axes: Axes, motor: MotorHistory) -> None:
    ends = motor.baselines.select("start", "end").drop_nulls()
    for first, last in ends.rows():
        axes.axvspan(first, last, color="0.5", alpha=0.15, lw=0)


def _line(axes: Axes, nights: Nights, course: Course, colour: str, name: str) -> None:
    axes.fill_between(nights, course.lower, course.upper, color=colour, alpha=0.25, lw=0)
    axes.plot(nights, course.value, color=colour, lw=1.5, label=name)


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
