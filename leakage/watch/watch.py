"""The watch of a motor, night by night: pure, causal, and of fixed size however long the history.

Shiryaev–Roberts over a mixture of starts, shapes and causes (an e-detector; Shin, Ramdas and
Rinaldo 2022, arXiv 2203.03532): ln R beyond a limit shows a change. Ten nights later it is
adopted, and the watch goes on behind it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from functools import cache
from typing import Any, get_args, get_type_hints

import numpy as np

from leakage.arrays import Array
from leakage.watch import choices
from leakage.watch.adoption import (
    across_event,
    adopt,
    at_rest,
    detect_change,
    in_force_of,
    settling_change,
    shorten,
)
from leakage.watch.causes import ODD_NIGHTS
from leakage.watch.circuit import circuit_change
from leakage.watch.evidence import Sums
from leakage.watch.nights import Estimate, Machine, NightBlocks, Verdict, WatchSettings
from leakage.watch.odd_nights import channels_apart, with_misfit, without_apart
from leakage.watch.periods import Earlier, begin, new_period, with_new_wander
from leakage.watch.state import (
    WatchState,
    all_causes,
    change_in_force,
    mean_change,
    nights_beyond,
    on_first_baseline,
    reported_change,
    settle_event,
    with_model_error,
)

# Distance of operating conditions from the baseline's that is no chance.
OTHER_CONDITIONS = choices.OPERATING_FREE + choices.OPERATING_OTHER
# Fields of a state that are given, or made of the others.
NOT_STORED = ("machine", "settings", "sums", "causes")


@dataclass(frozen=True, slots=True)
class Watch:
    """A motor's watch after its newest night."""

    state: WatchState

    @classmethod
    def begin(
        cls, machine: Machine, nights: Sequence[NightBlocks], settings: WatchSettings
    ) -> Watch:
        """Return the watch after the nights of its baseline, in order."""
        return cls(begin(machine, nights, settings))

    @property
    def day(self) -> int:
        """The newest night."""
        return self.state.day

    def after(self, night: NightBlocks, earlier: Earlier) -> Watch:
        """Return the watch after the next night.

        `night`: Its blocks; later than all nights before. `earlier`: The nights from a day on up to
        this night, which are asked for where a baseline period begins.
        """
        misfit = self.state.baseline.misfit(night)
        state = with_night(with_misfit(self.state, night.day, misfit), night)
        if state.apart:
            # Nothing is learned of the motor by channels that do not belong together.
            return Watch(shorten(state))
        if self.state.apart:
            state = without_apart(state, self.state.apart[0], choices.MISFIT_NIGHTS)
        state = adopt(state)
        if state.is_settling:
            state = settling_change(state)
            if state.is_settling:
                return Watch(shorten(state))
        if state.crossing is not None and len(state.window) > choices.PERIOD_NIGHTS:
            state = settle_event(state)
        state = detect_change(with_new_wander(state))
        if not state.is_settling and state.period_from is not None:
            state = new_period(state, earlier)
        return Watch(shorten(at_rest(state)))

    def across_event(self, machine: Machine, day: int, spread: float) -> Watch:
        """Return the watch of nights from a day on, behind an event with the same motor (7c.6).

        `machine`: As it is behind it, with its oil. `spread`: Of the step that the event may make.
        """
        state = self.state
        if state.apart and np.any(state.window.days < state.apart[0]):
            state = without_apart(state, state.apart[0], 0)
        return Watch(across_event(state, machine, day, spread))

    def beside(self, others: Sequence[Watch]) -> Watch:
        """Return the watch that knows what the circuit's other motors did since its own change.

        Only while a change settles: afterwards its name stays.
        """
        in_force = self.state.in_force
        if not others or in_force is None or in_force.attribution is None:
            return self
        size, *changes = (motor.change_since(*in_force.change.dates) for motor in (self, *others))
        known = [change for change in changes if change is not None]
        circuit = None if size is None else circuit_change(size, known)
        named = in_force_of(
            self.state,
            self.state.evidence_now(),
            in_force.attribution,
            in_force.change.detected_on,
            # One that has changed again says nothing of then: what it said stands.
            circuit or in_force.circuit,
        )
        return Watch(replace(self.state, in_force=named))

    def verdict(self) -> Verdict:
        """Return what is known after the newest night."""
        state = self.state
        change = channels_apart(state) if state.apart else reported_change(state)
        limit = state.settings.limit
        return Verdict(
            state.day,
            # Nothing is detected where the interval holds 0: then the evidence does not reach it.
            state.evidence if change is not None else min(state.evidence, limit),
            limit,
            state.baseline.model_error,
            change,
            with_model_error(state, on_first_baseline(state, slice(-1, None))),
            mean_change(state),
            state.smallest,
            nights_beyond(state) > 0,
            max((misfit for misfit in state.misfits if misfit > 0.0), default=0.0),
            state.usual_misfit,
            bool((state.window.distance[-2:] > OTHER_CONDITIONS).all()),
        )

    def change_since(self, day: int, first: int, last: int) -> Estimate | None:
        """Return the leakage's change from a day on; None without nights on both sides (7c.5).

        The day is known as between two: the level of at most ten nights from the last on, less that
        of the ten before the first. An adopted change is in no window any more: it is the change
        where it may have begun then.
        """
        state, in_force = self.state, self.state.in_force
        if (
            in_force is not None
            and in_force.attribution is None
            and in_force.change.cause != ODD_NIGHTS
        ):
            change = change_in_force(state)
            assert change is not None
            _, lower, upper = change.dates
            days = choices.CIRCUIT_DAYS
            if lower - days <= day <= upper + days:
                return change.size
        place, most = state.place(last), choices.PRESENT_NIGHTS
        if not 0 < place < len(state.window):
            return None
        end = max(1, state.place(first))
        level = state.level_along(state.baseline.leakage_flows)
        return level.difference(slice(place, place + most), slice(max(0, end - most), end))

    def leakage_at(self, drives: Array, conditions: Array) -> Estimate:
        """Return flow at some conditions, by the level of the newest night, [l/min].

        `drives` are the flows a unit of each path's coefficient there, shape (p,), 0 for what is
        left out; `conditions` are temperature [°C], pressure [bar] and speed [rpm], shape (3,).
        """
        state, (row, flow) = self.state, self._row_at(drives, conditions)
        level, of_cause = state.level.mean(slice(-1, None)), float(row @ state.along)
        as_first = 1.0 + float(row @ (state.baseline.unknowns + state.level.around.mean))
        before, _ = state.sums.before(np.array([len(state.window)]), state.window)
        uncertain = float(row @ np.linalg.solve(before[0], row))
        grown = as_first + level.value * of_cause
        missed = choices.LEAKAGE_BY_LACK * state.baseline.lack_of_fit * grown
        variance = (of_cause * level.sd) ** 2 + uncertain + missed**2
        return Estimate(flow * grown, flow * math.sqrt(variance))

    def frozen_leakage_at(self, drives: Array, conditions: Array) -> float:
        """Return the same by the baseline alone, [l/min]."""
        row, flow = self._row_at(drives, conditions)
        return flow * (1.0 + float(row @ self.state.baseline.unknowns))

    def _row_at(self, drives: Array, conditions: Array) -> tuple[Array, float]:
        """Return what a unit of each unknown is of the flow at conditions, and that flow by θ."""
        columns = self.state.baseline.columns
        every = columns.all_drives(drives[None], conditions[None])
        expected = columns.expected(every)
        row: Array = columns.design(every, conditions[None], np.maximum(expected, 1e-12))[0]
        if columns.has_zero:
            row[-1] = 0.0
        return row, float(expected[0])

    def arrays(self) -> dict[str, Array]:
        """Return numbers to store, by name."""
        return _pack("state", self.state)

    @classmethod
    def of_arrays(
        cls, machine: Machine, settings: WatchSettings, arrays: Mapping[str, Any]
    ) -> Watch:
        """Return the watch that was stored."""
        stored = _unpack(WatchState, "state", arrays)
        causes = all_causes(machine, stored["baseline"], stored["undone"])
        sums = Sums.of(stored["window"], stored["wander"], causes.basis)
        return cls(WatchState(machine, settings, sums=sums, causes=causes, **stored))


def with_night(state: WatchState, night: NightBlocks) -> WatchState:
    """Return the state with a further night, of which nothing is detected yet."""
    information, score = state.baseline.information(night)
    distance = state.baseline.distance(night)
    window = state.window.with_night(night.day, information, score, distance)
    sums = state.sums.extend(window, state.wander, len(window) - 1)
    return replace(state, window=window, sums=sums, n_nights=state.n_nights + 1)


def _pack(name: str, part: Any) -> dict[str, Any]:
    """Return arrays of a dataclass and of those in it by name; all else as bytes of a text."""
    packed: dict[str, Any] = {}
    words: dict[str, Any] = {}
    for field in _parts_of(part.__class__):
        value, own = getattr(part, field), f"{name}.{field}"
        if isinstance(value, np.ndarray):
            packed[own] = value
        elif is_dataclass(value):
            packed |= _pack(own, value)
        else:
            words[field] = value
    return {name: np.frombuffer(json.dumps(words).encode(), dtype=np.uint8)} | packed


def _unpack(kind: Any, name: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a dataclass, by name."""
    values: dict[str, Any] = json.loads(bytes(arrays[name]))
    for field, part in _parts_of(kind).items():
        own, value = f"{name}.{field}", values.get(field)
        if isinstance(value, list):
            values[field] = tuple(value)
        elif field not in values:
            values[field] = part(**_unpack(part, own, arrays)) if part else arrays[own]
    return values


@cache
def _parts_of(kind: Any) -> dict[str, Any]:
    """Return the stored fields, and the dataclass that each is or may be; None of the others.

    Cached, as a night of a thousand motors asks for the same hints seven thousand times.
    """
    return {
        field: next((part for part in (hint, *get_args(hint)) if is_dataclass(part)), None)
        for field, hint in get_type_hints(kind).items()
        if field not in NOT_STORED
    }
