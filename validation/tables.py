"""Answers as tables, printed and put into their page."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Table:
    """One answer: its name in the page, and rows as text."""

    name: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """As Markdown."""
        rows = (self.header, ["---"] * len(self.header), *self.rows)
        return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def show(tables: Sequence[Table], page: Path | None) -> None:
    """Print the tables, and put each between its two marks in the page, if there is one."""
    text = page.read_text("utf-8") if page else ""
    for table in tables:
        sys.stdout.write(f"\n{table.name}\n\n{table.markdown()}")
        begin, end = f"<!-- {table.name} -->\n", "<!-- end -->"
        if begin in text:
            before, _, after = text.partition(begin)
            text = f"{before}{begin}\n{table.markdown()}\n{end}{after.partition(end)[2]}"
    if page:
        page.write_text(text, "utf-8")
