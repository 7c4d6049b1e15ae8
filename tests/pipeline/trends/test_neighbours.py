"""Decisions on one motor do not change what was reported of the others of its oil circuit."""

from __future__ import annotations

import datetime as dt
import shutil
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any
from unittest.mock import patch

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pipeline.schema import Table
from pipeline.trends import circuits, stage
from pipeline.trends.figures.indicators import DEVIATION
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import History
from pipeline.trends.nights.tonight import Tonight
from pipeline.trends.rows import alarm_rows
from pipeline.trends.states.standing import Standing
from tests.pipeline.trends.nights import (
    OIL,
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

SPEC = motor()
# Nights in all, and the last that was told before something is said.
N, LAST = 62, 55
# Good nights of a baseline that serves.
BASELINE = 15
EVENTS = {"overhaul": None, "motor_exchanged": None, "oil_change": SPEC.file.oil}
SEVERITY = {"warning": 1, "alarm": 2}


@dataclass(frozen=True)
class Read:
    """A motor's nights as `read_nights` gives them."""

    history: History
    published: list[Row]
    filter_from: dt.date = dt.date.max

    def keep(self, *_: object) -> None:
        """Nothing is kept."""


def up_to(history: History, last: int) -> History:
    """Its nights up to a place."""
    words = {place: one for place, one in history.words.items() if place <= last}
    return replace(history, records=history.records[: last + 1], words=words)


def states(standing: Standing, places: Sequence[int]) -> Iterator[Row]:
    """Instead of whole rows of `trends`: each state, and what the others did to the last bit."""
    for place in places:
        for name, of_nights in standing.states.items():
            peers = standing.peers if name == DEVIATION else None
            others = "" if peers is None else float(peers.others[place]).hex()
            yield standing.key(place) | {
                "indicator": name,
                "state": of_nights[place],
                "others": others,
            }


@dataclass
class Circuit:
    """Runs over a circuit whose nights need no table, and what they have told."""

    folder: Path
    histories: dict[str, History]
    said: tuple[Decision, ...] = ()
    told: Told = field(default_factory=dict)

    def run(self, last: int, changed: Mapping[str, int] = MappingProxyType({})) -> list[Row]:
        """A run as of a night; returns the new rows of `alarms` of all but the first motor.

        By motor, the first night whose rows are others than in the run before.
        """
        said = {
            name: tuple(one for one in self.said if one.motor_id == name) for name in self.histories
        }
        read = {
            name: Read(replace(up_to(one, last), decisions=said[name]), self.alarms_of(name))
            for name, one in self.histories.items()
        }
        task = stage.TrendTask(
            tuple(
                circuits.Circuit.of(self.folder, group, self.said)
                for group in circuits.circuits_of(one.spec for one in self.histories.values())
            ),
            self.folder,
            # What is staged is what the next run reads.
            self.folder,
            {name: night_of(changed[name]) if name in changed else None for name in read},
            Tonight(night_of(last)),
        )
        with (
            patch.object(stage, "read_nights", lambda *_: read),
            patch.object(stage, "stage", self._take),
            # Neither is any reason for a state, and both take long.
            patch.object(stage, "trend_rows", states),
            patch.object(stage, "change_point_rows", lambda *_: ()),
            patch.object(alarm_rows, "path_behind", lambda *_: None),
        ):
            outcome = stage.run_trends(task)
        assert outcome.failures == {}
        return [row for row in outcome.alarms if row["motor_id"] != "M1"]

    def _take(self, path: Path, tables: Mapping[Table, Mapping[dt.date, list[Row]]]) -> None:
        self.told |= {
            (path.stem, table.name, night): rows
            for table, nights in tables.items()
            for night, rows in nights.items()
        }

    def alarms_of(self, name: str) -> list[Row]:
        """The published rows of `alarms` of a motor."""
        of_motor = (rows for key, rows in self.told.items() if key[:2] == (name, "alarms"))
        return [row for rows in of_motor for row in rows]

    def of_others(self) -> Told:
        """Rows reported of all motors but the first."""
        return {key: rows for key, rows in self.told.items() if key[0] != "M1"}

    def severities_of_others(self) -> dict[tuple[str, str], list[int]]:
        """Severity of each night, by motor and indicator."""
        found = defaultdict(list)
        for (name, table, _), rows in sorted(self.of_others().items()):
            for row in rows if table == "trends" else ():
                found[name, row["indicator"]].append(SEVERITY.get(row["state"], 0))
        return found


@dataclass(frozen=True)
class Story:
    """Events on motors of one tank, and an entry for the first."""

    # Night in which the oil changes, and the resulting rise of every path of every motor.
    oil: tuple[int, float]
    exchanged: tuple[int, float]  # the same for the first motor alone
    # By motor: path, True if sudden, first night, size.
    wear: tuple[tuple[tuple[str, bool, int, float], ...], ...]
    # said, of: entry for the first motor after the last reported night, and the night it concerns.
    said: str
    of: int

    def histories(self) -> dict[str, History]:
        """The motors' nights."""
        motors = []
        for number, wear in enumerate(self.wear, start=1):
            exchanged = step(N, *self.exchanged) if number == 1 else np.ones(N)
            factors = {OIL: step(N, *self.oil)} | dict.fromkeys(PATHS, exchanged)
            for path, sudden, at, size in wear:
                factors[path] = factors[path] * (step if sudden else ramp)(N, at, size)
            motors.append(Nights(named(SPEC, f"M{number}", "tank"), N, factors, seed=number))
        return histories(*motors)

    def tell(self, circuit: Circuit) -> None:
        """Say it."""
        if self.said in EVENTS:
            dated = event(self.of, self.said, oil=EVENTS[self.said])
            spec = named(SPEC, "M1", "tank", [dated])
            circuit.histories["M1"] = replace(circuit.histories["M1"], spec=spec)
        elif self.said == "acknowledged":
            circuit.said = (replace(reset(self.of), kind="acknowledged"),)
        else:
            circuit.said = (reset(self.of, self.said),)


WEAR = st.tuples(
    st.sampled_from(PATHS), st.booleans(), st.integers(30, N - 2), st.sampled_from([0.2, 0.5, 1.2])
)
STORIES = st.builds(
    Story,
    oil=st.tuples(st.integers(32, N), st.sampled_from([-0.2, 0.2, 0.4])),
    exchanged=st.tuples(st.integers(20, N), st.sampled_from([-0.3, 0.3])),
    wear=st.lists(st.lists(WEAR, max_size=2).map(tuple), min_size=2, max_size=4).map(tuple),
    said=st.sampled_from(["", "K_balance_sleeve", "acknowledged", *EVENTS]),
    of=st.integers(3, LAST + 1),
)


# The second motor of the demo's mill: a piston that wears, and a step of the sleeve in the first.
ALARMED = Story(
    oil=(N, 0.2),
    exchanged=(N, 0.3),
    wear=((("balance_sleeve", True, 45, 0.5),), (("balance_piston", False, 33, 1.2),)),
    said="",
    of=45,
)


@settings(max_examples=3, derandomize=True)
@example(ALARMED)
@given(STORIES)
def test_what_is_said_of_a_motor_moves_nothing_that_the_others_were_told(story: Story) -> None:
    with TemporaryDirectory() as folder:
        one, other = (Path(folder) / name for name in ("with", "without"))
        one.mkdir()
        circuit = Circuit(one, story.histories())
        circuit.run(LAST)
        shutil.copytree(one, other)
        without = Circuit(other, dict(circuit.histories), told=dict(circuit.told))
        story.tell(circuit)
        assert circuit.run(LAST) == []
        assert circuit.of_others() == without.of_others()
        # In the nights to come nothing is closed, and nothing is taken back that would have stood,
        # unless the first motor has something new to say: it has a baseline again.
        assert [row for row in circuit.run(N - 1) if row["way"] == "recomputed"] == []
        without.run(N - 1)
        if story.of + BASELINE >= N:
            stands = circuit.severities_of_others()
            for key, would_stand in without.severities_of_others().items():
                told = np.minimum.accumulate(would_stand[LAST:])
                assert np.all(stands[key][LAST:] >= told)
        # What was told is told again where all nights are made anew.
        before = circuit.of_others()
        assert circuit.run(N - 1, dict.fromkeys(circuit.histories, 0)) == []
        assert circuit.of_others() == before


def test_another_oil_dated_back_makes_that_motors_figures_anew_and_nobody_elses(
    tmp_path: Path,
) -> None:
    circuit = Circuit(tmp_path, ALARMED.histories())
    circuit.run(LAST)
    before = circuit.of_others()
    spec = named(SPEC, "M1", "tank", [event(45, "oil_change", oil="vg46")])
    circuit.histories |= histories(Nights(spec, N, seed=7))
    assert circuit.run(LAST, {"M1": 45}) == []
    assert circuit.of_others() == before
    assert circuit.run(N - 1) == []
    alarms = {row["state"] for row in circuit.told["M2", "trends", night_of(N - 1)]}
    assert "alarm" in alarms


def test_a_late_log_of_one_motor_may_close_what_another_was_told(tmp_path: Path) -> None:
    """It shows that the oil has moved both."""
    wear = Story(oil=(45, 0.25), exchanged=(N, 0.3), wear=((), ()), said="", of=0).histories()
    first = wear["M1"]
    silent = frozenset(range(45, N))
    late = histories(Nights(first.spec, N, absent=silent), tonight=N - 1)["M1"]
    circuit = Circuit(tmp_path, wear | {"M1": late})
    told = circuit.run(LAST)
    raised = {row["to_state"] for row in told if row["night"] > night_of(45)}
    assert raised
    assert raised <= set(SEVERITY)
    circuit.histories["M1"] = first
    closed = circuit.run(LAST, {"M1": 45})
    assert {row["to_state"] for row in closed} == {"common_cause"}
    assert circuit.run(LAST) == []
