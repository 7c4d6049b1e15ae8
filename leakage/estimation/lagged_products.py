r"""Sums of products of series at many lags, over pairs within one segment of samples only.

For series with gaps,

.. math:: S_{ab}(k) = \sum a(t)\, b(t + k) ,

over all t for which t and t + k lie in the same segment, a stretch of samples without a gap. The
sums are exact up to rounding. A segment is cut into chunks, each with what it reaches ahead; the
products of all chunks of one length are taken in the frequency domain [1]_, so the cost is that of
a few passes over the samples, however many lags and segments there are.

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

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Places = NDArray[np.int64]

# Lengths of transforms: short ones waste time between calls, long ones leave the cache.
SHORTEST_TRANSFORM, SHORTEST_LONGEST_TRANSFORM = 16, 4096
# Points that are transformed at a time.
BATCH_POINTS = 1 << 15


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
        begins = np.flatnonzero(np.diff(index, prepend=-2) != 1)
        return cls(begins, np.diff(begins, append=len(index)))

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

    def mask(self, n: int) -> Mask:
        """Mask over n samples, True in a segment, shape (n,)."""
        steps = np.zeros(n + 1, dtype=np.int64)
        np.add.at(steps, self.begins, 1)
        np.add.at(steps, self.begins + self.lengths, -1)
        inside: Mask = np.cumsum(steps)[:-1] > 0
        return inside


@dataclass(frozen=True, slots=True, eq=False)
class _Chunks:
    """Pieces of segments: each sample is owned by one chunk, which also sees what lies ahead."""

    begins: Places
    owned: Places
    seen: Places

    def only(self, chosen: slice | Places) -> _Chunks:
        return _Chunks(self.begins[chosen], self.owned[chosen], self.seen[chosen])


def lagged_products(
    series: Array, segments: Segments, longest_lag: int, pairs: Sequence[tuple[int, int]]
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

    Returns
    -------
    ndarray
        For each pair the sums at lags 0 to `longest_lag`, shape (p, longest_lag + 1); 0 where no
        pair of samples has that lag.

    Examples
    --------
    >>> values = np.array([[1.0, 2, 3, 4, 5]])
    >>> lagged_products(values, Segments.of(np.array([0, 1, 2, 7, 8])), 2, [(0, 0)]).round(9)
    array([[55., 28.,  3.]])
    """
    size = SHORTEST_LONGEST_TRANSFORM
    while size < 8 * (longest_lag + 1):
        size *= 2
    chunks = _cut(segments, longest_lag, size - longest_lag)
    # A transform has to hold what is owned and all lags that are asked for, or that exist.
    needed = np.maximum(chunks.seen, chunks.owned + np.minimum(longest_lag, chunks.seen - 1))
    lengths = np.maximum(2 ** np.ceil(np.log2(needed)).astype(np.int64), SHORTEST_TRANSFORM)
    sums = np.zeros((len(pairs), longest_lag + 1))
    whole = chunks.owned == chunks.seen
    for kind in np.unique(np.where(whole, lengths, -lengths)).tolist():
        length, is_whole = abs(kind), kind > 0
        chosen = np.flatnonzero((lengths == length) & (whole == is_whole))
        spectrum = _spectra(series, chunks.only(chosen), length, pairs, are_whole=is_whole)
        # Beyond half of a short transform stand the sums at negative lags.
        lags = min(longest_lag, (length - 1) // 2) + 1
        sums[:, :lags] += np.fft.irfft(spectrum, length)[:, :lags]
    return sums


def _cut(segments: Segments, longest_lag: int, longest: int) -> _Chunks:
    counts = -(-segments.lengths // longest)
    segment = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts, counts)
    left = segments.lengths[segment] - within * longest
    return _Chunks(
        segments.begins[segment] + within * longest,
        np.minimum(left, longest),
        np.minimum(left, longest + longest_lag),
    )


def _spectra(
    series: Array,
    chunks: _Chunks,
    length: int,
    pairs: Sequence[tuple[int, int]],
    *,
    are_whole: bool,
) -> NDArray[np.complex128]:
    """Sum over chunks of conj(A) B, for each pair of series; shape (p, length // 2 + 1).

    A chunk that is a whole segment owns all that it sees: one transform of it is enough, and (b, a)
    is (a, b) conjugated.
    """
    place = np.arange(length)
    unique = [pair for at, pair in enumerate(pairs) if not (are_whole and pair[::-1] in pairs[:at])]
    sums = {pair: np.zeros(length // 2 + 1, dtype=np.complex128) for pair in unique}
    step = max(1, BATCH_POINTS // length)
    for first in range(0, len(chunks.begins), step):
        batch = chunks.only(slice(first, first + step))
        unseen = place >= batch.seen[:, None]
        not_owned = place >= batch.owned[:, None]
        # Places beyond the last sample are not seen: which value stands there is all the same.
        places = batch.begins[:, None] + place
        seen, owned = [], []
        for one in series:
            values = one.take(places, mode="clip")
            values[unseen] = 0.0
            seen.append(np.fft.rfft(values))
            if not are_whole:
                values[not_owned] = 0.0
            owned.append((seen[-1] if are_whole else np.fft.rfft(values)).conj())
        for (a, b), spectrum in sums.items():
            spectrum += (owned[a] * seen[b]).sum(axis=0)
    return np.stack([sums[pair] if pair in sums else sums[pair[::-1]].conj() for pair in pairs])
