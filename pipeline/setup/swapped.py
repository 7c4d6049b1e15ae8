"""Columns that look swapped: a drain flow that follows nothing, an oil that jumps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pipeline.arrays import SECOND_US, Array
from pipeline.config import MotorSpec
from pipeline.config.channels import COUNTED
from pipeline.ingest import RawChannel
from pipeline.setup.promise import conditions_at, is_valid

# Conditions that vary by less tell nothing: the 5th to 95th percentile beside the median, and [K].
_VARIES, _VARIES_K = 0.3, 4.0
# Ranks of a flow and of what drives it agree at least so far, with noise and dead time.
_FOLLOWS = 0.2
_FEWEST = 200
# Oil in a line warms and cools slower than this, but for a few spikes.
_JUMP_C, _JUMP_S, _JUMPS_SHARE = 2.0, 10.0, 0.02


def swapped(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> Iterator[str]:
    """Notes on channels whose columns may be another's."""
    known = is_valid(spec, "oil_temperature", channels["oil_temperature"])
    steps_s = np.diff(channels["oil_temperature"].time_us[known]) / SECOND_US
    jumps = np.abs(np.diff(channels["oil_temperature"].value[known])) > _JUMP_C
    close = (steps_s > 0.0) & (steps_s <= _JUMP_S)
    if close.sum() >= _FEWEST and float(jumps[close].mean()) > _JUMPS_SHARE:
        yield "oil_temperature jumps as no oil does: are columns swapped?"
    if spec.file.channels[COUNTED].counts is not None:
        return
    flow = channels[COUNTED]
    known = is_valid(spec, COUNTED, flow)
    at = flow.time_us[known]
    pressure, speed, degrees = conditions_at(spec, channels, at)
    if pressure is None or speed is None or degrees is None:
        return
    ran = speed > spec.settings.cleaning.standstill_rpm
    if ran.sum() < _FEWEST:
        return
    p, t, q = pressure[ran], degrees[ran], flow.value[known][ran]
    drives = [
        one for one, width in ((p, _VARIES * np.median(p)), (t, _VARIES_K)) if _range(one) > width
    ]
    if drives and np.ptp(q) > 0 and all(_agree(one, q) < _FOLLOWS for one in drives):
        yield (
            "the drain flow follows neither pressure nor the oil's viscosity: are columns swapped?"
        )


def _range(values: Array) -> float:
    low, high = np.percentile(values, (5, 95))
    return float(high - low)


def _agree(one: Array, other: Array) -> float:
    """Agreement of the ranks; hotter oil is thinner, so that either rises with the flow."""
    first, second = (np.argsort(np.argsort(values)) for values in (one, other))
    return float(np.corrcoef(first, second)[0, 1])
