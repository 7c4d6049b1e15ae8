"""A fleet with a made baseline: no nightly run is needed for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.look import look as module
from pipeline.trends.record import Record
from tests.pipeline.look.fleet import TODAY, Growing, configured, made_baseline
from tests.pipeline.workshop import DAY


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Growing:
    """One motor whose last published night ends before today's log begins."""
    made = configured(tmp_path / "fleet")
    baseline = made_baseline(made.fleet.motors[0])
    record = Record("made", TODAY - DAY)
    monkeypatch.setattr(module, "read_record", lambda *_: record)
    monkeypatch.setattr(module, "baseline_of", lambda *_: baseline)
    return made
