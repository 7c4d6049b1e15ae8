"""The six motors of the demo, the truth of each night, and what their loggers make of it.

Of a night its operation is simulated, what the sensors say, and the faults of the log.
"""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from leakage import AnnularGap, Motor, OperatingConditions, leakage_l_per_min
from pipeline.config import Channel, MotorSpec
from pipeline.config.channels import ChannelName

GAP_SCATTER: Final = 0.002  # from night to night, recorded in the truth; 0.6 % in K
FLUSHING_SCATTER: Final = 0.005
LAST_NIGHT_OF_GROWTH: Final = 75
FIRST_SEED: Final = dt.date(2026, 1, 2)
RING, PISTON, SLEEVE = "piston_ring", "balance_piston", "balance_sleeve"


@dataclass(frozen=True, slots=True)
class Wear:
    """Gap heights that grow."""

    words: str  # what happens, for people
    paths: tuple[str, ...]  # leakage paths whose gaps grow
    first_night: int  # number of the first night with wear, counted from 1
    gap_growth: float  # relative growth of the gap height when the wear is complete, [-]
    # Growth goes with that power of time up to night 75; 0: complete from its first night on.
    power: int = 1

    def growth(self, path: str, number: int) -> float:
        """Return relative growth of a path's gap height by a night, counted from 1, [-]."""
        if path not in self.paths or number < self.first_night:
            return 0.0
        nights = LAST_NIGHT_OF_GROWTH - self.first_night + 1
        share = min((number - self.first_night + 1) / nights, 1.0)
        return float(self.gap_growth * share**self.power)


NO_WEAR: Final = Wear("none", (), 1, 0.0)


@dataclass(frozen=True, slots=True)
class DemoMotor:
    """A motor of the demo; its type, oil and log dialect stand in its config file."""

    motor_id: str  # as in the config
    # Gap heights of this motor as built, relative to those of its type's config, by path, [-].
    gap_factors: Mapping[str, float]
    wear: Wear = NO_WEAR
    # Lowest and highest level of the pressure difference, [bar]; the same twice: constant.
    pressure_bar: tuple[float, float] = (15.0, 300.0)
    # pressure_drift_bar, pressure_ripple_bar: standard deviation of the slow and of the fast
    # variation around a level, [bar].
    pressure_drift_bar: float = 3.0
    pressure_ripple_bar: float = 0.4
    # Lowest and highest level of the speed, [rpm]; levels are even in the logarithm.
    speed_rpm: tuple[float, float] = (3.0, 110.0)
    # Middle of a night's oil temperature and its swing to either side, [°C].
    temperature_c: tuple[float, float] = (49.0, 8.5)
    reverses: bool = False  # it runs backward after every other halt
    flushing_l_per_min: float = 0.0  # flow that flushes its case, [l/min]
    # Number of a night in which a sensor freezes, and its channel.
    frozen: tuple[int, str] | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """Extent of the simulation."""

    nights: int
    minutes: float  # length of a night's log, [min]
    rate_hz: float  # rate of all channels that are not logged every second, [Hz]
    seed: int  # seed of the whole fleet
    first_night: dt.date  # label of night 1: the date on which it ends


@dataclass(frozen=True, slots=True)
class DemoNight:
    """A night of a motor, counted from 1: the unit in which the demo is made."""

    demo: DemoMotor
    spec: MotorSpec
    plan: Plan
    number: int

    @property
    def label(self) -> dt.date:
        """The date on which the night ends."""
        return self.plan.first_night + dt.timedelta(days=self.number - 1)

    @property
    def motor(self) -> Motor:
        """The motor's paths and oil, its flushing among the paths."""
        return self.spec.motor(self.label, "estimated")

    def generator(self, purpose: str) -> np.random.Generator:
        """Return source of randomness of this motor, night and purpose alone, whoever makes it."""
        # By its number, as a date: the same samples whenever the demo is made.
        date = FIRST_SEED + dt.timedelta(days=self.number - 1)
        key = f"{self.plan.seed}/{self.demo.motor_id}/{date}/{purpose}"
        digest = hashlib.sha256(key.encode()).digest()
        return np.random.default_rng([int(word) for word in np.frombuffer(digest, dtype="<u4")])


def coefficients_of(night: DemoNight) -> dict[str, float]:
    """Return K of the gaps [m³], scale of the rollers, flushing [l/min] of a night, by path."""
    rng, motor = night.generator("truth"), night.motor
    coefficients = {path.name: path.configured_coefficient for path in motor.paths}
    for path in motor.paths:
        if isinstance(path, AnnularGap):
            grown = 1.0 + night.demo.wear.growth(path.name, night.number)
            scatter = float(np.exp(GAP_SCATTER * rng.standard_normal()))
            factor = night.demo.gap_factors.get(path.name, 1.0) * grown * scatter
            others = [parameter.value for parameter in path.parameters[1:]]
            coefficients[path.name] = float(path.coefficient([path.gap.value * factor, *others]))
    if motor.constant is not None:
        scatter = 1.0 + FLUSHING_SCATTER * rng.standard_normal()
        coefficients[motor.constant.name] = night.demo.flushing_l_per_min * scatter
    return coefficients


def reference_leakage(night: DemoNight, coefficients: Mapping[str, float]) -> float:
    """Return leakage without flushing at the reference conditions, [l/min]."""
    conditions = night.spec.settings.reference.conditions().operating
    return float(leakage_l_per_min(night.motor, conditions, coefficients)[0])


def truth_document(plan: Plan, nights: Iterable[DemoNight]) -> dict[str, Any]:
    """Return content of ``truth.json``: for people and tests, never read by the pipeline."""
    motors: dict[str, dict[str, Any]] = {}
    for night in nights:
        coefficients, motor, wear = coefficients_of(night), night.motor, night.demo.wear
        began = plan.first_night + dt.timedelta(days=wear.first_night - 1)
        about: dict[str, Any] = {
            "wear": wear.words,
            "worn_paths": list(wear.paths),
            "first_night_of_wear": str(began) if wear.paths else None,
            "nights": {},
        }
        gaps = [path.name for path in motor.paths if isinstance(path, AnnularGap)]
        motors.setdefault(night.demo.motor_id, about)["nights"][str(night.label)] = {
            "K_m3": {name: coefficients[name] for name in gaps},
            "C_f_l_per_min": coefficients[motor.constant.name] if motor.constant else 0.0,
            "reference_leakage_l_per_min": reference_leakage(night, coefficients),
        }
    return {**asdict(plan), "first_night": str(plan.first_night), "motors": motors}


DEMO_FLEET: Final = (
    DemoMotor("CB400-01", {RING: 1.02, PISTON: 0.98, SLEEVE: 1.01}, frozen=(12, "leakage_flow")),
    DemoMotor(
        "CB400-02",
        {RING: 0.99, PISTON: 1.03, SLEEVE: 0.98},
        Wear("the piston rings wear steadily", (RING,), 31, 0.30),
        pressure_bar=(15.0, 280.0),
    ),
    DemoMotor(
        "CB560-01",
        {RING: 1.00, PISTON: 1.01, SLEEVE: 1.02},
        Wear("the balance sleeves are damaged within a day", (SLEEVE,), 45, 0.15, power=0),
        reverses=True,
    ),
    DemoMotor(
        "CB560-02",
        {RING: 1.03, PISTON: 0.99, SLEEVE: 0.99},
        Wear("the balance pistons wear slowly", (PISTON,), 31, 0.30),
        temperature_c=(50.0, 8.0),
        frozen=(20, "high_port_pressure"),
    ),
    DemoMotor(
        "CB1120-01",
        {RING: 0.98, PISTON: 1.00, SLEEVE: 1.00},
        Wear("dirty oil wears the balance pistons and sleeves", (PISTON, SLEEVE), 31, 0.20),
        temperature_c=(48.0, 8.5),
        flushing_l_per_min=4.0,
    ),
    DemoMotor(
        "CB1120-02",
        {RING: 1.01, PISTON: 0.99, SLEEVE: 1.00},
        Wear("the balance sleeves wear ever faster", (SLEEVE,), 31, 0.40, power=2),
        pressure_bar=(180.0, 180.0),
        pressure_drift_bar=0.06,
        pressure_ripple_bar=0.04,
        speed_rpm=(25.0, 60.0),
        temperature_c=(49.0, 3.0),
    ),
)

FloatArray = NDArray[np.float64]


def phi_of(step_s: float, time_constant_s: float) -> float:
    """Return coefficient of a first-order autoregression: φ = exp(−Δt/τ), both times in [s]."""
    return float(np.exp(-step_s / time_constant_s))


def autoregression(white: FloatArray, phi: float) -> FloatArray:
    r"""Return first-order autoregression of independent values, (n, ...), in its stationary state.

    .. math:: x_0 = w_0, \quad x_k = \varphi x_{k-1} + \sqrt{1 - \varphi^2}\,w_k
    """
    driven = white * np.sqrt(1.0 - phi**2)
    driven[:1] = white[:1]
    return np.asarray(lfilter([1.0], [1.0, -phi], driven, axis=0), dtype=np.float64)


def correlated_noise(
    generator: np.random.Generator, samples: int, step_s: float, time_constant_s: float
) -> FloatArray:
    """Return autoregression of unit variance, (samples,), by its step and time constant [s]."""
    return autoregression(generator.standard_normal(samples), phi_of(step_s, time_constant_s))


START_HOUR, END_HOUR = -2.5, 6.0  # UTC, of the date that labels the night
CHARGE_PRESSURE_BAR: Final = 15.0
LOW_PRESSURE_BAR: Final = 100.0  # below it the piston rings leak enough to be seen
LOW_PRESSURE_SHARE: Final = 0.45  # of the levels, where the pressures reach that low
HOLD_S, RAMP_S, HALT_S = (20.0, 110.0), (8.0, 20.0), (120.0, 240.0)
RUN_DOWN_S: Final = 6.0  # shorter than the guard time before a standstill, so none of it is kept
RUN_UP_S: Final = 8.0
BACK_FLOW_S: Final = (3.0, 8.0)
TEMPERATURE_PERIODS_S: Final = (1500.0, 3000.0)
NOISE_TIME_CONSTANT_S: Final = 3.9  # φ = 0.95 at 5 samples a second
FROZEN_SHARE: Final = (0.40, 0.52)  # of the night
# Faults an hour: single samples and some seconds without a value, of each channel; up to three
# minutes without anything; stamps that repeat the stamp before, and as many that lie before it.
SPIKES, OUT_OF_RANGE, BLANKS, MISSING, DISORDERED = 4.0, 1.0, 0.7, 0.7, 0.5
SET_BACK_US: Final = 1_500_000
OWN_DELAY_US, OWN_JITTER_US = 4_000, 2_000  # of a channel's stamps behind another's
# White noise, usual spike, and what a broken sensor says, in the units of the tables.
SENSORS: Final[Mapping[ChannelName, tuple[float, float, float]]] = {
    "pressure_difference": (0.05, 60.0, 999.9),
    "high_port_pressure": (0.05, 60.0, 999.9),
    "low_port_pressure": (0.05, 8.0, 999.9),
    "oil_temperature": (0.03, 12.0, 850.0),
    "speed": (0.05, 40.0, 9999.0),
    "leakage_flow": (0.0, 3.0, -1.0),
}

Rng = np.random.Generator


@dataclass(frozen=True, slots=True)
class Operation:
    """True conditions in a motor, sample by sample, shape (n,) each."""

    # pressure_difference_bar, speed_rpm: negative where it runs backward, 0 where it stands.
    pressure_difference_bar: FloatArray
    oil_temperature_c: FloatArray
    speed_rpm: FloatArray
    # The drain line empties backward through its sensor, right after a halt.
    back_flow: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Recording:
    """A night's log before it takes a format."""

    time_us: NDArray[np.int64]  # UTC stamp of each row in the file's order, shape (n,), [µs]
    # Each channel in its canonical unit, shape (n,); NaN: no value there.
    values: Mapping[ChannelName, FloatArray]
    # Where the channels have stamps of their own: their delay behind `time_us`, shape (n,), [µs].
    own_delay_us: Mapping[ChannelName, NDArray[np.int64]]


def record_night(night: DemoNight) -> Recording:
    """Simulate a night and log it, faults included."""
    plan, file, rng = night.plan, night.spec.file, night.generator("log")
    time_s = np.arange(round(plan.minutes * 60.0 * plan.rate_hz)) / plan.rate_hz
    signals = _signals(night, time_s, simulate_operation(night.demo, time_s, rng), rng)
    delays: dict[ChannelName, NDArray[np.int64]] = {}
    if file.logs.format == "mcap":  # each message has its own stamp
        for place, name in enumerate(sorted(file.channels)):
            delays[name] = OWN_DELAY_US * place + rng.integers(0, OWN_JITTER_US, time_s.size)
            signals[name] = np.interp(time_s + 1e-6 * delays[name], time_s, signals[name])
    values = {name: _log_channel(night, name, signal, rng) for name, signal in signals.items()}
    # The temperature is logged every second, and so is all that has a message of its own.
    is_first = np.diff(np.floor(time_s + 1e-6), prepend=-1.0) > 0.0
    for name in values:
        if delays or name == "oil_temperature":
            values[name] = np.where(is_first, values[name], np.nan)
    return _with_log_faults(night, Recording(_stamps_us(night, time_s), values, delays), rng)


def simulate_operation(demo: DemoMotor, time_s: FloatArray, rng: Rng) -> Operation:
    """Return random load cycles of a night at evenly spaced times since its start, (n,), [s]."""
    # A halt a slot of 45 minutes, shorter in short logs.
    count = max(1, round(float(time_s[-1]) / 2700.0))
    slot = float(time_s[-1]) / count
    lengths = np.minimum(rng.uniform(*HALT_S, count), 0.08 * slot)
    begins = slot * (np.arange(count) + rng.uniform(0.1, 0.75, count))
    ends = begins + lengths
    knots = np.column_stack([begins - RUN_DOWN_S, begins, ends, ends + RUN_UP_S]).ravel()
    motion = np.interp(time_s, knots, np.tile([1.0, 0.0, 0.0, 1.0], count))
    if demo.reverses:
        turns = np.searchsorted((begins + ends) / 2.0, time_s)
        motion = np.where(turns % 2 == 0, 1.0, -1.0) * motion
    pressure_bar = motion * _pressure_bar(demo, time_s, rng)
    temperature_c = _temperature_c(demo, time_s, rng)
    speed_rpm = motion * _speed_rpm(demo, time_s, rng)
    back_flow_ends = begins + rng.uniform(*BACK_FLOW_S, count)
    latest = np.searchsorted(begins, time_s, side="right") - 1
    back_flow = np.logical_and(latest >= 0, time_s < back_flow_ends[latest])
    return Operation(pressure_bar, temperature_c, speed_rpm, back_flow)


def _pressure_bar(demo: DemoMotor, time_s: FloatArray, rng: Rng) -> FloatArray:
    low, high = demo.pressure_bar
    border = max(low, min(LOW_PRESSURE_BAR, high))

    def levels(count: int) -> FloatArray:
        is_low = rng.random(count) < LOW_PRESSURE_SHARE
        return np.where(is_low, rng.uniform(low, border, count), rng.uniform(border, high, count))

    step_s = float(time_s[1] - time_s[0])
    level = _load_cycle(time_s, rng, levels)
    drift = demo.pressure_drift_bar * correlated_noise(rng, time_s.size, step_s, 60.0)
    ripple = demo.pressure_ripple_bar * correlated_noise(rng, time_s.size, step_s, 0.5)
    room = 3.0 * (demo.pressure_drift_bar + demo.pressure_ripple_bar)
    return np.clip(level + drift + ripple, max(0.8 * low, low - room), high + room)


def _speed_rpm(demo: DemoMotor, time_s: FloatArray, rng: Rng) -> FloatArray:
    low, high = np.log(demo.speed_rpm)
    level = np.exp(_load_cycle(time_s, rng, lambda count: rng.uniform(low, high, count)))
    ripple = 0.3 * correlated_noise(rng, time_s.size, float(time_s[1] - time_s[0]), 2.0)
    return np.maximum(level + ripple, 0.8 * demo.speed_rpm[0])


def _temperature_c(demo: DemoMotor, time_s: FloatArray, rng: Rng) -> FloatArray:
    """Return three slow waves, scaled so that every night sees the whole swing."""
    middle, swing = demo.temperature_c
    periods = rng.uniform(*TEMPERATURE_PERIODS_S, 3)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    waves = np.sin(2.0 * np.pi * time_s[:, None] / periods + phases).sum(axis=1)
    shape = 2.0 * (waves - waves.min()) / np.ptp(waves) - 1.0
    return np.asarray(middle + rng.uniform(-1.0, 1.0) + swing * shape, dtype=np.float64)


def _load_cycle(time_s: FloatArray, rng: Rng, levels: Callable[[int], FloatArray]) -> FloatArray:
    """Return random levels, each held for a while, with straight ramps between them."""
    count = int(time_s[-1] / (HOLD_S[0] + RAMP_S[0])) + 2
    ramps, holds = rng.uniform(*RAMP_S, count), rng.uniform(*HOLD_S, count)
    ends = np.cumsum(ramps + holds)
    knots = np.column_stack([ends - holds, ends]).ravel()
    return np.interp(time_s, knots, np.repeat(levels(count), 2))


def _signals(
    night: DemoNight, time_s: FloatArray, operation: Operation, rng: Rng
) -> dict[ChannelName, FloatArray]:
    """Return True signal at each sensor, by channel."""
    step_s, pressure_bar = 1.0 / night.plan.rate_hz, operation.pressure_difference_bar
    pressures: dict[ChannelName, FloatArray] = {"pressure_difference": pressure_bar}
    if "pressure_difference" not in night.spec.file.channels:
        low = CHARGE_PRESSURE_BAR + 0.4 * correlated_noise(rng, time_s.size, step_s, 30.0)
        pressures = {"high_port_pressure": low + pressure_bar, "low_port_pressure": low}
    motor, coefficients = night.motor, coefficients_of(night)
    conditions = OperatingConditions.from_bar(
        pressure_bar, operation.oil_temperature_c, operation.speed_rpm
    )
    leakage = leakage_l_per_min(motor, conditions, coefficients)
    # Correlated over some seconds, with white noise on top.
    correlated = correlated_noise(rng, leakage.size, step_s, NOISE_TIME_CONSTANT_S)
    noise = (0.013 * correlated + 0.005 * rng.standard_normal(leakage.size)) * leakage
    noise = noise + 0.003 * leakage.mean() * correlated
    flushing = coefficients[motor.constant.name] if motor.constant else 0.0
    flow = np.maximum(leakage + noise, 0.0) + flushing
    maximum = night.spec.file.channels["leakage_flow"].sensor_maximum
    return pressures | {
        "oil_temperature": operation.oil_temperature_c,
        "speed": operation.speed_rpm,
        "leakage_flow": flow if maximum is None else np.where(operation.back_flow, maximum, flow),
    }


def _log_channel(night: DemoNight, name: ChannelName, signal: FloatArray, rng: Rng) -> FloatArray:
    """Return a channel as its sensor and the logger make it: noise, coarse steps, single faults."""
    channel, hours, size = night.spec.file.channels[name], night.plan.minutes / 60.0, signal.size
    noise, spike, error_value = SENSORS[name]
    noisy = signal + noise * rng.standard_normal(size)
    if channel.sensor_maximum is not None:
        noisy = np.minimum(noisy, channel.sensor_maximum)
    logged = _in_steps(noisy, channel)
    if night.demo.frozen == (night.number, name):
        first, last = (int(share * size) for share in FROZEN_SHARE)
        logged[first:last] = logged[first]
    spikes = _some(size, SPIKES * hours, rng)
    signs = rng.choice([-1.0, 1.0], spikes.size)
    heights = spike * rng.uniform(0.6, 1.6, spikes.size) * signs
    logged[spikes] = _in_steps(logged[spikes] + heights, channel)
    logged[_some(size, OUT_OF_RANGE * hours, rng)] = error_value
    # CSV and JSON have no agreed way to write a value that is not finite; Parquet has.
    not_finite = 1.0 if night.spec.file.logs.format == "parquet" else 0.0
    logged[_some(size, not_finite * hours, rng)] = np.inf
    logged[_stretches(size, hours, BLANKS, (3.0, 20.0), rng)] = np.nan
    return logged


def _in_steps(values: FloatArray, channel: Channel) -> FloatArray:
    """Return whole steps of the resolution, as the shortest decimal numbers."""
    return np.round(np.rint(values / channel.resolution) * channel.resolution, 6) + 0.0  # no -0.0


def _with_log_faults(night: DemoNight, recording: Recording, rng: Rng) -> Recording:
    """Return a recording without its missing periods, and with some stamps repeated or set back."""
    hours, rows = night.plan.minutes / 60.0, recording.time_us.size
    absent = _stretches(rows, hours, MISSING, (20.0, 180.0), rng)
    absent[[0, -1]] = False
    logged = np.flatnonzero(~absent)
    time_us = recording.time_us[logged]
    delays = {name: delay[logged] for name, delay in recording.own_delay_us.items()}
    repeated = 1 + _some(logged.size - 2, DISORDERED * hours, rng)
    for stamps in (time_us, *delays.values()):
        stamps[repeated] = stamps[repeated - 1]
    set_back = 1 + _some(logged.size - 2, DISORDERED * hours, rng)
    time_us[set_back] = np.maximum(time_us[set_back] - SET_BACK_US, time_us[0])
    values = {name: values[logged] for name, values in recording.values.items()}
    return Recording(time_us, values, delays)


def _some(size: int, expected: float, rng: Rng) -> NDArray[np.intp]:
    """Return a random number of random samples."""
    return np.asarray(rng.integers(0, size, rng.poisson(expected)), dtype=np.intp)


def _stretches(
    size: int, hours: float, per_hour: float, seconds: tuple[float, float], rng: Rng
) -> NDArray[np.bool_]:
    """Return mask of random stretches of time; none is longer than a twentieth of the log."""
    inside = np.zeros(size, dtype=np.bool_)
    samples_per_s = size / (3600.0 * hours)
    for first in _some(size, per_hour * hours, rng):
        length = min(int(rng.uniform(*seconds) * samples_per_s), size // 20)
        inside[first : first + length] = True
    return inside


def _stamps_us(night: DemoNight, time_s: FloatArray) -> NDArray[np.int64]:
    """Return UTC stamps in whole milliseconds; too long a log ends with the night."""
    midnight = dt.datetime.combine(night.label, dt.time(), dt.UTC)
    start_h = min(START_HOUR, END_HOUR - night.plan.minutes / 60.0)
    start_ms = round(midnight.timestamp() * 1e3 + start_h * 3.6e6)
    return (start_ms + np.rint(time_s * 1e3).astype(np.int64)) * 1000
