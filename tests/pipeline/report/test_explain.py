"""What `explain`, `status` and `ack` say of good nights, failed ones, and states."""

from __future__ import annotations

import datetime as dt
import math
import re
from pathlib import Path

import pytest
import typer

from pipeline.cli.arguments import duration
from pipeline.errors import UsageError
from pipeline.night.rows import explain_warm_up
from pipeline.report.build import STATES
from pipeline.report.explain import explain
from pipeline.report.status import last_alarm
from pipeline.schema import ALARMS, frame
from pipeline.trends.motor_states import ACTIONABLE, CHANGED, ORDER
from tests.pipeline.report.conftest import change_table, rows_with
from tests.pipeline.written import write_nights

FIRST = dt.date(2026, 1, 2)


def test_a_poor_fit_is_called_one(output: Path) -> None:
    change_table(
        output, "nights", rows_with("CB560-01", validation_fit_percent=-1295.0), f"{FIRST}"
    )
    (fit,) = [line for line in explain(output, "CB560-01", FIRST) if line.startswith("  fit: ")]
    assert "validation -1295.0 % (poor: worse than a constant flow)" in fit
    assert fit.count("poor") == 1


@pytest.mark.parametrize(
    ("sessions", "minutes", "missing", "cold"),
    [(1, 90, 0.5, 30), (4, 25, 0.5, 20), (4, 15, 0.5, 10), (4, 25, 0.0, None), (1, 25, 0.5, None)],
)
def test_a_warm_up_is_seen_however_short_sessions_are(
    sessions: int, minutes: int, missing: float, cold: int | None
) -> None:
    """Of 5 l/min a share is missing at each start, and e times less every 12 minutes."""
    rows = []
    for start in range(0, sessions * (minutes + 40), minutes + 40):
        for minute in range(minutes):
            time = dt.datetime(2026, 1, 1, 22, tzinfo=dt.UTC) + dt.timedelta(minutes=start + minute)
            flow = 5.0 * (1.0 - missing * math.exp(-minute / 12.0))
            ripple = 0.05 * math.sin(start + 2.0 * minute)
            rows.append(
                {"time": time, "measured_l_per_min": flow + ripple, "predicted_l_per_min": 4.5}
            )
    seen = re.findall(r"(.)\d+ % of the flow in the first (\d+)", "".join(explain_warm_up(rows)))
    assert seen == ([] if cold is None else [("-", str(cold))])


def test_a_silent_motor_is_acknowledged_and_not_inspected(tmp_path: Path) -> None:
    nights = {"alarm": dt.date(2026, 1, 6), "stale": dt.date(2026, 1, 7)}
    rows = [
        {"id": state, "motor_id": "M1", "night": night, "from_state": "ok", "to_state": state}
        | {"sentence": "it grew", "run_id": "r"}
        for state, night in nights.items()
    ]
    write_nights(tmp_path, ALARMS, frame(ALARMS, rows))
    assert last_alarm(tmp_path, "M1", "leakage", ACTIONABLE) == nights["stale"]
    assert last_alarm(tmp_path, "M1", "leakage", CHANGED) == nights["alarm"]
    with pytest.raises(UsageError, match="alarms so far: none"):
        last_alarm(tmp_path, "M2", "leakage", ACTIONABLE)


@pytest.mark.parametrize("text", ["", "h", "26", "-1h", "0h", "infh", "nanh", "1y", "26 h ours"])
def test_a_duration_that_is_none(text: str) -> None:
    with pytest.raises(typer.BadParameter):
        duration(text)


def test_every_state_has_a_meaning() -> None:
    assert set(STATES) == set(ORDER)
