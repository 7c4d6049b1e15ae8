"""A plant's first day: from a folder of logs of other physics to what is reported of each motor.

The plant is a sugar mill of other physics than the model that is fitted. Three slow drives write
one CSV file a day each, as a German control system does. The drain flow has a laminar part, a part
that goes with the speed and one through an orifice; the oil's viscosity falls by a power of e. What
goes wrong is what goes wrong in plants: a drive worsens, two columns change places, a file is cut,
and one drive logs MPa beside bar.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from pipeline.schema import LATEST
from pipeline.store.tables import read_table, whole_file
from tests.pipeline.calling import Call
from tests.scenarios.fleets import SEQUENTIAL

Array = NDArray[np.float64]

FIRST = dt.date(2026, 3, 2)
# Days are numbered from 0.
WORSENS_ON, SWAPPED_FROM, DAYS = 9, 11, 13
CUT_ON = DAYS - 1
WORSE_BY = 0.25
SHIFT_BEGINS, PERIOD_S = dt.time(6), 5
ATTEMPERED_C, COLD_C, WARMS_IN_S = 46.0, 30.0, 5400.0


@dataclass(frozen=True)
class Drive:
    """A drive: how its gauges log, and how much it leaks [l/min]."""

    name: str
    pressure_unit: str
    laminar: float  # at 180 bar and 40 °C
    by_speed: float  # at 6 rpm
    orifice: float  # at 180 bar
    worsens: bool = False
    is_swapped: bool = False
    is_cut: bool = False


WORSENS, SWAPPED, CUT = DRIVES = (
    Drive("Walze1", "bar", 1.1, 0.20, 0.45, worsens=True),
    Drive("Walze2", "bar", 0.9, 0.25, 0.40, is_swapped=True),
    Drive("Walze3", "MPa", 1.3, 0.15, 0.50, is_cut=True),
)


def write_mill(folder: Path, shift_h: float, seed: int = 1) -> Path:
    """Write the logs of all drives, of a shift a day; their folder."""
    for number, drive in enumerate(DRIVES):
        for day in range(DAYS):
            rng = np.random.default_rng((seed, number, day))
            path = folder / drive.name / f"{drive.name}_{FIRST + dt.timedelta(day):%Y%m%d}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            text = _as_text(drive, _day(drive, day, shift_h, rng), is_swapped=day >= SWAPPED_FROM)
            if drive.is_cut and day == CUT_ON:
                text = text[: 7 * len(text) // 10]
            path.write_text(text, "utf-8")
    return folder


def _day(drive: Drive, day: int, shift_h: float, rng: np.random.Generator) -> pl.DataFrame:
    """A day's readings, in bar, °C, rpm and l/min."""
    seconds = np.arange(0.0, shift_h * 3600.0, PERIOD_S)
    n = len(seconds)
    load = 175.0 + 35.0 * _wander(rng, n, 300.0) + 8.0 * _wander(rng, n, 20.0)
    difference = np.clip(load, 40.0, 280.0)
    speed = np.clip(6.5 + 1.2 * _wander(rng, n, 600.0), 4.0, 9.0)
    warm = ATTEMPERED_C + 3.0 * rng.standard_normal() + 1.5 * _wander(rng, n, 2000.0)
    temperature = warm - (ATTEMPERED_C - COLD_C) * np.exp(-seconds / WARMS_IN_S)
    low = 14.0 + 0.5 * _wander(rng, n, 60.0)
    viscosity = np.exp(-0.045 * (temperature - 40.0))
    flow = (
        drive.laminar * difference / 180.0 / viscosity
        + drive.by_speed * speed / 6.0
        + drive.orifice * np.sqrt(difference / 180.0)
    )
    if drive.worsens and day >= WORSENS_ON:
        flow = flow * (1.0 + WORSE_BY)
    begin = dt.datetime.combine(FIRST + dt.timedelta(day), SHIFT_BEGINS)
    noise = rng.standard_normal((5, n))
    return pl.DataFrame(
        {
            "time": [begin + dt.timedelta(seconds=second) for second in seconds.tolist()],
            "high": difference + low + 0.4 * noise[0],
            "low": low + 0.1 * noise[1],
            "temperature": temperature + 0.1 * noise[2],
            "speed": speed + 0.02 * noise[3],
            "flow": flow + 0.02 * noise[4],
        }
    )


def _wander(rng: np.random.Generator, n: int, memory_s: float) -> Array:
    """A reading that wanders about 0 with a standard deviation of 1."""
    keeps = float(np.exp(-PERIOD_S / memory_s))
    steps = np.sqrt(1.0 - keeps**2) * rng.standard_normal(n)
    steps[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -keeps], steps))


def _as_text(drive: Drive, readings: pl.DataFrame, *, is_swapped: bool) -> str:
    """A day's log as the control system writes it."""
    unit = drive.pressure_unit
    if unit == "MPa":
        readings = readings.with_columns(pl.col("high", "low") / 10.0)
    if drive.is_swapped and is_swapped:
        readings = readings.rename({"temperature": "speed", "speed": "temperature"})
    columns = {
        "Zeit": pl.col("time").dt.strftime("%d.%m.%Y %H:%M:%S"),
        f"Druck Zulauf [{unit}]": pl.col("high").round(2 if unit == "bar" else 3),
        f"Druck Rücklauf [{unit}]": pl.col("low").round(2 if unit == "bar" else 3),
        "Öltemperatur [°C]": pl.col("temperature").round(1),
        "Drehzahl [1/min]": pl.col("speed").round(2),
        "Lecköl [l/min]": pl.col("flow").round(3),
    }
    found = readings.select(**columns)
    return found.write_csv(separator=";", decimal_comma=True)


ANSWERS = {"time_zone": "Europe/Berlin", "motor_type": "CB560", "oil": "vg68"}


def test_a_mills_first_day_in_four_commands(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_mill(tmp_path / "logs", shift_h=2)
    monkeypatch.chdir(tmp_path)
    answers = [part for key in ANSWERS for part in ("--answer", f"{key}={ANSWERS[key]}")]
    fleet = Path("fleet/fleet.toml")

    code, shown, _ = call("init", "logs", *answers, "--write")
    assert code == 0
    days = "13 files, 2026-03-02 to 2026-03-14 (13 days)"
    assert f"Walze1: {days}, time Zeit %d.%m.%Y %H:%M:%S, zone Europe/Berlin" in shown
    with fleet.open("a", encoding="utf-8") as file:
        file.write(SEQUENTIAL)
    stray = Path("logs/Walze1/old.csv")
    stray.write_bytes(next(Path("logs/Walze1").iterdir()).read_bytes())
    code, noted, said = call("check", fleet)
    assert code == 1
    assert "Walze2_20260313.csv) on: columns changed? oil temperature and speed look swap" in said
    assert "Walze3_20260314.csv: the last line has no end" in noted
    assert "1 file matches no motor: Walze1/old.csv" in noted
    code, _, said = call("fit-fleet", fleet)
    assert code == 1
    assert "Walze2: columns_changed: night 2026-03-13: columns changed?" in said
    assert "1 file matches no motor: Walze1/old.csv" in said
    assert "Walze3_20260314.csv: 1 last row without a line end" in said
    code, _, _ = call("report", fleet)
    assert code == 0

    output = Path("fleet/out")
    rows = read_table(whole_file(output, LATEST), LATEST).to_dicts()
    latest = {row["motor_id"]: row for row in rows}
    worse = latest[WORSENS.name]
    assert worse["state"] in ("warning", "alarm")
    assert worse["leakage_change_lower"] < 100 * WORSE_BY < worse["leakage_change_upper"]
    assert worse["onset_earliest"].isoformat() <= "2026-03-11" <= worse["onset_latest"].isoformat()
    for drive in (SWAPPED, CUT):
        assert latest[drive.name]["state"] == "ok"
        assert latest[drive.name]["sentence"].startswith("no change detected since ")
        assert latest[drive.name]["detection_limit_percent"] < 10.0
        page = (output / f"report/motors/{drive.name}.html").read_text("utf-8")
        assert "No change detected since" in page
    assert "columns changed?" in latest[SWAPPED.name]["reason"]
    # Cut after 70 % of the shift.
    for words in ("1.4 h of log, 2.0 h in the nights before", "1 last row without a line end"):
        assert words in latest[CUT.name]["log_note"]
        assert words in (output / f"report/motors/{CUT.name}.html").read_text("utf-8")
