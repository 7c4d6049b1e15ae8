"""Rows of `alarms` reach every receiver at least once, with ids that tell repeats."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

import pytest

from pipeline.schema import ALARMS
from pipeline.store.state import open_state
from pipeline.store.tables import night_file
from pipeline.telling import outbox as module
from pipeline.telling.delivering import MOST_FAILURES, PAUSES_S, deliver
from pipeline.telling.delivery import Delivery
from pipeline.telling.outbox import (
    MOST_CHANGES,
    add_summary,
    backlogs,
    open_outbox,
    take_up,
    waiting,
)
from tests.pipeline.telling.made_alarms import FIRST, FLEET, Fake, publish, row, run, undelivered


def test_every_receiver_gets_the_rows_of_a_run_once(tmp_path: Path) -> None:
    first, second = Fake(), Fake("webhook", "alarms.webhook_url")
    assert run(tmp_path, [row("M1"), row("M2")], first, second) == ()
    assert run(tmp_path, [], first, second) == ()
    (document,) = first.taken
    assert (document["fleet"], document["type"]) == (FLEET, "alarms")
    expected = row("M1") | {"night": "2026-02-17", "time": "2026-02-17 06:00:00+00:00"}
    found = document["changes"][0]
    assert expected | {"change": "new", "id": found["id"]} == found
    assert [one["motor_id"] for one in document["changes"]] == ["M1", "M2"]
    assert second.taken[0]["changes"] == document["changes"]
    # Each delivery is one receiver's.
    assert second.taken[0]["id"] != document["id"]
    assert (len(first.taken), len(second.taken)) == (1, 1)


def test_a_change_of_rules_is_one_delivery_of_what_stands(tmp_path: Path) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1"), row("M2", state="warning")], receiver)
    by_rules = {"rules": "trends 5 to 6", "state_before_rules": "ok"}
    silent = [row(f"P{n}", **by_rules, is_silent=True) for n in range(40)]
    words = row("M1", reason="other words", **by_rules, is_silent=True)
    stands = row("M2", **by_rules, is_silent=False)
    tonight = row("M1", FIRST + dt.timedelta(1), "ok")
    run(tmp_path, [*silent, words, stands, tonight], receiver)
    found = [
        [(one["motor_id"], one["change"]) for one in document["changes"]]
        for document in receiver.taken[1:]
    ]
    assert found == [[("M2", "rules")], [("M1", "new")]]
    run(tmp_path, [*silent, words, stands], receiver)
    assert len(receiver.taken) == 3


def test_a_new_receiver_is_told_of_what_comes_and_the_run_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = Fake(), Fake("webhook")
    assert run(tmp_path, [row("M1")]) == ()
    assert backlogs(tmp_path, []) == ()
    run(tmp_path, [], first)
    assert "the command is told from now on; the 1 rows of `alarms` so far are not sent" in (
        caplog.text
    )
    run(tmp_path, [row("M1"), row("M2")], first, second)
    assert first.motors() == second.motors() == ["M2"]
    (backlog,) = backlogs(tmp_path, [second])
    assert dt.datetime.now(dt.UTC) - backlog.told_since < dt.timedelta(minutes=10)


def test_one_that_is_named_no_more_begins_anew(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    deaf = Fake(refuses=lambda _: True)
    run(tmp_path, [row("M1")], deaf)
    run(tmp_path, [row("M1"), row("M2")])
    assert "there is no command any more; not delivered: 1 change" in caplog.text
    again = Fake()
    run(tmp_path, [row("M1"), row("M2"), row("M3")], again)
    assert again.motors() == ["M3"]


def test_rows_that_a_run_published_and_did_not_take_up_are_told_by_the_next(
    tmp_path: Path,
) -> None:
    receiver = Fake()
    with open_state(tmp_path) as state:
        open_outbox(state, ["command"], FLEET)
    publish(tmp_path, row("M1"))  # and there the run was killed
    run(tmp_path, [row("M1"), row("M2")], receiver)
    assert receiver.motors() == ["M1", "M2"]
    assert undelivered(tmp_path, receiver) == [0]


def test_a_row_that_is_made_anew_is_not_told_again(tmp_path: Path) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1")], receiver)
    # Another run's row; figures of another kind of machine; the table lost and made anew.
    run(tmp_path, [row("M1", run_id="s", deviation_percent=27.0 + 1e-12)], receiver)
    night_file(tmp_path, ALARMS, FIRST).unlink()
    run(tmp_path, [], receiver)
    run(tmp_path, [row("M1")], receiver)
    assert len(receiver.taken) == 1


@pytest.mark.parametrize(
    "said",
    [
        {"to_state": "warning"},
        {"from_state": "insufficient"},
        {"way": "recomputed"},
        {"path": "piston_ring"},
        {"reason": "piston ring gap +31 % [29, 33]"},
    ],
)
def test_a_row_that_says_something_else_is_told_as_changed(
    tmp_path: Path, said: dict[str, Any]
) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1")], receiver)
    run(tmp_path, [row("M1", **said), row("M2")], receiver)
    before, changed, new = receiver.changes()
    assert [one["change"] for one in (before, changed, new)] == ["new", "changed", "new"]
    # The first part of the id is the row, the others what it says.
    assert changed["id"].split("-")[0] == before["id"].split("-")[0]
    assert changed["id"].split("-")[1] != before["id"].split("-")[1]
    assert changed | said == changed


def test_a_row_that_says_again_what_it_said_before_is_no_repeat(tmp_path: Path) -> None:
    receiver = Fake()
    for state in ("alarm", "warning", "alarm", "alarm"):
        run(tmp_path, [row("M1", state=state)], receiver)
    assert [one["to_state"] for one in receiver.changes()] == ["alarm", "warning", "alarm"]
    assert len({one["id"] for one in receiver.changes()}) == 3
    assert len({document["id"] for document in receiver.taken}) == 3
    # A delivery has no more rows than a receiver can hold.
    run(tmp_path, [row(f"M{n}") for n in range(2, MOST_CHANGES + 3)], receiver)
    assert [len(document["changes"]) for document in receiver.taken[3:]] == [MOST_CHANGES, 1]
    assert len({one["id"] for one in receiver.changes()}) == MOST_CHANGES + 4


def test_ids_hang_on_fleet_receiver_and_rows_alone(tmp_path: Path) -> None:
    def ids(folder: str, fleet: str, name: str, *motors: str) -> tuple[str, list[str]]:
        receiver = Fake(name)
        run(tmp_path / folder, map(row, motors), receiver, fleet=fleet)
        return receiver.taken[0]["id"], [one["id"] for one in receiver.changes()]

    first = ids("a", FLEET, "command", "M1")
    assert ids("b", FLEET, "command", "M1") == first
    assert ids("c", "Other", "command", "M1")[0] != first[0]
    assert ids("d", FLEET, "webhook", "M1")[0] != first[0]
    assert ids("e", FLEET, "command", "M1", "M2")[0] != first[0]


def test_what_was_not_taken_is_tried_again_by_the_next_run(tmp_path: Path) -> None:
    receiver = Fake(refuses=lambda _: True)
    (fault,) = run(tmp_path, [row("M1")], receiver)
    assert fault == "alarms.command: out of ink; for the next run: 1 change"
    (backlog,) = backlogs(tmp_path, [receiver])
    assert (backlog.undelivered, backlog.fault) == (1, "out of ink")
    assert dt.datetime.now(dt.UTC) - backlog.since < dt.timedelta(minutes=10)
    receiver.refuses = lambda _: False
    assert run(tmp_path, [], receiver) == ()
    assert undelivered(tmp_path, receiver) == [0]
    # Bytes and id are the same each time.
    assert len(set(receiver.tried)) == 1
    assert backlogs(tmp_path, [receiver])[0].fault is None


def test_a_run_tries_three_times_and_the_next_once(tmp_path: Path) -> None:
    receiver = Fake(refuses=lambda _: True)
    waits: list[float] = []
    with open_state(tmp_path) as state:
        open_outbox(state, ["command"], FLEET)
        publish(tmp_path, row("M1"))
        take_up(state, FLEET)
        deliver(state, [receiver], FLEET, waits.append)
        assert (len(receiver.tried), waits) == (3, list(PAUSES_S))
        assert waits == sorted(waits)
        deliver(state, [receiver], FLEET, waits.append)
    assert (len(receiver.tried), len(waits)) == (4, 2)


def test_one_that_hangs_costs_a_run_one_try(tmp_path: Path) -> None:
    receiver = Fake(refuses=lambda _: True, hangs=True)
    for motor in ("M1", "M2", "M3"):
        run(tmp_path, [row(motor)], receiver)
    assert len(receiver.tried) == 3
    # Not always the same: it may be that delivery that it hangs of.
    assert len({one.id for one in receiver.tried}) > 1


def test_a_delivery_that_is_never_taken_does_not_hold_up_the_others(tmp_path: Path) -> None:
    receiver = Fake(refuses=lambda one: b'"M0"' in one.content or b'"M1"' in one.content)
    for number in range(4):
        run(tmp_path, [row(f"M{number}", FIRST + dt.timedelta(number))], receiver)
    assert receiver.motors() == ["M2", "M3"]
    assert undelivered(tmp_path, receiver) == [2]


def test_a_dead_receiver_costs_a_run_a_few_tries(tmp_path: Path) -> None:
    receiver = Fake(refuses=lambda _: True)
    for number in range(9):
        run(tmp_path, [row("M1", FIRST + dt.timedelta(number))], receiver)
    receiver.tried.clear()
    run(tmp_path, [], receiver)
    assert len(receiver.tried) == MOST_FAILURES
    receiver.refuses = lambda _: False
    run(tmp_path, [], receiver)
    assert len(receiver.changes()) == 9


def test_one_that_fails_does_not_keep_the_other(tmp_path: Path) -> None:
    deaf, other = Fake(refuses=lambda _: True), Fake("webhook")
    assert len(run(tmp_path, [row("M1")], deaf, other)) == 1
    assert len(other.taken) == 1
    assert undelivered(tmp_path, deaf, other) == [1, 0]


def test_what_was_taken_is_known_at_once(tmp_path: Path) -> None:
    """A run that ends between two deliveries repeats neither the first nor its rows."""
    receiver = Fake()
    with open_state(tmp_path) as state:
        open_outbox(state, ["command"], FLEET)
        for number in range(2):
            publish(tmp_path, row("M1", FIRST + dt.timedelta(number)))
            take_up(state, FLEET)

    def stop(delivery: Delivery) -> bool:
        if len(receiver.tried) == 2:
            raise KeyboardInterrupt
        return False

    receiver.refuses = stop
    with pytest.raises(KeyboardInterrupt), open_state(tmp_path) as state:
        deliver(state, [receiver], FLEET)
    receiver.refuses = lambda _: False
    with open_state(tmp_path) as state:
        deliver(state, [receiver], FLEET)
    assert [one["night"] for one in receiver.changes()] == ["2026-02-17", "2026-02-18"]


def test_of_what_was_taken_only_the_keys_stay(tmp_path: Path) -> None:
    for number in range(3):
        run(tmp_path, [row("M1", FIRST + dt.timedelta(number))], Fake())
    with open_state(tmp_path) as state:
        assert waiting(state, "command") == []
        assert state.rows("SELECT count(*) FROM outbox") == [(0,)]
        assert state.rows("SELECT count(*) FROM queued") == [(3,)]


def test_a_damaged_table_waits_and_keeps_nothing_else(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    receiver, later = Fake(), FIRST + dt.timedelta(20)
    run(tmp_path, [], receiver)
    publish(tmp_path, row("M1"), row("M2", later))
    whole = night_file(tmp_path, ALARMS, FIRST).read_bytes()
    night_file(tmp_path, ALARMS, FIRST).write_bytes(whole[:-4])
    run(tmp_path, [], receiver)
    assert receiver.motors() == ["M2"]
    assert "2026-02.parquet of alarms is damaged" in caplog.text
    night_file(tmp_path, ALARMS, FIRST).write_bytes(whole)
    run(tmp_path, [], receiver)
    assert receiver.motors() == ["M2", "M1"]


def test_only_months_that_were_written_to_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1"), row("M2", dt.date(2026, 3, 1))], receiver)
    read: list[str] = []
    real = module.read_table

    def counted(path: Path, *asked: Any) -> Any:
        read.append(path.stem)
        return real(path, *asked)

    monkeypatch.setattr(module, "read_table", counted)
    run(tmp_path, [], receiver)
    assert read == []
    run(tmp_path, [row("M3", dt.date(2026, 3, 2))], receiver)
    assert set(read) == {"2026-03"}


def test_what_is_not_finite_is_null(tmp_path: Path) -> None:
    receiver = Fake()
    run(tmp_path, [row("M1", deviation_percent=float("nan"))], receiver)
    assert receiver.changes()[0]["deviation_percent"] is None


def test_a_summary_waits_once_for_each_date_it_is_due_on(tmp_path: Path) -> None:
    made: list[int] = []

    def rows() -> list[dict[str, Any]]:
        made.append(1)
        return [{"motor_id": "M", "state": "ok"}]

    with open_state(tmp_path) as state:
        open_outbox(state, ["email"], "Mill 3")
        for due in (dt.date(2026, 11, 16), dt.date(2026, 11, 16), dt.date(2026, 11, 23)):
            add_summary(state, "email", "Mill 3", due, rows)
            add_summary(state, "stranger", "Mill 3", due, rows)
        found = waiting(state, "email")
    assert [one.kind for one in found] == ["summary", "summary"]
    assert len({one.id for one in found}) == len(made) == 2
