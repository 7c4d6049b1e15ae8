"""Parts of the ± of a figure, and their total: samples, sensors, model.

The total is half the width of a 95 % interval of the figure itself; a stated tolerance counts as
two standard deviations. A motor that is compared with itself takes the statistical part alone:
what its sensors and its model do wrong is the same on all nights.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from leakage.estimation.error_sources import SENSORS

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ErrorParts:
    """Half-widths of a figure, in its unit."""

    statistical: float | None  # of the interval from the samples; None without one
    sensor: float  # from tolerances of the sensors, stated or assumed
    model: float | None  # from the night's structured misfit; None where it is not known
    # From tolerances of constants, as far as they are not the same on all nights.
    constants: float = 0.0

    @property
    def beside_samples(self) -> float:
        """All parts but the statistical one."""
        return math.hypot(self.sensor, self.model or 0.0, self.constants)

    @property
    def total(self) -> float | None:
        """Of all parts, by their squares; None without an interval from the samples."""
        if self.statistical is None:
            return None
        return math.hypot(self.statistical, self.beside_samples)

    def columns(self) -> dict[str, float | None]:
        """Columns that all figures have."""
        return {
            "statistical_half_width": self.statistical,
            "sensor_half_width": self.sensor,
            "model_half_width": self.model,
            "total_half_width": self.total,
        }


def of_stated(sensitivities: Sequence[Row]) -> dict[str, float]:
    """± of each indicator from stated tolerances."""
    return _by_squares([row for row in sensitivities if row.get("assumed_sensor") is None])


def of_sensors(sensitivities: Sequence[Row]) -> dict[str, float]:
    """± of each indicator from tolerances of sensors, stated or assumed."""
    return _by_squares([row for row in sensitivities if _is_sensor(row)])


def of_extrapolation(sensitivities: Sequence[Row], there: str, here: str, ratio: float) -> float:
    """± of one leakage against another from tolerances of constants, scaled by their ratio."""
    effects: defaultdict[str, float] = defaultdict(float)
    for row in sensitivities:
        if row["indicator"] in (there, here) and not _is_sensor(row):
            effects[row["source"]] += row["effect"] * (1.0 if row["indicator"] == there else -ratio)
    return math.hypot(*effects.values())


def _is_sensor(row: Row) -> bool:
    return str(row["source"]).startswith(SENSORS)


def _by_squares(rows: Sequence[Row]) -> dict[str, float]:
    effects: defaultdict[str, list[float]] = defaultdict(list)
    for row in rows:
        effects[row["indicator"]].append(row["effect"])
    return {indicator: math.hypot(*found) for indicator, found in effects.items()}
