"""Blocks from the night's start, the split into parts, and the merge for storage."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage.estimation.sample_blocks import (
    GUARD,
    TRAINING,
    VALIDATION,
    Block,
    ChosenPeriods,
    Windows,
    merge_neighbours,
    split_into_blocks,
    within,
)
from pipeline.config import ConfigError
from pipeline.night.fit_night import NightOutcome
from pipeline.schema.fits import INSUFFICIENT_DATA
from tests.pipeline.night.noise_free import configured_flow, fit, refused_of
from tests.pipeline.simulated import load_motor, motor_toml, operate

SECOND = 1_000_000
MINUTE = 60 * SECOND
START = 1_767_333_600 * SECOND


def minutes(first: int, end: int, step_s: int = 1) -> NDArray[np.int64]:
    """Times from one minute of the night to another."""
    return START + np.arange(first * 60, end * 60, step_s, dtype=np.int64) * SECOND


def parts(blocks: tuple[Block, ...]) -> str:
    """First letters of the parts, in order of time."""
    return "".join(block.part[0] for block in blocks)


def runs(text: str) -> list[tuple[str, int]]:
    return [(letter, len(list(group))) for letter, group in itertools.groupby(text)]


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
        for one, other in itertools.pairwise(blocks):
            assert one.end_us <= other.start_us
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


def test_four_fifths_train_one_guards_the_rest_validates() -> None:
    blocks = split_into_blocks(minutes(0, 100), START, Windows())
    assert parts(blocks) == "t" * 40 + "g" + "v" * 9
    # Nothing was logged for the length of a guard block: no samples need to be lost.
    time = np.concatenate([minutes(0, 80), minutes(82, 102)])
    assert parts(split_into_blocks(time, START, Windows())) == "t" * 40 + "v" * 10


def interleaved(n_minutes: int, guard: int = 1) -> tuple[Block, ...]:
    settings = Windows(split="interleaved", guard_blocks=guard)
    return split_into_blocks(minutes(0, n_minutes, 10), START, settings)


def test_seven_train_three_validate_a_guard_at_each_border() -> None:
    assert parts(interleaved(96)) == "tttttttgvvvg" * 4


@given(st.integers(60, 1500), st.integers(1, 5))
def test_training_and_validation_never_touch(n_minutes: int, guard: int) -> None:
    letters = runs(parts(interleaved(n_minutes, guard)))
    for (one, _), (other, _) in itertools.pairwise(letters):
        assert "g" in (one, other)
    assert all(n == guard for letter, n in letters[:-1] if letter == "g")


# Periods set by hand

BY_HAND = ChosenPeriods(
    training=((START + 10 * MINUTE, START + 31 * MINUTE),),
    validation=((START + 31 * MINUTE, START + 50 * MINUTE),),
)


def test_periods_set_chosen_periods_decide_alone() -> None:
    time = minutes(0, 60)
    kept = time[within(time, BY_HAND.training + BY_HAND.validation)]
    assert (kept[0], kept[-1]) == (START + 10 * MINUTE, START + 50 * MINUTE - SECOND)
    blocks = split_into_blocks(kept, START, Windows(), BY_HAND)
    # The block from 30 to 32 min holds samples of both.
    assert runs(parts(blocks)) == [("t", 10), ("g", 1), ("v", 9)]


def night_with(folder: Path, more: str) -> NightOutcome:
    spec = load_motor(folder, motor_toml("M1", more=more))
    operation = operate(minutes=60.0)
    return fit(spec, operation, operation.channels(configured_flow(spec, operation)))


def test_a_night_is_fitted_on_the_periods_in_the_motor_s_file(tmp_path: Path) -> None:
    outcome = night_with(
        tmp_path,
        "[periods]\ntraining = [[2026-03-01T22:10:00Z, 2026-03-01T23:40:00+01:00]]\n"
        "validation = [[2026-03-01T22:42:00Z, 2026-03-01T22:50:00Z]]\n",
    )
    row = outcome.rows["nights"][0] | outcome.rows["fits"][0]
    assert (row["status"], row["n_training"], row["n_validation"]) == ("ok", 1800, 480)
    assert refused_of(outcome)["time_base", "outside_periods"] == 3600 - 1800 - 480


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (
            "[periods]\ntraining = [[2026-03-02T05:00:00Z, 2026-03-02T05:30:00Z]]\n",
            "no part of the night is good enough to fit (outside periods 100 %",
        ),
        (
            "[periods]\nvalidation = [[2026-03-01T22:00:00Z, 2026-03-01T23:00:00Z]]\n",
            "0.0 minutes of kept samples for training",
        ),
    ],
)
def test_a_night_without_a_window_says_why(tmp_path: Path, more: str, reason: str) -> None:
    outcome = night_with(tmp_path, more)
    assert outcome.status == INSUFFICIENT_DATA
    assert (outcome.reason or "").startswith(reason)


@pytest.mark.parametrize(
    "period",
    [
        "training = [[2026-03-01T22:00:00Z, 2026-03-01T21:00:00Z]]",
        "training = [[2026-03-01T22:00:00, 2026-03-01T23:00:00]]",
        "training = [[2026-03-01T22:00:00Z, 2026-03-01T23:00:00Z]]\n"
        "validation = [[2026-03-01T22:59:00Z, 2026-03-01T23:30:00Z]]",
    ],
)
def test_periods_that_make_no_sense_are_faults(tmp_path: Path, period: str) -> None:
    with pytest.raises(ConfigError, match="periods"):
        load_motor(tmp_path, motor_toml("M1", more=f"[periods]\n{period}\n"))
