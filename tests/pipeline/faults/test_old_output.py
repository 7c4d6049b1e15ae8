"""An output of an earlier version is put aside: the first run begins anew from the logs."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store.state import STATE_FILE
from pipeline.trends.nights.decisions import read_decisions
from tests.pipeline.faults.conftest import say
from tests.pipeline.faults.fleet import MOTORS, TinyFleet, check_tables
from tests.pipeline.remembered import LASTING

pytestmark = pytest.mark.usefixtures("_quick")


def test_it_is_put_aside_and_made_anew(
    tiny_fleet: TinyFleet, output: Path, caplog: pytest.LogCaptureFixture
) -> None:
    say(output)
    with closing(sqlite3.connect(output / STATE_FILE)) as state:
        state.execute("PRAGMA user_version = 1")
    with pytest.raises(StoreError, match="makes it anew from the logs") as refused:
        read_decisions(output)
    assert refused.value.code == "store_older"
    result = tiny_fleet.run(output)
    assert "put aside in old-1" in caplog.text
    assert (result.n_nights, result.damage, result.failed) == (2 * len(MOTORS), (), ())
    check_tables(output, tiny_fleet.after)
    assert read_decisions(output) == ()
    assert {path.name for path in output.iterdir()} == LASTING | {"old-1"}
    assert {"tables", "views.sql"} < {path.name for path in (output / "old-1").iterdir()}
    assert tiny_fleet.run(output).n_nights == 0
    assert not (output / "old-2").exists()
