"""Motors of a test's own: config as TOML, and nights without noise, straight from the physics."""

from __future__ import annotations

import datetime as dt
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from leakage import Motor, OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec, Nights, load_fleet
from pipeline.config.nights import Night, night
from pipeline.demo import shipped_configs
from pipeline.ingest import RawChannel

Array = NDArray[np.float64]

NIGHT = dt.date(2026, 3, 2)
SECOND_US = 1_000_000
FLEET = 'name = "Tests"\nlive = false\n[folders]\nlogs = "../logs"\noutput = "../out"\n'
CANONICAL = {
    "pressure_difference": "bar",
    "oil_temperature": "degC",
    "speed": "rpm",
    "leakage_flow": "l/min",
}


def motor_toml(
    motor_id: str,
    motor_type: str = "CB560",
    units: Mapping[str, str] = CANONICAL,
    files: str | None = None,
    more: str = "",
) -> str:
    """A motor's file: Parquet logs whose columns are called as the channels are."""
    pattern = files or f'"{motor_id}/*.parquet"'
    channels = "".join(
        f'[channels.{name}]\nsource = "{name}"\nunit = "{unit}"\n' for name, unit in units.items()
    )
    return (
        f'motor_id = "{motor_id}"\nmotor_type = "{motor_type}"\noil = "vg68"\n'
        f'[logs]\nformat = "parquet"\nfiles = [{pattern}]\n{channels}{more}'
    )


def write_configs(
    folder: Path,
    motors: Mapping[str, str],
    types: Mapping[str, str] | None = None,
    fleet: str = FLEET,
) -> Path:
    """Shipped types and oils, and motors (and types) of the test's own; returns the fleet file."""
    configs = folder / "configs"
    for name in ("motor_types", "oils"):
        shutil.copytree(shipped_configs() / name, configs / name, dirs_exist_ok=True)
    (configs / "motors").mkdir(exist_ok=True)
    (folder / "logs").mkdir(exist_ok=True)
    for name, text in (types or {}).items():
        (configs / "motor_types" / f"{name}.toml").write_text(text, encoding="utf-8")
    for name, text in motors.items():
        (configs / "motors" / f"{name}.toml").write_text(text, encoding="utf-8")
    (configs / "fleet.toml").write_text(fleet, encoding="utf-8")
    return configs / "fleet.toml"


def load_motor(folder: Path, text: str, types: Mapping[str, str] | None = None) -> MotorSpec:
    """The one motor of a config of its own."""
    motor_id = text.split('"')[1]
    (spec,) = load_fleet(write_configs(folder, {motor_id: text}, types)).motors
    return spec


def with_settings(spec: MotorSpec, section: str, **keys: Any) -> MotorSpec:
    """A motor with other settings of a section."""
    part = getattr(spec.settings, section).model_copy(update=keys)
    return replace(spec, settings=spec.settings.model_copy(update={section: part}))


def with_file(spec: MotorSpec, **keys: Any) -> MotorSpec:
    """A motor with other keys of its own file."""
    return replace(spec, file=spec.file.model_copy(update=keys))


def with_channel(spec: MotorSpec, name: str, **keys: Any) -> MotorSpec:
    """A motor of which a channel is configured otherwise."""
    channel = spec.file.channels[name].model_copy(update=keys)
    return with_file(spec, channels={**spec.file.channels, name: channel})


@dataclass(frozen=True, slots=True)
class Operation:
    """Operation asked of a motor, on whole seconds from 22:00 of the evening on."""

    time_us: NDArray[np.int64]
    pressure_bar: Array
    temperature_c: Array
    speed_rpm: Array

    def flow(self, motor: Motor, coefficients: Mapping[str, float] | None = None) -> Array:
        """The drain flow of it, without any noise."""
        conditions = OperatingConditions.from_bar(
            self.pressure_bar, self.temperature_c, self.speed_rpm
        )
        return total_flow_l_per_min(motor, conditions, coefficients)

    def channels(self, flow: Array) -> dict[str, Array]:
        """Values by channel, in the units of the tables."""
        return {
            "pressure_difference": self.pressure_bar,
            "oil_temperature": self.temperature_c,
            "speed": self.speed_rpm,
            "leakage_flow": flow,
        }


def operate(label: dt.date = NIGHT, minutes: float = 40.0, seed: int = 1) -> Operation:
    """Smooth and never still: no rule of the cleaning has anything to refuse."""
    n = round(minutes * 60)
    seconds = np.arange(n, dtype=np.float64)
    rng = np.random.default_rng(seed)

    def wave(low: float, high: float, periods_s: tuple[float, ...]) -> Array:
        phases = rng.uniform(0.0, 2.0 * np.pi, len(periods_s))
        parts = [
            np.sin(2.0 * np.pi * seconds / period + phase)
            for period, phase in zip(periods_s, phases, strict=True)
        ]
        middle = np.sum(parts, axis=0) / len(parts)
        return np.asarray(low + (high - low) * (middle + 1.0) / 2.0)

    begin = dt.datetime.combine(label - dt.timedelta(days=1), dt.time(22), dt.UTC)
    first_us = int(begin.timestamp()) * SECOND_US
    return Operation(
        first_us + np.arange(n, dtype=np.int64) * SECOND_US,
        wave(15.0, 300.0, (97.0, 211.0)),
        wave(40.0, 58.0, (1301.0, 1709.0)),
        wave(4.0, 110.0, (151.0, 307.0)),
    )


def night_of(label: dt.date = NIGHT) -> Night:
    """A night as the fleet's default settings have it."""
    return night(label, Nights())


def raw(time_us: NDArray[np.int64], values: Mapping[str, Array]) -> dict[str, RawChannel]:
    """Channels as a reader gives them."""
    return {
        name: RawChannel(time_us[: len(value)], value, np.zeros(len(value), dtype=np.bool_), 0)
        for name, value in values.items()
    }


def write_log(path: Path, time_us: NDArray[np.int64], values: Mapping[str, Array]) -> None:
    """A Parquet log with every digit."""
    path.parent.mkdir(parents=True, exist_ok=True)
    time = pa.array(time_us, pa.timestamp("us", "UTC"))
    pq.write_table(
        pa.table({"time": time} | {name: pa.array(v) for name, v in values.items()}), path
    )
