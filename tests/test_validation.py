"""The scripts of `validation/`, on a small made-up record of the same shape as the rig's."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from validation import published, pump_rig
from validation.record import FLOW, PRESSURE, STATE, TEMPERATURE, TIME, read_records, windows
from validation.tables import Table, show

BEGIN = dt.datetime(2024, 3, 15, 8, 33, 44, tzinfo=dt.UTC)
SECOND = dt.timedelta(seconds=1)


def rows(minutes: float, state: int = 1, begin: dt.datetime = BEGIN) -> pl.DataFrame:
    """A warm record whose flow is 0.9 l/min and a laminar leak, down to the meter's floor."""
    t = np.arange(round(60 * minutes))
    pressure = 127.0 + 105.0 * np.sin(2.0 * np.pi * t / 120.0)
    flow = 0.9 + 0.0135 * pressure
    return pl.DataFrame(
        {
            TIME: pl.Series([begin + second * SECOND for second in t.tolist()]),
            STATE: [state] * t.size,
            PRESSURE: pressure,
            TEMPERATURE: 54.0 + np.sin(2.0 * np.pi * t / 600.0),
            FLOW: np.where(flow < 1.8, 1.2, flow),
        }
    )


def written(folder: Path, *parts: pl.DataFrame) -> Path:
    """A file of the rig with these parts, one after the other; its folder."""
    pl.concat(parts).write_csv(folder / "dane_UT9.csv", datetime_format="%F %T+00:00")
    return folder


class TestRecords:
    def test_what_is_no_record_is_refused_by_name(self, tmp_path: Path) -> None:
        with pytest.raises(SystemExit, match="no file"):
            read_records(tmp_path)
        rows(1).drop(FLOW).write_csv(tmp_path / "UT1.csv")
        with pytest.raises(SystemExit, match=f"UT1.csv: no column {FLOW}"):
            read_records(tmp_path)

    def test_states_are_never_averaged(self, tmp_path: Path) -> None:
        for later in (rows(3, 2, BEGIN + dt.timedelta(minutes=2)), rows(3)):
            with pytest.raises(SystemExit, match="several states, or a clock that goes back"):
                read_records(written(tmp_path, rows(2), later))

    def test_windows_have_their_length_and_begin_at_each_step(self) -> None:
        minute = dt.timedelta(minutes=1)
        cut = windows(rows(10), 4 * minute, 3 * minute)
        assert [(window[TIME][0] - BEGIN, window.height) for window in cut] == [
            (0 * minute, 240),
            (3 * minute, 240),
        ]
        assert windows(rows(3), 4 * minute, minute) == []


def recorded(folder: Path) -> Path:
    """A record of the law with a pause; its folder."""
    return written(folder, rows(12), rows(18, begin=BEGIN + dt.timedelta(minutes=14)))


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Table]:
    folder = tmp_path_factory.mktemp("rig")
    return {table.name: table for table in pump_rig.judge(recorded(folder), folder / "work")}


class TestPumpRig:
    def test_a_record_of_the_law_is_fitted_on_held_out_blocks(
        self, answers: dict[str, Table]
    ) -> None:
        fits = {
            row["samples"]: float(row["held-out fit"].removesuffix(" %"))
            for row in answers["held_out"].rows[:3]
        }
        assert fits["meter reads"] > 90.0 > fits["every sample"]

    def test_the_leakage_of_a_labelled_state_is_the_true_one(
        self, answers: dict[str, Table]
    ) -> None:
        (row,) = answers["labels"].rows
        assert (row["record"], row["state"]) == ("dane_UT9", "1")
        assert float(row["leakage, l/min"]) == pytest.approx(0.0135 * 150.0, rel=0.03)


@pytest.mark.full
def test_a_record_has_a_picture(tmp_path: Path) -> None:
    pump_rig.judge(recorded(tmp_path), tmp_path / "work", tmp_path)
    assert (tmp_path / "real_machines_dane_UT9.png").stat().st_size > 10_000


def test_published_coefficients_are_recovered_by_config_alone(tmp_path: Path) -> None:
    (table,) = published.judge(tmp_path / "work", minutes=12.0)
    assert [row["within 1 %"] for row in table.rows] == ["yes"] * len(published.PUBLISHED_M3)
    # The textbook's gap leaks as the textbook says.
    one_piston = published.PUBLISHED_M3["nine_pistons"] / 9.0
    assert one_piston * 19e6 / 0.018 == pytest.approx(57.6e-9, rel=1e-3)  # m³/s


def test_a_table_takes_its_place_in_the_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- one -->\nold\n<!-- end -->\nafter\n", "utf-8")
    show([Table("one", [{"a": "1", "b": "2"}]), Table("other", [])], page)
    assert page.read_text("utf-8") == (
        "before\n<!-- one -->\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\n<!-- end -->\nafter\n"
    )
