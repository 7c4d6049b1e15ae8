"""Attribution of a change in a motor's flows, in indicators, rows and words."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from leakage.course.growth import Growth, Shift
from leakage.course.hypotheses import weigh
from leakage.course.temperature_correction import TemperatureCorrection
from leakage.estimation.block_statistics import with_free_known
from pipeline.night.rows import upper_triangle
from pipeline.trends.baselines.eras import Era
from pipeline.trends.figures.indicators import DEVIATION, OWN_REFERENCE, REFERENCE, coefficients
from pipeline.trends.figures.temperature import Effect
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import Layout, blank_records, whole_matrix
from pipeline.trends.nights.segments import Segment
from pipeline.trends.rows.first_rows import reference_flows
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.explanations import Explanations
from pipeline.trends.states.standing import RAISED, Standing
from pipeline.trends.why.explanation_words import cannot_be_told
from pipeline.trends.why.reasons import path_behind, path_named, why_state
from tests.pipeline.trends.nights import (
    OIL,
    PATHS,
    Nights,
    histories,
    motor,
    named,
    ramp,
    standing,
    standings,
    step,
)

N, AT = 110, 80


def told(found: Standing, name: str) -> tuple[str, tuple[str, ...], str]:
    behind = path_behind(found, name, N - 1)
    assert behind is not None
    return behind.verdict, behind.named, why_state(found, name, N - 1, behind)


def row(found: Standing, name: str) -> dict[str, object]:
    return next(row for row in trend_rows(found, [N - 1]) if row["indicator"] == name)


@pytest.mark.parametrize("path", ["balance_piston", "balance_sleeve"])
@pytest.mark.parametrize("name", [REFERENCE, OWN_REFERENCE, DEVIATION])
def test_the_path_that_wears_is_named(path: str, name: str) -> None:
    found = standing(Nights(motor(), N, {path: step(N, AT, 0.5)}))
    verdict, paths, words = told(found, name)
    assert (verdict, paths) == ("path", (path,))
    assert words.endswith(f"mostly by the {path.replace('_', ' ')} (over 99 % probable)")
    assert row(found, name)["path"] == path
    assert row(found, name)["path_probability"] > 0.99
    assert row(found, name)["common_probability"] < 0.9
    assert "common_factor" not in row(found, name)


def with_free_rollers(of: History) -> History:
    """The same nights as they are published where the scale of the rollers is estimated."""
    spec = replace(of.spec, roller_is_free=True)
    layout = Layout.of(spec, of.nights[0])
    assert layout.stated_columns == of.layout.columns
    assert layout.standard is not None
    records = blank_records(layout, of.nights)
    stated = whole_matrix(of.records["factor"], len(of.layout.columns))
    free = with_free_known(stated, *layout.standard)
    records["factor"] = [upper_triangle(one) for one in free]
    records["mean_temperature_c"] = of.records["mean_temperature_c"]
    return History(spec, layout, records, {})


@pytest.mark.parametrize("wear", [{"balance_sleeve": 0.5}, {OIL: 0.25}])
def test_explanations_do_not_hang_on_the_form_of_the_rollers(wear: dict[str, float]) -> None:
    stated = histories(Nights(motor(), N, {name: step(N, AT, by) for name, by in wear.items()}))
    forms = [stated["M1"], with_free_rollers(stated["M1"])]
    era = Era(Segment(0, N, "first nights"), 30, None, None)
    before, after = (Explanations(form, (era,)).at(N - 1, AT) for form in forms)
    assert before is not None
    assert after is not None
    assert after.verdict == before.verdict == ("common" if OIL in wear else "path")
    assert after.paths == pytest.approx(before.paths, abs=1e-6)
    # The rollers are no indicator: alarms share one rate, whichever form a motor has.
    effect = Effect(np.ones(N), np.zeros(N), np.zeros(N))
    names = [[one.name for one in coefficients(form, effect)] for form in forms]
    assert names[0] == names[1]


def test_a_step_that_only_the_levels_tell_is_explained_by_all_nights_since_it() -> None:
    name, found = (
        "K_balance_piston",
        standing(Nights(motor(), N, {"balance_piston": step(N, AT, 0.6)})),
    )
    told = [one for one in range(AT, N) if found.told[name][one] in RAISED]
    by_level = [one for one in told if found.onset(name, one) is None]
    assert by_level
    assert {found.earliest_onset(one) for one in by_level} == {AT}


def test_rollers_of_a_free_scale_that_follow_temperature_have_not_grown() -> None:
    """Ten nights 10 K colder than the baseline's, where all flows fall by 1 % a kelvin."""
    cold = 50.0 - step(N, AT, 10.0) + 1.0 + np.random.default_rng(1).standard_normal(N)
    nights = Nights(
        motor(), N, {OIL: 1.0 - 0.01 * (cold - 50.0)}, operation={"mean_temperature_c": cold}
    )
    frozen = TemperatureCorrection(-0.01, 0.001, 50.0)
    era = Era(Segment(0, N, "first nights"), 30, None, None, frozen, 30)
    free = with_free_rollers(histories(nights)["M1"])
    found = Explanations(free, (era,)).at(N - 1, AT)
    assert found is not None
    assert (found.verdict, found.named) == ("no_change", ())


def test_a_worn_ring_is_named_where_it_shows() -> None:
    """At 200 bar it is 0.8 % of the leakage; over all pressures of a night it is much more."""
    found = standing(Nights(motor(), N, {"piston_ring": step(N, AT, 0.6)}))
    assert told(found, DEVIATION)[:2] == ("path", ("piston_ring",))
    assert found.states[REFERENCE][-1] == "ok"
    assert path_behind(found, REFERENCE, N - 1) is None


def test_several_paths_that_have_probably_grown_are_all_named() -> None:
    wear = {"balance_piston": step(N, AT, 0.6), "balance_sleeve": step(N, AT, 0.4)}
    found = standing(Nights(motor(), N, wear))
    verdict, paths, words = told(found, REFERENCE)
    assert (verdict, paths) == ("path", ("balance_piston", "balance_sleeve"))
    assert "by the balance piston and the balance sleeve, which have all grown (over 99" in words
    assert row(found, REFERENCE)["path"] == "balance_piston and balance_sleeve"
    # A loss factor speaks for its own path.
    assert row(found, "K_balance_sleeve")["path"] == "balance_sleeve"


def test_thinner_oil_is_a_factor_of_all_flows_and_no_path() -> None:
    """VG 68 at 50 °C loses 4.5 % of its viscosity a kelvin: ln 1.25 / 0.045 = 5 °C."""
    found = standing(Nights(motor(), N, {OIL: step(N, AT, 0.25)}))
    assert {found.states[f"K_{path}"][-1] for path in PATHS} <= {*RAISED}
    for name in (REFERENCE, "K_balance_sleeve"):
        verdict, _, words = told(found, name)
        assert verdict == "common"
        assert re.search(
            r"all flows × 1\.25 ± 0\.0\d: as if the oil were 20 % thinner, or the temperature "
            r"sensor read 5 °C low, or the meter 25 % high; no path \((9\d|over 99) %\)",
            words,
        )
        told_row = row(found, name)
        assert told_row["path"] is None
        assert told_row["common_factor"] == pytest.approx(1.25, abs=0.01)
        assert told_row["common_factor_lower"] < 1.25 < told_row["common_factor_upper"]
        assert told_row["common_origin"] is None


def test_a_flushing_that_rose_as_the_gaps_fell_is_told_with_what_may_do_so() -> None:
    """Half of 3 l/min gone from the gaps, 1.8 l/min more flushing; ± is 1.96 sd."""
    covariance = 1e-4 * np.array([[1.0, -1.0], [-1.0, 1.1]])
    shift = Shift(-0.5, 0.6, covariance, 3.0)
    of = Growth(("gaps",), False, np.array([-0.5]), covariance[:1, :1], np.eye(1), shift=shift)
    words = cannot_be_told(weigh(of))
    assert words.startswith(
        "the gaps' part -50.0 ± 2.0 % and the flushing +1.80 ± 0.06 l/min, which no oil does: "
        "a path with another pressure law"
    )
    assert "the meter's zero or the flushing" in words
    assert "what would tell: " in words


def test_a_sensor_of_one_motor_of_a_tank_is_told_as_its_own() -> None:
    own = Nights(named(motor(), "M1", "tank"), N, {OIL: step(N, AT, 0.2)})
    others = [Nights(named(motor(), f"M{n}", "tank"), N, seed=n) for n in (2, 3)]
    found = standings(histories(own, *others))["M1"]
    assert found.states[DEVIATION][-1] in RAISED
    words = told(found, DEVIATION)[2]
    assert (
        "unlike the other motors of the oil circuit: its own sensor, as if the temperature" in words
    )
    assert row(found, DEVIATION)["common_origin"] == "own_sensor"


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
    flows = reference_flows(standing(Nights(motor(), 40)), 39)
    truth = Nights(motor(), 1).truth()[0]
    leakage = [flows[path] * k for path, k in zip(PATHS, truth, strict=False)]
    expected = [32 * 3.445024e-4, 32 * 1.061377e-2, 32 * 1.529589e-2]
    np.testing.assert_allclose(leakage, expected, rtol=1e-6)
