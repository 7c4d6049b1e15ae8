"""Where and how benchmarks leave their figures."""

from __future__ import annotations

import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

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
        f"`python -m benchmarks {name}`.",
        "",
        *body,
    ]
    RESULTS.mkdir(exist_ok=True)
    text = "\n".join(lines)
    (RESULTS / f"{name}.md").write_text(text, "utf-8")
    sys.stdout.write(text)
