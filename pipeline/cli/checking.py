"""`check`: the config, the ends of the logs, or the published tables; `look`: the night so far."""

from __future__ import annotations

import datetime as dt
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from shutil import which
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
    print_table,
    progress_bar,
    say,
    tell,
)
from pipeline.cli.runs import stoppable, tell_faults
from pipeline.errors import LockedError, StoreError, UsageError
from pipeline.messages import counted, error_line

# A rule that refused less than this is not worth its name in a table.
WORTH_TELLING = 0.0005
_MOST_REASONS = 8
# Of a larger fleet so many motors' newest nights are judged: a check answers in half a minute.
JUDGED_AT_MOST = 100
CHANNEL_COLUMNS = ("channel", "rate", "median", "missing", "refused", "refused by")

if TYPE_CHECKING:
    from pipeline.config import Fleet
    from pipeline.intraday.check import MotorCheck as IntradayCheck
    from pipeline.setup.check import MotorCheck
    from pipeline.setup.samples import ChannelCheck


def check(
    config: ConfigFile,
    as_json: AsJson = False,
    tables: Annotated[
        bool, typer.Option("--tables", help="Compare every table file with its SHA-256 instead.")
    ] = False,
    full: Annotated[
        bool,
        typer.Option("--full", help="Read every log: which nights a run would fit, and why not."),
    ] = False,
    output: Output = None,
) -> None:
    """Check the config of a fleet and the ends of each log; nothing is fitted.

    Example: motor-leakage check configs/fleet.toml

    Example: motor-leakage check --tables configs/fleet.toml

    The newest night is judged by the rules of a run, with --full every night; of a fleet of more
    than 100 motors that of 100, those first that no run has fitted.

    Exit code 0: no fault; 1: a motor has no log, or no night that would be fitted, a log or its
    readings are at fault, the folder of the metrics is missing, or a file of the output is damaged;
    2: a fault in the config.
    """
    from pipeline.logs.finding import strays_text, unclaimed_logs
    from pipeline.logs.processed import paired_as_published, read_stays
    from pipeline.report.status import standing
    from pipeline.setup.check import Depth, check_motor, with_silent_nights
    from pipeline.store.state import read_state_file
    from pipeline.trends.decisions import read_decisions
    from pipeline.trends.tasks import decisions_of

    if tables:
        raise typer.Exit(_check_tables(config, output, as_json=as_json))
    fleet = load(config, output, None)
    fleet = paired_as_published(fleet, fleet.output)
    with read_state_file(fleet.output) as state:
        stays, _ = read_stays(state, [spec.motor_id for spec in fleet.motors])
        fitted = {motor_id for (motor_id,) in state.rows("SELECT DISTINCT motor_id FROM nights")}
    ids = sorted((spec.motor_id for spec in fleet.motors), key=fitted.__contains__)
    judged = ids if full else ids[:JUDGED_AT_MOST]
    depths = dict.fromkeys(judged, Depth.EVERY if full else Depth.NEWEST)
    decisions = decisions_of(fleet.motors, read_decisions(fleet.output))
    checks: tuple[MotorCheck, ...] = ()
    with progress_bar("motors", is_shown=not as_json) as draw:
        for spec in fleet.motors:
            motor_id = spec.motor_id
            depth = depths.get(motor_id, Depth.ENDS)
            checks += (check_motor(spec, stays[motor_id], decisions[motor_id], depth=depth),)
            draw(len(checks), len(fleet.motors))
    for motor in with_silent_nights(checks) if full else checks:
        if as_json:
            tell(asdict(motor), "", as_json=True)
        else:
            _print_check(motor)
    if len(judged) < len(checks):
        words = (
            f"the newest nights of {len(judged)} of {len(checks)} motors were judged, those first "
            "that no run has fitted; --full judges every night of all"
        )
        tell({"event": "judged", "motors": judged, "words": words}, words, as_json=as_json)
    placeholders = sorted({name for motor in checks for name in motor.placeholders})
    if placeholders and not as_json:
        names = ", ".join(placeholders)
        typer.echo(f"placeholders, to be replaced with the manufacturer's values: {names}")
    for line in standing(fleet.output, [spec.motor_id for spec in fleet.motors]):
        tell({"event": "standing", "words": line}, line, as_json=as_json)
    if strays := unclaimed_logs(fleet):
        tell({"event": "unclaimed", "logs": strays}, strays_text(strays), as_json=as_json)
    faults = list(_fleet_faults(fleet, checks))
    for fault in faults:
        line = error_line(fault.code, fault.message, EXIT_MOTORS_FAILED, as_json=as_json)
        typer.echo(line, err=True)
    faulty = faults or any(motor.faults for motor in checks)
    raise typer.Exit(EXIT_MOTORS_FAILED if faulty else EXIT_OK)


def _fleet_faults(fleet: Fleet, checks: Iterable[MotorCheck]) -> Iterator[UsageError]:
    """Yield what is wrong with the fleet as a whole."""
    if not any(check.n_files for check in checks):
        where = f"no log of any motor is below {fleet.log_place}"
        yield UsageError("no_logs", f"{where}; correct folders.logs, or logs.files")
    if (command := fleet.settings.alarms.command) and which(command[0]) is None:
        message = f"alarms.command: {command[0]} is no program that can be run: nobody is notified"
        yield UsageError("alarms_command", message)
    if fleet.metrics_file is not None and not fleet.metrics_file.parent.is_dir():
        where = f"{fleet.metrics_file.parent.resolve()} is no folder"
        yield UsageError("metrics_file", f"{where}; make it, or correct metrics.textfile")


def _check_tables(config: Path, output: Path | None, *, as_json: bool) -> int:
    """Compare the files of an output with what was published; returns the exit code."""
    from pipeline.store.published import verify_tables
    from pipeline.store.tables import existing_tables

    folder = load(config, output, None, logs=False).output
    faults = tuple(verify_tables(folder))
    tell_faults(faults, as_json=as_json)
    # Tables that are missing are reported already.
    tables = folder / "tables" if faults else existing_tables(folder)
    n_files = sum(1 for _ in tables.glob("**/*.parquet"))
    event = {"event": "tables", "n_files": n_files, "n_faults": len(faults)}
    words = f"{counted(n_files, 'table file')}, {counted(len(faults), 'fault')}"
    tell(event, words, as_json=as_json)
    return EXIT_MOTORS_FAILED if faults else EXIT_OK


def _print_check(motor: MotorCheck) -> None:
    span = f", {motor.first} to {motor.last}" if motor.first else ""
    typer.echo(
        f"{motor.motor_id}: {motor.motor_type}, {motor.log_format}, "
        f"{counted(motor.n_files, 'file')}, {counted(motor.n_nights, 'night')}{span}, "
        f"{counted(len(motor.faults), 'fault')}"
    )
    if motor.channels:
        print_table(CHANNEL_COLUMNS, list(map(_channel_cells, motor.channels)))
    refused = Counter(f"{night.status}: {night.reason}" for night in motor.forecast if night.reason)
    if motor.forecast:
        statuses = Counter(night.status for night in motor.forecast)
        n_read = statuses.total() - statuses["no_new_data"]
        typer.echo(f"{statuses['ok']} of {counted(n_read, 'night')} read would be fitted")
    for reason, n_nights in refused.most_common(_MOST_REASONS):
        typer.echo(f"{counted(n_nights, 'night')}: {reason}")
    for note in motor.notes:
        typer.echo(note)
    for fault in motor.faults:
        typer.echo(f"{motor.motor_id}: {fault}", err=True)
    typer.echo()


def _channel_cells(channel: ChannelCheck) -> tuple[str, ...]:
    """Return cells of `CHANNEL_COLUMNS`."""
    from pipeline.units import canonical_unit

    unit = canonical_unit(channel.channel).replace("degC", "°C")
    largest = sorted(channel.refused_by.items(), key=lambda entry: -entry[1])
    rules = (f"{name} {100 * share:.3g} %" for name, share in largest if share > WORTH_TELLING)
    return (
        channel.channel,
        f"{channel.rate_hz:.3g} Hz" if channel.rate_hz else "none",
        "none is kept" if channel.median is None else f"{channel.median:.4g} {unit}",
        f"{100 * channel.share_missing:.3g} %",
        f"{100 * channel.share_refused:.3g} %",
        ", ".join(rules),
    )


# The intraday check


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
                _look(fleet, wanted, as_json=as_json)
            except (StoreError, LockedError) as error:
                say(f"{error.code}: {error}; the next check tries again", err=True)
            due = max(due + pause_s, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))
        checks = _look(fleet, wanted, as_json=as_json)
    raise typer.Exit(EXIT_MOTORS_FAILED if any(check.fault for check in checks) else EXIT_OK)


def _look(fleet: Fleet, wanted: Sequence[str], *, as_json: bool) -> Sequence[IntradayCheck]:
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


def _measure(fleet: Fleet, checks: Sequence[IntradayCheck]) -> None:
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
