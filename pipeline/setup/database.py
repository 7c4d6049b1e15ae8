"""A fleet proposed from a database: its newest night is looked at as a file is."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from pydantic import ValidationError

from pipeline.clock import latest_us
from pipeline.config import Nights
from pipeline.config.logs import END, START, Database
from pipeline.config.nights import Night, night, night_of, nights_between
from pipeline.errors import UsageError
from pipeline.logs.database import Connection, DatabaseError
from pipeline.logs.landing import between, identifier, nights_with_rows, stored_type, write_parquet
from pipeline.setup.propose import Proposal, propose
from pipeline.setup.tables import Question
from pipeline.store.atomic_files import put

EARLIEST = dt.date(1990, 1, 1)  # no log is older
MOST_ROWS = 5_000_000  # of a night
# Tables with a time that the user may read; partitions are parts of a table.
TABLES = """
SELECT table_schema::text, table_name::text, column_name::text FROM information_schema.columns
WHERE data_type LIKE 'timestamp%' AND table_schema !~ '^(pg_|information_schema|_?timescaledb)'
AND NOT EXISTS (SELECT FROM pg_inherits
                WHERE inhrelid = format('%I.%I', table_schema, table_name)::regclass)
ORDER BY table_schema, table_name, ordinal_position"""


def propose_from_database(variable: str, query: str, answers: Mapping[str, str]) -> Proposal:
    """Propose a fleet from the rows of a query, or of the one table with a time.

    `variable` is the environment variable with the database's address, `query` as
    `logs.database.query`; empty: that of a table, which is asked for if there are several.

    Raises DatabaseError if there are no rows (``database_empty``) or the database does not answer,
    UsageError if the query is none, or no table has a time.
    """
    database = _as_configured(variable, query or f"SELECT {START}, {END}")
    with Connection(database, "UTC") as connection:
        name = "log"
        if not query:
            choices = dict(_tables(connection))
            if not choices:
                raise UsageError("query", "no table has a column of time stamps: give --query")
            chosen = next(iter(choices)) if len(choices) == 1 else answers.get("table", "")
            if chosen not in choices:
                text = "which table has the samples, and which of its times is theirs?"
                question = Question("table", text, tuple(choices))
                return Proposal(Path(name), (), (question,), (), ())
            name, query = choices[chosen]
        return _proposed(connection, database.model_copy(update={"query": query}), name, answers)


def _as_configured(variable: str, query: str) -> Database:
    try:
        return Database(query=query, connection=variable, begin=EARLIEST)
    except ValidationError as error:
        # Of an address in the place of a variable's name nothing is quoted.
        message = error.errors(include_input=False)[0]["msg"].removeprefix("Value error, ")
        raise UsageError("query", f"sql:NAME, or --query: {message}") from None


def _tables(connection: Connection) -> Iterator[tuple[str, tuple[str, str]]]:
    """Tables by the words that choose them: name, and query."""
    rows = connection.ask(
        TABLES, lambda batches, _: [row for one in batches for row in one.to_pylist()]
    )
    for row in rows:
        schema, table, column = row.values()
        query = (
            f"SELECT * FROM {identifier(schema)}.{identifier(table)} "
            f"WHERE {identifier(column)} >= {START} AND {identifier(column)} < {END}"
        )
        yield f"{schema}.{table} by {column}", (table, query)


def _proposed(
    connection: Connection, database: Database, name: str, answers: Mapping[str, str]
) -> Proposal:
    nights = Nights()
    labels = nights_between(EARLIEST, night_of(latest_us(), nights))
    windows = [night(one, nights) for one in labels]
    there = nights_with_rows(connection, database.query, windows)
    if not there:
        raise DatabaseError("database_empty", f"{database.connection}: the query has no rows")
    with TemporaryDirectory(prefix="motor-leakage-night-") as folder:
        sample = Path(folder) / f"{name.replace('/', '_')}.parquet"
        _write_sample(connection, database.query, windows[there[-1]], sample)
        found = propose(sample, answers)
    begin = windows[there[0]].date
    own = {"query": database.query, "connection": database.connection, "begin": begin}
    # The database takes the place of the file of a night.
    motors = tuple(
        replace(
            motor,
            files=(),
            logs={key: one for key, one in motor.logs.items() if key != "files"}
            | {"format": "sql", "database": own},
        )
        for motor in found.motors
    )
    return replace(found, log_root=Path(name), motors=motors)


def _write_sample(connection: Connection, query: str, here: Night, path: Path) -> None:
    """Write the rows of a night to a file, without columns that no log has."""
    rows = f"FROM (\n{between(query, here.start_us, here.end_us)}\n) AS log"
    schema = connection.ask(f"SELECT * {rows} LIMIT 0", lambda _, found: found)
    names = [one.name for one in schema if stored_type(one.type) is not None]
    connection.ask(
        f"SELECT {', '.join(map(identifier, names))} {rows} LIMIT {MOST_ROWS}",
        lambda batches, found: put(path, lambda stream: write_parquet(batches, found, stream)),
    )
