"""A motor's watch night by night: baseline periods, and what each night says."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from leakage.watch import Estimate, NightBlocks, Verdict, Watch, WatchSettings
from leakage.watch.adoption import oil_spread
from leakage.watch.causes import NO_LEAKAGE
from leakage.watch.choices import LEAKAGE_BY_LACK, METER_SPREAD, SENSOR_SPREAD
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.settings import Conditions
from pipeline.trends.nights.checkpoint import MotorCheckpoint, StoredWatch
from pipeline.trends.nights.history import WATCHED, BaselinePeriod, period_at, periods_of
from pipeline.trends.nights.published_nights import PublishedNights, read_blocks
from pipeline.trends.states.night_state import NightState, with_state

# A leakage is estimated at conditions as far beyond those of the baseline period's blocks [°C, bar,
# rpm].
REACH = np.array([10.0, 20.0, 10.0])
OUT_OF_REACH = "the era's blocks do not reach these conditions"

# Spread of the step of events that carry a baseline across, but for a change of oil.
SPREADS = {"meter_changed": METER_SPREAD, "sensor_changed": SENSOR_SPREAD}
NOTHING_SEEN = np.full((2, 3), np.nan)


@dataclass(frozen=True, slots=True)
class Baseline:
    """A baseline period: its nights, and what is frozen with it.

    `own` are the motor's own conditions, `coefficients` those of the paths as the watch has them;
    the leakages are at the motor's own and at the reference conditions, [l/min].
    """

    start: dt.date
    end: dt.date
    n: int
    own: Conditions
    coefficients: tuple[float, ...]
    own_leakage: float | None = None
    reference_leakage: float | None = None

    @classmethod
    def of(cls, watch: Watch, nights: Sequence[NightBlocks], charges: Array) -> Baseline:
        """The baseline of some nights, after which a watch stands, and their charge pressures."""
        every = np.concatenate([night.conditions for night in nights])
        temperature, pressure, speed = np.median(every, axis=0).tolist()
        known = charges[np.isfinite(charges)]
        charge = float(np.median(known)) if len(known) else None
        first, last = (dt.date.fromordinal(night.day) for night in (nights[0], nights[-1]))
        own = Conditions(pressure, temperature, speed, charge)
        theta = watch.state.baseline.columns.theta
        return cls(first, last, len(nights), own, tuple(theta.tolist()))


# To and from a checkpoint.
STORED_BASELINE = TypeAdapter(Baseline)


@dataclass(slots=True)
class Course:
    """A motor's nights, as far as its watch has taken them.

    `figures` are those of `WATCHED` by place, shape (n, 2).
    """

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
        history = nights.history
        if nights.beginning is None:
            return None
        periods, place = periods_of(history), history.place_from(nights.beginning)
        figures = np.column_stack([history.records[name] for name in WATCHED])
        course = cls(output, nights, periods, place, period_at(periods, max(place - 1, 0)), figures)
        checkpoint = nights.wanted.checkpoint
        if nights.resumes and checkpoint is not None and checkpoint.watch is not None:
            newest = dt.date.fromordinal(checkpoint.watch.day)
            machine = history.watch_columns.machine(history.spec, newest)
            settings = watch_settings(history.spec)
            course.watch = Watch.of_arrays(machine, settings, checkpoint.watch.arrays)
            course.baseline = STORED_BASELINE.validate_python(checkpoint.watch.own["baseline"])
            course.seen = np.array(checkpoint.watch.own["seen"])
        return course

    @property
    def nights_to_come(self) -> tuple[dt.date, ...]:
        """Nights that the watch is to take."""
        return self.nights.history.nights[self.place :]

    @property
    def night(self) -> dt.date | None:
        """The night that the watch took last; None before the first."""
        return self.nights.history.nights[self.place - 1] if self.place else None

    @property
    def spec(self) -> MotorSpec:
        """The motor."""
        return self.nights.history.spec

    def step(self) -> None:
        """Tell the watch the next night."""
        history = self.nights.history
        self.before = None
        if self.watch is not None and self.baseline is not None:
            self.before = self.period, self.baseline, self.seen, self.watch
        if self.place in (self.period.first, self.period.end):
            self.period = period_at(self.periods, self.place)
            self.watch, self.baseline, self.waiting, self.seen = None, None, [], NOTHING_SEEN
        night = history.nights[self.place]
        blocks = self.nights.blocks.get(night.toordinal())
        if blocks is not None:
            if self.watch is not None and (spread := self._spread(self.watch, night)):
                machine = history.watch_columns.machine(history.spec, night)
                self.watch = self.watch.across_event(machine, blocks.day, spread)
            self._take(blocks)
        self.place += 1

    def _spread(self, watch: Watch, night: dt.date) -> float:
        """Return spread of the step of events since the watch's newest night; 0 without one."""
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
        history = self.nights.history
        ends = np.min(blocks.conditions, axis=0), np.max(blocks.conditions, axis=0)
        self.seen = np.stack([np.fmin(self.seen[0], ends[0]), np.fmax(self.seen[1], ends[1])])
        if self.watch is not None:
            self.watch = self.watch.after(blocks, partial(self._since, blocks.day))
            return
        self.waiting.append(blocks)
        settings = watch_settings(history.spec)
        if len(self.waiting) < settings.baseline_nights:
            return
        machine = history.watch_columns.machine(history.spec, history.nights[self.period.first])
        self.watch = Watch.begin(machine, self.waiting, settings)
        charges = history.records["charge"][self.period.first : self.place + 1]
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
        """Return blocks of the nights from a day to another one, as the watch asks for them."""
        history, known = self.nights.history, self.nights.blocks
        begin = self.nights.blocks_from.toordinal()
        earlier = [
            night
            for night, n in zip(history.nights, history.records["blocks"].tolist(), strict=True)
            if n and day <= night.toordinal() < begin
        ]
        blocks = (
            read_blocks(self.output, self.spec, history.watch_columns, earlier) if earlier else []
        )
        later = (ordinal for ordinal in sorted(known) if max(day, begin) <= ordinal <= until)
        return blocks + [known[ordinal] for ordinal in later]

    def know_circuit(self, others: Sequence[Watch]) -> None:
        """Tell the watch what the other motors of the circuit did since its own change."""
        if self.watch is not None:
            self.watch = self.watch.beside(others)

    def state(self) -> NightState:
        """Return the state in the newest night; its leakages are noted."""
        history, place = self.nights.history, self.place - 1
        label, n_blocks = history.nights[place], int(history.records["blocks"][place])
        counted = np.flatnonzero(history.records["blocks"][: place + 1])
        last = int(history.numbers[counted[-1]]) if len(counted) else -1
        night = NightState(
            self.spec,
            place,
            label,
            self.period,
            n_blocks,
            n_waiting=len(self.waiting),
            silent=int(history.numbers[place]) - last,
            why_no_blocks="" if n_blocks else self.nights.why_no_blocks(label),
            fitted=self.nights.fitted_leakage(label),
        )
        if self.watch is None or self.baseline is None:
            return with_state(night)
        verdict = self.watch.verdict()
        night = replace(
            night,
            baseline=self.baseline,
            watch=self.watch,
            verdict=verdict,
            own_leakage=self._own_leakage(self.baseline, verdict, place),
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

    def _own_leakage(self, baseline: Baseline, verdict: Verdict, place: int) -> Estimate | str:
        """Return leakage now at the motor's own conditions: the baseline's and its change (7c.3).

        By the oil of the night, which the change is no part of.
        """
        assert self.watch is not None
        first = self.nights.history.place_from(baseline.end)
        now, then = self.drives_at(baseline.own, place), self.drives_at(baseline.own, first)
        if isinstance(now, str) or isinstance(then, str) or baseline.own_leakage is None:
            return now if isinstance(now, str) else OUT_OF_REACH
        theta, in_force = np.array(baseline.coefficients), self.watch.state.in_force
        change = verdict.newest_night
        if in_force is not None and in_force.change.cause in NO_LEAKAGE:
            change = in_force.before
        flow = baseline.own_leakage * float(theta @ now) / max(float(theta @ then), 1e-12)
        grown, missed = 1.0 + change.value, LEAKAGE_BY_LACK * verdict.lack_of_fit
        return Estimate(flow * grown, flow * math.hypot(change.sd, grown * missed))

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
        """Flow a unit of each coefficient in a night; what else shapes it is the same for all."""
        history = self.nights.history
        night = history.nights[place]
        key = history.spec.file.oil_on(night), at
        if key not in self.drives:
            self.drives[key] = history.watch_columns.drives_at(history.spec, night, at)
        return self.drives[key]

    def checkpoint(self, key: str) -> MotorCheckpoint:
        """Return what the next run needs: the watch before the newest night, which it may redo."""
        nights, watch = self.nights.history.nights, None
        if self.before is not None:
            period, baseline, seen, before = self.before
            own = {
                "baseline": STORED_BASELINE.dump_python(baseline, mode="json"),
                "seen": seen.tolist(),
            }
            watch = StoredWatch(nights[period.first], own, before.day, before.arrays())
        records = self.nights.history.records[: self.place].copy()
        for column, name in enumerate(WATCHED):
            records[name] = self.figures[: self.place, column]
        return MotorCheckpoint(key, nights[self.place - 1], records, watch)


def _measured(at: Conditions) -> Array:
    """Return temperature [°C], pressure [bar] and speed [rpm], as the watch takes them."""
    return np.array([at.temperature_c, at.pressure_bar, at.speed_rpm])


def watch_settings(spec: MotorSpec) -> WatchSettings:
    """Return settings of a motor's watch."""
    trend, alarms = spec.settings.trend, spec.settings.alarms
    return WatchSettings(alarms.false_alarms_per_year, trend.baseline_nights)
