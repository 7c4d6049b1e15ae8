"""Where and how benchmarks leave their figures."""

from __future__ import annotations

import argparse
import datetime as dt
import json
import platform
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True, slots=True)
class Part:
    """A section of a results file: what was measured, in words and in one table."""

    heading: str
    text: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


def write_results(
    name: str, title: str, header: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    """Write one Markdown table to `benchmarks/results/`, and print it."""
    _write(name, title, _table(header, rows))


def write_parts(name: str, title: str, text: str, parts: Sequence[Part]) -> None:
    """Write several Markdown tables with their words to one file, and print them."""
    lines = [text, ""]
    for part in parts:
        lines += [f"## {part.heading}", "", part.text, "", *_table(part.header, part.rows)]
    _write(name, title, lines)


def write_stored(
    name: str,
    title: str,
    text: str,
    makers: Mapping[str, Callable[[], Part]],
    options: Sequence[str],
) -> None:
    """Measure all parts or some (`--only A,B`); the others are as they were stored."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks {name}")
    parser.add_argument("--only", default=",".join(makers), help=f"of {', '.join(makers)}")
    asked = parser.parse_args(list(options)).only.split(",")
    if strangers := sorted(set(asked) - set(makers)):
        parser.error(f"no part {', '.join(strangers)}; there are {', '.join(makers)}")
    file = RESULTS / f"{name}.json"
    stored: dict[str, dict[str, Any]] = {}
    for one in asked:
        made = asdict(makers[one]())
        stored = json.loads(file.read_text("utf-8")) if file.exists() else {}
        stored[one] = made
        file.write_text(json.dumps(stored, indent=1, ensure_ascii=False) + "\n", "utf-8")
    write_parts(name, title, text, [Part(**stored[one]) for one in makers if one in stored])


def description(doc: str | None) -> str:
    """A benchmark's docstring without its first line, which is the title."""
    return (doc or "").split("\n\n", 1)[1].strip()


def median_and_late(values: Sequence[float] | NDArray[np.float64]) -> str:
    """Median and 90 % quantile of times of which some never come (infinite)."""
    ends = np.quantile(values, (0.5, 0.9), method="higher")
    return " / ".join(f"{one:.0f}" if np.isfinite(one) else "–" for one in ends)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(row) + " |" for row in rows),
        "",
    ]


def _write(name: str, title: str, body: Sequence[str]) -> None:
    lines = [
        f"# {title}",
        "",
        f"Python {platform.python_version()}, {platform.machine()}, made by "
        f"`python -m benchmarks {name}` on {dt.datetime.now(dt.UTC):%Y-%m-%d %H:%M} UTC.",
        "",
        *body,
    ]
    RESULTS.mkdir(exist_ok=True)
    text = "\n".join(lines)
    (RESULTS / f"{name}.md").write_text(text, "utf-8")
    sys.stdout.write(text)


def nights_of_history() -> str:
    """What the benchmark of history found."""
    path = RESULTS / "night_cost.md"
    if not path.exists():
        return ""
    found = re.search(
        r"\| processor time \|.*\| ([\d.]+) \|$", path.read_text("utf-8"), re.MULTILINE
    )
    if found is None:
        return ""
    return (
        "Nights of history: night 365 takes "
        f"{found.group(1)} times the processor time of night 2, the trend stage aside "
        "(`night_cost.md`)."
    )
