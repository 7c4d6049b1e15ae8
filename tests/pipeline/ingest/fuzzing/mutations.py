"""Damage done to a file: by truncation, by flipped bits, and whatever Hypothesis makes up."""

from __future__ import annotations

import random
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import hypothesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

STEP = 64
"""Bytes between the places where a file is cut."""

_TOKENS: dict[str, tuple[bytes, ...]] = {
    "csv": (
        *(b"\n", b"\r", b",", b";", b'"', b'"\n', b"\x00", b"\xff", b"\xef\xbb\xbf", b"\xff\xfe"),
        *(b"nan", b"-inf", b"1e999", b"9" * 400, b"time,dp,T,q\n", b"9999-12-31T23:59:59Z"),
        *(b"\x1f\x8b\x08", b"\x28\xb5\x2f\xfd", b"\xe2\x80\xa8"),
    ),
    "parquet": (b"PAR1", b"PARE", b"\x15\x80\x80\x80\x80\x10", b"\x19\xfc", b"time", b"\x1c" * 64),
    "mcap": (
        *(b"\x89MCAP0\r\n", b"zstd", b"lz4", b"{", b"}", b"[" * 200, b'{"value":' * 40, b"null"),
        *(bytes([opcode]) for opcode in range(1, 17)),
    ),
}
_NUMBERS = (0, 1, 2, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1)
_LARGE = (*_NUMBERS, 2**40, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1)


@dataclass(frozen=True, slots=True)
class Edit:
    """Bytes that stand in the place of others."""

    at: int
    removed: int
    inserted: bytes


@dataclass(frozen=True, slots=True)
class Mutation:
    """Edits of a file, in ascending order, none over another; its text tells how to repeat it."""

    edits: tuple[Edit, ...]

    def applied(self, data: bytes) -> bytes:
        """The damaged file."""
        for edit in reversed(self.edits):
            data = data[: edit.at] + edit.inserted + data[edit.at + edit.removed :]
        return data

    def touches_only(self, ranges: Sequence[tuple[int, int]]) -> bool:
        """True if all changed bytes lie within some ranges of the valid file."""
        return all(
            any(
                start <= edit.at and edit.at + max(edit.removed, 1) <= stop
                for start, stop in ranges
            )
            for edit in self.edits
        )


def truncations(data: bytes) -> Iterator[Mutation]:
    """The file cut at every 64th byte, from none."""
    for at in range(0, len(data), STEP):
        yield Mutation((Edit(at, len(data) - at, b""),))


def flips(data: bytes, count: int | None, name: str) -> Iterator[Mutation]:
    """A bit flipped in each of so many bytes; None: in every byte.

    Parameters
    ----------
    data
        The valid file.
    count
        Number of bytes.
    name
        Of the file; the bits follow from it.
    """
    rng = random.Random(zlib.crc32(name.encode()))  # noqa: S311
    places = range(len(data))
    if count is not None and count < len(data):
        places = sorted(rng.sample(places, count))  # type: ignore[assignment]
    for at in places:
        yield Mutation((Edit(at, 1, bytes([data[at] ^ 1 << rng.randrange(8)])),))


def made_up(data: bytes, count: int, reader: str, name: str) -> list[Mutation]:
    """So many mutations by Hypothesis, the same ones every time.

    Parameters
    ----------
    data, name
        The valid file.
    count
        Number of mutations.
    reader
        Its format.
    """
    found: list[Mutation] = []

    @hypothesis.seed(zlib.crc32(name.encode()))
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(_mutations(data, reader))
    def collect(mutation: Mutation) -> None:
        found.append(mutation)

    collect()
    return found[:count]


def _mutations(data: bytes, reader: str) -> st.SearchStrategy[Mutation]:
    place = st.integers(0, len(data) - 1)
    edits = st.one_of(
        st.builds(_flip, st.just(data), place, st.integers(0, 7)),
        st.builds(_overwrite, place, st.binary(min_size=1, max_size=32)),
        st.builds(_number, place, st.sampled_from(_LARGE), st.sampled_from([1, 2, 4, 8])),
        st.builds(Edit, place, st.integers(1, 200), st.just(b"")),
        st.builds(Edit, place, st.just(0), st.binary(min_size=1, max_size=64)),
        st.builds(Edit, place, st.just(0), st.sampled_from(_TOKENS[reader])),
        st.builds(_overwrite, place, st.sampled_from(_TOKENS[reader])),
        st.builds(
            _copy, st.just(data), place, place, st.integers(1, len(data) // 4), st.booleans()
        ),
    )
    return st.lists(edits, min_size=1, max_size=4).map(_apart).filter(lambda one: bool(one.edits))


def _flip(data: bytes, at: int, bit: int) -> Edit:
    return Edit(at, 1, bytes([data[at] ^ 1 << bit]))


def _overwrite(at: int, inserted: bytes) -> Edit:
    return Edit(at, len(inserted), inserted)


def _number(at: int, number: int, size: int) -> Edit:
    return _overwrite(at, (number % 256**size).to_bytes(size, "little"))


def _copy(data: bytes, source: int, at: int, size: int, over: bool) -> Edit:
    part = data[source : source + size]
    return Edit(at, len(part) if over else 0, part)


def _apart(edits: Sequence[Edit]) -> Mutation:
    """Edits in ascending order, without those that lie over one before."""
    kept: list[Edit] = []
    for edit in sorted(edits, key=lambda one: one.at):
        if not kept or edit.at > kept[-1].at + kept[-1].removed:
            kept.append(edit)
    return Mutation(tuple(kept))
