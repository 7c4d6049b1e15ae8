"""The last sample of an on-change channel before a night holds into it, in any file."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.config import Channel, Settings, load_fleet
from pipeline.ingest import RawChannel
from pipeline.night.cleaning import ChannelRules, CleanChannel, clean_channel
from pipeline.night.on_grid import on_grid
from pipeline.night.time_base import Samples, bring_together
from tests.pipeline.simulated import (
    NIGHT,
    SECOND_US,
    Operation,
    motor_toml,
    night_of,
    operate,
    write_configs,
)
from tests.pipeline.workshop import DAY, MINI, QUICK, Workshop, check_same_figures

START = night_of().start_us
SILENCE_S = 600.0
Log = Mapping[str, pa.Array]
Make = Callable[[], Workshop]


def cleaned(seconds: list[int], value: list[float], **keys: Any) -> CleanChannel:
    """An on-change channel whose times count from the night's start; nan for a blank cell."""
    bad = np.isin(np.array(value), keys.pop("bad", []))
    stated: dict[str, Any] = {"sampling": "on_change", "longest_silence_s": 100.0} | keys
    channel = Channel(source="x", unit=stated.pop("unit", "bar"), **stated)
    name = "leakage_flow" if channel.is_counted else "pressure_difference"
    rules = ChannelRules.of(name, channel)
    values = np.array(value)
    times = START + np.array(seconds, dtype=np.int64) * SECOND_US
    return clean_channel(RawChannel(times, values, np.isnan(values), 0, bad), rules, START)


def at(channel: CleanChannel, *seconds: int) -> list[float]:
    chosen = np.array(seconds) - seconds[0]
    grid = START + np.arange(seconds[0], seconds[-1] + 1, dtype=np.int64) * SECOND_US
    value, present, _ = on_grid(channel, grid, SECOND_US)
    return np.where(present, value, np.nan)[chosen].tolist()


NONE = float("nan")


METER = {"volume_per_count_cm3": 1000.0, "unit": "count"}
HOLD = {"between": "hold"}


@pytest.mark.parametrize(
    ("seconds", "values", "keys", "expected"),
    [
        # Held until the first of the night, or interpolated.
        ([-300, -50, -20, 30], [1.0, 2.0, 3.0, 4.0], HOLD, {0: 3.0, 29: 3.0, 30: 4.0, 31: 4.0}),
        ([-20, 30], [3.0, 8.0], {}, {0: 5.0, 10: 6.0, 30: 8.0}),
        # As long as silence may be: 100 s.
        ([-90, 30], [3.0, 8.0], HOLD, {0: 3.0, 10: 3.0, 11: NONE, 30: 8.0}),
        ([-80, 30], [3.0, 8.0], {}, {0: NONE, 29: NONE, 30: 8.0}),  # 110 s apart
        ([-101, 30], [3.0, 8.0], HOLD, {0: NONE, 30: 8.0}),
        ([-10], [3.0], HOLD, {0: 3.0, 90: 3.0, 91: NONE}),  # without a sample in the night, too
        # Blank cells are passed over; of bad or refused ones nothing before them counts either.
        ([-30, -20, -10, 30], [3.0, NONE, NONE, 4.0], HOLD, {0: 3.0}),
        ([-30, -20, 30], [3.0, 5.0, 4.0], {"bad": [5.0], **HOLD}, {0: NONE, 29: NONE, 30: 4.0}),
        ([-30, -20, 30], [3.0, 5000.0, 4.0], HOLD, {0: NONE, 29: NONE, 30: 4.0}),
        # The latest by its time, as two files have them.
        ([-20, -60, -40, 30], [3.0, 1.0, 2.0, 4.0], HOLD, {0: 3.0}),
        ([-20, 30], [3.0, 8.0], {"time_offset_s": 10.0}, {0: 4.0, 40: 8.0}),
        # Of a meter: 3 l in 60 s, then 1 l in 20 s.
        ([-20, 40, 60], [100.0, 103.0, 104.0], METER, {10: 3.0, 50: 3.0}),
    ],
)
def test_a_sample_before_the_night_carries_over(
    seconds: list[int], values: list[float], keys: dict[str, Any], expected: dict[int, float]
) -> None:
    found = cleaned(seconds, values, **keys)
    np.testing.assert_allclose(at(found, *expected), list(expected.values()))
    # It belongs to the night before, which has counted it.
    assert found.n_samples == sum(second >= 0 for second in seconds)
    assert found.counts["backward_time"] == found.counts.get("no_interval", 0) == 0


def together(**channels: CleanChannel) -> Samples:
    with patch("pipeline.night.time_base.grid_period_us", lambda _: SECOND_US):
        samples, _ = bring_together(channels, night_of(), Settings())
    return samples


def test_the_night_begins_with_its_first_sample_unless_all_channels_carry_over() -> None:
    """A value that is held from the start alone makes no hours of an empty log."""
    held = cleaned([-10, 3000], [100.0, 110.0], longest_silence_s=5000.0)
    late = cleaned([2000, 2010, 4000], [20.0, 21.0, 22.0], longest_silence_s=5000.0)
    names = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")
    some = together(**dict.fromkeys(names, held) | {"speed": late})
    assert (some.index[0], some.n_logged) == (2000, 2001)
    all_of_them = together(**dict.fromkeys(names, held))
    assert (all_of_them.index[0], all_of_them.n_logged) == (0, 3001)
    assert all_of_them.time_us[0] == START


@pytest.fixture
def make(tmp_path_factory: pytest.TempPathFactory) -> Callable[[], Workshop]:
    """Motors whose temperature is sent on change."""

    def made() -> Workshop:
        head = "[channels.oil_temperature]\n"
        stated = f'sampling = "on_change"\nlongest_silence_s = {SILENCE_S}\n'
        workshop = Workshop(tmp_path_factory.mktemp("border"))
        workshop.take(motor_toml("M1", "MINI").replace(head, head + stated))
        return workshop

    return made


def write(workshop: Workshop, name: str, rows: slice, log: Log) -> None:
    cells = {column: part[rows] for column, part in log.items()}
    pq.write_table(pa.table(cells), workshop.logs / f"{name}.parquet")


def gaps(workshop: Workshop) -> list[int]:
    """Samples without a temperature for want of one near enough, night by night."""
    found = workshop.rows("quality").filter(channel="oil_temperature", reason="gap")
    return found.sort("night")["n_refused"].to_list()


BORDER = 30 * 60  # seconds of the log before the night's end
KNOTS = np.arange(-70, 3600, 230)  # the border lies 140 s behind one and 90 s before the next


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Array]:
    """An hour around 06:00, the temperature a line from knot to knot, the flow exact for it."""
    configs = write_configs(
        tmp_path_factory.mktemp("motor"), {"M1": motor_toml("M1", "MINI")}, {"MINI": MINI}, QUICK
    )
    (spec,) = load_fleet(configs).motors
    moving = operate(NIGHT, 60.0)
    second = np.arange(3600)
    temperature = np.interp(second, KNOTS, 50.0 + 5.0 * np.sin(KNOTS / 400.0))
    there = Operation(
        moving.time_us + (8 * 3600 - BORDER) * SECOND_US,
        moving.pressure_bar,
        temperature,
        moving.speed_rpm,
    )
    values = there.channels(there.flow(spec.motor(NIGHT, "none")))
    cells = {name: pa.array(value) for name, value in values.items()}
    cells["oil_temperature"] = pa.array(temperature, mask=~np.isin(second, KNOTS))
    return {"time": pa.array(there.time_us, pa.timestamp("us", "UTC")), **cells}


class TestFiles:
    def test_the_value_across_the_border_is_the_one_that_was_there(
        self, make: Make, log: Log
    ) -> None:
        """Without noise the loss factor of the second night is exact, its first minutes too."""
        workshop = make()
        write(workshop, "all", slice(None), log)
        assert dict(workshop.run().counts) == {"ok": 2}
        # Before the first and behind the last temperature of the log, and nothing between.
        assert gaps(workshop)[0] >= 90
        second = workshop.rows("fits").filter(night=NIGHT + DAY).row(0, named=True)
        assert second["window_start"] == dt.datetime(2026, 3, 2, 6, tzinfo=dt.UTC)
        (found,) = workshop.rows("parameters").filter(night=NIGHT + DAY, parameter="K_gap")["value"]
        expected = 8 * np.pi * 35.0e-3 * 8.0e-6**3 / (6 * 4.0e-3)
        assert found == pytest.approx(expected, rel=1e-9)

    def test_a_correction_of_the_night_before_that_reaches_over_the_border_redoes_both(
        self, make: Make, log: Log
    ) -> None:
        """The first file first ends a quarter of an hour before the border, then at it."""
        corrected, at_once = make(), make()
        write(at_once, "a", slice(0, BORDER), log)
        write(corrected, "a", slice(0, BORDER - 900), log)
        for workshop in (corrected, at_once):
            write(workshop, "b", slice(BORDER, None), log)
            workshop.run()
        write(corrected, "a", slice(0, BORDER), log)
        assert corrected.run().nights == (NIGHT, NIGHT + DAY)
        check_same_figures(at_once, corrected, "log_files")
