"""The model itself, night by night: its misfit over the last nights that tell it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from leakage.model_verdict import (
    NIGHTS_TOGETHER,
    Misfit,
    StructuredMisfit,
    model_verdict,
    structured_misfit,
    verdict_in_words,
)
from pipeline.trends.standing import Standing

# Nights that are looked back for the first one that the model did not describe.
LONGEST_LOOK = 30


def misfit_at(standing: Standing, place: int) -> StructuredMisfit | None:
    """Misfit of the last ten nights that tell it, of the era of a night; None without one."""
    known = _known(standing, place)[-NIGHTS_TOGETHER:]
    rows = standing.history.records["misfit"][known]
    return structured_misfit([Misfit.of(row) for row in rows]) if len(rows) else None


def misfit_words(standing: Standing, place: int, found: StructuredMisfit) -> str | None:
    """A model that is disproved, in words, with the night since when; None of another one."""
    if model_verdict(found) != "disproved":
        return None
    night = _since(standing, place)
    if night is None:
        told = "the model does not describe this motor"
    else:
        told = f"the model no longer describes this motor since about {night}"
    return f"{told}: {verdict_in_words(found, standing.history.spec.low_side)}"


def _known(standing: Standing, place: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Places up to a night, of its era, whose blocks tell of the model."""
    first = standing.era(place).segment.first
    rows = standing.history.records[first : place + 1]
    told = np.isfinite(rows["misfit"]).all(axis=1) & (rows["model"] == rows["model"][-1])
    places: np.ndarray[tuple[int], np.dtype[np.intp]] = first + np.flatnonzero(told)
    return places


def _since(standing: Standing, place: int) -> object | None:
    """First night of those without a break that disprove the model; None where none did not."""
    last = None
    for one in _backwards(standing, place):
        found = misfit_at(standing, one)
        if found is not None and model_verdict(found) in ("supported", "doubtful"):
            return None if last is None else standing.history.nights[last]
        last = one
    return None


def _backwards(standing: Standing, place: int) -> Iterator[int]:
    yield from (int(one) for one in _known(standing, place)[-LONGEST_LOOK:][::-1])
