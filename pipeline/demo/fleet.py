"""The six motors of the demo, what is simulated of them, and the truth of each night."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from leakage import AnnularGap, Motor, leakage_l_per_min
from pipeline.config import MotorSpec

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
        """A source of randomness of this motor, night and purpose alone, whoever makes it."""
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
