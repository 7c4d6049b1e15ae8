"""One page of paper on a motor, for a work order: what happened, three charts, what to do, and
room for the finding."""

from __future__ import annotations

import datetime as dt
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import matplotlib.dates
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from pipeline.config import Fleet, MotorSpec
from pipeline.errors import UsageError
from pipeline.messages import as_sentence, plain
from pipeline.report.build import newest_changes
from pipeline.report.charts import Chart, Panel, watch_chart
from pipeline.report.status import current_states
from pipeline.report.tables import MotorHistory, motor_histories
from pipeline.report.words import conditions
from pipeline.schema import ALARMS
from pipeline.store.atomic_files import put
from pipeline.store.tables import read_rows
from pipeline.trends.rows.motor_states import MotorState
from pipeline.trends.sentences import day

# A4, in inches, and letters in a line of its text.
PAGE = (8.27, 11.69)
LEFT, RIGHT = 0.09, 0.95
LETTERS = 92
# Line styles of Matplotlib for those of Plotly.
DASHES: Final[dict[str, Any]] = {
    "dash": "--",
    "dot": ":",
    "dashdot": "-.",
    "longdash": (0, (8, 2)),
}
STYLE: Final[Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,
}
FINDINGS = ("worn", "sound", "not opened")


def write_paper(fleet: Fleet, motor_id: str, folder: Path) -> Path:
    """Write the page of a motor as PDF; its path.

    Raises UsageError if the fleet has no such motor, or no table a night of it; StoreError if a
    table is damaged or the file cannot be written.
    """
    spec = fleet.motor(motor_id)
    (motor,) = motor_histories(fleet.output, [motor_id])
    if not motor.nights:
        raise UsageError("unknown_motor", f"no night of motor {motor_id!r} is in the tables")
    changes = newest_changes(read_rows(fleet.output, ALARMS, [motor_id]))
    (state,) = current_states(fleet.output, [motor_id])
    path = folder / f"{motor_id}.pdf"
    with mpl.rc_context(STYLE):
        page = page_of(motor, state, spec, changes)
        page.text(RIGHT, 0.955, f"{fleet.name} · {spec.file.motor_type}", ha="right", color="0.35")
        # By default the file holds the date and the version of matplotlib.
        metadata = {"CreationDate": None, "Producer": None, "Creator": "motor-leakage"}
        put(path, lambda stream: page.savefig(stream, format="pdf", metadata=metadata))
    return path


def page_of(
    motor: MotorHistory,
    state: MotorState,
    spec: MotorSpec,
    changes: Sequence[Mapping[str, Any]] = (),
) -> Figure:
    """The page of a motor; `changes` are its rows of `alarms`."""
    page = Figure(figsize=PAGE)
    FigureCanvasPdf(page)
    page.text(LEFT, 0.955, motor.motor_id, fontsize=20, weight="bold")
    words, watch = f"{plain(state.state)}; data up to {day(motor.nights[-1])}", state.watch
    if watch is not None and watch.own_pressure_bar is not None:
        at = watch.own_pressure_bar, watch.own_temperature_c, watch.own_speed_rpm
        words += f"; its own conditions: {conditions(*at)}"
    page.text(LEFT, 0.935, words)
    top = 0.915
    for words, letters, look in (
        (as_sentence(state.sentence), 90, {"fontsize": 11}),
        (state.advice, 82, {"fontsize": 11, "weight": "bold"}),
        (as_sentence("; ".join(state.notes)), LETTERS, {"color": "0.35"}),
    ):
        if words:
            text = _wrapped(words, letters)
            page.text(LEFT, top, text, va="top", linespacing=1.4, **look)
            top -= 0.021 * (text.count("\n") + 1) + 0.003
    paths = [path.name for path in spec.motor_type.paths()]
    _charts(page, watch_chart(motor, paths, spec.file.events, changes), min(top - 0.045, 0.82))
    _finding(page, paths)
    return page


def _charts(page: Figure, chart: Chart, top: float) -> None:
    """The panels of the motor's page, and below them what their numbers mean."""
    marks = "; ".join(
        f"{number} {mark.night}: {mark.words}" for number, mark in enumerate(chart.marks, 1)
    )
    page.text(LEFT, 0.274, _wrapped(marks, max_lines=3), va="top", color="0.35")
    if not chart.panels:
        return
    grid = page.subplots(
        len(chart.panels), 1, sharex=True, squeeze=False,
        gridspec_kw={"left": LEFT, "right": RIGHT, "top": top, "bottom": 0.315, "hspace": 0.35,
                     "height_ratios": [one.height for one in chart.panels]},
    )[:, 0]  # fmt: skip
    # Above the first panel is room for the numbers.
    lift = 0.016 / grid[0].get_position().height if chart.marks else 0.0
    for axes, panel in zip(grid, chart.panels, strict=True):
        _panel(axes, panel, chart, lift if axes is grid[0] else 0.0)
    for number, mark in enumerate(chart.marks, 1):
        at = (_place(mark.night), 1.0)
        place = {"xycoords": ("data", "axes fraction"), "ha": "center", "va": "bottom"}
        grid[0].annotate(str(number), at, **place)
    dates = matplotlib.dates.ConciseDateFormatter(grid[0].xaxis.get_major_locator())  # type: ignore[no-untyped-call]
    grid[0].xaxis.set_major_formatter(dates)


def _place(night: dt.date) -> float:
    """Place of a night on the axis of time."""
    return float(matplotlib.dates.date2num(night))  # type: ignore[no-untyped-call]


def _panel(axes: Axes, panel: Panel, chart: Chart, lift: float) -> None:
    for ends in chart.shaded:
        axes.axvspan(*map(_place, ends), color="0.5", alpha=0.15, lw=0)
    for mark in chart.marks:
        axes.axvline(_place(mark.night), color=mark.colour, lw=0.8, ls=":")
    for line in panel.lines:
        if line.lower is not None and line.upper is not None:
            band = axes.fill_between(chart.time, line.lower, line.upper)
            band.set(color=line.colour, alpha=0.25, lw=0)
        style = DASHES.get(line.dash, "-")
        axes.plot(chart.time, line.value, color=line.colour, ls=style, lw=1.4, label=line.name)
    if panel.ends:
        axes.set_ylim(panel.ends)
    if len(panel.lines) > 1:
        place = (1.0, 0.98 + lift)
        axes.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=place, ncols=4)
    axes.set_title(panel.title, loc="left", fontsize=10, weight="bold", y=1.02 + lift)
    axes.set_ylabel(panel.unit)
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


def _wrapped(text: str, letters: int = LETTERS, max_lines: int | None = None) -> str:
    # No line begins with a unit.
    text = text.replace(" %", "\N{NO-BREAK SPACE}%")
    return textwrap.fill(text, letters, max_lines=max_lines, placeholder=" …")
