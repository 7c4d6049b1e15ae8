"""The guard against growing slow: its words, and all of its parts."""

from __future__ import annotations

import json

import pytest

from benchmarks import guard


def test_twenty_percent_more_is_a_warning_and_twice_as_much_fails(
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = {"a": 10.0, "b": 10.0, "c": 10.0}
    assert guard.compare({"a": 11.9, "b": 12.1, "c": 4.0}, before) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["ok", "warning", "ok"]
    assert guard.compare({"a": 10.0, "b": 20.1}, before) == 1
    assert "FAILED  b: 20.10, +101 %" in capsys.readouterr().out
    assert guard.compare({"new": 99.0}, {}) == 0  # compared with nothing
    assert capsys.readouterr().out == "ok      new: 99.00, +0 %\n"


@pytest.mark.full
def test_it_measures_what_the_committed_results_name() -> None:
    committed = json.loads(guard.COMMITTED.read_text("utf-8"))
    assert all(ratio > 0 for ratio in committed.values())
    assert guard.measured().keys() == committed.keys()
