"""Common factor or paths: how often the explanation of a change is right, through the physics.

Motors of known truth run 40 nights of a baseline and some nights after a change, each night with
its own load, and with the wander of the noise library: 0.3 °C and 0.3 % of gain with φ = 0.6,
0.3 bar. What changes is the viscosity, a sensor or the gaps, never a figure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks import error_kinds
from benchmarks.model_verdict import VG46, SensorFaults, lagged
from benchmarks.other_duty import false_alarms, wear_told
from benchmarks.results_file import Part, write_stored
from benchmarks.simulated_nights import motor, true_coefficients
from leakage import Motor, OperatingConditions, regressors
from leakage.course.growth import Blocks, Growth, growth
from leakage.course.hypotheses import Posterior, mean_factor, weigh
from leakage.physics.oil import Oil
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

MOTORS = 200
NIGHTS_BEFORE = 40
BLOCK = 600
NOISE, NOISE_PHI = 0.013, 0.97
MOTOR = motor()
THETA = true_coefficients(MOTOR)
NAMES = RING, PISTON, SLEEVE = tuple(path.name for path in MOTOR.column_paths)
FREE = np.array([True, True, True, False])
ROLLER = "cam_roller"
SEED = 180
# Deformation constant of a ring that leaks below some 100 bar, as in validation/cuts.py.
RING_PA = 120e5


@dataclass(frozen=True)
class Change(SensorFaults):
    """What is otherwise now.

    Factors on viscosity, gain and K; errors of the temperature sensor [°C] and of the meter's zero
    [l/min]; the oil; faults of sensors, which begin then; the highest pressure and speed; the
    flushing [l/min]; and a leak below some 100 bar, over the mean flow of the gaps.
    """

    viscosity: float = 1.0
    gain: float = 1.0
    reads_low_c: float = 0.0
    paths: Mapping[str, float] = field(default_factory=dict)
    oil: Oil | None = None
    zero_l_per_min: float = 0.0
    top_bar: float = 300.0
    top_rpm: float = 110.0
    flushing_l_per_min: float = 0.0
    ring_like: float = 0.0

    @property
    def is_common(self) -> bool:
        """Whether it scales all flows."""
        return (self.viscosity, self.gain, self.reads_low_c, self.oil) != (1.0, 1.0, 0.0, None)


CHANGES = {
    "none": Change(),
    "oil −5.5 %": Change(viscosity=0.945),
    "oil −10 %": Change(viscosity=0.9),
    "oil −20 %": Change(viscosity=0.8),
    "oil +25 %": Change(viscosity=1.25),
    "VG 46 for VG 68": Change(oil=VG46),
    "meter +3 %": Change(gain=1.03),
    "meter +6 %": Change(gain=1.06),
    "temperature −1 °C": Change(reads_low_c=1.0),
    "temperature −3 °C": Change(reads_low_c=3.0),
    **{
        f"{name.replace('_', ' ')} +{percent} %": Change(paths={name: 1.0 + percent / 100})
        for name in NAMES
        for percent in (10, 30, 100)
    },
    "ring and sleeve +30 %": Change(paths={RING: 1.3, SLEEVE: 1.3}),
    "piston and sleeve +30 %": Change(paths={PISTON: 1.3, SLEEVE: 1.3}),
    **{
        f"{name.replace('_', ' ')} +30 %, oil −20 %": Change(viscosity=0.8, paths={name: 1.3})
        for name in NAMES
    },
}


SENSORS_AND_DUTY = {
    "load halved": Change(top_bar=157.0),
    "speed cut": Change(top_rpm=55.0),
    "load halved, oil −20 %": Change(viscosity=0.8, top_bar=157.0),
    **{
        f"{words}, {name.replace('_', ' ')} +30 %": Change(paths={name: 1.3}, **duty)
        for words, duty in (("load halved", {"top_bar": 157.0}), ("speed cut", {"top_rpm": 55.0}))
        for name in NAMES
    },
    "meter's zero +0.02 l/min": Change(zero_l_per_min=0.02),
    "meter's zero +0.06 l/min": Change(zero_l_per_min=0.06),
    "temperature lag 60 s": Change(temperature_lag_s=60.0),
    "temperature lag 600 s": Change(temperature_lag_s=600.0),
    "drain lag 20 s": Change(drain_lag_s=20.0),
    "dead band 0.3 l/min": Change(dead_below_l_per_min=0.3),
}
FLUSHING = 0.5
WITH_FLUSHING = {
    name: CHANGES[name]
    for name in (
        "none",
        *(one for one in CHANGES if one.startswith(("oil", "VG", "meter", "temp"))),
    )
} | {name: one for name, one in CHANGES.items() if "30 %" in name}
ONE_PATH = {
    **{name: WITH_FLUSHING[name] for name in ("none", "oil −10 %", "oil −20 %", "oil +25 %")},
    **{f"ring-like +{percent} %": Change(ring_like=percent / 100) for percent in (5, 10, 20, 30)},
    "ring-like +20 %, oil +25 %": Change(ring_like=0.2, viscosity=1.25),
}
ONE_PRESSURE = {
    name: CHANGES[name]
    for name in (
        "none",
        "oil −20 %",
        "meter +6 %",
        *(f"{name.replace('_', ' ')} +{percent} %" for name in NAMES for percent in (30, 100)),
    )
}


@dataclass(frozen=True)
class Nights:
    """Channels of some nights as logged, shape (n, nights) each, and the sensors' wander."""

    pressure_bar: Array
    temperature_c: Array
    speed_rpm: Array
    wander: error_kinds.NightWander

    @classmethod
    def drawn(
        cls,
        nights: int,
        minutes: int,
        generator: np.random.Generator,
        span_bar: tuple[float, float] = (15.0, 300.0),
    ) -> Nights:
        """Load steps of a minute, at 1 Hz."""
        n = 60 * minutes

        def steps(low: float, high: float, hold: int, lag_s: float) -> Array:
            levels = generator.uniform(low, high, (n // hold + 2, nights))
            return error_kinds.lagging(np.repeat(levels, hold, axis=0)[:n], 1.0, lag_s)

        return cls(
            steps(*span_bar, 60, 3.0),
            steps(40.0, 60.0, 600, 200.0),
            steps(3.0, 110.0, 90, 3.0),
            error_kinds.night_wander(generator, (nights,)),
        )

    def part(self, nights: slice) -> Nights:
        """Some of them."""
        wander = error_kinds.NightWander(*(one[nights] for one in self.wander))
        channels = (self.pressure_bar, self.temperature_c, self.speed_rpm)
        return Nights(*(one[:, nights] for one in channels), wander)

    def blocks(self, change: Change, generator: np.random.Generator) -> Blocks:
        """Statistics of their samples under a change."""
        n, nights = self.pressure_bar.shape
        wander = self.wander
        pressure = 15.0 + (self.pressure_bar - 15.0) * (change.top_bar - 15.0) / 285.0
        speed = 3.0 + (self.speed_rpm - 3.0) * (change.top_rpm - 3.0) / 107.0
        read_c = lagged(self.temperature_c, change.temperature_lag_s)
        truth = OperatingConditions.from_bar(
            (pressure - wander.pressure_bar).T.ravel(),
            (self.temperature_c - wander.temperature_c + change.reads_low_c).T.ravel(),
            speed.T.ravel(),
        )
        of: Motor = MOTOR if change.oil is None else replace(MOTOR, oil=change.oil)
        theta = THETA * [*(change.paths.get(name, 1.0) for name in NAMES), 1.0]
        flow = regressors(of, truth) @ np.append(theta, 1.0) / change.viscosity
        low = flow * np.exp(-3.0 * truth.pressure_difference_pa / RING_PA)
        flow += change.ring_like * low * (flow.sum() / low.sum()) + change.flushing_l_per_min
        flow = lagged(flow.reshape(nights, n).T, change.drain_lag_s).T.ravel()
        errors = autoregression(generator.standard_normal((n, nights)), NOISE_PHI)
        flow *= change.gain * np.repeat(1.0 + wander.gain, n) * (1.0 + NOISE * errors.T.ravel())
        flow = np.where(flow < change.dead_below_l_per_min, 0.0, flow) + change.zero_l_per_min
        logged = (pressure, read_c, speed)
        seen = OperatingConditions.from_bar(*(one.T.ravel() for one in logged))
        columns = np.column_stack([regressors(MOTOR, seen), flow])
        means = read_c.T.reshape(-1, BLOCK).mean(axis=1)
        return Blocks(
            np.linalg.qr(columns.reshape(len(means), BLOCK, -1), mode="r"),
            np.repeat(np.arange(nights), n // BLOCK),
            means,
        )


def outcome(found: Posterior, change: Change) -> str:
    """``right``, ``cannot`` be told, ``wrong``; without all of the truth: ``cannot``."""
    worn = tuple(change.paths)
    if set(found.named) - set(worn):
        return "wrong"
    if found.verdict == "path":
        if (change.is_common and not found.is_common) or found.named != worn:
            return "cannot"
        return "right" if found.is_common == change.is_common else "wrong"
    if found.verdict == "common":
        return "right" if change.is_common and not worn else "wrong"
    nothing = not worn and not change.is_common and not change.ring_like
    return "right" if found.verdict == "no_change" and nothing else "cannot"


def grown(before: Blocks, now: Blocks) -> Growth:
    """As trends compare two periods."""
    found = growth(NAMES, before, now, THETA, FREE, ROLLER)
    assert found is not None
    return found


def with_flushing(before: Blocks, now: Blocks) -> Growth:
    """The same, the flushing estimated."""
    theta = np.append(THETA[:-1], FLUSHING)
    found = growth(NAMES, before, now, theta, np.ones(len(theta), dtype=np.bool_), ROLLER)
    assert found is not None
    return found


def one_path(before: Blocks, now: Blocks) -> Growth:
    """The same, with one path for pistons, sleeve and rollers, and none for the rings."""
    of_gaps = np.zeros((len(NAMES) + 3, 4))
    of_gaps[[NAMES.index(PISTON), NAMES.index(SLEEVE), -2], 0] = [*THETA[1:3], 1.0]
    of_gaps[-3, 1] = of_gaps[-1, 3] = 1.0

    def merged(one: Blocks) -> Blocks:
        return replace(one, factors=np.linalg.qr(one.factors @ of_gaps, mode="r"))

    theta = np.array([1.0, FLUSHING])
    free = np.array([True, True])
    found = growth(("all_gaps",), merged(before), merged(now), theta, free)
    assert found is not None
    return found


def alone(
    minutes: int,
    nights_of_now: int,
    changes: Mapping[str, Change],
    motors: int = MOTORS,
    span_bar: tuple[float, float] = (15.0, 300.0),
    compare: Callable[[Blocks, Blocks], Growth] = grown,
) -> dict[str, Counter[str]]:
    """Outcomes of motors on their own, by change."""
    found: dict[str, Counter[str]] = {name: Counter() for name in changes}
    flushing = 0.0 if compare is grown else FLUSHING
    for number in range(motors):
        generator = np.random.default_rng([SEED, minutes, nights_of_now, number])
        nights = Nights.drawn(NIGHTS_BEFORE + nights_of_now, minutes, generator, span_bar)
        healthy = Change(flushing_l_per_min=flushing)
        before = nights.part(slice(NIGHTS_BEFORE)).blocks(healthy, generator)
        later = nights.part(slice(NIGHTS_BEFORE, None))
        for name, change in changes.items():
            now = later.blocks(replace(change, flushing_l_per_min=flushing), generator)
            told = weigh(compare(before, now))
            found[name][outcome(told, change)] += 1
    return found


# By change of a tank: what all motors of it have, and what its first motor has besides.
TANKS = {
    "oil −10 %": (Change(viscosity=0.9), Change(viscosity=0.9)),
    "oil −20 %": (Change(viscosity=0.8), Change(viscosity=0.8)),
    "one meter +6 %": (Change(), Change(gain=1.06)),
    "one sensor −3 °C": (Change(), Change(reads_low_c=3.0)),
    "sleeve +30 % of one": (Change(), Change(paths={SLEEVE: 1.3})),
    "oil −20 %, sleeve +30 % of one": (
        Change(viscosity=0.8),
        Change(viscosity=0.8, paths={SLEEVE: 1.3}),
    ),
}


def tanks(minutes: int, nights_of_now: int, number_of: int = MOTORS) -> dict[str, Counter[str]]:
    """What the first motor of a tank of three is told: paths, and where the factor comes from."""
    found: dict[str, Counter[str]] = {name: Counter() for name in TANKS}
    for number in range(number_of):
        generator = np.random.default_rng([SEED + 1, minutes, nights_of_now, number])
        motors = [Nights.drawn(NIGHTS_BEFORE + nights_of_now, minutes, generator) for _ in range(3)]
        before = [one.part(slice(NIGHTS_BEFORE)).blocks(Change(), generator) for one in motors]
        for name, (shared, first) in TANKS.items():
            growths = [
                grown(past, one.part(slice(NIGHTS_BEFORE, None)).blocks(change, generator))
                for past, one, change in zip(before, motors, (first, shared, shared), strict=True)
            ]
            others = mean_factor([weigh(one).expected for one in growths[1:]])
            told = weigh(growths[0], others)
            wrong = set(told.named) - set(first.paths)
            words = [*told.named, *([told.origin] if told.origin else [])]
            found[name]["wrong name" if wrong else " and ".join(words) or "cannot"] += 1
    return found


def _alone_part(
    heading: str,
    text: str,
    changes: Mapping[str, Change],
    cells: Sequence[tuple[int, int]],
    span_bar: tuple[float, float] = (15.0, 300.0),
    compare: Callable[[Blocks, Blocks], Growth] = grown,
) -> Part:
    found = {cell: alone(*cell, changes, MOTORS, span_bar, compare) for cell in cells}
    rows = [
        [
            name,
            *(
                "/".join(str(found[cell][name][one]) for one in ("right", "cannot", "wrong"))
                for cell in cells
            ),
        ]
        for name in changes
    ]
    header = " | ".join(
        ["change", *(f"{minutes} min, {nights} nights" for minutes, nights in cells)]
    )
    return Part(heading, f"Right / cannot be told / wrong. {text}", header, rows)


def _tanks_part() -> Part:
    rows = [
        [name, ", ".join(f"{words} {number}" for words, number in counts.most_common())]
        for name, counts in tanks(60, 5).items()
    ]
    text = "What is told of the first, 60 minutes a night, five nights since the change."
    return Part("Three motors on a tank", text, "change | told", rows)


PARTS: dict[str, Callable[[], Part]] = {
    "false_alarms": false_alarms,
    "wear_at_another_duty": wear_told,
    "alone": lambda: _alone_part(
        "Motors on their own",
        "By minutes a night and nights since the change.",
        CHANGES,
        ((90, 10), (60, 10), (30, 10), (60, 3), (30, 3)),
    ),
    "sensors_and_duty": lambda: _alone_part(
        "Sensors and duty",
        "By the explanation alone: a zero that moves is told at halts, and a lag of the drain by "
        "the model's misfit, before a path is named. A common change that is told of a zero, a lag "
        "or a dead band counts as wrong.",
        SENSORS_AND_DUTY,
        ((60, 10), (60, 3)),
    ),
    "one_pressure": lambda: _alone_part(
        "Motors at one pressure",
        "Always at 200 bar, where the paths look alike.",
        ONE_PRESSURE,
        ((60, 10), (60, 3)),
        (200.0, 200.0),
    ),
    "flushing": lambda: _alone_part(
        "Flushing that is estimated",
        "0.5 l/min of flushing, fitted with the loss factors.",
        WITH_FLUSHING,
        ((60, 10), (60, 3)),
        compare=with_flushing,
    ),
    "one_path": lambda: _alone_part(
        "One path and an estimated flushing",
        "One path stands for all gaps, the rings have none. A leak below some 100 bar is added, of "
        "that share of the flow. Thinner oil and a wear of all gaps look alike.",
        ONE_PATH,
        ((60, 10), (60, 3)),
        compare=one_path,
    ),
    "tanks": _tanks_part,
}


def main(options: Sequence[str] = ()) -> None:
    """Measure all parts or some, and write `benchmarks/results/attribution.md`."""
    text = f"{MOTORS} motors a cell; 0 of {MOTORS} bounds a share by {300 / MOTORS:.1f} % (95 %)."
    write_stored("attribution", "Common factor or paths, and duty", text, PARTS, options)
