"""The reasons of `quality`: each that a night can have is documented, and no other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.cli.reference import table_reference
from pipeline.night.fit_night import fit_night
from pipeline.schema import QUALITY_REASONS
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, night_of, operate, raw

COUNTED = 'counts = "cumulative"\nvolume_per_count_cm3 = 1.0\n'
ALL_RULES = """
[override.cleaning]
refuse_transients = true
[override.transport_delay]
mode = "fixed"
fixed_s = 2.0
lagging = ["oil_temperature"]
[override.windows]
longest_gap_s = 60.0
"""
BY_HAND = """
[periods]
training = [[2026-03-01T22:00:00Z, 2026-03-01T22:20:00Z]]
"""


def reasons_of(folder: Path, text: str) -> set[str]:
    spec = load_motor(folder, text)
    operation = operate()
    values = operation.channels(operation.flow(spec.motor(NIGHT, "none")))
    if spec.file.channels["leakage_flow"].counts:
        values["leakage_flow"] = np.floor(np.cumsum(values["leakage_flow"]) * 1000.0 / 60.0)
    outcome = fit_night(spec, night_of(), raw(operation.time_us, values), {})
    return {row["reason"] for row in outcome.rows["quality"]}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    units = {
        "pressure_difference": "bar",
        "oil_temperature": "degC",
        "speed": "rpm",
        "leakage_flow": "count",
    }
    counted = motor_toml("M1", units=units).rstrip("\n") + "\n" + COUNTED + ALL_RULES
    folder = tmp_path_factory.mktemp
    return reasons_of(folder("all"), counted) | reasons_of(
        folder("by_hand"), motor_toml("M1", more=BY_HAND)
    )


def test_every_reason_is_documented_and_no_other(found: set[str]) -> None:
    assert found <= QUALITY_REASONS.keys()
    # Only where a channel's config names a column of qualities.
    assert QUALITY_REASONS.keys() - found <= {"bad_quality"}


def test_they_stand_on_the_page() -> None:
    page = table_reference().split("## quality")[1].split("\n## ")[0]
    for name, reason in QUALITY_REASONS.items():
        assert f"- `{name}`: {reason.meaning}.\n" in page
