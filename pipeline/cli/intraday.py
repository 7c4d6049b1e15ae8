"""The command of the intraday check."""

from __future__ import annotations

import datetime as dt
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.cli.arguments import (
    EXIT_MOTORS_FAILED,
    EXIT_OK,
    AsJson,
    ConfigFile,
    Motors,
    Output,
    duration,
    load,
    say,
    tell,
)
from pipeline.cli.runs import stoppable
from pipeline.errors import LockedError, StoreError, UsageError
from pipeline.messages import counted

if TYPE_CHECKING:
    from pipeline.config import Fleet
    from pipeline.intraday.check import MotorCheck


def look(
    config: ConfigFile,
    every: Annotated[
        dt.timedelta | None,
        typer.Option(parser=duration, help="Check again and again, so far apart, as 10min."),
    ] = None,
    output: Output = None,
    motors: Motors = "",
    as_json: AsJson = False,
) -> None:
    """Judge the night so far in growing logs, and notify of a sudden rise at once.

    The nightly run continues beside it, and nothing of it is touched. With --every 10min it checks
    until it is stopped.

    Example: motor-leakage look configs/fleet.toml

    Exit code 0: all motors were checked; 1: a motor could not be; 2: wrong usage or config;
    3: another check is under way; 4: nothing could be published.
    """
    pause_s = every.total_seconds() if every else 0.0
    with stoppable():
        fleet = load(config, output, None)
        wanted = fleet.known_motors(motors.split())
        if fleet.log_url:
            words = "logs in an object store cannot be checked within the day: use fit-fleet"
            raise UsageError("look_logs", words)
        due = time.monotonic()
        while pause_s:
            try:
                _check(fleet, wanted, as_json=as_json)
            except (StoreError, LockedError) as error:
                say(f"{error.code}: {error}; the next check tries again", err=True)
            due = max(due + pause_s, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))
        checks = _check(fleet, wanted, as_json=as_json)
    raise typer.Exit(EXIT_MOTORS_FAILED if any(check.fault for check in checks) else EXIT_OK)


def _check(fleet: Fleet, wanted: Sequence[str], *, as_json: bool) -> Sequence[MotorCheck]:
    """Check once, print changes of state and faults, and write the metrics."""
    from pipeline.intraday.check import check_fleet
    from pipeline.intraday.rows import NOT_JUDGED

    checks = check_fleet(fleet, wanted)
    for check in checks:
        event = {"event": "look", **asdict(check), "rows": check.rows}
        lines = [
            f"{row['time']:%Y-%m-%d %H:%M} {check.motor_id}: {row['to_state']}: {row['reason']}"
            for row in check.rows
        ]
        if check.fault:
            say(f"{check.motor_id}: {check.fault}", err=True)
        elif check.state == NOT_JUDGED:
            lines = [f"{check.motor_id}: not judged: {check.reason}"]
        tell(event, "\n".join(lines), as_json=as_json)
    if not as_json:
        states = Counter(check.state.replace("_", " ") for check in checks)
        counts = ", ".join(f"{n} {state}" for state, n in sorted(states.items()))
        say(f"{counted(len(checks), 'motor')} checked: {counts}")
    _measure(fleet, checks)
    return checks


def _measure(fleet: Fleet, checks: Sequence[MotorCheck]) -> None:
    """Write the metrics; that they cannot be written costs nobody the check."""
    if fleet.metrics_file is None:
        return
    from pipeline.run.notification import (
        intraday_metrics_file,
        intraday_metrics_text,
        write_metrics,
    )

    text = intraday_metrics_text(fleet, checks)
    try:
        write_metrics(intraday_metrics_file(fleet.metrics_file), text)
    except StoreError as error:
        say(f"{error.code}: {error}; there are no metrics of this check", err=True)
