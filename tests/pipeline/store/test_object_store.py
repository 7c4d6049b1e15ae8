"""The client of an object store, against a server on loopback."""

from __future__ import annotations

import io
import sys

import pytest

import pipeline.store.object_store
from pipeline.store.object_store import ObjectChangedError, ObjectStore
from tests.pipeline.calling import refused
from tests.pipeline.s3_server import URL, Server


def test_an_object_is_created_once_and_a_replacement_asks_for_the_tag_that_it_replaces(
    server: Server,
) -> None:
    store = ObjectStore.at(URL)
    store.create("a/b.txt", b"first")
    store.create("a/b.txt", b"second")
    found = store.get("a/b.txt")
    assert found is not None
    assert found[0] == b"first"
    assert store.get("a/c.txt") is None
    first = store.replace("current", b"one", None)
    second = store.replace("current", b"two", first)
    for stale in (None, first):
        with refused("object_store_conflict"):
            store.replace("current", b"three", stale)
    # One that landed unheard is no conflict.
    assert store.replace("current", b"two", first) == second
    assert store.get("current") == (b"two", second)


def test_a_listing_stays_in_its_folder(server: Server) -> None:
    store = ObjectStore.at(URL)
    for key in ("logs/M1/a.csv", "logs/M1/b.csv", "logs/M10/a.csv"):
        store.create(key, key.encode())
    listed = {one.key: one.size for one in store.list("logs/M1")}
    assert listed == {"logs/M1/a.csv": 13, "logs/M1/b.csv": 13}


def test_an_object_that_was_replaced_since_it_was_listed_is_not_read(server: Server) -> None:
    store = ObjectStore.at(URL)
    store.replace("log.csv", b"as listed", None)
    (listed,) = store.list()
    stream = io.BytesIO()
    store.fetch(listed, stream)
    assert stream.getvalue() == b"as listed"
    store.replace("log.csv", b"another", listed.tag)
    with pytest.raises(ObjectChangedError):
        store.fetch(listed, io.BytesIO())
    store.remove(["log.csv", "never.there"])
    with pytest.raises(ObjectChangedError):
        store.fetch(listed, io.BytesIO())


def test_a_request_that_fails_once_is_sent_again(server: Server) -> None:
    store, failures = ObjectStore.at(URL), [True]
    server.fails = lambda asked: asked.method == "PUT" and bool(failures) and failures.pop()
    store.create("a", b"content")
    assert store.get("a") is not None
    assert len(server.asked("PUT")) == 2  # the one that failed, and the one that did not
    for method, code in (("PUT", "store_write"), ("GET", "store_read")):
        server.fails = lambda asked, method=method: asked.method == method
        with refused(code, "503"):
            store.create("a", b"content") if method == "PUT" else store.get("a")


def test_a_bucket_that_is_missing_is_named(server: Server) -> None:
    store = ObjectStore.at("s3://nowhere/folder")
    for request in (
        lambda: store.get("a"),
        lambda: store.create("a", b""),
        lambda: store.replace("a", b"", None),
        lambda: list(store.list()),
    ):
        with refused("object_store_bucket", "s3://nowhere/folder"):
            request()


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("s3://b/x", ""),
        ("az://b/x", "AZURE_STORAGE_ACCOUNT_KEY"),
        ("gs://b/x", "GOOGLE_SKIP_SIGNATURE"),
    ],
)
def test_without_credentials_in_the_environment_nothing_is_asked(
    monkeypatch: pytest.MonkeyPatch, url: str, name: str
) -> None:
    """With them Azure and Google have the same client."""
    for names in pipeline.store.object_store.CREDENTIALS.values():
        for one in names:
            monkeypatch.delenv(one, raising=False)
    with refused("object_store_credentials", "expected one of "):
        ObjectStore.at(url)
    if name:
        monkeypatch.setenv(name, "a2V5" if name.endswith("KEY") else "1")
        monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_NAME", "account")
        assert ObjectStore.at(url).url == url


def test_without_the_extra_or_encryption_the_message_says_what_to_do(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "obstore.store", None)
        with refused("object_store_missing", "motor-leakage[s3]"):
            ObjectStore.at(URL)
    monkeypatch.delenv("AWS_ALLOW_HTTP")
    with refused("object_store_http", "AWS_ENDPOINT_URL is http://127.0.0.1:"):
        ObjectStore.at(URL)
    monkeypatch.setenv("AWS_ALLOW_HTTP", "true")
    assert ObjectStore.at(URL).get("nothing") is None
