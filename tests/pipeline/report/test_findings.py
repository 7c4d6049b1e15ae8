"""Parts named by alarms, against what inspections found."""

from __future__ import annotations

import datetime as dt
from typing import Any

import pytest

from pipeline.report.status import Score, scores
from pipeline.schema import WATCH, frame
from pipeline.trends.nights.decisions import Decision

OPENED = dt.date(2026, 5, 12)
SAID = dt.datetime(2026, 5, 13, 8, tzinfo=dt.UTC)
TYPES = {"M1": "CB560", "M2": "CB400"}


def opened(motor: str = "M1", *, hours: int = 0, **found: str) -> Decision:
    time = SAID + dt.timedelta(hours=hours)
    return Decision(motor, "", time, "finding", OPENED, None, "", **found)


def raised(motor: str, cause: str | None, *, days_before: int = 1, **more: Any) -> dict[str, Any]:
    row = {"run_id": "r", "motor_id": motor, "night": OPENED - dt.timedelta(days=days_before)}
    return row | {"state": "alarm", "cause": cause} | more


def score(decision: Decision, *rows: dict[str, Any]) -> Score | None:
    return scores([decision], frame(WATCH, rows), TYPES).get(TYPES[decision.motor_id])


RING, UNKNOWN = "piston_ring", "cannot_be_told"
BOTH = "piston_ring and balance_sleeve"
OVER = raised("M1", None, state="ok")


@pytest.mark.parametrize(
    ("found", "rows", "expected"),
    [
        ({"worn": RING}, [raised("M1", RING)], Score(named_right=1)),
        ({"sound": RING}, [raised("M1", RING)], Score(named_wrong=1)),
        ({"worn": RING}, [raised("M1", None)], Score(cannot_be_told=1)),
        ({"worn": RING}, [raised("M1", UNKNOWN)], Score(cannot_be_told=1)),
        ({"worn": RING}, [raised("M1", "all_gaps")], Score(cannot_be_told=1)),
        ({"worn": RING}, [raised("M1", "oil_grade")], Score(missed=1)),
        ({"worn": RING, "sound": "balance_sleeve"}, [raised("M1", BOTH)], Score(1, 1)),
        ({"worn": RING}, [raised("M1", "balance_sleeve")], Score(missed=1)),
        ({"worn": RING}, [], Score(missed=1)),
        ({"worn": RING}, [raised("M2", RING)], Score(missed=1)),
        ({"sound": RING}, [raised("M1", None)], Score()),
        # The oil of a circuit is no alarm of the motor.
        ({"worn": RING}, [raised("M1", RING, state="common_cause")], Score(missed=1)),
        # The newest alarm counts, none after the opening, and none from long before.
        ({"worn": RING}, [raised("M1", RING), raised("M1", UNKNOWN, days_before=3)], Score(1)),
        ({"worn": RING}, [raised("M1", RING, days_before=-1)], Score(missed=1)),
        ({"worn": RING}, [raised("M1", RING, days_before=0)], Score(named_right=1)),
        # It may have stood for weeks before it is opened; an alarm that had ended does not count.
        ({"worn": RING}, [raised("M1", RING, days_before=30)], Score(named_right=1)),
        ({"worn": RING}, [raised("M1", RING, days_before=30), OVER], Score(missed=1)),
    ],
)
def test_a_part_is_scored(found: dict[str, str], rows: list[Any], expected: Score) -> None:
    assert score(opened(**found), *rows) == expected


def test_a_finding_on_a_loss_factor_is_one_on_its_part() -> None:
    for indicator, finding, expected in (
        ("K_piston_ring", "confirmed", Score(named_right=1)),
        ("K_piston_ring", "not_confirmed", Score(named_wrong=1)),
        ("reference_leakage", "confirmed", None),
    ):
        found = Decision("M1", indicator, SAID, "finding", OPENED, finding, "seen")
        assert score(found, raised("M1", RING)) == expected


def test_motors_are_told_by_type_and_the_last_word_counts() -> None:
    said = [opened(motor, worn=RING) for motor in ("M1", "M2", "M9")]
    said.insert(1, opened("M1", hours=1, sound=RING))
    found = scores(said, frame(WATCH, [raised("M1", RING)]), TYPES)
    assert found == {"CB400": Score(missed=1), "CB560": Score(named_wrong=1)}
