"""Nights of a database: asked for once, whole or not at all, anew where their rows changed."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

import pipeline.logs.database
from pipeline.config import MotorSpec, load_fleet
from pipeline.config.nights import night
from pipeline.errors import LogError
from pipeline.ingest import read_log
from pipeline.logs.landing import land_nights
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.run.tasks import MotorOutcome
from tests.pipeline.postgres_server import SECRET, PostgresServer
from tests.pipeline.simulated import motor_toml, write_configs
from tests.pipeline.workshop import DAY, MINI, QUICK, Workshop, check_same_figures

VARIABLE = "MOTOR_LEAKAGE_DATABASE"
FIRST = dt.date(2026, 1, 2)
# Of the three nights the third is over, as it ends at 06:00.
CLOCK = dt.datetime(2026, 1, 4, 8, tzinfo=dt.UTC)
NIGHTS = tuple(FIRST + n * DAY for n in range(3))
QUERY = "SELECT * FROM log WHERE time >= {start} AND time < {end}"
FILES = 'format = "parquet"\nfiles = ["M1/*.parquet"]\n'


@pytest.fixture
def server(postgres: PostgresServer, monkeypatch: pytest.MonkeyPatch) -> Iterator[PostgresServer]:
    """The server without any table of a test before, and the environment that leads to it."""
    postgres.run("DROP SCHEMA public CASCADE", "CREATE SCHEMA public")
    monkeypatch.setenv(VARIABLE, postgres.address())
    monkeypatch.setattr(pipeline.logs.database, "WAITS_S", (0.0,))
    yield postgres
    postgres.end_connections()


def latest(clock: dt.datetime = CLOCK) -> int:
    return round((clock + DAY).timestamp()) * 1_000_000


def logs_toml(query: str = QUERY, logs: str = "", more: str = "") -> str:
    return (
        f'format = "sql"\n{logs}[logs.database]\nbegin = {FIRST}\nquery = """{query}"""\n'
        f"look_back_days = 1\n{more}"
    )


@dataclass(frozen=True, slots=True)
class Plant:
    """A motor whose nights lie in the table `log`."""

    shop: Workshop
    server: PostgresServer

    @classmethod
    def at(cls, folder: Path, server: PostgresServer, nights: int = 3) -> Plant:
        made = cls(Workshop.at(folder), server)
        for seed, label in enumerate(NIGHTS[:nights]):
            made.fill(label, seed)
        made.configure()
        return made

    def configure(self, text: str | None = None) -> None:
        motor = motor_toml("M1", "MINI").replace(FILES, text or logs_toml())
        write_configs(self.shop.folder, {"M1": motor}, {"MINI": MINI}, QUICK)

    def fill(self, label: dt.date, seed: int) -> None:
        operation, values = self.shop.night(label, seed)
        self.server.fill("log", table(operation.time_us, values))

    @property
    def spec(self) -> MotorSpec:
        (spec,) = load_fleet(self.shop.fleet).motors
        return spec

    def land(self, clock: dt.datetime = CLOCK) -> dict[str, LogError]:
        return land_nights(self.spec, latest(clock))

    def run(self, clock: dt.datetime = CLOCK) -> MotorOutcome:
        (outcome,) = run_fleet(RunRequest(load_fleet(self.shop.fleet), clock=clock)).outcomes
        return outcome

    def files(self) -> dict[str, bytes]:
        return {one.name: one.read_bytes() for one in self.spec.log_root.glob("*.parquet")}

    def rows(self, label: dt.date) -> pa.Table:
        return pq.read_table(self.spec.log_root / f"{label}.parquet")


def table(time_us: Any, values: Mapping[str, Any]) -> pa.Table:
    return pa.table({"time": pa.array(time_us, pa.timestamp("us", "UTC")), **values})


def stamp(label: dt.date, after: dt.timedelta = dt.timedelta()) -> str:
    """A time in the middle of a night, or so long after it."""
    return f"TIMESTAMPTZ '{label} 00:00:00+00' + interval '{after.total_seconds()} s'"


def test_a_run_reads_each_night_once_and_anew_where_its_rows_changed(
    server: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant, files = Plant.at(tmp_path / "sql", server), Workshop.at(tmp_path / "files")
    monkeypatch.setenv(VARIABLE, f"postgresql://owner:{SECRET}@127.0.0.1:9/postgres")
    gone = plant.run()
    assert (gone.counts, gone.error_code) == ({"failed": 1}, "database_unreachable")
    assert SECRET not in str(gone)
    monkeypatch.setenv(VARIABLE, server.address())
    assert plant.run().counts == {"ok": 3}
    for seed, label in enumerate(NIGHTS):
        files.log(label, seed=seed)
    files.run()
    check_same_figures(files, plant.shop, "input_files")
    server.run(f"UPDATE log SET speed = speed + 1 WHERE time > {stamp(NIGHTS[1])}")
    assert (again := plant.run()).nights == (NIGHTS[2],)
    assert again.files == {"read": 1, "unchanged": 2}
    assert plant.run().files == {"unchanged": 3}


def test_rows_are_looked_for_again_within_the_look_back(
    server: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, server)
    plant.land()
    before = plant.files()
    late = [f"SELECT {stamp(label, DAY / 8)}, 150.0, 50.0, 30.0, 1.0" for label in NIGHTS]
    # The newest night and the one before are within the look-back; the first is not.
    server.run(*(f"INSERT INTO log {row}" for row in late))
    plant.land()
    changed = {name for name, one in plant.files().items() if one != before[name]}
    assert changed == {f"{label}.parquet" for label in NIGHTS[1:]}
    assert (
        plant.rows(NIGHTS[1]).num_rows
        == pq.read_metadata(plant.spec.log_root / f"{FIRST}.parquet").num_rows + 1
    )


def test_files_stay_where_the_same_rows_come_in_another_order(
    server: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, server)
    assert plant.land() == {}
    before = {one: one.stat().st_mtime_ns for one in plant.spec.log_root.glob("*.parquet")}
    server.run(
        "ALTER TABLE log RENAME TO old",
        "CREATE TABLE log AS SELECT * FROM old ORDER BY leakage_flow DESC",
    )
    # Another query asks for all nights again, those beyond the look-back, too.
    plant.configure(logs_toml(QUERY + " AND true"))
    assert plant.land() == {}
    assert {one: one.stat().st_mtime_ns for one in before} == before
    assert len(before) == 3


def test_another_query_is_asked_for_all_nights(server: PostgresServer, tmp_path: Path) -> None:
    plant = Plant.at(tmp_path, server)
    plant.land()
    rows = plant.rows(FIRST)
    half = "SELECT time, pressure_difference / 2 AS pressure_difference, oil_temperature, speed, "
    plant.configure(
        logs_toml(f"{half} leakage_flow FROM log WHERE time >= {{start}} AND time < {{end}}")
    )
    plant.land()
    halved = pc.divide(rows["pressure_difference"], 2.0)
    assert plant.rows(FIRST)["pressure_difference"].equals(halved)


def test_an_empty_night_has_no_file_and_is_not_asked_for_for_good(
    server: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, server, nights=2)
    assert plant.land(CLOCK + DAY) == {}
    assert sorted(plant.files()) == [f"{label}.parquet" for label in NIGHTS[:2]]
    plant.fill(NIGHTS[2], 2)
    assert plant.land(CLOCK + 3 * DAY) == {}
    assert f"{NIGHTS[2]}.parquet" not in plant.files()  # three nights late; one is looked back


def test_a_night_that_lost_all_its_rows_keeps_what_was_read(
    server: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, server)
    plant.land()
    before = plant.files()
    server.run("TRUNCATE log")
    plant.land()
    assert plant.files() == before


def test_a_night_is_asked_for_when_it_is_over(server: PostgresServer, tmp_path: Path) -> None:
    plant = Plant.at(tmp_path, server)
    plant.land(CLOCK - dt.timedelta(hours=3))
    assert sorted(plant.files()) == [f"{label}.parquet" for label in NIGHTS[:2]]


# Connections


def test_a_connection_lost_in_a_result_is_made_anew_and_nothing_is_half_read(
    server: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = large(Plant.at(tmp_path, server, nights=1))
    signs: list[set[str]] = []

    def lost_once() -> None:
        signs.append({one.name for one in plant.spec.log_root.iterdir()})
        if len(signs) == 2:  # a batch is there, the rest of them under way
            server.end_connections()

    monkeypatch.setattr(pipeline.logs.database, "BATCH_BYTES", 1 << 16)
    monkeypatch.setattr(pipeline.logs.database, "still_alive", lost_once)
    assert plant.land(CLOCK - 2 * DAY) == {}
    assert all(name.startswith(".") for names in signs for name in names)
    assert plant.rows(FIRST).num_rows == LARGE
    assert sorted(one.name for one in plant.spec.log_root.iterdir()) == [
        f"{FIRST}.parquet",
        "landed.json",
    ]


LARGE = 200_000


def large(plant: Plant) -> Plant:
    """A night of more rows than a connection holds on their way."""
    plant.configure(
        logs_toml(
            f"SELECT {{start}} + n * interval '0.1 s' AS time, 100.0 AS pressure_difference, "
            f"50.0 AS oil_temperature, 30.0 AS speed, n AS leakage_flow, {{end}} AS other "
            f"FROM generate_series(0, {LARGE - 1}) AS n"
        )
    )
    return plant


def test_a_server_that_is_gone_is_asked_again_and_costs_no_night_that_is_known(
    server: PostgresServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    plant = Plant.at(tmp_path, server)
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
    server: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, server)
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
    server: PostgresServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    address: str,
    code: str,
) -> None:
    plant = Plant.at(tmp_path, server, nights=0)
    monkeypatch.setenv(VARIABLE, address.replace("PORT", str(server.port)))
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
    server: PostgresServer, tmp_path: Path, statement: str, code: str, words: str
) -> None:
    plant = Plant.at(tmp_path, server)
    plant.land(CLOCK - DAY)
    server.run(statement)
    ((name, fault),) = plant.land().items()
    assert (name, fault.code) == (f"{NIGHTS[2]}.parquet", code)
    assert words in fault.message
    assert NIGHTS[2].isoformat() in fault.message
    assert "LINE 1" not in fault.message


def test_a_table_that_may_not_be_read_is_told(
    server: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = Plant.at(tmp_path, server, nights=1)
    server.run("GRANT USAGE ON SCHEMA public TO reader")
    monkeypatch.setenv(VARIABLE, server.address("reader"))
    (fault,) = plant.land().values()
    assert (fault.code, SECRET in fault.message) == ("database_denied", False)
    assert "permission denied for table log" in fault.message
    server.run("GRANT SELECT ON log TO reader")
    assert plant.land() == {}


def test_a_query_cannot_write(server: PostgresServer, tmp_path: Path) -> None:
    plant = Plant.at(tmp_path, server, nights=1)
    plant.configure(
        logs_toml(
            "WITH gone AS (DELETE FROM log RETURNING *) SELECT * FROM gone "
            "WHERE time >= {start} AND time < {end}"
        )
    )
    ((_, fault),) = plant.land().items()
    assert fault.code == "database_query"


# Types and layouts


def test_a_motor_takes_its_own_rows_and_tags_of_a_long_table(
    server: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, server)
    tags = {
        "pressure_difference": "dp",
        "oil_temperature": "TOIL",
        "speed": "n",
        "leakage_flow": "it's",
    }
    parts = [
        f"SELECT time, '{motor}' AS motor, $${tag}$$ AS tag, ({channel} + {plus})::numeric "
        "AS reading FROM log"
        for motor, plus in (("M1", 0), ("M2", 1000))
        for channel, tag in {**tags, "speed * 2": "other"}.items()
    ]
    server.run(
        f"CREATE TABLE long AS {' UNION ALL '.join(parts)}",
        "INSERT INTO long SELECT time, 'M1', 'dp' FROM log LIMIT 1",
    )
    logs = (
        'layout = "long"\nchannel_column = "tag"\nvalue_column = "reading"\n'
        'motor_column = "motor"\nmotor_name = "M1"\n'
    )
    plant.configure(logs_toml(QUERY.replace("log", "long"), logs))
    text = (tmp_path / "configs/motors/M1.toml").read_text("utf-8")
    for channel, tag in tags.items():
        text = text.replace(f'source = "{channel}"', f'source = "{tag}"')
    (tmp_path / "configs/motors/M1.toml").write_text(text, "utf-8")
    assert plant.land() == {}
    rows = plant.rows(FIRST)
    assert set(rows["tag"].to_pylist()) == set(tags.values())
    assert set(rows["motor"].to_pylist()) == {"M1"}
    assert rows["reading"].type == pa.float64()
    spec = plant.spec
    found = read_log(spec.log_root / f"{FIRST}.parquet", spec.file.logs, spec.file.channels)
    _, values = plant.shop.night(FIRST, seed=0)
    for name, value in values.items():
        channel = found.channels[name]
        # PostgreSQL makes 15 digits of a float.
        np.testing.assert_allclose(channel.value[~channel.missing], value, rtol=1e-14)


def test_stamps_without_a_zone_are_of_the_zone_of_the_config(
    server: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, server)
    server.run("ALTER TABLE log ALTER time TYPE timestamp USING time AT TIME ZONE 'Asia/Tokyo'")
    plant.configure(logs_toml(logs='time_zone = "Asia/Tokyo"\n'))
    plant.land()
    spec, here = plant.spec, night(FIRST, plant.spec.settings.nights)
    log = read_log(spec.log_root / f"{FIRST}.parquet", spec.file.logs, spec.file.channels)
    operation, _ = plant.shop.night(FIRST, seed=0)
    assert (log.first_us, log.last_us) == (operation.time_us[0], operation.time_us[-1])
    assert here.start_us <= operation.time_us[0] < here.end_us
