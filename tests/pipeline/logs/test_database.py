"""Connections to a database: lost, refused, too slow; and what is told of them."""

from __future__ import annotations

from pathlib import Path

import pytest

import pipeline.logs.database
from tests.pipeline.plant_database import (
    CLOCK,
    FIRST,
    NIGHTS,
    QUERY,
    VARIABLE,
    Plant,
    logs_toml,
    stamp,
)
from tests.pipeline.postgres_server import SECRET, PostgresServer
from tests.pipeline.workshop import DAY


def test_a_connection_lost_in_a_result_is_made_anew_and_nothing_is_half_read(
    database: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = large(Plant.at(tmp_path, database, nights=1))
    signs: list[set[str]] = []

    def lost_once() -> None:
        signs.append({one.name for one in plant.spec.log_root.iterdir()})
        if len(signs) == 2:  # a batch is there, the rest of them under way
            database.end_connections()

    monkeypatch.setattr(pipeline.logs.database, "BATCH_BYTES", 1 << 16)
    monkeypatch.setattr(pipeline.logs.database, "still_alive", lost_once)
    assert plant.land(CLOCK - 2 * DAY) == {}
    assert all(name.startswith(".") for names in signs for name in names)
    assert plant.landed(FIRST).num_rows == LARGE
    assert sorted(one.name for one in plant.spec.log_root.iterdir()) == [
        f"{FIRST}.parquet",
        "landed.json",
    ]


LARGE = 200_000


def large(plant: Plant, flow: str = "n") -> Plant:
    """A night of more rows than a connection holds on their way."""
    plant.configure(
        logs_toml(
            f"SELECT {{start}} + n * interval '0.1 s' AS time, 100.0 AS pressure_difference, "
            f"50.0 AS oil_temperature, 30.0 AS speed, {flow} AS leakage_flow, {{end}} AS other "
            f"FROM generate_series(0, {LARGE - 1}) AS n"
        )
    )
    return plant


def test_a_server_that_is_gone_is_asked_again_and_costs_no_night_that_is_known(
    database: PostgresServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    plant = Plant.at(tmp_path, database)
    plant.land(CLOCK - DAY)
    waits: list[float] = []
    monkeypatch.setattr(pipeline.logs.database.time, "sleep", waits.append)
    monkeypatch.setattr(pipeline.logs.database, "WAITS_S", (1.0, 4.0))
    monkeypatch.setenv(VARIABLE, f"postgresql://owner:{SECRET}@127.0.0.1:9/postgres")
    ((name, fault),) = plant.land().items()
    assert (name, fault.code) == (f"{NIGHTS[2]}.parquet", "database_unreachable")
    assert waits == [1.0, 4.0]
    assert plant.land(CLOCK - DAY) == {}
    assert "what was read of this night before stays" in caplog.text
    assert len(plant.files()) == 2


def test_a_night_that_takes_too_long_costs_that_night_alone(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database)
    stuck = f" AND (time < {stamp(NIGHTS[0], DAY / 2)} OR time > {stamp(NIGHTS[1], DAY / 2)}"
    plant.configure(
        logs_toml(f"{QUERY} {stuck} OR pg_sleep(60) IS NULL)", more="statement_timeout_s = 0.3\n")
    )
    (name, fault), *others = plant.land().items()
    assert (name, fault.code, others) == (f"{NIGHTS[1]}.parquet", "database_slow", [])
    assert "statement_timeout_s is 0.3" in fault.message
    assert sorted(plant.files()) == [f"{NIGHTS[0]}.parquet", f"{NIGHTS[2]}.parquet"]
    # It is asked for again, though beyond the look-back by then.
    assert plant.land(CLOCK + 3 * DAY).keys() == {name}


@pytest.mark.parametrize(
    ("address", "code"),
    [
        ("", "database_address"),
        ("nonsense", "database_address"),
        (f"postgresql://owner:{SECRET}wrong@127.0.0.1:PORT/postgres", "database_refused"),
        ("postgresql://owner@127.0.0.1:PORT/postgres", "database_refused"),
        (f"postgresql://owner:{SECRET}@127.0.0.1:PORT/absent", "database_refused"),
        (f"postgresql://owner:{SECRET}/x@127.0.0.1:PORT/postgres", "database_address"),
        (f"postgresql://owner:{SECRET}%zz@127.0.0.1:PORT/postgres", "database_address"),
        (f"postgresql://owner:x@{SECRET}@127.0.0.1:PORT/postgres", "database_unreachable"),
        (f"host=127.0.0.1 port=PORT user=owner password={SECRET}", "database_refused"),
    ],
)
def test_an_address_that_leads_nowhere_is_told_without_its_password(
    database: PostgresServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    address: str,
    code: str,
) -> None:
    plant = Plant.at(tmp_path, database, nights=0)
    monkeypatch.setenv(VARIABLE, address.replace("PORT", str(database.port)))
    ((name, fault),) = plant.land().items()
    assert (name, fault.code) == (f"{FIRST}.parquet", code)
    assert VARIABLE in fault.message
    assert SECRET not in fault.message


@pytest.mark.parametrize(
    ("statement", "code", "words"),
    [
        ("ALTER TABLE log RENAME speed TO n", "log_column_missing", '"speed" does not exist'),
        ("DROP TABLE log", "database_query", 'relation "log" does not exist'),
        (
            "ALTER TABLE log ALTER speed TYPE interval USING make_interval(secs => speed)",
            "database_rows",
            "column 'speed' is of type",
        ),
    ],
)
def test_a_query_that_is_refused_is_told_with_the_night(
    database: PostgresServer, tmp_path: Path, statement: str, code: str, words: str
) -> None:
    plant = Plant.at(tmp_path, database)
    plant.land(CLOCK - DAY)
    database.run(statement)
    ((name, fault),) = plant.land().items()
    assert (name, fault.code) == (f"{NIGHTS[2]}.parquet", code)
    assert words in fault.message
    assert NIGHTS[2].isoformat() in fault.message
    assert "LINE 1" not in fault.message


def test_a_query_cannot_write(database: PostgresServer, tmp_path: Path) -> None:
    plant = Plant.at(tmp_path, database, nights=1)
    plant.configure(
        logs_toml(
            "WITH gone AS (DELETE FROM log RETURNING *) SELECT * FROM gone "
            "WHERE time >= {start} AND time < {end}"
        )
    )
    ((_, fault),) = plant.land().items()
    assert fault.code == "database_query"
