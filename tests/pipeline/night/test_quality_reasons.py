"""The reasons of `quality`: each that a night can have is documented, and no other."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.schema import QUALITY_REASONS
from tests.pipeline.night.noise_free import configured_flow, fit, refused_of
from tests.pipeline.simulated import CANONICAL, load_motor, motor_toml, operate
from tests.reference_pages import table_reference

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
    values = operation.channels(configured_flow(spec, operation))
    if spec.file.channels["leakage_flow"].counts:
        values["leakage_flow"] = np.floor(np.cumsum(values["leakage_flow"]) * 1000.0 / 60.0)
    return {reason for _, reason in refused_of(fit(spec, operation, values))}


def test_every_reason_is_documented_and_no_other(tmp_path: Path) -> None:
    counted = motor_toml("M1", units=CANONICAL | {"leakage_flow": "count"}) + COUNTED + ALL_RULES
    found = reasons_of(tmp_path / "all", counted)
    found |= reasons_of(tmp_path / "by_hand", motor_toml("M1", more=BY_HAND))
    assert found <= QUALITY_REASONS.keys()
    # Only where a channel's config names a column of qualities.
    assert QUALITY_REASONS.keys() - found <= {"bad_quality"}


def test_they_stand_on_the_page() -> None:
    page = table_reference().split("## quality")[1].split("\n## ")[0]
    for name, reason in QUALITY_REASONS.items():
        assert f"- `{name}`: {reason.meaning}.\n" in page
