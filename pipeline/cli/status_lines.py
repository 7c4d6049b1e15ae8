"""`motor-leakage status` on a terminal, in a file, or for programs."""

from __future__ import annotations

import datetime as dt
import json
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict

import typer

from pipeline.cli.arguments import print_table, say
from pipeline.messages import counted
from pipeline.report.status import FleetStatus
from pipeline.store.heartbeat import FINISHED, RUNNING
from pipeline.trends.rows.motor_states import MotorState, latest_rows
from pipeline.trends.sentences import in_percent

# Colours only support the words of a state.
COLOURS = {
    "alarm": "bold red",
    "warning": "yellow",
    "common_cause": "magenta",
    "stale": "blue",
}
COLUMNS = ("motor", "state", "newest night", "leakage l/min", "since", "last good night", "what")
# On a terminal the last column needs the room, and has these in words.
IN_WORDS = {"since", "newest night"}


def print_status(name: str, found: FleetStatus, *, too_old: bool, as_json: bool) -> None:
    """Print a fleet's state: for people, or one JSON object a motor and one for the fleet.

    `too_old`: the last good run is older than was asked for. Piped, only the table goes to stdout.
    """
    if as_json:
        _print_json(found, too_old=too_old)
        return
    on_terminal = sys.stdout.isatty()
    columns = [one for one in COLUMNS if not (on_terminal and one in IN_WORDS)]
    rows = [dict(zip(COLUMNS, _cells(motor), strict=True)) for motor in found.motors]
    styles = [COLOURS.get(motor.state, "") for motor in found.motors]
    print_table(columns, ([row[one] for one in columns] for row in rows), name, styles)
    for line in _fleet_lines(found, too_old=too_old):
        say(line, err=not on_terminal)


def _print_json(found: FleetStatus, *, too_old: bool) -> None:
    for motor, row in zip(found.motors, latest_rows(found.motors, ""), strict=True):
        look = None if motor.look is None else asdict(motor.look)
        del row["run_id"]
        typer.echo(json.dumps({"event": "motor", **row, "look": look}, default=str))
    fleet = {
        "event": "fleet",
        "last_good_run": found.last_good_run,
        "too_old": too_old,
        "findings": found.findings,
        "findings_confirmed": found.findings_confirmed,
        "run": None if found.beat is None else asdict(found.beat),
        "receivers": [asdict(one) for one in found.receivers],
        "changed_by_rules": found.n_by_rules,
        "damage": [asdict(fault) for fault in found.damage],
    }
    typer.echo(json.dumps(fleet, default=str))


def _fleet_lines(found: FleetStatus, *, too_old: bool) -> Iterator[str]:
    """Lines below the motors: last run, deliveries, damage, inspections."""
    ended = f"{found.last_good_run:%Y-%m-%d %H:%M} UTC" if found.last_good_run else "never"
    yield f"last good run: {ended}{', which is too old' if too_old else ''}"
    newest = max((one.data_night for one in found.motors if one.data_night), default=None)
    if newest is not None:
        days = (dt.datetime.now(dt.UTC).date() - newest).days
        yield f"newest samples: night of {newest}{f', {days} days ago' if days > 1 else ''}"
    if (line := _run_line(found)) is not None:
        yield line
    yield from (one.words for one in found.receivers if one.undelivered)
    if found.n_by_rules:
        yield (
            "changes of the program's rules: other states of past nights: "
            f"{found.n_by_rules}; `alarms.rules` has them"
        )
    if found.damage:
        first, files = found.damage[0], counted(len(found.damage), "published file")
        yield f"damaged or missing: {files}, such as {first.path}: {first.code}"
    looks = [motor.look for motor in found.motors if motor.look is not None]
    if looks:
        counts = Counter(one.state.replace("_", " ") for one in looks)
        states = ", ".join(f"{n} {state}" for state, n in sorted(counts.items()))
        told, confirmed, withdrawn = (
            sum(getattr(one, name) for one in looks) for name in ("told", "confirmed", "withdrawn")
        )
        yield f"looks: {states}; rises told {told}, confirmed {confirmed}, withdrawn {withdrawn}"
    if found.findings:
        share = 100 * found.findings_confirmed / found.findings
        yield (
            f"inspections that confirmed an alarm: {found.findings_confirmed} of "
            f"{found.findings} ({share:.0f} %)"
        )


def _run_line(found: FleetStatus) -> str | None:
    """Line on a run that is under way, or that did not end."""
    beat = found.beat
    if beat is None or beat.state == FINISHED:
        return None
    done = f"{beat.n_motors_done} of {beat.n_motors} motors done"
    since = f"{beat.started_at:%Y-%m-%d %H:%M} UTC"
    if beat.state != RUNNING:
        return f"the run of {since} {beat.state} ({beat.error_code or beat.stage}), {done}"
    if beat.is_missing(dt.datetime.now(dt.UTC)):
        return (
            f"the run of {since} (process {beat.pid} on {beat.host}) died or hangs: last heartbeat "
            f"{beat.beaten_at:%Y-%m-%d %H:%M} UTC, in the stage {beat.stage}, {done}"
        )
    return f"a run is under way since {since} (process {beat.pid}): {beat.stage}, {done}"


def _cells(motor: MotorState) -> tuple[str, ...]:
    """Cells of `COLUMNS`."""
    watch, newest, leakage, since = motor.watch, "unknown", "unknown", ""
    if watch is not None:
        change = (watch.tonight_change, watch.tonight_change_lower, watch.tonight_change_upper)
        if None not in change:
            newest = in_percent(1, *(100 * one for one in change if one is not None))
        if watch.own_leakage_l_per_min is not None:
            leakage = f"{watch.own_leakage_l_per_min:.3g}"
        since = str(watch.since or "")
    return (
        motor.motor_id,
        motor.state.replace("_", " "),
        newest,
        leakage,
        since,
        str(motor.last_good_night or "never"),
        f"{motor.why}. {motor.advice}" if motor.needs_attention else motor.why,
    )
