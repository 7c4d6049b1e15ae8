"""Channels that are stated, as the log does not hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.config import ConfigError, MotorSpec
from pipeline.ingest import read_log
from pipeline.night.cleaning import ChannelRules, clean_channel
from tests.pipeline.simulated import load_motor, motor_toml, operate, write_log

STATED = """
[channels.case_pressure]
constant = 145.0377
unit = "psi"
"""


def stated_speed(more: str = "") -> str:
    text = motor_toml("M1").replace('source = "speed"', "constant = 1485.0")
    return text + more


def read(folder: Path, text: str) -> tuple[MotorSpec, dict[str, np.ndarray]]:
    spec, operation = load_motor(folder, text), operate()
    path = folder / "logs" / "M1" / "a.parquet"
    values = operation.channels(operation.pressure_bar)
    values["leakage_flow"][3] = np.nan
    write_log(path, operation.time_us, values)
    log = read_log(path, spec.file.logs, spec.file.channels)
    refused = {}
    for name, raw in log.channels.items():
        channel = spec.file.channels[name]
        rules = ChannelRules.of(name, channel, spec.settings.cleaning, spec.file.logs)
        refused[name] = clean_channel(raw, rules).refused
        if channel.constant is not None:
            np.testing.assert_array_equal(raw.time_us, operation.time_us)
    return spec, {name: raw.value for name, raw in log.channels.items()} | {
        f"refused {name}": mask for name, mask in refused.items()
    }


def test_a_constant_has_its_value_in_the_unit_of_the_tables(tmp_path: Path) -> None:
    _, found = read(tmp_path, motor_toml("M1") + STATED)
    assert found["case_pressure"][:3] == pytest.approx([10.0] * 3, rel=1e-6)
    assert list(found) == [
        *("pressure_difference", "case_pressure", "oil_temperature", "speed", "leakage_flow"),
        *(f"refused {name}" for name in found if not name.startswith("refused")),
    ]


def test_no_rule_refuses_a_constant(tmp_path: Path) -> None:
    """Neither the range of a motor's speed nor that of a sensor that has stopped moving."""
    _, found = read(tmp_path, stated_speed())
    assert not found["refused speed"].any()
    assert set(found["speed"]) == {1485.0}


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("constant = 1485.0", 'constant = 1485.0\nsource = "speed"', "channels.speed.source"),
        ("constant = 1485.0", "constant = 1485.0\nresolution = 0.1", "channels.speed.resolution"),
        ("constant = 1485.0", "", "channels.speed.source"),
        ('source = "leakage_flow"', "constant = 1.5", "channels.leakage_flow.constant"),
    ],
)
def test_what_cannot_be_stated(tmp_path: Path, before: str, after: str, told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_motor(tmp_path, stated_speed().replace(before, after))
    assert [fault.key for fault in caught.value.faults] == [told]
