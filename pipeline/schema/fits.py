"""Outcomes of a motor's night, verdicts on its model, and what nights say of the drain flow."""

from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any, Literal

OK, STOOD_STILL, NO_NEW_DATA = "ok", "stood_still", "no_new_data"
INSUFFICIENT_DATA, FAILED = "insufficient_data", "failed"
# Outcomes of nights of which a log could be read.
WITH_SAMPLES = (OK, STOOD_STILL, INSUFFICIENT_DATA)

# Lack of fit up to which a model is supported, and up to which it is doubtful (model.md, 7b).
SUPPORTED, DOUBTFUL = 0.02, 0.05
ModelVerdict = Literal["supported", "doubtful", "disproved"]


def model_verdict(lack_of_fit: float) -> ModelVerdict:
    """Return verdict on a model by its lack of fit."""
    if lack_of_fit <= SUPPORTED:
        return "supported"
    return "doubtful" if lack_of_fit <= DOUBTFUL else "disproved"


LAG_COLUMNS = ("drain_lag_s", "drain_lag_gain_percent")
# Nights that decide on the drain flow's delay, how close their lags are to each other, and what
# they explain: steady motors scatter over the whole range (model.md, 7c.7).
DECIDING_NIGHTS, AGREEING_S, LEAST_GAIN_PERCENT = 8, 0.5, 5.0


def agreed_lag(fits: Iterable[Mapping[str, Any]]) -> tuple[float, float] | None:
    """Return the lag [s] that nights agree on and its gain [%], medians; None: they do not.

    `fits` are the deciding nights' rows of `fits`.
    """
    rows = list(fits)
    lags = [row["drain_lag_s"] for row in rows]
    if not rows or None in lags:
        return None
    lag, gain = median(lags), median(row["drain_lag_gain_percent"] for row in rows)
    agree = max(abs(other - lag) for other in lags) <= AGREEING_S
    return (round(lag, 2), gain) if agree and lag > 0.0 and gain >= LEAST_GAIN_PERCENT else None
