"""A bucket of an object store, S3, Azure or Google, and the copy of an output's tables in it.

Credentials come from the environment alone, by the names of each provider's own tools.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import os
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from pipeline.errors import StoreError
from pipeline.store.atomic_files import store_errors
from pipeline.store.state import read_state_file

# One of these must be set: without any, the client would query the metadata addresses of cloud
# machines for minutes.
CREDENTIALS = {
    "s3": (
        *("AWS_ACCESS_KEY_ID", "AWS_WEB_IDENTITY_TOKEN_FILE", "AWS_METADATA_ENDPOINT"),
        *("AWS_CONTAINER_CREDENTIALS_RELATIVE_URI", "AWS_CONTAINER_CREDENTIALS_FULL_URI"),
        "AWS_SKIP_SIGNATURE",
    ),
    "az": (
        *("AZURE_STORAGE_ACCOUNT_KEY", "AZURE_STORAGE_SAS_KEY", "AZURE_STORAGE_TOKEN"),
        *("AZURE_CLIENT_ID", "AZURE_FEDERATED_TOKEN_FILE", "AZURE_MSI_ENDPOINT"),
    ),
    "gs": (
        *("GOOGLE_APPLICATION_CREDENTIALS", "GOOGLE_SERVICE_ACCOUNT"),
        *("GOOGLE_SERVICE_ACCOUNT_KEY", "GOOGLE_SKIP_SIGNATURE"),
    ),
}
# Variables that name another S3-compatible server; the client takes the first.
ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
# Retries of a failed request, with growing waits in between.
RETRIES = 5
PART = 8 << 20
# At the URL alone: the SHA-256 of each file of the copy.
MANIFEST = "manifest.json"
# Requests under way at a time.
REQUESTS = 16


@dataclass(frozen=True, slots=True)
class StoredObject:
    """An object in a listing; its key is relative to the URL."""

    key: str
    size: int
    tag: str
    modified: dt.datetime


@dataclass(frozen=True, slots=True)
class ObjectStore:
    """All objects below a URL such as s3://bucket/folder; all requests raise StoreError."""

    url: str
    _client: Any = field(repr=False, compare=False)

    @classmethod
    def at(cls, url: str) -> ObjectStore:
        """Return the store at a URL; no request is sent yet.

        Raises StoreError: ``object_store_missing``: the extra is not installed;
        ``object_store_credentials``: the environment has none; ``object_store_http``: the server
        has no encryption, and the environment does not allow that.
        """
        scheme = url.partition("://")[0]
        try:
            from obstore.store import from_url
        except ImportError as error:
            raise StoreError(
                "object_store_missing",
                f"{url} needs the extra `s3` ({error}): pip install 'motor-leakage[s3]'",
            ) from error
        if not any(name in os.environ for name in CREDENTIALS[scheme]):
            raise StoreError(
                "object_store_credentials",
                f"{url}: the environment has no credentials; expected one of "
                f"{', '.join(CREDENTIALS[scheme])}",
            )
        if scheme == "s3":
            _require_http_allowed()
        second = dt.timedelta(seconds=1)
        waits = {"init_backoff": second / 10, "max_backoff": 5 * second, "base": 2}
        retries = {"max_retries": RETRIES, "backoff": waits, "retry_timeout": 60 * second}
        client: Any = from_url  # its overloads know a provider each
        return cls(url.rstrip("/"), client(url, retry_config=retries))

    def put(self, key: str, content: bytes) -> None:
        """Put an object, in place of any that has its key."""
        with self._store_errors(key, "written"):
            self._client.put(key, content, use_multipart=False)

    def get(self, key: str) -> bytes | None:
        """Return content of an object; None where there is none."""
        with self._store_errors(key, "read"):
            try:
                got = self._client.get(key)
            except FileNotFoundError as error:
                if _is_absent_bucket(error):
                    raise
                return None
            return bytes(got.bytes())

    def fetch(self, stored: StoredObject, stream: BinaryIO) -> None:
        """Write an object's content to a stream; raises ObjectChangedError if it has changed."""
        from obstore.exceptions import PreconditionError

        with self._store_errors(stored.key, "read"):
            try:
                got = self._client.get(stored.key, options={"if_match": stored.tag})
                stream.writelines(got.stream(min_chunk_size=PART))
            except (PreconditionError, FileNotFoundError) as error:
                if _is_absent_bucket(error):
                    raise
                raise ObjectChangedError(stored.key) from error

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        """Yield objects in a folder and below."""
        with self._store_errors(prefix, "listed"):
            for page in self._client.list(prefix or None):
                for entry in page:
                    yield StoredObject(
                        entry["path"], entry["size"], entry["e_tag"] or "", entry["last_modified"]
                    )

    def remove(self, keys: Collection[str]) -> None:
        """Remove objects, if they exist."""
        with self._store_errors("objects", "removed"):
            for key in keys:
                try:
                    self._client.delete(key)
                except FileNotFoundError:
                    continue

    @contextmanager
    def _store_errors(self, key: str, what: str) -> Iterator[None]:
        """Return turn a failed request into `StoreError`."""
        from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError

        place = f"{self.url}/{key}"
        try:
            yield
        except (PermissionDeniedError, UnauthenticatedError) as error:
            raise StoreError(
                "object_store_denied",
                f"{place} cannot be {what}: the credentials of the environment do not allow it "
                f"({_first_line(error)})",
            ) from error
        except (BaseError, OSError) as error:
            code = "store_read" if what in ("read", "listed") else "store_write"
            why = _first_line(error)
            if _is_absent_bucket(error):
                code = "object_store_bucket"
                why = "there is no such bucket; make it, or correct the URL"
            raise StoreError(code, f"{place} cannot be {what}: {why}") from error


class ObjectChangedError(Exception):
    """An object has changed since it was listed; carries its key."""


def _require_http_allowed() -> None:
    """Require the variable that Polars requires, too."""
    name = next((name for name in ENDPOINTS if name in os.environ), None)
    allowed = os.environ.get("AWS_ALLOW_HTTP", "").lower() in ("1", "true", "yes", "on", "y", "t")
    if name and os.environ[name].startswith("http://") and not allowed:
        raise StoreError(
            "object_store_http",
            f"{name} is {os.environ[name]}, without encryption; expected https://, or "
            "AWS_ALLOW_HTTP=true beside it",
        )


def _is_absent_bucket(error: Exception) -> bool:
    return any(word in str(error) for word in ("NoSuchBucket", "ContainerNotFound"))


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0].strip()


def copy_output(url: str, output: Path) -> None:
    """Copy new and changed tables of an output folder to a URL, under the names of the files.

    The copy's own `manifest.json` is written last, so a copy that was broken off is completed by
    the next. The caller holds the folder's lock.

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

    with ThreadPoolExecutor(REQUESTS) as pool:
        list(pool.map(copy, sorted(published.keys() - trusted)))
    store.put(MANIFEST, manifest)
    store.remove((copied.keys() - published.keys()) & modified.keys())


def _digests(manifest: bytes) -> Mapping[str, str]:
    """Return SHA-256 by path below the output; none of a damaged manifest."""
    try:
        return {f"tables/{name}": str(sha) for name, sha in json.loads(manifest)["sha256"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
