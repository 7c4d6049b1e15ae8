"""A connection to a PostgreSQL database, from which the rows of a query come in Arrow batches."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

import pyarrow as pa

from pipeline.config.alarms import VARIABLE
from pipeline.config.logs import Database
from pipeline.errors import StoreError, one_line
from pipeline.workers.process import still_alive

Taken = TypeVar("Taken")

UNREACHABLE = "database_unreachable"
SLOW = "database_slow"
# Waits before another attempt after the connection failed [s].
WAITS_S = (1.0, 4.0, 15.0)
# Of a batch: what a task holds of a result, however large that is.
BATCH_BYTES = 4 << 20
# SQLSTATE of a lost connection, a server that goes down or comes up, and one that is full.
OF_CONNECTION = re.compile(r"08|57P|53300")
CODES = {"57014": SLOW, "42501": "database_denied", "42703": "log_column_missing"}
# Said by a server that refuses now and may not later.
REFUSED_NOW = re.compile(r"too many|starting up|shutting down|recovery mode|not yet accepting")
REFUSED = re.compile(r"FATAL|password|pg_hba")
NO_SERVER = re.compile(r"connection to server|could not translate host|could not connect")


class DatabaseError(StoreError):
    """A database that cannot be asked, or refuses a query."""


class Connection:
    """A connection that is made when it is needed, and made anew where it was lost.

    Time stamps that state no zone are in `time_zone`.
    """

    def __init__(self, database: Database, time_zone: str) -> None:
        self._database = database
        self._time_zone = time_zone
        self._open: Any = None
        # Of the driver, and of the stream of a result.
        self._errors: tuple[type[Exception], ...] = ()

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def ask(self, sql: str, take: Callable[[Iterator[pa.RecordBatch], pa.Schema], Taken]) -> Taken:
        """Give the rows of a query to a function, batch by batch; again, if the connection fails.

        Raises DatabaseError if there is no answer.
        """
        for wait_s in (*WAITS_S, None):
            try:
                return self._once(sql, take)
            except DatabaseError as error:
                if error.code != UNREACHABLE or wait_s is None:
                    raise
            still_alive()
            time.sleep(wait_s)
        raise AssertionError("the last attempt returns or raises")

    def _once(
        self, sql: str, take: Callable[[Iterator[pa.RecordBatch], pa.Schema], Taken]
    ) -> Taken:
        begin = time.monotonic()
        if self._open is None:
            self._connect()
        with self._cursor() as cursor:
            with self._coded(begin):
                cursor.adbc_statement.set_options(
                    **{"adbc.postgresql.batch_size_hint_bytes": str(BATCH_BYTES)}
                )
                cursor.execute(sql)
                reader = cursor.fetch_record_batch()
            return take(self._batches(reader, begin), reader.schema)

    def _batches(self, reader: pa.RecordBatchReader, begin: float) -> Iterator[pa.RecordBatch]:
        while True:
            with self._coded(begin):
                try:
                    batch = reader.read_next_batch()
                except StopIteration:
                    return
            still_alive()
            yield batch

    @contextmanager
    def _coded(self, begin: float) -> Iterator[None]:
        """Errors of the driver become those of this program, without a secret in them."""
        try:
            yield
        except self._errors as error:
            found = self._fault(error, time.monotonic() - begin)
            if found.code == UNREACHABLE:
                self._close()
            raise found from None

    def _fault(self, error: Exception, seconds: float) -> DatabaseError:
        state = getattr(error, "sqlstate", None)
        if state is None:  # the driver says none in the middle of a result
            if not self._is_alive():
                state = "08006"
            elif seconds >= self._database.statement_timeout_s:
                state = "57014"
        code = _code_of(state or "")
        words = _words(str(error))
        if code == SLOW:
            words += (
                f"; logs.database.statement_timeout_s is {self._database.statement_timeout_s:g}"
            )
        return DatabaseError(code, one_line(f"{self._name}: {words}"))

    def _is_alive(self) -> bool:
        with suppress(*self._errors), self._cursor() as cursor:
            cursor.execute("SELECT 1")
            return True
        return False

    def _connect(self) -> None:
        try:
            from adbc_driver_postgresql import dbapi
        except ImportError as error:
            raise DatabaseError(
                "database_missing",
                f"a database needs the extra `sql` ({error}): pip install 'motor-leakage[sql]'",
            ) from error
        os.environ.setdefault("PGCONNECT_TIMEOUT", str(self._database.connect_timeout_s))
        try:
            connection = dbapi.connect(self._address(), autocommit=True)
        except dbapi.Error as error:
            raise self._refusal(_words(str(error))) from None
        self._open = connection
        self._errors = (dbapi.Error, OSError, pa.ArrowInvalid, pa.ArrowNotImplementedError)
        try:
            self._set_up()
        except BaseException:
            self._close()
            raise

    def _set_up(self) -> None:
        settings = {
            "TIME ZONE": f"'{self._time_zone}'",
            "default_transaction_read_only =": "on",
            "standard_conforming_strings =": "on",
            "statement_timeout =": f"{self._database.statement_timeout_s * 1000:.0f}",
        }
        with self._cursor() as cursor, self._coded(time.monotonic()):
            for name, value in settings.items():
                cursor.execute(f"SET {name} {value}")

    def _refusal(self, words: str) -> DatabaseError:
        """The error of an attempt to connect, whose words may quote the address."""
        if REFUSED.search(words) and not REFUSED_NOW.search(words):
            code = "database_refused"
        else:
            code = "database_unreachable" if NO_SERVER.search(words) else "database_address"
        if code == "database_address" or self._address().count("@") > 1:
            words = (
                "the address is not understood; expected postgresql://user:password@host/database, "
                "with special characters of the password as %XX"
            )
        return DatabaseError(code, one_line(f"{self._name}: {words}"))

    @property
    def _name(self) -> str:
        return f"database of {self._database.connection}"

    def _address(self) -> str:
        address = os.environ.get(VARIABLE.sub(r"\1", self._database.connection), "").strip()
        if not address:
            raise DatabaseError(
                "database_address",
                f"{self._name}: the environment has no such variable; "
                "expected postgresql://user:password@host/database in it",
            )
        return address

    def _close(self) -> None:
        if self._open is not None:
            with suppress(*self._errors):  # it is lost already
                self._open.close()
            self._open = None

    @contextmanager
    def _cursor(self) -> Iterator[Any]:
        cursor = self._open.cursor()
        try:
            yield cursor
        finally:
            with suppress(*self._errors):  # its connection is lost
                cursor.close()


def _code_of(state: str) -> str:
    """Code of an error by the server's SQLSTATE; class 22 is of values that cannot be converted."""
    if OF_CONNECTION.match(state):
        return UNREACHABLE
    other = "database_rows" if state.startswith("22") else "database_query"
    return CODES.get(state, other)


def _words(text: str) -> str:
    """The server's own words in a message of the driver."""
    text = text.partition("\n\nQuery was")[0].partition(". SQLSTATE")[0]
    text = re.sub(r"\nLINE \d+:.*\n.*\^", "", text)
    text = re.sub(r"^.*?(Failed to connect|Execution error \[\w+\]|query):\s*", "", text)
    text = text.removeprefix("could not begin COPY: ")
    return "; ".join(line.strip() for line in text.splitlines() if line.strip())
