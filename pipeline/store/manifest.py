"""Manifests: the SHA-256 of every published table file proves it, its footer included.

One manifest a month. Page checksums do not cover a footer, and a query engine checks neither.
Before files are put into their places their manifest lists old and new digests, afterwards the new
ones: every file can be proven at any moment, wherever a run was broken off.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath
from typing import TypeVar

from pipeline.schema import LOOKS
from pipeline.store.atomic_files import put, remove
from pipeline.store.sealed import DamagedError, put_sealed, read_sealed, seal, unseal

Value = TypeVar("Value")

MONTH_PREFIX = "month="
# Name of the manifest of tables that are one file.
WHOLE = "whole"


@dataclass(frozen=True, slots=True)
class Manifest:
    """Published files, by path relative to the folder of the tables."""

    files: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of each
    # SHA-256 before and after, of files that a run is replacing; None for no file.
    coming: Mapping[str, tuple[str | None, ...]] = field(default_factory=dict)

    def accepted(self, name: str) -> tuple[str | None, ...]:
        """Digests that a file may have; empty where it is not listed."""
        if name in self.coming:
            return self.coming[name]
        return (self.files[name],) if name in self.files else ()

    @property
    def names(self) -> set[str]:
        """Files that it lists."""
        return self.files.keys() | self.coming.keys()


def manifest_file(output: Path, key: str) -> Path:
    """File of a manifest."""
    return output / "manifest" / f"{key}.json"


def manifest_keys(output: Path) -> list[str]:
    """Names of all manifests, sorted."""
    return sorted(path.stem for path in (output / "manifest").glob("*.json"))


def manifest_key(name: str) -> str:
    """Name of the manifest that lists a table file.

    Examples
    --------
    >>> manifest_key("fits/month=2026-03/2026-03.parquet")
    '2026-03'
    >>> manifest_key("looks/month=2026-03/2026-03.parquet")  # no run writes it
    'looks-2026-03'
    >>> manifest_key("decisions/decisions.parquet")
    'whole'
    """
    path = PurePosixPath(name)
    if not path.parent.name.startswith(MONTH_PREFIX):
        return WHOLE
    month = path.parent.name.removeprefix(MONTH_PREFIX)
    return f"{LOOKS.name}-{month}" if path.parts[0] == LOOKS.name else month


def read_manifest(output: Path, key: str) -> Manifest | None:
    """A manifest; None where there is none, or it is damaged.

    Raises StoreError if there is one that cannot be read: taken for absent, it would lose its
    files.
    """
    try:
        document = read_sealed(manifest_file(output, key), unseal)
        if document is None:
            return None
        coming = {one: tuple(some) for one, some in document["coming"].items()}
        return Manifest(dict(document["files"]), coming)
    except (DamagedError, ValueError, KeyError, TypeError, AttributeError):
        return None


def announce(output: Path, changes: Mapping[str, tuple[str | None, str | None]]) -> None:
    """Say which files are about to be replaced: by path, SHA-256 before and after.

    Raises StoreError if it cannot be written.
    """
    for key, some in _by_key(changes).items():
        before = read_manifest(output, key) or Manifest()
        coming = {name: pair for name, pair in some.items() if pair[0] != pair[1]}
        after = Manifest(before.files, {**before.coming, **coming})
        put_sealed(manifest_file(output, key), asdict(after))


def update_manifest(output: Path, files: Mapping[str, str | None]) -> None:
    """Record files; those not named stay as they were.

    Parameters
    ----------
    output
        Output folder.
    files
        SHA-256 by path relative to the folder of the tables; None for no file.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    for key, some in _by_key(files).items():
        before = read_manifest(output, key) or Manifest()
        listed = {**before.files, **some}
        kept = {one: digest for one, digest in listed.items() if digest is not None}
        coming = {one: pair for one, pair in before.coming.items() if one not in some}
        if kept or coming:
            put_sealed(manifest_file(output, key), asdict(Manifest(kept, coming)))
        else:
            remove(manifest_file(output, key))


def _by_key(named: Mapping[str, Value]) -> dict[str, dict[str, Value]]:
    """What is said of files, by the manifest that lists them."""
    found: defaultdict[str, dict[str, Value]] = defaultdict(dict)
    for name, value in named.items():
        found[manifest_key(name)][name] = value
    return dict(sorted(found.items()))


def renew_manifest(output: Path, key: str) -> None:
    """Give a manifest the time of now, as its files have been proven once more.

    Raises StoreError if it cannot be written.
    """
    manifest = read_manifest(output, key)
    if manifest is not None:
        put(manifest_file(output, key), seal(asdict(manifest)))
