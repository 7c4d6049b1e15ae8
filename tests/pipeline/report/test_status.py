"""The fleet's state, and the commands `status`, `ack` and `baseline reset`."""

from __future__ import annotations

import datetime as dt
import shlex
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
import typer

from pipeline.cli.arguments import duration
from pipeline.errors import UsageError
from pipeline.report.status import last_alarm
from pipeline.report.words import STATES
from pipeline.schema import ALARMS, RUNS, frame
from pipeline.trends.decisions import read_decisions
from pipeline.trends.motor_states import ACTIONABLE, CHANGED, ORDER, IntradayStatus, urgency
from tests.pipeline.calling import Call
from tests.pipeline.report.states import night_of, output, state_of
from tests.pipeline.written import night_file, publisher_of, write_nights

__all__ = ["output"]

OPENED = "ack {} M1 --note x --opened"


def ran(output: Path, hours_ago: float, status: str = "ok") -> None:
    ended = dt.datetime.now(dt.UTC) - dt.timedelta(hours=hours_ago)
    row = {"run_id": f"r{hours_ago}", "started_at": ended, "finished_at": ended, "status": status}
    with publisher_of(output) as publisher:
        publisher.add(f"{ended:%Y-%m}", {RUNS: [row]})


@pytest.fixture
def config(output: Path) -> Path:
    return output.parent / "configs" / "fleet.toml"


def test_max_age_counts_good_runs_alone(output: Path, config: Path, call: Call) -> None:
    def is_old(max_age: str) -> bool:
        code, _, err = call("status", config, "--max-age", max_age)
        assert ("which is too old" in err) == bool(code)
        return bool(code)

    assert is_old("26h")
    assert "last run without a failure: never" in call("status", config)[2]
    ran(output, 1.0, "interrupted")
    assert is_old("26h")
    ran(output, 30.0)
    assert (is_old("26h"), is_old("2d")) == (True, False)
    # A failure that stands is to be seen, each day.
    ran(output, 3.0, "motors_failed")
    assert (is_old("26h"), is_old("2d")) == (True, False)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("ack {} M9 --note x", "no motor M9; there are M1"),
        ("ack {} M1 flow_zero --note x", "has had no alarm of 'flow_zero'; alarms so far: leakage"),
        ("ack {} M1 --note x --finding yes", "is not one of 'confirmed'"),
        ("ack {} M1 --note ' '", "expected some words"),
        ("ack {} M1", "--note"),
        (f"{OPENED} 2026-01-06", "expected --opened with --worn or --sound"),
        (f"{OPENED} 9998-01-06 --worn cam_roller", "which has not come"),
        (f"{OPENED} '6 May' --worn cam_roller", "expected YYYY-MM-DD"),
        (f"{OPENED} 2026-01-06 --worn valve", "M1 has no part 'valve'; it has balance_p"),
        (
            f"{OPENED} 2026-01-06 --worn cam_roller --sound 'cam roller'",
            "cam_roller: expected worn or sound, not both",
        ),
        ("baseline reset {} M1 '5 May' --note x", "got '5 May'; expected YYYY-MM-DD"),
        ("baseline reset {} M1 2199-01-01 --note x", "which has not come"),
        ("baseline reset {} M9 2026-01-05 --note x", "no motor M9"),
    ],
)
def test_what_would_do_nothing_is_refused(
    output: Path, config: Path, call: Call, line: str, words: str
) -> None:
    code, out, err = call(*shlex.split(line.format(config)))
    assert (code, out) == (2, "")
    assert words in err
    assert read_decisions(output) == ()


def test_a_silent_motor_is_acknowledged_and_not_inspected(output: Path) -> None:
    row = (
        pl.read_parquet(night_file(output, ALARMS, night_of(4)))
        .filter(night=night_of(4))
        .to_dicts()[0]
    )
    stale = row | {"night": night_of(5), "to_state": "stale", "id": "M1 later leakage"}
    write_nights(output, ALARMS, frame(ALARMS, [stale]))
    assert last_alarm(output, "M1", "leakage", ACTIONABLE) == night_of(5)
    assert last_alarm(output, "M1", "leakage", CHANGED) == night_of(4)
    with pytest.raises(UsageError, match="alarms so far: none"):
        last_alarm(output, "M2", "leakage", ACTIONABLE)


@pytest.mark.parametrize("text", ["", "h", "26", "-1h", "0h", "infh", "nanh", "1y", "26 h ours"])
def test_a_duration_that_is_none(text: str) -> None:
    with pytest.raises(typer.BadParameter):
        duration(text)


def test_every_state_has_a_meaning() -> None:
    assert set(STATES) == set(ORDER)


def test_a_sudden_rise_within_the_day_comes_first_and_a_clear_one_is_not_shown() -> None:
    since = dt.datetime(2026, 3, 2, 14, 30, tzinfo=dt.UTC)
    rise = IntradayStatus("risen", since, "drain flow +82 % [75, 90]", risen=1)
    broken = replace(state_of("M2"), intraday=rise)
    quiet = replace(state_of("M3"), intraday=IntradayStatus("clear", since, "x"))
    assert min((state_of("M1", "alarm"), quiet, broken), key=urgency).motor_id == "M2"
    assert "risen since 2026-03-02 14:30 UTC: drain flow +82 % [75, 90]" in broken.why
    assert "clear" not in quiet.why
