"""Nights of another duty: what is compared, what is told, and what is said of the rest."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest

from leakage.course.balanced_baseline import DutyBlocks
from leakage.estimation.model_verdict import StructuredMisfit
from pipeline.config import MotorSpec
from pipeline.night.rows import upper_triangle
from pipeline.schema import BLOCK_STATISTICS
from pipeline.store.encoding import write_table
from pipeline.store.tables import night_file
from pipeline.trends.baselines import blocks as baseline_blocks
from pipeline.trends.baselines.blocks import BlockFiles
from pipeline.trends.baselines.duty import with_duty
from pipeline.trends.figures.indicators import DEVIATION, REFERENCE
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import BALANCED, OUTSIDE, Layout
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import Standing
from pipeline.trends.why.reasons import path_behind, path_named, why_not_named, why_state
from tests.pipeline.trends.blocks import blocks_of
from tests.pipeline.trends.nights import OIL, Nights, histories, motor, night_of, standings, step

N, AT = 60, 40
SLEEVE = "K_balance_sleeve"
PLACE = 2
# A night at twice the load that the histograms of the others reach.
HIGH = np.array([0] * 16 + [10] * 4)

Change = Callable[[History], History]


def outside(found: History) -> History:
    records = found.records.copy()
    records["duty"][AT:] = OUTSIDE
    records["pressure_histogram"][AT:] = HIGH
    return replace(found, records=records)


def balanced(rise: float, error: float, flow: float, share: float = 0.8) -> Change:
    """Nights whose sleeves have grown so much against the baseline at their duty."""

    def change(found: History) -> History:
        records = found.records.copy()
        records["duty"][AT:] = BALANCED
        then = np.array(found.layout.configured)
        now = then * [1.0, 1.0, 1.0 + rise, 1.0]
        records["duty_then"][AT:], records["duty_now"][AT:] = then, now
        records["duty_root"][AT:] = upper_triangle(np.diag(error * then))
        records["duty_flow"][AT:], records["duty_share"][AT:] = np.log1p(flow), share
        return replace(found, records=records)

    return change


def told(change: Change, wear: float = 0.4, limits: str = "") -> Standing:
    """A motor whose sleeves seem to grow from a night on."""
    nights = Nights(motor(limits=limits), N, {"balance_sleeve": step(N, AT, wear)})
    return standings(histories(nights), change=change)["M1"]


def test_a_loss_factor_that_is_the_dutys_is_no_rise() -> None:
    plain, found = told(lambda one: one), told(balanced(0.0, 0.02, 0.0))
    for name in (SLEEVE, DEVIATION, REFERENCE):
        assert plain.states[name][N - 1] in ("warning", "alarm")
        assert found.states[name][N - 1] == "ok"


def test_a_rise_at_another_duty_is_told_with_its_size() -> None:
    found = told(balanced(0.5, 0.02, 0.15), 0.0)
    assert found.states[SLEEVE][N - 1] == "alarm"
    assert found.states[DEVIATION][N - 1] == "warning"
    assert found.rise(SLEEVE, N - 1).relative == pytest.approx(0.5, abs=0.02)  # type: ignore[union-attr]


def test_a_rise_that_is_not_certain_holds_the_state_and_says_why() -> None:
    found = told(balanced(0.4, 0.15, 0.1))
    assert set(found.states[SLEEVE][AT : AT + 7]) == {"ok"}
    assert found.states[SLEEVE][N - 1] == "stale"
    row = next(one for one in trend_rows(found, [AT + 5]) if one["indicator"] == SLEEVE)
    assert (
        row["gated_reason"] == "at this duty the baseline does not tell a rise from its own error"
    )
    assert row["value"] is not None


def test_duty_outside_the_baseline_is_a_state_that_says_what_is_missing() -> None:
    found = told(outside)
    assert set(found.states[SLEEVE][AT:]) == {"duty_outside"}
    words = "duty outside the baseline: no baseline at loads above 300 bar"
    assert why_state(found, SLEEVE, AT, None) == words
    lasting = why_state(found, SLEEVE, AT + 6, None)
    assert lasting.startswith(f"{words}; so for 7 nights: if this duty is to stay, begin a new")
    assert f"from {night_of(AT)} (`motor-leakage baseline reset`)" in lasting


def test_the_drain_flow_acts_at_every_duty_and_no_path_is_named() -> None:
    found = told(outside)
    assert found.states[DEVIATION][N - 1] in ("warning", "alarm")
    behind = path_behind(found, DEVIATION, N - 1)
    assert behind is not None
    assert behind.named == ("balance_sleeve",)
    assert path_named(found, DEVIATION, N - 1, behind) is None
    assert "duty outside the baseline" in why_state(found, DEVIATION, N - 1, behind)


def test_an_absolute_limit_acts_at_every_duty() -> None:
    found = told(outside, limits="[limits]\nwarning_l_per_min = 1.2\nalarm_l_per_min = 1.3\n")
    assert found.states[REFERENCE][N - 1] == "alarm"


def test_duty_wins_over_a_common_change_and_that_over_the_model() -> None:
    nights = Nights(motor(), N, {OIL: step(N, AT, 0.25)})
    (thin,) = standings(histories(nights), change=outside).values()
    behind = path_behind(thin, DEVIATION, N - 1)
    assert behind is not None
    assert behind.verdict == "common"
    assert why_not_named(thin, N - 1, behind).startswith("duty outside")
    (thin,) = standings(histories(nights)).values()
    changed = replace(thin, model=replace(thin.model, state=("warning",) * N))
    assert why_not_named(changed, N - 1, behind) == ""


def test_no_path_is_named_where_the_model_has_changed() -> None:
    found = told(lambda one: one)
    behind = path_behind(found, SLEEVE, N - 1)
    assert path_named(found, SLEEVE, N - 1, behind) == "balance_sleeve"
    changed = replace(found, model=replace(found.model, state=("warning",) * N))
    assert path_named(changed, SLEEVE, N - 1, behind) is None
    assert changed.states[SLEEVE][N - 1] == found.states[SLEEVE][N - 1]


def test_wear_with_thinner_oil_is_named_although_the_rollers_misfit_has_grown() -> None:
    """The model as stated holds the rollers, so a common factor alone makes it misfit by speed."""
    nights = Nights(motor(), N, {OIL: step(N, AT, 0.25), "balance_sleeve": step(N, AT, 0.4)})
    (found,) = standings(histories(nights)).values()
    behind = path_behind(found, SLEEVE, N - 1)
    assert behind is not None
    assert behind.is_common
    for kinds, name in ((("speed",), "balance_sleeve"), (("load", "speed"), None)):
        misfit = StructuredMisfit(0.04, 0.03, 0.001, kinds, 10)
        model = Mock(state=("warning",) * N, at=lambda _, one=misfit: one, words=lambda _: "misfit")
        assert path_named(replace(found, model=model), SLEEVE, N - 1, behind) == name


@dataclass
class Files:
    """Blocks at some loads in place of stored ones; it notes the nights that are asked for."""

    low: float
    asked: list[dt.date] = field(default_factory=list)

    def of(self, _: MotorSpec, layout: Layout, nights: Sequence[dt.date], model: str) -> DutyBlocks:
        assert model == "hash-vg68"
        if len(nights) == 1:
            self.asked += nights
        generator = np.random.default_rng(len(nights))
        n = 40 * len(nights)
        low, high = (10.0, 300.0) if len(nights) > 1 else (self.low, self.low + 80.0)
        load = generator.uniform(low, high, n)
        factors = np.zeros((n, 6, 6))
        factors[:, range(3), range(3)] = load[:, None] * generator.uniform(0.5, 1.0, (n, 3))
        factors[:, 3, 3:5] = 1.0, 0.1
        factors[:, 4, 4] = 0.1
        factors[:, :5, 5] = factors[:, :5, :5] @ np.append(np.array(layout.configured), 1.0)
        channels = (np.full(n, 50.0) + generator.uniform(-1, 1, n), load, np.full(n, 40.0))
        return DutyBlocks(factors, np.column_stack(channels), np.repeat(np.arange(len(nights)), 40))

    of_baseline = of


def history_at(pressure_bar: float, first: int, last: int) -> History:
    changes = {place: {"own_pressure_bar": pressure_bar} for place in range(first, last)}
    return histories(Nights(motor(), N, changes=changes))["M1"]


def test_only_nights_of_another_duty_are_compared_and_each_once() -> None:
    files = Files(low=310.0)
    history = history_at(200.0, AT, AT + 3)
    done = with_duty(history, dt.date.min, files)  # type: ignore[arg-type]
    assert files.asked == [night_of(place) for place in range(AT, AT + 3)]
    assert np.flatnonzero(done.records["duty"]).tolist() == [AT, AT + 1, AT + 2]
    again = with_duty(done, night_of(AT + 2), files)  # type: ignore[arg-type]
    assert files.asked[3:] == [night_of(AT + 2)]
    assert (again.records["duty"] == done.records["duty"]).all()
    assert not history.records["duty"].any()


def test_a_slightly_other_mean_is_the_same_duty() -> None:
    files = Files(low=310.0)
    with_duty(history_at(150.0, AT, N), dt.date.min, files)  # type: ignore[arg-type]
    assert files.asked == []


def test_blocks_of_the_baseline_are_kept_until_their_files_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nights = Nights(motor(), 3, changes={place: {} for place in range(3)})
    rows = blocks_of(nights)
    labels = [night_of(place) for place in range(3)]
    for (night,), part in rows.partition_by("night", as_dict=True).items():
        write_table(night_file(tmp_path, BLOCK_STATISTICS, night), part)
    layout = Layout.of(nights.spec, labels[0])

    def read() -> DutyBlocks:
        found = BlockFiles(tmp_path, ["M1"]).of_baseline(nights.spec, layout, labels, "hash-vg68")
        assert found is not None
        return found

    first = read()
    assert len(first.nights) == rows.height
    np.testing.assert_allclose(first.conditions[:, 1], rows["mean_pressure_bar"])
    reads: list[object] = []
    plain = baseline_blocks.read_rows
    monkeypatch.setattr(
        baseline_blocks,
        "read_rows",
        lambda *some, **more: reads.append(some) or plain(*some, **more),
    )
    kept = read()
    assert reads == []
    for name in ("factors", "conditions", "nights"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(first, name))
    late = rows.filter(pl.col("night") == labels[1]).head(5)
    write_table(night_file(tmp_path, BLOCK_STATISTICS, labels[1]), late)
    assert len(read().nights) == rows.height - 10


def test_blocks_of_another_model_are_not_compared(tmp_path: Path) -> None:
    nights = Nights(motor(), 1, changes={0: {}})
    write_table(night_file(tmp_path, BLOCK_STATISTICS, night_of(0)), blocks_of(nights))
    files = BlockFiles(tmp_path, ["M1"])
    layout = Layout.of(nights.spec, night_of(0))
    assert files.of(nights.spec, layout, [night_of(0)], "another") is None
    stranger = replace(nights.spec, file=nights.spec.file.model_copy(update={"motor_id": "M2"}))
    assert files.of(stranger, layout, [night_of(0)], "hash-vg68") is None
