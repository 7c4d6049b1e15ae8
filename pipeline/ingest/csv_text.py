"""The text of a CSV: unpacked, decoded and cut into pieces of whole lines.

Nothing here is larger than a piece, whatever the file unfolds to.
"""

from __future__ import annotations

import codecs
from collections.abc import Iterator
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
_LINE = 2**12
_UNPACKED_HERE = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd"}
_PACKERS = {
    **_UNPACKED_HERE,
    b"PK\x03\x04": "zip",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"7z\xbc\xaf": "7z",
    b"Rar!": "rar",
}


def is_utf8(encoding: str) -> bool:
    """True if text in an encoding is UTF-8 as it stands."""
    return codecs.lookup(encoding).name in {"utf-8", "utf-8-sig", "ascii"}


def is_packed(path: Path) -> bool:
    """True if a file is compressed, by its first bytes."""
    with path.open("rb") as file:
        return _packer(file.read(8)) is not None


def _packer(head: bytes) -> str | None:
    return next((name for magic, name in _PACKERS.items() if head.startswith(magic)), None)


def read_lines(path: Path, encoding: str, piece: int = PIECE) -> Iterator[bytes]:
    """Text of a file, plain or packed, in UTF-8, as pieces of whole lines; `piece` in bytes.

    There is one piece at least. The last one is what stands behind the last line end, if anything.

    Raises
    ------
    LogError
        ``log_encoding``, ``log_not_csv``, ``log_too_large``; ``log_truncated`` and ``log_damaged``
        for what cannot be unpacked.
    """
    rest, is_first = b"", True
    for text in _decoded(path, unpacked(path, piece), encoding):
        data = rest + text if rest else text
        if is_first and len(data) < 4:
            rest = data
            continue
        if is_first:
            data = _first(path, data)
            is_first = False
        newline = data.rfind(b"\n")
        end = max(newline, data.rfind(b"\r", newline + 1)) + 1
        if not end and len(data) > LONGEST_LINE:
            raise LogError("log_not_csv", path, f"a line is longer than {LONGEST_LINE} bytes")
        whole, rest = data[:end], data[end:]
        if whole:
            yield repaired(whole)
    if is_first:
        rest = _first(path, rest)
    yield rest if rest.strip() else b""


def repaired(data: bytes) -> bytes:
    """Text with a mark in the place of what is not UTF-8, and the minus sign as in ASCII.

    A cell with a mark is no number.
    """
    if data.isascii():
        return data
    return data.decode(errors="replace").replace("\N{MINUS SIGN}", "-").encode()


def unpacked(path: Path, piece: int) -> Iterator[bytes]:
    """Bytes of the text in pieces; errors as of `read_lines`."""
    size, total = path.stat().st_size, 0
    with path.open("rb") as file:
        packer = _packer(file.read(8))
        file.seek(0)
        if packer is not None and packer not in _UNPACKED_HERE.values():
            how = f"the file is packed with {packer}: unpack it, or use gzip"
            raise LogError("log_not_csv", path, how)
        # Up to the end of a line, where that is near: it need not be joined to the next piece.
        plain = iter(lambda: file.read(piece) + file.readline(_LINE), b"")
        for data in plain if packer is None else _inflated(path, file, packer, piece):
            total += len(data)
            if total > LARGEST_TEXT:
                raise LogError(
                    "log_too_large",
                    path,
                    f"there are more than the {LARGEST_TEXT} bytes of text that a CSV may have: "
                    "split it, or use Parquet",
                )
            # By what has been unpacked so far: a bomb shows long before its end.
            if packer and total > max(_RATIO_FROM, LARGEST_RATIO * file.tell()):
                raise LogError(
                    "log_too_large",
                    path,
                    f"its {size} bytes expand to more than {LARGEST_RATIO} times as many, "
                    "too many for a log: decompress it and check its content",
                )
            yield data


def _inflated(path: Path, file: BinaryIO, packer: str, piece: int) -> Iterator[bytes]:
    # Not the zstandard package's reader: it takes a cut file for a whole one.
    try:
        with pa.CompressedInputStream(pa.PythonFile(file, "r"), packer) as stream:
            # Not `read`: in PyArrow 26 a stream that fails keeps what that has set aside for good.
            while (data := stream.read_buffer(piece)).size:
                yield data.to_pybytes()
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        if "runcated" in reason or "end of" in reason:
            how = f"the end of the {packer} file is missing: copy it again"
            raise LogError("log_truncated", path, how) from error
        how = f"the {packer} file cannot be unpacked: {reason}"
        raise LogError("log_damaged", path, how) from error


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
            how = f"the text is not in encoding {encoding}: {error}"
            raise LogError("log_encoding", path, how) from error


def _first(path: Path, data: bytes) -> bytes:
    """The first piece without its mark; what is no text, or in another encoding, is refused."""
    head = data[:4096]
    packer = _packer(head)
    if packer is not None:
        raise LogError("log_not_csv", path, f"what is in it is packed again, with {packer}")
    if head.startswith(b"SQLite format 3\0"):
        how = "this is an SQLite database: export its table as CSV or Parquet"
        raise LogError("log_not_csv", path, how)
    if head and not any(head):
        raise LogError("log_damaged", path, "the file holds nothing but zero bytes: copy it again")
    encoding = wide_encoding(head)
    if encoding:
        how = f'the text looks like {encoding.upper()}: set encoding = "{encoding}" for this log'
        raise LogError("log_encoding", path, how)
    if 0 in head:
        how = "the file is not text: set the format it has, or unpack it first"
        raise LogError("log_not_csv", path, how)
    return data.removeprefix(codecs.BOM_UTF8)


def wide_encoding(head: bytes) -> str | None:
    """Encoding of text whose letters have zero bytes around them."""
    if head.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return "utf-32"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    # Text has no zero byte: of plain letters in UTF-16 every other byte is one, in UTF-32 three of
    # four.
    nul = head.count(0)
    if 5 * nul <= 2 * len(head):
        return None
    return f"utf-{32 if 10 * nul > 7 * len(head) else 16}-{'le' if head[0] else 'be'}"
