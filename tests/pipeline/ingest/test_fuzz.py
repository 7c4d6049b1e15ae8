"""Damaged logs end in a coded error, in data that is right, or in values that nothing could tell
from right ones."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.config.channels import Channels
from pipeline.config.logs import Logs
from pipeline.ingest import RawLog, read_log

from .fuzzing.campaign import FULL, SHORT, Counts, Extent, fuzzed, mutations_of
from .fuzzing.judging import Outcome, judged
from .fuzzing.mutations import Edit, Mutation, truncations
from .fuzzing.process import PATIENCE_S, Reader
from .fuzzing.seeds import LARGEST, Seed, seed_named, seeds

NOTHING = Mutation(())
every_seed = pytest.mark.parametrize("seed", seeds(), ids=lambda seed: seed.name)


@pytest.fixture(scope="module")
def reader() -> Iterator[Reader]:
    """A process that reads, the same one for all seeds as long as it lives."""
    with Reader() as one:
        yield one


@every_seed
@pytest.mark.parametrize(
    "extent", [SHORT, pytest.param(FULL, marks=pytest.mark.full)], ids=["short", "full"]
)
def test_a_damaged_log_ends_as_it_may(seed: Seed, extent: Extent, reader: Reader) -> None:
    counts = fuzzed(reader, seed, mutations_of(seed, extent))
    assert counts.faults == []
    if seed.checked == ((0, 2**62),) and not seed.source.logs.salvage:
        assert set(counts.outcomes) <= {Outcome.REFUSED, Outcome.RIGHT}
    # The log as it is among the first, the empty file among the second.
    assert counts.outcomes[Outcome.RIGHT] > 0
    assert counts.outcomes[Outcome.REFUSED] > 0


def test_seeds_are_small_and_cover_all_formats_with_and_without_checksums() -> None:
    found = seeds()
    assert len({seed.name for seed in found}) == len(found)
    assert all(len(seed.data) <= LARGEST for seed in found)
    kinds = {(seed.reader, bool(seed.checked)) for seed in found}
    assert kinds == {(name, sign) for name in ("csv", "parquet", "mcap") for sign in (True, False)}


def test_mutations_are_the_same_every_time_and_do_change_something() -> None:
    for seed in seeds()[::7]:
        first, second = (mutations_of(seed, SHORT) for _ in range(2))
        assert first == second
        assert len(list(truncations(seed.data))) == -(-len(seed.data) // 64)
        changed = sum(mutation.applied(seed.data) != seed.data for mutation in first)
        assert changed > 0.9 * len(first)


# What the rest relies on: no fault of a reader goes unnoticed. One with faults, each where the log
# has a word for it behind its end.


def faulty(path: Path, logs: Logs, channels: Channels) -> RawLog:
    word = path.read_bytes().rpartition(b"!")[2]
    path.write_bytes(path.read_bytes().partition(b"!")[0])
    log = read_log(path, logs, channels)
    match word:
        case b"crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        case b"hang":
            signal.pause()
        case b"raise":
            raise ZeroDivisionError
        case b"run out":
            np.ones(2**50, np.uint8)
        case b"eat":
            np.ones(2**27, np.uint8)
        case b"err":
            return in_error(log)
    return log


def in_error(log: RawLog) -> RawLog:
    """With another last digit of one value."""
    channel = log.channels["leakage_flow"]
    value = channel.value.copy()
    value[3] = np.nextafter(value[3], np.inf)
    return replace(log, channels={**log.channels, "leakage_flow": replace(channel, value=value)})


def with_word(seed: Seed, word: str) -> Mutation:
    """The valid file with a word behind its end."""
    return Mutation((Edit(len(seed.data), 0, f"!{word}".encode()),))


@pytest.mark.full
def test_no_fault_goes_unnoticed_and_the_next_mutation_is_read_all_the_same() -> None:
    seed = seed_named("csv")
    words = ["", "crash", "raise", "run out", "err", ""]
    with Reader(faulty, memory_bytes=2**26) as reader:
        verdicts = list(reader.verdicts(seed, [with_word(seed, word) for word in words]))
        reader.patience_s = 1.0
        (hung,) = reader.verdicts(seed, [with_word(seed, "hang")])
        reader.patience_s = PATIENCE_S
        right, eaten = reader.verdicts(seed, [with_word(seed, ""), with_word(seed, "eat")])
    assert [(verdict.outcome, verdict.detail[:28]) for verdict in verdicts] == [
        (Outcome.RIGHT, ""),
        (Outcome.CRASHED, "the process ended with SIGSE"),
        (Outcome.UNCODED, "ZeroDivisionError()"),
        (Outcome.MEMORY, "MemoryError((112589990684262"),
        (Outcome.UNDETECTABLE, ""),
        (Outcome.RIGHT, ""),
    ]
    assert (hung.outcome, hung.detail) == (Outcome.HUNG, "no word in 1 s")
    assert right.outcome is Outcome.RIGHT
    assert eaten.outcome is Outcome.MEMORY
    assert "bytes after" in eaten.detail


def test_a_wrong_value_is_a_fault_only_where_a_checksum_would_have_told(tmp_path: Path) -> None:
    parquet = replace(seed_named("parquet-checksums-zstd"), name="changed")
    start, stop = parquet.checked[0]
    whole = in_error(read(parquet, tmp_path))
    for at, outcome in ((start, Outcome.WRONG), (stop, Outcome.UNDETECTABLE)):
        same = Mutation((Edit(at, 1, parquet.data[at : at + 1]),))
        verdict = judged(parquet, whole, tmp_path, same)
        assert verdict.outcome is outcome
    packed = seed_named("csv-gz")
    whole = in_error(read(packed, tmp_path))
    counts = Counts()
    counts.add(packed, NOTHING, judged(packed, whole, tmp_path, NOTHING))
    assert counts.faults == [f"csv-gz: wrong under a checksum: : {NOTHING}"]


def test_a_checksum_that_the_damage_has_blanked_covers_nothing(tmp_path: Path) -> None:
    seed = seed_named("mcap-json-zstd")
    whole = in_error(read(seed, tmp_path))
    chunk = next(at for at in range(8, len(seed.data)) if seed.data[at] == 6)
    blank = Mutation((Edit(chunk + 9 + 24, 4, bytes(4)),))
    assert judged(seed, whole, tmp_path, NOTHING).outcome is Outcome.WRONG
    assert judged(seed, whole, tmp_path, blank).outcome is Outcome.UNDETECTABLE


def read(seed: Seed, folder: Path) -> RawLog:
    path = folder / seed.file_name
    path.write_bytes(seed.data)
    return read_log(path, *seed.source)


@pytest.mark.parametrize("name", [seed.name for seed in seeds() if "checksums" in seed.name])
def test_a_changed_byte_in_a_page_with_a_checksum_is_always_told(name: str, reader: Reader) -> None:
    seed = seed_named(name)
    inside = [at for start, stop in seed.checked for at in range(start, stop)][::18]
    flips = [Mutation((Edit(at, 1, bytes([seed.data[at] ^ 16])),)) for at in inside]
    assert fuzzed(reader, seed, flips).codes == {"log_damaged": len(flips)}
