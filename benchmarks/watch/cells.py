"""All cells: motors to which the same happens, and what may be said of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from benchmarks.watch import foreign
from benchmarks.watch.cb560 import FITTED, FLUSHED, LAMINAR, OTHERWISE, TWO_SIDED
from benchmarks.watch.rig import BEGIN, CUTS
from benchmarks.watch.simulator import (
    AND_FLUSHING,
    HEALTHY,
    ONE_PATH,
    PATHS,
    PISTON,
    RING,
    SLEEVE,
    Course,
    History,
    Machine,
    State,
    asked,
    history,
)
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

BASELINE, CHANGE, YEAR = 60, 75, 365
RIG = "pump rig"
# Ambient temperature [K about its mean]: the year, and the weather with its memory; and what oil
# and sensor take of it.
SEASON_K, WEATHER_K, WEATHER_PHI = 12.0, 4.0, 0.7
OIL_FOLLOWS, SENSOR_FOLLOWS = 0.6, 0.1

Seed = tuple[int, ...]
Names = tuple[str, ...]
# A motor of a seed, or all of a tank, and so many of its nights.
Make = Callable[[Seed, int], Sequence[History]]
FLOWS, GAPS, GRADE = ("all_flows",), ("all_gaps",), ("oil_grade",)
SENSOR, WARMTH, SEVERAL = ("temperature_sensor",), ("temperature_effect",), ("several",)


@dataclass(frozen=True)
class Event:
    """What happens to a motor, and what may be said of it."""

    course: Course
    nights: int
    begin: int | None = None  # night from which on something is otherwise than it was
    right: Names = ()  # causes that are true
    near: Names = ()  # causes that say less than the truth, and nothing false

    @property
    def is_step(self) -> bool:
        """Whether all of it is there at once, whatever the season; every third night counts."""
        first, later = (
            replace(self.course(np.array([(self.begin or 0) + n])), warmer_k=0.0) for n in (0, 3)
        )
        return first == later


@dataclass(frozen=True)
class Cell:
    """Motors to which the same happens."""

    group: str
    words: str
    machine: str
    make: Make
    motors: int
    event: Event
    baseline: int = BASELINE
    has_rivals: bool = False

    @property
    def key(self) -> str:
        """Its name among all."""
        return "; ".join((self.group, self.words, self.machine, str(self.baseline)))


def change(
    begin: int = CHANGE,
    over: int = 0,
    until: float = np.inf,
    every: int = 1,
    power: float = 1.0,
    **to: float,
) -> Course:
    """Figures of the state that go to others, at once or evenly, until a night; gaps: power 3."""

    def course(night: Array) -> State:
        share = np.clip((night - begin) / over, 0.0, 1.0) if over else 1.0 * (night >= begin)
        share = share * (night < until) * (night % every == 0)
        firsts = {name: getattr(HEALTHY, name) for name in to}
        return State(
            **{name: (one + share * (to[name] - one)) ** power for name, one in firsts.items()}
        )

    return course


def happens(
    nights: int, right: Names = (), near: Names = (), begin: int = CHANGE, **of: float
) -> Event:
    """One change."""
    return Event(change(begin, **of), nights, begin, right, near)


def both(one: Course, other: Course) -> Course:
    """Two changes: factors multiply, others add."""

    def course(night: Array) -> State:
        pairs = {
            of.name: (getattr(one(night), of.name), getattr(other(night), of.name), of.default)
            for of in fields(State)
        }
        return State(**{name: a * b if at else a + b for name, (a, b, at) in pairs.items()})

    return course


def ambient(name: str, follows: float, first: float, seed: Seed) -> Course:
    """What follows the ambient temperature, from its warmest (1) or coldest (-1) day on [K]."""
    white = np.random.default_rng([*seed, 9]).standard_normal(YEAR)
    year = SEASON_K * np.cos(2.0 * np.pi * np.arange(YEAR) / YEAR)
    air = WEATHER_K * autoregression(white, WEATHER_PHI) + first * year
    return lambda night: State(**{name: follows * air[: len(night)]})


NOTHING = Event(lambda _: HEALTHY, YEAR)
KINDS: Mapping[str, Machine] = {
    "otherwise": OTHERWISE,
    "as modelled": FITTED,
    "two-sided": TWO_SIDED,
    **foreign.MACHINES,
}


def _cell(
    group: str,
    words: str,
    machine: str,
    event: Event,
    motors: int = 30,
    baseline: int = BASELINE,
    rivals: bool = False,
    of: Machine | None = None,
    by_seed: Callable[[Seed], Course] | None = None,
    tank: Sequence[Course] = (),
) -> Cell:
    """Motors of a machine, or tanks with others, each with a course of its own."""

    def make(seed: Seed, nights: int) -> Sequence[History]:
        courses = by_seed(seed) if by_seed else event.course, *tank
        seeds = [(*seed, place) for place in range(len(courses))] if tank else [seed]
        return [
            history(of or KINDS[machine], course, nights, one, baseline)
            for course, one in zip(courses, seeds, strict=True)
        ]

    return Cell(group, words, machine, make, motors, event, baseline, rivals)


WORLDS = {
    "plain": OTHERWISE,
    "wander × 1.5, φ 0.8": replace(OTHERWISE, wander=1.5, phi=0.8),
    "φ 0.9": replace(OTHERWISE, phi=0.9),
    "1 % odd nights": replace(OTHERWISE, odd=0.01),
    "each path ± 1.5 %": replace(OTHERWISE, paths=0.015),
}


def _healthy() -> Iterator[Cell]:
    for world, of in WORLDS.items():
        for baseline in (8, 15, 60):
            rivals = world == "plain" and baseline == BASELINE
            yield _cell("healthy", world, "otherwise", NOTHING, 67, baseline, rivals, of)
    for baseline in (8, 60):
        yield _cell("healthy", "plain", "as modelled", NOTHING, 30, baseline)


WEAR = {
    "all gaps' flow +10 % at once": happens(115, GAPS, FLOWS, wear=1.1),
    "all gaps' flow +20 % at once": happens(115, GAPS, FLOWS, wear=1.2),
    "all gaps' flow +30 % at once": happens(115, GAPS, FLOWS, wear=1.3),
    "ring gap +37 % in 120 nights": happens(225, (RING,), over=120, power=3, piston_ring=1.37),
    "sleeve gap +9 % in a year (+10 % of leakage)": happens(
        CHANGE + 200, (SLEEVE,), over=YEAR, power=3, balance_sleeve=1.09
    ),
    "a sleeve breaks: its flow × 3": happens(95, (SLEEVE,), balance_sleeve=3.0),
}
NO_WEAR = {
    "load halved": happens(135, load=0.5),
    "speed cut by half": happens(135, speed=0.5),
    "VG 46 for VG 68, undeclared": happens(95, GRADE, FLOWS, vg46=1.0),
    "oil −20 %": happens(95, FLOWS + GRADE, viscosity=0.8),
    "meter +6 % at once": happens(95, FLOWS, gain=1.06),
    "temperature sensor −3 °C": happens(95, SENSOR, FLOWS, reads_high_c=-3.0),
    "oil thins by 10 % in 90 nights": happens(195, FLOWS + GRADE, over=90, viscosity=0.9),
    "meter drifts by +6 % in 120 nights": happens(225, FLOWS, over=120, gain=1.06),
    "every third night +8 %": happens(135, ("odd_nights",), every=3, gain=1.08),
}
SEASONS = {
    "season: oil ± 7 K, winter first": (
        Event(NOTHING.course, 245),
        partial(ambient, "warmer_k", OIL_FOLLOWS, -1.0),
    ),
    "temperature sensor takes 10 % of ambient": (
        Event(NOTHING.course, 245, None, SENSOR, FLOWS + WARMTH),
        partial(ambient, "reads_high_c", SENSOR_FOLLOWS, 1.0),
    ),
}


def _changes() -> Iterator[Cell]:
    """One change, on both machines; the first of them with all that users would make."""
    for machine in ("otherwise", "as modelled"):
        for baseline in (BASELINE, 8):
            rivals = machine == "otherwise" and baseline == BASELINE
            for words, event in WEAR.items():
                yield _cell("wear", words, machine, event, 30, baseline, rivals)
            if baseline == BASELINE:
                for words, event in NO_WEAR.items():
                    yield _cell("no wear", words, machine, event, 30, baseline, rivals)
    for words, (event, by_seed) in SEASONS.items():
        yield _cell("no wear", words, "otherwise", event, rivals=True, by_seed=by_seed)


def _from_the_first() -> Iterator[Cell]:
    """Wear from the first night on."""
    for machine in ("otherwise", "as modelled"):
        for baseline in (8, 15):
            for path, growth in ((RING, 37), (PISTON, 6)):
                to = {path: 1.0 + growth / 100.0}
                event = happens(120, (path,), begin=0, over=120, power=3, **to)
                words = f"{path.replace('_', ' ')} gap +{growth} % in 120 nights"
                yield _cell("from the first night", words, machine, event, 30, baseline)


SECOND = CHANGE + 35


def _second() -> Iterator[Cell]:
    """A second change after a first; begin is the second's."""
    firsts = {
        "oil −20 %": change(viscosity=0.8),
        "meter +6 %": change(gain=1.06),
        "all gaps +12 %": change(wear=1.12),
    }
    seconds = {
        "the ring wears": happens(225, (RING,), (), SECOND, over=120, power=3, piston_ring=1.37),
        "a sleeve breaks": happens(SECOND + 30, (SLEEVE,), (), SECOND, balance_sleeve=3.0),
    }
    for words, first in firsts.items():
        yield _cell("after a change", words, "otherwise", Event(first, YEAR, CHANGE), 20)
        for then, second in seconds.items():
            event = replace(second, course=both(first, second.course))
            yield _cell("second change", f"{words}, then {then}", "otherwise", event, 20)
    until = change(until=SECOND, wear=1.12)
    repaired = Event(until, SECOND + 30, SECOND, ("back_as_before",), GAPS + FLOWS)
    yield _cell("second change", "all gaps +12 %, then repaired", "otherwise", repaired, 20)


def _other_duty() -> Iterator[Cell]:
    """+20 % of all gaps twenty nights after other operating conditions."""
    more = happens(CHANGE + 40, GAPS, FLOWS, CHANGE + 20, wear=1.2)
    for words in ("load halved", "speed cut by half"):
        event = replace(more, course=both(NO_WEAR[words].course, more.course))
        yield _cell("wear at another duty", f"{words}, then all gaps +20 %", "otherwise", event)


def _kinds() -> Iterator[Cell]:
    """Motors and nights that tell less: figures, and no false name."""
    kinds = {
        "always at 200 bar": ("as modelled", replace(FITTED, bar=(200.0, 200.0))),
        "nights of ten minutes": ("as modelled", replace(FITTED, minutes=10)),
        "flushing estimated": ("as modelled", replace(FLUSHED, fitted=AND_FLUSHING)),
        "two-sided": ("two-sided", TWO_SIDED),
    }
    events = {
        "nothing": replace(NOTHING, nights=200),
        **{name: WEAR[name] for name in list(WEAR)[1::2]},
        "oil −20 %": NO_WEAR["oil −20 %"],
    }
    for words, event in events.items():
        for kind, (machine, of) in kinds.items():
            yield _cell(f"special: {kind}", words, machine, event, 20, 15, of=of)


FIRST_WORN, NAMED_NIGHTS = 40, 62


def _at_once(right: Names = (), near: Names = (), **to: float) -> Event:
    """What a change is called: a baseline of 40 nights, and 22 after the change."""
    return happens(NAMED_NIGHTS, right, near, FIRST_WORN, **to)


DUTIES = {"load halved": {"load": 0.5}, "speed cut": {"speed": 0.5}}
NAMED = {
    "nothing": _at_once(),
    "oil −5.5 %": _at_once(FLOWS + GRADE, viscosity=0.945),
    "oil −10 %": _at_once(FLOWS + GRADE, viscosity=0.9),
    "oil −20 %": _at_once(FLOWS + GRADE, viscosity=0.8),
    "oil +25 %": _at_once(FLOWS + GRADE, viscosity=1.25),
    "VG 46 for VG 68": _at_once(GRADE, FLOWS, vg46=1.0),
    "meter +3 %": _at_once(FLOWS, gain=1.03),
    "meter +6 %": _at_once(FLOWS, gain=1.06),
    "temperature −1 °C": _at_once(SENSOR, FLOWS, reads_high_c=-1.0),
    "temperature −3 °C": _at_once(SENSOR, FLOWS, reads_high_c=-3.0),
    **{
        f"{name.replace('_', ' ')} +{percent} %": _at_once((name,), **{name: 1 + percent / 100})
        for name in PATHS
        for percent in (10, 30, 100)
    },
    **{
        f"{words} +30 %": _at_once(
            (f"{pair[0]} and {pair[1]}",), pair + GAPS, **dict.fromkeys(pair, 1.3)
        )
        for words, pair in {
            "ring and sleeve": (RING, SLEEVE),
            "piston and sleeve": (PISTON, SLEEVE),
        }.items()
    },
    **{
        f"{name.replace('_', ' ')} +30 %, oil −20 %": _at_once(
            SEVERAL, (name, *FLOWS, *GAPS, *GRADE), viscosity=0.8, **{name: 1.3}
        )
        for name in PATHS
    },
    "load halved": _at_once(load=0.5),
    "speed cut": _at_once(speed=0.5),
    "load halved, oil −20 %": _at_once(FLOWS + GRADE, viscosity=0.8, load=0.5),
    **{
        f"{words}, {name.replace('_', ' ')} +30 %": _at_once((name,), **duty, **{name: 1.3})
        for words, duty in DUTIES.items()
        for name in PATHS
    },
    "meter's zero +0.02 l/min": _at_once(("zero",), FLOWS, zero_l_per_min=0.02),
    "meter's zero +0.06 l/min": _at_once(("zero",), FLOWS, zero_l_per_min=0.06),
    "temperature lag 60 s": _at_once(temperature_lag_s=60.0),
    # A sensor that lags reads wrong; flows at what it reads, and their way with it, are others.
    "temperature lag 600 s": _at_once(SENSOR, FLOWS + WARMTH, temperature_lag_s=600.0),
    "drain lag 20 s": _at_once(drain_lag_s=20.0),
    "dead band 0.3 l/min": _at_once(dead_below_l_per_min=0.3),
}
NAMED_ON_ONE_PATH = {
    **{words: NAMED[words] for words in ("nothing", "oil −10 %", "oil −20 %", "oil +25 %")},
    **{
        f"ring-like +{percent} %": _at_once(near=(*GAPS, "flushing"), ring_like=percent / 100)
        for percent in (5, 10, 20, 30)
    },
    "ring-like +20 %, oil +25 %": _at_once(
        SEVERAL, (*FLOWS, *GAPS, "flushing"), ring_like=0.2, viscosity=1.25
    ),
}
NAMED_IN = {
    "names, nights of 60 min": (NAMED, 50, FITTED),
    "names, nights of 30 min": (NAMED, 30, replace(FITTED, minutes=30)),
    "names, one path and flushing": (NAMED_ON_ONE_PATH, 30, replace(FLUSHED, fitted=ONE_PATH)),
}


def _named() -> Iterator[Cell]:
    for group, (events, motors, of) in NAMED_IN.items():
        for words, event in events.items():
            yield _cell(group, words, "as modelled", event, motors, FIRST_WORN, of=of)


def _tanks() -> Iterator[Cell]:
    """Three motors on a tank: what the first has, which is judged, and what the others have."""
    thin, healthy = change(FIRST_WORN, viscosity=0.8), NOTHING.course
    tanks = {
        "oil −20 %": (_at_once(("tank",), FLOWS + GRADE, viscosity=0.8), thin),
        "meter of one +6 %": (_at_once(FLOWS, gain=1.06), healthy),
        "sleeve of one +50 %": (_at_once((SLEEVE,), balance_sleeve=1.5), healthy),
        "oil −20 %, sleeve of one +50 %": (
            _at_once(SEVERAL, (SLEEVE, "tank", *FLOWS, *GRADE), viscosity=0.8, balance_sleeve=1.5),
            thin,
        ),
    }
    for words, (event, other) in tanks.items():
        tank = (other, other)
        yield _cell("tank of three", words, "otherwise", event, 20, FIRST_WORN, tank=tank)


def _laminar() -> Iterator[Cell]:
    """An all-laminar machine: its leakage at the reference and at its own conditions."""
    event = Event(change(0, 90, warmer_k=10.0), 90)

    def make(seed: Seed, nights: int) -> Sequence[History]:
        found = history(LAMINAR, event.course, nights, seed)
        blocks = np.concatenate([one.conditions for one in found.nights[:8]])
        own = np.median(blocks, axis=0).tolist()
        of = tuple(asked(LAMINAR, one) for one in ((50.0, 200.0, 30.0), own))
        return [replace(found, asked=of)]

    yield Cell("laminar", "oil +10 K in 90 nights", "all laminar", make, 20, event, 8)


def _warming(night: Array) -> State:
    """A season of +12 K in 90 nights."""
    return State(warmer_k=12.0 * np.clip(night / 90, 0.0, 1.0) - 6.0)


WORN = GAPS + FLOWS
STORIES: Mapping[str, Event] = {
    "nothing": Event(NOTHING.course, 100),
    "load +30 %": Event(change(30, load=1.3), 70),
    "load −40 %": Event(change(30, load=0.6), 70),
    "season, +12 K in 90 nights": Event(_warming, 100),
    "oil −20 %": happens(60, FLOWS + GRADE, (), 30, viscosity=0.8),
    "meter +6 %": happens(60, FLOWS, (), 30, gain=1.06),
    "wear, a step": happens(60, WORN, (), 30, wear=1.25),
    "the season, and a step of wear": Event(both(_warming, change(45, wear=1.18)), 100, 45, WORN),
    "the season, and wear in 70 nights": Event(
        both(_warming, change(20, 70, wear=1.35)), 100, 20, WORN
    ),
    "wear in 8 nights": happens(50, WORN, (), 20, over=8, wear=1.4),
    "wear in 45 nights, then a repair": happens(90, WORN, (), 15, over=45, until=60, wear=1.3),
    "every third night +8 %": happens(90, ("odd_nights",), (), 40, every=3, gain=1.08),
}


def _foreign() -> Iterator[Cell]:
    for machine in foreign.MACHINES:
        for words, event in STORIES.items():
            yield _cell("not fitted", words, machine, event, 8, foreign.BASELINE)


def _rig() -> Iterator[Cell]:
    for words, cut in CUTS.items():
        begin = BEGIN if cut.is_worn else None
        event = Event(NOTHING.course, cut.nights, begin, FLOWS + GAPS)
        yield Cell(RIG, words, "pump", cut.make, 8 if cut.is_mixed else 1, event, 8)


def cells() -> dict[str, Cell]:
    """All of them by key."""
    makers = (
        _healthy,
        _changes,
        _from_the_first,
        _second,
        _other_duty,
        _kinds,
        _named,
        _tanks,
        _laminar,
        _foreign,
        _rig,
    )
    return {cell.key: cell for make in makers for cell in make()}
