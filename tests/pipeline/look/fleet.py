"""A fleet whose motors log to growing CSV files: published nights, and a day that is going on."""

from __future__ import annotations

import datetime as dt
import shutil
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from leakage.watch import NightBlocks, Watch
from pipeline.clock import utc
from pipeline.config import MotorSpec, load_fleet
from pipeline.look.comparison import NightsBefore, blocks_within, night_blocks
from pipeline.look.look import MotorLook, look_at_fleet
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.trends.nights.layout import Layout
from pipeline.trends.states.course import watch_settings
from tests.pipeline.calling import change
from tests.pipeline.notification.fleet import keep, told
from tests.pipeline.simulated import Operation, motor_toml, night_of, operate, raw, write_configs
from tests.pipeline.workshop import DAY, MINI, QUICK, Workshop

FIRST = dt.date(2026, 1, 2)
NIGHTS = 20
MADE_NIGHTS = 12
TODAY = FIRST + NIGHTS * DAY
BEGIN = dt.datetime.combine(TODAY - DAY, dt.time(22), dt.UTC)
MINUTES = 50.0
HEADER = "time,pressure_difference,oil_temperature,speed,leakage_flow\n"
LOOK = "[look]\nwarm_up_minutes = 4.0\n"


def rows_of(operation: Operation, flow: NDArray[np.float64]) -> list[str]:
    columns = (operation.pressure_bar, operation.temperature_c, operation.speed_rpm, flow)
    times = (f"{utc(one):%Y-%m-%dT%H:%M:%SZ}" for one in operation.time_us.tolist())
    return [
        f"{time},{p:.3f},{t:.3f},{w:.3f},{y:.7f}\n"
        for time, p, t, w, y in zip(times, *(one.tolist() for one in columns), strict=True)
    ]


def night_rows(
    spec: MotorSpec, label: dt.date, seed: int, rise: float = 0.0, after_minutes: float = 30.0
) -> list[str]:
    """Rows of a night; the flow rises by a share of it after some minutes."""
    operation = operate(label, MINUTES, seed)
    flow = operation.flow(spec.motor(label, "none"))
    flow = flow * (1.0 + rise * (np.arange(len(flow)) >= after_minutes * 60))
    return rows_of(operation, flow * (1.0 + noise(seed, len(flow))))


def noise(seed: int, n: int) -> NDArray[np.float64]:
    """Relative errors of samples."""
    return np.asarray(np.random.default_rng(seed).normal(0.0, 0.1, n))


loaded = lru_cache(maxsize=64)(load_fleet)


class Growing(Workshop):
    """The fleet, in a folder."""

    def today(self, motor: str = "M1") -> Path:
        """The log that grows today."""
        return self.folder / "logs" / motor / "today.csv"

    def append(self, rows: Sequence[str], motor: str = "M1") -> None:
        path = self.today(motor)
        is_new = not path.exists()
        with path.open("a", encoding="utf-8") as file:
            file.write((HEADER if is_new else "") + "".join(rows))

    def look(self, minutes: float = MINUTES) -> tuple[MotorLook, ...]:
        """Look so long after the begin of today's log."""
        return look_at_fleet(loaded(self.fleet), clock=BEGIN + dt.timedelta(minutes=minutes))

    def run(self, *, days: int = 1) -> None:
        """The nightly run, so many mornings after today's log began."""
        clock = BEGIN + days * DAY
        assert not run_fleet(RunRequest(loaded(self.fleet), clock=clock)).failed

    def looks(self) -> list[dict[str, object]]:
        """Published rows of `looks`, in order."""
        return self.rows("looks").to_dicts()

    def told(self) -> list[dict[str, object]]:
        """Changes that were delivered, in order."""
        return [change for one in told(self.folder) for change in one["changes"]]

    def copy(self, folder: Path) -> Growing:
        shutil.copytree(self.folder, folder)
        made = Growing(folder)
        change(made.fleet, "fleet.toml", f"{self.folder}/", f"{folder}/")
        return made


def configured(folder: Path, motors: Sequence[str] = ("M1",), circuit: str = "") -> Growing:
    """A fleet without a night; changes are told to a file beside it."""
    more = f'oil_circuit = "{circuit}"\n' if circuit else ""
    texts = {}
    for motor in motors:
        text = motor_toml(motor, "MINI", files=f'"{motor}/*.csv"')
        text = text.replace('format = "parquet"', 'format = "csv"\ntime = "time"')
        texts[motor] = text.replace("[logs]", f"{more}[logs]", 1)
        (folder / "logs" / motor).mkdir(parents=True)
    teller = f"[alarms]\n{keep(folder / 'told')}\n"
    write_configs(folder, texts, {"MINI": MINI}, QUICK + LOOK + teller)
    return Growing(folder)


def published(folder: Path) -> Growing:
    """The fleet with its nights published."""
    made = configured(folder)
    for night in range(NIGHTS):
        label = FIRST + night * DAY
        rows = night_rows(made.spec, label, seed=night)
        (made.logs / f"{label}.csv").write_text(HEADER + "".join(rows), "utf-8")
    made.run(days=0)
    return made


def made_watch(spec: MotorSpec) -> NightsBefore:
    """The watch of some made nights, for a motor that has none published."""
    labels = [TODAY - DAY * (MADE_NIGHTS - night) for night in range(MADE_NIGHTS)]
    layout = Layout.of(spec, labels[0])
    nights = [_made_night(spec, layout, seed, label) for seed, label in enumerate(labels)]
    settings = watch_settings(spec)
    watch = Watch.begin(layout.machine(spec, labels[0]), nights[:8], settings)
    for night in nights[8:]:
        watch = watch.after(night, lambda _: ())
    return NightsBefore(watch, layout, labels[-1])


def _made_night(spec: MotorSpec, layout: Layout, seed: int, label: dt.date) -> NightBlocks:
    operation = operate(label, MINUTES, seed)
    flow = operation.flow(spec.motor(label, "none"))
    flow = flow * (1.0 + noise(seed, len(flow)))
    night = night_of(label)
    channels = raw(operation.time_us, operation.channels(flow))
    blocks, why = blocks_within(spec, night, channels, night.start_us, night.end_us)
    assert not why
    return night_blocks(layout, blocks, label)
