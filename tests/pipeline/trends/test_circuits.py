"""Motors of one oil circuit: what moves all of them is no wear, what moves one is."""

from __future__ import annotations

import re

import numpy as np
import pytest

from pipeline.trends.figures.indicators import DEVIATION
from pipeline.trends.rows.alarm_rows import alarm_rows
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import RAISED, Standing
from pipeline.trends.why.reasons import path_behind, path_named, why_state
from tests.pipeline.trends.nights import OIL, Nights, histories, motor, named, ramp, standings, step

N, AT = 110, 80
THIN = {OIL: step(N, AT, 0.25)}
THIN_BEFORE, THINNER = ({OIL: step(N, 60, size)} for size in (0.25, 0.5))
SLEEVE = {"balance_sleeve": step(N, AT, 0.40)}


def tank(*wear: dict[str, np.ndarray], charge: np.ndarray | None = None) -> dict[str, Standing]:
    """Motors M1, M2, … on one tank, each with its wear."""
    motors = [
        Nights(named(motor(), f"M{number}", "tank"), N, one, seed=number, charge=charge)
        for number, one in enumerate(wear, start=1)
    ]
    return standings(histories(*motors))


def both(*changes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Changes that come together."""
    return {
        path: np.prod([one[path] for one in changes if path in one], axis=0)
        for path in {path for one in changes for path in one}
    }


def raised(standing: Standing) -> set[str]:
    """Indicators that were ever raised."""
    return {name for name in standing.watched if set(standing.states[name]) & set(RAISED)}


def last(standing: Standing) -> dict[str, str]:
    return {name: standing.states[name][-1] for name in standing.watched}


def test_thin_oil_in_the_tank_raises_no_motor() -> None:
    found = tank(THIN, THIN, THIN, THIN)
    for standing in found.values():
        assert raised(standing) == set()
        assert set(last(standing).values()) == {"common_cause"}
        why = why_state(standing, DEVIATION, N - 1, path_behind(standing, DEVIATION, N - 1))
        assert re.search(
            r"all flows × 1\.25 ± 0\.0\d, as in the other motors of the oil circuit: as if the oil "
            r"were 20 % thinner, not this motor; no path \(",
            why,
        )


@pytest.mark.parametrize("size", [-0.25, -0.15, 0.08])
def test_another_oil_for_the_whole_tank_in_one_night_raises_no_motor(size: float) -> None:
    """Every path of every motor by one factor: it was taken for a sudden change of each motor."""
    oil = {OIL: step(N, AT, size)}
    for standing in tank(oil, oil, oil).values():
        assert raised(standing) == set()
        assert [one.kind for one in standing.sudden if one.kind != "circuit"] == []


def test_thick_oil_is_told_as_what_it_is() -> None:
    oil = {OIL: step(N, AT, -0.25)}
    for standing in tank(oil, oil, oil).values():
        assert last(standing)[DEVIATION] == "common_cause"
        why = why_state(standing, DEVIATION, N - 1, None)
        assert "as in the other motors of the oil circuit: oil, temperature or charge" in why


def test_wear_of_one_motor_is_its_own() -> None:
    found = tank(SLEEVE, {}, {})
    assert last(found["M1"])["K_balance_sleeve"] == "alarm"
    assert raised(found["M2"]) == raised(found["M3"]) == set()
    assert "common_cause" not in {*last(found["M2"]).values(), *last(found["M3"]).values()}


def test_wear_beside_thin_oil_blames_the_worn_path_alone() -> None:
    """Changes of the worn motor's ring and pistons are the oil's, as in the other motors."""
    found = tank(both(THIN, SLEEVE), THIN, THIN, THIN)
    worn = found["M1"]
    assert raised(worn) == {
        "K_balance_sleeve",
        "reference_leakage",
        "own_reference_leakage",
        DEVIATION,
    }
    assert last(worn)["K_piston_ring"] == last(worn)["K_balance_piston"] == "common_cause"
    for name in ("reference_leakage", DEVIATION):
        behind = path_behind(worn, name, N - 1)
        assert behind is not None
        assert (behind.verdict, behind.named) == ("path", ("balance_sleeve",))
        assert path_named(worn, name, N - 1, behind) == "balance_sleeve"
        why = why_state(worn, name, N - 1, behind)
        assert "mostly by the balance sleeve (over 99 % probable); and all flows × 1.25" in why
    for name in ("M2", "M3", "M4"):
        assert raised(found[name]) == set()


def test_what_one_path_has_told_stays_in_a_night_that_does_not_tell_it_apart() -> None:
    """It fell from alarm to common cause for a night, as the others had moved by more."""
    worn, _ = tank(both(THIN_BEFORE, {"balance_sleeve": step(N, AT, 0.22)}), THINNER).values()
    assert set(worn.states["K_balance_sleeve"][AT + 2 :]) == {"alarm"}


@pytest.mark.parametrize("others", [0, 1, 2])
def test_two_motors_that_wear_alike_do_not_excuse_each_other(others: int) -> None:
    found = tank(SLEEVE, SLEEVE, *[{}] * others)
    for name in ("M1", "M2"):
        states = found[name].states["K_balance_sleeve"]
        assert "common_cause" not in states
        assert states[-1] == "alarm"
        assert {place for place, state in enumerate(states) if state in RAISED} >= set(
            range(AT + 4, N)
        )
    for number in range(others):
        assert raised(found[f"M{number + 3}"]) == set()


def test_with_two_motors_it_is_said_that_nobody_can_tell_which() -> None:
    found = tank(SLEEVE, {})
    row = next(
        row for row in trend_rows(found["M1"], [N - 1]) if row["indicator"] == "peer_deviation"
    )
    # 40 % on the sleeves' part of the flow, which the deviation has as a whole.
    expected = found["M1"].watched[DEVIATION].indicator.value[-1]
    assert row["value"] == pytest.approx(expected, abs=0.01)
    assert row["state_reason"] == "with one other motor: they diverge, nobody can tell which"


def test_a_motor_whose_peers_are_silent_decides_alone() -> None:
    quiet = Nights(named(motor(), "M2", "tank"), N, absent=frozenset(range(AT, N)), seed=2)
    worn = Nights(named(motor(), "M1", "tank"), N, SLEEVE)
    found = standings(histories(worn, quiet, tonight=N - 1))
    assert last(found["M1"])["K_balance_sleeve"] == "alarm"
    assert last(found["M2"])["K_balance_sleeve"] == "stale"


def test_a_motor_that_joins_later_changes_nothing_of_what_was_said() -> None:
    """Before it can be compared, the motor's own nights decide, as they did then."""
    late = Nights(named(motor(), "M2", "tank"), N, absent=frozenset(range(60)), seed=2)
    alone = Nights(named(motor(), "M1", "tank"), N, SLEEVE)
    found = standings(histories(alone, late))["M1"]
    by_itself = standings(histories(alone))["M1"]
    for name in found.watched:
        assert found.states[name][:89] == by_itself.states[name][:89]


def test_the_circuit_coming_back_ends_a_common_cause() -> None:
    oil = {OIL: step(N, 60, 0.25) / step(N, AT, 0.25)}
    (first, *_) = tank(oil, oil, oil).values()
    rows = [row for row in alarm_rows(first, range(N)) if row["indicator"] == "reference_leakage"]
    assert [row["to_state"] for row in rows] == ["ok", "common_cause", "ok"]
    assert rows[-1]["reason"] == "the oil circuit is back where it was"


def test_another_motors_wear_is_not_taken_for_the_oils() -> None:
    """Two of three wear, one a little more slowly and by another path: none excuses the other."""
    slow = {"balance_piston": ramp(N, 40, 0.6)}
    quick = {"balance_sleeve": step(N, AT, 0.4)}
    found = tank(quick, slow, {})
    why = why_state(found["M1"], DEVIATION, N - 1, path_behind(found["M1"], DEVIATION, N - 1))
    assert "the other motors" not in why
    assert "mostly by the balance sleeve" in why
    for name, path in (("M1", "balance_sleeve"), ("M2", "balance_piston")):
        by_itself = standings(
            histories(
                Nights(
                    named(motor(), name), N, *{"M1": [quick], "M2": [slow]}[name], seed=int(name[1])
                )
            )
        )[name]
        together = found[name].states[f"K_{path}"]
        alone = by_itself.states[f"K_{path}"]
        first = next(place for place, state in enumerate(alone) if state in RAISED)
        # Within a few nights of what it would be told by itself.
        assert set(together[first + 4 :]) <= set(RAISED)
