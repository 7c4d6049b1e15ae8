"""Alarms that a change of rules moves stand on the fleet page and in `status`."""

from __future__ import annotations

import datetime as dt
import re
from typing import Any

import polars as pl

from pipeline.cli.status_lines import print_status
from pipeline.report.pages import FleetFacts, fleet_html
from pipeline.report.status import FleetStatus, changed_by_rules
from pipeline.schema import ALARMS, frame

NIGHT = dt.date(2026, 3, 4)
FACTS = FleetFacts("Mill", NIGHT, NIGHT, ())


def row(before: str | None, after: str, **more: Any) -> dict[str, Any]:
    rules = None if before is None else "trends 5 to 6"
    keys = {"motor_id": "M<1>", "night": NIGHT, "indicator": "K_piston_ring", "page": "m1"}
    states = {"to_state": after, "state_before_rules": before, "rules": rules}
    return keys | states | {"reason": "+9 % [8, 10]", "is_silent": True} | more


def test_only_states_that_were_raised_changed_or_withdrawn_count() -> None:
    made = [
        row(None, "alarm"),
        row("warning", "warning"),
        row("insufficient", "ok"),
        row("ok", "warning"),
        row("warning", "alarm"),
        row("alarm", "ok"),
    ]
    rows = [
        {name: value for name, value in one.items() if name != "page"}
        | {"night": NIGHT + dt.timedelta(place)}
        for place, one in enumerate(made)
    ]
    found = changed_by_rules(frame(ALARMS, rows))
    assert found.select("state_before_rules", "to_state").rows() == [
        ("ok", "warning"),
        ("warning", "alarm"),
        ("alarm", "ok"),
    ]
    assert changed_by_rules(pl.DataFrame(schema=ALARMS.schema)).is_empty()


def test_the_page_lists_them_and_is_linked_only_where_there_are_any() -> None:
    page = fleet_html(FACTS, [], [row("ok", "warning"), row("ok", "alarm", is_silent=False)])
    assert 'href="#rules"' in page
    _, section = page.split('<section id="rules">')
    cells = re.sub(r"<[^>]+>", " ", section.split("</section>")[0])
    words = " ".join(cells.split())
    line = "M&lt;1&gt; 2026-03-04 piston ring gap ok {} +9 % [8, 10] trends 5 to 6 {}"
    assert line.format("warning", "no") in words
    assert line.format("alarm", "yes") in words
    assert "rules" not in fleet_html(FACTS, [])


def test_status_says_how_many(capsys: Any) -> None:
    for n, expected in ((0, False), (3, True)):
        print_status(
            "Mill", FleetStatus((), None, 0, 0, n_by_rules=n), too_old=False, as_json=False
        )
        lines = capsys.readouterr().err.splitlines()
        said = "changes of the program's rules: other states of past nights: 3"
        assert any(line.startswith(said) for line in lines) is expected
