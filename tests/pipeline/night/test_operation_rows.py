"""Rows of `operation`: hours, histograms, readings of the sensors at halts."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.ingest import RawChannel
from pipeline.night.halts import Halts, Zero
from pipeline.night.operation_rows import coarse_histogram, hours_counted, operation_row
from pipeline.night.time_base import Samples
from pipeline.schema import OPERATION, PRESSURE_EDGES_BAR, frame
from tests.pipeline.simulated import SECOND_US, night_of
from tests.pipeline.trends.nights import motor

N = 400


def samples(n: int = N, **more: object) -> Samples:
    generator = np.random.default_rng(1)
    index = np.arange(n, dtype=np.int64)
    return Samples(
        index,
        index * SECOND_US,
        -generator.uniform(10.0, 300.0, n),
        generator.uniform(40.0, 60.0, n),
        np.where(index % 4 == 0, -20.0, 20.0),
        generator.uniform(1.0, 2.0, n),
        {},
        SECOND_US,
        N,
        N,
        **more,  # type: ignore[arg-type]
    )


def counter(*hours: float) -> RawChannel:
    n = len(hours)
    return RawChannel(np.arange(n, dtype=np.int64), np.array(hours), np.zeros(n, dtype=np.bool_), 0)


def test_running_hours_are_the_share_of_the_logged_time_over_the_night() -> None:
    """A quarter of what is logged, of 24 hours, however little is logged."""
    row = operation_row(motor(), night_of(), samples(n_logged=800, n_turning=200), None)
    assert row["running_hours"] == pytest.approx(6.0)
    assert row["running_hours_source"] == "share"
    assert row["logged_hours"] == pytest.approx(800 / 3600)
    assert row["kept_hours"] == pytest.approx(N / 3600)
    assert row["running_share"] == 0.25


def test_a_counter_in_the_log_wins() -> None:
    seen = samples(n_logged=800, n_turning=200)
    row = operation_row(motor(), night_of(), seen, counter(812.0, 815.5, 820.25))
    assert (row["running_hours"], row["running_hours_source"]) == (8.25, "counter")


@pytest.mark.parametrize("hours", [(812.0,), (812.0, 3.0, 5.0), (np.nan, np.nan), ()])
def test_a_counter_that_cannot_tell_does_not(hours: tuple[float, ...]) -> None:
    assert hours_counted(counter(*hours)) is None
    seen = samples(n_logged=800, n_turning=200)
    row = operation_row(motor(), night_of(), seen, counter(*hours))
    assert row["running_hours_source"] == "share"


def test_a_counter_is_read_in_order_of_time_and_without_its_gaps() -> None:
    mixed = RawChannel(
        np.array([2, 0, 1, 3]), np.array([820.0, 812.0, np.nan, 821.0]), np.zeros(4, bool), 0
    )
    assert hours_counted(mixed) == 9.0


def test_a_night_without_a_sample_has_what_is_known_and_no_more() -> None:
    row = operation_row(motor(), night_of(), samples(0), None)
    assert row["kept_hours"] == 0.0
    assert row["running_share"] is None
    assert "running_hours" not in row
    assert "pressure_histogram" not in row


def test_conditions_are_magnitudes_and_histograms_hold_every_sample() -> None:
    seen = samples()
    row = operation_row(motor(), night_of(), seen, None)
    assert row["mean_pressure_bar"] == pytest.approx(np.abs(seen.pressure_difference_bar).mean())
    assert row["mean_speed_rpm"] == 20.0
    assert row["share_reversed"] == 0.25
    for name, bins in (("pressure", 20), ("temperature", 28), ("speed", 15)):
        histogram = row[f"{name}_histogram"]
        assert (len(histogram), sum(histogram)) == (bins, N)
    expected, _ = np.histogram(np.abs(seen.pressure_difference_bar), PRESSURE_EDGES_BAR)
    assert row["pressure_histogram"] == expected.tolist()


def test_the_end_bins_hold_all_beyond() -> None:
    assert coarse_histogram(np.array([-5.0, 0.0, 399.9, 400.0, 900.0]), PRESSURE_EDGES_BAR) == [
        2,
        *[0] * 18,
        3,
    ]


def test_zeros_of_the_sensors_are_columns_of_the_table() -> None:
    halts = Halts(4, Zero(0.5, 0.1), Zero(0.02, None))
    row = operation_row(motor(), night_of(), samples(halts=halts), None)
    assert row["n_halts"] == 4
    assert (row["pressure_zero_bar"], row["pressure_zero_standard_error_bar"]) == (0.5, 0.1)
    assert row["flow_zero_l_per_min"] == 0.02
    assert row["flow_zero_standard_error_l_per_min"] is None
    assert set(row) <= set(OPERATION.schema)
    assert frame(OPERATION, [{"run_id": "r", **row}]).height == 1
