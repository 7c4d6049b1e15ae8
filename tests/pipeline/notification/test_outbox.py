"""Rows of `alarms` reach every receiver at least once, with ids that tell repeats."""

from __future__ import annotations

import datetime as dt
import json
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from pipeline.notification.delivery import Delivery, UndeliveredError
from pipeline.notification.outbox import (
    MOST_CHANGES,
    MOST_FAILURES,
    PAUSES_S,
    backlogs,
    deliver,
    deliver_summary,
    is_notified,
    open_outbox,
    pass_over,
)
from pipeline.schema import ALARM_CONTENT, ALARMS, frame
from pipeline.store.state import open_state
from tests.pipeline.written import night_file, write_nights

FLEET = "Mill"
FIRST = dt.date(2026, 2, 17)


@dataclass
class Fake:
    """A receiver that takes or refuses on command."""

    name: str = "command"
    label: str = "alarms.command"
    refuses: Callable[[Delivery], bool] = lambda _: False
    hangs: bool = False
    tried: list[Delivery] = field(default_factory=list)
    taken: list[dict[str, Any]] = field(default_factory=list)

    def take(self, delivery: Delivery) -> None:
        self.tried.append(delivery)
        if self.refuses(delivery):
            raise UndeliveredError("out of ink", hung=self.hangs)
        document = json.loads(delivery.content)
        assert document["id"] == delivery.id
        self.taken.append(document)

    def changes(self) -> list[dict[str, Any]]:
        return [change for document in self.taken for change in document["changes"]]

    def motors(self) -> list[str]:
        return [change["motor_id"] for change in self.changes()]


@pytest.fixture(autouse=True)
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Waits between tries, which cost no time here."""
    pauses: list[float] = []
    monkeypatch.setattr(time, "sleep", lambda seconds: pauses.append(seconds) if seconds else None)
    return pauses


def row(motor: str, night: dt.date = FIRST, state: str = "alarm", **more: Any) -> dict[str, Any]:
    row = {"run_id": "r", "motor_id": motor, "night": night, "id": f"{motor} {night} leakage"}
    row |= {"from_state": "ok", "to_state": state, "sentence": "piston ring gap +27 % [25, 29]"}
    absent = dict.fromkeys(("cause", "closed_as", "leakage_change_lower", "leakage_change_upper"))
    return row | {"leakage_change_percent": 27.0} | absent | more


def publish(output: Path, *rows: dict[str, Any]) -> None:
    """Put the rows of each night, in place of those that it has."""
    for night in {row["night"] for row in rows}:
        here = [row for row in rows if row["night"] == night]
        write_nights(output, ALARMS, frame(ALARMS, here))


def run(
    output: Path,
    rows: Iterable[dict[str, Any]],
    *receivers: Fake,
    fleet: str = FLEET,
    silent: Collection[str] = (),
) -> tuple[str, ...]:
    """The steps of a run that publishes some rows."""
    with open_state(output) as state:
        open_outbox(state, [receiver.name for receiver in receivers])
        publish(output, *rows)
        pass_over(state, silent)
        return deliver(state, receivers, fleet)


def deaf(**more: Any) -> Fake:
    return Fake(refuses=lambda _: True, **more)


@pytest.mark.parametrize(
    ("before", "after", "is_news"),
    [
        ("insufficient", "ok", False),  # a baseline is no news,
        ("ok", "insufficient", False),
        ("alarm", "insufficient", True),  # unless it ends what was sent
        ("stale", "insufficient", True),
    ],
)
def test_a_baseline_is_not_sent(before: str, after: str, is_news: bool) -> None:
    assert is_notified(row("M1", state=after, from_state=before)) is is_news


def test_of_silent_rows_nothing_is_sent_now_or_later(tmp_path: Path) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1"), row("M2", state="warning")], receiver)
    past = [row(f"P{n}") for n in range(3)]
    words = row("M1", sentence="other words")
    rows = [*past, words, row("M2"), row("M1", FIRST + dt.timedelta(1))]
    run(tmp_path, rows, receiver, silent=[change["id"] for change in (*past, words)])
    run(tmp_path, rows, receiver)
    changes = [(change["motor_id"], change["change"]) for change in receiver.changes()[2:]]
    assert changes == [("M2", "changed"), ("M1", "new")]


def test_a_row_that_waits_is_sent_though_a_rule_words_it_anew(tmp_path: Path) -> None:
    receiver = deaf()
    run(tmp_path, [], receiver)
    run(tmp_path, [row("M1")], receiver)
    run(tmp_path, [other := row("M1", sentence="other words")], receiver, silent=[other["id"]])
    receiver.refuses = lambda _: False
    run(tmp_path, [], receiver)
    assert [change["sentence"] for change in receiver.changes()] == ["other words"]


def test_a_receiver_is_sent_what_comes_while_the_config_names_it(tmp_path: Path) -> None:
    first, second = Fake(), Fake("webhook")
    run(tmp_path, [row("M1")])
    assert backlogs(tmp_path, []) == ()
    run(tmp_path, [], first)
    run(tmp_path, [row("M1"), row("M2")], first, second)
    assert first.motors() == second.motors() == ["M2"]
    (backlog,) = backlogs(tmp_path, [second])
    assert dt.datetime.now(dt.UTC) - backlog.notified_since < dt.timedelta(minutes=10)
    run(tmp_path, [row("M3")], deaf())
    run(tmp_path, [])
    again = Fake()
    run(tmp_path, [row("M3"), row("M4")], again)
    assert again.motors() == ["M4"]


def test_a_row_that_is_made_anew_is_not_sent_again(tmp_path: Path) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1")], receiver)
    # Another run's row; figures of another kind of machine; the table lost and made anew.
    run(tmp_path, [row("M1", run_id="s", leakage_change_percent=27.0 + 1e-12)], receiver)
    night_file(tmp_path, ALARMS, FIRST).unlink()
    run(tmp_path, [], receiver)
    run(tmp_path, [row("M1")], receiver)
    assert len(receiver.taken) == 1


@pytest.mark.parametrize("column", ALARM_CONTENT)
def test_a_row_that_says_something_else_is_sent_as_changed(tmp_path: Path, column: str) -> None:
    """And one that says again what it said before: that is no repeat."""
    receiver = Fake()
    run(tmp_path, [row("M1")], receiver)
    run(tmp_path, [row("M1", **{column: "warning"}), row("M2")], receiver)
    run(tmp_path, [row("M1")], receiver)
    before, changed, new, again = receiver.changes()
    kinds = [change["change"] for change in (before, changed, new, again)]
    assert kinds == ["new", "changed", "new", "changed"]
    assert changed[column] == "warning"
    # The first part of the id is the row, the others what it says.
    ids = [change["change_id"].split("-") for change in (before, changed, again)]
    assert len({parts[0] for parts in ids}) == 1
    assert ids[0][1] == ids[2][1] != ids[1][1]
    assert len({tuple(parts) for parts in ids}) == len(
        {message["id"] for message in receiver.taken}
    )


def test_a_delivery_has_no_more_rows_than_a_receiver_can_hold(tmp_path: Path) -> None:
    receiver = Fake()
    run(tmp_path, [], receiver)
    run(tmp_path, [row(f"M{n}") for n in range(MOST_CHANGES + 1)], receiver)
    assert [len(document["changes"]) for document in receiver.taken] == [MOST_CHANGES, 1]


@pytest.mark.parametrize(("hangs", "tries"), [(False, len(PAUSES_S) + MOST_FAILURES), (True, 1)])
def test_a_dead_receiver_costs_a_run_a_few_tries(tmp_path: Path, hangs: bool, tries: int) -> None:
    receiver = deaf(hangs=hangs)
    for number in range(4):
        receiver.tried.clear()
        run(tmp_path, [row("M1", FIRST + dt.timedelta(number))], receiver)
    assert len(receiver.tried) == tries
    receiver.refuses = lambda _: False
    run(tmp_path, [], receiver)
    assert len(receiver.changes()) == 4


def test_a_delivery_that_is_never_taken_does_not_hold_up_the_others(tmp_path: Path) -> None:
    receiver = Fake(refuses=lambda message: b'"M0"' in message.content)
    for number in range(4):
        run(tmp_path, [row(f"M{number}", FIRST + dt.timedelta(number))], receiver)
        assert receiver.motors() == [f"M{n}" for n in range(1, number + 1)]
    assert [backlog.undelivered for backlog in backlogs(tmp_path, [receiver])] == [1]


def test_what_was_taken_is_known_at_once(tmp_path: Path) -> None:
    """A run that ends between two deliveries repeats neither the first nor its rows."""
    receiver = deaf()
    run(tmp_path, [row("M1")], receiver)
    receiver.tried.clear()

    def stop(_: Delivery) -> bool:
        if len(receiver.tried) == 2:
            raise KeyboardInterrupt
        return False

    receiver.refuses = stop
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, [row("M1", FIRST + dt.timedelta(1))], receiver)
    receiver.refuses = lambda _: False
    run(tmp_path, [], receiver)
    assert [change["night"] for change in receiver.changes()] == ["2026-02-18", "2026-02-17"]


def test_what_a_killed_run_published_is_sent_and_a_damaged_table_waits(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    receiver, later = Fake(), FIRST + dt.timedelta(20)
    run(tmp_path, [], receiver)
    publish(tmp_path, row("M1"), row("M2", later))  # and there the run was killed
    whole = night_file(tmp_path, ALARMS, FIRST).read_bytes()
    night_file(tmp_path, ALARMS, FIRST).write_bytes(whole[:-4])
    run(tmp_path, [], receiver)
    assert receiver.motors() == ["M2"]
    assert "2026-02.parquet of alarms is damaged" in caplog.text
    night_file(tmp_path, ALARMS, FIRST).write_bytes(whole)
    run(tmp_path, [], receiver)
    assert receiver.motors() == ["M2", "M1"]


def test_a_summary_is_delivered_once_for_each_date_it_is_due_on(tmp_path: Path) -> None:
    receiver = Fake("email", refuses=lambda _: len(receiver.tried) == 1)
    with open_state(tmp_path) as state:
        open_outbox(state, ["email"])

        def summary(day: int) -> None:
            due = dt.date(2026, 11, day)
            deliver_summary(state, receiver, "Mill 3", due, lambda: [{"motor_id": "M"}])

        with pytest.raises(UndeliveredError):
            summary(16)
        for day in (16, 16, 23):
            summary(day)
    assert [document["type"] for document in receiver.taken] == ["summary"] * 2
    assert receiver.motors() == ["M", "M"]
    # The id is the same where it was not taken at first.
    assert [delivery.id for delivery in receiver.tried[:2]] == [receiver.taken[0]["id"]] * 2
    assert receiver.taken[0]["id"] != receiver.taken[1]["id"]
