"""The six motors of the demo, what is simulated of them, and the truth of each night."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from leakage import AnnularGap, Motor, leakage_l_per_min
from pipeline.config import MotorSpec
from pipeline.demo.operation import Duty

GAP_SCATTER: Final = 0.002  # from night to night, recorded in the truth; 0.6 % in K
FLUSHING_SCATTER: Final = 0.005

LAST_NIGHT_OF_GROWTH: Final = 75

RING: Final = "piston_ring"
PISTON: Final = "balance_piston"
SLEEVE: Final = "balance_sleeve"


@dataclass(frozen=True, slots=True)
class Wear:
    """Gap heights that grow."""

    words: str  # what happens, for people
    paths: tuple[str, ...]  # leakage paths whose gaps grow
    first_night: int  # number of the first night with wear, counted from 1
    gap_growth: float  # relative growth of the gap height when the wear is complete, [-]
    # ``step``: complete from its first night on; ``linear`` and ``accelerating`` (with the square
    # of time): complete from night 75 on.
    course: Literal["step", "linear", "accelerating"]

    def growth(self, path: str, number: int) -> float:
        """Relative growth of a path's gap height by a night, counted from 1, [-]."""
        if path not in self.paths or number < self.first_night:
            return 0.0
        if self.course == "step":
            return self.gap_growth
        nights = LAST_NIGHT_OF_GROWTH - self.first_night + 1
        share = min((number - self.first_night + 1) / nights, 1.0)
        return self.gap_growth * (share if self.course == "linear" else share**2)


@dataclass(frozen=True, slots=True)
class DemoMotor:
    """A motor of the demo; its type, oil and log dialect stand in its config file."""

    motor_id: str  # as in the config
    duty: Duty  # what it is asked to do
    wear: Wear | None  # how it wears; None: it does not
    # Gap heights of this motor as built, relative to those of its type's config, by path, [-].
    gap_factors: Mapping[str, float]
    flushing_l_per_min: float = 0.0  # flow that flushes its case, [l/min]
    # Number of a night in which a sensor freezes, and its channel.
    frozen: tuple[int, str] | None = None

    @property
    def is_excited(self) -> bool:
        """Its pressures vary enough to tell its paths apart."""
        lowest, highest = self.duty.pressure_bar
        return highest > lowest


@dataclass(frozen=True, slots=True)
class Plan:
    """Extent of the simulation."""

    nights: int
    minutes: float  # length of a night's log, [min]
    rate_hz: float  # rate of all channels but the temperature, which is logged every second, [Hz]
    seed: int  # seed of the whole fleet
    first_night: dt.date  # label of night 1: the date on which it ends
    slow_errors_min: float = 0.0  # time constant of slow errors of the drain flow, [min]; 0: none


@dataclass(frozen=True, slots=True)
class DemoNight:
    """One night of one motor, counted from 1: the unit in which the demo is made."""

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
        """A source of randomness of this motor, night and purpose alone, whoever makes it."""
        key = f"{self.plan.seed}/{self.demo.motor_id}/{self.label}/{purpose}"
        digest = hashlib.sha256(key.encode()).digest()
        return np.random.default_rng([int(word) for word in np.frombuffer(digest, dtype="<u4")])


@dataclass(frozen=True, slots=True)
class Truth:
    """State of a motor in a night that no log shows."""

    gaps_um: Mapping[str, float]  # gap height of each annular gap, [µm]
    # Coefficient of every path by name: K of the gaps, [m³]; scale of the rollers' curve, [-];
    # flushing, [l/min].
    coefficients: Mapping[str, float]
    # Leakage without flushing at the reference conditions, [l/min].
    reference_leakage_l_per_min: float


def truth_of(night: DemoNight) -> Truth:
    """State of a motor in a night: as built, with its wear and a small scatter between nights."""
    rng, motor = night.generator("truth"), night.motor
    gaps: dict[str, float] = {}
    coefficients = {path.name: path.configured_coefficient for path in motor.paths}
    for path in motor.paths:
        if isinstance(path, AnnularGap):
            gaps[path.name] = path.gap.value * _gap_factor(night, path.name, rng)
            others = [parameter.value for parameter in path.parameters[1:]]
            coefficients[path.name] = float(path.coefficient([gaps[path.name], *others]))
    if motor.constant is not None:
        scatter = 1.0 + FLUSHING_SCATTER * rng.standard_normal()
        coefficients[motor.constant.name] = night.demo.flushing_l_per_min * scatter
    conditions = night.spec.settings.reference.conditions().operating
    at_reference = leakage_l_per_min(motor, conditions, coefficients)
    return Truth(gaps, coefficients, float(at_reference[0]))


def truth_document(plan: Plan, nights: Iterable[DemoNight]) -> dict[str, Any]:
    """Content of ``truth.json``: for people and tests, never read by the pipeline."""
    motors: dict[str, dict[str, Any]] = {}
    for night in nights:
        motor_id = night.demo.motor_id
        document = motors.setdefault(motor_id, _motor_document(night))
        document["nights"][night.label.isoformat()] = _night_document(night)
    return {
        "nights": plan.nights,
        "minutes": plan.minutes,
        "rate_hz": plan.rate_hz,
        "seed": plan.seed,
        "first_night": plan.first_night.isoformat(),
        "motors": motors,
    }


def _gap_factor(night: DemoNight, path: str, rng: np.random.Generator) -> float:
    wear = night.demo.wear
    grown = 1.0 + (wear.growth(path, night.number) if wear else 0.0)
    scatter = float(np.exp(GAP_SCATTER * rng.standard_normal()))
    return night.demo.gap_factors.get(path, 1.0) * grown * scatter


def _motor_document(night: DemoNight) -> dict[str, Any]:
    demo, wear = night.demo, night.demo.wear
    first = night.plan.first_night
    return {
        "motor_type": night.spec.file.motor_type,
        "excited": demo.is_excited,
        "wear": wear.words if wear else "none",
        "worn_paths": list(wear.paths) if wear else [],
        "first_night_of_wear": (
            (first + dt.timedelta(days=wear.first_night - 1)).isoformat() if wear else None
        ),
        "reference_conditions": night.spec.settings.reference.model_dump(),
        "nights": {},
    }


def _night_document(night: DemoNight) -> dict[str, Any]:
    truth, constant = truth_of(night), night.motor.constant
    return {
        "K_m3": {name: truth.coefficients[name] for name in truth.gaps_um},
        "gap_um": dict(truth.gaps_um),
        "C_f_l_per_min": truth.coefficients[constant.name] if constant else 0.0,
        "reference_leakage_l_per_min": truth.reference_leakage_l_per_min,
    }


DEMO_FLEET: Final = (
    DemoMotor(
        "CB400-01",
        Duty(),
        wear=None,
        gap_factors={RING: 1.02, PISTON: 0.98, SLEEVE: 1.01},
        frozen=(12, "leakage_flow"),
    ),
    DemoMotor(
        "CB400-02",
        Duty(pressure_bar=(15.0, 280.0)),
        wear=Wear("the piston rings wear steadily", (RING,), 31, 0.30, "linear"),
        gap_factors={RING: 0.99, PISTON: 1.03, SLEEVE: 0.98},
    ),
    DemoMotor(
        "CB560-01",
        Duty(reverses=True),
        wear=Wear("the balance sleeves are damaged within a day", (SLEEVE,), 45, 0.15, "step"),
        gap_factors={RING: 1.00, PISTON: 1.01, SLEEVE: 1.02},
    ),
    DemoMotor(
        "CB560-02",
        Duty(temperature_c=(50.0, 8.0)),
        wear=Wear("the balance pistons wear slowly", (PISTON,), 31, 0.30, "linear"),
        gap_factors={RING: 1.03, PISTON: 0.99, SLEEVE: 0.99},
        frozen=(20, "high_port_pressure"),
    ),
    DemoMotor(
        "CB1120-01",
        Duty(temperature_c=(48.0, 8.5)),
        wear=Wear(
            "dirty oil wears the balance pistons and sleeves", (PISTON, SLEEVE), 31, 0.20, "linear"
        ),
        gap_factors={RING: 0.98, PISTON: 1.00, SLEEVE: 1.00},
        flushing_l_per_min=4.0,
    ),
    DemoMotor(
        "CB1120-02",
        Duty(
            pressure_bar=(180.0, 180.0),
            pressure_drift_bar=0.06,
            pressure_ripple_bar=0.04,
            speed_rpm=(25.0, 60.0),
            temperature_c=(49.0, 3.0),
        ),
        wear=Wear("the balance sleeves wear ever faster", (SLEEVE,), 31, 0.40, "accelerating"),
        gap_factors={RING: 1.01, PISTON: 0.99, SLEEVE: 1.00},
    ),
)
