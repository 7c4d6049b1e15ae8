"""The command that looks within the day."""

from __future__ import annotations

import datetime as dt
import time
from collections import Counter
from collections.abc import Sequence
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
    from pipeline.look.look import MotorLook


def look(
    config: ConfigFile,
    every: Annotated[
        dt.timedelta | None,
        typer.Option(parser=duration, help="Look again and again, so far apart, as 10min."),
    ] = None,
    output: Output = None,
    motors: Motors = "",
    as_json: AsJson = False,
) -> None:
    """Look at the new minutes of growing logs, and tell of a sudden rise at once.

    The nightly run goes on beside it, and nothing of it is touched. With --every 10min it looks
    until it is stopped.

    Example: motor-leakage look configs/fleet.toml

    Exit code 0: all motors were looked at; 1: at least one could not be; 2: wrong usage or config;
    3: another look is under way; 4: nothing could be published.
    """
    pause_s = every.total_seconds() if every else 0.0
    with stoppable():
        fleet = load(config, output, None)
        wanted = fleet.known_motors(motors.split())
        _require_files(fleet)
        due = time.monotonic()
        while pause_s:
            try:
                _look(fleet, wanted, as_json=as_json)
            except (StoreError, LockedError) as error:
                say(f"{error.code}: {error}; the next look tries again", err=True)
            due = max(due + pause_s, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))
        found = _look(fleet, wanted, as_json=as_json)
    raise typer.Exit(EXIT_MOTORS_FAILED if any(one.fault for one in found) else EXIT_OK)


def _look(fleet: Fleet, wanted: Sequence[str], *, as_json: bool) -> Sequence[MotorLook]:
    """Look once, print changes of state and faults, and write the metrics."""
    from pipeline.look.look import look_at_fleet

    found = look_at_fleet(fleet, wanted)
    for one in found:
        event = {
            "event": "look",
            "motor_id": one.motor_id,
            "state": one.state.state,
            "reason": one.state.reason,
            "changes": one.rows,
            "fault": one.fault,
        }
        lines = (
            f"{row['time']:%Y-%m-%d %H:%M} {one.motor_id}: {row['to_state']}: {row['reason']}"
            for row in one.rows
        )
        tell(event, "\n".join(lines), as_json=as_json)
        if one.fault and not as_json:
            say(f"{one.motor_id}: {one.fault}", err=True)
    if not as_json:
        states = Counter(one.state.state for one in found)
        counts = ", ".join(f"{n} {name}" for name, n in sorted(states.items()))
        say(f"{counted(len(found), 'motor')} looked at: {counts}")
    _measure(fleet)
    return found


def _require_files(fleet: Fleet) -> None:
    """Refuse a fleet whose logs are no files of a folder."""
    if fleet.log_url:
        raise UsageError(
            "look_logs", "logs in an object store cannot be looked at yet: leave it to fit-fleet"
        )


def _measure(fleet: Fleet) -> None:
    """Write the metrics of the looks; that they cannot be written costs nobody the look."""
    if fleet.metrics_file is None:
        return
    from pipeline.look.state import look_statuses
    from pipeline.run.metrics import look_metrics_file, look_metrics_text, write_metrics

    looks = look_statuses(fleet.output, [spec.motor_id for spec in fleet.motors])
    try:
        write_metrics(look_metrics_file(fleet.metrics_file), look_metrics_text(fleet, looks))
    except StoreError as error:
        say(f"{error.code}: {error}; there are no metrics of this look", err=True)
