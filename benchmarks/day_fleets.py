"""Fleets of motors that each have a log of a simulated day, for benchmarks of whole runs."""

from __future__ import annotations

import os
import re
import shutil
from datetime import date
from pathlib import Path

from pipeline.demo.writing import write_demo

MOTORS = {"parquet": "CB400-02", "csv": "CB400-01", "mcap": "CB560-01"}
"""The motor of the demo whose logs come in a format: four channels, temperature at 1 Hz."""
NIGHT = date(2026, 1, 2)


def make_fleet(folder: Path, name: str, n: int, minutes: float, rate_hz: float) -> Path:
    """Make a fleet of n motors, each on a tank of its own and with the same log in a format.

    Returns its config; `logs_of` has the logs.
    """
    of = MOTORS[name]
    shutil.rmtree(folder, ignore_errors=True)
    write_demo(
        folder, nights=1, minutes=minutes, rate_hz=rate_hz, workers=1, first_night=NIGHT,
        motors=[of],
    )  # fmt: skip
    config, motors = folder / "configs" / "fleet.toml", folder / "configs" / "motors"
    text, (log,) = (motors / f"{of}.toml").read_text("utf-8"), logs_of(config)
    shutil.rmtree(motors)
    motors.mkdir()
    for motor_id in (f"M{number:04}" for number in range(1, n + 1)):
        own = re.sub("(oil_circuit = ).*", rf'\1"tank of {motor_id}"', text.replace(of, motor_id))
        (motors / f"{motor_id}.toml").write_text(own, "utf-8")
        target = log.parents[1] / motor_id / log.name
        target.parent.mkdir()
        os.link(log, target)
    log.unlink()
    return config


def logs_of(config: Path) -> list[Path]:
    """All logs of such a fleet."""
    logs = config.parent.parent / "demo" / "logs"
    return sorted(path for path in logs.rglob("*") if path.is_file())
