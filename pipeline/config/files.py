"""TOML files to models, with every fault of each."""

from __future__ import annotations

import errno
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from pipeline.config.defaults import Document, completed
from pipeline.config.faults import Fault, faults_of

# Bytes of a config file.
LARGEST = 8 * 2**20

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Folder(Generic[Model]):
    """The TOML files of a folder by name without ending."""

    own: Mapping[str, Document]  # content of every file there is; empty where it cannot be read
    documents: Mapping[str, Document]  # the same with the fleet's defaults
    parsed: Mapping[str, Model]  # those without a fault


def read_folder(
    folder: Path | None,
    model: type[Model],
    faults: list[Fault],
    defaults: Document | None = None,
) -> Folder[Model]:
    """All TOML files of a folder; none where it cannot be, which is told already."""
    if folder is None:
        return Folder({}, {}, {})
    if not folder.is_dir():
        faults.append(Fault(folder.name, "", f"expected a folder at {folder}"))
        return Folder({}, {}, {})
    own: dict[str, Document] = {}
    documents: dict[str, Document] = {}
    parsed: dict[str, Model] = {}
    for path in sorted(folder.glob("*.toml")):
        file, name = f"{folder.name}/{path.name}", path.stem
        document = read_toml(path, file, faults)
        own[name] = document or {}
        documents[name] = completed(own[name], defaults or {}, name)
        content = None
        if document is not None:
            content = validated(model, documents[name], file, faults)
        if content is not None:
            parsed[name] = content
    return Folder(own, documents, parsed)


def read_toml(path: Path, file: str, faults: list[Fault]) -> dict[str, Any] | None:
    """Content of a TOML file; None if it has a fault."""
    try:
        # Windows' editors begin a file with a byte order mark.
        document = tomllib.loads(_content(path).decode("utf-8-sig"))
        # Whatever cannot be written as JSON: too deep, or a number of thousands of digits.
        json.dumps(document, default=str)
    except OSError as error:
        faults.append(Fault(file, "", f"cannot be read: {error.strerror}"))
    except UnicodeDecodeError as error:
        faults.append(Fault(file, "", f"is not UTF-8, as TOML must be: byte {error.start}"))
    except (ValueError, RecursionError) as error:
        faults.append(Fault(file, "", f"is not TOML: {error}"))
    else:
        return document
    return None


def _content(path: Path) -> bytes:
    """All of a file. Raises OSError for a huge one, a pipe, or a device, which may never end."""
    if not (path.is_file() or path.is_dir()) and path.exists():
        raise OSError(errno.EINVAL, "is no regular file")
    with path.open("rb") as stream:
        content = stream.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise OSError(errno.EFBIG, f"is larger than {LARGEST // 2**20} MiB")
    return content


def validated(
    model: type[Model], document: Document, file: str, faults: list[Fault], prefix: str = ""
) -> Model | None:
    """The model of a file's content; None if it has a fault."""
    try:
        # By way of JSON: strict validation then still takes arrays as tuples and text as dates.
        return model.model_validate_json(json.dumps(document, default=str))
    except ValidationError as error:
        faults += faults_of(error, file, prefix, document)
    return None
