"""Fleets of motors that each have a log of one simulated day, for benchmarks of whole runs.

The day is that of a motor of the demo; each motor of a fleet has the very file of its log, under a
name of its own.
"""

from __future__ import annotations

import os
import re
import shutil
from datetime import date
from pathlib import Path

from pipeline.demo import write_demo

MOTORS = {"parquet": "CB400-02", "csv": "CB400-01", "mcap": "CB560-01"}
"""The motor of the demo whose logs come in a format: four channels, temperature at 1 Hz."""
NIGHT = date(2026, 1, 2)


def write_day(folder: Path, minutes: float, rate_hz: float, *formats: str) -> None:
    """Write the demo's configs, and one log in each of some formats."""
    motors = [MOTORS[name] for name in formats]
    write_demo(
        folder, nights=1, minutes=minutes, rate_hz=rate_hz, workers=1, first_night=NIGHT,
        motors=motors,
    )  # fmt: skip


def log_of(day: Path, name: str) -> Path:
    """The log of a day in a format."""
    (log,) = (day / "demo" / "logs" / MOTORS[name]).iterdir()
    return log


def make_fleet(day: Path, folder: Path, name: str, n: int) -> Path:
    """Make a fleet of n motors with a day's log in a format, each on a tank of its own.

    Returns its config.
    """
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(day / "configs", folder / "configs")
    motors = folder / "configs" / "motors"
    text = (motors / f"{MOTORS[name]}.toml").read_text("utf-8")
    shutil.rmtree(motors)
    motors.mkdir()
    log = log_of(day, name)
    for number in range(1, n + 1):
        motor_id = f"M{number:04}"
        own = text.replace(MOTORS[name], motor_id)
        own = re.sub("(oil_circuit = ).*", rf'\1"tank of {motor_id}"', own)
        (motors / f"{motor_id}.toml").write_text(own, "utf-8")
        target = folder / "demo" / "logs" / motor_id / log.name
        target.parent.mkdir(parents=True)
        os.link(log, target)
    return folder / "configs" / "fleet.toml"


def logs_of(config: Path) -> list[Path]:
    """All logs of such a fleet."""
    return sorted(
        path for path in (config.parent.parent / "demo" / "logs").rglob("*") if path.is_file()
    )
