"""Nights too poor to say anything alone: fitted together, each once, from their blocks."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.optimize import lsq_linear

from leakage import Parametrisation
from pipeline.trends.decisions import Decision
from pipeline.trends.history import History
from pipeline.trends.poor_nights import with_poor_nights
from pipeline.trends.trend_rows import trend_rows
from tests.pipeline.trends.blocks import (
    PERIOD_S,
    POOR,
    SAMPLES,
    TRAINING,
    blocks_of,
    samples_of,
)
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
)

N = 12


def poor(*places: int, n: int = N, **more: Any) -> Nights:
    """Nights of which some have 24 minutes of training samples."""
    spec = more.pop("spec", motor())
    return Nights(spec, n, changes=dict.fromkeys(places, POOR), **more)


def merged(nights: Nights, *said: Decision, until: int | None = None) -> History:
    blocks = blocks_of(nights)
    read: list[dt.date] = []

    def read_blocks(labels: Sequence[dt.date]) -> pl.DataFrame:
        read.extend(labels)
        return blocks.filter(pl.col("night").is_in(list(labels)))

    found = with_poor_nights(history(nights, until=until), said, read_blocks)
    assert len(read) == len(set(read)), "blocks of a night are read once"
    return found


def groups(found: History) -> dict[int, int]:
    """Nights behind each figure that is made of several, by place."""
    several = np.flatnonzero(found.records["n_nights"] > 1)
    return {int(place): int(found.records["n_nights"][place]) for place in several}


def test_a_groups_fit_is_that_of_all_its_samples() -> None:
    """Bounded least squares over the samples themselves, by another library."""
    nights = poor(3, 4, 5)
    found = merged(nights)
    assert groups(found) == {5: 3}
    truth = nights.truth()
    samples = np.concatenate([samples_of(nights, place, truth[place]) for place in (3, 4, 5)])
    made = nights.spec.motor(found.nights[5], "none")
    lower, upper = Parametrisation.of(made).coefficient_bounds()
    scale = truth[5, :3]
    expected = lsq_linear(
        samples[:, :3] * scale,
        samples[:, -1] - samples[:, -2],
        (lower[:3] / scale, upper[:3] / scale),
        tol=1e-14,
    )
    np.testing.assert_allclose(found.records["theta"][5, :3], scale * expected.x, rtol=1e-7)
    # An hour and more of samples: every figure is there, and its interval holds the truth.
    for number in range(len(PATHS)):
        value, low, high = found.records["figures"][5, number]
        assert low < truth[5, number] < high
        assert value == found.records["theta"][5, number]
    assert found.records["minutes"][5] == pytest.approx(3 * TRAINING * SAMPLES * PERIOD_S / 60)
    leakage, low, high = found.records["reference"][5]
    # Twice the half-width of a 95 % interval is missed once in ten thousand times.
    assert abs(leakage - 1.371423) < high - low < 0.04 * leakage
    assert found.words[5].reference == ""


def test_the_other_nights_of_a_group_say_nothing_and_why() -> None:
    found = merged(poor(3, 4, 5))
    assert not found.fitted[[3, 4]].any()
    assert found.fitted[[2, 5, 6]].all()
    assert found.statuses[4] == "24.0 minutes of training samples; an interval needs 30"
    assert np.isnan(found.records["reference"][3:5]).all()


def test_the_rows_say_how_many_nights() -> None:
    nights = poor(*range(30, 60), n=60)
    blocks = blocks_of(nights)

    def change(one: History, said: tuple[Decision, ...]) -> History:
        return with_poor_nights(
            one, said, lambda labels: blocks.filter(pl.col("night").is_in(list(labels)))
        )

    found = standings({"M1": history(nights)}, change=change)["M1"]
    rows = {row["indicator"]: row for row in trend_rows(found, [32])}
    for name in ("reference_leakage", "K_piston_ring", "own_reference_leakage"):
        assert rows[name]["n_nights"] == 3
        assert rows[name]["value"] is not None
        assert rows[name]["state"] == "ok"
    # Every third night has a figure: none is stale, as a week would make it.
    assert set(found.states["K_balance_sleeve"][30:]) == {"ok"}
    waiting = {row["indicator"]: row for row in trend_rows(found, [33])}
    assert waiting["reference_leakage"]["n_nights"] == 1
    assert waiting["reference_leakage"]["value"] is None
    assert "an interval needs 30" in waiting["reference_leakage"]["gated_reason"]


def test_nights_whose_blocks_were_pruned_are_left_out() -> None:
    """It was an internal error, and the motor had no trends any more."""
    nights = poor(3, 4, 5, 7, 8, 9)
    blocks = blocks_of(nights).filter(pl.col("night") > night_of(4))
    found = with_poor_nights(
        history(nights), (), lambda labels: blocks.filter(pl.col("night").is_in(list(labels)))
    )
    assert groups(found) == {9: 3}
    assert found.words[5].status == (
        "24.0 minutes of training samples; an interval needs 30; 3 nights together: statistics of "
        "their blocks are not there any more"
    )


def test_each_night_is_used_once() -> None:
    assert groups(merged(poor(*range(10)))) == {2: 3, 5: 3, 8: 3}


def test_a_fitted_night_ends_a_row() -> None:
    assert groups(merged(poor(3, 4, 6, 7, 8, 9))) == {8: 3}
    assert groups(merged(poor(3, 5, 7, 9))) == {}


@pytest.mark.parametrize("kind", ["overhaul", "flushing_change", "motor_exchanged"])
def test_never_across_an_event(kind: str) -> None:
    spec = named(motor(), "M1", events=[event(4, kind)])
    assert groups(merged(poor(2, 3, 4, 5, 6, spec=spec))) == {6: 3}
    assert groups(merged(poor(2, 3, 4, 5, spec=spec))) == {}


def test_never_across_an_oil_change() -> None:
    spec = named(motor(), "M1", events=[event(4, "oil_change", oil="vg46")])
    assert groups(merged(poor(2, 3, 4, 5, spec=spec))) == {}
    # The same oil, filled in anew: its statistics are alike, and the event stands all the same.
    spec = named(motor(), "M1", events=[event(4, "oil_change", oil="vg68")])
    assert groups(merged(poor(2, 3, 4, 5, spec=spec))) == {}


def test_never_across_a_reset_of_all_indicators() -> None:
    nights = poor(2, 3, 4, 5)
    assert groups(merged(nights)) == {4: 3}
    assert groups(merged(nights, reset(4))) == {}
    # One indicator's baseline is no reason to keep the nights apart.
    assert groups(merged(nights, reset(4, "K_piston_ring"))) == {4: 3}


def test_never_across_other_settings() -> None:
    nights = poor(2, 3, 4)
    blocks = blocks_of(nights).with_columns(
        model_hash=pl.when(pl.col("night") >= history(nights).nights[4])
        .then(pl.lit("another"))
        .otherwise("model_hash")
    )
    changed = {**nights.changes, 4: {**POOR, "model_hash": "another"}}
    other = Nights(motor(), N, changes=changed)
    found = with_poor_nights(
        history(other), (), lambda labels: blocks.filter(pl.col("night").is_in(list(labels)))
    )
    assert groups(found) == {}


def test_never_across_a_long_silence() -> None:
    silent = frozenset(range(5, 14))
    assert groups(merged(poor(3, 4, 14, 15, n=20, absent=silent))) == {}
    short = frozenset(range(5, 10))
    assert groups(merged(poor(3, 4, 10, 11, n=20, absent=short))) == {10: 3}


def test_nights_without_any_fit_take_part_with_their_blocks() -> None:
    """Fewer samples than a fit needs: the night's row has no figures, its blocks are there."""
    nothing: Mapping[str, Any] = {
        "status": "insufficient_data",
        "reason": "too few samples",
        **dict.fromkeys(
            (
                "n_training",
                "sample_period_s",
                "correlation_time_s",
                "coefficients",
                "coefficient_covariance",
                "night_factor",
                "model_hash",
                "interval_status",
                "reference_verdict",
            )
        ),
    }
    nights = Nights(motor(), N, changes={3: POOR, 4: nothing, 5: POOR})
    found = merged(nights)
    assert groups(found) == {5: 3}
    assert found.records["minutes"][5] == pytest.approx(72.0)
    np.testing.assert_allclose(
        found.records["theta"][5], merged(poor(3, 4, 5)).records["theta"][5], rtol=1e-12
    )


def test_merging_can_be_turned_off() -> None:
    nights = poor(3, 4, 5, spec=motor(fleet="[trend]\nmerge_nights = 1\n"))
    found = merged(nights)
    assert groups(found) == {}
    assert not found.fitted[[3, 4, 5]].any()


@pytest.mark.parametrize("until", [4, 5, 8])
def test_a_group_hangs_on_no_later_night(until: int) -> None:
    nights = poor(*range(10))
    all_nights, then = merged(nights), merged(nights, until=until)
    for name in ("theta", "figures", "reference", "n_nights", "factor", "fitted"):
        np.testing.assert_array_equal(
            then.records[name], all_nights.records[name][: until + 1], err_msg=name
        )
    assert [then.words[place].reference for place in range(until + 1)] == [
        all_nights.words[place].reference for place in range(until + 1)
    ]
