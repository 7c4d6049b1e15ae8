"""The demo fleet in another dialect: its configs rewritten, and the logs of its first nights."""

from __future__ import annotations

import datetime as dt
import json
import shutil
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.config import MotorFile, load_fleet
from pipeline.demo.fleet import DEMO_FLEET, DemoNight, Plan
from pipeline.demo.recording import record_night
from tests.dialects.dialect import Dialect
from tests.dialects.recorded import Recorded, recorded

Nights = Mapping[str, Mapping[dt.date, Recorded]]
"""By motor and label, what was recorded."""


def first_nights(demo: Path) -> Nights:
    """Records of all nights of a demo's folder, simulated again without any reader."""
    truth = json.loads((demo / "demo" / "truth.json").read_text("utf-8"))
    stated = (truth[name] for name in ("nights", "minutes", "rate_hz", "seed"))
    plan = Plan(*stated, dt.date.fromisoformat(truth["first_night"]))
    specs = {spec.motor_id: spec for spec in load_fleet(demo / "configs" / "fleet.toml").motors}
    nights: dict[str, dict[dt.date, Recorded]] = {}
    for motor in DEMO_FLEET:
        spec = specs[motor.motor_id]
        for number in range(1, plan.nights + 1):
            night = DemoNight(motor, spec, plan, number)
            log = recorded(record_night(night), spec.file)
            nights.setdefault(motor.motor_id, {})[night.label] = log
    return nights


def write_fleet(demo: Path, folder: Path, dialect: Dialect, nights: Nights) -> Path:
    """Configs of a demo and logs of some nights, written to a folder in a dialect; its fleet file.

    Motors are left out that are not among the nights, or whose log the dialect cannot hold.
    """
    shutil.copytree(demo / "configs", folder / "configs")
    for file in (folder / "configs" / "motors").iterdir():
        own = nights.get(file.stem)
        if own is None or not all(map(dialect.holds, own.values())):
            file.unlink()
            continue
        document = tomllib.loads(file.read_text("utf-8"))
        logs = folder / "demo" / "logs" / file.stem
        logs.mkdir(parents=True)
        for label, log in own.items():
            dialect.write(logs, f"{file.stem}_{label}", log)
        file.write_text(toml(_rewritten(document, dialect)), "utf-8")
    return folder / "configs" / "fleet.toml"


def _rewritten(document: Mapping[str, Any], dialect: Dialect) -> dict[str, Any]:
    """A motor's file with other logs; what its sensors can say stays."""
    told = {"source", "unit", "field", "scale", "offset"}
    channels = {
        name: {key: value for key, value in keys.items() if key not in told} | dialect.source(name)
        for name, keys in document["channels"].items()
    }
    logs = dialect.section() | {"files": [f"{document['motor_id']}/*.{dialect.format}*"]}
    changed = {**document, "logs": logs, "channels": channels}
    MotorFile.model_validate_json(json.dumps(changed))
    return changed


def toml(document: Mapping[str, Any]) -> str:
    """A document of tables, texts, numbers, truths and lists of these as TOML.

    Examples
    --------
    >>> print(toml({"a": 1, "b": {"c": "d", "e": {"f": [0.5, True]}}}))
    a = 1
    [b]
    c = "d"
    [b.e]
    f = [0.5, true]
    """
    return "\n".join(_lines(document, ()))


def _lines(table: Mapping[str, Any], above: tuple[str, ...]) -> Iterator[str]:
    nested = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    if above and len(nested) < len(table):
        yield f"[{'.'.join(above)}]"
    for key, value in table.items():
        if key not in nested:
            yield f"{key} = {json.dumps(value, ensure_ascii=False)}"
    for key, value in nested.items():
        yield from _lines(value, (*above, key))
