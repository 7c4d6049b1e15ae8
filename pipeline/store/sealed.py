"""Sealed files: JSON with its own SHA-256, so that a flipped digit is not believed.

Manifests, decisions, ledgers, the outbox and the report's list of files are sealed so.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from pipeline.errors import StoreError
from pipeline.store.atomic_files import put, read, scratch, store_errors

log = logging.getLogger(__name__)

Content = TypeVar("Content")
# Characters of the digest in lines of `decisions.jsonl` that older versions wrote.
SHORT_DIGEST = 16


class DamagedError(StoreError):
    """A sealed file is not as it was written."""


def seal(document: Mapping[str, Any]) -> bytes:
    """A document as JSON with its digest; dates become text.

    Examples
    --------
    >>> unseal(seal({"last_night": "2026-03-02"}))
    {'last_night': '2026-03-02'}
    >>> unseal(seal({"last_night": "2026-03-02"}).replace(b"03-02", b"03-03")) is None
    True
    """
    sealed = {**document, "sha256": _digest(document)}
    return json.dumps(sealed, separators=(",", ":"), sort_keys=True, default=_text).encode()


def unseal(content: bytes) -> dict[str, Any] | None:
    """The document of sealed content; None where that is damaged."""
    try:
        document: dict[str, Any] = json.loads(content)
        found, digest = document.pop("sha256"), _digest(document)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return document if found in (digest, digest[:SHORT_DIGEST]) else None


def _digest(document: Mapping[str, Any]) -> str:
    text = json.dumps(dict(document), sort_keys=True, default=_text)
    return hashlib.sha256(text.encode()).hexdigest()


def _text(value: object) -> str:
    if isinstance(value, dt.date):  # or a time
        return value.isoformat()
    raise TypeError(f"{type(value).__name__} cannot be sealed")


def read_sealed(path: Path, unsealed: Callable[[bytes], Content | None]) -> Content | None:
    """Content of a file that tells whether it is whole; None where there is no file.

    One that reads as damaged is read again: an error on the way from the disk is no damage.

    Raises DamagedError if it is not as it was written; StoreError (``store_read``) if it cannot be
    read.
    """
    name = "/".join(path.parts[-3:])
    try:
        for _ in range(2):
            content = unsealed(read(path))
            if content is not None:
                return content
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise StoreError("store_read", f"{name} cannot be read: {error.strerror}") from error
    raise DamagedError("store_read", f"{name} is damaged")


def read_if_whole(path: Path, unsealed: Callable[[bytes], Content | None]) -> Content | None:
    """Content of a sealed file that only saves work; None, with a warning, where it is damaged."""
    try:
        return read_sealed(path, unsealed)
    except StoreError as error:
        log.warning("%s; it is made anew", error)
        return None


def put_sealed(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document, unless it is there already.

    Raises StoreError if it cannot be written.
    """
    content = seal(document)
    with suppress(OSError):
        if read(path) == content:
            return
    put(path, content)


def stage_sealed(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document to a scratch file, in a folder of its own below one of the run's folder.

    Raises StoreError if it cannot be written.
    """
    with store_errors(path), scratch(path, depth=2) as stream:
        stream.write(seal(document))
