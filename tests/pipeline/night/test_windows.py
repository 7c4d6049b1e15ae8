"""Blocks from the night's start, the split into parts, and the merge for storage."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage.estimation.blocks import (
    GUARD,
    TRAINING,
    VALIDATION,
    ChosenPeriods,
    Windows,
    merge_neighbours,
    split_into_blocks,
    within,
)
from tests.pipeline.night.noise_free import configured_flow, fit, refused_of
from tests.pipeline.simulated import load_motor, motor_toml, operate

SECOND = 1_000_000
MINUTE = 60 * SECOND
START = 1_767_333_600 * SECOND


def minutes(*spans: tuple[int, int]) -> NDArray[np.int64]:
    """Times, every ten seconds, from some minutes of the night to others."""
    seconds = [np.arange(first * 60, end * 60, 10, dtype=np.int64) for first, end in spans]
    return START + np.concatenate(seconds) * SECOND


def parts(time: NDArray[np.int64], windows: Windows, *chosen: ChosenPeriods) -> str:
    """First letters of the blocks' parts, in order of time."""
    return "".join(block.part[0] for block in split_into_blocks(time, START, windows, *chosen))


NIGHT_TIMES = st.lists(st.integers(0, 25 * 3600 - 1), min_size=1, max_size=300, unique=True)
SETTINGS = st.builds(
    Windows,
    block_s=st.sampled_from([1.0, 30.0, 120.0, 600.0, 7000.0]),
    maximum_blocks=st.integers(4, 96),
    split=st.sampled_from(["chronological", "interleaved"]),
    training_share=st.floats(0.05, 0.95),
    guard_blocks=st.integers(0, 8),
)


@given(NIGHT_TIMES, SETTINGS)
def test_every_sample_lies_in_exactly_one_block_short_or_stored(
    seconds: list[int], settings: Windows
) -> None:
    time = START + np.array(sorted(seconds), np.int64) * SECOND
    short = split_into_blocks(time, START, settings)
    stored = merge_neighbours(short, settings.maximum_blocks)
    assert len(stored) <= settings.maximum_blocks
    for blocks in (short, stored):
        ends = [0, *(block.end_row for block in blocks)]
        assert [block.first_row for block in blocks] == ends[:-1]
        assert ends[-1] == len(time)
        for block, following in itertools.pairwise(blocks):
            assert block.end_us <= following.start_us
    for block in stored:
        joined = [part for part in short if block.first_row <= part.first_row < block.end_row]
        assert {part.part for part in joined} == {block.part}
        assert (block.start_us, block.end_us) == (joined[0].start_us, joined[-1].end_us)
    length = round(settings.block_s * SECOND)
    for block in short:
        assert block.n > 0
        assert (block.start_us - START) % length == 0
        assert block.end_us - block.start_us == length
        inside = time[block.first_row : block.end_row]
        assert ((inside >= block.start_us) & (inside < block.end_us)).all()
        assert block.part in {TRAINING, VALIDATION, GUARD}


@given(st.integers(60, 1500), st.integers(1, 5))
def test_training_and_validation_never_touch(n_minutes: int, guard: int) -> None:
    letters = parts(minutes((0, n_minutes)), Windows(split="interleaved", guard_blocks=guard))
    runs = [(letter, len(list(group))) for letter, group in itertools.groupby(letters)]
    for (letter, _), (following, _) in itertools.pairwise(runs):
        assert "g" in (letter, following)
    assert all(n == guard for letter, n in runs[:-1] if letter == "g")


BY_HAND = ChosenPeriods(
    training=((START + 10 * MINUTE, START + 31 * MINUTE),),
    validation=((START + 31 * MINUTE, START + 50 * MINUTE),),
)


def test_parts_are_those_of_the_split_or_of_periods_set_by_hand() -> None:
    whole, interleaved = minutes((0, 100)), Windows(split="interleaved")
    assert parts(whole, Windows()) == "t" * 40 + "g" + "v" * 9
    # Nothing was logged for the length of a guard block: no samples need to be lost.
    assert parts(minutes((0, 80), (82, 102)), Windows()) == "t" * 40 + "v" * 10
    assert parts(minutes((0, 96)), interleaved) == "tttttttgvvvg" * 4
    kept = whole[within(whole, BY_HAND.training + BY_HAND.validation)]
    assert (kept[0], kept[-1]) == (START + 10 * MINUTE, START + 50 * MINUTE - 10 * SECOND)
    # The block from 30 to 32 min holds samples of both.
    assert parts(kept, Windows(), BY_HAND) == "t" * 10 + "g" + "v" * 9


def motor_with(periods: str) -> str:
    return motor_toml("M1", more=f"[periods]\n{periods}\n")


@pytest.mark.parametrize(
    ("periods", "reason", "n_training", "n_validation"),
    [
        pytest.param(
            "training = [[2026-03-01T22:10:00Z, 2026-03-01T23:40:00+01:00]]\n"
            "validation = [[2026-03-01T22:42:00Z, 2026-03-01T22:50:00Z]]",
            "", 1800, 480, id="both",
        ),
        pytest.param(
            "training = [[2026-03-02T05:00:00Z, 2026-03-02T05:30:00Z]]",
            "no part of the night is good enough to fit (outside periods 100 %", 0, 0, id="none",
        ),
        pytest.param(
            "validation = [[2026-03-01T22:00:00Z, 2026-03-01T23:00:00Z]]",
            "0.0 minutes of kept samples for training", 0, 3600, id="nothing trains",
        ),
    ],
)  # fmt: skip
def test_a_night_is_fitted_on_the_periods_in_the_motor_s_file(
    tmp_path: Path, periods: str, reason: str, n_training: int, n_validation: int
) -> None:
    spec, operation = load_motor(tmp_path, motor_with(periods)), operate(minutes=60.0)
    outcome = fit(spec, operation, operation.channels(configured_flow(spec, operation)))
    refused = refused_of(outcome)["time_base", "outside_periods"]
    assert refused == 3600 - n_training - n_validation
    assert (outcome.reason or "").startswith(reason)
    assert outcome.status == ("insufficient_data" if reason else "ok")
    if not reason:
        row = outcome.rows["fits"][0]
        assert (row["n_training"], row["n_validation"]) == (n_training, n_validation)
