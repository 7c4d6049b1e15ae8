"""The copy of an output's tables at a URL, for readers elsewhere.

Objects have the names of the files. The copy's own `manifest.json` says what is there; it is
written last, so a copy that was broken off is completed by the next one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.store.atomic_files import store_errors
from pipeline.store.object_store import ObjectStore
from pipeline.store.published import MANIFEST_FILE

# Requests under way at a time.
REQUESTS = 16


def copy_output(url: str, output: Path) -> int:
    """Copy new and changed tables of an output folder to a URL; returns how many.

    The caller holds the folder's lock. Files that are no longer published are removed last.

    Raises StoreError if the store refuses a request, or a file is not what was published.
    """
    store = ObjectStore.at(url)
    with store_errors(output / MANIFEST_FILE, "read"):
        manifest = (output / MANIFEST_FILE).read_bytes()
    published = _digests(manifest)
    copied = _digests(store.get(MANIFEST_FILE) or b"{}")
    modified = {stored.key: stored.modified for stored in store.list()}
    # A newer object than the manifest is of a copy that was broken off.
    trusted = {
        key
        for key, digest in copied.items()
        if key in modified
        and modified[key] <= modified[MANIFEST_FILE]
        and published.get(key) == digest
    }

    def copy(key: str) -> None:
        path = output / key
        with store_errors(path, "read"):
            content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != published[key]:
            message = f"{path} is not what was published; the next run repairs and copies it"
            raise StoreError("store_read", message)
        store.put(key, content)

    missing = sorted(published.keys() - trusted)
    with ThreadPoolExecutor(REQUESTS) as pool:
        list(pool.map(copy, missing))
    store.put(MANIFEST_FILE, manifest)
    store.remove((copied.keys() - published.keys()) & modified.keys())
    return len(missing)


def _digests(manifest: bytes) -> Mapping[str, str]:
    """SHA-256 by path below the output; none of a damaged manifest, which is then replaced."""
    try:
        return {f"tables/{name}": str(sha) for name, sha in json.loads(manifest)["sha256"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
