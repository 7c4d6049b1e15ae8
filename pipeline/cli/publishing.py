"""Commands on published tables: in words, as pages or CSV; pruned."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Annotated, Literal

import typer

from pipeline.cli.arguments import (
    AsJson,
    ConfigFile,
    Motor,
    Motors,
    Output,
    Since,
    Until,
    absolute_folder,
    day,
    load,
    progress_bar,
    require_order,
    say,
    tell,
)
from pipeline.clock import now
from pipeline.errors import UsageError
from pipeline.messages import counted


def explain(
    config: ConfigFile,
    motor: Motor,
    night: Annotated[dt.date, typer.Argument(parser=day, help="The night's label, YYYY-MM-DD.")],
    output: Output = None,
) -> None:
    """Explain in words the figures of a motor's night, or their absence.

    Example: motor-leakage explain configs/fleet.toml CB560-01 2026-01-03
    """
    from pipeline.report.explain import explain as explained

    fleet = load(config, output, None)
    fleet.known_motors([motor])
    for line in explained(fleet.output, motor, night):
        typer.echo(line)


def report(
    config: ConfigFile,
    output: Output = None,
    to: Annotated[
        Path | None,
        typer.Option(
            callback=absolute_folder, help="Folder of the report, instead of report/ in the output."
        ),
    ] = None,
    nights: Annotated[
        int | None, typer.Option(min=1, help="Newest nights with their own file; default: all.")
    ] = None,
) -> None:
    """Write the report: pages for the fleet and each motor that open without a server.

    Example: motor-leakage report configs/fleet.toml

    Then open out/report/index.html. A further call only writes what has changed. A motor's page
    prints as a work order on a sheet.
    """
    from pipeline.report.build import build_report

    fleet = load(config, output, None, logs=False)
    folder = to or fleet.output / "report"
    with progress_bar("nights") as draw:
        result = build_report(
            fleet, folder, nights=nights, made=now(), config=str(config), progress=draw
        )
    typer.echo(
        f"{counted(result.n_motors, 'motor')}, {counted(result.n_nights, 'night')} updated, "
        f"{counted(result.n_written, 'file')} written, {result.n_removed} removed; "
        f"open {folder / 'index.html'}"
    )


def export(
    config: ConfigFile,
    csv: Annotated[Path, typer.Option(metavar="FOLDER", help="Write CSV there, a file a table.")],
    tables: Annotated[str, typer.Option(help="Tables, with commas between; all if empty.")] = "",
    motors: Motors = "",
    since: Since = None,
    until: Until = None,
    separator: Annotated[
        Literal[",", ";", "\t", "|"], typer.Option(help="Character between the cells of CSV.")
    ] = ",",
    decimal: Annotated[Literal[".", ","], typer.Option(help="Decimal sign of CSV.")] = ".",
    bom: Annotated[
        bool, typer.Option("--bom", help="Begin each file with a byte order mark, for Excel.")
    ] = False,
    output: Output = None,
) -> None:
    """Write published tables as CSV; files of the same name are replaced.

    Example: motor-leakage export configs/fleet.toml --csv csv --tables fits,parameters --bom

    Excel with a decimal comma reads --separator ';' --decimal , as it is.

    Text that a spreadsheet would evaluate as a formula gets an apostrophe in front.
    """
    from pipeline.config import load_fleet, overlap
    from pipeline.export import CsvRequest, export_csv, tables_named

    fleet = load_fleet(config)
    if (expected := overlap(fleet.at_output(csv.absolute()))) is not None:
        raise UsageError("csv_folder", f"--csv: got {csv}; {expected}")
    root, named = output or fleet.output, tables_named(tables.replace(",", " ").split())
    require_order(since, until)
    ids = fleet.known_motors(motors.split())
    request = CsvRequest(named, ids, since, until, separator, decimal, bom)
    for path, n_rows in export_csv(root, csv, request):
        typer.echo(f"{path}: {counted(n_rows, 'row')}")


def prune(
    config: ConfigFile,
    output: Output = None,
    tables: Annotated[
        str, typer.Option(help="Tables, with commas between; without, predictions alone.")
    ] = "predictions",
    keep: Annotated[int, typer.Option(min=1, help="Newest nights to keep of them.")] = 400,
    yes: Annotated[
        bool, typer.Option("--yes", help="Remove them; without it nothing is removed.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List the old nights of heavy tables that can be removed; remove them with --yes.

    Figures, trends and alarms stay, and no night is redone.

    Example: motor-leakage prune configs/fleet.toml --tables predictions,error_budget --keep 400
    """
    from pipeline.config.nights import nights_between
    from pipeline.run.publishing import newest_of_fleet
    from pipeline.store.atomic_files import locked
    from pipeline.store.published import old_files, require_prunable
    from pipeline.store.published import prune as remove
    from pipeline.store.state import open_state, read_state_file
    from pipeline.store.tables import existing_tables
    from pipeline.trends.motor_states import published_states

    fleet = load(config, output, None, logs=False)
    existing_tables(fleet.output)
    named = tables.replace(",", " ").split()
    require_prunable(named)
    keep_by_table = dict.fromkeys(named, keep)
    with read_state_file(fleet.output) as state:
        newest_night = newest_of_fleet(fleet, state, now())
    motor_ids = [spec.motor_id for spec in fleet.motors]
    rows = (state.row for state in published_states(fleet.output, motor_ids))
    baselines = ((row["baseline_start"], row["baseline_end"]) for row in rows)
    needed = {night for ends in baselines if all(ends) for night in nights_between(*ends)}
    newest = None if newest_night is None else newest_night.night
    old = old_files(fleet.output, keep_by_table, newest, needed)
    if yes and old:
        with locked(fleet.output), open_state(fleet.output) as state:
            remove(state, old)
    word = "removed" if yes else "can be removed"
    for part in old:
        event = {
            "event": "prune",
            "table": part.table,
            "n_files": len(part.names),
            "size_bytes": part.size_bytes,
            "first_night": part.first,
            "last_night": part.last,
            "removed": yes,
            "loss": part.loss,
        }
        words = (
            f"{part.table}: {counted(len(part.names), 'file')}, {part.first} to {part.last}, "
            f"{part.size_bytes / 1024**2:.1f} MiB {word}; with them goes: {part.loss}"
        )
        tell(event, words, as_json=as_json)
    if not as_json:
        size = sum(part.size_bytes for part in old) / 1024**2
        say(f"{size:.1f} MiB {word}" + ("" if yes or not old else "; say --yes to remove them"))
