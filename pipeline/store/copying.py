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
from pipeline.store.state import read_state_file

# At the URL alone: the SHA-256 of each file of the copy.
MANIFEST = "manifest.json"
# Requests under way at a time.
REQUESTS = 16


def copy_output(url: str, output: Path) -> int:
    """Copy new and changed tables of an output folder to a URL; returns how many.

    The caller holds the folder's lock. Files that are no longer published are removed last.

    Raises StoreError if the store refuses a request, or a file is not what was published.
    """
    store = ObjectStore.at(url)
    with read_state_file(output) as state:
        rows = state.rows("SELECT name, sha256 FROM files WHERE sha256 != '' ORDER BY name")
    manifest = json.dumps({"sha256": dict(rows)}, indent=0).encode()
    published = _digests(manifest)
    copied = _digests(store.get(MANIFEST) or b"{}")
    modified = {stored.key: stored.modified for stored in store.list()}
    # A newer object than the manifest is of a copy that was broken off.
    trusted = {
        key
        for key, digest in copied.items()
        if key in modified and modified[key] <= modified[MANIFEST] and published.get(key) == digest
    }

    def copy(key: str) -> None:
        path = output / key
        with store_errors(path, "read"):
            content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != published[key]:
            message = f"{path} is not what was published; `fit-fleet --repair` makes it anew"
            raise StoreError("store_read", message)
        store.put(key, content)

    missing = sorted(published.keys() - trusted)
    with ThreadPoolExecutor(REQUESTS) as pool:
        list(pool.map(copy, missing))
    store.put(MANIFEST, manifest)
    store.remove((copied.keys() - published.keys()) & modified.keys())
    return len(missing)


def _digests(manifest: bytes) -> Mapping[str, str]:
    """SHA-256 by path below the output; none of a damaged manifest, which is then replaced."""
    try:
        return {f"tables/{name}": str(sha) for name, sha in json.loads(manifest)["sha256"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
