"""Manifests: the SHA-256 of every published table file proves it, its footer included.

One manifest a night, a joined month, and a run. Page checksums do not cover a footer, and a query
engine checks neither. Before files are put into their places their manifest lists old and new
digests, afterwards the new ones: every file can be proven at any moment, wherever a run was broken
off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath

from pipeline.store.atomic_files import put, remove
from pipeline.store.sealed import DamagedError, put_sealed, read_sealed, seal, unseal

MONTH_PREFIX = "month="
# Stands for the month of tables that are one file.
WHOLE = "whole"
# Month and name of a manifest.
Key = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Manifest:
    """Published files of a night or of a run, by path relative to the folder of the tables."""

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


def manifest_file(output: Path, month: str, name: str) -> Path:
    """File of the manifest of a night, or of a run."""
    return output / "manifest" / f"{MONTH_PREFIX}{month}" / f"{name}.json"


def manifest_keys(output: Path, month: str = "*") -> list[Key]:
    """Month and name of each manifest, or of those of a month, sorted."""
    paths = (output / "manifest").glob(f"{MONTH_PREFIX}{month}/*.json")
    return sorted((path.parent.name.removeprefix(MONTH_PREFIX), path.stem) for path in paths)


def manifest_key(name: str) -> Key:
    """Month and name of the manifest that lists a table file.

    Examples
    --------
    >>> manifest_key("fits/month=2026-03/2026-03-02.parquet")
    ('2026-03', '2026-03-02')
    >>> manifest_key("fits/month=2026-03/2026-03.parquet")
    ('2026-03', '2026-03')
    >>> manifest_key("decisions/decisions.parquet")
    ('whole', 'decisions')
    """
    path = PurePosixPath(name)
    folder = path.parent.name
    month = folder.removeprefix(MONTH_PREFIX) if folder.startswith(MONTH_PREFIX) else WHOLE
    return month, path.stem


def read_manifest(output: Path, month: str, name: str) -> Manifest | None:
    """The manifest of a night, or of a run; None where there is none, or it is damaged.

    Raises StoreError if there is one that cannot be read: taken for absent, it would lose its
    files.
    """
    try:
        document = read_sealed(manifest_file(output, month, name), unseal)
        if document is None:
            return None
        coming = {one: tuple(some) for one, some in document["coming"].items()}
        return Manifest(dict(document["files"]), coming)
    except (DamagedError, ValueError, KeyError, TypeError, AttributeError):
        return None


def announce(
    output: Path, month: str, name: str, changes: Mapping[str, tuple[str | None, str | None]]
) -> None:
    """Say which files are about to be replaced: by path, SHA-256 before and after.

    Raises StoreError if it cannot be written.
    """
    before = read_manifest(output, month, name) or Manifest()
    coming = {one: pair for one, pair in changes.items() if pair[0] != pair[1]}
    after = Manifest(before.files, {**before.coming, **coming})
    put_sealed(manifest_file(output, month, name), asdict(after))


def update_manifest(output: Path, month: str, name: str, files: Mapping[str, str | None]) -> None:
    """Record the files of a night or of a run; those not named stay as they were.

    Parameters
    ----------
    output
        Output folder.
    month, name
        YYYY-MM, and the files' name without ending.
    files
        SHA-256 by path relative to the folder of the tables; None for no file.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    before = read_manifest(output, month, name) or Manifest()
    listed: dict[str, str | None] = {**before.files, **files}
    kept = {one: digest for one, digest in listed.items() if digest is not None}
    coming = {one: some for one, some in before.coming.items() if one not in files}
    path = manifest_file(output, month, name)
    if kept or coming:
        put_sealed(path, asdict(Manifest(kept, coming)))
    else:
        remove(path)


def renew_manifest(output: Path, month: str, name: str) -> None:
    """Give a manifest the time of now, as its files have been proven once more.

    Raises StoreError if it cannot be written.
    """
    manifest = read_manifest(output, month, name)
    if manifest is not None:
        put(manifest_file(output, month, name), seal(asdict(manifest)))
