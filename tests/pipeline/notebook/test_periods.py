"""Training on some nights of a log, and validation on others."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from pipeline.config import MotorSpec
from pipeline.errors import UsageError
from pipeline.notebook import fit_periods
from tests.pipeline.simulated import operate, write_log

FIRST = dt.date(2026, 3, 2)
DAY = dt.timedelta(days=1)
NOISE = 0.02


@pytest.fixture
def config(tmp_path: Path, spec: MotorSpec) -> Path:
    """Three nights of 24 minutes; in the third the motor leaks a tenth more."""
    for at, more in enumerate((1.0, 1.0, 1.1)):
        operation = operate(FIRST + at * DAY, minutes=24.0, seed=at)
        flow = more * operation.flow(spec.motor(FIRST, "none"))
        flow += NOISE * np.random.default_rng(at).standard_normal(len(flow))
        path = tmp_path / "logs" / "M1" / f"{at}.parquet"
        write_log(path, operation.time_us, operation.channels(flow))
    return tmp_path / "configs" / "fleet.toml"


def test_a_motor_is_trained_on_two_nights_and_validated_on_the_third(config: Path) -> None:
    found, prepared = fit_periods(config, "M1", "2026-03-02..2026-03-03", "2026-03-04..2026-03-04")
    here = prepared.frame["time"] < dt.datetime(2026, 3, 3, 6, tzinfo=dt.UTC)
    assert (found.training.n, found.validation.n) == (here.sum(), (~here).sum())
    assert found.training.rmse_l_per_min == pytest.approx(NOISE, rel=0.05)
    mean_flow = prepared.frame["leakage_l_per_min"].filter(~here).mean()
    assert found.validation.mean_error_l_per_min == pytest.approx(mean_flow / 11.0, rel=0.1)


@pytest.mark.parametrize(
    ("nights", "words"),
    [
        ("monday", "write nights as"),
        ("2026-03-01T22:01..2026-03-01T22:02", "write nights as"),
        ("2026-03-03..2026-03-02", "ends before it begins"),
        ("2027-03-02..2027-03-03", "no log of M1 covers 2027-03-02 to 2027-03-03"),
    ],
)
def test_nights_without_samples_or_form_are_refused(config: Path, nights: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        fit_periods(config, "M1", nights)
