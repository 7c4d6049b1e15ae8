"""Fuzzing of one seed, and the counts of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from tests.pipeline.ingest.fuzzing.judging import Outcome, Verdict
from tests.pipeline.ingest.fuzzing.mutations import Mutation, flips, made_up, truncations
from tests.pipeline.ingest.fuzzing.process import Reader
from tests.pipeline.ingest.fuzzing.seeds import Seed


@dataclass(frozen=True, slots=True)
class Extent:
    """Amount of damage done to a seed, besides cuts at every 64th byte."""

    flipped: int | None  # number of bytes of which a bit is flipped; None: all
    made_up: int  # number of mutations by Hypothesis


SHORT = Extent(flipped=25, made_up=25)
FULL = Extent(flipped=None, made_up=1000)


@dataclass(slots=True)
class Counts:
    """Results of mutations."""

    # outcomes, codes: number of mutations by outcome, and of coded errors by code.
    outcomes: Counter[Outcome] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    # Seed, mutation and verdict of each fault, in words.
    faults: list[str] = field(default_factory=list)
    longest_s: float = 0.0  # processor time of the slowest read
    peak_bytes: int = 0  # peak memory of a process that read them

    def add(self, seed: Seed, mutation: Mutation, verdict: Verdict) -> None:
        """Count what came of a mutation."""
        self.outcomes[verdict.outcome] += 1
        self.longest_s = max(self.longest_s, verdict.cpu_s)
        if verdict.outcome is Outcome.REFUSED:
            self.codes[verdict.detail] += 1
        if verdict.outcome.is_fault:
            self.faults.append(f"{seed.name}: {verdict.outcome}: {verdict.detail}: {mutation}")

    def merge(self, other: Counts) -> None:
        """Add other counts."""
        self.outcomes.update(other.outcomes)
        self.codes.update(other.codes)
        self.faults += other.faults
        self.longest_s = max(self.longest_s, other.longest_s)
        self.peak_bytes = max(self.peak_bytes, other.peak_bytes)


def mutations_of(seed: Seed, extent: Extent) -> list[Mutation]:
    """None at all first, then the same ones every time."""
    return [
        Mutation(()),
        *truncations(seed.data),
        *flips(seed.data, extent.flipped, seed.name),
        *made_up(seed.data, extent.made_up, seed.reader, seed.name),
    ]


def fuzzed(reader: Reader, seed: Seed, mutations: Iterable[Mutation]) -> Counts:
    """Counts of what comes of mutations of a seed."""
    counts, chosen = Counts(), list(mutations)
    for mutation, verdict in zip(chosen, reader.verdicts(seed, chosen), strict=True):
        counts.add(seed, mutation, verdict)
    counts.peak_bytes = reader.peak_bytes
    return counts
