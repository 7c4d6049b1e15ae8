"""A chart as Plotly's JSON, and JSON that no name can break out of.

A page may be opened from a file, so its data are scripts; what stands in them came out of files
of others and is never trusted.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Mapping
from html import escape
from typing import Any, Final

import numpy as np

from pipeline.arrays import Array
from pipeline.report.charts import Chart, Line, Mark, Panel, Times

Payload = dict[str, Any]

# In a string of JSON their escapes mean the same, and end no script element; what lies beyond
# ASCII, and could end a line, is escaped by JSON itself.
HARMFUL = "<>&"
# Pixels around the panels, of a line of a panel's head, and of the numbers of events.
MARGIN: Final = {"l": 52, "r": 12, "t": 6, "b": 24}
LETTER_HEIGHT, NUMBERS, BELOW = 17, 26, 12
LETTERS = 46  # of a line of the names in a head: a telephone has room for no more
# Of more nights than that the marks would cover the lines.
MARKED = 200
SIGNS = {"circle": "●", "square": "■", "diamond": "◆", "triangle-up": "▲", "x": "✕", "": "━━"}


def figure(chart: Chart) -> Payload:
    """The chart for `draw` of the pages; empty where there is nothing to show.

    `x` holds the times, the same of all traces.
    """
    if not chart.panels:
        return {}
    heads = [_head(panel) for panel in chart.panels]
    above = [LETTER_HEIGHT * (one.count("<br>") + 1) + BELOW for one in heads]
    above[0] += NUMBERS if chart.marks else 0
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
        layout[f"yaxis{axis[1:]}"] = ends | {"nticks": max(3, panel.height // 30)}
        shift = NUMBERS if chart.marks and place == 0 else 0
        layout["annotations"].append(_text(head, axis, yshift=shift, align="left"))
        traces += [_trace(line, panel, axis, chart) for line in panel.lines]
        layout["shapes"] += [_upright(one, axis) for one in chart.marks]
        layout["shapes"] += [
            {"type": "rect", "layer": "below", "x0": str(first), "x1": str(last)}
            | {"yref": f"{axis} domain", "y0": 0, "y1": 1, "fillcolor": "#8a949e"}
            | {"opacity": 0.18, "line": {"width": 0}}
            for first, last in chart.shaded
        ]
    for number, mark in enumerate(chart.marks):
        at = {"x": str(mark.night), "xref": "x", "xanchor": "center", "yshift": 13 * (number % 2)}
        layout["annotations"].append(_text(str(number + 1), "y", **at))
    layout["xaxis"] = {"type": "date", "anchor": f"y{len(heads) if len(heads) > 1 else ''}"}
    layout["xaxis"]["range"] = _span(chart.time)
    return {"x": [str(one) for one in chart.time], "data": traces, "layout": layout}


def script_json(document: Mapping[str, Any]) -> str:
    r"""JSON that may stand inside a script, of a page or of a file of its own.

    Raises ValueError if it holds NaN or infinity, which JSON has not.
    """
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    for character in HARMFUL:  # one after the other: `translate` takes a hundred times as long
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def numbers(values: Array) -> list[float | None]:
    """Numbers as JSON has them, with six digits; null where there is none."""
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in values.tolist()]


def safe(name: str) -> str:
    """A name as Plotly shows it: it reads some HTML, and a percent sign begins a figure."""
    return escape(name, quote=False).replace("%", "")


def _trace(line: Line, panel: Panel, axis: str, chart: Chart) -> Payload:
    marks = bool(line.symbol) and int(np.isfinite(line.value).sum()) <= MARKED
    day = "%Y-%m-%d" if chart.time.dtype == np.dtype("datetime64[D]") else "%Y-%m-%d %H:%M:%S"
    trace: Payload = {
        "type": "scatter",
        "mode": "lines+markers" if marks else "lines",
        "name": safe(line.name),
        "y": numbers(line.value),
        "yaxis": axis,
        "line": {"color": line.colour, "width": 1.4, "dash": "solid" if marks else line.dash},
        "marker": {"color": line.colour, "size": 5, "symbol": line.symbol or "circle"},
        "hovertemplate": f"%{{x|{day}}}: %{{y:.4g}} {panel.unit}<extra>{safe(line.name)}</extra>",
    }
    if line.lower is not None and line.upper is not None:
        ends = {"array": line.upper - line.value, "arrayminus": line.value - line.lower}
        trace["error_y"] = {name: numbers(end) for name, end in ends.items()}
        trace["error_y"] |= {"type": "data", "symmetric": False, "width": 0, "thickness": 2}
        trace["error_y"]["color"] = f"{line.colour}66"
    return trace


def _head(panel: Panel) -> str:
    """Title and unit of a panel; below, in their colours, the names of its lines."""
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
        rows[-1].append(f"{sign} {safe(short)}")
    return "<br>".join([title, *("   ".join(row) for row in rows)])


def _text(words: str, axis: str, **more: Any) -> Payload:
    """Words above a panel."""
    place = {"xref": "paper", "x": 0, "xanchor": "left", "yref": f"{axis} domain", "y": 1}
    return place | {"text": words, "showarrow": False, "yanchor": "bottom"} | more


def _upright(mark: Mark, axis: str) -> Payload:
    place = {"type": "line", "x0": str(mark.night), "x1": str(mark.night), "yref": f"{axis} domain"}
    return place | {"y0": 0, "y1": 1, "line": {"color": mark.colour, "width": 1, "dash": "dot"}}


def _span(time: Times) -> list[str]:
    """Ends of the axis of time: a little beyond the first and the last."""
    first, last = time[[0, -1]].astype("datetime64[m]")
    beyond = max((last - first) // 50, np.timedelta64(1, "m"))
    return [str(first - beyond), str(last + beyond)]
