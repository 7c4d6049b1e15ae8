r"""Sums of products of series at many lags, over pairs within one segment of samples only.

For series with gaps,

.. math:: S_{ab}(k) = \sum a(t)\, b(t + k) ,

over all t for which t and t + k lie in the same segment, a stretch of samples without a gap. The
sums are exact up to rounding. Segments of about the same length are transformed together, each in
a row that zeros fill up, and their products are taken in the frequency domain [1]_: the cost is
that of a few passes over the samples, however many lags and segments there are. A long segment is
cut into chunks, each with what it reaches ahead and behind.

References
----------
.. [1] T. G. Stockham, "High-speed convolution and correlation", *AFIPS Spring Joint Computer
   Conference*, 28, 1966: correlation in sections.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Places = NDArray[np.int64]
Spectra = NDArray[np.complex128]
# Length, and the transforms of the samples that chunks own and see, shape (s, c, length // 2 + 1).
Transforms: TypeAlias = Iterator[tuple[int, Spectra, Spectra]]

# Lengths of transforms: short ones waste time between calls, long ones leave the cache.
SHORTEST_TRANSFORM, SHORTEST_LONGEST_TRANSFORM = 16, 4096
# Points of a series that are transformed at a time.
BATCH_POINTS = 1 << 14


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Stretches of samples without a gap.

    Attributes
    ----------
    begins, lengths
        First sample of each and how many it has, shape (s,).
    """

    begins: Places
    lengths: Places

    @classmethod
    def of(cls, index: Places) -> Segments:
        """Segments of samples by their places on an even time base, increasing, shape (n,).

        Examples
        --------
        >>> Segments.of(np.array([3, 4, 5, 9, 10])).lengths
        array([3, 2])
        """
        begins = np.concatenate([[0], np.flatnonzero(index[1:] - index[:-1] != 1) + 1])
        begins = begins[: len(index)]
        return cls(begins, np.diff(begins, append=len(index)))

    def __getitem__(self, chosen: slice | Mask | Places) -> Segments:
        return Segments(self.begins[chosen], self.lengths[chosen])

    @property
    def ends(self) -> Places:
        """Sample behind the last of each, shape (s,)."""
        return self.begins + self.lengths

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(self.lengths.sum())

    def pair_counts(self, longest_lag: int) -> Array:
        """Number of pairs within one segment at each lag from 0 to `longest_lag` samples.

        Examples
        --------
        >>> Segments.of(np.array([3, 4, 5, 9, 10])).pair_counts(3)
        array([5., 3., 1., 0.])
        """
        lengths = np.sort(self.lengths)
        sums = np.concatenate([[0], np.cumsum(lengths)])
        lags = np.arange(longest_lag + 1)
        shorter = np.searchsorted(lengths, lags, side="right")
        counts: Array = (sums[-1] - sums[shorter] - lags * (len(lengths) - shorter)).astype(float)
        return counts

    def without_ends(self, margin: int) -> Segments:
        """The segments without `margin` samples at each end; those that are no longer are gone."""
        kept = self.lengths > 2 * margin
        return Segments(self.begins[kept] + margin, self.lengths[kept] - 2 * margin)

    def samples(self, ranks: Places) -> Places:
        """Samples by their ranks among those of all segments, shape of `ranks`.

        Examples
        --------
        >>> Segments(np.array([3, 20]), np.array([2, 5])).samples(np.array([0, 1, 2, 6]))
        array([ 3,  4, 20, 24])
        """
        ends = np.cumsum(self.lengths)
        segment = np.searchsorted(ends, ranks, side="right")
        return ranks + (self.begins + self.lengths - ends)[segment]


def lagged_products(
    series: Array,
    segments: Segments,
    longest_lag: int,
    pairs: Sequence[tuple[int, int]],
    behind: int = 0,
) -> Array:
    """Sums of products a(t) b(t + k) over pairs within one segment.

    Parameters
    ----------
    series
        Shape (s, n), finite; centred series keep more digits.
    segments
        Where the samples have no gap.
    longest_lag
        Largest lag k [samples].
    pairs
        Which series are a and b; a series with itself gives its autocovariance.
    behind
        Largest lag of the other sign [samples], not above `longest_lag`.

    Returns
    -------
    ndarray
        For each pair the sums at lags −behind to `longest_lag`, shape (p, behind + 1 +
        longest_lag); 0 where no pair of samples has that lag.

    Examples
    --------
    >>> values = np.array([[1.0, 2, 3, 4, 5]])
    >>> lagged_products(values, Segments.of(np.array([0, 1, 2, 7, 8])), 2, [(0, 0)]).round(9)
    array([[55., 28.,  3.]])
    """
    size = SHORTEST_LONGEST_TRANSFORM
    while size < 4 * (longest_lag + 1):
        size *= 2
    is_whole = segments.lengths <= size - behind - longest_lag
    transforms = chain(
        _whole(series, segments[is_whole], longest_lag),
        _cut(series, segments[~is_whole], behind, longest_lag, size),
    )
    # Sums over chunks of conj(A) B for each pair, by the length of the transform.
    spectra: dict[int, Spectra] = {}
    for length, owned, seen in transforms:
        spectrum = spectra.setdefault(
            length, np.zeros((len(pairs), length // 2 + 1), dtype=np.complex128)
        )
        for total, (a, b) in zip(spectrum, pairs, strict=True):
            total += (owned[a].conj() * seen[b]).sum(axis=0)
    sums = np.zeros((len(pairs), behind + 1 + longest_lag))
    for length, spectrum in spectra.items():
        found = np.fft.irfft(spectrum, length)
        # Of a short transform, one half stands for lags ahead and the other for lags behind.
        ahead, back = (min(lag, (length - 1) // 2) for lag in (longest_lag, behind))
        sums[:, behind : behind + ahead + 1] += found[:, : ahead + 1]
        sums[:, behind - back : behind] += found[:, length - back :]
    return sums


def products_near_ends(series: Array, segments: Segments, margin: int) -> Array:
    """Sums of products a(t) b(t + k) with t among the first or last samples of its segment.

    Parameters
    ----------
    series
        Shape (s, n); a is the first series, b each other one.
    segments
        Where the samples have no gap.
    margin
        How many samples are first or last ones; also the largest lag of either sign.

    Returns
    -------
    ndarray
        For each b the sums at lags −margin to margin, shape (s − 1, 2 margin + 1).

    Examples
    --------
    >>> values = np.array([[1.0, 2, 3, 4, 5], [1, 1, 1, 1, 10]])
    >>> products_near_ends(values, Segments.of(np.arange(5)), 1)
    array([[ 5., 51.,  1.]])
    """
    lags, own = np.arange(2 * margin + 1), np.arange(margin)[:, None]
    sums = np.zeros((len(series) - 1, len(lags)))
    step = max(1, BATCH_POINTS // (2 * margin))
    for first in range(0, len(segments.begins), step):
        part = segments[first : first + step]
        begins, ends = np.tile(part.begins, 2)[:, None], np.tile(part.ends, 2)[:, None]
        # What is among the first and the last counts once.
        head_ends = np.minimum(part.begins + margin, part.ends)
        tails = np.maximum(part.ends - margin, head_ends)
        place = np.concatenate([part.begins, tails])[:, None] + np.arange(-margin, 2 * margin)
        seen = series[1:].take(place, axis=1, mode="clip")
        seen *= (place >= begins) & (place < ends)
        place = place[:, margin : 2 * margin]
        owned = series[0].take(place, mode="clip")
        owned *= place < np.concatenate([head_ends, part.ends])[:, None]
        products = owned.T @ seen
        sums += products[:, own, own + lags].sum(axis=1)
    return sums


def _whole(series: Array, segments: Segments, longest_lag: int) -> Transforms:
    """Transforms of whole segments, of which those of about one length share a batch."""
    order = np.argsort(-segments.lengths)
    needed = segments.lengths + np.minimum(longest_lag, segments.lengths - 1)
    first = 0
    while first < len(order):
        length = _transform_length(int(needed[order[first]]))
        batch = segments[order[first : first + max(1, BATCH_POINTS // length)]]
        seen = _transformed(series, length, batch.begins, batch.begins, batch.ends)
        yield length, seen, seen
        first += len(batch.begins)


def _cut(series: Array, segments: Segments, behind: int, ahead: int, length: int) -> Transforms:
    """Transforms of the chunks of long segments, each with the samples that it reaches."""
    longest, step = length - behind - ahead, max(1, BATCH_POINTS // length)
    for begin, end in zip(segments.begins, segments.ends, strict=True):
        for first in range(begin, end, step * longest):
            begins = np.arange(first, min(first + step * longest, end), longest)
            seen_from = np.maximum(begins - behind, begin)
            ends = np.minimum(begins + longest, end)
            yield (
                length,
                _transformed(series, length, seen_from, begins, ends),
                _transformed(series, length, seen_from, seen_from, np.minimum(ends + ahead, end)),
            )


def _transformed(
    series: Array, length: int, origins: Places, begins: Places, ends: Places
) -> Spectra:
    """Transforms of rows from the origins on, zero outside begins and ends."""
    rows = np.zeros((len(series), len(begins), length))
    for row, (origin, begin, end) in enumerate(
        zip(origins.tolist(), begins.tolist(), ends.tolist(), strict=True)
    ):
        rows[:, row, begin - origin : end - origin] = series[:, begin:end]
    return np.fft.rfft(rows)


def _transform_length(needed: int) -> int:
    """The least power of two, or three quarters of one, that is not below what is needed."""
    power = max(SHORTEST_TRANSFORM, 1 << (needed - 1).bit_length())
    return power * 3 // 4 if needed <= power * 3 // 4 else power
