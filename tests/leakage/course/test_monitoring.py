"""An indicator watched: what each night's state is, and that it never depends on later nights."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.course.alarms import Levels, Limits
from leakage.course.baseline import BaselineSettings
from leakage.course.monitoring import ChangeSize, Monitoring, MonitorSettings, change_size, monitor
from leakage.errors import ShapeError
from tests.leakage.made_nights import autoregression

K = MonitorSettings(baseline=BaselineSettings(relative_floor=0.05))


def healthy(n: int, seed: int, sd: float = 0.003, phi: float = 0.3) -> np.ndarray:
    return 1.37 * (1 + sd * autoregression(n, phi, np.random.default_rng(seed)))


def size_at(nights: np.ndarray, values: np.ndarray, found: Monitoring, place: int) -> ChangeSize:
    baseline = found.baseline_at(place)
    assert baseline is not None
    return change_size(nights, values, baseline, int(found.onset[place]), place)


def test_a_healthy_indicator_is_insufficient_and_then_ok() -> None:
    found = monitor(np.arange(400), healthy(400, 1))
    assert found.states == ["insufficient"] * 15 + ["ok"] * 385
    statuses = [baseline.status for baseline in found.baselines]
    assert statuses == ["provisional", "provisional", "frozen"]
    assert found.served_from == (15, 30, 60)
    assert found.baselines[0].reason == "provisional: 15 of 60 good nights"


def test_a_step_beyond_the_levels_is_a_warning_and_then_an_alarm() -> None:
    nights = np.arange(300)
    values = healthy(300, 2) * np.select([nights >= 200, nights >= 100], [1.5, 1.2], 1.0)
    found = monitor(nights, values)
    assert [found.states.index(one) for one in ("ok", "warning", "alarm")] == [15, 102, 202]


def test_slow_wear_is_told_by_the_sum_long_before_the_levels() -> None:
    """10 % a year: at the level of 15 % after one and a half years."""
    nights = np.arange(730)
    values = healthy(730, 3) * (1 + np.maximum(nights - 100, 0) * 0.10 / 365)
    found = monitor(nights, values)
    first = found.states.index("warning")
    assert 110 < first < 100 + 75
    size = size_at(nights, values, found, first)
    truth = values[first - 5] / 1.37 - 1
    assert size.lower < truth < size.upper
    assert size.upper - size.lower < 0.01
    assert 90 < size.since_night <= first


def test_no_night_depends_on_later_ones() -> None:
    generator = np.random.default_rng(5)
    nights = np.flatnonzero(generator.random(320) > 0.2)
    values = healthy(len(nights), 6, sd=0.02) * (1 + np.maximum(nights - 90, 0) * 0.002)
    values[generator.random(len(nights)) < 0.2] = np.nan
    whole = monitor(nights, values, K)
    for end in range(1, len(nights), 7):
        part = monitor(nights[:end], values[:end], K)
        assert part.states == whole.states[:end]
        assert part.evidence == pytest.approx(whole.evidence[:end], nan_ok=True)


def test_a_later_night_changes_no_figure_but_those_of_its_own_and_after() -> None:
    values = healthy(200, 7, sd=0.02)
    before = monitor(np.arange(200), values)
    values[150:] *= 3.0
    after = monitor(np.arange(200), values)
    assert before.states[:150] == after.states[:150]
    assert before.deviation[30:150] == pytest.approx(after.deviation[30:150])


def test_nights_without_a_value_hold_and_are_stale_after_a_week() -> None:
    nights = np.arange(200)
    values = healthy(200, 8) * np.where(nights >= 100, 1.5, 1.0)
    values[120:140] = np.nan
    found = monitor(nights, values)
    assert found.states[119] == "alarm"
    assert found.states[120:127] == ["alarm"] * 7
    assert found.states[127:140] == ["stale"] * 13
    assert found.states[140] == "alarm"


def test_absent_nights_are_as_good_as_nights_without_a_value() -> None:
    nights = np.arange(200)
    values = healthy(200, 9)
    values[50:85] = np.nan
    kept = np.isfinite(values)
    kept[80] = True
    found, short = monitor(nights, values), monitor(nights[kept], values[kept])
    assert short.states == [state for state, there in zip(found.states, kept, strict=True) if there]
    assert short.states[np.flatnonzero(nights[kept] == 80)[0]] == "stale"


def test_too_few_nights_are_insufficient_for_ever() -> None:
    for n in (0, 1, 3, 14):
        found = monitor(np.arange(n), healthy(max(n, 1), 10)[:n])
        assert found.states == ["insufficient"] * n
    nothing = monitor(np.arange(100), np.full(100, np.nan))
    assert nothing.states == ["insufficient"] * 100


def test_a_mean_that_is_not_positive_is_no_baseline() -> None:
    assert set(monitor(np.arange(90), np.zeros(90)).states) == {"insufficient"}


def test_a_constant_indicator_is_ok() -> None:
    assert set(monitor(np.arange(90), np.full(90, 2.0)).states[15:]) == {"ok"}


def test_wear_does_not_become_its_own_baseline() -> None:
    """Wear from night 30 on, told before night 60: the first thirty nights stay the baseline."""
    nights = np.arange(200)
    values = healthy(200, 11) * (1 + np.maximum(nights - 30, 0) * 0.003)
    found = monitor(nights, values)
    _, provisional, kept = found.baselines
    assert (provisional.status, kept.status, kept.n) == ("provisional", "frozen", 30)
    assert found.served_from == (15, 30, 60)
    assert kept.mean == provisional.mean
    assert kept.reason == "kept at 30 good nights: a change was told before there were 60"
    assert found.states[-1] == "alarm"


def test_a_slope_that_is_not_told_does_not_become_the_baseline_either() -> None:
    nights = np.arange(200)
    values = healthy(200, 12, sd=0.001) * (1 + np.maximum(nights - 30, 0) * 0.0006)
    # So rarely wrong that it says nothing in time.
    silent = MonitorSettings(false_alarms_per_year=0.002)
    found = monitor(nights, values, silent)
    assert found.baselines[-1].reason == "kept at 30 good nights: 60 have a slope"


def test_an_absolute_limit_is_an_alarm_where_the_levels_warn() -> None:
    nights = np.arange(200)
    values = healthy(200, 43) * np.where(nights >= 120, 1.2, 1.0)
    at_least = 1.1 * float(np.mean(values[:120]))
    limited = MonitorSettings(limits=Limits(alarm=at_least))
    assert monitor(nights, values).states[-1] == "warning"
    assert monitor(nights, values, limited).states[-1] == "alarm"


def test_a_motor_exchanged_under_the_same_name_is_an_alarm_or_a_fall_and_no_error() -> None:
    nights = np.arange(200)
    for factor, state in ((8.0, "alarm"), (0.2, "ok")):
        values = healthy(200, 44) * np.where(nights >= 120, factor, 1.0)
        assert monitor(nights, values).states[-1] == state


def test_the_size_of_a_change_holds_the_truth() -> None:
    nights = np.arange(160)
    held = 0
    for seed in range(200):
        noise = autoregression(160, 0.4, np.random.default_rng(seed))
        values = (1 + 0.02 * noise) * np.where(nights >= 100, 1.25, 1.0)
        size = size_at(nights, values, monitor(nights, values), 159)
        held += size.lower <= 0.25 <= size.upper
    assert held / 200 > 0.89


def test_the_size_of_a_wear_that_goes_on_is_that_of_tonight() -> None:
    """0.5 % a night: a mean over the last ten nights lags by more than its interval."""
    nights = np.arange(110)
    truth = 0.005 * np.clip(nights - 69, 0, None)
    held = []
    for seed in range(200):
        scatter = 0.006 * np.random.default_rng(seed).standard_normal(110)
        values = 1.37 * (1.0 + truth + scatter)
        size = size_at(nights, values, monitor(nights, values), 109)
        held.append(size.lower <= truth[-1] <= size.upper)
    assert 0.90 <= np.mean(held) <= 0.985


def test_the_levels_of_a_widely_scattering_indicator_wait_for_more() -> None:
    """Piston rings whose single nights scatter by 13 % reach 15 % by chance."""
    generator = np.random.default_rng(46)
    raised = 0
    for _ in range(30):
        values = 1 + 0.13 * generator.standard_normal(425)
        found = monitor(np.arange(425), values, K)
        raised += not {"warning", "alarm"}.isdisjoint(found.states)
    assert raised <= 2
    loose = MonitorSettings(levels=Levels(least_sd=0.0), baseline=K.baseline)
    values = 1 + 0.13 * generator.standard_normal(425)
    assert "warning" in monitor(np.arange(425), values, loose).states


def test_series_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(ShapeError):
        monitor(np.arange(10), np.ones(9))


def test_only_what_a_night_deviates_by_beyond_its_allowance_counts() -> None:
    generator = np.random.default_rng(11)
    nights = np.arange(120)
    values = 1.0 + 0.002 * generator.standard_normal(120) + 0.05 * (nights >= 90)
    allowance = np.where(nights >= 90, 0.08, 0.0)
    assert monitor(nights, values).states[-1] == "warning"
    found = monitor(nights, values, allowance=allowance)
    assert set(found.states[60:]) == {"ok"}
    # The deviation that is shown is the whole one.
    assert found.deviation[-1] == pytest.approx(0.05, abs=0.01)
    larger = monitor(nights, values + 0.2 * (nights >= 90), allowance=allowance)
    assert larger.states[-1] == "warning"
