"""Commands that keep the tables in order: pruning, and a working copy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.arguments import AsJson, ConfigFile, Output, absolute_folder, load, say, tell
from pipeline.clock import now
from pipeline.messages import counted


def prune(
    config: ConfigFile,
    output: Output = None,
    tables: Annotated[
        str, typer.Option(help="Tables, with commas between; those of [retention] if empty.")
    ] = "",
    keep: Annotated[
        int | None, typer.Option(min=1, help="Newest nights to keep of them; else the config's.")
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Remove them; without it nothing is removed.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """List the old nights of heavy tables that can be removed; remove them with --yes.

    Figures, trends and alarms stay, and no night is redone.

    Example: motor-leakage prune configs/fleet.toml --tables predictions,starts --keep 400
    """
    from pipeline.run.publishing import newest_of_fleet
    from pipeline.store.locks import locked
    from pipeline.store.retention import nights_kept, old_files
    from pipeline.store.retention import prune as remove
    from pipeline.store.state import make_ready, open_state
    from pipeline.store.tables import existing_tables
    from pipeline.store.working_copy import working_copy

    fleet = load(config, output, None, logs=False)
    existing_tables(fleet.output)
    kept = nights_kept(fleet.retention, tables.replace(",", " ").split(), keep)
    newest_night = newest_of_fleet(fleet, now())
    old = old_files(fleet.output, kept, None if newest_night is None else newest_night.night)
    if yes and old:
        with locked(fleet.output), working_copy(fleet.object_store, fleet.output):
            make_ready(fleet.output)
            with open_state(fleet.output) as state:
                remove(state, old)
    word = "removed" if yes else "can be removed"
    for one in old:
        event = {
            "event": "prune",
            "table": one.table,
            "n_files": len(one.names),
            "size_bytes": one.size_bytes,
            "first_night": one.first,
            "last_night": one.last,
            "removed": yes,
            "loss": one.loss,
        }
        words = (
            f"{one.table}: {counted(len(one.names), 'file')}, {one.first} to {one.last}, "
            f"{one.size_bytes / 1024**2:.1f} MiB {word}; with them goes: {one.loss}"
        )
        tell(event, words, as_json=as_json)
    if not as_json:
        size = sum(one.size_bytes for one in old) / 1024**2
        say(f"{size:.1f} MiB {word}" + ("" if yes or not old else "; say --yes to remove them"))


def pull(
    config: ConfigFile,
    output: Annotated[
        Path | None,
        typer.Option(
            callback=absolute_folder, help="Folder of the copy, instead of the config's output."
        ),
    ] = None,
) -> None:
    """Bring the output folder up to date with the object store that it is published to.

    Example: motor-leakage pull configs/fleet.toml
    """
    from pipeline.run.fleet import refresh

    fleet = load(config, None, None, logs=False)
    if output is not None:
        fleet = replace(fleet, output=output)
    if not fleet.object_store:
        say(f"{fleet.output} is published nowhere else: folders.object_store is not set")
        return
    say(f"{counted(refresh(fleet), 'file')} of {fleet.object_store} in {fleet.output}")
