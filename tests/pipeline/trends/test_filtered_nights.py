"""Nights too poor alone: each has figures by itself and the nights before it, with intervals."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.trends.baselines.eras import eras_of
from pipeline.trends.baselines.leakages import indicators_of
from pipeline.trends.figures.filtered_nights import Filtered, with_filter
from pipeline.trends.figures.indicators import Indicator, coefficients, with_filtered
from pipeline.trends.figures.temperature import Effect
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import History
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import Standing
from tests.pipeline.trends.blocks import POOR, blocks_of, samples_of, with_blocks
from tests.pipeline.trends.nights import (
    PATHS,
    Nights,
    event,
    history,
    motor,
    named,
    night_of,
    reset,
    standings,
    step,
)

N = 12
# A night of which a fit says nothing at all.
NOTHING: Mapping[str, Any] = {
    "status": "insufficient_data",
    "reason": "too few samples",
    **dict.fromkeys(
        (
            "n_training",
            "coefficients",
            "coefficient_covariance_root",
            "night_factor",
            "model_hash",
            "interval_status",
            "reference_verdict",
            "own_pressure_bar",
            "own_temperature_c",
            "own_speed_rpm",
        )
    ),
}


def poor(*places: int, n: int = N, kind: Mapping[str, Any] = POOR, **more: Any) -> Nights:
    """Nights of which some have 30 minutes of samples."""
    return Nights(more.pop("spec", motor()), n, changes=dict.fromkeys(places, kind), **more)


def read(nights: Nights, until: int | None = None, blocks: pl.DataFrame | None = None) -> History:
    """The nights as trends read them."""
    return with_blocks(
        history(nights, until=until), blocks_of(nights) if blocks is None else blocks
    )


def followed(nights: Nights, *said: Decision, until: int | None = None) -> History:
    return with_filter(replace(read(nights, until), decisions=said), dt.date.min)


def stood(nights: Nights) -> Standing:
    change = partial(with_filter, until=dt.date.min)
    return standings({"M1": read(nights)}, change=change)["M1"]


def indicators(found: History) -> dict[str, Indicator]:
    return indicators_of(found, eras_of(found))


@pytest.mark.parametrize("kind", [POOR, NOTHING])
def test_every_night_has_figures_with_intervals_that_hold_the_truth(
    kind: Mapping[str, Any],
) -> None:
    nights = poor(*range(N), kind=kind)
    found = indicators(followed(nights))
    for number, path in enumerate(PATHS):
        one = found[f"K_{path}"]
        truth = nights.truth()[:, number]
        assert np.isfinite(one.watched[1:]).all()
        assert ((one.lower < truth) & (truth < one.upper))[1:].all()
        assert one.n_nights.tolist() == list(range(1, N + 1))
    leakage = found["reference_leakage"]
    assert (leakage.lower[1:] < 1.371423).all()
    assert (leakage.upper[1:] > 1.371423).all()


def test_what_a_night_says_alone_stays() -> None:
    """The filter fills in where a night is poor, and nowhere else."""
    nights = poor(3, 4)
    alone, found = indicators(history(nights)), indicators(followed(nights))
    for name in ("K_piston_ring", "reference_leakage"):
        good = np.setdiff1d(np.arange(N), (3, 4))
        assert np.array_equal(found[name].value[good], alone[name].value[good])
        assert np.isnan(alone[name].value[[3, 4]]).all()
        assert np.isfinite(found[name].value[[3, 4]]).all()
        assert found[name].n_nights[[2, 3, 4, 5]].tolist() == [1, 4, 5, 1]


def test_a_night_without_samples_has_no_figure() -> None:
    found = indicators(followed(poor(*range(N), absent=frozenset({5}))))
    assert np.isnan(found["K_piston_ring"].value[5])
    assert "no log" in found["K_piston_ring"].gated[5]
    assert found["K_piston_ring"].n_nights[6] == 6


@pytest.mark.parametrize("kind", ["overhaul", "flushing_change", "motor_exchanged"])
def test_an_event_begins_it_anew(kind: str) -> None:
    spec = named(motor(), "M1", events=[event(6, kind)])
    found = followed(poor(*range(N), spec=spec))
    assert found.records["followed"].tolist() == [1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5, 6]


def test_a_reset_of_all_indicators_begins_it_anew() -> None:
    nights = poor(*range(N))
    assert followed(nights, reset(6)).records["followed"][6] == 1
    # One indicator's baseline is no reason to forget the nights before.
    assert followed(nights, reset(6, "K_piston_ring")).records["followed"][6] == 7


@pytest.mark.parametrize("begin", [1, 6, 11])
def test_a_run_that_goes_on_says_what_one_from_the_start_says(begin: int) -> None:
    """To the bit, so that what is kept of nights changes nothing."""
    nights = poor(*range(N), absent=frozenset({4, 5}))
    whole = followed(nights)
    first = with_filter(read(nights, until=begin - 1), dt.date.min)
    records = read(nights).records
    places = np.searchsorted(records["night"], first.records["night"])
    records[places] = first.records
    gone_on = with_filter(replace(whole, records=records), night_of(begin))
    assert gone_on.records.tobytes() == whole.records.tobytes()


def test_a_night_hangs_on_no_later_one() -> None:
    nights = poor(*range(N))
    whole, then = followed(nights), followed(nights, until=7)
    assert then.records.tobytes() == whole.records[:8].tobytes()


def test_nights_whose_blocks_were_pruned_say_nothing() -> None:
    nights = poor(*range(N), kind=NOTHING)
    blocks = blocks_of(nights).filter(pl.col("night") > night_of(4))
    found = with_filter(read(nights, blocks=blocks), dt.date.min)
    assert found.records["followed"].tolist() == [0] * 5 + [1, 2, 3, 4, 5, 6, 7]
    assert "too few samples" in indicators(found)["K_piston_ring"].gated[2]


def test_a_step_is_told_with_its_path_on_nights_of_half_an_hour() -> None:
    """Sleeves + 40 % from night 40 on, every night too poor to say anything alone."""
    n, at = 46, 40
    nights = poor(*range(n), n=n, wear={"balance_sleeve": step(n, at, 0.4)})
    found = stood(nights)
    assert set(found.states["K_balance_sleeve"][15:at]) == {"ok"}
    assert found.states["K_balance_sleeve"][at + 3] in ("warning", "alarm")
    rows = {row["indicator"]: row for row in trend_rows(found, [at + 5])}
    assert rows["K_balance_sleeve"]["path"] == "balance_sleeve"
    assert rows["K_balance_sleeve"]["n_nights"] == at + 6
    assert (
        rows["gap_change_balance_sleeve"]["lower"]
        < 11.9
        < rows["gap_change_balance_sleeve"]["upper"]
    )


def test_a_figure_that_is_too_wide_to_count_is_shown_with_its_interval_and_why() -> None:
    found = history(poor(0, 1, n=2))
    alone = next(coefficients(found, Effect(np.ones(2), np.zeros(2), np.zeros(2))))
    assert alone.gated == (POOR["interval_status"],) * 2
    said = Filtered(np.ones(2), np.array([0.4, 0.6]), np.array([3, 4], dtype=np.int32))
    both = with_filtered(alone, said, 0.5, np.ones(2))
    assert both.gated == ("", "known to ± 60 % by 4 nights; 50 % are needed")
    assert both.upper.tolist() == [1.4, 1.6]
    assert np.array_equal(both.watched, [1.0, np.nan], equal_nan=True)


def test_from_the_first_night_on_there_are_drain_flow_and_progress() -> None:
    nights = poor(*range(N))
    found = stood(nights)
    rows = {(row["indicator"], row["night"]): row for row in trend_rows(found, range(N))}
    z = samples_of(nights, 0, nights.truth()[0])
    assert rows["drain_flow", night_of(0)]["value"] == pytest.approx(z[:, -1].mean(), rel=1e-9)
    # At comparable conditions the healthy motor leaks what its configured gaps leak.
    for place in range(N):
        comparable = rows["comparable_drain_flow", night_of(place)]["value"]
        assert comparable == pytest.approx(1.371423, rel=0.02)
    progress = rows["baseline_progress", night_of(11)]
    assert progress["value"] == pytest.approx(80.0)
    assert progress["state_reason"] == "12 of 15 good nights for a baseline (first nights)"
