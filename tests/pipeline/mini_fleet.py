"""A fleet of the quickest motors that there are, with one log a night."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

from tests.pipeline.simulated import motor_toml, write_configs, write_log
from tests.pipeline.workshop import DAY, MINI, QUICK, Workshop

FIRST = dt.date(2026, 1, 2)


def mini_fleet(folder: Path, n_motors: int, n_nights: int, execution: str = "") -> Path:
    """Write motors M1, M2, … with their logs; returns the fleet file."""
    fleet = QUICK.replace('backend = "sequential"\n', execution or 'backend = "sequential"\n')
    motors = [f"M{number}" for number in range(1, n_motors + 1)]
    texts = {motor: motor_toml(motor, "MINI") for motor in motors}
    file = write_configs(folder, texts, {"MINI": MINI}, QUICK)
    shop = Workshop(folder)
    for number, motor in enumerate(motors):
        spec_logs = folder / "logs" / motor
        for night in range(n_nights):
            operation, values = shop.night(FIRST + night * DAY, seed=number + night)
            write_log(spec_logs / f"{FIRST + night * DAY}.parquet", operation.time_us, values)
    file.write_text(fleet, "utf-8")
    return file
