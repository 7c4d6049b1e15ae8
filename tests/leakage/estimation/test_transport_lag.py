"""Lag of a flow behind its drivers, of series whose lag is known."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.estimation.transport_lag import transport_lag

SECONDS = np.arange(4000.0)
LEVELS = np.random.default_rng(7).uniform(20.0, 280.0, (300, 2))


def drivers(at_s: np.ndarray) -> np.ndarray:
    """Two loads that change every 15 s."""
    ends = 15.0 * np.arange(len(LEVELS))
    return np.column_stack([np.interp(at_s, ends, level) for level in LEVELS.T])


def flow(at_s: np.ndarray) -> np.ndarray:
    """A flow that the drivers do not explain whole."""
    return np.sqrt(drivers(at_s)) @ (1.0, 0.3) + np.random.default_rng(3).normal(size=len(at_s))


@pytest.mark.parametrize("lag_s", [-4.3, 0.0, 3.5, 8.0, 20.6])
@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_a_lag_is_found_whatever_the_rate_and_the_gaps(lag_s: float, period_s: float) -> None:
    index = np.arange(int(4000 / period_s))
    index = index[(index * period_s) % 500 > 60]
    time_s = index * period_s
    found = transport_lag(flow(time_s - lag_s), [*drivers(time_s).T], index, period_s)
    assert found is not None
    assert found.seconds == pytest.approx(lag_s, abs=0.15)
    assert (found.gain > 0.05) == (lag_s != 0.0)


def test_what_was_paired_before_is_part_of_it() -> None:
    found = transport_lag(
        flow(SECONDS - 8.0), [*drivers(SECONDS - 5.5).T], SECONDS.astype(int), 1.0, 5.5
    )
    assert found is not None
    assert found.seconds == pytest.approx(8.0, abs=0.15)
    assert found.gain > 0.2


@pytest.mark.parametrize(
    ("y", "u", "period_s"),
    [
        (np.ones(4000), drivers(SECONDS), 1.0),
        (flow(SECONDS), np.ones((4000, 2)), 1.0),
        (flow(SECONDS), drivers(SECONDS), 30.0),
        (flow(SECONDS - 60.0), drivers(SECONDS), 1.0),
    ],
    ids=["flow at rest", "drivers at rest", "samples far apart", "lag out of reach"],
)
def test_none_where_nothing_can_be_estimated(y: np.ndarray, u: np.ndarray, period_s: float) -> None:
    found = transport_lag(y, [*u.T], SECONDS.astype(int), period_s)
    assert found is None or found.gain < 0.05
