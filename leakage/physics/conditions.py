"""Operating conditions: what a motor's leakage depends on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from leakage.arrays import Array
from leakage.errors import ShapeError

PASCALS_PER_BAR = 1e5


@dataclass(frozen=True, slots=True, eq=False)
class OperatingConditions:
    """Operating conditions that a motor's leakage depends on, sample by sample.

    `pressure_difference_pa`: ΔP, high minus low port, shape (n,), [Pa]; the sign is its direction.
    `oil_temperature_c`: T, shape (n,), [°C].
    `speed_rpm`: ω, shape (n,), [rpm]; the sign is its direction.
    `charge_over_case_pa`: Charge pressure (the low port's) above case pressure, shape (n,), [Pa]:
    every path then leaks to the case from both sides. None: the thesis's one side, at ΔP.

    Raises ShapeError if the channels differ in shape or are not one-dimensional.
    """

    pressure_difference_pa: Array
    oil_temperature_c: Array
    speed_rpm: Array
    charge_over_case_pa: Array | None = None

    def __post_init__(self) -> None:
        channels = [self.pressure_difference_pa, self.oil_temperature_c, self.speed_rpm]
        if self.charge_over_case_pa is not None:
            channels.append(self.charge_over_case_pa)
        shapes = [channel.shape for channel in channels]
        if len(shapes[0]) != 1 or len(set(shapes)) != 1:
            raise ShapeError(
                "conditions_shape",
                "the channels of operating conditions must be one-dimensional and of equal length,"
                f" not of shapes {shapes}",
            )

    @classmethod
    def from_bar(
        cls,
        pressure_difference_bar: ArrayLike,
        oil_temperature_c: ArrayLike,
        speed_rpm: ArrayLike,
        charge_over_case_bar: ArrayLike | None = None,
    ) -> OperatingConditions:
        """Return conditions in the units of logs and tables; scalars are every sample's.

        Examples
        --------
        >>> OperatingConditions.from_bar([100.0, 200.0], 50.0, 30.0).oil_temperature_c.tolist()
        [50.0, 50.0]
        """
        given = [pressure_difference_bar, oil_temperature_c, speed_rpm]
        if charge_over_case_bar is not None:
            given.append(charge_over_case_bar)
        try:
            channels = np.broadcast_arrays(
                *(np.atleast_1d(np.asarray(channel, dtype=np.float64)) for channel in given)
            )
        except ValueError as error:
            raise ShapeError("conditions_shape", f"conditions do not match: {error}") from error
        charge = channels[3] * PASCALS_PER_BAR if len(channels) > 3 else None
        return cls(channels[0] * PASCALS_PER_BAR, channels[1], channels[2], charge)

    @classmethod
    def join(cls, parts: Sequence[OperatingConditions]) -> OperatingConditions:
        """Return samples of some conditions, end to end; all single-sided, or all two-sided."""
        charges = [
            part.charge_over_case_pa for part in parts if part.charge_over_case_pa is not None
        ]
        return cls(
            np.concatenate([part.pressure_difference_pa for part in parts]),
            np.concatenate([part.oil_temperature_c for part in parts]),
            np.concatenate([part.speed_rpm for part in parts]),
            np.concatenate(charges) if charges else None,
        )

    def __len__(self) -> int:
        return self.speed_rpm.size

    def part(self, rows: slice | NDArray[np.int64]) -> OperatingConditions:
        """Return conditions of some of the samples; of a slice as views."""
        charge = self.charge_over_case_pa
        return OperatingConditions(
            self.pressure_difference_pa[rows],
            self.oil_temperature_c[rows],
            self.speed_rpm[rows],
            None if charge is None else charge[rows],
        )

    def sides(self) -> tuple[OperatingConditions, ...]:
        """Return the pressures that drive leakage to the case, each as conditions of its own.

        The conditions themselves where one side leaks; with a charge pressure the high side, at
        |ΔP| + (p_charge − p_case), and the low side, at p_charge − p_case.
        """
        charge = self.charge_over_case_pa
        if charge is None:
            return (self,)
        high = np.abs(self.pressure_difference_pa) + charge
        return tuple(
            OperatingConditions(pressure, self.oil_temperature_c, self.speed_rpm)
            for pressure in (high, charge)
        )
