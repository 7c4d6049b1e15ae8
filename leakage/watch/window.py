"""The nights of a motor as the watch keeps them: numbers of fixed size a night."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leakage.watch import choices
from leakage.watch.nights import Array
from leakage.watch.wander import Wander, effective


@dataclass(frozen=True, slots=True)
class Window:
    """Nights in order, and what all before them say together.

    Attributes
    ----------
    days
        Of the nights, shape (n,).
    information, score
        Of each night, shapes (n, q, q) and (n, q).
    distance
        Of each night's duty from the baseline's, shape (n,).
    odd
        ln of how much likelier each night was as an odd one, shape (n,); 0 in the baseline.
    before, score_before
        Prior, and what the nights before the window say, shapes (q, q) and (q,).
    """

    days: NDArray[np.int64]
    information: Array
    score: Array
    distance: Array
    odd: Array
    before: Array
    score_before: Array

    def __len__(self) -> int:
        return len(self.days)

    def with_night(self, day: int, information: Array, score: Array, distance: float) -> Window:
        """The window with one more night."""
        return replace(
            self,
            days=np.append(self.days, day),
            information=np.concatenate([self.information, information[None]]),
            score=np.concatenate([self.score, score[None]]),
            distance=np.append(self.distance, distance),
            odd=np.append(self.odd, 0.0),
        )

    def with_odd(self, odd: float) -> Window:
        """The window with how odd its newest night was."""
        return replace(self, odd=np.append(self.odd[:-1], odd))

    def from_night(self, first: int, before: Array, score_before: Array) -> Window:
        """The nights from a place on, before which stand other figures; none was odd so far."""
        return Window(
            self.days[first:],
            self.information[first:],
            self.score[first:],
            self.distance[first:],
            np.zeros(len(self) - first),
            before,
            score_before,
        )

    def shortened(self, sums: Sums) -> Window:
        """The window without its oldest nights, where it is long; they are summed up."""
        if len(self) < choices.WINDOW + choices.WINDOW_SLACK:
            return self
        first = len(self) - choices.WINDOW
        before, score_before = sums.before(np.array([first]), self)
        odd = self.odd[first:]
        return replace(self.from_night(first, before[0], score_before[0]), odd=odd)


@dataclass(frozen=True, slots=True)
class Sums:
    """Cumulative sums over a window's nights, each with its own shift of the paths.

    Shapes (2, n + 1, …): information weighted by 1, day and day²; scores by 1 and day. First with
    the shifts' covariance Q as it is, then times the inflation of a long record: sums of correlated
    nights lie between. Distances have shape (n + 1,).
    """

    information: tuple[Array, Array, Array]
    score: tuple[Array, Array]
    distance: Array

    @classmethod
    def of(cls, window: Window, wander: Wander) -> Sums:
        q = window.score.shape[1]
        start = cls((np.zeros((2, 1, q, q)),) * 3, (np.zeros((2, 1, q)),) * 2, np.zeros(1))
        return start._extended(window, wander, 0)

    def with_night(self, window: Window, wander: Wander) -> Sums:
        """The sums with the newest night of a window, which has one night more than these."""
        return self._extended(window, wander, len(window) - 1)

    def _extended(self, window: Window, wander: Wander, first: int) -> Sums:
        """With the nights from a place on."""
        told = [
            effective(window.information[first:], window.score[first:], factor * wander.spread)
            for factor in (1.0, wander.long_inflation)
        ]
        information, score = (np.stack([one[place] for one in told]) for place in (0, 1))

        def summed(sums: Array, values: Array) -> Array:
            return np.concatenate([sums, sums[:, -1:] + values.cumsum(axis=1)], axis=1)

        days = window.days[first:].astype(float)
        by_day, by_matrix = days[:, None], days[:, None, None]
        a, u, distance = self.information, self.score, window.distance[first:]
        return Sums(
            (
                summed(a[0], information),
                summed(a[1], information * by_matrix),
                summed(a[2], information * by_matrix**2),
            ),
            (summed(u[0], score), summed(u[1], score * by_day)),
            np.append(self.distance, self.distance[-1] + distance.cumsum()),
        )

    def before(self, starts: NDArray[np.intp], window: Window) -> tuple[Array, Array]:
        """What all nights before some starts say, shapes (k, q, q) and (k, q)."""
        return (
            window.before + self.information[0][1, starts],
            window.score_before + self.score[0][1, starts],
        )

    def since(
        self,
        sums: Array,
        starts: NDArray[np.intp],
        weights: tuple[Array, Array],
        without: NDArray[np.intp] | None,
    ) -> Array:
        """Some of these sums from starts to the newest night, shape (k, …).

        `weights` are those of the sums with Q as it is and of those with Q of a long record, shape
        (k,) each; `without` is a night that each start leaves out.
        """
        since: Array = sums[:, -1:] - sums[:, starts]
        if without is not None:
            since = since - (sums[:, without + 1] - sums[:, without])
        short, long = (one.reshape((-1,) + (1,) * (since.ndim - 2)) for one in weights)
        mixed: Array = short * since[0] + long * since[1]
        return mixed
