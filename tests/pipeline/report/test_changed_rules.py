"""Alarms that a change of rules moves are counted in `status`."""

from __future__ import annotations

import datetime as dt
from typing import Any

import polars as pl

from pipeline.cli.status_lines import print_status
from pipeline.report.status import FleetStatus, changed_by_rules
from pipeline.schema import ALARMS, frame

NIGHT = dt.date(2026, 3, 4)


def row(before: str | None, after: str, **more: Any) -> dict[str, Any]:
    rules = None if before is None else "trends 5 to 6"
    keys = {"motor_id": "M<1>", "night": NIGHT, "indicator": "leakage"}
    states = {"to_state": after, "state_before_rules": before, "rules": rules}
    return keys | states | {"reason": "+9 % [8, 10]", "is_silent": True} | more


def test_only_states_that_were_raised_changed_or_withdrawn_count() -> None:
    counted = [("ok", "warning"), ("warning", "alarm"), ("alarm", "ok")]
    others = [(None, "alarm"), ("warning", "warning"), ("insufficient", "ok")]
    rows = [
        row(*states) | {"night": NIGHT + dt.timedelta(place)}
        for place, states in enumerate([*others, *counted])
    ]
    found = changed_by_rules(frame(ALARMS, rows))
    assert found.select("state_before_rules", "to_state").rows() == counted
    assert changed_by_rules(pl.DataFrame(schema=ALARMS.schema)).is_empty()


def test_status_says_how_many(capsys: Any) -> None:
    for n, expected in ((0, False), (3, True)):
        found = FleetStatus((), None, 0, 0, n_by_rules=n)
        print_status("Mill", found, too_old=False, as_json=False)
        lines = capsys.readouterr().err.splitlines()
        said = "changes of the program's rules: other states of past nights: 3"
        assert any(line.startswith(said) for line in lines) is expected
