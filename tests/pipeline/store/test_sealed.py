"""Sealed files: read as they were written, or reported as damaged."""

from __future__ import annotations

import datetime as dt
import errno
import hashlib
import json
from pathlib import Path

import pytest

from pipeline.errors import StoreError
from pipeline.store import sealed
from pipeline.store.sealed import DamagedError, put_sealed, read_if_whole, read_sealed, seal, unseal

DOCUMENT = {"model": [7.5e-14, 0.0], "night": "2026-01-02", "wear": "µ", "none": None}
CONTENT = seal(DOCUMENT)


def flipped(content: bytes, bit: int) -> bytes:
    found = bytearray(content)
    found[bit // 8] ^= 1 << bit % 8
    return bytes(found)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "sealed"
    put_sealed(path, DOCUMENT)
    return path


def test_anybody_can_check_the_digest() -> None:
    """By the words of the docs: JSON with the SHA-256 of its other members."""
    document = json.loads(CONTENT)
    digest = document.pop("sha256")
    assert document == DOCUMENT
    assert digest == hashlib.sha256(json.dumps(DOCUMENT, sort_keys=True).encode()).hexdigest()


def test_any_flipped_bit_is_seen() -> None:
    for bit in range(8 * len(CONTENT)):
        assert unseal(flipped(CONTENT, bit)) in (None, DOCUMENT), bit
    assert sum(unseal(flipped(CONTENT, bit)) is None for bit in range(8 * len(CONTENT))) > 1000


def test_any_truncation_is_seen() -> None:
    assert {unseal(CONTENT[:length]) is None for length in range(len(CONTENT))} == {True}


@pytest.mark.parametrize(
    "content", [b"null", b"[]", b"{}", b'"text"', b"\xff\xfe", b"\0" * 4096, b"[" * 100_000]
)
def test_other_content_is_damage(content: bytes) -> None:
    assert unseal(content) is None


def test_dates_become_text_and_nothing_else_does() -> None:
    moment = dt.datetime(2026, 1, 2, 3, tzinfo=dt.UTC)
    text = {"night": "2026-01-02", "time": "2026-01-02T03:00:00+00:00"}
    assert unseal(seal({"night": moment.date(), "time": moment})) == text
    with pytest.raises(TypeError, match="Path cannot be sealed"):
        seal({"path": Path("x")})


def test_a_file_is_there_absent_damaged_or_unreadable(
    path: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert read_sealed(path, unseal) == read_if_whole(path, unseal) == DOCUMENT
    for absent in (tmp_path / "absent", path / "below a file"):
        assert read_sealed(absent, unseal) is read_if_whole(absent, unseal) is None
    assert caplog.text == ""
    path.write_bytes(flipped(CONTENT, 100))
    with pytest.raises(DamagedError, match="sealed is damaged"):
        read_sealed(path, unseal)
    with pytest.raises(StoreError, match="cannot be read: Is a directory") as caught:
        read_sealed(tmp_path, unseal)
    assert (caught.value.code, type(caught.value)) == ("store_read", StoreError)
    assert read_if_whole(path, unseal) is read_if_whole(tmp_path, unseal) is None
    assert caplog.text.count("it is made anew") == 2


def test_an_error_on_the_way_from_the_disk_is_no_damage(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    contents = iter([flipped(CONTENT, 100), CONTENT])
    monkeypatch.setattr(sealed, "read", lambda _: next(contents))
    assert read_sealed(path, unseal) == DOCUMENT


def test_a_file_is_written_only_where_it_differs(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(sealed, "put", lambda *_: pytest.fail("was written"))
        put_sealed(path, dict(reversed(DOCUMENT.items())))
    path.write_bytes(flipped(CONTENT, 100))
    put_sealed(path, DOCUMENT)
    assert path.read_bytes() == CONTENT


def test_a_file_that_cannot_be_compared_is_written(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: Path) -> bytes:
        raise OSError(errno.EIO, "Input/output error")

    path.unlink()
    monkeypatch.setattr(sealed, "read", fail)
    put_sealed(path, DOCUMENT)
    assert path.read_bytes() == CONTENT
