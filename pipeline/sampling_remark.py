"""Whether a channel's sampling looks as its config says, in words."""

from __future__ import annotations

from pipeline.config import Channel
from pipeline.sampling_look import SHORTEST_MEAN_S, Look

# How far the period of means may be from the one stated, and how often a sample sent on change may
# repeat the one before, as where some are sent after a longest silence.
PERIOD_TOLERANCE = 0.2
REPEATED_SHARE = 0.1


def words(look: Look) -> str:
    """What a channel looks like; empty where nothing can be told.

    Examples
    --------
    >>> words(Look("periodic", 0.2)), words(Look("mean", 10.0))
    ('periodic', 'like means of 10 s')
    """
    period = "" if look.period_s is None else f"{look.period_s:.3g} s"
    long = look.period_s is not None and look.period_s >= SHORTEST_MEAN_S
    return {
        "periodic": f"periodic, or like means of {period}" if long else "periodic",
        "on_change": "sent on change",
        "compressed": "compressed by a historian",
        "irregular": "sent on change, compressed, or lost in part",
        "mean": f"like means of {period}",
        "cumulative": "like a running total",
        "pulses": "like counts since the sample before",
        "unknown": "",
    }[look.kind]


def configured(channel: Channel) -> str:
    """What a channel is configured as."""
    if channel.counts is not None:
        total = channel.counts == "cumulative"
        return "a running total" if total else "counts since the sample before"
    if channel.sampling == "mean":
        return f"means of {channel.mean_of_s:g} s"
    return "periodic" if channel.sampling == "periodic" else "sent on change or compressed"


def remark(channel: Channel, look: Look) -> str:
    """Where a channel does not look as its config says, in words; empty where it does.

    Parameters
    ----------
    channel
        Its config.
    look
        What it looks like.
    """
    if _agrees(channel, look):
        return ""
    advice = _advice(look)
    if channel.counts == "cumulative":
        advice = "it falls again and again"
    return f"configured as {configured(channel)}, looks {words(look)}: {advice}"


def _agrees(channel: Channel, look: Look) -> bool:
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


def _advice(look: Look) -> str:
    """What to write into the config, if it is so."""
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
