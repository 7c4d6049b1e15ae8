"""The fleet's state: what needs attention first, what was said of it, and how old it is."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from leakage.monitoring import ChangeSize
from pipeline.errors import UsageError
from pipeline.report.status import (
    RAISED,
    age_in_hours,
    fleet_status,
    last_alarm,
    last_findings,
)
from pipeline.report.words import STATES
from pipeline.schema import ALARMS, FITS, RUNS, TRENDS, frame
from pipeline.store.publishing import Publisher
from pipeline.store.tables import night_file, write_table
from pipeline.trends.decisions import Decision, read_decisions
from pipeline.trends.motor_states import ORDER, TOLD, LookStanding, MotorState, motor_state, urgency
from pipeline.trends.trend_rows import trend_rows
from pipeline.trends.words import FALL, size_words
from tests.pipeline.cli.test_cli import Call
from tests.pipeline.cli.test_cli import call as call  # a fixture
from tests.pipeline.trends.nights import Nights, configure, motor, night_of, standing, step

LAST = 5
NAMES = ("reference_leakage", "K_piston_ring")
OPENED = ["M1", "--note", "x", "--opened"]


def trend(motor: str, night: int, name: str, state: str = "ok", **more: Any) -> dict[str, Any]:
    return {
        "run_id": "r",
        "motor_id": motor,
        "night": night_of(night),
        "indicator": name,
        "value": 1.4,
        "state": state,
        "state_reason": None if state == "ok" else f"{name} is {state}",
        "deviation_percent": 0.0,
        "n_slope": 30,
        "sensor_health": "ok",
        **more,
    }


def rows_of(motor: str, **states: list[str]) -> pl.DataFrame:
    """Trends of some nights: a state for each night and indicator."""
    return frame(
        TRENDS,
        [
            trend(motor, night, name, state)
            for name in NAMES
            for night, state in enumerate(states.get(name, ["ok"] * (LAST + 1)))
        ],
    )


def fits_of(motor: str, nights: int = LAST + 1) -> pl.DataFrame:
    return frame(
        FITS,
        [
            {
                "run_id": "r",
                "motor_id": motor,
                "motor_type": "CB560",
                "night": night_of(night),
                "status": "ok",
            }
            for night in range(nights)
        ],
    )


def said(night: int, kind: str = "acknowledged", **more: Any) -> Decision:
    when = dt.datetime(2026, 2, 1, night, tzinfo=dt.UTC)
    return Decision("M1", "K_piston_ring", when, kind, night_of(night), **more)  # type: ignore[arg-type]


WORN = ["ok", "ok", "warning", "warning", "alarm", "alarm"]


def test_a_motor_is_as_its_worst_indicator_tonight() -> None:
    found = motor_state("M1", rows_of("M1", K_piston_ring=WORN), fits_of("M1"), ())
    assert (found.state, found.indicator) == ("alarm", "K_piston_ring")
    assert found.reason == "K_piston_ring is alarm"
    assert found.leakage_l_per_min == 1.4
    assert found.last_good_night == night_of(LAST)


def test_the_headline_names_every_part_in_alarm() -> None:
    worn = {"balance_piston": step(110, 80, 0.6), "balance_sleeve": step(110, 80, 0.7)}
    rows = [
        one | {"run_id": "r"} for one in trend_rows(standing(Nights(motor(), 110, worn)), [109])
    ]
    found = motor_state("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert (found.state, found.indicator) == ("alarm", "K_balance_sleeve")
    assert found.reason is not None
    assert found.reason.startswith("balance sleeve gap +")
    assert "; balance piston gap +" in found.reason
    assert found.change_start == night_of(80)


def test_a_motor_without_a_baseline_says_how_far_it_has_come_and_what_it_drains() -> None:
    rows = [one | {"run_id": "r"} for one in trend_rows(standing(Nights(motor(), 5)), [4])]
    others = [one for one in rows if one["indicator"] != "reference_leakage"]
    found = motor_state("M1", frame(TRENDS, others), fits_of("M1"), ())
    assert (found.state, found.leakage_indicator) == ("insufficient", "comparable_drain_flow")
    assert found.reason == "5 of 15 good nights for a baseline (first nights)"
    # A healthy motor drains what its configured gaps leak (CB560, model.md, section 3).
    assert found.leakage_l_per_min == pytest.approx(1.371423, rel=1e-6)


def of_leakage(name: str, values: list[float | None], **tonight: Any) -> list[dict[str, Any]]:
    rows = [trend("M1", night, name, value=value) for night, value in enumerate(values)]
    rows[-1] |= tonight
    return rows


UNKNOWN = [1.4, 1.4, None, None, None, None]


@pytest.mark.parametrize(
    ("tonight", "ring", "known"),
    [
        ({}, {}, True),
        ({"state": "stale"}, {}, False),
        ({"state": "insufficient"}, {}, False),
        ({}, {"state": "alarm", "change_start": night_of(1)}, True),
        ({}, {"state": "alarm", "change_start": night_of(2)}, False),
    ],
    ids=["held", "stale", "no baseline", "since the change", "before the change"],
)
def test_a_leakage_that_says_nothing_of_now_is_not_told_as_current(
    tonight: dict[str, Any], ring: dict[str, Any], known: bool
) -> None:
    rows = of_leakage("reference_leakage", UNKNOWN, **tonight)
    rows += of_leakage("K_piston_ring", [1.0] * 6, **ring)
    found = motor_state("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert found.leakage_night == night_of(1)
    expected = (1.4, 0.0) if known else (None, None)
    assert (found.leakage_l_per_min, found.deviation_percent) == expected


def test_the_leakage_at_the_motors_own_conditions_stands_in_where_it_alone_is_known() -> None:
    rows = of_leakage("reference_leakage", UNKNOWN, state="stale")
    rows += of_leakage("own_reference_leakage", [2.0] * 6)
    found = motor_state("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert (found.leakage_l_per_min, found.leakage_night) == (2.0, night_of(LAST))


def test_the_leakage_has_its_indicator_and_interval() -> None:
    rows = of_leakage("reference_leakage", [1.3, 1.4], lower=1.35, upper=1.45)
    found = motor_state("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert found.leakage_indicator == "reference_leakage"
    assert (found.leakage_lower, found.leakage_upper) == (1.35, 1.45)


@pytest.mark.parametrize(
    ("began", "expected"),
    [(None, ("piston_ring", -9.0)), (1, ("piston_ring", -9.0)), (2, ("sleeve", 4.0))],
)
def test_the_gap_that_changed_most_is_one_known_since_the_change(
    began: int | None, expected: tuple[str, float]
) -> None:
    """As the newest rows of `trends` have it; the ring's is of the second night."""
    rows = of_leakage("gap_change_piston_ring", [2.0, -9.0, None, None], n_slope=None)
    rows += of_leakage("gap_change_sleeve", [8.0, 4.0, 4.0, 4.0], n_slope=None)
    change = {} if began is None else {"state": "alarm", "change_start": night_of(began)}
    rows += of_leakage("K_piston_ring", [1.0] * 4, **change)
    found = motor_state("M1", frame(TRENDS, rows), fits_of("M1"), ())
    assert (found.gap_path, found.gap_change_percent) == expected


def test_a_last_night_that_failed_is_told_and_comes_before_motors_in_order() -> None:
    failed = {"run_id": "r", "motor_id": "M1", "night": night_of(6), "status": "failed"}
    fits = pl.concat([fits_of("M1"), frame(FITS, [failed | {"reason": "the log is cut"}])])
    found = motor_state("M1", rows_of("M1"), fits, ())
    assert (found.state, found.failure) == ("ok", "night of 2026-01-08 failed: the log is cut")
    assert found.why == f"no change of external leakage; {found.failure}"
    fine = motor_state("M0", rows_of("M0"), fits_of("M0"), ())
    assert fine.failure == ""
    assert urgency(found) < urgency(fine)


def test_a_poor_fit_of_the_last_good_night_is_told() -> None:
    def said(*fits: dict[str, Any]) -> str:
        rows = [
            {"run_id": "r", "motor_id": "M1", "night": night_of(night), "is_primary": True} | fit
            for night, fit in enumerate(fits)
        ]
        return motor_state("M1", rows_of("M1"), frame(FITS, rows), ()).poor_fit

    good = {"status": "ok", "training_fit_percent": 99.0, "validation_fit_percent": 0.0}
    poor = good | {"validation_fit_percent": -1295.0}
    assert said(poor, good) == ""
    assert said(good | {"validation_fit_percent": None}) == ""
    assert said(good, poor, {"status": "failed"}) == (
        "fit of 2026-01-03: validation -1295.0 % (poor: worse than a constant flow)"
    )


def test_an_alarm_of_the_past_is_past() -> None:
    over = [*WORN[:5], "ok"]
    found = motor_state("M1", rows_of("M1", K_piston_ring=over), fits_of("M1"), ())
    assert (found.state, found.indicator, found.reason) == ("ok", None, None)


def test_a_motor_that_never_sees_the_fleets_conditions_is_judged_by_its_others() -> None:
    missing = ["insufficient"] * (LAST + 1)
    found = motor_state("M1", rows_of("M1", reference_leakage=missing), fits_of("M1"), ())
    assert found.state == "ok"
    both = rows_of("M1", reference_leakage=missing, K_piston_ring=missing)
    assert motor_state("M1", both, fits_of("M1"), ()).state == "insufficient"


def test_a_sensor_alone_makes_no_motor_ok_and_one_that_drifts_is_named() -> None:
    zero = frame(
        TRENDS,
        [
            trend("M1", LAST, "flow_zero", n_slope=None),
            trend("M1", LAST, "pressure_zero", n_slope=None),
        ],
    )
    missing = ["insufficient"] * (LAST + 1)
    rows = rows_of("M1", reference_leakage=missing, K_piston_ring=missing)
    assert motor_state("M1", pl.concat([rows, zero]), fits_of("M1"), ()).state == "insufficient"
    moved = trend(
        "M1",
        LAST,
        "flow_zero",
        "warning",
        n_slope=None,
        deviation_percent=None,
        state_reason="the zero of the flow sensor has moved",
    )
    found = motor_state("M1", pl.concat([rows_of("M1"), frame(TRENDS, [moved])]), fits_of("M1"), ())
    assert (found.state, found.indicator) == ("ok", None)
    assert found.reason == "the zero of the flow sensor has moved"


def test_a_silent_motor_is_stale() -> None:
    stale = ["ok"] * 3 + ["stale"] * 3
    rows = rows_of("M1", reference_leakage=stale, K_piston_ring=stale)
    found = motor_state("M1", rows, fits_of("M1", 3), ())
    assert found.state == "stale"
    assert found.last_good_night == night_of(2)


def test_without_trends_there_is_a_state_too() -> None:
    found = motor_state("M1", rows_of("M2").clear(), fits_of("M1", 2), ())
    assert (found.state, found.reason) == ("insufficient", "no trends yet")


def test_what_was_said_since_the_state_began_is_shown() -> None:
    rows = rows_of("M1", K_piston_ring=WORN)

    def shown(*decisions: Decision) -> str:
        return motor_state("M1", rows, fits_of("M1"), decisions).acknowledged

    assert shown() == ""
    assert shown(said(4, note="rings ordered")) == "rings ordered"
    assert shown(said(4)) == "acknowledged"
    # The warning before was another state, and a reset says nothing of the alarm.
    assert shown(said(2, note="seen")) == ""
    assert shown(said(4, "baseline_reset", note="x")) == ""
    assert (
        shown(said(4, note="seen"), said(5, "finding", finding="confirmed", note="worn")) == "worn"
    )
    other = replace(said(4, note="other"), indicator="K_balance_sleeve")
    assert shown(other) == ""


def test_of_an_alarm_that_was_inspected_twice_the_last_word_counts() -> None:
    first = said(4, "finding", finding="not_confirmed")
    second = replace(first, finding="confirmed", time=first.time + dt.timedelta(days=1))
    elsewhere = replace(first, motor_id="M2")
    assert sorted(last_findings([first, said(4), second, elsewhere])) == [
        "confirmed",
        "not_confirmed",
    ]


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """A fleet of M1, whose rings are worn, with the tables that status reads."""
    configure(tmp_path)
    output = tmp_path / "out"
    trends, fits = rows_of("M1", K_piston_ring=WORN), fits_of("M1")
    for night in range(LAST + 1):
        for table, rows in ((TRENDS, trends), (FITS, fits)):
            own = rows.filter(night=night_of(night))
            write_table(night_file(output, table, night_of(night)), own)
    for night, before, after in ((2, "ok", "warning"), (4, "warning", "alarm")):
        row = {
            "run_id": "r",
            "motor_id": "M1",
            "night": night_of(night),
            "time": dt.datetime(2026, 1, 2 + night, 6, tzinfo=dt.UTC),
            "indicator": "K_piston_ring",
            "from_state": before,
            "to_state": after,
            "reason": "it grew",
            "way": "level",
        }
        write_table(night_file(output, ALARMS, night_of(night)), frame(ALARMS, [row]))
    return output


def ran(output: Path, hours_ago: float, status: str = "ok") -> None:
    ended = dt.datetime.now(dt.UTC) - dt.timedelta(hours=hours_ago)
    row = {"run_id": f"r{hours_ago}", "started_at": ended, "finished_at": ended, "status": status}
    Publisher(output, output / "staging", "r").of_run(ended, {RUNS: [row]})


@pytest.fixture
def config(output: Path) -> Path:
    return output.parent / "configs" / "fleet.toml"


Run = Callable[..., tuple[int, str, str]]


def test_the_command_prints_motors_and_the_last_good_run(
    output: Path,
    config: Path,
    call: Call,
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


@pytest.mark.parametrize(
    ("hours_ago", "max_age", "expected"),
    [(3.0, "26h", 0), (30.0, "26h", 1), (30.0, "2d", 0), (3.0, "90m", 1)],
)
def test_max_age(
    output: Path,
    config: Path,
    call: Call,
    hours_ago: float,
    max_age: str,
    expected: int,
) -> None:
    ran(output, hours_ago)
    code, _, err = call("status", config, "--max-age", max_age)
    assert code == expected
    assert ("which is too old" in err) == bool(expected)


def test_max_age_counts_good_runs_alone(
    output: Path,
    config: Path,
    call: Call,
) -> None:
    code, _, err = call("status", config, "--max-age", "26h")
    assert code == 1
    assert "last good run: never, which is too old" in err
    ran(output, 1.0, "interrupted")
    assert call("status", config, "--max-age", "26h")[0] == 1
    # A failed motor does not make a run a bad one: the others are done.
    ran(output, 2.0, "motors_failed")
    assert call("status", config, "--max-age", "26h")[0] == 0


def test_json_has_a_line_a_motor_and_one_for_the_fleet(
    output: Path,
    config: Path,
    call: Call,
) -> None:
    ran(output, 30.0)
    code, out, _ = call("status", config, "--json", "--max-age", "26h")
    assert code == 1
    motor, fleet = map(json.loads, out.splitlines())
    assert (motor["event"], motor["motor_id"], motor["state"]) == ("motor", "M1", "alarm")
    assert (fleet["event"], fleet["too_old"], fleet["findings"]) == ("fleet", True, 0)


def test_acknowledged_found_and_counted(
    output: Path,
    config: Path,
    call: Call,
) -> None:
    code, out, _ = call("ack", config, "M1", "K_piston_ring", "--note", "rings ordered")
    assert (code, out) == (
        0,
        "M1: K_piston_ring, raised last on 2026-01-06: acknowledged\n",
    )
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
    ("arguments", "words"),
    [
        (["M9", "K_piston_ring", "--note", "x"], "no motor M9; there are M1"),
        (
            ["M1", "C_f", "--note", "x"],
            "M1 has had no alarm of 'C_f'; alarms so far: K_piston_ring",
        ),
        (["M1", "K_piston_ring", "--note", "x", "--finding", "yes"], "expected confirmed or not_"),
        (["M1", "K_piston_ring"], "--note"),
        (["M1", "--note", "x"], "expected the indicator of an alarm, or --opened with --worn"),
        ([*OPENED, "2026-01-06"], "expected --opened with --worn or --sound"),
        ([*OPENED, "", "--worn", "cam_roller"], "expected --opened with --worn or --sound"),
        ([*OPENED, "9998-01-06", "--worn", "cam_roller"], "which has not come"),
        ([*OPENED, "6 May", "--worn", "cam_roller"], "expected YYYY-MM-DD"),
        ([*OPENED, "2026-01-06", "--worn", "valve"], "M1 has no part 'valve'; it has balance_p"),
        (
            [*OPENED, "2026-01-06", "--worn", "cam_roller", "--sound", "cam roller"],
            "cam_roller: expected worn or sound, not both",
        ),
    ],
)
def test_ack_of_what_is_not_there(
    output: Path,
    config: Path,
    call: Call,
    arguments: list[str],
    words: str,
) -> None:
    code, out, err = call("ack", config, *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert read_decisions(output) == ()


def test_parts_of_an_opened_motor_are_recorded_and_scored(
    output: Path, config: Path, call: Call
) -> None:
    """Its alarm names no part, so that the worn one could not be told."""
    parts = ["--worn", "Piston ring", "--sound", "balance_sleeve", "--sound", "balance_piston"]
    code, out, _ = call("ack", config, *OPENED, "2026-01-07", *parts)
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
    output: Path,
    config: Path,
    call: Call,
) -> None:
    code, out, _ = call("baseline", "reset", config, "M1", "2026-01-05", "--note", "new rings")
    assert (code, out) == (0, "M1: every baseline starts with the night 2026-01-05\n")
    (found,) = read_decisions(output)
    assert (found.kind, found.night, found.indicator, found.note) == (
        "baseline_reset",
        dt.date(2026, 1, 5),
        "",
        "new rings",
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["M1", "5 January"], "NIGHT: got '5 January'; expected YYYY-MM-DD"),
        (["M9", "2026-01-05"], "no motor M9"),
        (
            ["M1", "2026-01-05", "--indicator", "K_ring"],
            "M1 has no 'K_ring'; it has K_piston_ring, reference_leakage",
        ),
    ],
)
def test_a_reset_that_would_do_nothing_is_refused(
    output: Path,
    config: Path,
    call: Call,
    arguments: list[str],
    words: str,
) -> None:
    code, out, err = call("baseline", "reset", config, *arguments, "--note", "x")
    assert (code, out) == (2, "")
    assert words in err
    assert read_decisions(output) == ()


@pytest.mark.parametrize(
    "name",
    [
        "K_piston_ring",
        "piston ring leakage",
        "piston ring gap",
        "Piston ring",
        " the piston ring leakage",
        "k_piston_ring",
    ],
)
def test_an_alarm_is_known_by_each_of_its_names(
    output: Path, config: Path, call: Call, name: str
) -> None:
    code, out, _ = call("ack", config, "M1", name, "--note", "seen")
    assert (code, out) == (0, "M1: K_piston_ring, raised last on 2026-01-06: acknowledged\n")
    assert [one.indicator for one in read_decisions(output)] == ["K_piston_ring"]
    assert "(acknowledged: seen)" in call("status", config)[1]


def test_whatever_can_be_raised_is_known_by_the_words_of_status(output: Path) -> None:
    row = pl.read_parquet(night_file(output, ALARMS, night_of(4))).to_dicts()[0]
    names = [*NAMES, "K_balance_sleeve", "own_reference_leakage", "baseline_deviation", "C_f"]
    names += ["peer_deviation", "pressure_zero", "flow_zero"]
    rows = frame(ALARMS, [row | {"indicator": name} for name in names])
    write_table(night_file(output, ALARMS, night_of(4)), rows)
    for name in names:
        size = ChangeSize(9, 0.3, 0.2, 0.4, 10)
        for words in (name, size_words(name, size, "2026-10-03").partition(" +")[0]):
            assert last_alarm(output, "M1", words, RAISED) == (name, night_of(4))


def test_a_silent_motor_is_acknowledged_and_not_inspected(output: Path) -> None:
    row = pl.read_parquet(night_file(output, ALARMS, night_of(4))).to_dicts()[0]
    stale = row | {"night": night_of(5), "to_state": "stale"}
    write_table(night_file(output, ALARMS, night_of(5)), frame(ALARMS, [stale]))
    assert last_alarm(output, "M1", "K_piston_ring", TOLD) == ("K_piston_ring", night_of(5))
    assert last_alarm(output, "M1", "K_piston_ring", RAISED) == ("K_piston_ring", night_of(4))
    with pytest.raises(UsageError, match="alarms so far: none"):
        last_alarm(output, "M2", "K_piston_ring", TOLD)


@pytest.mark.parametrize("text", ["", "h", "26", "-1h", "0h", "infh", "nanh", "1y", "26 h ours"])
def test_an_age_that_is_none(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        age_in_hours(text)
    assert caught.value.code == "age"


def test_dates_and_the_effect_of_temperature_stand_in_the_words_of_a_state() -> None:
    found = MotorState(
        "M",
        "warning",
        reason="piston ring gap +18 %",
        limit_dates="not before August 2027",
        temperature_effect="K falls by 0.97 % a kelvin",
    )
    assert found.why == (
        "piston ring gap +18 %; its limit not before August 2027; K falls by 0.97 % a kelvin"
    )


FALLEN = f"reference leakage is down to -6 % [-10, -1] after a rise since 3 March 2026; {FALL}"


@pytest.mark.parametrize(
    ("state", "advice"),
    [
        (MotorState("M", "alarm", path="piston_ring"), "Look at the piston ring at the next stop."),
        (
            MotorState("M", "alarm", path="balance_sleeve and balance_piston"),
            "Look at the balance sleeve and the balance piston at the next stop.",
        ),
        (MotorState("M", "warning", path="piston_ring"), "Plan a look at the piston ring."),
        (
            MotorState("M", "alarm"),
            "Look at the motor, as its part is not known, at the next stop.",
        ),
        (MotorState("M", "warning", reason=FALLEN), "Check oil, sensors and flushing first."),
        (MotorState("M", "ok"), "Nothing to do."),
        (MotorState("M", "ok", failure="night failed"), "Mend what failed in the last night."),
    ],
)
def test_each_state_says_what_to_do(state: MotorState, advice: str) -> None:
    assert state.advice == advice


def test_every_state_has_words_and_a_meaning() -> None:
    assert set(STATES) == set(ORDER)
    assert all(MotorState("M", state).advice for state in ORDER)


def test_the_parts_in_the_worst_state_and_since_when_it_is_known() -> None:
    key = {"motor_id": "M", "n_slope": 30, "deviation_percent": 50.0, "sensor_health": "ok"}
    states = {
        "K_balance_sleeve": ("warning", "ok", "warning", "alarm"),
        "K_balance_piston": ("ok", "ok", "ok", "alarm"),
        "K_piston_ring": ("ok", "ok", "ok", "warning"),
    }
    rows = [
        key | {"night": night_of(n), "indicator": name, "state": state}
        for name, course in states.items()
        for n, state in enumerate(course)
    ]
    rows[3] |= {"deviation_percent": 60.0}
    found = motor_state("M", frame(TRENDS, rows), frame(FITS, []), [])
    assert found.path == "balance_sleeve and balance_piston"
    # The warning of the first night had ended.
    assert found.known_since == night_of(2)
    assert found.needs_attention


def test_a_sudden_rise_within_the_day_comes_first_and_a_clear_look_is_not_shown() -> None:
    since = dt.datetime(2026, 3, 2, 14, 30, tzinfo=dt.UTC)
    rise = LookStanding("look_now", since, "drain flow +82 % [75, 90]", told=1)
    worn = motor_state("M1", rows_of("M1", K_piston_ring=WORN), fits_of("M1"), ())
    broken = replace(motor_state("M2", rows_of("M2"), fits_of("M2"), ()), look=rise)
    clear = LookStanding("clear", since, "x")
    quiet = replace(motor_state("M3", rows_of("M3"), fits_of("M3"), ()), look=clear)
    assert min((worn, quiet, broken), key=urgency).motor_id == "M2"
    assert "look now since 2026-03-02 14:30 UTC: drain flow +82 % [75, 90]" in broken.why
    assert "clear" not in quiet.why


def test_a_night_to_come_begins_no_baseline_and_a_note_has_words(
    output: Path, config: Path, call: Call
) -> None:
    code, _, err = call("baseline", "reset", config, "M1", "2199-01-01", "--note", "new rings")
    assert (code, "which has not come" in err) == (2, True)
    code, _, err = call("ack", config, "M1", "K_piston_ring", "--note", " ")
    assert (code, "expected some words" in err) == (2, True)
    assert read_decisions(output) == ()
