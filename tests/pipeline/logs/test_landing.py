"""Nights of a database: asked for once, whole or not at all, anew where their rows changed."""

from __future__ import annotations

import json
import logging
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.config import MotorSpec
from pipeline.config.nights import night
from pipeline.ingest import read_log
from pipeline.logs.landing import land_nights
from pipeline.run.motor_nights import peak_memory_mib
from tests.pipeline.plant_database import (
    CLOCK,
    FIRST,
    NIGHTS,
    QUERY,
    VARIABLE,
    Plant,
    latest,
    logs_toml,
    stamp,
)
from tests.pipeline.postgres_server import SECRET, PostgresServer
from tests.pipeline.workshop import DAY, Workshop, check_same_figures

log = logging.getLogger(__name__)


def test_a_run_reads_each_night_once_and_anew_where_its_rows_changed(
    database: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant, files = Plant.at(tmp_path / "sql", database), Workshop.at(tmp_path / "files")
    monkeypatch.setenv(VARIABLE, f"postgresql://owner:{SECRET}@127.0.0.1:9/postgres")
    gone = plant.run(clock=CLOCK)
    assert (gone.counts, gone.error_code) == ({"failed": 1}, "database_unreachable")
    assert SECRET not in str(gone)
    monkeypatch.setenv(VARIABLE, database.address())
    assert plant.run(clock=CLOCK).counts == {"ok": 3}
    for seed, label in enumerate(NIGHTS):
        files.log(label, seed=seed)
    files.run()
    check_same_figures(files, plant, "input_files")
    database.run(f"UPDATE log SET speed = speed + 1 WHERE time > {stamp(NIGHTS[1])}")
    assert (again := plant.run(clock=CLOCK)).nights == (NIGHTS[2],)
    assert again.files == {"read": 1, "unchanged": 2}
    assert plant.run(clock=CLOCK).files == {"unchanged": 3}


def test_rows_are_looked_for_again_within_the_look_back(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database)
    plant.land()
    before = plant.files()
    late = [f"SELECT {stamp(label, DAY / 8)}, 150.0, 50.0, 30.0, 1.0" for label in NIGHTS]
    # The newest night and the one before are within the look-back; the first is not.
    database.run(*(f"INSERT INTO log {row}" for row in late))
    plant.land()
    changed = {name for name, one in plant.files().items() if one != before[name]}
    assert changed == {f"{label}.parquet" for label in NIGHTS[1:]}
    assert (
        plant.landed(NIGHTS[1]).num_rows
        == pq.read_metadata(plant.spec.log_root / f"{FIRST}.parquet").num_rows + 1
    )


def test_files_stay_where_the_same_rows_come_in_another_order(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database)
    assert plant.land() == {}
    before = {one: one.stat().st_mtime_ns for one in plant.spec.log_root.glob("*.parquet")}
    database.run(
        "ALTER TABLE log RENAME TO old",
        "CREATE TABLE log AS SELECT * FROM old ORDER BY leakage_flow DESC",
    )
    # Another query asks for all nights again, those beyond the look-back, too.
    plant.configure(logs_toml(QUERY + " AND true"))
    assert plant.land() == {}
    assert {one: one.stat().st_mtime_ns for one in before} == before
    assert len(before) == 3


def test_an_empty_night_has_no_file_and_is_not_asked_for_for_good(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database, nights=2)
    assert plant.land(CLOCK + DAY) == {}
    assert sorted(plant.files()) == [f"{label}.parquet" for label in NIGHTS[:2]]
    plant.fill(NIGHTS[2], 2)
    assert plant.land(CLOCK + 3 * DAY) == {}
    assert f"{NIGHTS[2]}.parquet" not in plant.files()  # three nights late; one is looked back


def test_a_night_that_lost_all_its_rows_keeps_what_was_read(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database)
    plant.land()
    before = plant.files()
    database.run("TRUNCATE log")
    plant.land()
    assert plant.files() == before


def test_a_motor_takes_its_own_rows_and_tags_of_a_long_table(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database)
    tags = {
        "pressure_difference": "dp",
        "oil_temperature": "TOIL",
        "speed": "n",
        "leakage_flow": "it's \\",
    }
    parts = [
        f"SELECT time, '{motor}' AS motor, $${tag}$$ AS tag, ({channel} + {plus})::numeric "
        "AS reading FROM log"
        for motor, plus in (("M1", 0), ("M2", 1000))
        for channel, tag in {**tags, "speed * 2": "other"}.items()
    ]
    database.run(
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
        text = text.replace(f'source = "{channel}"', f"source = {json.dumps(tag)}")
    (tmp_path / "configs/motors/M1.toml").write_text(text, "utf-8")
    database.run("ALTER ROLE owner SET standard_conforming_strings = off")
    try:
        assert plant.land() == {}
    finally:
        database.run("ALTER ROLE owner RESET standard_conforming_strings")
    rows = plant.landed(FIRST)
    assert set(rows["tag"].to_pylist()) == set(tags.values())
    assert set(rows["motor"].to_pylist()) == {"M1"}
    assert rows["reading"].type == pa.float64()
    spec = plant.spec
    found = read_log(spec.log_root / f"{FIRST}.parquet", spec.file.logs, spec.file.channels)
    _, values = plant.night(FIRST, seed=0)
    for name, value in values.items():
        channel = found.channels[name]
        # PostgreSQL makes 15 digits of a float.
        np.testing.assert_allclose(channel.value[~channel.missing], value, rtol=1e-14)


def test_stamps_without_a_zone_are_of_the_zone_of_the_config(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database)
    database.run("ALTER TABLE log ALTER time TYPE timestamp USING time AT TIME ZONE 'Asia/Tokyo'")
    plant.configure(logs_toml(logs='time_zone = "Asia/Tokyo"\n'))
    plant.land()
    spec, here = plant.spec, night(FIRST, plant.spec.settings.nights)
    log = read_log(spec.log_root / f"{FIRST}.parquet", spec.file.logs, spec.file.channels)
    operation, _ = plant.night(FIRST, seed=0)
    assert log.ends() == (operation.time_us[0], operation.time_us[-1])
    assert here.start_us <= operation.time_us[0] < here.end_us


@pytest.mark.full
def test_ten_million_rows_take_no_more_memory_than_a_few_batches(
    database: PostgresServer, tmp_path: Path
) -> None:
    plant = Plant.at(tmp_path, database, nights=0)
    plant.configure(
        logs_toml(
            "SELECT {start} + n * interval '8 ms' AS time, sin(n) AS pressure_difference, "
            "cos(n) AS oil_temperature, n * 0.5 AS speed, n % 100 AS leakage_flow, {end} AS other "
            "FROM generate_series(0, 9999999) AS n"
        )
    )
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        before_mib, after_mib = pool.submit(peaks_of_landing, plant.spec).result()
    assert pq.read_metadata(plant.spec.log_root / f"{FIRST}.parquet").num_rows == 10_000_000
    log.info("landing took %.0f MiB beside %.0f before", after_mib - before_mib, before_mib)
    # The rows are 400 MB; the file is written as they come.
    assert after_mib - before_mib < 100


def peaks_of_landing(spec: MotorSpec) -> tuple[float, float]:
    """Largest memory of this process before and after a night is landed [MiB]."""
    assert land_nights(spec, latest(CLOCK - 3 * DAY)) == {}  # before the first: nothing to ask
    before = peak_memory_mib()
    assert land_nights(spec, latest(CLOCK - 2 * DAY)) == {}
    return before, peak_memory_mib()
