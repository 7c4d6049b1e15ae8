"""Small files that tell whether they are whole: a flipped digit would else be believed."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from pipeline.store.atomic_files import put, read

log = logging.getLogger(__name__)

Said = TypeVar("Said")


def seal(document: Mapping[str, Any]) -> bytes:
    """A document as JSON, with the hash of all that it says.

    Examples
    --------
    >>> unseal(seal({"last_night": "2026-03-02"}))
    {'last_night': '2026-03-02'}
    >>> unseal(seal({"last_night": "2026-03-02"}).replace(b"03-02", b"03-03")) is None
    True
    """
    whole = {**document, "sha256": _digest(document)}
    return json.dumps(whole, separators=(",", ":"), sort_keys=True).encode()


def unseal(content: bytes) -> dict[str, Any] | None:
    """What a document says; None where it is damaged."""
    try:
        document = json.loads(content)
        found: dict[str, Any] = {name: one for name, one in document.items() if name != "sha256"}
        return found if document["sha256"] == _digest(found) else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _digest(document: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(dict(document), sort_keys=True).encode()).hexdigest()


def seal_bytes(content: bytes) -> bytes:
    """Any content, with its hash before it.

    Examples
    --------
    >>> unseal_bytes(seal_bytes(b"all nights"))
    b'all nights'
    >>> unseal_bytes(seal_bytes(b"all nights").replace(b"all", b"few")) is None
    True
    """
    return hashlib.sha256(content).digest() + content


def unseal_bytes(content: bytes) -> bytes | None:
    """What was sealed; None where it is damaged."""
    size = hashlib.sha256().digest_size
    whole = content[size:]
    return whole if content[:size] == hashlib.sha256(whole).digest() else None


def read_sealed(path: Path, unsealed: Callable[[bytes], Said | None]) -> Said | None:
    """Content of a file of an output; None where there is none, or it is damaged.

    A damaged one is named in a warning.
    """
    try:
        content = unsealed(read(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        fault = f"cannot be read: {error.strerror}"
    else:
        if content is not None:
            return content
        fault = "is damaged"
    name = "/".join(path.parts[-3:])
    log.warning("%s %s; what it told of is made anew where that can be", name, fault)
    return None


def put_sealed(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document, unless it is there as it is to be.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    content = seal(document)
    with suppress(OSError):
        if read(path) == content:
            return
    put(path, content)
