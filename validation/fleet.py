"""A fleet of cuts: logs and motors' files beside a config of this folder, and the program's run."""

from __future__ import annotations

import datetime as dt
import shutil
from collections.abc import Sequence
from pathlib import Path

import polars as pl

from pipeline.cli import app
from pipeline.notebook import Tables, open_tables
from validation.record import TIME

HERE = Path(__file__).parent
FIRST = dt.datetime(2024, 4, 1, 8, tzinfo=dt.UTC)
DAY = dt.timedelta(days=1)


def new_fleet(config: str, folder: Path) -> Path:
    """Copy a config of this folder to `folder/config`; the fleet file's path."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(HERE / config, folder / "config")
    (folder / "config" / "motors").mkdir(exist_ok=True)
    (folder / "logs").mkdir()
    return folder / "config" / "fleet.toml"


def add_motor(fleet: Path, motor_id: str, nights: Sequence[pl.DataFrame], more: str = "") -> None:
    """Write a motor whose logs are cuts: the first as of `FIRST`, each a day after the last."""
    file = fleet.parent / "motors" / f"{motor_id}.toml"
    file.write_text(f'motor_id = "{motor_id}"\n{more}', "utf-8")
    logs = fleet.parent.parent / "logs" / motor_id
    logs.mkdir(parents=True)
    for number, rows in enumerate(nights):
        shift = FIRST + number * DAY - rows[TIME][0]
        shifted = rows.with_columns(pl.col(TIME) + shift)
        shifted.write_parquet(logs / f"{number:03}.parquet")


def fitted(fleet: Path) -> Tables:
    """Run `motor-leakage fit-fleet`; its tables."""
    app(["fit-fleet", str(fleet)], standalone_mode=False)
    return open_tables(fleet.parent.parent / "out")
