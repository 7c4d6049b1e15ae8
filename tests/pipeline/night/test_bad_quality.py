"""Samples that the log itself does not call good: refused, counted, and the end of what is held."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.config import Channel, Cleaning
from pipeline.config.logs import Logs
from pipeline.night.channel_rules import ChannelRules
from pipeline.night.cleaning import CleanChannel, clean_channel
from pipeline.night.resampling import on_grid
from tests.pipeline.night.channels import SECOND, Times, as_read, refused_by
from tests.pipeline.simulated import Array

Mask = NDArray[np.bool_]
ON_CHANGE: dict[str, Any] = {"sampling": "on_change", "longest_silence_s": 300.0}
LONG = Logs(format="csv", files=("*.csv",), layout="long")


def cleaned(
    time_us: Times, value: Array, bad: Any, logs: Logs | None = None, **keys: Any
) -> CleanChannel:
    name = "leakage_flow" if "counts" in keys else "pressure_difference"
    channel = Channel(source="x", unit="count" if "counts" in keys else "bar", **keys)
    rules = ChannelRules.of(name, channel, Cleaning(), logs)
    mask = np.zeros(len(value), np.bool_)
    mask[bad] = True
    return clean_channel(as_read(time_us, value, mask), rules)


def seconds(n: int) -> Times:
    return np.arange(n, dtype=np.int64) * SECOND


def lively(n: int) -> Array:
    return 100.0 + 20.0 * np.sin(np.arange(n) / 3.0)


class TestPeriodic:
    def test_a_bad_sample_is_refused_under_its_own_reason(self) -> None:
        found = cleaned(seconds(100), lively(100), [10, 11, 50])
        assert refused_by(found) == {"bad_quality": 3, "any": 3}
        assert np.flatnonzero(found.refused).tolist() == [10, 11, 50]
        assert found.n_samples == 100

    def test_bad_samples_judge_no_others(self) -> None:
        """Zeros of a broken sensor, flagged as such, make no spikes of what lies between them."""
        value = lively(200)
        bad = np.flatnonzero(np.arange(200) % 3 > 0)
        value[bad] = 0.0
        found = cleaned(seconds(200), value, bad)
        assert refused_by(found) == {"bad_quality": len(bad), "any": len(bad)}

    def test_a_blank_cell_between_the_samples_of_a_slow_channel_is_none_however_bad(self) -> None:
        """One column of qualities for all channels of a wide log: the row is of another one."""
        value = np.full(100, np.nan)
        value[::10] = lively(10)
        found = cleaned(seconds(100), value, [3, 14, 15, 20])
        assert found.n_samples == 10
        assert refused_by(found) == {"bad_quality": 1, "any": 1}

    def test_a_counter_of_which_a_reading_is_bad_leaves_no_interval(self) -> None:
        total = np.arange(60.0) * 3.0
        total[30] = 7.0
        stated: dict[str, Any] = {"counts": "cumulative", "volume_per_count_cm3": 1.0}
        found = cleaned(seconds(60), total, [30], **stated)
        assert refused_by(found) == {"bad_quality": 1, "no_interval": 2, "any": 3}
        np.testing.assert_allclose(found.value[~found.refused], 0.18)
        pulses = np.full(60, 3.0)
        pulses[30] = 500.0
        stated["counts"] = "pulses"
        found = cleaned(seconds(60), pulses, [30], **stated)
        assert refused_by(found) == {"bad_quality": 1, "no_interval": 1, "any": 2}


class TestOnChange:
    """Silence after a bad sample is a gap; before it the value holds as ever."""

    TIME = np.array([0, 100, 200, 260, 500], dtype=np.int64) * SECOND
    VALUE = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    LOST = np.array([10.0, 20.0, np.nan, 40.0, 50.0])

    @pytest.mark.parametrize(
        ("value", "bad", "logs", "times", "refused", "ends"),
        [
            (VALUE, [2], None, TIME, {"bad_quality": 1, "any": 1}, [2]),
            # As a historian marks that its source was lost.
            (LOST, [2], None, TIME, {"missing": 1, "bad_quality": 1, "any": 1}, [2]),
            # A blank of a wide log says nothing, and a row of its own that there is none.
            (LOST, [], None, np.delete(TIME, 2), {}, []),
            (LOST, [], LONG, TIME, {"missing": 1, "any": 1}, [2]),
        ],
    )
    def test_what_ends_a_value(
        self,
        value: Array,
        bad: list[int],
        logs: Logs | None,
        times: Times,
        refused: dict[str, int],
        ends: list[int],
    ) -> None:
        found = cleaned(self.TIME, value, bad, logs, between="hold", **ON_CHANGE)
        np.testing.assert_array_equal(found.time_us, times)
        assert (found.n_samples, refused_by(found)) == (len(times), refused)
        assert found.ends is not None
        assert np.flatnonzero(found.ends).tolist() == ends
        assert np.flatnonzero(found.refused).tolist() == ends

    def test_held(self) -> None:
        found = cleaned(self.TIME, self.VALUE, [2], between="hold", **ON_CHANGE)
        grid = np.arange(0, 900, dtype=np.int64) * SECOND
        value, present, silent = on_grid(found, grid, SECOND)
        # At its own time a bad sample is refused; from there on there is none.
        assert np.flatnonzero(~present).tolist() == [*range(200, 260), *range(801, 900)]
        assert np.flatnonzero(silent).tolist() == [*range(201, 260), *range(801, 900)]
        assert value[[0, 99, 100, 260, 499, 800]].tolist() == [10, 10, 20, 40, 40, 50]
