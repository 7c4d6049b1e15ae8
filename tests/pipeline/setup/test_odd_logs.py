"""Commands over logs that hold nothing of use: words and a stated exit code, never a traceback."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.pipeline.calling import Call, Called
from tests.pipeline.simulated import CANONICAL, NIGHT, motor_toml, operate, write_log
from tests.pipeline.workshop import Workshop

Values = NDArray[np.float64]
AT = np.arange(1200)
STAMPS = operate(minutes=20.0).time_us
# Values by kind of nonsense.
ODD: dict[str, Values] = {
    "constant": np.full(1200, 1.5),
    "nan": np.full(1200, np.nan),
    "infinite": np.full(1200, np.inf),
    "largest": np.where(AT % 2, 1.7e308, -1.7e308),
    "two values": AT % 2 * 1.0,
    "one sample": np.where(AT == 600, 1.5, np.nan),
}
IN_FULL = ("largest", "two values", "one sample")
TIMES = {
    "sound": STAMPS,
    "all alike": np.full_like(STAMPS, STAMPS[0]),
    "backwards": STAMPS[::-1],
    "uneven": STAMPS + np.cumsum(AT % 7 == 0) * 10**7,
}
COUNTED = 'unit = "count"\nvolume_per_count_cm3 = 1.0'
LABEL = NIGHT.isoformat()


def write(shop: Workshop, kind: str, rows: int = 1200, times: str = "sound") -> Path:
    operation = operate(minutes=20.0)
    sound = operation.channels(operation.flow(shop.task().spec.motor(NIGHT, "none")))
    values = {name: ODD.get(kind, sound[name])[:rows] for name in CANONICAL}
    log = shop.logs / f"{LABEL}.parquet"
    write_log(log, TIMES[times][:rows], values)
    return log


def words_of(called: Called) -> str:
    """Output of a command on both streams, checked to be plain words."""
    code, out, err = called
    assert code in (0, 1, 2)
    for word in ("Traceback", "Warning", "internal", "None"):
        assert word not in out + err
    return out + err


@pytest.mark.parametrize(
    ("kind", "rows", "times", "counted"),
    [
        *(
            pytest.param(
                *(kind, 1200, "sound", kind == "infinite"),
                marks=[pytest.mark.full] * (kind in IN_FULL),
            )
            for kind in ODD
        ),
        *(("sound", rows, "sound", True) for rows in (1, 31)),
        *(("sound", 1200, times, False) for times in ("all alike", "backwards", "uneven")),
    ],
)
def test_check_and_init_of_any_log(
    tmp_path: Path, call: Call, kind: str, rows: int, times: str, counted: bool
) -> None:
    shop = Workshop.at(tmp_path)
    motor = motor_toml("M1", "MINI")
    shop.take(motor.replace('unit = "l/min"', COUNTED) if counted else motor)
    log = write(shop, kind, rows, times)
    text = words_of(call("check", shop.fleet))
    assert all(f"\n{name}\t" in text for name in CANONICAL)
    assert "\tspeed\tspeed\t" in words_of(call("init", log))


def test_every_command_over_a_night_of_nothing(tmp_path: Path, call: Call) -> None:
    shop = Workshop.at(tmp_path)
    shop.take(motor_toml("M1", "MINI"))
    write(shop, "nan")
    for command in ("fit-fleet", "report"):
        words_of(call(command, shop.fleet))
    words_of(call("explain", shop.fleet, "M1", LABEL))
    # `status` knows of the motor that it knows nothing.
    shown = words_of(call("status", shop.fleet)).splitlines()[1].split("\t")
    assert shown[:6] == ["M1", "insufficient", "unknown", "unknown", "", "Wait for more nights."]
