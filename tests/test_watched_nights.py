"""The yardstick of the watch: its nights, its truths, its charts, and a cell from end to end."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.results_file import stored
from benchmarks.watch.cb560 import FITTED, HEALTHY, SLEEVE, State, history
from benchmarks.watch.cells import FOREIGN, RIG, cells, step
from benchmarks.watch.foreign import Duty, Night
from benchmarks.watch.foreign import history as foreign_history
from benchmarks.watch.outcomes import TRIAL, outcome
from benchmarks.watch.rivals import chart
from benchmarks.watch.tables import parts, readme
from pipeline.arrays import Array

CELLS = cells()
README = Path(__file__).parent.parent / "README.md"


def test_a_seed_draws_the_same_operating_point_and_errors_whatever_changes() -> None:
    same = history(FITTED, lambda _: HEALTHY, 3, (2,))
    changed = history(FITTED, step(1, gain=1.06, paths={SLEEVE: 3.0}), 3, (2,))
    more = history(FITTED, step(1, gain=1.06), 3, (2,))
    for night in range(3):
        assert np.array_equal(same.nights[night].drives, changed.nights[night].drives)
        assert np.array_equal(same.nights[night].conditions, changed.nights[night].conditions)
    assert np.array_equal(same.nights[0].flow, changed.nights[0].flow)
    assert more.nights[2].flow == pytest.approx(1.06 * same.nights[2].flow)
    assert more.change == pytest.approx([0.0, 0.06, 0.06])
    assert changed.change[2] > 0.2


def test_a_sensor_that_reads_low_changes_the_flow_at_the_conditions_as_read() -> None:
    low = history(FITTED, step(1, reads_high_c=-3.0), 3, (3,))
    thinner = history(FITTED, lambda night: State(viscosity=0.88 if night else 1.0), 3, (3,))
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


@pytest.mark.parametrize("name", FOREIGN)
def test_what_is_true_of_a_machine_is_what_its_physics_says(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def steady(_: object, __: object, load: Array, ___: object) -> Duty:
        bar, celsius, rpm = (np.full((360, len(load)), one) for one in AT)
        return bar, celsius, rpm

    machine, (gaps, rest, power) = FOREIGN[name], BY_HAND[name]
    monkeypatch.setattr(type(machine), "operating_point", steady)
    churning = 0.0025 * 6.0 if name == "winch" else 0.0
    nights = [Night(), Night(wear=1.25), Night(viscosity=0.8), Night(meter=1.06)]
    found = foreign_history(machine, nights.__getitem__, 4, (4,))
    thinned = gaps + (rest if name == "winch" else 0.0)
    whole = gaps + rest + churning
    expected = [0.0, 0.25 * gaps / whole, (0.8**-power - 1.0) * thinned / whole, 0.06]
    assert found.change == pytest.approx(expected)
    assert found.newest_night == pytest.approx(expected)


def test_every_cell_can_be_made() -> None:
    for cell in CELLS.values():
        assert all(cell.event.course(night) for night in range(cell.event.nights))
        if cell.group != RIG:
            for one in cell.make((5,), 2):
                assert [night.flow.min() >= 0.0 for night in one.nights] == [True, True]
                assert one.change.shape == one.newest_night.shape == (2,)


def test_a_break_is_told_in_all_tables_that_have_it() -> None:
    cell = CELLS["wear; a sleeve breaks: its flow × 3; as modelled; 8"]
    found = {cell.key: [outcome(cell, 0, TRIAL, {})]}
    tables = {part.heading: part.rows for part in parts(CELLS, found)}
    (row,) = tables["What was told"]
    assert row[5] in ("1 (1)", "2 (2)", "3 (3)")
    assert row[6] == "1/0/0"
    assert {"Since and size", "Probability"} < tables.keys()


def test_the_readme_has_the_table_that_is_printed() -> None:
    assert "\n".join(readme(CELLS, stored("watch"))) in README.read_text("utf-8")


def test_a_chart_counts_in_the_scatter_of_its_baseline() -> None:
    change = np.array([0.9, 1.0, 1.1, 1.4, 1.0]) - 1.0
    assert chart(change, 3) == pytest.approx([-1.0, 0.0, 1.0, 4.0, 0.0])
    # A moving mean of weight w scatters by √(w / (2 − w)); 0.5: by 0.577.
    assert chart(change, 3, 0.5)[3:] == pytest.approx(np.array([2.0, 1.0]) * np.sqrt(3.0))
