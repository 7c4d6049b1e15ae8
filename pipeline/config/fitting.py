"""Settings of the fit: the model, its estimation, the conditions at which it is evaluated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from pipeline.config.section import NonNegative, Positive, Section, Stage

if TYPE_CHECKING:
    from leakage import OperatingConditions


class Model(Section):
    """Choices of the physics that are not a property of the motor."""

    shapes = Stage.BLOCKS

    film_pressure: Literal["thesis", "slot"] = "thesis"
    """`thesis`: Barus viscosity at the pressure difference times the share; `slot`: exact laminar
    flow through a slot with Barus viscosity."""
    film_pressure_share: NonNegative = Field(1.0, le=1)
    """Share of the pressure difference in the film; `thesis` only."""
    film_pressure_share_tolerance: Annotated[NonNegative, Stage.FIGURES] = Field(0.0, le=1)
    """Stated tolerance of that share; 0: none stated."""
    two_sided: bool | None = None
    """Every path leaks to the case from both sides: the high one at pressure difference + charge −
    case pressure, the low one at charge − case pressure; by default where the charge or low-port
    pressure is logged, or `charge_pressure_bar` is stated."""
    charge_pressure_bar: NonNegative = 0.0
    """Pressure of the low port, without a channel of it; 0: none stated."""
    case_pressure_bar: NonNegative = 0.0
    """Pressure of the case; `two_sided` without a channel of it."""
    charge_pressure_tolerance_bar: Annotated[NonNegative, Stage.FIGURES] = 0.0
    """Stated tolerance of charge − case pressure; 0: none stated."""

    roller_scale: Annotated[Literal["by_information", "fixed"], Stage.FIGURES] = "by_information"
    """Scale of a motor's one known curve, that of the cam rollers: estimated where most of the
    first nights of a baseline tell it, since speed varies; `fixed`: as the motor type says, the
    thesis."""

    def is_two_sided(self, *, is_logged: bool = False) -> bool:
        """Two-sided as stated, else where the low side's pressure is stated or logged."""
        is_known = is_logged or self.charge_pressure_bar > 0.0
        return is_known if self.two_sided is None else self.two_sided


class Estimation(Section):
    """Bounded least squares; the search of the thesis, by `fit` alone, names as in MATLAB's
    lsqnonlin."""

    shapes = Stage.NOTHING

    starting_points: int = Field(10, ge=0, le=1000)
    """Starting points of the audit that `fit` makes, the configured one first; 0: none. No figure
    depends on it or on the three settings after it."""
    step_tolerance: Positive = 1e-10
    """A start stops at a relative step below this."""
    function_tolerance: Positive = 1e-10
    """A start stops at a relative change of the criterion below this."""
    maximum_iterations: int = Field(200, ge=1)
    """Iterations a start may take."""
    loss: Annotated[Literal["squared", "huber"], Stage.BLOCKS] = "squared"
    """`huber`: training samples with large errors count less, by weights found before their
    statistics are made."""
    sensitivity_samples: Annotated[int, Stage.FIGURES] = Field(1500, ge=100)
    """Training samples that carry the stated tolerances; thinned."""
    seed: int = Field(1, ge=0)
    """Seed of the starts; a night's seed is derived from it."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions at which a leakage is told."""

    pressure_bar: float
    temperature_c: float
    speed_rpm: float
    # Charge above case pressure of a two-sided motor.
    charge_over_case_bar: float | None = None

    @property
    def operating(self) -> OperatingConditions:
        """The same as the model takes them."""
        from leakage.physics.conditions import OperatingConditions

        return OperatingConditions.from_bar(
            self.pressure_bar, self.temperature_c, self.speed_rpm, self.charge_over_case_bar
        )


class ReferenceConditions(Section):
    """Conditions at which the reference leakage is evaluated."""

    shapes = Stage.FIGURES

    pressure_bar: Positive = 200.0
    """Pressure difference."""
    temperature_c: float = Field(50.0, gt=-60, lt=150)
    """Oil temperature."""
    speed_rpm: NonNegative = 30.0
    """Motor speed."""

    def conditions(self, charge_over_case_bar: float | None = None) -> Conditions:
        """These conditions; of a two-sided motor with a charge above case pressure, else None.

        A night by itself takes its own mean charge, a watch that of its baseline: where the charge
        is stated and not logged, they are the same.
        """
        return Conditions(
            self.pressure_bar, self.temperature_c, self.speed_rpm, charge_over_case_bar
        )
