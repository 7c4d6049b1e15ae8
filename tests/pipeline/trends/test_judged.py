"""States: what each asks of the watch (issue 36, model.md 7b)."""

from __future__ import annotations

import pytest

from leakage.watch import Estimate
from pipeline.trends.states.judged import model_verdict
from tests.pipeline.trends.judged_nights import change, judge, waiting, watched
from tests.pipeline.trends.nights import motor

LIMITS = "[limits]\nwarning_l_per_min = 1.6\nalarm_l_per_min = 1.8\n"


def state(*night: object, **more: object) -> str:
    return judge(watched(*night, **more)).state  # type: ignore[arg-type]


def test_nothing_told_is_ok_and_a_change_a_warning() -> None:
    assert state() == "ok"
    for cause in ("balance_sleeve", "all_gaps", "all_flows", "oil_grade", "cannot_be_told", "zero"):
        assert state(change(cause)) == "warning"


def test_an_alarm_is_a_rise_beyond_its_level_with_97_percent() -> None:
    """30 % by default: 1.96 standard deviations below 32 % it is, 1.9 below it is not yet."""
    far = change("balance_sleeve", size=Estimate(0.32, 0.01))
    assert state(far) == "alarm"
    assert state(far, present=Estimate(0.3 + 1.9 * 0.01, 0.01)) == "warning"
    fall = change("all_flows", is_rise=False, size=Estimate(-0.4, 0.01))
    assert state(fall) == "warning"


def test_what_the_tank_did_is_no_own_alarm() -> None:
    assert state(change("tank", size=Estimate(0.5, 0.01))) == "common_cause"


def test_an_effect_of_temperature_alone_is_a_notice() -> None:
    assert state(change("temperature_effect")) == "ok"
    assert state(change("back_as_before")) == "ok"


def test_a_motor_that_says_nothing_for_more_than_a_week_is_stale_whatever_stood() -> None:
    for found in (None, change("balance_sleeve")):
        assert state(found, silent=7, n_blocks=0) != "stale"
        assert state(found, silent=8, n_blocks=0) == "stale"
    assert judge(waiting(0, silent=8, n_blocks=0)).state == "stale"


def test_fewer_nights_than_a_baseline_needs_are_insufficient() -> None:
    assert judge(waiting(5)).state == "insufficient"


@pytest.mark.parametrize(
    ("leakage", "expected"),
    [(1.55, "ok"), (1.65, "warning"), (1.83, "warning"), (1.85, "alarm")],
)
def test_limits_of_the_motor_type_count_with_97_percent(leakage: float, expected: str) -> None:
    spec = motor(limits=LIMITS)
    found = judge(watched(reference=Estimate(leakage, 0.02)), spec)
    assert found.state == expected
    assert expected == "ok" or found.way == "limit"
    # Before there is a watch the night's own fit tells it, too.
    early = judge(waiting(3), spec, fitted=Estimate(leakage, 0.02))
    assert early.state == ("insufficient" if expected == "ok" else expected)


def test_a_limit_holds_whatever_the_others_on_the_tank_do() -> None:
    found = judge(watched(change("tank"), reference=Estimate(2.0, 0.02)), motor(limits=LIMITS))
    assert found.state == "alarm"


def test_where_the_model_is_disproved_no_part_is_named() -> None:
    growth = Estimate(0.5, 0.02)
    for cause in ("balance_sleeve", "balance_sleeve and piston_ring", "all_gaps"):
        found = judge(watched(change(cause, path_growth=growth), lack_of_fit=0.06))
        assert found.change is not None
        assert (found.change.cause, found.gap_growth) == ("cannot_be_told", None)
        assert found.state == "warning"
    doubtful = judge(watched(change("balance_sleeve"), lack_of_fit=0.05))
    assert doubtful.change is not None
    assert doubtful.change.cause == "balance_sleeve"
    flows = judge(watched(change("all_flows"), lack_of_fit=0.2)).change
    assert flows is not None
    assert flows.cause == "all_flows"


def test_the_verdict_on_the_model_is_its_lack_of_fit() -> None:
    found = [model_verdict(one) for one in (0.02, 0.0201, 0.05, 0.0501)]
    assert found == ["supported", "doubtful", "doubtful", "disproved"]
    assert judge(waiting(3)).model_verdict is None


def test_a_gap_goes_with_the_cube_root_of_its_leakage() -> None:
    gap = judge(watched(change("piston_ring", path_growth=Estimate(1.197, 0.03)))).gap_growth
    assert gap is not None
    assert gap.value == pytest.approx(0.3, abs=1e-4)
    # d(1 + g)^(1/3) = dg / (3 (1 + g)^(2/3)).
    assert gap.sd == pytest.approx(0.03 / (3 * 1.3**2), rel=1e-4)
    assert judge(watched(change("known", path_growth=Estimate(0.5, 0.03)))).gap_growth is None
