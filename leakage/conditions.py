"""Operating conditions: what a motor's leakage depends on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from leakage.errors import ShapeError

PASCALS_PER_BAR = 1e5


@dataclass(frozen=True, slots=True, eq=False)
class OperatingConditions:
    """What a motor's leakage depends on, sample by sample.

    Parameters
    ----------
    pressure_difference_pa
        ΔP, high minus low port, shape (n,), [Pa]; the sign is its direction.
    oil_temperature_c
        T, shape (n,), [°C].
    speed_rpm
        ω, shape (n,), [rpm]; the sign is its direction.

    Raises
    ------
    ShapeError
        If the three differ in shape or are not one-dimensional.
    """

    pressure_difference_pa: NDArray[np.float64]
    oil_temperature_c: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]

    def __post_init__(self) -> None:
        shapes = [
            channel.shape
            for channel in (self.pressure_difference_pa, self.oil_temperature_c, self.speed_rpm)
        ]
        if len(shapes[0]) != 1 or len(set(shapes)) != 1:
            raise ShapeError(
                "conditions_shape",
                "pressure difference, oil temperature and speed must be one-dimensional and of"
                f" one length, not of shapes {shapes}",
            )

    @classmethod
    def from_bar(
        cls, pressure_difference_bar: ArrayLike, oil_temperature_c: ArrayLike, speed_rpm: ArrayLike
    ) -> OperatingConditions:
        """Conditions in the units of logs and tables; scalars are one sample, or every sample's.

        Parameters
        ----------
        pressure_difference_bar
            ΔP, shape (n,) or scalar, [bar].
        oil_temperature_c
            T, shape (n,) or scalar, [°C].
        speed_rpm
            ω, shape (n,) or scalar, [rpm].

        Returns
        -------
        OperatingConditions
            The conditions, ΔP in [Pa].

        Examples
        --------
        >>> OperatingConditions.from_bar([100.0, 200.0], 50.0, 30.0).oil_temperature_c.tolist()
        [50.0, 50.0]
        """
        bar, temperature, speed = (
            np.atleast_1d(np.asarray(channel, dtype=np.float64))
            for channel in (pressure_difference_bar, oil_temperature_c, speed_rpm)
        )
        try:
            bar, temperature, speed = np.broadcast_arrays(bar, temperature, speed)
        except ValueError as error:
            raise ShapeError("conditions_shape", f"conditions do not match: {error}") from error
        return cls(bar * PASCALS_PER_BAR, temperature, speed)

    def __len__(self) -> int:
        return self.speed_rpm.size

    def part(self, rows: slice) -> OperatingConditions:
        """Conditions of some of the samples, as views."""
        return OperatingConditions(
            self.pressure_difference_pa[rows], self.oil_temperature_c[rows], self.speed_rpm[rows]
        )
