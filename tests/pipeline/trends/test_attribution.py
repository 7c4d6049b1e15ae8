"""Which path is behind a change, and what is said where that cannot be told."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import pytest

from pipeline.trends.attribution import path_behind, path_flows, path_named, reference_flows
from pipeline.trends.indicators import DEVIATION, OWN_REFERENCE, REFERENCE
from pipeline.trends.reasons import why_state
from pipeline.trends.standing import Standing
from pipeline.trends.trend_rows import trend_rows
from tests.pipeline.trends.nights import PATHS, Nights, motor, ramp, standing, step

N, AT = 110, 80
# Error correlation of the balance pistons and sleeves (model.md, section 5).
TRADE = -0.985


def told(found: Standing, name: str) -> tuple[str, tuple[str, ...], str]:
    behind = path_behind(found, name, N - 1)
    assert behind is not None
    return behind.status, behind.paths, why_state(found, name, N - 1, behind)


@pytest.mark.parametrize("path", ["balance_piston", "balance_sleeve"])
@pytest.mark.parametrize("name", [REFERENCE, OWN_REFERENCE, DEVIATION])
def test_the_path_that_wears_is_named(path: str, name: str) -> None:
    found = standing(Nights(motor(), N, {path: step(N, AT, 0.5)}))
    status, paths, words = told(found, name)
    assert (status, paths) == ("path", (path,))
    assert words.endswith(f"mostly by the {path.replace('_', ' ')} (over 99 % probable)")
    row = next(row for row in trend_rows(found, [N - 1]) if row["indicator"] == name)
    assert row["path"] == path
    assert row["path_probability"] > 0.99


def test_a_worn_ring_is_named_where_it_shows() -> None:
    """At 200 bar it is 0.8 % of the leakage; over all pressures of a night it is much more."""
    found = standing(Nights(motor(), N, {"piston_ring": step(N, AT, 0.6)}))
    assert told(found, DEVIATION)[:2] == ("path", ("piston_ring",))
    assert found.states[REFERENCE][-1] == "ok"
    assert path_behind(found, REFERENCE, N - 1) is None


def test_several_paths_that_have_certainly_grown_are_all_named() -> None:
    wear = {"balance_piston": step(N, AT, 0.6), "balance_sleeve": step(N, AT, 0.4)}
    found = standing(Nights(motor(), N, wear))
    status, paths, words = told(found, REFERENCE)
    assert (status, paths) == ("several", ("balance_piston", "balance_sleeve"))
    assert "by the balance piston and the balance sleeve, which have all grown (over 99" in words
    behind = path_behind(found, REFERENCE, N - 1)
    assert path_named(found, REFERENCE, N - 1, behind) == "balance_piston and balance_sleeve"


def test_pistons_and_sleeves_are_one_where_their_split_rests_on_noise() -> None:
    """Errors of 20 % that trade against each other: their sum is known to 1 %, the split is not."""
    wear = {"balance_piston": step(N, AT, 0.08), "balance_sleeve": step(N, AT, 0.08)}
    seen = Counter()
    for seed in range(8):
        found = standing(Nights(motor(), N, wear, seed=seed, noise=8.0, trade=TRADE))
        behind = path_behind(found, DEVIATION, N - 1)
        assert behind is not None
        seen[behind.status] += 1
        if behind.status == "together":
            assert behind.paths == ("balance_piston", "balance_sleeve")
            words = why_state(found, DEVIATION, N - 1, behind)
            assert (
                "by the balance piston and the balance sleeve together: the split between balance "
                "piston and balance sleeve rests on noise (error correlation -0.9"
            ) in words
            named = path_named(found, DEVIATION, N - 1, behind)
            assert named == "balance_piston and balance_sleeve"
    assert seen["together"] >= 5
    # Never one of them alone with certainty it has not.
    assert seen["path"] <= 1


def test_what_the_nights_do_not_tell_is_said_to_be_so() -> None:
    """Independent errors so wide that each path might be it, though one of them has grown."""
    wear = {"balance_piston": step(N, AT, 0.106), "balance_sleeve": step(N, AT, 0.074)}
    seen = Counter()
    for seed in range(8):
        found = standing(Nights(motor(), N, wear, seed=seed, noise=8.0))
        behind = path_behind(found, DEVIATION, N - 1)
        assert behind is not None
        seen[behind.status] += 1
        if behind.status == "cannot_be_told_apart":
            words = why_state(found, DEVIATION, N - 1, behind)
            assert re.search(
                "which path cannot be told: (no path is more than .* % probable|the coefficients "
                "scatter too widely: they have not certainly risen)$",
                words,
            ), words
            assert path_named(found, DEVIATION, N - 1, behind) is None
    assert seen["cannot_be_told_apart"] >= 4
    # An alarm that stands is never said to be none.
    assert seen["no_change"] == 0


def without(path: str) -> dict[tuple[int, str], str]:
    return {(place, f"K_{path}"): "only_in_combination" for place in range(N)}


def test_a_path_whose_coefficient_is_not_known_is_the_rest() -> None:
    wear = {"balance_piston": step(N, AT, 0.5)}
    found = standing(Nights(motor(), N, wear, verdicts=without("balance_piston")))
    status, _, words = told(found, DEVIATION)
    assert status == "cannot_be_told_apart"
    assert "the nights do not tell the coefficients of: balance piston" in words
    assert path_named(found, DEVIATION, N - 1, path_behind(found, DEVIATION, N - 1)) is None


def test_a_known_path_that_explains_all_is_named_though_another_is_not_known() -> None:
    wear = {"balance_sleeve": step(N, AT, 0.6)}
    found = standing(Nights(motor(), N, wear, verdicts=without("balance_piston")))
    assert told(found, DEVIATION)[:2] == ("path", ("balance_sleeve",))


def test_a_motor_of_which_no_path_is_known_still_has_its_alarm() -> None:
    none = {(place, f"K_{path}"): "not_excited" for place in range(N) for path in PATHS}
    found = standing(Nights(motor(), N, {"balance_sleeve": step(N, AT, 0.5)}, verdicts=none))
    assert found.states[DEVIATION][-1] == "warning"
    words = told(found, DEVIATION)[2]
    assert "do not tell the coefficients of: piston ring, balance piston, balance sleeve" in words


def test_a_factor_that_only_trades_with_another_blames_neither() -> None:
    """A split that drifts, with the sum as it was: K of the pistons rises, the other falls."""
    flows = reference_flows(standing(Nights(motor(), 2)), 1)
    truth = Nights(motor(), 1).truth()[0]
    gain = 0.6
    loss = gain * truth[1] * flows["balance_piston"] / (truth[2] * flows["balance_sleeve"])
    drift = {"balance_piston": step(N, AT, gain), "balance_sleeve": step(N, AT, -loss)}
    found = standing(Nights(motor(), N, drift, noise=3.0, trade=TRADE))
    name = "K_balance_piston"
    assert found.states[name][-1] == "alarm"
    status, paths, words = told(found, name)
    assert (status, paths) == ("cannot_be_told_apart", ("balance_piston", "balance_sleeve"))
    assert "balance_sleeve falls by what balance_piston rises".replace("_", " ") in words
    assert path_named(found, name, N - 1, path_behind(found, name, N - 1)) is None


def test_an_indicator_that_is_ok_has_no_path() -> None:
    found = standing(Nights(motor(), N))
    for name in found.watched:
        assert path_behind(found, name, N - 1) is None
        assert path_named(found, name, N - 1, None) is None


def test_a_wear_that_goes_on_is_told_by_its_latest_nights() -> None:
    found = standing(Nights(motor(), N, {"balance_piston": ramp(N, 50, 0.5)}))
    assert told(found, DEVIATION)[:2] == ("path", ("balance_piston",))


def test_flows_are_those_of_the_table_of_worked_values() -> None:
    """CB560 at 200 bar, 50 °C, 30 rpm: l/min of 32 interfaces (model.md, section 3)."""
    found = standing(Nights(motor(), 40))
    truth = Nights(motor(), 1).truth()[0]
    flows = reference_flows(found, 39)
    leakage = [flows[path] * k for path, k in zip(PATHS, truth, strict=False)]
    expected = [32 * 3.445024e-4, 32 * 1.061377e-2, 32 * 1.529589e-2]
    np.testing.assert_allclose(leakage, expected, rtol=1e-6)
    # At the pressures of a night the ring weighs more than there.
    assert path_flows(found, DEVIATION, 39)["piston_ring"] > 3 * flows["piston_ring"]
