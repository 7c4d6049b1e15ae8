"""The queries of `docs/queries.md`: found on the page, run, and their answers written into it.

``python -m tests.query_page FOLDER`` runs them on the tables in ``FOLDER/out/tables`` and puts
the answers below the queries.
"""

from __future__ import annotations

import contextlib
import math
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import duckdb
import polars as pl
import pyarrow as pa

from pipeline.messages import counted

PAGE = Path(__file__).resolve().parents[1] / "docs" / "queries.md"
ENGINES = ("DuckDB", "Polars", "pandas")
ANSWER = "On the demo:"
MOST_ROWS = 8


@dataclass(frozen=True)
class Question:
    """A part of the page: its heading, a query for each engine, and the answer's columns."""

    title: str
    queries: dict[str, str]
    columns: tuple[str, ...]


def preparation() -> dict[str, str]:
    """Statements to run before any query, by engine."""
    return _queries(_parts()[0][1])


def questions() -> list[Question]:
    return [Question(title, _queries(text), _columns(text)) for title, text in _parts()[1:]]


def answer(engine: str, question: Question) -> pl.DataFrame:
    """Answer a question on the tables in `out/tables` of the folder in which we are."""
    if engine == "DuckDB":
        with duckdb.connect() as connection:
            connection.execute("SET file_search_path = 'out'")
            connection.execute(Path("out/views.sql").read_text("utf-8"))
            rows = connection.sql(question.queries[engine]).to_arrow_table()
    else:
        names: dict[str, object] = {}
        exec(preparation()[engine] + question.queries[engine], names)  # noqa: S102
        found = names["answer"]
        if isinstance(found, pl.DataFrame):
            return _plain(found)
        rows = pa.Table.from_pandas(found, preserve_index=False)
    return _plain(pl.from_arrow(rows))


def _plain(rows: pl.DataFrame) -> pl.DataFrame:
    """The same types from every engine."""
    return rows.with_columns(
        pl.selectors.integer().cast(pl.Int64), pl.selectors.float().cast(pl.Float64)
    )


def _parts() -> list[tuple[str, str]]:
    text = PAGE.read_text("utf-8")
    return re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)


def _queries(text: str) -> dict[str, str]:
    found = {"DuckDB": re.findall(r"^```sql\n(.*?)^```", text, re.MULTILINE | re.DOTALL)}
    for engine in ENGINES[1:]:
        pattern = rf"^```python\n# {engine}\n(.*?)^```"
        found[engine] = re.findall(pattern, text, re.MULTILINE | re.DOTALL)
    return {engine: queries[0] for engine, queries in found.items() if queries}


def _columns(text: str) -> tuple[str, ...]:
    _, _, shown = text.partition(f"\n{ANSWER}\n\n")
    head = shown.partition("\n")[0]
    return tuple(cell.strip() for cell in head.strip("|").split("|"))


def _shown(rows: pl.DataFrame) -> str:
    """An answer as a table of the page."""
    lines = [rows.columns, ["---"] * rows.width]
    lines += [[_cell(value) for value in row] for row in rows.head(MOST_ROWS).iter_rows()]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    more = rows.height - MOST_ROWS
    return f"{ANSWER}\n\n{table}\n" + (
        f"\n… and {counted(more, 'more row')}.\n" if more > 0 else ""
    )


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else ""
    return "" if value is None else str(value)


def main(folder: Path) -> None:
    """Write the answers into the page."""
    text = PAGE.read_text("utf-8")
    with contextlib.chdir(folder):
        for question in questions():
            shown = _shown(answer("DuckDB", question))
            last = question.queries["pandas"] + "```\n"
            before, _, after = text.partition(last)
            rest = re.sub(r"\A.*?(?=^## |\Z)", "", after, count=1, flags=re.MULTILINE | re.DOTALL)
            text = f"{before}{last}\n{shown}" + (f"\n{rest}" if rest else "")
    PAGE.write_text(text, "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
