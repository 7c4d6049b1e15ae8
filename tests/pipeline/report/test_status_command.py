"""The commands `status`, `ack` and `baseline reset`."""

from __future__ import annotations

import datetime as dt
import json
import shlex
from pathlib import Path

import polars as pl
import pytest

from leakage.course.monitoring import ChangeSize
from pipeline.cli.arguments import duration
from pipeline.errors import UsageError
from pipeline.report.status import fleet_status, last_alarm
from pipeline.schema import ALARMS, FITS, RUNS, TRENDS, frame
from pipeline.store.encoding import write_table
from pipeline.store.publishing import Publisher
from pipeline.store.tables import night_file
from pipeline.trends.nights.decisions import read_decisions
from pipeline.trends.rows.motor_states import CHANGED, TOLD
from pipeline.trends.states.words import size_words
from tests.pipeline.calling import Call, refused
from tests.pipeline.report.states import LAST, NAMES, output, trend
from tests.pipeline.trends.nights import night_of

__all__ = ["output"]

OPENED = "ack {} M1 --note x --opened"


def ran(output: Path, hours_ago: float, status: str = "ok") -> None:
    ended = dt.datetime.now(dt.UTC) - dt.timedelta(hours=hours_ago)
    row = {"run_id": f"r{hours_ago}", "started_at": ended, "finished_at": ended, "status": status}
    Publisher(output, output / "staging", "r").of_run(ended, {RUNS: [row]})


@pytest.fixture
def config(output: Path) -> Path:
    return output.parent / "configs" / "fleet.toml"


def test_the_command_prints_motors_and_the_last_good_run(
    output: Path, config: Path, call: Call
) -> None:
    ran(output, 3.0)
    code, out, err = call("status", config)
    assert code == 0
    columns, first = out.splitlines()
    assert columns.split("\t")[:3] == ["motor", "state", "since"]
    assert first.split("\t") == [
        *("M1", "alarm", str(night_of(2)), "unknown", "1.4", "+0.0 %"),
        *("2026-01-07", "ok", "K_piston_ring is alarm"),
    ]
    assert err.startswith("last good run: 20")


def test_the_command_says_since_when_a_leakage_is_not_known_and_that_a_fit_is_poor(
    output: Path, config: Path, call: Call
) -> None:
    for night in range(LAST + 1):
        rows = [trend("M1", night, "reference_leakage", "stale" if night == LAST else "ok")]
        rows[0]["value"] = 1.4 if night == 0 else None
        fit = {"motor_id": "M1", "night": night_of(night), "status": "ok", "is_primary": True}
        fit |= {"run_id": "r", "training_fit_percent": 99.0, "validation_fit_percent": -1295.0}
        write_table(night_file(output, TRENDS, night_of(night)), frame(TRENDS, rows))
        write_table(night_file(output, FITS, night_of(night)), frame(FITS, [fit]))
    cells = call("status", config)[1].splitlines()[1].split("\t")
    assert cells[4:6] == ["not known since 2026-01-02", "not known"]
    assert cells[-1] == (
        "reference_leakage is stale; fit of 2026-01-07: validation -1295.0 % (poor: worse than a "
        "constant flow)"
    )


def test_max_age_counts_good_runs_alone(output: Path, config: Path, call: Call) -> None:
    def is_old(max_age: str) -> bool:
        code, _, err = call("status", config, "--max-age", max_age)
        assert ("which is too old" in err) == bool(code)
        return bool(code)

    assert is_old("26h")
    assert "last good run: never" in call("status", config)[2]
    ran(output, 1.0, "interrupted")
    assert is_old("26h")
    ran(output, 30.0)
    assert (is_old("26h"), is_old("2d")) == (True, False)
    # A failed motor does not make a run a bad one: the others are done.
    ran(output, 3.0, "motors_failed")
    assert (is_old("90m"), is_old("26h")) == (True, False)


def test_json_has_a_line_a_motor_and_one_for_the_fleet(
    output: Path, config: Path, call: Call
) -> None:
    ran(output, 30.0)
    code, out, _ = call("status", config, "--json", "--max-age", "26h")
    assert code == 1
    motor, fleet = map(json.loads, out.splitlines())
    assert (motor["event"], motor["motor_id"], motor["state"]) == ("motor", "M1", "alarm")
    assert (fleet["event"], fleet["too_old"], fleet["findings"]) == ("fleet", True, 0)


def test_acknowledged_found_and_counted(output: Path, config: Path, call: Call) -> None:
    code, out, _ = call("ack", config, "M1", "Piston ring", "--note", "rings ordered")
    assert (code, out) == (0, "M1: K_piston_ring, raised last on 2026-01-06: acknowledged\n")
    assert "(acknowledged: rings ordered)" in call("status", config)[1]
    assert "inspections" not in call("status", config)[2]
    finding = ("ack", config, "M1", "K_piston_ring", "--note", "worn", "--finding", "confirmed")
    assert call(*finding)[0] == 0
    _, out, err = call("status", config)
    assert "(acknowledged: worn)" in out
    assert "inspections that confirmed an alarm: 1 of 1 (100 %)" in err
    assert fleet_status(output, ["M1"]).findings_confirmed == 1
    (first, second) = read_decisions(output)
    assert (first.kind, second.kind, second.finding) == ("acknowledged", "finding", "confirmed")
    assert second.night == night_of(4)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("ack {} M9 K_piston_ring --note x", "no motor M9; there are M1"),
        ("ack {} M1 C_f --note x", "M1 has had no alarm of 'C_f'; alarms so far: K_piston_ring"),
        ("ack {} M1 K_piston_ring --note x --finding yes", "expected confirmed or not_"),
        ("ack {} M1 K_piston_ring --note ' '", "expected some words"),
        ("ack {} M1 K_piston_ring", "--note"),
        ("ack {} M1 --note x", "expected the indicator of an alarm, or --opened with --worn"),
        (f"{OPENED} 2026-01-06", "expected --opened with --worn or --sound"),
        (f"{OPENED} '' --worn cam_roller", "expected --opened with --worn or --sound"),
        (f"{OPENED} 9998-01-06 --worn cam_roller", "which has not come"),
        (f"{OPENED} '6 May' --worn cam_roller", "expected YYYY-MM-DD"),
        (f"{OPENED} 2026-01-06 --worn valve", "M1 has no part 'valve'; it has balance_p"),
        (
            f"{OPENED} 2026-01-06 --worn cam_roller --sound 'cam roller'",
            "cam_roller: expected worn or sound, not both",
        ),
        ("baseline reset {} M1 '5 May' --note x", "NIGHT: got '5 May'; expected YYYY-MM-DD"),
        ("baseline reset {} M1 2199-01-01 --note x", "which has not come"),
        ("baseline reset {} M9 2026-01-05 --note x", "no motor M9"),
        (
            "baseline reset {} M1 2026-01-05 --indicator K_ring --note x",
            "M1 has no 'K_ring'; it has K_piston_ring, reference_leakage",
        ),
    ],
)
def test_what_would_do_nothing_is_refused(
    output: Path, config: Path, call: Call, line: str, words: str
) -> None:
    code, out, err = call(*shlex.split(line.format(config)))
    assert (code, out) == (2, "")
    assert words in err
    assert read_decisions(output) == ()


def test_parts_of_an_opened_motor_are_recorded_and_scored(
    output: Path, config: Path, call: Call
) -> None:
    """Its alarm names no part, so that the worn one could not be told."""
    parts = "--worn 'Piston ring' --sound balance_sleeve --sound balance_piston"
    code, out, _ = call(*shlex.split(f"{OPENED} 2026-01-07 {parts}".format(config)))
    assert (code, out) == (
        0,
        "M1: opened on 2026-01-07; worn: piston_ring; sound: balance_sleeve, balance_piston\n",
    )
    (found,) = read_decisions(output)
    assert (found.kind, found.indicator, found.night) == ("finding", "", dt.date(2026, 1, 7))
    assert found.worn_parts == ("piston_ring",)
    assert found.sound_parts == ("balance_sleeve", "balance_piston")
    line = "parts named by alarms, after inspections: 0 right, 0 wrong, 1 cannot be told, 0 missed"
    assert line in call("status", config)[2]
    fleet = json.loads(call("status", config, "--json")[1].splitlines()[-1])
    assert fleet["parts"]["CB560"]["cannot_be_told"] == 1


def test_a_baseline_is_reset_with_a_night_and_a_reason(
    output: Path, config: Path, call: Call
) -> None:
    code, out, _ = call("baseline", "reset", config, "M1", "2026-01-05", "--note", "new rings")
    assert (code, out) == (0, "M1: every baseline starts with the night 2026-01-05\n")
    (found,) = read_decisions(output)
    told = (found.kind, found.night, found.indicator, found.note)
    assert told == ("baseline_reset", dt.date(2026, 1, 5), "", "new rings")


def test_an_alarm_is_known_by_each_of_its_names(output: Path) -> None:
    names = ("piston ring leakage", "piston ring gap", "Piston ring", " the piston ring leakage")
    for name in (*names, "k_piston_ring"):
        assert last_alarm(output, "M1", name, CHANGED) == ("K_piston_ring", night_of(4)), name


def test_whatever_can_be_raised_is_known_by_the_words_of_status(output: Path) -> None:
    row = pl.read_parquet(night_file(output, ALARMS, night_of(4))).to_dicts()[0]
    names = [*NAMES, "K_balance_sleeve", "own_reference_leakage", "baseline_deviation", "C_f"]
    names += ["peer_deviation", "pressure_zero", "flow_zero"]
    rows = frame(ALARMS, [row | {"indicator": name} for name in names])
    write_table(night_file(output, ALARMS, night_of(4)), rows)
    for name in names:
        size = ChangeSize(9, 0.3, 0.2, 0.4, 10)
        for words in (name, size_words(name, size, "2026-10-03").partition(" +")[0]):
            assert last_alarm(output, "M1", words, CHANGED) == (name, night_of(4))


def test_a_silent_motor_is_acknowledged_and_not_inspected(output: Path) -> None:
    row = pl.read_parquet(night_file(output, ALARMS, night_of(4))).to_dicts()[0]
    stale = row | {"night": night_of(5), "to_state": "stale"}
    write_table(night_file(output, ALARMS, night_of(5)), frame(ALARMS, [stale]))
    assert last_alarm(output, "M1", "K_piston_ring", TOLD) == ("K_piston_ring", night_of(5))
    assert last_alarm(output, "M1", "K_piston_ring", CHANGED) == ("K_piston_ring", night_of(4))
    with pytest.raises(UsageError, match="alarms so far: none"):
        last_alarm(output, "M2", "K_piston_ring", TOLD)


@pytest.mark.parametrize("text", ["", "h", "26", "-1h", "0h", "infh", "nanh", "1y", "26 h ours"])
def test_a_duration_that_is_none(text: str) -> None:
    with refused("age"):
        duration(text, "--max-age")
