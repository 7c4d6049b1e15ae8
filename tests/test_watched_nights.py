"""The yardstick of the watch: its nights, its truths, its charts, and a cell from end to end."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks import guard
from benchmarks.watch import stored
from benchmarks.watch.cb560 import FITTED
from benchmarks.watch.cells import NOTHING, RIG, cells, change
from benchmarks.watch.foreign import MACHINES
from benchmarks.watch.outcomes import TRIAL, outcome
from benchmarks.watch.rivals import chart
from benchmarks.watch.simulator import Duty, State, history
from benchmarks.watch.tables import readme, tables

CELLS = cells()
README = Path(__file__).parent.parent / "README.md"


def test_a_seed_draws_the_same_operating_point_and_errors_whatever_changes() -> None:
    same = history(FITTED, NOTHING.course, (2,), 3)
    changed = history(FITTED, change(1, gain=1.06, balance_sleeve=3.0), (2,), 3)
    more = history(FITTED, change(1, gain=1.06), (2,), 3)
    for night in range(3):
        assert np.array_equal(same.nights[night].drives, changed.nights[night].drives)
        assert np.array_equal(same.nights[night].conditions, changed.nights[night].conditions)
    assert np.array_equal(same.nights[0].flow, changed.nights[0].flow)
    assert more.nights[2].flow == pytest.approx(1.06 * same.nights[2].flow)
    assert more.change == pytest.approx([0.0, 0.06, 0.06])
    assert changed.change[2] > 0.2


def test_a_sensor_that_reads_low_changes_the_flow_at_the_conditions_as_read() -> None:
    low = history(FITTED, change(1, reads_high_c=-3.0), (3,), 3)
    thinner = history(FITTED, change(1, viscosity=0.88), (3,), 3)
    # An oil of VG 68 is some 12 % thinner at 58 °C than at 55 °C.
    assert low.newest_night[1:] == pytest.approx(thinner.newest_night[1:], abs=0.02)


# Gaps and all flow [l/min] at 200 bar, 50 °C and 6 rpm, and the power of the viscosity, by hand.
AT = (200.0, 50.0, 6.0)
BY_HAND = {
    "mill": (
        0.18 * 229.0 / (0.0573 * math.exp(962.0 / 148.7)),
        0.02 * 6.0 + 0.016 * math.sqrt(214.5),
        1.0,
    ),
    "winch": (
        0.125 * 1.015**3 * 200.0 / (47.0 * math.exp(-0.205 + 0.003 + 0.34)),
        0.0034 * 200.0**1.5 / (47.0 * math.exp(-0.205 + 0.003 + 0.34)),
        1.0,
    ),
    "conveyor": (
        0.062 * 200.0**1.15 / (60.0 * math.exp(5150.0 * (1 / 323.15 - 1 / 313.15))) ** 0.85,
        0.0016 * 6.0**1.3,
        0.85,
    ),
}


@pytest.mark.parametrize("name", MACHINES)
def test_what_is_true_of_a_machine_is_what_its_physics_says(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def steady(_: object, __: object, nights: int, ___: object) -> Duty:
        return Duty(*(np.full((360, nights), value) for value in AT))

    machine, (gaps, rest, power) = MACHINES[name], BY_HAND[name]
    monkeypatch.setattr(type(machine), "duty", steady)
    churning = 0.0025 * 6.0 if name == "winch" else 0.0
    wear, viscosity, gain = np.array([[1, 1.25, 1, 1], [1, 1, 0.8, 1], [1, 1, 1, 1.06]])
    state = State(wear=wear, viscosity=viscosity, gain=gain)
    watched = history(machine, lambda _: state, (4,), 4)
    thinned = gaps + (rest if name == "winch" else 0.0)
    whole = gaps + rest + churning
    expected = [0.0, 0.25 * gaps / whole, (0.8**-power - 1.0) * thinned / whole, 0.06]
    assert watched.change == pytest.approx(expected)
    assert watched.newest_night == pytest.approx(expected)


def test_every_cell_can_be_made() -> None:
    for cell in CELLS.values():
        if cell.group != RIG:
            for course in cell.make((5,), 2):
                assert [night.flow.min() >= 0.0 for night in course.nights] == [True, True]
                assert course.change.shape == course.newest_night.shape == (2,)


def test_a_break_stands_in_all_tables_that_have_it() -> None:
    cell = CELLS["wear; a sleeve breaks: its flow × 3; as modelled; 8"]
    outcomes = {cell.key: [outcome(cell, 0, TRIAL, {})]}
    rows = {table.name: table.rows for table in tables(CELLS, outcomes)}
    (row,) = rows["reported changes"]
    assert row["nights"] in ("1 (1)", "2 (2)", "3 (3)")
    assert row["names"] == "1/0/0"
    assert rows["since and size"]
    assert rows["probability"]
    assert not rows["false alarms"]


def test_the_readme_has_the_table_that_is_printed() -> None:
    assert readme(CELLS, stored()).markdown() in README.read_text("utf-8")


def test_a_chart_counts_in_the_scatter_of_its_baseline() -> None:
    change = np.array([0.9, 1.0, 1.1, 1.4, 1.0]) - 1.0
    assert chart(change, 3) == pytest.approx([-1.0, 0.0, 1.0, 4.0, 0.0])
    # A moving mean of weight w scatters by √(w / (2 − w)); 0.5: by 0.577.
    assert chart(change, 3, 0.5)[3:] == pytest.approx(np.array([2.0, 1.0]) * np.sqrt(3.0))


# The guard against growing slow


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
