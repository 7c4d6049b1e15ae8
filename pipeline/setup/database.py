"""A fleet proposed from a database: its newest night is looked at as a file is."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from pydantic import ValidationError

from pipeline.clock import latest_us
from pipeline.config import Nights
from pipeline.config.logs import Database
from pipeline.config.nights import Night, night, night_of, nights_between
from pipeline.errors import UsageError
from pipeline.logs.database import Connection, DatabaseError
from pipeline.logs.landing import between, identifier, nights_with_rows, stored_type, write_parquet
from pipeline.setup.propose import Proposal, propose
from pipeline.store.atomic_files import put

EARLIEST = dt.date(1990, 1, 1)  # no log is older
MOST_ROWS = 5_000_000  # of a night


def propose_from_database(variable: str, query: str, answers: Mapping[str, str]) -> Proposal:
    """Propose a fleet from the rows of a query, as of `logs.database.query`.

    `variable` is the environment variable with the database's address.

    Raises DatabaseError if there are no rows (``database_empty``) or the database does not answer,
    UsageError if the query is none.
    """
    try:
        database = Database(query=query, connection=variable, begin=EARLIEST)
    except ValidationError as error:
        # Of an address in the place of a variable's name nothing is quoted.
        message = error.errors(include_input=False)[0]["msg"].removeprefix("Value error, ")
        raise UsageError("query", f"sql:NAME, or --query: {message}") from None
    nights = Nights()
    labels = nights_between(EARLIEST, night_of(latest_us(), nights))
    windows = [night(one, nights) for one in labels]
    with (
        Connection(database, "UTC") as connection,
        TemporaryDirectory(prefix="motor-leakage-night-") as folder,
    ):
        there = nights_with_rows(connection, database.query, windows)
        if not there:
            raise DatabaseError("database_empty", f"{database.connection}: the query has no rows")
        sample = Path(folder) / "log.parquet"
        _write_sample(connection, database.query, windows[there[-1]], sample)
        found = propose(sample, answers)
    # The database takes the place of the file of a night.
    begin = windows[there[0]].date
    own = {"query": database.query, "connection": database.connection, "begin": begin}
    motors = []
    for motor in found.motors:
        logs = {**motor.logs, "format": "sql", "database": own}
        del logs["files"]
        motors.append(replace(motor, files=(), logs=logs))
    return replace(found, log_root=Path("log"), motors=tuple(motors))


def _write_sample(connection: Connection, query: str, here: Night, path: Path) -> None:
    """Write the rows of a night to a file, without columns that no log has."""
    rows = f"FROM (\n{between(query, here.start_us, here.end_us)}\n) AS log"
    schema = connection.ask(f"SELECT * {rows} LIMIT 0", lambda _, found: found)
    names = [one.name for one in schema if stored_type(one.type) is not None]
    connection.ask(
        f"SELECT {', '.join(map(identifier, names))} {rows} LIMIT {MOST_ROWS}",
        lambda batches, found: put(path, lambda stream: write_parquet(batches, found, stream)),
    )
