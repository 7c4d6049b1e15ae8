"""The hash of what shapes the statistics, by night; its settings: `config/test_hashes.py`."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

from pipeline.config.hashes import model_hash
from tests.pipeline.simulated import (
    NIGHT,
    load_motor,
    motor_toml,
)


def test_model_hash_changes_with_the_oil_and_not_with_the_mode(tmp_path: Path) -> None:
    change = '[[events]]\ndate = 2026-03-02\nkind = "oil_change"\noil = "vg46"\n'
    spec = load_motor(tmp_path, motor_toml("M1", more=change))
    before, after = NIGHT - dt.timedelta(days=1), NIGHT
    hashes = {
        (night, mode): model_hash(spec, spec.motor(night, mode), night)
        for night in (before, after)
        for mode in ("none", "estimated")
    }
    assert hashes[before, "none"] == hashes[before, "estimated"] != hashes[after, "none"]
    assert len({hashes[after, mode] for mode in ("none", "estimated")}) == 1
