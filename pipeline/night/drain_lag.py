"""The drain flow's lag behind what drives it: estimated in each night, decided by the first ones.

A drain line that is not full, and a meter that averages, delay the flow. Where the first nights of
a motor agree on a lag that explains more of the flow, all its nights are paired so.
"""

from __future__ import annotations

import numpy as np

from leakage.estimation.transport_lag import transport_lag
from pipeline.night.statistics import NightStatistics
from pipeline.schema.fits import LAG_COLUMNS


def lag_columns(statistics: NightStatistics) -> dict[str, float | None]:
    """Return columns of `fits` on the lag of a night; null where it has none.

    The flow follows the model's own columns, and of machines that the model lacks something of,
    speed and the root of the pressure.
    """
    samples = statistics.samples
    drivers = np.column_stack(
        [
            statistics.unsmoothed[:, :-1],
            np.abs(samples.speed_rpm),
            np.sqrt(np.abs(samples.pressure_difference_bar)),
        ]
    )
    lag = transport_lag(
        samples.leakage_l_per_min, drivers, samples.index, samples.period_us / 1e6, samples.delay_s
    )
    found = (None, None) if lag is None else (lag.seconds, 100.0 * lag.gain)
    return dict(zip(LAG_COLUMNS, found, strict=True))
