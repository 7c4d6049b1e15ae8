"""Logs that `init` is asked about, and what it proposes with the answers of who knows the plant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config import Channel
from pipeline.config.logs import Logs
from pipeline.ingest import RawLog, read_log
from pipeline.setup.names import meaning_of
from pipeline.setup.propose import Proposal, ProposedMotor, propose
from pipeline.units import canonical_unit
from tests.dialects import Csv, Recorded

START_US = 1_741_845_600_000_000  # 13 March 2025, 06:00 UTC
KPA = {"pressure": "kPa"}
UNITS = {"pressure_difference": "kPa"}
CALLED = {
    "pressure_difference": ("dp", "kPa"),
    "oil_temperature": ("Oil temp", "°C"),
    "speed": ("Speed", "1/min"),
    "leakage_flow": ("Drain flow", "l/min"),
}
# By place of the units in the log.
NAMES: Mapping[str, Mapping[str, str]] = {
    place: {channel: form.format(*own) for channel, own in CALLED.items()}
    for place, form in (("name", "{} [{}]"), ("word", "{}_{}"), ("nowhere", "{}"))
}


def text_log(logs: Mapping[str, Any], named: str = "name", **options: Any) -> Csv:
    """A dialect of text."""
    return Csv(logs, KPA, names=NAMES[named], **options)


def log_of(
    count: int = 30, start_us: int = START_US, step_s: float = 1.0, blank: int | None = None
) -> Recorded:
    """A log of a motor, with a blank in the speed and another in the drain flow."""
    i = np.arange(count, dtype=np.float64)
    values = {
        "pressure_difference": 200.5 + 0.25 * i,
        "oil_temperature": 50.5 + 0.125 * (i % 5),
        "speed": 12.25 + 0.5 * (i % 7),
        "leakage_flow": 1.0625 + 0.0625 * (i % 3),
    }
    if blank is not None:
        values["speed"][blank] = values["leakage_flow"][blank + 3] = np.nan
    return Recorded(start_us + (1e6 * step_s * i).astype(np.int64), values)


def log_in(folder: Path, data: bytes, name: str = "log.csv") -> Path:
    path = folder / "logs" / "M1" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def proposed(source: Path, units: Mapping[str, str] | None = None, form: str = "") -> Proposal:
    """A proposal, with the answers of a person who knows the units and the form of the time."""
    answers: dict[str, str] = {}
    for _ in range(4):
        proposal = propose(source, answers)
        for question in proposal.questions:
            answer = next(iter(question.choices), "")
            if question.key.startswith("unit of"):
                channel = question.text.split("unit of ")[1].split(" (")[0].replace(" ", "_")
                answer = (units or {}).get(channel, canonical_unit(channel))
            elif question.key.startswith("time_format"):
                answer = form or answer
            elif "pressure" in question.key:
                high = (
                    n for n in question.choices if meaning_of(n).channel == "high_port_pressure"
                )
                answer = next(high, answer)
            elif question.key == "time_zone":
                answer = "UTC"
            answers[question.key] = answer
    assert not proposal.questions, proposal.questions
    return proposal


def read_as_proposed(motor: ProposedMotor, root: Path) -> list[RawLog]:
    """The logs of a motor, found and read with what is proposed."""
    logs = Logs.model_validate({**motor.logs, "files": tuple(motor.logs["files"])}, strict=False)
    channels: Any = {
        name: Channel.model_validate(channel.keys) for name, channel in motor.channels.items()
    }
    paths = sorted({path for pattern in logs.files for path in root.glob(pattern)})
    assert set(motor.files) <= set(paths), "the patterns do not find the logs"
    return [read_log(path, logs, channels) for path in paths]


def require_it_reads(
    source: Path, log: Recorded, form: str = "", units: Mapping[str, str] = UNITS
) -> ProposedMotor:
    """The only motor that is proposed, of which every sample is read back in its unit."""
    proposal = proposed(source, units, form)
    (motor,) = proposal.motors
    logs = read_as_proposed(motor, proposal.log_root)
    for channel, values in log.values.items():
        (raw,) = [each.channels[channel] for each in logs if each.channels[channel].time_us.size]
        np.testing.assert_array_equal(raw.time_us, log.time_us)
        np.testing.assert_array_equal(raw.missing, np.isnan(values))
        assert not raw.unparsed
        np.testing.assert_allclose(raw.value, values, rtol=1e-6, atol=1e-9)
    return motor
