"""The misfit of the model over the nights: ten together, and since when it is too large."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.estimation.model_verdict import Misfit
from pipeline.trends.rows.first_rows import model_row
from pipeline.trends.states.standing import Standing
from pipeline.trends.states.words import day
from tests.pipeline.trends.nights import Nights, motor, night_of, standing

N, CHANGE = 60, 40
SAMPLES, FLOW = 3600.0, 1.4


def statistics(share: float, seed: int) -> list[float]:
    """A night whose temperature column explains so much of the leakage, beside some noise."""
    noise = 0.001 * np.random.default_rng(seed).standard_normal(6)
    gamma = np.array([0.0, share, 0.0, 0.0, 0.0, 0.0]) + noise
    gram = SAMPLES * FLOW**2 * np.eye(6)
    row = Misfit(SAMPLES, SAMPLES * FLOW, gram, gram, gram @ gamma, 1e-6 * gram @ gram)
    return row.numbers().tolist()


def told(shares: NDArray[np.float64]) -> Standing:
    rows = {
        place: {"model_misfit_statistics": statistics(share, place)}
        for place, share in enumerate(shares.tolist())
    }
    return standing(Nights(motor(), N, changes=rows))


@pytest.fixture(scope="module")
def changed() -> Standing:
    return told(np.where(np.arange(N) < CHANGE, 0.0, 0.03))


def test_the_size_is_that_of_ten_nights_together(changed: Standing) -> None:
    row = model_row(changed, N - 1)
    assert row is not None
    assert row["value"] == pytest.approx(3.0, abs=0.2)
    assert row["n_nights"] == 10
    assert row["model_verdict"] == "disproved"


def test_a_model_that_no_longer_describes_the_motor_says_since_when(changed: Standing) -> None:
    before = model_row(changed, CHANGE - 1)
    assert before is not None
    assert (before["model_verdict"], before["state_reason"]) == ("supported", None)
    row = model_row(changed, CHANGE + 12)
    assert row is not None
    words = row["state_reason"]
    assert words.startswith("the model no longer describes this motor since about ")
    assert words.split("about ")[1].split(":")[0] in {
        day(night_of(one)) for one in range(CHANGE, CHANGE + 10)
    }
    assert "temperature: another oil than stated" in words


def test_a_model_that_never_described_the_motor_has_no_date() -> None:
    row = model_row(told(np.full(N, 0.03)), N - 1)
    assert row is not None
    assert row["state_reason"].startswith("the model does not describe this motor: 3.0 % of")


def test_nights_that_tell_nothing_of_the_model_have_no_row() -> None:
    assert model_row(standing(Nights(motor(), N)), N - 1) is None
