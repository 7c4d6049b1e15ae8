"""What a channel's samples look like: readings, changes, what a historian left, means, or counts.

Never certain: the tests go by the spacing of the stamps and by which changes occur and which do
not, whatever the channel's magnitude. Three facts carry them:

- Changes between readings are distributed about zero, those next to zero the most frequent. Where
  changes below some size are absent, samples are sent on change.
- Where samples are lost at random, the value has changed more the longer the silence was. Where
  what is sent depends on the value, it has not.
- First differences of the means of adjoining periods of a random walk have a correlation of 1/4
  from one to the next and none beyond [1]_; those of readings have none, or are negative.

References
----------
.. [1] H. Working, "Note on the correlation of first differences of averages in a random chain",
   *Econometrica*, 28(4), 1960, p. 916.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, spearmanr

from pipeline.ingest import RawChannel

Values = NDArray[np.float64]

Kind = Literal[
    "periodic", "on_change", "compressed", "irregular", "mean", "cumulative", "pulses", "unknown"
]

# Samples of the head of a log that are looked at, and fewest that tell anything.
HEAD = 20_000
FEWEST = 30
# Larger figures are no readings, and their squares no numbers.
LARGEST = 1e100
# A step is a silence beyond so many of the shortest tenth of steps; a log is irregular where
# silences are so frequent, and take up so much of the time.
SILENCE_STEPS = 3.5
SILENT_STEPS_SHARE = 0.02
SILENT_TIME_SHARE = 0.2
# Changes next to zero are absent where they are so many times rarer than the smallest ones, and
# chance makes them so rare less often than this.
ABSENT = 6.0
CHANCE = 1e-5
# Rank correlation of silence and change at which what is sent depends on the value.
DRIVEN_BY_VALUE = -0.1
# Tenth percentile over median of how far samples lie off the line between their neighbours: 0.19
# of a normal distribution; a historian leaves out what lies near that line.
OFF_THE_LINE = 0.3
# A running total may be reset or roll over so often; below, it rises all the time.
FALLS_SHARE = 0.005
FEWEST_RISES = 20
# Differences of counts: 4/6 in theory, 1/2 for white noise.
OVER_DIFFERENCED = -0.55
# Twice the relative difference of neighbouring intervals: 1 at random, 0 for a clock.
EVENLY_SPACED = 0.7
FEWEST_PULSES = 20
# Shorter means than these cost no accuracy, and tell themselves apart from nothing.
SHORTEST_MEAN_S = 4.0
FEWEST_MEANS = 150
SHARE_OFF_THE_STEPS = 0.5


@dataclass(frozen=True, slots=True)
class Look:
    """What a channel looks like.

    Attributes
    ----------
    kind
        "unknown" where nothing can be told.
    period_s
        Typical distance of two samples; None for fewer than two.
    longest_silence_s
        Longest distance of two samples, but for the longest hundredth.
    share_repeated
        Of the samples, those that repeat the one before.
    """

    kind: Kind
    period_s: float | None = None
    longest_silence_s: float | None = None
    share_repeated: float = 0.0


def look_of(raw: RawChannel, *, is_flow: bool = False, resolution: float = 0.0) -> Look:
    """Tell the sampling of a channel from the head of its log.

    Parameters
    ----------
    raw
        Samples as read.
    is_flow
        Whether it may hold counts of a volume.
    resolution
        Stated step of the sensor, in the unit of the samples; 0: none stated.

    Examples
    --------
    >>> time_us = np.arange(200) * 1_000_000
    >>> value = np.cumsum(np.resize([1.0, 2.0, 0.0], 200))
    >>> raw = RawChannel(time_us, value, np.zeros(200, dtype=np.bool_), 0)
    >>> look_of(raw, is_flow=True).kind
    'cumulative'
    """
    time_s, value = _head(raw)
    if value.size < FEWEST or not np.ptp(value):
        return Look("unknown", _typical(time_s))
    steps, changes = np.diff(time_s), np.diff(value)
    kind: Kind
    if is_flow and _rises(value, changes):
        kind = "cumulative"
    elif is_flow and _counts(value, changes):
        kind = "pulses"
    elif _is_irregular(steps):
        kind = _irregular(steps, changes)
    elif _is_mean(steps, value, resolution):
        kind = "mean"
    else:
        kind = "periodic"
    return Look(
        kind,
        _typical(time_s),
        float(np.quantile(steps, 0.99, method="higher")),
        float(np.mean(changes == 0)),
    )


def _head(raw: RawChannel) -> tuple[Values, Values]:
    """Times [s] and values of the first samples, in order of time, each time once."""
    rows = np.flatnonzero(~raw.missing & (np.abs(raw.value) < LARGEST))[:HEAD]
    time_us, first = np.unique(raw.time_us[rows], return_index=True)
    time_s = (time_us - time_us[:1]) / 1e6
    return time_s, raw.value[rows][first]


def _typical(time_s: Values) -> float | None:
    return float(np.median(np.diff(time_s))) if time_s.size > 1 else None


def _silent(steps: Values) -> NDArray[np.bool_]:
    silent: NDArray[np.bool_] = steps > SILENCE_STEPS * np.quantile(steps, 0.1)
    return silent


def _is_irregular(steps: Values) -> bool:
    silent = _silent(steps)
    in_silence = steps[silent].sum() / steps.sum()
    return bool(silent.mean() >= SILENT_STEPS_SHARE and in_silence >= SILENT_TIME_SHARE)


def _irregular(steps: Values, changes: Values) -> Kind:
    sizes = np.abs(changes)
    if _small_ones_absent(sizes) or _small_ones_absent(sizes[_silent(steps)]):
        return "on_change"
    if float(spearmanr(steps, sizes).statistic) < DRIVEN_BY_VALUE:
        never_repeats = float(np.mean(sizes == 0)) < FALLS_SHARE
        return "on_change" if never_repeats and _step(changes) else "compressed"
    return "compressed" if _bends_everywhere(steps, changes) else "irregular"


def _bends_everywhere(steps: Values, changes: Values) -> bool:
    """Whether hardly a sample lies near the line between its neighbours."""
    slopes = changes / steps
    off = np.abs(np.diff(slopes)) * steps[1:] * steps[:-1] / (steps[1:] + steps[:-1])
    median = float(np.median(off))
    return bool(median > 0 and np.quantile(off, 0.1) > OFF_THE_LINE * median)


def _small_ones_absent(sizes: Values) -> bool:
    """Whether changes next to zero are absent, though slightly larger ones are not.

    Of a density that falls from zero, [0, m/2) holds at least half of what [m/2, 3m/2) holds.
    """
    if not sizes.size:
        return False
    edge = float(np.quantile(sizes, 0.03))
    below = int(np.sum(sizes < 0.5 * edge))
    around = int(np.sum((sizes >= 0.5 * edge) & (sizes < 1.5 * edge)))
    by_chance = float(binom.cdf(below, below + around, 1 / 3))
    return edge > 0 and ABSENT * below < around and by_chance < CHANCE


def _step(changes: Values) -> float:
    """The step in which values come; 0 where they do not."""
    sizes = np.abs(changes[changes != 0])
    if not sizes.size:
        return 0.0
    smallest = float(np.quantile(sizes, 0.01, method="lower"))
    multiples = sizes / smallest
    # Beyond, a conversion of units has blurred what is a whole number of steps.
    near = multiples[multiples < 1e4]
    off = np.abs(near - np.round(near))
    return smallest if float(np.mean(off < 0.02)) > 0.98 else 0.0


def _rises(value: Values, changes: Values) -> bool:
    """Whether values only rise, resets and roll-overs apart."""
    falls = changes < 0
    rises = int(np.sum(changes > 0))
    if rises < FEWEST_RISES or float(np.mean(falls)) > FALLS_SHARE:
        return False
    # A reading that warms up falls now and then by its step; a total falls to its begin.
    low, high = float(value.min()), float(value.max())
    return bool(np.all(-changes[falls] > 0.3 * (high - low)))


def _counts(value: Values, changes: Values) -> bool:
    """Whether values are counts since the sample before.

    What a count has too much its neighbour has too little: with rounding errors e of a running
    total, a count's error is a difference of two of them, and the differences of counts have the
    correlation -4/6. Errors of readings are their own, and it is -1/2 at most.
    """
    step = _step(changes)
    multiples = value / step if step else value
    whole = np.abs(multiples - np.round(multiples)) < 0.02
    if not step or float(value.min()) < 0 or not whole.all():
        return False
    if float(np.ptp(multiples)) < 1.5:
        return _evenly_spaced(multiples > float(multiples.min()) + 0.5)
    threshold = min(OVER_DIFFERENCED, -0.5 - 3.0 / float(np.sqrt(changes.size)))
    return _correlation(changes, 1) < threshold


def _evenly_spaced(higher: NDArray[np.bool_]) -> bool:
    """Whether the rarer of two values comes as regularly as a steady flow fills a volume."""
    rarer = higher if float(higher.mean()) < 0.5 else ~higher
    intervals = np.diff(np.flatnonzero(rarer))
    if intervals.size < FEWEST_PULSES:
        return False
    unevenness = 2 * np.abs(np.diff(intervals)) / (intervals[1:] + intervals[:-1])
    return bool(unevenness.mean() < EVENLY_SPACED)


def _is_mean(steps: Values, value: Values, resolution: float) -> bool:
    if float(np.median(steps)) < SHORTEST_MEAN_S:
        return False
    if resolution > 0:
        multiples = value / resolution
        off = np.abs(multiples - np.round(multiples)) > 0.1
        if float(np.mean(off)) > SHARE_OFF_THE_STEPS:
            return True
    if value.size < FEWEST_MEANS:
        return False
    changes = np.diff(_without_spikes(value))
    error = 3.0 / float(np.sqrt(changes.size))
    first, second = _correlation(changes, 1), _correlation(changes, 2)
    return error < first < 0.25 + error and abs(second) < 0.25 * first + error


def _without_spikes(value: Values) -> Values:
    """Values without those that lie far off both neighbours on the same side."""
    before, after = np.diff(value)[:-1], np.diff(value)[1:]
    far = 10.0 * float(np.quantile(np.abs(np.diff(value)), 0.9))
    spikes = (before * after < 0) & (np.minimum(np.abs(before), np.abs(after)) > far)
    kept = np.ones(value.size, dtype=np.bool_)
    kept[1:-1] = ~spikes
    return value[kept]


def _correlation(changes: Values, lag: int) -> float:
    centred = changes - changes.mean()
    power = float(np.mean(centred**2))
    return float(np.mean(centred[lag:] * centred[:-lag])) / power if power else 0.0
