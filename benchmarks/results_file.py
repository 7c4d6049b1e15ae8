"""Where and how benchmarks leave their figures."""

from __future__ import annotations

import datetime as dt
import json
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True, slots=True)
class Part:
    """A section of a results file: what was measured, in words and in one table."""

    heading: str
    text: str
    header: str  # names of the columns, with " | " between them
    rows: Sequence[Sequence[str]]


def write_parts(name: str, title: str, text: str, parts: Sequence[Part]) -> None:
    """Write several Markdown tables with their words to one file, and print them."""
    lines = [
        f"# {title}",
        "",
        f"Python {platform.python_version()}, {platform.machine()}, made by "
        f"`python -m benchmarks {name}` on {dt.datetime.now(dt.UTC):%Y-%m-%d %H:%M} UTC.",
        "",
        text,
        "",
        *_sections(parts),
    ]
    written = "\n".join(lines)
    (RESULTS / f"{name}.md").write_text(written, "utf-8")
    sys.stdout.write(written)


def show_parts(parts: Sequence[Part]) -> None:
    """Print several Markdown tables with their words."""
    sys.stdout.write("\n".join(_sections(parts)))


def stored(name: str) -> dict[str, Any]:
    """All that runs of a benchmark have found so far, by part."""
    file = RESULTS / f"{name}.json"
    found: dict[str, Any] = json.loads(file.read_text("utf-8")) if file.exists() else {}
    return found


def store(name: str, part: str, found: object) -> None:
    """Keep what was found of a part beside the others, a part a line."""
    parts = (stored(name) | {part: found}).items()
    lines = (f'"{one}": {json.dumps(of, ensure_ascii=False)}' for one, of in parts)
    (RESULTS / f"{name}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")


def description(doc: str | None) -> str:
    """A benchmark's docstring without its first line, which is the title."""
    return (doc or "").split("\n\n", 1)[1].strip()


def _sections(parts: Sequence[Part]) -> list[str]:
    lines = []
    for part in parts:
        lines += [f"## {part.heading}", "", part.text, "", *table(part.header, part.rows)]
    return lines


def table(header: str, rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    line = "|" + "---|" * len(header.split(" | "))
    return [f"| {header} |", line, *(f"| {' | '.join(row)} |" for row in rows), ""]
