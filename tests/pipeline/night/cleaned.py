"""Channels to be cleaned, and the rules by which tests clean them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest import RawChannel
from pipeline.night.channel_rules import ChannelRules
from tests.pipeline.night.channels import Floats

RULES = ChannelRules(
    valid_range=(0.0, 100.0),
    sensor_maximum=None,
    resolution=0.1,
    hampel_window=11,
    hampel_threshold=5.0,
    frozen_after_s=60.0,
    gap_sample_periods=5.0,
    longest_gap_s=None,
)


def raw(time_us: NDArray[np.int64], value: Floats, missing: object = None) -> RawChannel:
    """Channel as a reader leaves it: arrays that cannot be written to."""
    blank = np.zeros(len(value), np.bool_) if missing is None else np.asarray(missing, np.bool_)
    arrays = time_us.copy(), np.where(blank, np.nan, value), blank
    for array in arrays:
        array.flags.writeable = False
    return RawChannel(*arrays, 0)
