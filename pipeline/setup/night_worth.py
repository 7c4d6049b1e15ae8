"""Operation in a log, and whether it is enough for a night's fit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.arrays import SECOND_US
from pipeline.config import MotorSpec
from pipeline.ingest import RawChannel

# Inputs of the model with their unit in words; the pressure is the difference, or the high side.
_INPUTS = {
    "pressure_difference": "bar",
    "high_port_pressure": "bar",
    "oil_temperature": "°C",
    "speed": "rpm",
}


def night_worth(spec: MotorSpec, channels: Mapping[str, RawChannel], nights: int) -> str:
    """Running minutes a night and the conditions in them, in words.

    A sample counts for the typical distance of two, so that gaps count for nothing. Conditions are
    the 5th to 95th percentiles of all that was logged.
    """
    speed = channels["speed"]
    is_running = np.abs(speed.value) > spec.settings.cleaning.standstill_rpm
    steps = np.diff(np.unique(speed.time_us[~speed.missing]))
    step_us = float(np.median(steps)) if steps.size else 0.0
    minutes = float(is_running.sum()) * step_us / SECOND_US / 60.0 / max(nights, 1)
    windows = spec.settings.windows
    needed = windows.minimum_training_minutes / windows.training_share
    conditions = [
        f"{low:.3g} to {high:.3g} {unit}"
        for name, unit in _INPUTS.items()
        if name in channels and (numbers := _numbers(channels[name])).size
        for low, high in [np.percentile(numbers, (5, 95), method="nearest")]
    ]
    ran = f"the motor ran {minutes:.3g} minutes a night, at {', '.join(conditions)}"
    if minutes >= needed:
        return f"{ran}: enough for a fit every night ({needed:.3g} minutes)"
    return f"{ran}: too little for a fit, which needs {needed:.3g} minutes"


def _numbers(raw: RawChannel) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    numbers: np.ndarray[tuple[int], np.dtype[np.float64]] = raw.value[np.isfinite(raw.value)]
    return numbers
