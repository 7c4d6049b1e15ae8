"""`check`, `init` and `look` of a database."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.config import load_fleet
from pipeline.ingest import read_log
from pipeline.logs.landing import land_nights
from pipeline.setup.check import check_motor
from tests.pipeline.plant_database import FIRST, QUERY, VARIABLE, Plant, latest, table
from tests.pipeline.postgres_server import SECRET, PostgresServer
from tests.pipeline.workshop import Workshop


def test_check_looks_at_the_newest_nights_and_writes_nothing(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database)
    found = check_motor(plant.spec)
    assert (found.n_files, found.first, found.last) == (3, "2026-01-02", "2026-01-04")
    assert len(found.channels) == 4
    assert not plant.output.exists()
    database.run("ALTER TABLE log RENAME speed TO n")
    (fault,) = check_motor(plant.spec).faults
    assert fault.startswith("log_column_missing: ")
    database.run("ALTER TABLE log RENAME n TO speed", "TRUNCATE log")
    (fault,) = check_motor(plant.spec).faults
    assert fault == "database_empty: there are no rows from the night 2026-01-02 on"


def test_init_proposes_the_motors_of_a_table(database: PostgresServer, tmp_path: Path) -> None:
    shop = Workshop.at(tmp_path / "made")
    operation, values = shop.night(FIRST)
    labels = ("dp [bar]", "T_oil [degC]", "n [rpm]", "leak [l/min]")
    columns = {
        f"W{motor}_{label}": value
        for motor in (1, 2)
        for label, value in zip(labels, values.values(), strict=True)
    }
    database.fill("plant", table(operation.time_us, columns))
    database.run("ALTER TABLE plant ADD id uuid, ADD entered timestamptz")
    answers = {"motor_type": "CB560", "oil": "vg68"}
    to, query = tmp_path / "fleet", QUERY.replace("log", "plant")
    done = init(f"sql:{VARIABLE}", "--query", query, "--to", str(to), "--write", **answers)
    assert done.exit_code == 0, done.output
    fleet = load_fleet(to / "fleet.toml")
    assert [spec.motor_id for spec in fleet.motors] == ["W1", "W2"]
    assert not any(SECRET in path.read_text("utf-8") for path in to.rglob("*.toml"))
    (spec, _) = fleet.motors
    assert spec.file.logs.database.begin == FIRST
    assert land_nights(spec, latest()) == {}
    found = read_log(spec.log_root / f"{FIRST}.parquet", spec.file.logs, spec.file.channels)
    for name, value in values.items():
        np.testing.assert_allclose(found.channels[name].value, value)


def init(source: str, *options: str, **answers: str) -> Result:
    given = [part for one in answers.items() for part in ("--answer", "=".join(one))]
    return CliRunner().invoke(app, ["init", source, *options, *given])


@pytest.mark.parametrize(
    ("source", "options", "words"),
    [
        (f"postgresql://me:{SECRET}@host/db", [], "motor-leakage init sql:PLANT_DATABASE"),
        (f"sql:postgresql://me:{SECRET}@host/db", ["--query", QUERY], "expected ${NAME}"),
        (f"sql:{VARIABLE}", ["--query", "SELECT 1"], "expected the marks {start} and {end}"),
        (f"sql:{VARIABLE}", [], "expected the marks {start} and {end}"),
        ("logs", ["--query", QUERY], "--query is of a database"),
    ],
)
def test_what_init_cannot_ask_is_refused_without_a_secret(
    database: PostgresServer, source: str, options: list[str], words: str
) -> None:
    error = init(source, *options).exception
    assert words in error.message
    assert SECRET not in error.message


def test_a_look_refuses_a_database(database: PostgresServer, tmp_path: Path) -> None:
    plant = Plant.at(tmp_path, database, nights=0)
    error = CliRunner().invoke(app, ["look", str(plant.fleet)]).exception
    assert error.code == "look_logs"
