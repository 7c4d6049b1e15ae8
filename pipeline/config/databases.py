"""`[logs.database]` of a motor's file: the query of its samples, and when it is asked."""

from __future__ import annotations

import datetime as dt

from pydantic import Field, field_validator

from pipeline.config.receivers import Secret
from pipeline.config.section import Positive, Section, Stage

START, END = "{start}", "{end}"
"""Stand in a query for the borders of a night, half open."""


class Database(Section):
    """A query in a PostgreSQL database, asked night by night."""

    shapes = Stage.NOTHING

    query: str
    """One `SELECT` with the marks `{start}` and `{end}`, which become time stamps with a zone
    (`timestamptz`): `SELECT * FROM log WHERE time >= {start} AND time < {end}`. Only the columns,
    the motor and the tags that this file names are fetched of it."""
    connection: Secret = Field("${MOTOR_LEAKAGE_DATABASE}", min_length=1)
    """`${NAME}` of the environment variable that holds the address,
    `postgresql://user:password@host/database?sslmode=verify-full`; the address itself belongs into
    no config file."""
    begin: dt.date
    """First night that is asked for."""
    look_back_days: int = Field(3, ge=0, le=366)
    """Nights before the newest that every run asks for again, for rows that came late or were
    corrected; shorter than the time for which the database keeps its rows."""
    statement_timeout_s: Positive = Field(600.0, le=86_400.0)
    """Longest time for the query of one night; the server ends it then."""
    connect_timeout_s: int = Field(10, ge=2, le=600)
    """Longest time for one attempt to connect."""

    @field_validator("query")
    @classmethod
    def _asks_for_a_night(cls, query: str) -> str:
        if START not in query or END not in query:
            raise ValueError(f"expected the marks {START} and {END} in it")
        query = query.strip().removesuffix(";").rstrip()
        if query.split(maxsplit=1)[0].upper() not in ("SELECT", "WITH"):
            raise ValueError("expected a query that begins with SELECT or WITH")
        return query
