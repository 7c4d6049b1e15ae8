"""Growth of the gaps of a simulated motor over its nights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

LAST_NIGHT_OF_GROWTH: Final = 75

Course = Literal["step", "linear", "accelerating"]


@dataclass(frozen=True, slots=True)
class Wear:
    """Gap heights that grow.

    Parameters
    ----------
    words
        What happens, for people.
    paths
        Leakage paths whose gaps grow.
    first_night
        Number of the first night with wear, counted from 1.
    gap_growth
        Relative growth of the gap height when the wear is complete, [-].
    course
        ``step``: complete from its first night on; ``linear`` and ``accelerating`` (with the
        square of time): complete from night 75 on.
    """

    words: str
    paths: tuple[str, ...]
    first_night: int
    gap_growth: float
    course: Course

    def growth(self, path: str, number: int) -> float:
        """Relative growth of a path's gap height by a night, [-].

        Parameters
        ----------
        path
            Name of the path.
        number
            Number of the night, counted from 1.

        Returns
        -------
        float
            0 before the wear, and for paths that do not wear.

        Examples
        --------
        >>> wear = Wear("rings", ("piston_ring",), 31, 0.3, "linear")
        >>> [round(wear.growth("piston_ring", number), 3) for number in (30, 31, 75, 90)]
        [0.0, 0.007, 0.3, 0.3]
        """
        if path not in self.paths or number < self.first_night:
            return 0.0
        if self.course == "step":
            return self.gap_growth
        nights = LAST_NIGHT_OF_GROWTH - self.first_night + 1
        share = min((number - self.first_night + 1) / nights, 1.0)
        return self.gap_growth * (share if self.course == "linear" else share**2)
