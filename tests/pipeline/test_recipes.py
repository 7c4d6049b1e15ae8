"""The recipes of CONTRIBUTING: a law and two cleaning rules of this module, and their nights.

Only what the recipes name is added: for the law its class and its config model, for a rule its
function and its words.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import Field

from leakage.physics.paths import (
    CoefficientUnit,
    DerivedFigure,
    Law,
    Parameter,
    PathTolerance,
    Side,
    Values,
)
from pipeline.config import Cleaning, MotorSpec
from pipeline.config.hashes import model_hash
from pipeline.config.motor_types import (
    BAR,
    AnnularGapPath,
    LaminarPath,
    MotorTypeFile,
    PathSection,
    SpeedCurvePath,
    Unknown,
)
from pipeline.config.section import Stage
from pipeline.night.cleaning import CHANNEL_RULES, Course
from pipeline.night.fit_night import fit_night
from pipeline.night.rows import Rows
from pipeline.night.time_base import JOINT_RULES, Together
from pipeline.report.explain import refusal
from pipeline.schema import QUALITY_REASONS, Reason
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, night_of, operate, raw

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Orifice(Law):
    """Turbulent flow through a bore: Q = s Q₀ √(|ΔP|/ΔP₀)."""

    coefficient_unit: ClassVar[CoefficientUnit] = "1"

    name: str
    flow_l_per_min: float
    reference_pressure_pa: float
    diameter_um: float
    scale: Parameter
    flow_tolerance: float

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (self.scale,)

    @property
    def coefficient_name(self) -> str:
        return self.scale.name

    def coefficient(self, values: Values) -> Array:
        return np.asarray(values, dtype=np.float64)[..., 0]

    def regressor(self, side: Side) -> Array:
        share = np.abs(side.pressure_difference_pa) / self.reference_pressure_pa
        return self.flow_l_per_min * np.sqrt(share)

    def tolerances(self) -> tuple[PathTolerance, ...]:
        more = replace(self, flow_l_per_min=self.flow_l_per_min * (1 + self.flow_tolerance))
        return (PathTolerance("flow", self.flow_tolerance, more),)

    def derived_figures(
        self,
        coefficient: float,
        limits: tuple[float, float] | None,  # noqa: ARG002
        roughness_m: tuple[float, float],  # noqa: ARG002
    ) -> tuple[DerivedFigure, ...]:
        diameter = self.diameter_um * coefficient**0.5
        return (DerivedFigure(f"d_{self.name}", "um", diameter, diameter),)


class OrificePath(PathSection):
    """`orifice`: turbulent flow through a bore."""

    law: Literal["orifice"]
    flow_l_per_min: float
    diameter_um: Annotated[float, Stage.SCALE]
    scale: Annotated[Unknown, Stage.SCALE]
    flow_tolerance_percent: Annotated[float, Stage.FIGURES] = 0.0

    def path(self) -> Orifice:
        scale = self.scale.parameter(f"scale_{self.name}", "1")
        tolerance = self.flow_tolerance_percent / 100
        return Orifice(
            self.name, self.flow_l_per_min, 200 * BAR, self.diameter_um, scale, tolerance
        )


DECLARED = AnnularGapPath | SpeedCurvePath | LaminarPath | OrificePath


class WithOrifice(MotorTypeFile):
    """The entry of the law among those that a `[[path]]` can name."""

    path: tuple[Annotated[DECLARED, Field(discriminator="law")], ...]


LAMINAR: dict[str, Any] = {
    "name": "distributor", "law": "laminar", "source": "test", "count": 1,
    "coefficient_m3": {"value": 2e-14, "minimum": 0.0, "maximum": 1e-12},
}  # fmt: skip
ORIFICE: dict[str, Any] = {
    "name": "bore", "law": "orifice", "source": "test", "count": 1, "flow_l_per_min": 1.0,
    "diameter_um": 400.0, "flow_tolerance_percent": 5.0,
    "scale": {"value": 1.0, "minimum": 0.0, "maximum": 10.0, "fixed": False},
}  # fmt: skip


def settling(course: Course) -> NDArray[np.bool_]:
    """The first minute of a channel."""
    mask: NDArray[np.bool_] = course.time_us < course.time_us[0] + 60_000_000
    return mask


def hot(together: Together, cleaning: Cleaning) -> NDArray[np.bool_]:
    """Oil above 55 °C."""
    mask: NDArray[np.bool_] = together.values["oil_temperature"] > 55.0
    return mask


def with_paths(folder: Path, **orifice: object) -> MotorSpec:
    spec = load_motor(folder, motor_toml("M1"))
    declared = {"motor_type": "CB560", "path": [LAMINAR, ORIFICE | orifice]}
    return replace(spec, motor_type=WithOrifice.model_validate(declared, strict=False))


@pytest.fixture
def rules(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CHANNEL_RULES, "settling", settling)
    monkeypatch.setitem(JOINT_RULES, "hot", hot)
    monkeypatch.setitem(QUALITY_REASONS, "settling", Reason("sensor settling", "The first minute"))
    monkeypatch.setitem(QUALITY_REASONS, "hot", Reason("oil too hot", "Oil above 55 °C"))


def night_rows(spec: MotorSpec) -> tuple[Rows, Array]:
    """Rows of a night of 90 minutes, and its temperatures."""
    operation = operate(minutes=90.0)
    flow = operation.flow(spec.motor(NIGHT, "none"), {"distributor": 3e-14, "bore": 1.44})
    channels = raw(operation.time_us, operation.channels(flow))
    return fit_night(spec, night_of(), channels).rows, operation.temperature_c


def test_a_law_of_its_own_is_fitted_with_its_figures(tmp_path: Path) -> None:
    rows, _ = night_rows(with_paths(tmp_path))
    found = {row["parameter"]: row for row in rows["parameters"]}
    assert found["K_distributor"]["value"] == pytest.approx(3e-14, rel=1e-6)
    assert found["scale_bore"]["value"] == pytest.approx(1.44, rel=1e-6)
    assert found["scale_bore"]["verdict"] == found["d_bore"]["verdict"] == "identified"
    assert found["d_bore"]["value"] == pytest.approx(480.0, rel=1e-6)
    effects = {(row["indicator"], row["source"]): row["effect"] for row in rows["error_budget"]}
    # 5 % more flow for the same scale is a scale smaller by 5/105.
    assert effects["scale_bore", "bore flow"] == pytest.approx(-1.44 * 5 / 105, rel=1e-3)


def test_what_scales_it_and_its_tolerance_leave_the_statistics_as_they_are(tmp_path: Path) -> None:
    def hashed(**orifice: object) -> str:
        spec = with_paths(tmp_path, **orifice)
        return model_hash(spec, spec.motor(NIGHT, "none"), NIGHT)

    plain = hashed()
    assert hashed(diameter_um=300.0) == hashed(flow_tolerance_percent=1.0) == plain
    assert hashed(flow_l_per_min=2.0) != plain


@pytest.mark.usefixtures("rules")
def test_rules_of_its_own_refuse_and_are_reported_in_their_words(tmp_path: Path) -> None:
    rows, temperature = night_rows(with_paths(tmp_path))
    refused = {(row["channel"], row["reason"]): row["n_refused"] for row in rows["quality"]}
    assert refused["speed", "settling"] == refused["oil_temperature", "settling"] == 60
    assert refused["time_base", "hot"] == int((temperature[60:] > 55.0).sum()) > 0
    assert refusal("settling") == "sensor settling"
    assert refusal("hot") == "oil too hot"


def test_every_reason_has_words_on_the_pages() -> None:
    assert all(refusal(code) for code in QUALITY_REASONS)
    assert refusal("bad_quality") == "not good by the log's own word"
