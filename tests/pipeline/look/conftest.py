"""A fleet with a made baseline: no nightly run is needed for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.look import look as module
from pipeline.look.baseline import LookBaseline
from pipeline.trends.nights.trend_record import Record
from tests.pipeline.look.fleet import TODAY, Growing, configured, made_baseline
from tests.pipeline.workshop import DAY


@pytest.fixture(scope="session")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> LookBaseline:
    return made_baseline(configured(tmp_path_factory.mktemp("made")).fleet.motors[0])


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, baseline: LookBaseline) -> Growing:
    """One motor whose last published night ends before today's log begins."""
    made = configured(tmp_path / "fleet")
    record = Record("made", TODAY - DAY)
    monkeypatch.setattr(module, "read_record", lambda *_: record)
    monkeypatch.setattr(module, "baseline_of", lambda *_: baseline)
    return made
