"""Standing of a motor, night by night: the source of the rows of all trend tables."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import overload

import numpy as np
from numpy.typing import NDArray

from leakage.course.alarms import OF_SEVERITY, Limits
from leakage.course.hypotheses import Posterior
from leakage.course.monitoring import ChangeSize, change_size, monitor
from pipeline.clock import utc
from pipeline.config.nights import night as night_labelled
from pipeline.trends.baselines.eras import Era, era_at
from pipeline.trends.figures.indicators import DEVIATION, MODEL_MISFIT, TEMPERATURE_EFFECT
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import FLUSHING, OUTSIDE
from pipeline.trends.nights.running import RunningHours, running_hours
from pipeline.trends.states.explanations import Why
from pipeline.trends.states.model import ModelCourse
from pipeline.trends.states.peers import Peers
from pipeline.trends.states.sudden import Sudden
from pipeline.trends.states.temperature_watch import TemperatureWatch, temperature_watch
from pipeline.trends.states.watch import Watched
from pipeline.trends.states.zeros import Zero, health

Array = NDArray[np.float64]

RAISED = ("warning", "alarm")
CHANGED = (*RAISED, "common_cause")
DAYS_A_YEAR = 365.25
# Nights for which it stays told that a rise is the oil circuit's.
LONGEST_MEMORY = 60


@dataclass(frozen=True)
class Standing:
    """States, changes and explanations of a motor's nights."""

    history: History
    eras: tuple[Era, ...]
    watched: Mapping[str, Watched]  # by name
    peers: Peers | None  # the other motors of its oil circuit; None without others
    why: Why
    sudden: tuple[Sudden, ...]
    zeros: Mapping[str, Zero]  # by name
    model: ModelCourse
    _onsets: dict[int, int] = field(default_factory=dict)

    @cached_property
    def hours(self) -> RunningHours:
        """Running hours."""
        return running_hours(self.history)

    @cached_property
    def is_outside(self) -> NDArray[np.bool_]:
        """Nights whose duty the baseline has not seen, shape (n,)."""
        outside: NDArray[np.bool_] = self.history.records["duty"] == OUTSIDE
        return outside

    @cached_property
    def told(self) -> dict[str, tuple[str, ...]]:
        """State of each night, by indicator, whatever the other motors of the circuit did."""
        found = {name: list(states) for name, states in self._told.items()}
        for name, watched in self.watched.items():
            for place in np.flatnonzero(np.isnan(watched.series) & self.is_outside).tolist():
                if found[name][place] in ("ok", "stale"):
                    found[name][place] = "duty_outside"
        return {name: tuple(states) for name, states in found.items()} | {
            name: one.state for name, one in self.by_own_rules.items()
        }

    @cached_property
    def temperature(self) -> TemperatureWatch:
        """Effect of temperature on the loss factors; nights of another change do not count."""
        changed = np.isin(np.array(list(self._told.values())), CHANGED)
        return temperature_watch(self.history, self.eras, np.any(changed, axis=0))

    @cached_property
    def _told(self) -> dict[str, tuple[str, ...]]:
        """The same of the watched indicators alone."""
        found: dict[str, list[str]] = {
            name: list(one.found.states) for name, one in self.watched.items()
        }
        # A baseline that no longer holds is a warning: under it, wear would not show.
        flow = found[DEVIATION]
        for one in self.sudden:
            for place in range(one.told, one.until):
                if flow[place] == "ok":
                    flow[place] = "common_cause" if one.kind == "circuit" else "warning"
        return {name: tuple(states) for name, states in found.items()}

    @cached_property
    def by_own_rules(self) -> Mapping[str, Zero | ModelCourse | TemperatureWatch]:
        """What is told by other rules than the watched indicators: sensors and the model."""
        return {**self.zeros, MODEL_MISFIT: self.model, TEMPERATURE_EFFECT: self.temperature}

    @cached_property
    def states(self) -> dict[str, States]:
        """State of each night, by indicator."""
        return {name: States(self, name) for name in self.told}

    def state(self, name: str, place: int) -> str:
        """State of an indicator; a rise that all motors of the oil circuit have is no own alarm.

        An absolute limit holds whatever the others do, and what a path did is the motor's own.
        """
        told = self.told[name][place]
        if told not in RAISED or self.why.circuit is None:
            return told
        if name == MODEL_MISFIT:
            # Another oil moves the gaps and not the rollers, which the stated model holds.
            others = {self.state(one, place) for one in self.watched}
            return "common_cause" if "common_cause" in others and not others & {*RAISED} else told
        if name not in self.watched:
            return told
        watched = self.watched[name]
        if watched.found.limit_severity[place] or name == FLUSHING:
            return told
        first = watched.segment(place).first
        return "common_cause" if self._is_of_circuit(name, place, first) else told

    def _is_of_circuit(self, name: str, place: int, first: int) -> bool:
        """True if a rise is common to all motors of the oil circuit.

        Once found, this holds until a cause of the motor's own is found, the rise ends, or
        `LONGEST_MEMORY` nights have passed.
        """
        path = self.watched[name].indicator.path
        for one in range(place, max(first, place - LONGEST_MEMORY) - 1, -1):
            found = self.explained(one) if self.told[name][one] in RAISED else None
            if found is None:
                return False
            if found.is_of_tank and (found.verdict == "common" or (path and found.excludes(path))):
                return True
            if found.is_own:
                return False
        return False

    def explained(self, place: int) -> Posterior | None:
        """Explanation of the change that raised indicators report; None if undetermined."""
        return self.why.at(place, self.earliest_onset(place))

    def sudden_at(self, place: int) -> Sudden | None:
        """The sudden change that stands in a night, the latest of several; None without one."""
        standing = [one for one in self.sudden if one.stands(place)]
        latest = max((one.place for one in standing), default=0)
        return next((one for one in standing if one.place == latest), None)

    def levels(self, name: str, place: int) -> tuple[float, float]:
        """Relative rises that are a warning and an alarm in a night, by its baseline's scatter."""
        return self.watched[name].settings.levels.in_effect(self.relative_sd(name, place))

    def relative_sd(self, name: str, place: int) -> float:
        """Scatter of the nights of the baseline that serves a night, from the safe side."""
        baseline = self.watched[name].baseline(place)
        return 0.0 if baseline is None else baseline.highest_sd() / baseline.mean

    @cached_property
    def diverged(self) -> tuple[str, ...]:
        """State of the drain flow less what the other motors' did, of each night."""
        watched = self.watched[DEVIATION]
        settings = replace(watched.settings, limits=Limits())
        found: list[str] = []
        for part in watched.segments:
            here = part.here
            if self.peers is None:
                found += ["insufficient"] * (part.end - part.first)
                continue
            series = watched.series[here] / np.exp(self.peers.others[here])
            one = monitor(self.history.numbers[here], series, settings)
            known = self.peers.known_from(part) <= np.arange(part.first, part.end)
            state = np.array(OF_SEVERITY, dtype=object)[one.severity]
            state[~(known & one.has_baseline)] = "insufficient"
            found += state.tolist()
        return tuple(found)

    def era(self, place: int) -> Era:
        """The era of a night."""
        return era_at(self.eras, place)

    def label(self, place: int) -> dt.date:
        """Label of a night."""
        return self.history.nights[place]

    def key(self, place: int) -> dict[str, object]:
        """Motor and night, as they begin every row."""
        return {"motor_id": self.history.spec.motor_id, "night": self.label(place)}

    def end_of(self, place: int) -> dt.datetime:
        """End of a night, UTC."""
        night = night_labelled(self.label(place), self.history.spec.settings.nights)
        return utc(night.end_us)

    def health(self, place: int) -> str:
        """Health of the sensors, from their zeros at halts."""
        return health(tuple(self.zeros.values()), place)

    def onset(self, name: str, place: int) -> int | None:
        """Place of the night on which the change began that an indicator tells; None: none told."""
        onset = int(self.watched[name].found.onset[place])
        return onset if onset >= 0 else None

    def rise(self, name: str, place: int) -> ChangeSize | None:
        """Size of the rise that an indicator reports, relative to its baseline; None without one.

        Negative if the rise has since been undone.
        """
        watched = self.watched[name]
        found, baseline = watched.found, watched.baseline(place)
        if baseline is None or not found.severity[place]:
            return None
        onset = int(found.onset[place])
        if onset < 0:
            good, _ = self._counted_nights(name, place)
            onset = int(good[-watched.settings.levels.on_nights :][0])
        return change_size(self.history.numbers, watched.series, baseline, onset, place)

    def has_fallen(self, name: str, place: int) -> bool:
        """True if an indicator still reports a rise but is no longer above its baseline."""
        size = self.rise(name, place)
        return size is not None and size.relative <= 0.0

    def change_start(self, name: str, place: int) -> int | None:
        """Place of the night on which the change began that an indicator tells; None: none told.

        A sudden change of the whole motor begins it anew.
        """
        size = self.rise(name, place)
        began = [] if size is None else [self.history.place_of(size.since_night)]
        return max([*began, *self._sudden_places(place)], default=None)

    def earliest_onset(self, place: int) -> int:
        """Place of the night on which the change began that some raised indicator tells first.

        A wear shows in one indicator before it does in another. A sudden change of the whole motor
        begins it anew.
        """
        if place not in self._onsets:
            begins = [
                onset
                for name in self.watched
                if self.told[name][place] in CHANGED
                and (onset := self._onset_of_rise(name, place)) is not None
            ]
            first = min([place, *begins])
            self._onsets[place] = max([first, *self._sudden_places(place)])
        return self._onsets[place]

    def _onset_of_rise(self, name: str, place: int) -> int | None:
        """The same as `onset`, of a rise that only the levels tell as well."""
        watched = self.watched[name]
        found = watched.found
        if not found.severity[place] or found.onset[place] >= 0:
            return self.onset(name, place)
        good, went_on = self._counted_nights(name, place)
        good = good[-watched.settings.levels.of_nights :]
        above = good[found.deviation[good] >= self.levels(name, place)[0]]
        return int(above[0]) if len(above) else went_on

    def _counted_nights(self, name: str, place: int) -> tuple[NDArray[np.intp], int]:
        """Good nights up to that on which the levels told a rise of a night, and that night."""
        watched = self.watched[name]
        first = watched.segment(place).first
        off = np.flatnonzero(watched.found.severity[first : place + 1] == 0)
        went_on = first + (int(off[-1]) + 1 if len(off) else 0)
        good = np.flatnonzero(np.isfinite(watched.found.deviation[first : went_on + 1]))
        return first + good, went_on

    def _sudden_places(self, place: int) -> list[int]:
        """Places of the sudden changes that stand in a night."""
        return [one.place for one in self.sudden if one.stands(place)]

    def line_start(self, name: str, place: int) -> int:
        """Place of the first night of the line that tells the slope as of a night.

        Where a change stands told, the nights since it began: a line across a step, or across
        nights before a wear began, is none. Where nothing is told, the nights since the baseline
        began.
        """
        first, onset = self.watched[name].segment(place).first, self.onset(name, place)
        return max([first, *([] if onset is None else [onset]), *self._sudden_places(place)])


@dataclass(frozen=True, slots=True)
class States(Sequence[str]):
    """States of an indicator, each made when it is asked for."""

    standing: Standing
    name: str

    def __len__(self) -> int:
        return len(self.standing.history)

    @overload
    def __getitem__(self, place: int) -> str: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[str, ...]: ...

    def __getitem__(self, place: int | slice) -> str | tuple[str, ...]:
        places = range(len(self))[place]
        if isinstance(places, range):
            return tuple(self.standing.state(self.name, one) for one in places)
        return self.standing.state(self.name, places)
