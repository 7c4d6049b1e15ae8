"""The look of a channel's sampling, and a remark where its config says something else.

Never certain: the tests go by the spacing of the stamps and by which changes occur and which do
not, whatever the channel's magnitude. Two facts carry them:

- Samples that a clock writes lie evenly; those sent on change, or left by a historian's
  compression, leave silences. Which of the two it was makes no difference to the config.
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

from pipeline.config import Channel
from pipeline.ingest import RawChannel

Values = NDArray[np.float64]

Kind = Literal["periodic", "irregular", "mean", "cumulative", "pulses", "unknown"]

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
# How far the period of means may be from the one stated, and how often a sample sent on change may
# repeat the one before, as where some are sent after a longest silence.
PERIOD_TOLERANCE = 0.2
REPEATED_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Sampling:
    """The look of a channel."""

    kind: Kind  # "unknown" where nothing can be told
    period_s: float | None = None  # typical distance of two samples; None for fewer than two
    longest_silence_s: float | None = None  # but for the longest hundredth
    share_repeated: float = 0.0  # of the samples, those that repeat the one before


def look_of(raw: RawChannel, *, is_flow: bool = False, resolution: float = 0.0) -> Sampling:
    """Tell the sampling of a channel from the head of its log.

    Only a flow can be counts of a volume; `resolution` is the sensor's stated step in the unit of
    the samples, 0 where none is stated.
    """
    time_s, value = _head(raw)
    if value.size < FEWEST or not np.ptp(value):
        return Sampling("unknown", _typical(time_s))
    steps, changes = np.diff(time_s), np.diff(value)
    kind: Kind
    if is_flow and _rises(value, changes):
        kind = "cumulative"
    elif is_flow and _counts(value, changes):
        kind = "pulses"
    elif _is_irregular(steps):
        kind = "irregular"
    elif _is_mean(steps, value, resolution):
        kind = "mean"
    else:
        kind = "periodic"
    return Sampling(
        kind,
        _typical(time_s),
        float(np.quantile(steps, 0.99, method="higher")),
        float(np.mean(changes == 0)),
    )


def words(look: Sampling) -> str:
    """The look in words; empty where nothing can be told.

    Examples
    --------
    >>> words(Sampling("periodic", 0.2)), words(Sampling("mean", 10.0))
    ('periodic', 'like means of 10 s')
    """
    period = "" if look.period_s is None else f"{look.period_s:.3g} s"
    long = look.period_s is not None and look.period_s >= SHORTEST_MEAN_S
    return {
        "periodic": f"periodic, or like means of {period}" if long else "periodic",
        "irregular": "sent on change, compressed, or lost in part",
        "mean": f"like means of {period}",
        "cumulative": "like a running total",
        "pulses": "like counts since the sample before",
        "unknown": "",
    }[look.kind]


def configured(channel: Channel) -> str:
    """A channel's sampling as configured, in words."""
    if channel.counts is not None:
        total = channel.counts == "cumulative"
        return "a running total" if total else "counts since the sample before"
    if channel.sampling == "mean":
        return f"means of {channel.mean_of_s:g} s"
    return "periodic" if channel.sampling == "periodic" else "sent on change or compressed"


def remark(channel: Channel, look: Sampling) -> str:
    """The difference between a channel's look and its config, in words; empty for none."""
    if _agrees(channel, look):
        return ""
    advice = _advice(look)
    if channel.counts == "cumulative":
        advice = "it falls again and again"
    return f"configured as {configured(channel)}, looks {words(look)}: {advice}"


def _agrees(channel: Channel, look: Sampling) -> bool:
    if look.kind == "unknown":
        return True
    if channel.counts is not None:
        # Many counts a sample look like readings, but a total looks like nothing else.
        return (look.kind == "cumulative") == (channel.counts == "cumulative")
    if channel.sampling == "on_change":
        regular = look.kind == "periodic" and look.share_repeated > REPEATED_SHARE
        return not regular and look.kind not in ("cumulative", "pulses")
    if channel.sampling == "mean":
        off = abs((look.period_s or 0.0) / (channel.mean_of_s or 1.0) - 1.0)
        return look.kind in ("mean", "periodic") and off < PERIOD_TOLERANCE
    return look.kind == "periodic"


def _advice(look: Sampling) -> str:
    """The keys to write into the config, if it is so."""
    if look.kind in ("cumulative", "pulses"):
        return f'then counts = "{look.kind}", unit = "count" and volume_per_count_cm3'
    if look.kind == "mean":
        return f'then sampling = "mean" and mean_of_s = {look.period_s:.3g}'
    if look.kind == "periodic":
        return (
            f"a sample every {look.period_s:.3g} s, {100 * look.share_repeated:.0f} % of them as "
            'the one before; then sampling = "periodic"'
        )
    return (
        'then sampling = "on_change" and longest_silence_s; silences here reach '
        f"{look.longest_silence_s:.3g} s"
    )


def _head(raw: RawChannel) -> tuple[Values, Values]:
    """Times [s] and values of the first samples, in order of time, each time once."""
    rows = np.flatnonzero(~raw.missing & (np.abs(raw.value) < LARGEST))[:HEAD]
    time_us, first = np.unique(raw.time_us[rows], return_index=True)
    time_s = (time_us - time_us[:1]) / 1e6
    return time_s, raw.value[rows][first]


def _typical(time_s: Values) -> float | None:
    return float(np.median(np.diff(time_s))) if time_s.size > 1 else None


def _is_irregular(steps: Values) -> bool:
    """Silences are frequent and take up much of the time: a clock did not write these samples."""
    silent = steps > SILENCE_STEPS * np.quantile(steps, 0.1)
    in_silence = steps[silent].sum() / steps.sum()
    return bool(silent.mean() >= SILENT_STEPS_SHARE and in_silence >= SILENT_TIME_SHARE)


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
    """True if values only rise, resets and roll-overs apart."""
    falls = changes < 0
    rises = int(np.sum(changes > 0))
    if rises < FEWEST_RISES or float(np.mean(falls)) > FALLS_SHARE:
        return False
    # A reading that warms up falls now and then by its step; a total falls to its begin.
    low, high = float(value.min()), float(value.max())
    return bool(np.all(-changes[falls] > 0.3 * (high - low)))


def _counts(value: Values, changes: Values) -> bool:
    """True if values are counts since the sample before.

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
    """True if the rarer of two values comes as regularly as a steady flow fills a volume."""
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
