"""Damaged logs: how many mutations of small valid ones end in which way, by reader.

Cuts at every 64th byte, a flipped bit in every byte, and mutations by Hypothesis; the same ones
every time. Nothing but the first four ends may occur, which the tests assert.
"""

from __future__ import annotations

import sys

from benchmarks.results_file import Part, write_parts
from tests.pipeline.ingest.fuzzing.campaign import FULL, Counts, fuzzed, mutations_of
from tests.pipeline.ingest.fuzzing.judging import Outcome
from tests.pipeline.ingest.fuzzing.process import MEMORY_BYTES, PATIENCE_S, Reader
from tests.pipeline.ingest.fuzzing.seeds import Seed, seeds

TEXT = f"""\
A log may end in a coded error, in what was written, in a part of it with a note that something is
left out, or, where no checksum covers what was changed, in values that cannot be told from right
ones. Each was read by a process with at most {MEMORY_BYTES // 2**20} MiB for it, and ended after
{PATIENCE_S:g} s without an answer. `time_span`, `sniff` and `read_log` were called on each."""
HEADER = " | ".join(("", "files", "mutations", *Outcome, "slowest [s]", "memory [MiB]"))
NAMES = {"csv": "CSV", "parquet": "Parquet", "mcap": "MCAP"}


def main() -> None:
    """Write `benchmarks/results/fuzz.md`."""
    by_seed: dict[Seed, Counts] = {}
    with Reader() as reader:
        for seed in seeds():
            mutations = mutations_of(seed, FULL)
            by_seed[seed] = fuzzed(reader, seed, mutations)
            for fault in by_seed[seed].faults:
                sys.stderr.write(f"{fault}\n")
    rows = [_row(name, by_seed, reader) for reader, name in NAMES.items()]
    rows.append(_row("all", by_seed, ""))
    codes = _sum(list(by_seed.values())).codes.most_common()
    parts = [
        Part("By reader", "", HEADER, rows),
        Part(
            "By file",
            "Where a checksum covers all of a file, its values are right or it is refused.",
            HEADER,
            [_cells(seed.name, 1, counts) for seed, counts in by_seed.items()],
        ),
        Part("Codes of the errors", "", "code | mutations", [(c, str(n)) for c, n in codes]),
    ]
    write_parts("fuzz", "Fuzzing of the three readers", TEXT, parts)


def _row(name: str, by_seed: dict[Seed, Counts], reader: str) -> list[str]:
    chosen = [counts for seed, counts in by_seed.items() if reader in ("", seed.reader)]
    return _cells(name, len(chosen), _sum(chosen))


def _sum(parts: list[Counts]) -> Counts:
    whole = Counts()
    for part in parts:
        whole.merge(part)
    return whole


def _cells(name: str, files: int, counts: Counts) -> list[str]:
    numbers = [files, counts.outcomes.total(), *(counts.outcomes[one] for one in Outcome)]
    memory = f"{counts.peak_bytes / 2**20:.0f}"
    return [name, *map(str, numbers), f"{counts.longest_s:.2f}", memory]
