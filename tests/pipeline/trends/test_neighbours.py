"""What is said of one motor leaves alone what the others of its oil circuit were told."""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.decisions import Decision
from pipeline.schema import Table
from pipeline.trends import stage
from pipeline.trends.history import History
from pipeline.trends.record import note_touched, write_record
from pipeline.trends.trend_rows import trend_rows
from tests.pipeline.trends.nights import (
    PATHS,
    Nights,
    event,
    histories,
    motor,
    named,
    night_of,
    ramp,
    reset,
    step,
)

Row = dict[str, Any]
Told = dict[tuple[str, str, dt.date], list[Row]]

# Nights in all, the last that was told before something is said, and the first whose rows of
# `trends` are looked at as well.
N, LAST, LOOKED_AT = 62, 55, 46
SEVERITY = {"warning": 1, "alarm": 2}


@dataclass
class Known:
    """A motor's nights as `read_nights` gives them."""

    history: History
    published: list[Row]
    known: None = None

    def keep(self, *_: object) -> None:
        """Nothing is kept."""


@dataclass
class Circuit:
    """Runs over a circuit whose nights need no table, and what they have told."""

    folder: Path
    motors: Sequence[Nights]
    said: tuple[Decision, ...] = ()
    told: Told = field(default_factory=dict)

    def run(self, last: int, redone_from: int | None = None) -> list[Row]:
        """A run as of a night; returns the rows of `alarms` that are new."""
        found = histories(*self.motors, until=last, tonight=last)
        known = {name: Known(one, self.alarms(name)) for name, one in found.items()}
        first = None if redone_from is None else night_of(redone_from)
        task = stage.TrendTask(
            tuple(one.spec for one in self.motors),
            self.folder,
            self.folder,
            dict.fromkeys(found, first),
            night_of(last),
            self.said,
        )

        def looked_at(standing: stage.Standing, places: Sequence[int]) -> list[Row]:
            return list(trend_rows(standing, [one for one in places if one >= LOOKED_AT]))

        with (
            patch.object(stage, "read_nights", lambda *_: known),
            patch.object(stage, "stage", self._take),
            patch.object(stage, "trend_rows", looked_at),
        ):
            outcome = stage.run_trends(task)
        assert outcome.failures == {}
        for name, record in outcome.records.items():
            write_record(self.folder, name, record)
        return list(outcome.alarms)

    def _take(self, path: Path, table: Table, nights: Mapping[dt.date, list[Row]]) -> None:
        self.told |= {(path.stem, table.name, night): rows for night, rows in nights.items()}

    def alarms(self, name: str) -> list[Row]:
        """The published rows of `alarms` of a motor."""
        return [row for key, rows in self.told.items() if key[:2] == (name, "alarms") for row in rows]

    def of_others(self, last: int) -> Told:
        """What all motors but the first were told up to a night."""
        return {
            key: rows
            for key, rows in self.told.items()
            if key[0] != "M1" and key[2] <= night_of(last)
        }

    def severities(self, name: str) -> dict[str, list[int]]:
        """Severity of each looked-at night, by indicator."""
        found = defaultdict(list)
        for key in sorted(key for key in self.told if key[:2] == (name, "trends")):
            for row in self.told[key]:
                found[row["indicator"]].append(SEVERITY.get(row["state"], 0))
        return found


@st.composite
def tanks(draw: st.DrawFn) -> list[Nights]:
    """Motors on one tank: its oil may change, each may wear, the first may be another motor."""
    oil = step(N, draw(st.integers(32, N)), draw(st.sampled_from([-0.2, 0.2, 0.4])))
    exchanged = step(N, draw(st.integers(20, N)), draw(st.sampled_from([-0.3, 0.3])))
    motors = []
    for number in range(1, draw(st.integers(2, 4)) + 1):
        factors = {path: oil.copy() for path in PATHS}
        for path in draw(st.lists(st.sampled_from(PATHS), unique=True, max_size=2)):
            shape = draw(st.sampled_from([step, ramp]))
            size = draw(st.sampled_from([0.2, 0.5, 1.2]))
            factors[path] = factors[path] * shape(N, draw(st.integers(30, N - 2)), size)
        if number == 1:
            factors = {path: one * exchanged for path, one in factors.items()}
        motors.append(Nights(named(motor(), f"M{number}", "tank"), N, factors, seed=number))
    return motors


@st.composite
def sayings(draw: st.DrawFn) -> tuple[str, int]:
    """What is said of the first motor, and of which night: one that was told, or the next."""
    kind = draw(
        st.sampled_from(
            ["reset", "reset of a path", "acknowledged", "overhaul", "motor_exchanged", "oil_change"]
        )
    )
    return kind, draw(st.integers(3, LAST + 1))


def say(circuit: Circuit, kind: str, place: int) -> None:
    """Something is said of the first motor."""
    first, *others = circuit.motors
    if kind == "reset":
        circuit.said = (reset(place),)
    elif kind == "reset of a path":
        circuit.said = (reset(place, "K_balance_sleeve"),)
    elif kind == "acknowledged":
        circuit.said = (replace(reset(place), kind="acknowledged"),)
    else:
        oil = {"oil": first.spec.file.oil} if kind == "oil_change" else {}
        spec = named(first.spec, "M1", "tank", [event(place, kind, **oil)])
        circuit.motors = [replace(first, spec=spec), *others]


@settings(max_examples=12)
@given(tanks(), sayings())
def test_what_is_said_of_a_motor_moves_nothing_that_the_others_were_told(
    motors: list[Nights], saying: tuple[str, int]
) -> None:
    with TemporaryDirectory() as folder, TemporaryDirectory() as other:
        circuit = Circuit(Path(folder), motors)
        circuit.run(LAST)
        before = circuit.of_others(LAST)
        without = Circuit(Path(other), motors, told=dict(circuit.told))
        say(circuit, *saying)
        assert [row for row in circuit.run(LAST) if row["motor_id"] != "M1"] == []
        assert circuit.of_others(LAST) == before

