"""A motor's watch night by night: baseline periods, and what each night says."""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from leakage.watch import Estimate, NightBlocks, Verdict, Watch, WatchSettings
from leakage.watch.causes import NO_LEAKAGE, oil_spread
from leakage.watch.choices import LEAKAGE_BY_LACK, METER_SPREAD, SENSOR_SPREAD
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.settings import Conditions
from pipeline.trends.checkpoint import WATCHED, MotorCheckpoint, StoredWatch
from pipeline.trends.night_state import Baseline, NightState, with_state
from pipeline.trends.nights import BaselinePeriod, PublishedNights, period_at, read_blocks

# A leakage is estimated at conditions as far beyond those of the baseline period's blocks [°C, bar,
# rpm].
REACH = np.array([10.0, 20.0, 10.0])
OUT_OF_REACH = "the era's blocks do not reach these conditions"

# Spread of the step of events that carry a baseline across, but for a change of oil.
SPREADS = {"meter_changed": METER_SPREAD, "sensor_changed": SENSOR_SPREAD}
NOTHING_SEEN = np.full((2, 3), np.nan)


# To and from a checkpoint.
STORED_BASELINE = TypeAdapter(Baseline)


@dataclass(slots=True)
class Course:
    """A motor's nights, as far as its watch has taken them."""

    output: Path
    nights: PublishedNights
    periods: tuple[BaselinePeriod, ...]
    place: int  # of the next night
    period: BaselinePeriod
    figures: Array
    watch: Watch | None = None
    baseline: Baseline | None = None
    waiting: list[NightBlocks] = field(default_factory=list)
    # Lowest and highest block means of the baseline period, shape (2, 3).
    seen: Array = field(default_factory=lambda: NOTHING_SEEN)
    # Before the newest night, for the checkpoint: period, baseline, what it saw, and the watch.
    before: tuple[BaselinePeriod, Baseline, Array, Watch] | None = None
    # Flow a unit of each coefficient at some conditions, by oil and conditions.
    drives: dict[tuple[str, Conditions], Array | str] = field(default_factory=dict)

    @classmethod
    def of(cls, output: Path, nights: PublishedNights) -> Course | None:
        """Return a motor whose watch goes on from its checkpoint, or begins anew; None: neither."""
        if nights.beginning is None:
            return None
        periods, place = nights.periods(), nights.place_from(nights.beginning)
        figures = np.column_stack([nights.records[name] for name in WATCHED])
        course = cls(output, nights, periods, place, period_at(periods, max(place - 1, 0)), figures)
        stored = nights.checkpoint.watch if nights.resumes and nights.checkpoint else None
        if stored is not None:
            machine = nights.watch_columns.machine(nights.spec, dt.date.fromordinal(stored.day))
            course.watch = Watch.of_arrays(machine, watch_settings(nights.spec), stored.arrays)
            course.baseline = STORED_BASELINE.validate_python(stored.own["baseline"])
            course.seen = np.array(stored.own["seen"])
        return course

    @property
    def nights_to_come(self) -> tuple[dt.date, ...]:
        """Nights that the watch is to take."""
        return self.nights.labels[self.place :]

    @property
    def night(self) -> dt.date | None:
        """The night that the watch took last; None before the first."""
        return self.nights.labels[self.place - 1] if self.place else None

    @property
    def spec(self) -> MotorSpec:
        """The motor."""
        return self.nights.spec

    def step(self) -> None:
        """Give the watch the next night."""
        nights = self.nights
        self.before = None
        if self.watch is not None and self.baseline is not None:
            self.before = self.period, self.baseline, self.seen, self.watch
        if self.place in (self.period.first, self.period.end):
            self.period = period_at(self.periods, self.place)
            self.watch, self.baseline, self.waiting, self.seen = None, None, [], NOTHING_SEEN
        night = nights.labels[self.place]
        blocks = nights.blocks.get(night.toordinal())
        if blocks is not None:
            if self.watch is not None and (spread := self._spread(self.watch, night)):
                machine = nights.watch_columns.machine(self.spec, night)
                self.watch = self.watch.across_event(machine, blocks.day, spread)
            self._take(blocks)
        self.place += 1

    def _spread(self, watch: Watch, night: dt.date) -> float:
        """Return spread of the step of events since the watch's newest night; 0 without events."""
        before, file = dt.date.fromordinal(watch.day), self.spec.file
        spreads = [
            SPREADS[event.kind]
            for event in file.events
            if event.kind in SPREADS and before < event.date <= night
        ]
        if (filled := file.filled_on(night)) is not None and before < filled:
            at_c = watch.state.baseline.columns.temperature_c
            old, new = (self.spec.oil_on(label).oil() for label in (before, night))
            spreads.append(oil_spread(old, new, at_c))
        return math.hypot(*spreads)

    def _take(self, blocks: NightBlocks) -> None:
        nights = self.nights
        ends = np.min(blocks.conditions, axis=0), np.max(blocks.conditions, axis=0)
        self.seen = np.stack([np.fmin(self.seen[0], ends[0]), np.fmax(self.seen[1], ends[1])])
        if self.watch is not None:
            self.watch = self.watch.after(blocks, partial(self._since, blocks.day))
            return
        self.waiting.append(blocks)
        settings = watch_settings(self.spec)
        if len(self.waiting) < settings.baseline_nights:
            return
        machine = nights.watch_columns.machine(self.spec, nights.labels[self.period.first])
        self.watch = Watch.begin(machine, self.waiting, settings)
        charges = nights.records["charge"][self.period.first : self.place + 1]
        self.baseline = Baseline.of(self.watch, self.waiting, charges)
        self.baseline = replace(
            self.baseline,
            own_leakage=self._frozen(self.watch, self.baseline.own),
            reference_leakage=self._frozen(self.watch, self.reference),
        )
        self.waiting = []

    def _frozen(self, watch: Watch, at: Conditions) -> float | None:
        """Return leakage by the baseline that begins a watch."""
        drives = self.drives_at(at, self.place)
        return None if isinstance(drives, str) else watch.frozen_leakage_at(drives, _measured(at))

    def _since(self, until: int, day: int) -> list[NightBlocks]:
        """Return blocks of the nights from a day to another, as the watch asks for them."""
        nights, known = self.nights, self.nights.blocks
        begin = (nights.beginning or dt.date.max).toordinal()
        earlier = [
            night
            for night, n in zip(nights.labels, nights.records["blocks"].tolist(), strict=True)
            if n and day <= night.toordinal() < begin
        ]
        blocks = (
            read_blocks(self.output, self.spec, nights.watch_columns, earlier) if earlier else []
        )
        later = (ordinal for ordinal in sorted(known) if max(day, begin) <= ordinal <= until)
        return blocks + [known[ordinal] for ordinal in later]

    def state(self) -> NightState:
        """Return the state in the newest night; its leakages are noted."""
        nights, place = self.nights, self.place - 1
        label, n_blocks = nights.labels[place], int(nights.records["blocks"][place])
        counted = np.flatnonzero(nights.records["blocks"][: place + 1])
        last = int(nights.numbers[counted[-1]]) if len(counted) else -1
        night = NightState(
            self.spec,
            place,
            label,
            self.period,
            n_blocks,
            n_waiting=len(self.waiting),
            silent=int(nights.numbers[place]) - last,
            why_no_blocks="" if n_blocks else nights.why_no_blocks(label),
            is_refused=not n_blocks and nights.is_refused(label),
            fitted=nights.fitted_leakage(label),
        )
        if self.watch is None or self.baseline is None:
            return with_state(night)
        verdict = self.watch.verdict()
        night = replace(
            night,
            baseline=self.baseline,
            watch=self.watch,
            verdict=verdict,
            own_leakage=self._own_leakage(verdict, place),
            reference_leakage=self._leakage(self.reference, place),
        )
        if n_blocks:
            leakages = night.reference_leakage, night.own_leakage
            self.figures[place] = [
                np.nan if isinstance(leakage, str) else leakage.value for leakage in leakages
            ]
        return with_state(night)

    @property
    def reference(self) -> Conditions:
        """The fleet's reference conditions, with the charge pressure of the baseline."""
        charge = None if self.baseline is None else self.baseline.own.charge_over_case_bar
        return self.spec.settings.reference.conditions(charge)

    def first_leakage(self, place: int) -> float | str:
        """Return the baseline's leakage [l/min] at the motor's own conditions, by a night's oil.

        A text says why there is none.
        """
        assert self.watch is not None
        assert self.baseline is not None
        own, first = self.baseline.own, self.nights.place_from(self.baseline.end)
        now, then = self.drives_at(own, place), self.drives_at(own, first)
        if isinstance(now, str) or isinstance(then, str) or self.baseline.own_leakage is None:
            return now if isinstance(now, str) else OUT_OF_REACH
        after, before = (
            self.watch.frozen_leakage_at(drives, _measured(own)) for drives in (now, then)
        )
        # Where all of the flow is flushing, there is nothing that another oil changes.
        return self.baseline.own_leakage * (after / before if before else 1.0)

    def _own_leakage(self, verdict: Verdict, place: int) -> Estimate | str:
        """Return leakage now at the motor's own conditions: the baseline's and its change (7c.3).

        The oil is no part of the change. What an estimated flushing takes of the drain flow, it
        takes in the baseline and now.
        """
        assert self.watch is not None
        flow, in_force = self.first_leakage(place), self.watch.state.in_force
        if isinstance(flow, str):
            return flow
        change = verdict.newest_night
        if in_force is not None and in_force.change.cause in NO_LEAKAGE:
            change = in_force.before
        grown = 1.0 + change.value
        missed = LEAKAGE_BY_LACK * self.watch.state.baseline.lack_of_fit
        split = self.watch.state.baseline.split_error
        return Estimate(flow * grown, flow * math.hypot(change.sd, grown * missed, grown * split))

    def _leakage(self, at: Conditions, place: int) -> Estimate | str:
        assert self.watch is not None
        drives = self.drives_at(at, place)
        if isinstance(drives, str):
            return drives
        conditions = _measured(at)
        if (conditions < self.seen[0] - REACH).any() or (conditions > self.seen[1] + REACH).any():
            return OUT_OF_REACH
        return self.watch.leakage_at(drives, conditions)

    def drives_at(self, at: Conditions, place: int) -> Array | str:
        """Return flow a unit of each coefficient in a night; all else is the same for all."""
        night = self.nights.labels[place]
        key = self.spec.file.oil_on(night), at
        if key not in self.drives:
            self.drives[key] = self.nights.watch_columns.drives_at(self.spec, night, at)
        return self.drives[key]

    def checkpoint(self, key: str) -> MotorCheckpoint:
        """Return what the next run needs: the watch before the newest night, which it may redo."""
        labels, watch = self.nights.labels, None
        if self.before is not None:
            period, baseline, seen, before = self.before
            own = {
                "baseline": STORED_BASELINE.dump_python(baseline, mode="json"),
                "seen": seen.tolist(),
            }
            watch = StoredWatch(labels[period.first], own, before.day, before.arrays())
        records = self.nights.records[: self.place].copy()
        for column, name in enumerate(WATCHED):
            records[name] = self.figures[: self.place, column]
        return MotorCheckpoint(key, labels[self.place - 1], records, watch)


def _measured(at: Conditions) -> Array:
    """Return temperature [°C], pressure [bar] and speed [rpm], as the watch takes them."""
    return np.array([at.temperature_c, at.pressure_bar, at.speed_rpm])


def watch_settings(spec: MotorSpec) -> WatchSettings:
    """Return settings of a motor's watch."""
    trend, alarms = spec.settings.trend, spec.settings.alarms
    return WatchSettings(alarms.false_alarms_per_year, trend.baseline_nights)
