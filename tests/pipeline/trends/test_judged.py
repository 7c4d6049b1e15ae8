"""States: what each asks of the watch (issue 36, model.md 7b)."""

from __future__ import annotations

import pytest

from leakage.watch import Change, Estimate
from pipeline.trends.states.judged import model_verdict
from tests.pipeline.trends.judged_nights import change, judge, waiting, watched
from tests.pipeline.trends.nights import motor

LIMITS = "[limits]\nwarning_l_per_min = 1.6\nalarm_l_per_min = 1.8\n"
SLEEVE = "balance_sleeve"
FAR = change(SLEEVE, size=Estimate(0.32, 0.01))


@pytest.mark.parametrize(
    ("found", "more", "expected"),
    [
        (None, {}, "ok"),
        *((change(cause), {}, "warning") for cause in (SLEEVE, "all_flows", "cannot_be_told")),
        # 30 % by default: 1.96 standard deviations below 32 % it is, 1.9 below it is not yet.
        (FAR, {}, "alarm"),
        (FAR, {"present": Estimate(0.3 + 1.9 * 0.01, 0.01)}, "warning"),
        (change("all_flows", is_rise=False, size=Estimate(-0.4, 0.01)), {}, "warning"),
        (change("tank", size=Estimate(0.5, 0.01)), {}, "common_cause"),
        (change("temperature_effect"), {}, "ok"),
        (change("back_as_before"), {}, "ok"),
        (None, {"silent": 7, "n_blocks": 0}, "ok"),
        (None, {"silent": 8, "n_blocks": 0}, "stale"),
        (FAR, {"silent": 8, "n_blocks": 0}, "stale"),
    ],
)
def test_a_state_by_what_the_watch_says(
    found: Change | None, more: dict[str, object], expected: str
) -> None:
    assert judge(watched(found, **more)).state == expected


def test_without_a_baseline_a_motor_waits_or_is_stale() -> None:
    assert judge(waiting(5)).state == "insufficient"
    assert judge(waiting(5)).model_verdict is None
    assert judge(waiting(0, silent=8, n_blocks=0)).state == "stale"


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
    # Whatever the others on the tank do.
    tank = judge(watched(change("tank"), reference=Estimate(leakage, 0.02)), spec)
    assert tank.state == ("common_cause" if expected == "ok" else expected)


@pytest.mark.parametrize(
    ("cause", "lack", "named"),
    [
        (SLEEVE, 0.05, SLEEVE),
        (SLEEVE, 0.06, "cannot_be_told"),
        ("balance_sleeve and piston_ring", 0.06, "cannot_be_told"),
        ("all_gaps", 0.06, "cannot_be_told"),
        ("all_flows", 0.2, "all_flows"),
    ],
)
def test_where_the_model_is_disproved_no_part_is_named(cause: str, lack: float, named: str) -> None:
    candidates = {cause: 0.6, "piston_ring": 0.2, "oil_grade": 0.2}
    found = judge(
        watched(
            change(cause, path_growth=Estimate(0.5, 0.02), candidates=candidates), lack_of_fit=lack
        )
    )
    assert found.change is not None
    assert found.change.cause == named
    assert (found.gap_growth is None) == (named != SLEEVE)
    if lack > 0.05:
        assert "piston_ring" not in found.change.candidates
        assert sum(found.change.candidates.values()) == pytest.approx(1.0)


def test_the_verdict_on_the_model_is_its_lack_of_fit() -> None:
    found = [model_verdict(one) for one in (0.02, 0.0201, 0.05, 0.0501)]
    assert found == ["supported", "doubtful", "doubtful", "disproved"]


def test_a_gap_goes_with_the_cube_root_of_its_leakage() -> None:
    gap = judge(watched(change("piston_ring", path_growth=Estimate(1.197, 0.03)))).gap_growth
    assert gap is not None
    assert gap.value == pytest.approx(0.3, abs=1e-4)
    # d(1 + g)^(1/3) = dg / (3 (1 + g)^(2/3)).
    assert gap.sd == pytest.approx(0.03 / (3 * 1.3**2), rel=1e-4)
    assert judge(watched(change("known", path_growth=Estimate(0.5, 0.03)))).gap_growth is None
