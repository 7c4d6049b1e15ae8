"""`motor-leakage check`: the config, the ends of the logs, or the published tables."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.cli.arguments import (
    EXIT_MOTORS_FAILED,
    EXIT_OK,
    AsJson,
    ConfigFile,
    Output,
    load,
    say,
)
from pipeline.cli.tables import print_table
from pipeline.errors import UsageError
from pipeline.messages import counted, error_line

# A rule that refused less than this is not worth its name in a table.
WORTH_TELLING = 0.0005
CHANNEL_COLUMNS = (
    "channel",
    "rate",
    "median",
    "missing",
    "refused",
    "refused by",
    "configured as",
    "looks",
)

if TYPE_CHECKING:
    from pipeline.setup.channel_check import ChannelCheck
    from pipeline.setup.check import MotorCheck
    from pipeline.store.published import TableFault


def check(
    config: ConfigFile,
    as_json: AsJson = False,
    tables: Annotated[
        bool, typer.Option("--tables", help="Compare every table file with its SHA-256 instead.")
    ] = False,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Put aside what is not its SHA-256, for the next run."),
    ] = False,
    output: Output = None,
) -> None:
    """Check the config of a fleet and the ends of each log; nothing is fitted.

    Example: motor-leakage check configs/fleet.toml

    Example: motor-leakage check --repair configs/fleet.toml

    Exit code 0: no fault; 1: a log cannot be read, there is no log, or a file of the output is
    damaged; 2: a fault in the config.
    """
    from pipeline.setup.check import check_fleet, strays_told, unclaimed

    if tables or repair:
        raise typer.Exit(_check_tables(config, output, as_json=as_json, is_mended=repair))
    fleet = load(config, None, None)
    checks = check_fleet(fleet)
    if as_json:
        for one in checks:
            typer.echo(json.dumps(asdict(one)))
        if strays := unclaimed(fleet):
            typer.echo(json.dumps({"event": "unclaimed", "logs": strays}))
    else:
        _print_checks(checks)
        if told := strays_told(fleet):
            typer.echo(told)
    there_are_logs = any(one.n_files for one in checks)
    if not there_are_logs:
        message = (
            f"no log of any motor is below {fleet.log_place}; correct folders.logs, or logs.files"
        )
        fault = UsageError("no_logs", message)
        line = error_line(fault.code, fault.message, EXIT_MOTORS_FAILED, as_json=as_json)
        say(line, err=True)
    faulty = not there_are_logs or any(one.faults for one in checks)
    raise typer.Exit(EXIT_MOTORS_FAILED if faulty else EXIT_OK)


def _check_tables(config: Path, output: Path | None, *, as_json: bool, is_mended: bool) -> int:
    """Compare the files of an output with what was published; returns the exit code."""
    from pipeline.run.mending import repair
    from pipeline.store.locks import locked
    from pipeline.store.published import verify_tables
    from pipeline.store.state import make_ready, open_state
    from pipeline.store.tables import existing_tables
    from pipeline.store.working_copy import working_copy

    fleet = load(config, output, None, logs=False)
    folder = fleet.output
    if is_mended:
        with locked(folder), working_copy(fleet.object_store, folder) as restore:
            make_ready(folder)
            with open_state(folder) as state:
                found, left = repair(state, restore)
    else:
        found = left = tuple(verify_tables(folder))
    _say_faults(found, "table_fault", "", as_json=as_json)
    if is_mended:
        _say_faults(left, "table_fault_left", "left: ", as_json=as_json)
    # Tables that are missing are reported already.
    tables = folder / "tables" if found else existing_tables(folder)
    n_files = sum(1 for _ in tables.glob("**/*.parquet"))
    total = {"event": "tables", "n_files": n_files, "n_faults": len(found), "n_left": len(left)}
    words = f"{counted(n_files, 'table file')}, {counted(len(found), 'fault')}"
    words += f", {len(left)} left" * is_mended
    say(json.dumps(total) if as_json else words)
    return EXIT_MOTORS_FAILED if left else EXIT_OK


def _say_faults(faults: Iterable[TableFault], event: str, mark: str, *, as_json: bool) -> None:
    for one in faults:
        words = f"motor-leakage: {mark}{one}"
        say(json.dumps({"event": event, **asdict(one)}) if as_json else words, err=True)


def _print_checks(checks: tuple[MotorCheck, ...]) -> None:
    for one in checks:
        span = f", {one.first} to {one.last}" if one.first else ""
        typer.echo(
            f"{one.motor_id}: {one.motor_type}, {one.log_format}, {counted(one.n_files, 'file')}, "
            f"{counted(one.n_nights, 'night')}{span}, {counted(len(one.faults), 'fault')}"
        )
        if one.channels:
            print_table(CHANNEL_COLUMNS, map(_channel_cells, one.channels))
        for channel in one.channels:
            for remark in channel.remarks:
                typer.echo(f"LOOK: {channel.channel}: {remark}")
        for note in one.notes:
            typer.echo(note)
        for fault in one.faults:
            typer.echo(f"{one.motor_id}: {fault}", err=True)
        typer.echo()
    placeholders = sorted({name for one in checks for name in one.placeholders})
    if placeholders:
        typer.echo(
            "placeholders, to be replaced with the manufacturer's values: "
            f"{', '.join(placeholders)}"
        )


def _channel_cells(channel: ChannelCheck) -> tuple[str, ...]:
    """Cells of `CHANNEL_COLUMNS`."""
    from pipeline.units import canonical_unit

    unit = canonical_unit(channel.channel).replace("degC", "°C")
    largest = sorted(channel.refused_by.items(), key=lambda one: -one[1])
    rules = (f"{name} {100 * share:.3g} %" for name, share in largest if share > WORTH_TELLING)
    return (
        channel.channel,
        f"{channel.rate_hz:.3g} Hz" if channel.rate_hz else "none",
        "none is kept" if channel.median is None else f"{channel.median:.4g} {unit}",
        f"{100 * channel.share_missing:.3g} %",
        f"{100 * channel.share_refused:.3g} %",
        ", ".join(rules),
        channel.configured,
        channel.looks,
    )
