"""The demo fleet in another dialect: the logs of its first nights, and motors that read them."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from pipeline.config import Fleet, MotorSpec, load_fleet
from pipeline.config.channels import Channel
from pipeline.config.logs import Logs
from pipeline.demo.fleet import DEMO_FLEET, DemoNight, Plan
from pipeline.demo.recording import record_night
from tests.dialects.dialect import Dialect
from tests.dialects.recorded import Recorded, recorded

Nights = Mapping[str, Mapping[dt.date, Recorded]]
"""By motor and label, what was recorded."""

OF_THE_LOG = frozenset({"source", "unit", "field", "scale", "offset"})


def demo_fleet(demo: Path) -> Fleet:
    """Fleet of a demo's folder."""
    return load_fleet(demo / "configs" / "fleet.toml")


def first_nights(demo: Path) -> Nights:
    """Records of all nights of a demo's folder, simulated again without any reader."""
    truth = json.loads((demo / "demo" / "truth.json").read_text("utf-8"))
    stated = (truth[name] for name in ("nights", "minutes", "rate_hz", "seed"))
    plan = Plan(*stated, dt.date.fromisoformat(truth["first_night"]))
    specs = {spec.motor_id: spec for spec in demo_fleet(demo).motors}
    nights: dict[str, dict[dt.date, Recorded]] = {}
    for motor in DEMO_FLEET:
        spec = specs[motor.motor_id]
        for number in range(1, plan.nights + 1):
            night = DemoNight(motor, spec, plan, number)
            log = recorded(record_night(night), spec.file)
            nights.setdefault(motor.motor_id, {})[night.label] = log
    return nights


def fleet_of_one(
    demo: Path, motor_id: str, folder: Path, dialect: Dialect, nights: Nights
) -> Fleet:
    """A motor of a demo whose logs are written to a folder in a dialect."""
    fleet = demo_fleet(demo)
    (spec,) = (one for one in fleet.motors if one.motor_id == motor_id)
    folder.mkdir(parents=True)
    for label, log in nights[motor_id].items():
        dialect.write(folder, f"{motor_id}_{label}", log)
    return replace(fleet, motors=(_reading(spec, folder, dialect),))


def _reading(spec: MotorSpec, folder: Path, dialect: Dialect) -> MotorSpec:
    """The motor with other logs; what its sensors can say stays."""
    channels = {
        name: Channel(
            **channel.model_dump(exclude_unset=True, exclude=set(OF_THE_LOG)) | dialect.source(name)
        )
        for name, channel in spec.file.channels.items()
    }
    logs = Logs(**dialect.section(), files=("*",))
    file = spec.file.model_copy(update={"logs": logs, "channels": channels})
    return replace(spec, file=file, log_root=folder)
