r"""Sums of products of series at many lags, over pairs within one segment of samples only.

For series with gaps,

.. math:: S_{ab}(k) = \sum a(t)\, b(t + k) ,

over all t for which t and t + k lie in the same segment, a stretch of samples without a gap. The
sums are exact up to rounding. Segments of about the same length are transformed together, each in
a row that zeros fill up, and their products are taken in the frequency domain [1]_: the cost is
that of a few passes over the samples, however many lags and segments there are. A long segment is
cut into pieces that overlap by the longest lag: each pair is within a piece, and those within an
overlap, which are in two, are taken off once.

References
----------
.. [1] T. G. Stockham, "High-speed convolution and correlation", *AFIPS Spring Joint Computer
   Conference*, 28, 1966: correlation in sections.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array, Mask, Places

Spectra = NDArray[np.complex128]

# Lengths of transforms: short ones waste time between calls, long ones leave the cache.
SHORTEST_TRANSFORM, SHORTEST_LONGEST_TRANSFORM = 16, 1 << 14
# Points of all series that are transformed at a time.
BATCH_POINTS = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Stretches of samples without a gap."""

    # begins, lengths: first sample of each and how many it has, shape (s,).
    begins: Places
    lengths: Places

    @classmethod
    def of(cls, index: Places) -> Segments:
        """Segments of samples by their places on an even time base, increasing, shape (n,)."""
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
        """Number of pairs within one segment at each lag from 0 to `longest_lag` samples."""
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
        """Samples by their ranks among those of all segments, shape of `ranks`."""
        ends = np.cumsum(self.lengths)
        segment = np.searchsorted(ends, ranks, side="right")
        return ranks + (self.begins + self.lengths - ends)[segment]


def lagged_products(
    series: Sequence[Array],
    means: Sequence[float],
    segments: Segments,
    longest_lag: int,
    crossed_lag: int = 0,
) -> tuple[Array, Array]:
    """Sums of products a(t) b(t + k) of series less their means, over pairs within one segment.

    Of each series with itself at lags 0 to `longest_lag`, shape (s, longest_lag + 1); of the first,
    a, with each other one at lags −crossed_lag to crossed_lag, shape (s − 1, 2 crossed_lag + 1).
    """
    own = np.zeros((len(series), longest_lag + 1))
    crossed = np.zeros((len(series) - 1, 2 * crossed_lag + 1))
    pieces, overlaps = _pieces(segments, longest_lag)
    for sign, some in ((1.0, pieces), (-1.0, overlaps)):
        for length, (power, product) in _spectra(series, means, some, longest_lag).items():
            # Of a short transform, one half stands for lags ahead and the other for lags behind.
            ahead, reach = (min(lag, (length - 1) // 2) for lag in (longest_lag, crossed_lag))
            own[:, : ahead + 1] += sign * np.fft.irfft(power, length)[:, : ahead + 1]
            lags = np.arange(-reach, reach + 1)
            crossed[:, crossed_lag + lags] += sign * np.fft.irfft(product, length)[:, lags]
    return own, crossed


def products_near_ends(
    series: Sequence[Array], means: Sequence[float], segments: Segments, margin: int
) -> Array:
    """Those crossed sums of which t is among the `margin` first or last samples of its segment."""
    lags, own = np.arange(2 * margin + 1), np.arange(margin)[:, None]
    sums = np.zeros((len(series) - 1, len(lags)))
    step = max(1, BATCH_POINTS // (len(series) * 2 * margin))
    for first in range(0, len(segments.begins), step):
        part = segments[first : first + step]
        begins, ends = np.tile(part.begins, 2)[:, None], np.tile(part.ends, 2)[:, None]
        # What is among the first and the last counts once.
        head_ends = np.minimum(part.begins + margin, part.ends)
        tails = np.maximum(part.ends - margin, head_ends)
        place = np.concatenate([part.begins, tails])[:, None] + np.arange(-margin, 2 * margin)
        inside = (place >= begins) & (place < ends)
        owners = place[:, margin : 2 * margin]
        owned = series[0].take(owners, mode="clip") - means[0]
        owned *= owners < np.concatenate([head_ends, part.ends])[:, None]
        for of_one, values, mean in zip(sums, series[1:], means[1:], strict=True):
            seen = values.take(place, mode="clip") - mean
            seen *= inside
            of_one += (owned.T @ seen)[own, own + lags].sum(axis=0)
    return sums


def _pieces(segments: Segments, longest_lag: int) -> tuple[Segments, Segments]:
    """Segments, of which long ones are cut into overlapping pieces; and the overlaps."""
    length = SHORTEST_LONGEST_TRANSFORM
    while length < 4 * (longest_lag + 1):
        length *= 2
    longest = length - longest_lag
    if segments.lengths.max(initial=0) <= longest:
        return segments, segments[:0]
    step = longest - longest_lag
    counts = np.maximum(-((longest_lag - segments.lengths) // step), 1)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    begins = np.repeat(segments.begins, counts) + step * place
    ends = np.minimum(begins + longest, np.repeat(segments.ends, counts))
    again = begins[place > 0]
    return Segments(begins, ends - begins), Segments(again, np.full(len(again), longest_lag))


def _spectra(
    series: Sequence[Array], means: Sequence[float], segments: Segments, longest_lag: int
) -> dict[int, tuple[Array, Spectra]]:
    """Sums of |A|², shape (s, f), and conj(A) B, shape (s − 1, f), by length of the transform."""
    order = np.argsort(-segments.lengths)
    needed = segments.lengths + np.minimum(longest_lag, segments.lengths - 1)
    sums: dict[int, tuple[Array, Spectra]] = {}
    first = 0
    while first < len(order):
        length = _transform_length(int(needed[order[first]]))
        batch = segments[order[first : first + max(1, BATCH_POINTS // (len(series) * length))]]
        spectra = np.fft.rfft(_rows(series, means, batch, length))
        shape = len(series) - 1, length // 2 + 1
        power, product = sums.setdefault(
            length, (np.zeros((shape[0] + 1, shape[1], 2)), np.zeros(shape, dtype=np.complex128))
        )
        parts = spectra.view(np.float64)
        power += np.einsum("srf,srf->sf", parts, parts).reshape(power.shape)
        product += np.multiply(spectra[0].conj(), spectra[1:], out=spectra[1:]).sum(axis=1)
        first += len(batch.begins)
    return {length: (power.sum(axis=2), product) for length, (power, product) in sums.items()}


def _rows(
    series: Sequence[Array], means: Sequence[float], segments: Segments, length: int
) -> Array:
    """Centred values in rows that begin with a segment each, shape (s, segments, length)."""
    rows = np.zeros((len(series), len(segments.begins), length))
    places = [*zip(segments.begins.tolist(), segments.ends.tolist(), strict=True)]
    for of_one, values, mean in zip(rows, series, means, strict=True):
        for row, (begin, end) in zip(of_one, places, strict=True):
            np.subtract(values[begin:end], mean, out=row[: end - begin])
    return rows


def _transform_length(needed: int) -> int:
    """The least power of two, or three quarters of one, that is not below what is needed."""
    power = max(SHORTEST_TRANSFORM, 1 << (needed - 1).bit_length())
    return power * 3 // 4 if needed <= power * 3 // 4 else power
