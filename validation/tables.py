"""Answers as tables, printed and put into their page."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

NONE = "–"
Row = dict[str, str]


@dataclass(frozen=True, slots=True)
class Table:
    """One answer: its name in the page, and rows of text by column."""

    name: str
    rows: Sequence[Row]

    def markdown(self) -> str:
        """As Markdown."""
        if not self.rows:
            return "No record tells this.\n"
        header = list(self.rows[0])
        lines = (header, ["---"] * len(header), *(row.values() for row in self.rows))
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)


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
