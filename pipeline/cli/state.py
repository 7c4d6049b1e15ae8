"""Commands on the state of the fleet: status, acknowledgements, baseline resets."""

from __future__ import annotations

import datetime as dt
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from pipeline.cli.arguments import (
    EXIT_MOTORS_FAILED,
    EXIT_OK,
    AsJson,
    ConfigFile,
    Motor,
    Output,
    day,
    duration,
    load,
    past_day,
    print_table,
    say,
    tell,
)
from pipeline.clock import now
from pipeline.errors import UsageError
from pipeline.messages import counted

if TYPE_CHECKING:
    from pipeline.config import Fleet, MotorSpec
    from pipeline.report.status import FleetStatus
    from pipeline.trends.decisions import Decision, Kind
    from pipeline.trends.motor_states import MotorState

# Colours only support the words of a state.
COLOURS = {
    "alarm": "bold red",
    "warning": "yellow",
    "common_cause": "magenta",
    "stale": "blue",
    "removed": "blue",
}
COLUMNS = ("motor", "state", "l/min", "change", "since", "order")
LONG_COLUMNS = (*COLUMNS, "last good night", "what")


def status(
    config: ConfigFile,
    output: Output = None,
    max_age: Annotated[
        dt.timedelta | None,
        typer.Option(parser=duration, help="End with 1 if the last good run is older, as 26h."),
    ] = None,
    is_long: Annotated[
        bool, typer.Option("--long", help="With the last good night, and the state in words.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Print the state of each motor in a line, the most urgent first.

    Example: motor-leakage status configs/fleet.toml --max-age 26h

    Exit code 0; with --max-age 1 if the last good run is too old, or there was none, or no motor
    has samples newer than alarms.stale_after_nights.
    """
    from pipeline.notification.outbox import receivers_of
    from pipeline.report.status import fleet_status

    fleet = load(config, output, None, logs=False)
    receivers = receivers_of(fleet.settings.alarms)
    motor_ids = [spec.motor_id for spec in fleet.motors]
    fleet_state = fleet_status(fleet.output, motor_ids, receivers)
    ended = fleet_state.last_good_run
    too_old = max_age is not None and (ended is None or now() - ended > max_age)
    newest = fleet_state.newest_sample
    is_silent = fleet.is_live and newest is not None and now() - newest > fleet.stale_after
    if as_json:
        _print_json(fleet_state, too_old=too_old, is_silent=is_silent)
    else:
        columns = LONG_COLUMNS if is_long else COLUMNS
        rows = [_cells(motor)[: len(columns)] for motor in fleet_state.motors]
        styles = [COLOURS.get(motor.state, "") for motor in fleet_state.motors]
        print_table(columns, rows, fleet.name if is_long else "", styles, is_dense=not is_long)
        if not (fleet.output / "tables").is_dir():
            say(f"no run has published anything in {fleet.output}", err=not sys.stdout.isatty())
        for line in fleet_lines(fleet_state, too_old=too_old, is_silent=is_silent):
            say(line, err=not sys.stdout.isatty())
    is_late = too_old or (max_age is not None and is_silent)
    raise typer.Exit(EXIT_MOTORS_FAILED if is_late else EXIT_OK)


def _print_json(fleet_state: FleetStatus, *, too_old: bool, is_silent: bool) -> None:
    for motor in fleet_state.motors:
        intraday = None if motor.intraday is None else asdict(motor.intraday)
        typer.echo(json.dumps({"event": "motor", **motor.row, "intraday": intraday}, default=str))
    fleet = {
        "event": "fleet",
        "last_good_run": fleet_state.last_good_run,
        "too_old": too_old,
        "silent": is_silent,
        "standing": fleet_state.standing,
        "run": None if fleet_state.beat is None else asdict(fleet_state.beat),
        "receivers": [asdict(receiver) for receiver in fleet_state.receivers],
        "damage": [asdict(fault) for fault in fleet_state.damage],
    }
    typer.echo(json.dumps(fleet, default=str))


def fleet_lines(fleet_state: FleetStatus, *, too_old: bool, is_silent: bool) -> Iterator[str]:
    """Yield lines below the motors: last run, deliveries, damage, intraday check."""
    good, beat = fleet_state.last_good_run, fleet_state.beat
    ended = f"{good:%Y-%m-%d %H:%M} UTC" if good else "never"
    later = ""
    if beat is not None and beat.is_finished and (good is None or good < beat.started_at):
        later = f"; the run of {beat.started_at:%Y-%m-%d %H:%M} UTC left failures, or had no log"
    yield f"last run without a failure: {ended}{', which is too old' if too_old else ''}{later}"
    if (newest := fleet_state.newest_sample) is not None:
        days = (now() - newest).days
        ago = f", {days} days ago" if days > 1 else ""
        silent = ": the plant is silent" if is_silent else ""
        yield f"newest samples: {newest:%Y-%m-%d %H:%M} UTC{ago}{silent}"
    if (line := _run_line(fleet_state)) is not None:
        yield line
    yield from fleet_state.standing
    yield from (receiver.words for receiver in fleet_state.receivers if receiver.undelivered)
    if fleet_state.damage:
        first, files = fleet_state.damage[0], counted(len(fleet_state.damage), "published file")
        yield f"damaged or missing: {files}, such as {first.path}: {first.code}"
    checks = [motor.intraday for motor in fleet_state.motors if motor.intraday is not None]
    if checks:
        risen, confirmed, withdrawn = (
            sum(getattr(check, name) for check in checks)
            for name in ("risen", "confirmed", "withdrawn")
        )
        yield f"intraday rises: reported {risen}, confirmed {confirmed}, withdrawn {withdrawn}"


def _run_line(fleet_state: FleetStatus) -> str | None:
    """Return line on a run that is under way, or that did not end."""
    from pipeline.store.heartbeat import RUNNING

    beat = fleet_state.beat
    if beat is None or beat.is_finished:
        return None
    done = f"{beat.n_motors_done} of {beat.n_motors} motors done"
    since = f"{beat.started_at:%Y-%m-%d %H:%M} UTC"
    if beat.state != RUNNING:
        return f"the run of {since} {beat.state} ({beat.error_code or beat.stage}), {done}"
    if beat.is_missing(now()):
        return (
            f"the run of {since} (process {beat.pid} on {beat.host}) died or hangs: last heartbeat "
            f"{beat.beaten_at:%Y-%m-%d %H:%M} UTC, in the stage {beat.stage}, {done}"
        )
    return f"a run is under way since {since} (process {beat.pid}): {beat.stage}, {done}"


def _cells(motor: MotorState) -> tuple[str, ...]:
    """Return cells of `LONG_COLUMNS`."""
    from pipeline.messages import figure

    row = motor.row
    leakage = row["own_leakage_l_per_min"]
    rise = f"{motor.intraday.words}. " if motor.intraday and motor.is_sudden else ""
    return (
        motor.motor_id,
        motor.state.replace("_", " "),
        "unknown" if leakage is None else figure(leakage),
        motor.change or "unknown",
        motor.since,
        f"{rise}{motor.advice}",
        str(row["last_fit_night"] or "never"),
        motor.why,
    )


def compare(
    config: ConfigFile,
    motor: Motor,
    at: Annotated[
        dt.date, typer.Option(parser=day, help="First night after what was done, YYYY-MM-DD.")
    ],
    nights: Annotated[int, typer.Option(min=8, help="Nights on each side at most.")] = 60,
    output: Output = None,
    as_json: AsJson = False,
) -> None:
    """Compare a motor's nights before and after a date: a repair, a cleaning, a new filter.

    Example: motor-leakage compare configs/fleet.toml CB400-02 --at 2026-03-02

    What has changed in the case drain flow at the same conditions, with its 95 % interval, and how
    sure that is. A season or another load is none of it, as far as the nights before show them.
    """
    from pipeline.trends.comparing import compare_nights

    fleet = load(config, output, None, logs=False)
    record, lines = compare_nights(fleet.output, fleet.motor(motor), at, nights)
    tell(record, "\n".join(lines), as_json=as_json)


def ack(
    config: ConfigFile,
    motor: Motor,
    note: Annotated[str, typer.Option(help="Note in words.")],
    indicator: Annotated[
        str, typer.Argument(help="leakage, or the zero of a sensor: pressure_zero, flow_zero.")
    ] = "leakage",
    finding: Annotated[
        Literal["confirmed", "not_confirmed"] | None,
        typer.Option(help="What an inspection of the alarm has found."),
    ] = None,
    opened: Annotated[
        dt.date | None,
        typer.Option(parser=past_day, help="Day on which the motor was opened, YYYY-MM-DD."),
    ] = None,
    worn: Annotated[
        list[str] | None, typer.Option(help="Part found worn; may be repeated.")
    ] = None,
    sound: Annotated[
        list[str] | None, typer.Option(help="Part found sound; may be repeated.")
    ] = None,
    night: Annotated[
        dt.date | None,
        typer.Option(parser=past_day, help="Failed night to accept as excluded, YYYY-MM-DD."),
    ] = None,
    fit: Annotated[
        bool, typer.Option("--fit", help="With --night: fit it, its columns are right.")
    ] = False,
    output: Output = None,
) -> None:
    """Acknowledge an alarm, a failed night or a removed motor, or record an inspection.

    Example: motor-leakage ack configs/fleet.toml CB400-02 --note "rings ordered"

    After an inspection of an alarm add --finding confirmed or --finding not_confirmed. For a motor
    that was opened, with or without an alarm, name the parts:

    motor-leakage ack configs/fleet.toml CB400-02 --opened 2026-05-12 --worn piston_ring
    --sound balance_sleeve --note "rings scored"

    A failed night stays out with --night, or is fitted by the next run with --night and --fit.
    """
    from pipeline.report.status import last_alarm
    from pipeline.trends.decisions import Decision, record_decision
    from pipeline.trends.motor_states import ACTIONABLE, CHANGED

    require_words(note)
    fleet = load(config, output, None, logs=False)
    if night or fit:
        record_decision(fleet.output, _failed_night(fleet, motor, night, note, is_fit=fit))
        how = "the next run fits it" if fit else "excluded, runs end well without it"
        typer.echo(f"{motor}: night {night}: {how}")
        return
    if (removed := _removed_on(fleet, motor)) is not None:
        record_decision(fleet.output, Decision(motor, "", now(), "removed", removed, None, note))
        typer.echo(f"{motor}: that it was removed is confirmed; the next run leaves it out")
        return
    parts = [_parts(fleet.motor(motor), nights or ()) for nights in (worn, sound)]
    if opened or any(parts):
        if not opened or not any(parts) or finding:
            message = "expected --opened with --worn or --sound, and no --finding"
            raise UsageError("finding", message)
        decision = _finding_on_parts(motor, opened, parts, note)
        text = f"opened on {decision.night}; "
        text += f"worn: {decision.worn or 'none'}; sound: {decision.sound or 'none'}"
    else:
        night = last_alarm(fleet.output, motor, indicator, CHANGED if finding else ACTIONABLE)
        kind: Kind = "finding" if finding else "acknowledged"
        decision = Decision(motor, indicator, now(), kind, night, finding, note)
        text = f"{indicator}, raised last on {night}: {kind}"
    record_decision(fleet.output, decision)
    typer.echo(f"{motor}: {text}")


def require_words(note: str) -> None:
    """Raise UsageError if a note says nothing."""
    if not note.strip():
        raise UsageError("note", "--note: expected some words")


def _failed_night(
    fleet: Fleet, motor: str, night: dt.date | None, note: str, *, is_fit: bool
) -> Decision:
    """Return decision on a failed night; raises UsageError (``night``) if it is none."""
    from pipeline.report.status import failed_nights
    from pipeline.trends.decisions import Decision

    fleet.known_motors([motor])
    failed = failed_nights(fleet.output, [motor])[motor]
    if night not in failed:
        there = ", ".join(map(str, failed)) or "none"
        raise UsageError("night", f"--night: expected a failed night of {motor}: {there}")
    kind: Kind = "released" if is_fit else "excluded"
    return Decision(motor, "", now(), kind, night, None, note)


def _removed_on(fleet: Fleet, motor_id: str) -> dt.date | None:
    """Return last night of a motor that was removed; None for a motor of the config."""
    from pipeline.trends.motor_states import REMOVED, published_states

    states = published_states(fleet.output, [spec.motor_id for spec in fleet.motors])
    gone = {state.motor_id: state.row["night"] for state in states if state.state == REMOVED}
    last: dt.date | None = gone.get(motor_id)
    return last


def _parts(spec: MotorSpec, names: Sequence[str]) -> list[str]:
    """Return parts of a motor by name or in words; raises UsageError (``finding_part``)."""
    known = {path.name for path in spec.motor_type.path}
    parts = {name: name.strip().lower().removeprefix("the ").replace(" ", "_") for name in names}
    for name, part in parts.items():
        if part not in known:
            there = ", ".join(sorted(known))
            message = f"{spec.motor_id} has no part {name!r}; it has {there}"
            raise UsageError("finding_part", message)
    return list(dict.fromkeys(parts.values()))


def _finding_on_parts(
    motor_id: str, opened: dt.date, parts: Sequence[Sequence[str]], note: str
) -> Decision:
    """Return finding on the parts of an opened motor; raises UsageError (``finding_part``)."""
    from pipeline.trends.decisions import Decision

    worn, sound = parts
    if both := sorted({*worn} & {*sound}):
        raise UsageError("finding_part", f"{', '.join(both)}: expected worn or sound, not both")
    named = (", ".join(part) or None for part in parts)
    return Decision(motor_id, "", now(), "finding", opened, None, note, *named)


def baseline_reset(
    config: ConfigFile,
    motor: Motor,
    night: Annotated[
        dt.date,
        typer.Argument(parser=past_day, help="First night of the new baseline, YYYY-MM-DD."),
    ],
    note: Annotated[str, typer.Option(help="Reason in words.")],
    output: Output = None,
) -> None:
    """Start a new baseline of a motor with a night; the next run redoes its trends.

    Enter an overhaul, an oil change or a change of flushing in `events` of the motor's file
    instead: a dated event starts a new baseline as well.

    Example: motor-leakage baseline reset configs/fleet.toml CB560-01 2026-02-15 --note "new"
    """
    from pipeline.store.state import read_state_file
    from pipeline.trends.decisions import Decision, record_decision

    require_words(note)
    fleet = load(config, output, None, logs=False)
    fleet.known_motors([motor])
    with read_state_file(fleet.output) as state:
        rows = state.rows("SELECT night FROM nights WHERE motor_id = ? ORDER BY night", motor)
    nights = [dt.date.fromisoformat(label) for (label,) in rows]
    if not nights:
        raise UsageError("unknown_night", f"{fleet.output} has no night of {motor}; run fit-fleet")
    if not nights[0] <= night <= nights[-1] + dt.timedelta(days=1):
        span = f"{nights[0]} to {nights[-1]}"
        message = f"{motor} has the nights {span}; expected one of them, or the next"
        raise UsageError("unknown_night", message)
    record_decision(fleet.output, Decision(motor, "", now(), "baseline_reset", night, None, note))
    typer.echo(f"{motor}: its baseline starts with the night {night}")
