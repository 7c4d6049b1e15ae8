"""A chart as Plotly's JSON, and JSON that no name can break out of.

A page may be opened from a file, so its data are scripts; what stands in them came out of files
of others and is never trusted.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any, Final

import numpy as np
import polars as pl

from pipeline.arrays import Array
from pipeline.report.charts import Area, Chart, Line, Mark, Panel, Times
from pipeline.trends.sentences import in_percent

Payload = dict[str, Any]

# In a string of JSON their escapes mean the same, and end no script element; what lies beyond
# ASCII, and could end a line, is escaped by JSON itself.
HARMFUL = "<>&"
# Pixels around the panels, above them for the buttons; of a line of a panel's head, and below it.
MARGIN: Final = {"l": 44, "r": 44, "t": 30, "b": 24}
LETTER_HEIGHT, BELOW = 17, 12
# Nights that a chart is asked to show; "all" is always there.
RANGES: Final = (30, 90, 365)
# Beyond the last night is shown at most this share of those before it.
MOST_AHEAD = 1.0
LETTERS = 46  # of a line of the names in a head: a telephone has room for no more
# Of more nights than that the marks would cover the lines.
MARKED = 200
SIGNS = {"circle": "●", "square": "■", "diamond": "◆", "triangle-up": "▲", "x": "✕", "": "━━"}


def figure(chart: Chart) -> Payload:
    """Return the chart for `draw` of the pages; empty where there is nothing to show.

    `x` holds the times of traces that have none of their own; `ranges` the ends of the axis of time
    by the number of nights shown.
    """
    if not chart.panels:
        return {}
    heads = [_head(panel) for panel in chart.panels]
    above = [LETTER_HEIGHT * (title.count("<br>") + 1) + BELOW for title in heads]
    heights = [top + panel.height for top, panel in zip(above, chart.panels, strict=True)]
    whole = sum(heights)
    traces: list[Payload] = []
    layout: Payload = {"height": whole + MARGIN["t"] + MARGIN["b"], "margin": MARGIN}
    layout |= {"showlegend": False, "hovermode": "closest", "annotations": [], "shapes": []}
    for place, (panel, head) in enumerate(zip(chart.panels, heads, strict=True)):
        axis = f"y{place + 1 if place else ''}"
        bottom = 1.0 - sum(heights[: place + 1]) / whole
        ends = {"domain": [max(bottom, 0.0), bottom + panel.height / whole]}
        ends |= {"range": list(panel.ends)} if panel.ends else {}
        ticks = {"nticks": max(3, panel.height // 30), "fixedrange": True}
        layout[f"yaxis{axis[1:]}"] = ends | ticks
        layout["annotations"].append(_text(head, axis))
        traces += [_area(area, axis) for area in _areas(panel, chart.time)]
        traces += [_trace(line, panel, axis, chart) for line in panel.lines]
        if panel.right and panel.ends:
            flows = [panel.right * (1.0 + end / 100.0) for end in panel.ends]
            right = {"overlaying": axis, "side": "right", "range": flows, "showgrid": False}
            layout["yaxis9"] = right | ticks | {"tickformat": ".3~g"}
            # Plotly shows an axis only with a trace.
            traces.append({"yaxis": "y9", "y": [None] * len(chart.time), "hoverinfo": "skip"})
        whole_height = {"yref": f"{axis} domain", "y0": 0, "y1": 1}
        layout["shapes"] += [
            {"type": "line", "x0": str(mark.night), "x1": str(mark.night)}
            | {"line": {"color": mark.colour, "width": 1, "dash": "dot"}}
            | whole_height
            for mark in chart.marks
        ]
        layout["shapes"] += [
            {"type": "rect", "layer": "below", "x0": str(first), "x1": str(last)}
            | {"fillcolor": "#8a949e", "opacity": 0.18, "line": {"width": 0}}
            | whole_height
            for first, last in chart.shaded
        ]
    if chart.marks:
        hidden = {"overlaying": "y", "visible": False, "fixedrange": True}
        layout["yaxis8"] = hidden | {"range": [0, 1]}
        traces.append(_mark_trace(chart.marks))
    layout["xaxis"] = {
        "tickangle": 0,
        "nticks": 6,
        "anchor": f"y{len(heads) if len(heads) > 1 else ''}",
    }
    if chart.time.dtype.kind == "f":
        layout["xaxis"]["title"] = {"text": "lag, s: above 0 the error comes later"}
        layout["height"] += LETTER_HEIGHT
        layout["margin"] = MARGIN | {"b": MARGIN["b"] + LETTER_HEIGHT}
        return {"x": chart.time.tolist(), "data": traces, "layout": layout}
    ranges = _ranges(chart)
    layout["xaxis"] |= {"type": "date", "range": ranges["all"]}
    return {"x": list(map(str, chart.time)), "data": traces, "layout": layout, "ranges": ranges}


def script_json(document: Mapping[str, Any]) -> str:
    r"""Return JSON that may stand inside a script, of a page or of a file of its own.

    Raises ValueError if it holds NaN or infinity, which JSON has not.
    """
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    for character in HARMFUL:  # in turn: `translate` takes a hundred times as long
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def numbers(values: Array) -> list[float | None]:
    """Return numbers as JSON has them, with six digits; null where there is none."""
    series = pl.Series(values, dtype=pl.Float64)
    known = pl.when(series.is_finite()).then(series.round_sig_figs(6))
    return pl.select(known).to_series().to_list()


def safe(name: str) -> str:
    """Return a name as Plotly shows it: it reads some HTML, and a percent sign begins a figure."""
    return escape(name, quote=False).replace("%", "")


def _trace(line: Line, panel: Panel, axis: str, chart: Chart) -> Payload:
    marks = bool(line.symbol) and int(np.isfinite(line.value).sum()) <= MARKED
    form = "|%Y-%m-%d" if chart.time.dtype == np.dtype("datetime64[D]") else "|%Y-%m-%d %H:%M:%S"
    form = ":.4g" if chart.time.dtype.kind == "f" else form
    trace: Payload = {
        "type": "scatter",
        "mode": "lines+markers" if marks else "lines",
        "name": safe(line.name),
        "y": numbers(line.value),
        "yaxis": axis,
        "line": {"color": line.colour, "width": 1.4, "dash": "solid" if marks else line.dash},
        "marker": {"color": line.colour, "size": 5, "symbol": line.symbol or "circle"},
        "hovertemplate": f"%{{x{form}}}: %{{y:.4g}} {panel.unit}<extra>{safe(line.name)}</extra>",
    }
    if line.time is not None:
        trace["x"] = list(map(str, line.time))
    if line.lower is None or line.upper is None:
        return trace
    if line.is_band:
        trace["customdata"] = [
            in_percent(*ends) if all(map(math.isfinite, ends)) else ""
            for ends in np.column_stack([line.value, line.lower, line.upper]).tolist()
        ]
        words = f"%{{x{form}}}: %{{customdata}}<extra>{safe(line.name)}</extra>"
        return trace | {"hovertemplate": words}
    ends = {"array": line.upper - line.value, "arrayminus": line.value - line.lower}
    trace["error_y"] = {name: numbers(end) for name, end in ends.items()}
    trace["error_y"] |= {"type": "data", "symmetric": False, "width": 0, "thickness": 2}
    trace["error_y"]["color"] = f"{line.colour}66"
    return trace


def _areas(panel: Panel, time: Times) -> Iterator[Area]:
    """Yield the areas of a panel, and those of the bands, broken where nights have no interval."""
    yield from panel.areas
    for line in panel.lines:
        if not line.is_band or line.lower is None or line.upper is None:
            continue
        known = np.flatnonzero(np.isfinite(line.lower) & np.isfinite(line.upper))
        for part in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
            there_and_back = np.concatenate([part, part[::-1]])
            ends = np.concatenate([line.lower[part], line.upper[part[::-1]]])
            yield Area(time[there_and_back], ends, line.colour)


def _area(area: Area, axis: str) -> Payload:
    return {
        "x": list(map(str, area.time)),
        "y": numbers(area.value),
        "yaxis": axis,
        "mode": "lines",
        "line": {"width": 0},
        "fill": "toself",
        "fillcolor": f"{area.colour}33",
        "hoverinfo": "skip",
    }


def _mark_trace(marks: Sequence[Mark]) -> Payload:
    """Return the marks at the top of the first panel, with their words."""
    return {
        "x": [str(mark.night) for mark in marks],
        "y": [0.985] * len(marks),
        "yaxis": "y8",
        "mode": "markers",
        "name": "marks",
        "marker": {
            "symbol": "triangle-down",
            "size": 10,
            "color": [mark.colour for mark in marks],
        },
        "customdata": [safe(mark.words) for mark in marks],
        "hovertemplate": "%{x|%Y-%m-%d}: %{customdata}<extra></extra>",
    }


def _head(panel: Panel) -> str:
    """Return title and unit of a panel; below, in their colours, the names of its lines."""
    unit = f", {panel.unit}" if panel.unit else ""
    title = f"<b>{panel.title}</b>{unit}"
    if len(panel.lines) < 2:
        return title
    rows: list[list[str]] = [[]]
    room = LETTERS
    for line in panel.lines:
        short = textwrap.shorten(line.name, LETTERS - 4, placeholder="…")
        if rows[-1] and room < len(short):
            rows.append([])
            room = LETTERS
        room -= len(short) + 4
        sign = f'<span style="color:{line.colour}">{SIGNS[line.symbol]}</span>'
        rows[-1].append(f"{sign} {escape(short, quote=False)}")
    return "<br>".join([title, *("   ".join(row) for row in rows)])


def _text(words: str, axis: str) -> Payload:
    """Return words above a panel."""
    place = {"xref": "paper", "x": 0, "xanchor": "left", "yref": f"{axis} domain", "y": 1}
    return place | {"text": words, "showarrow": False, "yanchor": "bottom", "align": "left"}


def _ranges(chart: Chart) -> dict[str, list[str]]:
    """Return ends of the axis of time : a little beyond the nights that it shows, and ahead."""
    first, last = chart.time[[0, -1]].astype("datetime64[m]")
    begins = {str(n): last - np.timedelta64(n, "D") for n in RANGES}
    begins = {name: begin for name, begin in begins.items() if begin > first} | {"all": first}
    ahead = np.timedelta64(0, "m") if chart.until is None else chart.until - last
    ranges = {}
    for name, begin in begins.items():
        beyond = max((last - begin) // 50, np.timedelta64(1, "m"))
        end = last + max(beyond, min(ahead, (last - begin) * MOST_AHEAD))
        ranges[name] = [str(begin - beyond), str(end)]
    return ranges
