"""Rows of `operation`: hours, histograms, readings of the sensors at halts."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.ingest import RawChannel
from pipeline.night.sample_rows import hours_counted, operation_row
from pipeline.night.time_base import Samples
from pipeline.schema import PRESSURE_EDGES_BAR
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
