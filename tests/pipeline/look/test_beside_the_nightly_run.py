"""Looks beside nightly runs: the same tables to the byte, and a verdict of the night."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.look.state import look_statuses
from tests.pipeline.calling import contents
from tests.pipeline.look.fleet import MINUTES, TODAY, Growing, night_rows, published

# What a run writes of itself, and what looks write.
OF_A_RUN = ("runs", "motor_outcomes", "looks")


def tables(fleet: Growing) -> dict[str, bytes]:
    found = contents(fleet.output / "tables")
    return {name: one for name, one in found.items() if not name.startswith(OF_A_RUN)}


@pytest.mark.full
def test_a_day_of_looks_leaves_the_tables_of_the_night_as_they_are_without(tmp_path: Path) -> None:
    looked = published(tmp_path / "looked")
    alone = looked.copy(tmp_path / "alone")
    rows = night_rows(looked.spec, TODAY, 500, 0.8, 30.0)
    alone.append(rows)
    alone.run()
    for minute in range(24 * 60):
        if minute < MINUTES:
            looked.append(rows[minute * 60 : (minute + 1) * 60])
        if minute == 9 * 60:
            looked.run()
        looked.look(minute + 1)
    assert tables(looked) == tables(alone)
    moves = [(row["to_state"], row["verdict"]) for row in looked.looks()]
    assert moves[:3] == [("blind", None), ("clear", None), ("look_now", "told")]
    assert moves[3] == ("look_now", "confirmed")
    scores = look_statuses(looked.output, ["M1"])["M1"]
    assert (scores.told, scores.confirmed, scores.withdrawn) == (1, 1, 0)
    assert [one["verdict"] for one in looked.told() if "verdict" in one] == ["told", "confirmed"]


def test_columns_that_change_are_told_as_that_and_not_as_a_rise(tmp_path: Path) -> None:
    fleet = published(tmp_path / "fleet")
    healthy = night_rows(fleet.spec, TODAY, 500)
    cells = [row.rstrip().split(",") for row in healthy]
    others = {
        "mpa": (
            [[time, str(float(p) / 10), t, w, y] for time, p, t, w, y in cells],
            "if the log is now in MPa where the config has bar",
        ),
        "swapped": (
            [[time, w, t, p, y] for time, p, t, w, y in cells],
            "columns changed? pressure difference and speed look swapped: ",
        ),
    }
    begin, change = 12 * 60, 25 * 60
    for name, (changed, words) in others.items():
        other = fleet.copy(tmp_path / name)
        rows = [*healthy[:change], *(",".join(one) + "\n" for one in changed[change:])]
        other.append(rows[:begin])
        other.look(begin / 60)
        other.append(rows[begin:])
        other.look()
        assert [row["to_state"] for row in other.looks()] == ["blind", "clear", "blind"]
        assert words in str(other.looks()[-1]["reason"])
        assert other.told() == []
