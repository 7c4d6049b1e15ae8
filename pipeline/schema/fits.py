"""Outcomes of a motor's night, `status` of the table `nights`, and verdicts on its model."""

from typing import Literal

OK, STOOD_STILL, NO_NEW_DATA = "ok", "stood_still", "no_new_data"
INSUFFICIENT_DATA, FAILED = "insufficient_data", "failed"
# Outcomes of nights of which a log could be read.
WITH_SAMPLES = (OK, STOOD_STILL, INSUFFICIENT_DATA)

# Lack of fit up to which a model is supported, and up to which it is doubtful (model.md, 7b).
SUPPORTED, DOUBTFUL = 0.02, 0.05
ModelVerdict = Literal["supported", "doubtful", "disproved"]


def model_verdict(lack_of_fit: float) -> ModelVerdict:
    """Verdict on a model by its lack of fit."""
    if lack_of_fit <= SUPPORTED:
        return "supported"
    return "doubtful" if lack_of_fit <= DOUBTFUL else "disproved"
