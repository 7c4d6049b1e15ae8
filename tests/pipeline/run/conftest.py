"""A motor whose logs are written and run in a folder of the test's own."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pipeline.workshop import Workshop


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return Workshop.at(tmp_path)
