"""All cells: motors to which the same happens, and what may be said of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from benchmarks.watch.cb560 import (
    FITTED,
    FLUSHED,
    HEALTHY,
    LAMINAR,
    OTHERWISE,
    PATHS,
    PISTON,
    RING,
    SLEEVE,
    TWO_SIDED,
    USUAL,
    VG46,
    Course,
    Nights,
    State,
    World,
    asked,
    history,
)
from benchmarks.watch.conveyor import Conveyor
from benchmarks.watch.foreign import BASELINE as FOREIGN_BASELINE
from benchmarks.watch.foreign import STORIES, Foreign
from benchmarks.watch.foreign import history as foreign_history
from benchmarks.watch.history import Event, History
from benchmarks.watch.mill import Mill
from benchmarks.watch.rig import BEGIN, CUTS
from benchmarks.watch.winch import Winch
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

BASELINE, CHANGE, YEAR = 60, 75, 365
RIG = "pump rig"
# Ambient temperature [K about its mean]: the year, and the weather with its memory; and what oil
# and sensor take of it.
SEASON_K, WEATHER_K, WEATHER_PHI = 12.0, 4.0, 0.7
OIL_FOLLOWS, SENSOR_FOLLOWS = 0.6, 0.1

Seed = tuple[int, ...]
# A motor of a seed, or all of a tank, and so many of its nights.
Make = Callable[[Seed, int], Sequence[History]]


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


TRUTHS = {"otherwise": OTHERWISE, "as modelled": FITTED, "two-sided": TWO_SIDED}
WORLDS = {
    "plain": USUAL,
    "wander × 1.5, φ 0.8": World(1.5, 0.8),
    "φ 0.9": World(phi=0.9),
    "1 % odd nights": World(odd=0.01),
    "each path ± 1.5 %": World(paths=0.015),
}
FLOWS, GAPS = frozenset({"all_flows"}), frozenset({"all_gaps"})
GRADE, SENSOR = frozenset({"oil_grade"}), frozenset({"temperature_sensor"})
WARMTH, SEVERAL = frozenset({"temperature_effect"}), frozenset({"several"})


def step(begin: int = CHANGE, **changed: Any) -> Course:
    """Something is otherwise from a night on."""
    now = State(**changed)
    return lambda night: now if night >= begin else HEALTHY


def gap(path: str, growth: float, nights: int, begin: int = CHANGE) -> Course:
    """A gap grows evenly by so much in so many nights."""
    return lambda night: State(paths={path: (1.0 + growth * _share(night, begin, nights)) ** 3})


def drift(begin: int, nights: int, **to: float) -> Course:
    """A figure of the state that goes evenly to another."""
    first = asdict(HEALTHY)

    def course(night: int) -> State:
        share = _share(night, begin, nights)
        return State(
            **{name: first[name] + share * (end - first[name]) for name, end in to.items()}
        )

    return course


def _share(night: int, begin: int, nights: int) -> float:
    return float(np.clip((night - begin) / nights, 0.0, 1.0))


def after(first: Course, second: Course) -> Course:
    """Two changes: what the first is, with the paths of both."""

    def course(night: int) -> State:
        one, other = first(night), second(night)
        paths = {
            name: one.paths.get(name, 1.0) * other.paths.get(name, 1.0)
            for name in sorted({*one.paths, *other.paths})
        }
        return replace(one, paths=paths)

    return course


def ambient_k(seed: Seed, winter_first: bool) -> Array:
    """Ambient temperature over a year from its coldest or its warmest day on, shape (365,) [K]."""
    white = np.random.default_rng([*seed, 9]).standard_normal(YEAR)
    year = SEASON_K * np.cos(2.0 * np.pi * np.arange(YEAR) / YEAR)
    weather = WEATHER_K * autoregression(white, WEATHER_PHI)
    found: Array = weather - year if winter_first else weather + year
    return found


def season(seed: Seed) -> Course:
    """Oil that follows the ambient temperature, winter first."""
    air = ambient_k(seed, winter_first=True)
    return lambda night: State(warmer_k=OIL_FOLLOWS * float(air[night]))


def sensor(seed: Seed) -> Course:
    """A temperature sensor that takes some of the ambient temperature, summer first."""
    air = ambient_k(seed, winter_first=False)
    return lambda night: State(reads_high_c=SENSOR_FOLLOWS * float(air[night]))


NOTHING = Event(lambda _: HEALTHY, YEAR)


def _cell(
    group: str,
    words: str,
    machine: str,
    event: Event,
    motors: int = 30,
    baseline: int = BASELINE,
    rivals: bool = False,
    by_seed: Callable[[Seed], Course] | None = None,
    **of: Any,
) -> Cell:
    """Motors of a CB560; `of` are its world and the kind of its nights."""
    truth = FLUSHED if "kind" in of and of["kind"].with_flushing else TRUTHS[machine]

    def make(seed: Seed, nights: int) -> Sequence[History]:
        course = by_seed(seed) if by_seed else event.course
        return [history(truth, course, nights, seed, baseline=baseline, **of)]

    return Cell(group, words, machine, make, motors, event, baseline, rivals)


def _healthy() -> Iterator[Cell]:
    for world, of in WORLDS.items():
        for baseline in (8, 15, 60):
            rivals = world == "plain" and baseline == BASELINE
            yield _cell("healthy", world, "otherwise", NOTHING, 67, baseline, rivals, world=of)
    for baseline in (8, 60):
        yield _cell("healthy", "plain", "as modelled", NOTHING, 30, baseline)


WEAR = {
    **{
        f"all gaps' flow +{percent} % at once": Event(
            step(paths=dict.fromkeys(PATHS, 1.0 + percent / 100)), 115, CHANGE, GAPS, FLOWS
        )
        for percent in (10, 20, 30)
    },
    "ring gap +37 % in 120 nights": Event(
        gap(RING, 0.37, 120), 225, CHANGE, frozenset({RING}), is_step=False
    ),
    "sleeve gap +9 % in a year (+10 % of leakage)": Event(
        gap(SLEEVE, 0.09, YEAR), CHANGE + 200, CHANGE, frozenset({SLEEVE}), is_step=False
    ),
    "a sleeve breaks: its flow × 3": Event(
        step(paths={SLEEVE: 3.0}), 95, CHANGE, frozenset({SLEEVE})
    ),
}
NO_WEAR = {
    "load halved": Event(step(load=0.5), 135, CHANGE),
    "speed cut by half": Event(step(speed=0.5), 135, CHANGE),
    "VG 46 for VG 68, undeclared": Event(step(oil=VG46), 95, CHANGE, GRADE, FLOWS),
    "oil −20 %": Event(step(viscosity=0.8), 95, CHANGE, FLOWS | GRADE),
    "meter +6 % at once": Event(step(gain=1.06), 95, CHANGE, FLOWS),
    "temperature sensor −3 °C": Event(step(reads_high_c=-3.0), 95, CHANGE, SENSOR, FLOWS),
    "oil thins by 10 % in 90 nights": Event(
        drift(CHANGE, 90, viscosity=0.9), 195, CHANGE, FLOWS | GRADE, is_step=False
    ),
    "meter drifts by +6 % in 120 nights": Event(
        drift(CHANGE, 120, gain=1.06), 225, CHANGE, FLOWS, is_step=False
    ),
    "every third night +8 %": Event(
        lambda n: State(gain=1.08 if n >= CHANGE and n % 3 == 0 else 1.0),
        135,
        CHANGE,
        frozenset({"odd_nights"}),
    ),
}
SEASONS = {
    "season: oil ± 7 K, winter first": (season, frozenset[str](), frozenset[str]()),
    "temperature sensor takes 10 % of ambient": (sensor, SENSOR, FLOWS | WARMTH),
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
    for words, (by_seed, right, near) in SEASONS.items():
        event = replace(NOTHING, nights=245, right=right, near=near)
        yield _cell("no wear", words, "otherwise", event, 30, rivals=True, by_seed=by_seed)


def _from_the_first() -> Iterator[Cell]:
    """Wear from the first night on."""
    growing = {RING: (0.37, 120), PISTON: (0.06, 120)}
    for machine in ("otherwise", "as modelled"):
        for baseline in (8, 15):
            for path, (growth, nights) in growing.items():
                event = Event(
                    gap(path, growth, nights, 0), 120, 0, frozenset({path}), is_step=False
                )
                words = f"{path.replace('_', ' ')} gap +{100 * growth:.0f} % in {nights} nights"
                yield _cell("from the first night", words, machine, event, 30, baseline)


SECOND = CHANGE + 35
ALL_UP = step(paths=dict.fromkeys(PATHS, 1.12))


def _second() -> Iterator[Cell]:
    """A second change after a first; begin is the second's."""
    firsts = {
        "oil −20 %": step(viscosity=0.8),
        "meter +6 %": step(gain=1.06),
        "all gaps +12 %": ALL_UP,
    }
    ring = gap(RING, 0.37, 120, SECOND)
    broken = step(SECOND, paths={SLEEVE: 3.0})
    for words, first in firsts.items():
        yield _cell("after a change", words, "otherwise", Event(first, YEAR, CHANGE), 20)
        seconds = {
            "the ring wears": Event(
                after(first, ring), 225, SECOND, frozenset({RING}), is_step=False
            ),
            "a sleeve breaks": Event(
                after(first, broken), SECOND + 30, SECOND, frozenset({SLEEVE})
            ),
        }
        for second, event in seconds.items():
            yield _cell("second change", f"{words}, then {second}", "otherwise", event, 20)
    repaired = Event(
        lambda n: ALL_UP(n) if n < SECOND else HEALTHY,
        SECOND + 30,
        SECOND,
        frozenset({"back_as_before"}),
        GAPS | FLOWS,
    )
    yield _cell("second change", "all gaps +12 %, then repaired", "otherwise", repaired, 20)


def _other_duty() -> Iterator[Cell]:
    """+20 % of all gaps twenty nights after other operating conditions."""
    more = step(CHANGE + 20, paths=dict.fromkeys(PATHS, 1.2))
    for words in ("load halved", "speed cut by half"):
        course = after(NO_WEAR[words].course, more)
        event = Event(course, CHANGE + 40, CHANGE + 20, GAPS, FLOWS)
        yield _cell("wear at another duty", f"{words}, then all gaps +20 %", "otherwise", event)


def _kinds() -> Iterator[Cell]:
    """Motors and nights that tell less: figures, and no false name."""
    kinds = {
        "always at 200 bar": Nights(bar=(200.0, 200.0)),
        "nights of ten minutes": Nights(minutes=10),
        "flushing estimated": Nights(with_flushing=True),
    }
    events = {
        "nothing": replace(NOTHING, nights=200),
        **{name: WEAR[name] for name in list(WEAR)[1::2]},
        "oil −20 %": NO_WEAR["oil −20 %"],
    }
    for words, event in events.items():
        for kind, nights in kinds.items():
            yield _cell(f"special: {kind}", words, "as modelled", event, 20, 15, kind=nights)
        yield _cell("special: two-sided", words, "two-sided", event, 20, 15)


FIRST_WORN, NAMED_NIGHTS = 40, 62


def _named() -> Iterator[Cell]:
    """What a change is called: a baseline of 40 nights, and 22 after the change."""
    for minutes, motors in ((60, 50), (30, 30)):
        for words, changed in NAMED.items():
            event = replace(changed, nights=NAMED_NIGHTS, begin=FIRST_WORN)
            yield _cell(
                f"names, nights of {minutes} min",
                words,
                "as modelled",
                event,
                motors,
                FIRST_WORN,
                kind=Nights(minutes),
            )
    for words, changed in ONE_PATH.items():
        event = replace(changed, nights=NAMED_NIGHTS, begin=FIRST_WORN)
        kind = Nights(with_flushing=True, one_path=True)
        yield _cell(
            "names, one path and flushing", words, "as modelled", event, 30, FIRST_WORN, kind=kind
        )


def _at_once(right: Iterable[str] = (), near: Iterable[str] = (), **changed: Any) -> Event:
    return Event(step(FIRST_WORN, **changed), 0, FIRST_WORN, frozenset(right), frozenset(near))


NAMED = {
    "nothing": replace(NOTHING, nights=0),
    "oil −5.5 %": _at_once(FLOWS | GRADE, viscosity=0.945),
    "oil −10 %": _at_once(FLOWS | GRADE, viscosity=0.9),
    "oil −20 %": _at_once(FLOWS | GRADE, viscosity=0.8),
    "oil +25 %": _at_once(FLOWS | GRADE, viscosity=1.25),
    "VG 46 for VG 68": _at_once(GRADE, FLOWS, oil=VG46),
    "meter +3 %": _at_once(FLOWS, gain=1.03),
    "meter +6 %": _at_once(FLOWS, gain=1.06),
    "temperature −1 °C": _at_once(SENSOR, FLOWS, reads_high_c=-1.0),
    "temperature −3 °C": _at_once(SENSOR, FLOWS, reads_high_c=-3.0),
    **{
        f"{name.replace('_', ' ')} +{percent} %": _at_once([name], paths={name: 1 + percent / 100})
        for name in PATHS
        for percent in (10, 30, 100)
    },
    **{
        f"{words} +30 %": _at_once(
            [" and ".join(pair)], [*pair, *GAPS], paths=dict.fromkeys(pair, 1.3)
        )
        for words, pair in (
            ("ring and sleeve", (RING, SLEEVE)),
            ("piston and sleeve", (PISTON, SLEEVE)),
        )
    },
    **{
        f"{name.replace('_', ' ')} +30 %, oil −20 %": _at_once(
            SEVERAL, near=[name, *FLOWS, *GAPS, *GRADE], viscosity=0.8, paths={name: 1.3}
        )
        for name in PATHS
    },
    "load halved": _at_once(load=0.5),
    "speed cut": _at_once(speed=0.5),
    "load halved, oil −20 %": _at_once(FLOWS | GRADE, viscosity=0.8, load=0.5),
    **{
        f"{words}, {name.replace('_', ' ')} +30 %": _at_once(
            [name], paths={name: 1.3}, load=load, speed=speed
        )
        for words, load, speed in (("load halved", 0.5, 1.0), ("speed cut", 1.0, 0.5))
        for name in PATHS
    },
    "meter's zero +0.02 l/min": _at_once(["zero"], FLOWS, zero_l_per_min=0.02),
    "meter's zero +0.06 l/min": _at_once(["zero"], FLOWS, zero_l_per_min=0.06),
    "temperature lag 60 s": _at_once(temperature_lag_s=60.0),
    # A sensor that lags reads wrong; flows at what it reads, and their way with it, are others.
    "temperature lag 600 s": _at_once(SENSOR, FLOWS | WARMTH, temperature_lag_s=600.0),
    "drain lag 20 s": _at_once(drain_lag_s=20.0),
    "dead band 0.3 l/min": _at_once(dead_below_l_per_min=0.3),
}
ONE_PATH = {
    **{words: NAMED[words] for words in ("nothing", "oil −10 %", "oil −20 %", "oil +25 %")},
    **{
        f"ring-like +{percent} %": _at_once(near=["all_gaps", "flushing"], ring_like=percent / 100)
        for percent in (5, 10, 20, 30)
    },
    "ring-like +20 %, oil +25 %": _at_once(
        SEVERAL, near=[*FLOWS, "all_gaps", "flushing"], ring_like=0.2, viscosity=1.25
    ),
}


def _tanks() -> Iterator[Cell]:
    """Three motors on a tank: what all have, and what the first has besides, which is judged."""
    oil, tank = State(viscosity=0.8), frozenset({"tank"})
    worn = State(paths={SLEEVE: 1.5})
    both = State(paths={SLEEVE: 1.5}, viscosity=0.8)
    tanks = {
        "oil −20 %": (oil, oil, tank, FLOWS | GRADE),
        "meter of one +6 %": (State(gain=1.06), HEALTHY, FLOWS, frozenset[str]()),
        "sleeve of one +50 %": (worn, HEALTHY, frozenset({SLEEVE}), frozenset[str]()),
        "oil −20 %, sleeve of one +50 %": (
            both,
            oil,
            SEVERAL,
            frozenset({SLEEVE, "tank", *FLOWS, *GRADE}),
        ),
    }
    for words, (first, others, right, near) in tanks.items():
        courses = [_from(state) for state in (first, others, others)]

        def make(seed: Seed, nights: int, courses: Sequence[Course] = courses) -> Sequence[History]:
            return [
                history(OTHERWISE, course, nights, (*seed, place), baseline=FIRST_WORN)
                for place, course in enumerate(courses)
            ]

        event = Event(courses[0], NAMED_NIGHTS, FIRST_WORN, right, near)
        yield Cell("tank of three", words, "otherwise", make, 20, event, FIRST_WORN)


def _from(state: State) -> Course:
    return lambda night: state if night >= FIRST_WORN else HEALTHY


def _laminar() -> Iterator[Cell]:
    """An all-laminar machine: its leakage at the reference and at its own conditions."""
    course = drift(0, 90, warmer_k=10.0)
    event = Event(course, 90)

    def make(seed: Seed, nights: int) -> Sequence[History]:
        found = history(LAMINAR, course, nights, seed)
        blocks = np.concatenate([one.conditions for one in found.nights[:8]])
        own = np.median(blocks, axis=0).tolist()
        of = tuple(asked(LAMINAR, one) for one in ((50.0, 200.0, 30.0), own))
        return [replace(found, asked=of)]

    yield Cell("laminar", "oil +10 K in 90 nights", "all laminar", make, 20, event, 8)


FOREIGN: Mapping[str, Foreign] = {"mill": Mill(), "winch": Winch(), "conveyor": Conveyor()}


def _foreign() -> Iterator[Cell]:
    for machine, of in FOREIGN.items():
        for words, event in STORIES.items():

            def make(
                seed: Seed, nights: int, of: Foreign = of, event: Event = event
            ) -> Sequence[History]:
                return [foreign_history(of, event.course, nights, seed)]

            yield Cell("not fitted", words, machine, make, 8, event, FOREIGN_BASELINE)


def _rig() -> Iterator[Cell]:
    for words, cut in CUTS.items():
        begin = BEGIN if cut.is_worn else None
        event = replace(NOTHING, nights=cut.nights, begin=begin, right=FLOWS | GAPS)
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
