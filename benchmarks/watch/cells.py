"""All cells: motors to which the same happens, and causes that may be named."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from benchmarks.watch import foreign, rig
from benchmarks.watch.cb560 import FITTED, FLUSHED, LAMINAR, OTHERWISE, TWO_SIDED
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
    history,
)
from pipeline.arrays import Array
from pipeline.demo.fleet import autoregression

BASELINE, CHANGE, YEAR = 60, 75, 365
RIG, PLAIN = "pump rig", ("healthy", "plain")
# Ambient temperature [K about its mean]: the year, and the weather with its memory; and what oil
# and sensor take of it.
SEASON_K, WEATHER_K, WEATHER_PHI = 12.0, 4.0, 0.7
OIL_FOLLOWS, SENSOR_FOLLOWS = 0.6, 0.1

Seed = tuple[int, ...]
Names = tuple[str, ...]
# A machine that is simulated, or nights of a record.
Of = Machine | Callable[[Seed], Sequence[History]]
FLOWS, GAPS, GRADE = ("all_flows",), ("all_gaps",), ("oil_grade",)
SENSOR, WARMTH = ("temperature_sensor",), ("temperature_effect",)
# Of what is otherwise: causes that are true, and those that say less than the truth and nothing
# false. Of load and speed nothing may be named.
CAUSES: Mapping[str, tuple[Names, Names]] = {
    **{path: ((path,), ()) for path in PATHS},
    "wear": (GAPS, FLOWS),
    "viscosity": (FLOWS + GRADE, ()),
    "vg46": (GRADE, FLOWS),
    "gain": (FLOWS, ()),
    "reads_high_c": (SENSOR, FLOWS),
    # A sensor that lags reads wrong; flows at what it reads, and their way with it, are others.
    "temperature_lag_s": (SENSOR, (*FLOWS, *WARMTH, "channels")),
    "drain_lag_s": (("channels",), ()),
    "zero_l_per_min": (("zero",), FLOWS),
    "ring_like": ((), (*GAPS, "flushing")),
}


@dataclass(frozen=True)
class Event:
    """What happens to a motor, and the causes that may be named."""

    course: Course
    nights: int
    begin: int | None = None  # night from which on something is otherwise than it was
    right: Names = ()
    near: Names = ()
    others: Course | None = None  # of two more motors on its tank
    by_seed: Callable[[Seed], Course] | None = None  # in place of `course`

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
    of: Of
    event: Event
    motors: int
    baseline: int
    has_rivals: bool

    @property
    def key(self) -> str:
        """Its name among all."""
        return "; ".join((self.group, self.words, self.machine, str(self.baseline)))

    def make(self, seed: Seed, nights: int) -> Sequence[History]:
        """A motor of a seed, or all of a tank, and so many of its nights."""
        if callable(self.of):
            return self.of(seed)
        event, of = self.event, (nights, self.baseline)
        if event.others is None:
            course = event.by_seed(seed) if event.by_seed else event.course
            return [history(self.of, course, seed, *of)]
        courses = enumerate((event.course, event.others, event.others))
        return [history(self.of, course, (*seed, place), *of) for place, course in courses]


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
            **{
                name: (first + share * (to[name] - first)) ** power
                for name, first in firsts.items()
            }
        )

    return course


def happens(nights: int, begin: int = CHANGE, **of: Any) -> Event:
    """A change, and the causes that may be named for what goes to another value."""
    changed = [name for name in of if name in CAUSES]
    right = tuple(cause for name in changed for cause in CAUSES[name][0])
    near = tuple(cause for name in changed for cause in CAUSES[name][1])
    if "every" in of:
        right, near = ("odd_nights",), ()
    elif len(changed) > 1:
        several = " and ".join(changed) if set(changed) < set(PATHS) else "several"
        right, near = (several,), (*right, *near, *GAPS)
    return Event(change(begin, **of), nights, begin, right, near)


def both(first: Course, second: Course) -> Course:
    """Two changes: factors multiply, others add."""

    def course(night: Array) -> State:
        pairs = {
            of.name: (getattr(first(night), of.name), getattr(second(night), of.name), of.default)
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


def warming(night: Array) -> State:
    """A season of +12 K in 90 nights."""
    return State(warmer_k=12.0 * np.clip(night / 90, 0.0, 1.0) - 6.0)


NOTHING = Event(lambda _: HEALTHY, YEAR)
RING_WEARS: Mapping[str, Any] = {"over": 120, "power": 3, RING: 1.37}
WEAR = {
    "all gaps' flow +10 % at once": happens(115, wear=1.1),
    "all gaps' flow +20 % at once": happens(115, wear=1.2),
    "all gaps' flow +30 % at once": happens(115, wear=1.3),
    "ring gap +37 % in 120 nights": happens(225, **RING_WEARS),
    "sleeve gap +9 % in a year (+10 % of leakage)": happens(
        CHANGE + 200, over=YEAR, power=3, balance_sleeve=1.09
    ),
    "a sleeve breaks: its flow × 3": happens(95, balance_sleeve=3.0),
}
NO_WEAR = {
    "load halved": happens(135, load=0.5),
    "speed cut by half": happens(135, speed=0.5),
    "VG 46 for VG 68, undeclared": happens(95, vg46=1.0),
    "oil −20 %": happens(95, viscosity=0.8),
    "meter +6 % at once": happens(95, gain=1.06),
    "temperature sensor −3 °C": happens(95, reads_high_c=-3.0),
    "oil thins by 10 % in 90 nights": happens(195, over=90, viscosity=0.9),
    "meter drifts by +6 % in 120 nights": happens(225, over=120, gain=1.06),
    "every third night +8 %": happens(135, every=3, gain=1.08),
}
OF_AMBIENT = {
    "season: oil ± 7 K, winter first": replace(
        NOTHING, nights=245, by_seed=partial(ambient, "warmer_k", OIL_FOLLOWS, -1.0)
    ),
    "temperature sensor takes 10 % of ambient": replace(
        NOTHING,
        nights=245,
        right=SENSOR,
        near=FLOWS + WARMTH,
        by_seed=partial(ambient, "reads_high_c", SENSOR_FOLLOWS, 1.0),
    ),
}
FROM_THE_FIRST = {
    f"{path.replace('_', ' ')} gap +{growth} % in 120 nights": happens(
        120, 0, over=120, power=3, **{path: 1.0 + growth / 100.0}
    )
    for path, growth in ((RING, 37), (PISTON, 6))
}
# A second change after a first; begin is the second's.
SECOND = CHANGE + 35
FIRSTS = {
    "oil −20 %": change(viscosity=0.8),
    "meter +6 %": change(gain=1.06),
    "all gaps +12 %": change(wear=1.12),
}
SECONDS = {
    "the ring wears": happens(225, SECOND, **RING_WEARS),
    "a sleeve breaks": happens(SECOND + 30, SECOND, balance_sleeve=3.0),
}
TWO = {
    **{
        f"{words}, then {then}": replace(second, course=both(first, second.course))
        for words, first in FIRSTS.items()
        for then, second in SECONDS.items()
    },
    "all gaps +12 %, then repaired": Event(
        change(until=SECOND, wear=1.12), SECOND + 30, SECOND, ("back_as_before",), GAPS + FLOWS
    ),
}
# +20 % of all gaps twenty nights after other operating conditions.
LATER = happens(CHANGE + 40, CHANGE + 20, wear=1.2)
AT_ANOTHER_DUTY = {
    f"{words}, then all gaps +20 %": replace(
        LATER, course=both(NO_WEAR[words].course, LATER.course)
    )
    for words in ("load halved", "speed cut by half")
}
SPECIAL = {
    "nothing": replace(NOTHING, nights=200),
    **{name: WEAR[name] for name in list(WEAR)[1::2]},
    "oil −20 %": NO_WEAR["oil −20 %"],
}
# What a change is called: a baseline of 40 nights, and 22 after the change.
named = partial(happens, 62, 40)
NAMED = {
    "nothing": named(),
    "oil −5.5 %": named(viscosity=0.945),
    "oil −10 %": named(viscosity=0.9),
    "oil −20 %": named(viscosity=0.8),
    "oil +25 %": named(viscosity=1.25),
    "VG 46 for VG 68": named(vg46=1.0),
    "meter +3 %": named(gain=1.03),
    "meter +6 %": named(gain=1.06),
    "temperature −1 °C": named(reads_high_c=-1.0),
    "temperature −3 °C": named(reads_high_c=-3.0),
    **{
        f"{path.replace('_', ' ')} +{percent} %": named(**{path: 1 + percent / 100})
        for path in PATHS
        for percent in (10, 30, 100)
    },
    "ring and sleeve +30 %": named(piston_ring=1.3, balance_sleeve=1.3),
    "piston and sleeve +30 %": named(balance_piston=1.3, balance_sleeve=1.3),
    **{
        f"{path.replace('_', ' ')} +30 %, oil −20 %": named(viscosity=0.8, **{path: 1.3})
        for path in PATHS
    },
    "load halved": named(load=0.5),
    "speed cut": named(speed=0.5),
    "load halved, oil −20 %": named(viscosity=0.8, load=0.5),
    **{
        f"{words}, {path.replace('_', ' ')} +30 %": named(**{duty: 0.5, path: 1.3})
        for words, duty in (("load halved", "load"), ("speed cut", "speed"))
        for path in PATHS
    },
    "meter's zero +0.02 l/min": named(zero_l_per_min=0.02),
    "meter's zero +0.06 l/min": named(zero_l_per_min=0.06),
    "temperature lag 60 s": named(temperature_lag_s=60.0),
    "temperature lag 600 s": named(temperature_lag_s=600.0),
    "drain lag 20 s": named(drain_lag_s=20.0),
    "dead band 0.3 l/min": named(dead_below_l_per_min=0.3),
}
NAMED_ON_ONE_PATH = {
    **{words: NAMED[words] for words in ("nothing", "oil −10 %", "oil −20 %", "oil +25 %")},
    **{f"ring-like +{percent} %": named(ring_like=percent / 100) for percent in (5, 10, 20, 30)},
    "ring-like +20 %, oil +25 %": named(ring_like=0.2, viscosity=1.25),
}
# Three motors on a tank: what the first has, which is judged, and what the others have.
THIN = NAMED["oil −20 %"].course
TANK = {
    "oil −20 %": replace(NAMED["oil −20 %"], right=("tank",), near=FLOWS + GRADE, others=THIN),
    "meter of one +6 %": replace(NAMED["meter +6 %"], others=NOTHING.course),
    "sleeve of one +50 %": replace(named(balance_sleeve=1.5), others=NOTHING.course),
    "oil −20 %, sleeve of one +50 %": replace(
        named(viscosity=0.8, balance_sleeve=1.5),
        near=(SLEEVE, "tank", *FLOWS, *GRADE),
        others=THIN,
    ),
}
STORIES = {
    "nothing": replace(NOTHING, nights=100),
    "load +30 %": replace(happens(70, 30, load=1.3), begin=None),
    "load −40 %": replace(happens(70, 30, load=0.6), begin=None),
    "season, +12 K in 90 nights": Event(warming, 100),
    "oil −20 %": happens(60, 30, viscosity=0.8),
    "meter +6 %": happens(60, 30, gain=1.06),
    "wear, a step": happens(60, 30, wear=1.25),
    "the season, and a step of wear": Event(
        both(warming, change(45, wear=1.18)), 100, 45, *CAUSES["wear"]
    ),
    "the season, and wear in 70 nights": Event(
        both(warming, change(20, 70, wear=1.35)), 100, 20, *CAUSES["wear"]
    ),
    "wear in 8 nights": happens(50, 20, over=8, wear=1.4),
    "wear in 45 nights, then a repair": happens(90, 15, over=45, until=60, wear=1.3),
    "every third night +8 %": happens(90, 40, every=3, gain=1.08),
}
WORLDS = {
    "plain": OTHERWISE,
    "wander × 1.5, φ 0.8": replace(OTHERWISE, wander=1.5, phi=0.8),
    "φ 0.9": replace(OTHERWISE, phi=0.9),
    "1 % odd nights": replace(OTHERWISE, odd=0.01),
    "each path ± 1.5 %": replace(OTHERWISE, paths=0.015),
}
OTHER, MODELLED = {"otherwise": OTHERWISE}, {"as modelled": FITTED}
BOTH = OTHER | MODELLED


class Group(NamedTuple):
    """Cells of a group: each event on each machine, by each baseline."""

    name: str
    events: Mapping[str, Event]
    motors: int
    machines: Mapping[str, Of] = OTHER
    baselines: tuple[int, ...] = (BASELINE,)

    def cells(self) -> Iterator[Cell]:
        """In the order of the page."""
        for machine, of in self.machines.items():
            for baseline, (words, event) in product(self.baselines, self.events.items()):
                # What users would make is beside it on a single machine.
                is_first = self.name in ("wear", "no wear") or (self.name, words) == PLAIN
                rivals = is_first and of is OTHERWISE and baseline == BASELINE
                yield Cell(self.name, words, machine, of, event, self.motors, baseline, rivals)


def _groups() -> Iterator[Group]:
    for words, of in WORLDS.items():
        yield Group("healthy", {words: NOTHING}, 67, {"otherwise": of}, (8, 15, 60))
    yield Group("healthy", {"plain": NOTHING}, 30, MODELLED, (8, 60))
    yield Group("wear", WEAR, 30, BOTH, (60, 8))
    yield Group("no wear", NO_WEAR, 30, BOTH)
    yield Group("no wear", OF_AMBIENT, 30)
    yield Group("from the first night", FROM_THE_FIRST, 30, BOTH, (8, 15))
    firsts = {words: Event(first, YEAR, CHANGE) for words, first in FIRSTS.items()}
    yield Group("after a change", firsts, 20)
    yield Group("second change", TWO, 20)
    yield Group("wear at another duty", AT_ANOTHER_DUTY, 30)
    # Motors and nights that tell less: figures, and no false name.
    for words, of in {
        "always at 200 bar": replace(FITTED, bar=(200.0, 200.0)),
        "nights of ten minutes": replace(FITTED, minutes=10),
        "flushing estimated": replace(FLUSHED, fitted=AND_FLUSHING),
    }.items():
        yield Group(f"special: {words}", SPECIAL, 20, {"as modelled": of}, (15,))
    yield Group("special: two-sided", SPECIAL, 20, {"two-sided": TWO_SIDED}, (15,))
    half_hours = {"as modelled": replace(FITTED, minutes=30)}
    on_one_path = {"as modelled": replace(FLUSHED, fitted=ONE_PATH)}
    yield Group("names, nights of 60 min", NAMED, 50, MODELLED, (40,))
    yield Group("names, nights of 30 min", NAMED, 30, half_hours, (40,))
    yield Group("names, one path and flushing", NAMED_ON_ONE_PATH, 30, on_one_path, (40,))
    yield Group("tank of three", TANK, 20, OTHER, (40,))
    warmer = {"oil +10 K in 90 nights": Event(change(0, 90, warmer_k=10.0), 90)}
    yield Group("laminar", warmer, 20, {"all laminar": LAMINAR}, (8,))
    yield Group("not fitted", STORIES, 8, foreign.MACHINES, (foreign.BASELINE,))
    for words, nights, cut in rig.CUTS:
        for more, begin in (("", None), (", +10 % from night 20 on", rig.BEGIN)):
            event = Event(NOTHING.course, nights, begin, FLOWS + GAPS)
            motors, record = 8 if "mixed" in words else 1, partial(cut, begin=begin)
            yield Group(RIG, {words + more: event}, motors, {"pump": record}, (8,))


def cells() -> dict[str, Cell]:
    """All of them by key."""
    return {cell.key: cell for group in _groups() for cell in group.cells()}
