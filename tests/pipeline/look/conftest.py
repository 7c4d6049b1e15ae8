"""A fleet with a made watch: no nightly run is needed for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.look import look as module
from pipeline.look.comparison import NightsBefore
from tests.pipeline.look.fleet import Growing, configured, made_watch


@pytest.fixture(scope="session")
def before(tmp_path_factory: pytest.TempPathFactory) -> NightsBefore:
    return made_watch(configured(tmp_path_factory.mktemp("made")).spec)


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: NightsBefore) -> Growing:
    """One motor whose last published night ends before today's log begins."""
    made = configured(tmp_path / "fleet")
    monkeypatch.setattr(module, "nights_before", lambda *_: before)
    return made
