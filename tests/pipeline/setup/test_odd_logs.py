"""Commands over logs that hold nothing of use: words and a stated exit code, never a traceback."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.pipeline.calling import Call, Called
from tests.pipeline.simulated import CANONICAL, NIGHT, motor_toml, operate, write_log
from tests.pipeline.workshop import Workshop

Values = NDArray[np.float64]
Times = NDArray[np.int64]

ODD: Mapping[str, Callable[[Values], Values]] = {
    "sound": lambda value: value,
    "constant": lambda value: np.full_like(value, value[0]),
    "zero": np.zeros_like,
    "nan": lambda value: np.full_like(value, np.nan),
    "infinite": lambda value: np.full_like(value, np.inf),
    "refused": lambda value: value * 1e12,
    "largest": lambda value: np.where(np.arange(len(value)) % 2, 1.7e308, -1.7e308),
    "smallest": lambda value: value * 1e-310,
    "two values": lambda value: np.arange(len(value)) % 2 * 1.0,
    "one sample": lambda value: np.where(np.arange(len(value)) == len(value) // 2, value, np.nan),
}
TIMES: Mapping[str, Callable[[Times], Times]] = {
    "sound": lambda time_us: time_us,
    "one": lambda time_us: np.full_like(time_us, time_us[0]),
    "backwards": lambda time_us: time_us[::-1],
    "uneven": lambda time_us: time_us + np.cumsum(np.arange(len(time_us)) % 7 == 0) * 10**7,
}
COUNTED = 'unit = "count"\ncounts = "cumulative"\nvolume_per_count_cm3 = 1.0'
OPERATION = operate(minutes=20.0)
LABEL = NIGHT.isoformat()


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop.at(tmp_path_factory.mktemp("workshop"))


def write(
    workshop: Workshop, odd: Mapping[str, str], rows: int = 1200, times: str = "sound"
) -> Path:
    flow = OPERATION.flow(workshop.task().spec.motor(NIGHT, "none"))
    values = OPERATION.channels(flow)
    log = workshop.logs / f"{LABEL}.parquet"
    write_log(
        log,
        TIMES[times](OPERATION.time_us[:rows]),
        {name: ODD[odd.get(name, "sound")](value[:rows]) for name, value in values.items()},
    )
    return log


def said(called: Called) -> str:
    """Output of a command on both streams, checked to be plain words."""
    code, out, err = called
    assert code in (0, 1, 2)
    for word in ("Traceback", "Warning", "internal", "None"):
        assert word not in out + err
    return out + err


@pytest.mark.parametrize(
    ("kind", "rows", "times", "counted"),
    [
        *((kind, 1200, "sound", False) for kind in ODD),
        ("infinite", 1200, "sound", True),
        *(("sound", rows, "sound", True) for rows in (1, 2, 29, 31)),
        *(("sound", 1200, times, False) for times in TIMES),
    ],
)
def test_check_of_any_log(
    workshop: Workshop, call: Call, kind: str, rows: int, times: str, counted: bool
) -> None:
    motor = motor_toml("M1", "MINI")
    workshop.take(motor.replace('unit = "l/min"', COUNTED) if counted else motor)
    log = write(workshop, dict.fromkeys(CANONICAL, kind), rows, times)
    text = said(call("check", workshop.fleet))
    assert all(f"\n{name}\t" in text for name in CANONICAL)
    assert "M1\tspeed\tspeed\t" in said(call("init", log)).replace("log\t", "M1\t")


@pytest.mark.parametrize("kind", ["constant", "nan", "one sample"])
def test_every_command_over_a_night_of_nothing(tmp_path: Path, call: Call, kind: str) -> None:
    workshop = Workshop.at(tmp_path)
    write(workshop, dict.fromkeys(CANONICAL, kind))
    assert "M1: insufficient_data" in said(call("fit-fleet", workshop.fleet))
    assert "insufficient_data" in said(call("fit", workshop.fleet, "M1", LABEL))
    assert "insufficient_data" in said(call("explain", workshop.fleet, "M1", LABEL))
    # `status` knows of the motor that it knows nothing.
    shown = said(call("status", workshop.fleet)).splitlines()[1].split("\t")
    assert shown[:6] == ["M1", "insufficient", "unknown", "unknown", "", "Wait for more nights."]
    found = said(call("check", workshop.fleet))
    assert ("none is kept" in found) == (kind != "one sample")
    assert "e+" not in found
