"""Growth of the gaps of a simulated motor over its nights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

LAST_NIGHT_OF_GROWTH: Final = 75

Course = Literal["step", "linear", "accelerating"]


@dataclass(frozen=True, slots=True)
class Wear:
    """Gap heights that grow."""

    words: str  # what happens, for people
    paths: tuple[str, ...]  # leakage paths whose gaps grow
    first_night: int  # number of the first night with wear, counted from 1
    gap_growth: float  # relative growth of the gap height when the wear is complete, [-]
    # ``step``: complete from its first night on; ``linear`` and ``accelerating`` (with the square
    # of time): complete from night 75 on.
    course: Course

    def growth(self, path: str, number: int) -> float:
        """Relative growth of a path's gap height by a night, counted from 1, [-].

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
