"""A changed setting makes anew what depends on it, from the logs only where it must.

Nights fitted anew from their statistics give what their logs would give.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

import pipeline.logs.motor_logs
from pipeline.config import hashes
from pipeline.errors import LogError
from pipeline.schema import NIGHT_TABLES
from tests.pipeline.simulated import NIGHT
from tests.pipeline.workshop import DAY, QUICK, Workshop

OTHER_REFERENCE = QUICK + "[reference]\npressure_bar = 150.0\ntemperature_c = 45.0\n"
OTHER_CLEANING = QUICK + "[cleaning]\nhampel_threshold = 6.0\n"


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three nights, done."""
    made = Workshop.at(tmp_path_factory.mktemp("done"))
    for day in range(3):
        made.log(NIGHT + day * DAY, seed=day)
    assert made.run().status == "ok"
    return made.folder


@pytest.fixture
def workshop(done: Path, tmp_path: Path) -> Workshop:
    """A copy of them."""
    return Workshop(Path(shutil.copytree(done, tmp_path / "copy")))


def refuse(path: Path, _: object) -> None:
    raise LogError("log_not_readable", path, "it must not be read")


def from_scratch(workshop: Workshop) -> Workshop:
    """The same logs and config with an output of its own."""
    fresh = Workshop(workshop.folder / "fresh")
    shutil.copytree(workshop.folder / "configs", fresh.folder / "configs")
    shutil.copytree(workshop.folder / "logs", fresh.folder / "logs")
    assert fresh.run().status == "ok"
    return fresh


def figures(workshop: Workshop, table: str) -> pl.DataFrame:
    return workshop.rows(table).drop("is_refitted", strict=False)


@pytest.mark.parametrize(
    "fleet",
    [OTHER_REFERENCE, QUICK + "[model]\nfilm_pressure_share_tolerance = 0.1\n"],
    ids=["reference conditions", "a tolerance"],
)
def test_settings_of_the_fit_need_no_log(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch, fleet: str
) -> None:
    refitted = ("fits", "parameters", "sensitivities")
    others = {
        table.name: workshop.rows(table.name)
        for table in NIGHT_TABLES
        if table.name not in refitted
    }
    workshop.configure(fleet=fleet)
    with monkeypatch.context() as patch:
        patch.setattr(pipeline.logs.motor_logs, "read_log", refuse)
        outcome = workshop.run()
    assert (len(outcome.nights), outcome.n_refitted, outcome.status) == (3, 3, "ok")
    assert workshop.rows("fits")["is_refitted"].all()
    for name, before in others.items():
        assert_frame_equal(workshop.rows(name), before, check_exact=True)
    assert not workshop.run().nights
    if fleet == OTHER_REFERENCE:
        # They give what the logs would give.
        fresh = from_scratch(workshop)
        for table in refitted:
            made, read = (figures(one, table) for one in (workshop, fresh))
            assert_frame_equal(made, read, rel_tol=1e-9, abs_tol=1e-9)


def test_a_night_of_merged_blocks_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workshop = Workshop.at(tmp_path)
    workshop.log(NIGHT)
    workshop.configure(fleet=QUICK + "[windows]\nmaximum_blocks = 4\n")
    workshop.run()
    blocks, before = workshop.rows("block_statistics"), figures(workshop, "fits")
    assert blocks.height <= 4
    monkeypatch.setattr(hashes, "FIGURES_VERSION", -1)
    assert workshop.run().n_refitted == 1
    assert_frame_equal(figures(workshop, "fits"), before)


def test_settings_of_the_statistics_need_the_logs(workshop: Workshop) -> None:
    workshop.configure(fleet=OTHER_CLEANING)
    outcome = workshop.run()
    assert (len(outcome.nights), outcome.n_refitted) == (3, 0)
    fresh = from_scratch(workshop)
    for table in NIGHT_TABLES:
        assert_frame_equal(workshop.rows(table.name), fresh.rows(table.name), check_exact=True)


def test_without_its_logs_a_published_night_stays(workshop: Workshop) -> None:
    before = workshop.rows("fits")
    shutil.rmtree(workshop.logs)
    workshop.configure(fleet=OTHER_CLEANING)
    assert not workshop.run().nights
    assert_frame_equal(workshop.rows("fits"), before, check_exact=True)


def test_damaged_statistics_are_made_anew_from_the_log(workshop: Workshop) -> None:
    for path in (workshop.output / "tables" / "block_statistics").rglob("*.parquet"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    workshop.configure(fleet=OTHER_REFERENCE)
    outcome = workshop.run()
    assert (len(outcome.nights), outcome.n_refitted) == (3, 0)
    fresh = from_scratch(workshop)
    for table in ("fits", "parameters"):
        assert_frame_equal(workshop.rows(table), fresh.rows(table), check_exact=True)
