"""Tables on a terminal: as wide as it is, with colours; tab-separated where the output is piped."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence

import typer

from pipeline.errors import one_line


def print_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    title: str = "",
    styles: Sequence[str] = (),
) -> None:
    """Print rows below their columns; `styles` has one a row, none for rows beyond its end.

    Piped, the title is left out, and a cell that would break a line or a column is escaped.
    """
    if not sys.stdout.isatty():
        for cells in (columns, *rows):
            typer.echo("\t".join(map(one_line, cells)))
        return
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(one_line(title)) or None, title_justify="left", box=box.SIMPLE_HEAD)
    for name in columns:
        table.add_column(name, overflow="fold")
    for place, cells in enumerate(rows):
        style = styles[place] if place < len(styles) else None
        table.add_row(*(escape(one_line(cell)) for cell in cells), style=style)
    Console().print(table)
