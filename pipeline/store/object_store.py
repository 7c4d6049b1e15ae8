"""A bucket of an object store: S3, Azure or Google, by one client, with conditional puts.

Neither PyArrow's file systems nor Polars have a put that fails if somebody else was there first;
`obstore` has, and is the client library on which Polars stands. Credentials come from the
environment alone, by the names that each provider's own tools use.
"""

from __future__ import annotations

import datetime as dt
import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, BinaryIO

from pipeline.errors import StoreError

# What the environment must name one of: without any, the client would ask the addresses of cloud
# machines for minutes.
CREDENTIALS = {
    "s3": (
        "AWS_ACCESS_KEY_ID",
        "AWS_WEB_IDENTITY_TOKEN_FILE",
        "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
        "AWS_CONTAINER_CREDENTIALS_FULL_URI",
        "AWS_METADATA_ENDPOINT",
        "AWS_SKIP_SIGNATURE",
    ),
    "az": (
        "AZURE_STORAGE_ACCOUNT_KEY",
        "AZURE_STORAGE_SAS_KEY",
        "AZURE_STORAGE_TOKEN",
        "AZURE_CLIENT_ID",
        "AZURE_FEDERATED_TOKEN_FILE",
        "AZURE_MSI_ENDPOINT",
    ),
    "gs": (
        "GOOGLE_APPLICATION_CREDENTIALS",
        "GOOGLE_SERVICE_ACCOUNT",
        "GOOGLE_SERVICE_ACCOUNT_KEY",
        "GOOGLE_SKIP_SIGNATURE",
    ),
}
# Another S3-compatible server: the names that the client reads, the first found.
ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
# A server that fails is asked again this often, with longer and longer waits in between.
RETRIES = 5
PART = 8 << 20


@dataclass(frozen=True, slots=True)
class StoredObject:
    """An object as a listing tells of it: its key below the URL, size, tag and last change."""

    key: str
    size: int
    tag: str
    modified: dt.datetime


@dataclass(frozen=True, slots=True)
class ObjectStore:
    """What lies below a URL.

    Attributes
    ----------
    url
        Such as s3://bucket/folder.
    """

    url: str
    _client: Any = field(repr=False, compare=False)

    @classmethod
    def at(cls, url: str) -> ObjectStore:
        """The store at a URL; nothing is asked of it yet.

        Raises
        ------
        StoreError
            ``object_store_missing``: the extra is not installed; ``object_store_credentials``: the
            environment has none; ``object_store_http``: it names a server without encryption, and
            does not say that this is meant.
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
        client: Any = from_url  # its overloads know one provider each
        return cls(url.rstrip("/"), client(url, retry_config=retries))

    def create(self, key: str, content: bytes) -> None:
        """Put an object that never changes; one that is there already has this very content.

        Raises
        ------
        StoreError
            If it cannot be put.
        """
        from obstore.exceptions import AlreadyExistsError

        with self._told(key, "written"):
            try:
                self._client.put(key, content, mode="create", use_multipart=False)
            except AlreadyExistsError:
                return

    def replace(self, key: str, content: bytes, tag: str | None) -> str:
        """Put an object in the place of the one with a tag, or of none.

        Returns
        -------
        str
            The new tag.

        Raises
        ------
        StoreError
            ``object_store_conflict``: another has been put there since.
        """
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        mode: Any = "create" if tag is None else {"e_tag": tag}
        with self._told(key, "written"):
            try:
                put = self._client.put(key, content, mode=mode, use_multipart=False)
            except (AlreadyExistsError, PreconditionError) as error:
                # Of a request that was answered too late and sent again, the first may have landed.
                found = self.get(key)
                if found is not None and found[0] == content:
                    return found[1]
                raise StoreError(
                    "object_store_conflict",
                    f"{self.url}/{key} was replaced by another run meanwhile; nothing of this run "
                    "is published, and the next one does it",
                ) from error
        return str(put["e_tag"])

    def get(self, key: str) -> tuple[bytes, str] | None:
        """Content and tag of an object; None where there is none."""
        with self._told(key, "read"):
            try:
                got = self._client.get(key)
                return bytes(got.bytes()), str(got.meta["e_tag"])
            except FileNotFoundError as error:
                if _is_absent_bucket(error):
                    raise
                return None

    def fetch(self, one: StoredObject, stream: BinaryIO) -> None:
        """Write an object's content to a stream, if it is still the one that was listed.

        Raises
        ------
        ObjectChangedError
            If it has another tag by now, or is gone.
        """
        from obstore.exceptions import PreconditionError

        with self._told(one.key, "read"):
            try:
                got = self._client.get(one.key, options={"if_match": one.tag})
                stream.writelines(got.stream(min_chunk_size=PART))
            except PreconditionError as error:
                raise ObjectChangedError(one.key) from error
            except FileNotFoundError as error:
                if _is_absent_bucket(error):
                    raise
                raise ObjectChangedError(one.key) from error

    def tag_of(self, key: str) -> str | None:
        """The tag that an object has now; None where there is none."""
        with self._told(key, "read"):
            try:
                return str(self._client.head(key)["e_tag"])
            except FileNotFoundError:
                return None

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        """Objects whose key begins with a folder's path."""
        with self._told(prefix, "listed"):
            for page in self._client.list(prefix or None):
                for one in page:
                    yield StoredObject(
                        one["path"], one["size"], one["e_tag"] or "", one["last_modified"]
                    )

    def remove(self, keys: Collection[str]) -> None:
        """Remove objects; those that are gone already are no fault."""
        with self._told("objects", "removed"):
            for key in keys:
                try:
                    self._client.delete(key)
                except FileNotFoundError:
                    continue

    @contextmanager
    def _told(self, key: str, what: str) -> Iterator[None]:
        """A failed request as an error with a code."""
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
            if _is_absent_bucket(error):
                raise StoreError(
                    "object_store_bucket",
                    f"{place} cannot be {what}: there is no such bucket; make it, or correct the "
                    "URL",
                ) from error
            code = "store_read" if what == "read" else "store_write"
            if what == "listed":
                code = "store_read"
            raise StoreError(code, f"{place} cannot be {what}: {_first_line(error)}") from error


class ObjectChangedError(Exception):
    """An object is no more the one that was listed; carries its key."""


def _require_http_allowed() -> None:
    """All that reads the tables later asks for the same word: Polars, Delta Lake."""
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
