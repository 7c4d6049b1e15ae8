"""Channels that are stated, as the log does not hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.config import ConfigError
from pipeline.ingest import read_log
from pipeline.night.cleaning import ChannelRules, clean_channel
from tests.pipeline.simulated import load_motor, motor_toml, operate, write_log

STATED = motor_toml("M1").replace('source = "speed"', "constant = 1485.0")
PRESSURE = '\n[channels.case_pressure]\nconstant = 145.0377\nunit = "psi"\n'


def test_a_constant_has_its_value_wherever_there_is_a_drain_flow(tmp_path: Path) -> None:
    """In the unit of the tables; no rule refuses it, neither of range nor of a frozen sensor."""
    spec, operation = load_motor(tmp_path, STATED + PRESSURE), operate()
    path = tmp_path / "logs" / "M1" / "a.parquet"
    values = operation.channels(operation.pressure_bar)
    values["leakage_flow"][3] = np.nan
    write_log(path, operation.time_us, values)
    log = read_log(path, spec.file.logs, spec.file.channels)
    names = ["pressure_difference", "case_pressure", "oil_temperature", "speed", "leakage_flow"]
    assert list(log.channels) == names
    flow = log.channels["leakage_flow"]
    for name, constant in (("speed", 1485.0), ("case_pressure", 10.0)):
        raw, channel = log.channels[name], spec.file.channels[name]
        np.testing.assert_array_equal(raw.time_us, operation.time_us)
        np.testing.assert_array_equal(raw.missing, flow.missing)
        np.testing.assert_allclose(raw.value[~raw.missing], constant, rtol=1e-6)
        rules = ChannelRules.of(name, channel, spec.settings.cleaning, spec.file.logs)
        assert not clean_channel(raw, rules).refused[~raw.missing].any()


@pytest.mark.parametrize(
    ("before", "after", "key"),
    [
        ("constant = 1485.0", 'constant = 1485.0\nsource = "speed"', "channels.speed.source"),
        ("constant = 1485.0", "constant = 1485.0\nresolution = 0.1", "channels.speed.resolution"),
        ("constant = 1485.0", "", "channels.speed.source"),
        ('source = "leakage_flow"', "constant = 1.5", "channels.leakage_flow.constant"),
    ],
)
def test_what_cannot_be_stated(tmp_path: Path, before: str, after: str, key: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_motor(tmp_path, STATED.replace(before, after))
    assert [fault.key for fault in caught.value.faults] == [key]
