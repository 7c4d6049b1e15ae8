"""Nights whose trends are made anew."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.config.settings import Conditions
from pipeline.store.state import open_state
from pipeline.trends.course import Course
from pipeline.trends.decisions import Decision
from pipeline.trends.tasks import (
    NewestNight,
    Record,
    circuit_of,
    note_touched,
    read_records,
    trend_hash,
    with_spans,
    write_record,
)
from tests.pipeline.trends.nights import event, motor, named, night_of, reset


def test_a_motor_whose_flow_is_all_flushing_has_no_leakage_by_any_oil() -> None:
    watch = SimpleNamespace(frozen_leakage_at=lambda *_: 0.0)
    baseline = SimpleNamespace(own=Conditions(100.0, 50.0, 30.0), end=night_of(7), own_leakage=0.0)
    course: Any = SimpleNamespace(
        watch=watch,
        baseline=baseline,
        nights=SimpleNamespace(place_from=lambda _: 7),
        drives_at=lambda *_: np.zeros(1),
    )
    assert Course.first_leakage(course, 20) == 0.0


# Which nights

SPECS = (named(motor(), "A", "t"), named(motor(), "B", "t"))
OTHER_OIL = (named(motor(), "A", "t", [event(20, "oil_change", oil="vg46")]), SPECS[1])
RESET = reset(20, motor_id="A")
ALL = (dt.date.min, night_of(39))


def span(first: int, last: int = 39) -> tuple[dt.date, dt.date]:
    return night_of(first), night_of(last)


@pytest.mark.parametrize(
    ("last", "changed", "decisions", "specs", "expected"),
    [
        pytest.param(None, {"A": 0, "B": None}, (), SPECS, {"A": ALL, "B": ALL}, id="at first"),
        pytest.param(
            37, {"A": 38, "B": None}, (), SPECS, {"A": span(38), "B": span(38)}, id="new nights"
        ),
        pytest.param(
            39, {"A": 20, "B": None}, (), SPECS, {"A": span(20), "B": span(20)}, id="a late log"
        ),
        pytest.param(
            39, {"A": None, "B": None}, (RESET,), SPECS, {"A": ALL}, id="a reset: that motor"
        ),
        pytest.param(
            39,
            {"A": None, "B": None},
            (replace(RESET, kind="acknowledged"),),
            SPECS,
            {},
            id="an acknowledgement",
        ),
        pytest.param(
            35, {"A": 30}, (), SPECS, {"A": span(30), "B": span(30, 35)}, id="not asked for"
        ),
        pytest.param(
            39, {"A": 20, "B": None}, (), OTHER_OIL, {"A": ALL}, id="settings of its own: no other"
        ),
    ],
)
def test_which_nights_are_to_be_made(
    tmp_path: Path,
    last: int | None,
    changed: dict[str, int | None],
    decisions: tuple[Decision, ...],
    specs: tuple[object, ...],
    expected: dict[str, tuple[dt.date, dt.date]],
) -> None:
    asked = {name: None if place is None else night_of(place) for name, place in changed.items()}
    assert to_be_made(tmp_path, asked, last, decisions, specs) == expected


def to_be_made(
    output: Path,
    changed: dict[str, dt.date | None],
    last: int | None,
    decisions: tuple[Decision, ...] = (),
    specs: tuple[object, ...] = SPECS,
    touched: tuple[tuple[str, dt.date], ...] = (),
) -> dict[str, tuple[dt.date, dt.date]]:
    """Spans of nights to be made, of motors whose trends are published up to a last one."""
    with open_state(output) as state:
        for spec in SPECS if last is not None else ():
            write_record(state, spec.motor_id, Record(trend_hash(spec, ()), night_of(last)))
        note_touched(state, touched)
        circuit = circuit_of(specs, decisions, read_records(state), {})
    motors = with_spans(circuit, changed, NewestNight(night_of(39)))
    asked = (motor for motor in motors if motor.first is not None)
    return {motor.spec.motor_id: (motor.first, motor.until) for motor in asked}


def test_what_a_broken_run_left_is_done_by_the_next(tmp_path: Path) -> None:
    touched = (("B", night_of(25)), ("B", night_of(31)), ("C", night_of(0)))
    spans = to_be_made(tmp_path, {"A": None, "B": None}, 39, touched=touched)
    assert spans == {"A": span(25), "B": span(25)}
