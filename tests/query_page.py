"""The queries of `docs/queries.md`: found on the page, run, and their answers written into it.

``python -m tests.query_page FOLDER`` runs them on the tables in ``FOLDER/out/tables`` and puts
the answers below the queries.
"""

from __future__ import annotations

import contextlib
import math
import re
import sys
from pathlib import Path

import duckdb
import polars as pl

from pipeline.messages import counted

PAGE = Path(__file__).resolve().parents[1] / "docs" / "queries.md"
ANSWER = "On the demo:"
MOST_ROWS = 5
QUESTION = re.compile(
    rf"^## (\d+)\. .*?^```sql\n(.*?)^```\n\n{ANSWER}\n\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL
)


def questions() -> dict[int, tuple[str, tuple[str, ...]]]:
    """The query of each number, and the columns of the answer that the page shows."""
    found = QUESTION.findall(PAGE.read_text("utf-8"))
    return {
        int(number): (query, tuple(cell.strip() for cell in shown.split("\n")[0].split("|")[1:-1]))
        for number, query, shown in found
    }


def views() -> duckdb.DuckDBPyConnection:
    """The tables in `out/tables` of the folder in which we are."""
    connection = duckdb.connect(config={"threads": 1})
    connection.execute("SET file_search_path = 'out'")
    connection.execute(Path("out/views.sql").read_text("utf-8"))
    return connection


def _shown(rows: pl.DataFrame) -> str:
    """An answer as a table of the page."""
    lines = [rows.columns, ["---"] * rows.width]
    lines += [[_cell(value) for value in row] for row in rows.head(MOST_ROWS).iter_rows()]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    more = rows.height - MOST_ROWS
    return f"{table}\n\n" + (f"… and {counted(more, 'more row')}.\n\n" if more > 0 else "")


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else ""
    return "" if value is None else str(value)


def main(folder: Path) -> None:
    """Write the answers into the page."""
    text = PAGE.read_text("utf-8")
    with contextlib.chdir(folder), views() as tables:
        for found in QUESTION.finditer(text):
            whole, shown = found[0], found[3]
            answer = _shown(tables.sql(found[2]).pl())
            text = text.replace(whole, whole.removesuffix(shown) + answer)
    PAGE.write_text(text.rstrip() + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
