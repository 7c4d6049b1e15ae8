"""The text of a CSV: unpacked, decoded and cut into pieces of whole lines.

Nothing here is larger than a piece, whatever the file unfolds to.
"""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa

from pipeline.errors import LogError

LARGEST_TEXT = 4 * 2**30
"""Bytes of text in a file, packed or not; readings of more would not fit into memory."""

LARGEST_RATIO = 400
"""Bytes of text to a byte of a packed file. A motor that stands still all night has below 100."""

PIECE = 2**21
"""Bytes read at a time: few enough to stay in the processor's cache."""

LONGEST_LINE = 2**25
"""Bytes of a line; a file with longer ones is no table."""

_RATIO_FROM = 2**26
_LOOK = 2**16
_PACKED = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd"}
_OTHER_PACKERS = {
    b"PK\x03\x04": "zip",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"7z\xbc\xaf": "7z",
    b"Rar!": "rar",
}


@dataclass(frozen=True, slots=True)
class Lines:
    """A piece of a text: UTF-8, whole lines only."""

    data: bytes  # without a byte order mark at the file's begin
    torn: int = 0  # bytes behind the file's last line end; 0 in all pieces but the last


def is_utf8(encoding: str) -> bool:
    """True if text in an encoding is UTF-8 as it stands."""
    return codecs.lookup(encoding).name in {"utf-8", "utf-8-sig", "ascii"}


def is_packed(path: Path) -> bool:
    """True if a file is compressed in a way that can be unpacked here, by its first bytes."""
    return _packing(path) is not None


def read_lines(path: Path, encoding: str, piece: int = PIECE) -> Iterator[Lines]:
    """Text of a file, plain or packed, as pieces of whole lines, at least one; `piece` in bytes.

    Raises
    ------
    LogError
        ``log_encoding``, ``log_not_csv``, ``log_too_large``; ``log_truncated`` and ``log_damaged``
        for what cannot be unpacked.
    """
    rest = b""
    first = True
    for text in _decoded(path, unpacked(path, piece), encoding):
        data = rest + text if rest else text
        if first and len(data) < 4:
            rest = data
            continue
        if first:
            _refuse_binary(path, data[:4096])
            data = data.removeprefix(codecs.BOM_UTF8)
            first = False
        newline = data.rfind(b"\n")
        end = max(newline, data.rfind(b"\r", newline + 1)) + 1
        if not end and len(data) > LONGEST_LINE:
            raise LogError("log_not_csv", path, f"a line is longer than {LONGEST_LINE} bytes")
        whole, rest = data[:end], data[end:]
        if whole:
            yield Lines(repaired(whole))
    if first:
        _refuse_binary(path, rest)
        rest = rest.removeprefix(codecs.BOM_UTF8)
    yield Lines(b"", torn=len(rest.strip()))


def repaired(data: bytes) -> bytes:
    """Text with a mark in the place of what is not UTF-8; a cell with a mark is no number."""
    return data if data.isascii() else data.decode(errors="replace").encode()


def _packing(path: Path) -> str | None:
    with path.open("rb") as file:
        head = file.read(8)
    for magic, name in _OTHER_PACKERS.items():
        if head.startswith(magic):
            raise LogError(
                "log_not_csv", path, f"the file is packed with {name}: unpack it, or use gzip"
            )
    return next((name for magic, name in _PACKED.items() if head.startswith(magic)), None)


def unpacked(path: Path, piece: int) -> Iterator[bytes]:
    """Bytes of the text in pieces; errors as of `read_lines`."""
    packing = _packing(path)
    size = path.stat().st_size
    total = 0
    with path.open("rb") as file:
        pieces = (
            _read_lines(file, piece) if packing is None else _inflated(path, file, packing, piece)
        )
        for data in pieces:
            total += len(data)
            if total > LARGEST_TEXT:
                raise LogError(
                    "log_too_large",
                    path,
                    f"there are more than the {LARGEST_TEXT} bytes of text that a CSV may have: "
                    "split it, or use Parquet",
                )
            # By what has been unpacked so far: a bomb shows long before its end.
            if packing and total > max(_RATIO_FROM, LARGEST_RATIO * file.tell()):
                raise LogError(
                    "log_too_large",
                    path,
                    f"its {size} bytes expand to more than {LARGEST_RATIO} times as many, "
                    "too many for a log: decompress it and check its content",
                )
            yield data


def _read_lines(file: BinaryIO, piece: int) -> Iterator[bytes]:
    """Pieces that end with a line where that can be seen: they need not be copied to be joined."""
    look = min(_LOOK, piece)
    at = 0
    while True:
        file.seek(at + piece - look)
        newline = file.read(look).rfind(b"\n")
        file.seek(at)
        data = file.read(piece if newline < 0 else piece - look + newline + 1)
        if not data:
            return
        at += len(data)
        yield data


def _inflated(path: Path, file: BinaryIO, packing: str, piece: int) -> Iterator[bytes]:
    # Not the zstandard package's reader: it takes a cut file for a whole one.
    try:
        with pa.CompressedInputStream(pa.PythonFile(file, "r"), packing) as stream:
            # Not `read`: in PyArrow 26 a stream that fails keeps what that has set aside for good.
            while (data := stream.read_buffer(piece)).size:
                yield data.to_pybytes()
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        if "runcated" in reason or "end of" in reason:
            raise LogError(
                "log_truncated", path, f"the end of the {packing} file is missing: copy it again"
            ) from error
        raise LogError(
            "log_damaged", path, f"the {packing} file cannot be unpacked: {reason}"
        ) from error


def _decoded(path: Path, pieces: Iterator[bytes], encoding: str) -> Iterator[bytes]:
    """Pieces in UTF-8; half a character at the end is left to the last, cut row."""
    if is_utf8(encoding):
        yield from pieces
        return
    decoder = codecs.getincrementaldecoder(encoding)()
    for data in pieces:
        try:
            yield decoder.decode(data).encode()
        except (UnicodeError, ValueError) as error:
            raise LogError(
                "log_encoding", path, f"the text is not in encoding {encoding}: {error}"
            ) from error


def _refuse_binary(path: Path, head: bytes) -> None:
    """Refuse what is no text, or in another encoding, and say what it is."""
    packers = {**_PACKED, **_OTHER_PACKERS}
    packed = next((name for magic, name in packers.items() if head.startswith(magic)), None)
    if packed is not None:
        raise LogError("log_not_csv", path, f"what is in it is packed again, with {packed}")
    if head.startswith(b"SQLite format 3\0"):
        how = "this is an SQLite database: export its table as CSV or Parquet"
        raise LogError("log_not_csv", path, how)
    if head and not any(head):
        raise LogError("log_damaged", path, "the file holds nothing but zero bytes: copy it again")
    encoding = _wide_encoding(head)
    if encoding:
        how = f'the text looks like {encoding.upper()}: set encoding = "{encoding}" for this log'
        raise LogError("log_encoding", path, how)
    if 0 in head:
        raise LogError(
            "log_not_csv", path, "the file is not text: set the format it has, or unpack it first"
        )


def _wide_encoding(head: bytes) -> str | None:
    """Encoding of text whose letters have zero bytes around them."""
    if head.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return "utf-32"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    nul = head.count(0)
    if 10 * nul > 7 * len(head):
        return "utf-32"
    return "utf-16" if 5 * nul > 2 * len(head) else None
