"""Causes of a change of a motor's flows: a common factor or paths, alone and in its oil circuit.

They are found from the statistics of at most ten nights since the change and of the first good
nights before it. The common factor of the other motors of an oil circuit is taken over the same
number of nights.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from leakage.course.growth import Blocks, Growth, growth
from leakage.course.hypotheses import CommonFactor, Posterior, mean_factor, weigh
from leakage.course.temperature_correction import TemperatureCorrection
from leakage.estimation.block_statistics import with_path_known
from pipeline.trends.baselines.eras import Era, era_at
from pipeline.trends.figures.temperature import warming
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import Layout

# Nights that say what is now, at most, and what was before, at least.
NIGHTS_OF_NOW = 10
LEAST_NIGHTS = 5
# Over how many nights other motors are asked: few, so that each is asked once for many.
LENGTHS = (1, 2, 3, 5, NIGHTS_OF_NOW)

Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Explanations:
    """The explanations of a motor's changes, each made when it is asked for."""

    history: History
    eras: tuple[Era, ...]
    _growths: dict[tuple[int, int], Growth | None] = field(default_factory=dict)
    _factors: dict[tuple[int, int], CommonFactor | None] = field(default_factory=dict)

    def era(self, place: int) -> Era:
        """The era of a night."""
        return era_at(self.eras, place)

    def nights_of_now(self, place: int, begin: int) -> Places:
        """Places of the latest nights with statistics from one on."""
        return self._informed(max(begin, self.era(place).segment.first), place + 1)[-NIGHTS_OF_NOW:]

    def at(self, place: int, begin: int, others: CommonFactor | None = None) -> Posterior | None:
        """The change from a night on as of another; None where the nights cannot say."""
        now = self.nights_of_now(place, begin)
        found = self._growth(now) if self._is_recent(now, place) else None
        return None if found is None else weigh(found, others)

    def factor(self, place: int, length: int) -> CommonFactor | None:
        """Common factor of this motor's flows in a night, as the other motors use it.

        After a new baseline it is added to the factor before. None before the first baseline.
        """
        if (place, length) not in self._factors:
            self._factors[place, length] = self._factor(place, length)
        return self._factors[place, length]

    def _factor(self, place: int, length: int) -> CommonFactor | None:
        era = self.era(place)
        first = era.segment.first
        before = self.factor(first - 1, NIGHTS_OF_NOW) if first else None
        now = self._informed(max(first, era.known_from + 1), place + 1)[-length:]
        found = self._growth(now) if self._is_recent(now, place) else None
        if found is None:
            return before if place <= era.known_from else None
        told = weigh(found)
        if told.taken_back:
            return None
        own = told.expected
        if before is None:
            return own
        return CommonFactor(before.log + own.log, math.hypot(before.sd, own.sd))

    def _informed(self, first: int, end: int) -> Places:
        factors = self.history.records["factor"][first:end]
        return first + np.flatnonzero(np.isfinite(factors).all(axis=1))

    def _is_recent(self, now: Places, place: int) -> bool:
        numbers, longest = self.history.numbers, self.history.spec.settings.alarms
        return len(now) > 0 and numbers[place] - numbers[now[-1]] <= longest.stale_after_nights

    def _growth(self, now: Places) -> Growth | None:
        key = int(now[0]), int(now[-1])
        if key not in self._growths:
            self._growths[key] = self._grown(now)
        return self._growths[key]

    def _grown(self, now: Places) -> Growth | None:
        trend, layout = self.history.spec.settings.trend, self.history.once(_stated)
        era = self.era(int(now[0]))
        before = self._informed(era.segment.first, int(now[0]))[: trend.baseline_nights]
        if len(before) < LEAST_NIGHTS:
            return None
        known = era.temperature if now[-1] > era.temperature_from else None
        return growth(
            layout.paths,
            self._blocks(before, known),
            self._blocks(now, known),
            np.array(layout.configured),
            np.array(layout.free),
            self.history.once(_standard_name),
        )

    def _blocks(self, places: Places, correction: TemperatureCorrection | None) -> Blocks:
        """Nights as blocks of their own, with what their temperature does to K in the columns."""
        temperature = self.history.records["mean_temperature_c"][places]
        known = bool(np.isfinite(temperature).all()) and np.ptp(temperature) > 0.0
        factors = self.history.factors(places)
        driven = [*range(len(self.history.once(_stated).paths))]
        if (standard := self.history.layout.standard) is not None:
            factors = with_path_known(factors, *standard)
            # Where their scale is free, the rollers change with temperature as the gaps do.
            driven.append(-2)
        effect = warming(self.history.records[places], correction)
        factors[:, :, driven] *= effect[:, None, None]
        return Blocks(factors, places, temperature if known else None)


def _stated(history: History) -> Layout:
    """The layout with the cam rollers known: the change of their scale is found on its own."""
    return Layout.of(history.spec.stated, history.nights[0])


def _standard_name(history: History) -> str:
    """Name of the flow that is known: the cam rollers, as a rule."""
    motor = history.spec.stated.motor(history.nights[0], history.spec.file.flushing.mode)
    return "_and_".join(path.name for path in motor.known_paths) or "known_flow"


@dataclass(frozen=True, slots=True)
class View:
    """A motor as the others of its circuit saw it before a night, or for good (None)."""

    until: dt.date | None
    explanations: Explanations


@dataclass(frozen=True, slots=True)
class OilCircuit:
    """The motors of an oil circuit, by how the others saw each, the earliest view first."""

    views: Mapping[str, Sequence[View]]

    def others(self, motor_id: str, place: int, begin: int) -> CommonFactor | None:
        """Mean factor of the others over a motor's nights since a change; None: none is known.

        Where the motor's own baseline is new, since that was taken.
        """
        own = self.views[motor_id][-1].explanations
        now = own.nights_of_now(place, begin)
        length = max((one for one in LENGTHS if one <= len(now)), default=LENGTHS[0])
        era = own.era(place)
        night, frozen = own.history.nights[place], None
        if era.segment.first and era.known_from < era.segment.end:
            frozen = own.history.nights[era.known_from]
        found = []
        for other in self.views:
            said = None if other == motor_id else self._said(other, night, length)
            if said is not None and frozen is not None:
                then = self._said(other, frozen, NIGHTS_OF_NOW)
                if then is not None:
                    said = CommonFactor(said.log - then.log, math.hypot(said.sd, then.sd))
            if said is not None:
                found.append(said)
        return mean_factor(found) if found else None

    def _said(self, motor_id: str, night: dt.date, length: int) -> CommonFactor | None:
        seen = next(
            one.explanations
            for one in self.views[motor_id]
            if one.until is None or night < one.until
        )
        nights = seen.history.records["night"]
        place = int(np.searchsorted(nights, np.datetime64(night), side="right")) - 1
        return seen.factor(place, length) if place >= 0 else None


@dataclass(frozen=True, slots=True)
class Why:
    """The explanations of a motor's changes within its oil circuit; None: it is on its own."""

    own: Explanations
    circuit: OilCircuit | None
    _found: dict[tuple[int, int], Posterior | None] = field(default_factory=dict)

    def at(self, place: int, begin: int) -> Posterior | None:
        """The change from a night on as of another; None where the nights cannot say."""
        if (place, begin) not in self._found:
            others = None
            if self.circuit is not None:
                motor_id = self.own.history.spec.motor_id
                others = self.circuit.others(motor_id, place, begin)
            self._found[place, begin] = self.own.at(place, begin, others)
        return self._found[place, begin]
