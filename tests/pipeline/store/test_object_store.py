"""The client of an object store, against a server on loopback."""

from __future__ import annotations

import pytest

from pipeline.store.object_store import CREDENTIALS, ObjectStore
from tests.pipeline.calling import refused
from tests.pipeline.s3_server import URL, Server


def test_a_request_that_fails_once_is_sent_again(server: Server) -> None:
    store, failures = ObjectStore.at(URL), [True]
    server.fails = lambda asked: asked.method == "PUT" and bool(failures) and failures.pop()
    store.put("a", b"content")
    assert len(server.asked("PUT")) == 2  # the one that failed, and the one that did not
    server.fails = lambda asked: asked.method == "GET"
    with refused("store_read", "503"):
        store.get("a")


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("s3://b/x", ""),
        ("az://b/x", "AZURE_STORAGE_ACCOUNT_KEY"),
        ("gs://b/x", "GOOGLE_SKIP_SIGNATURE"),
    ],
)
def test_without_credentials_in_the_environment_no_request_is_sent(
    monkeypatch: pytest.MonkeyPatch, url: str, name: str
) -> None:
    """With them Azure and Google have the same client."""
    for variables in CREDENTIALS.values():
        for variable in variables:
            monkeypatch.delenv(variable, raising=False)
    with refused("object_store_credentials", "expected one of "):
        ObjectStore.at(url)
    if name:
        monkeypatch.setenv(name, "a2V5" if name.endswith("KEY") else "1")
        monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_NAME", "account")
        assert ObjectStore.at(url).url == url


def test_without_encryption_the_message_says_what_to_do(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AWS_ALLOW_HTTP")
    with refused("object_store_http", "AWS_ENDPOINT_URL is http://127.0.0.1:"):
        ObjectStore.at(URL)
    monkeypatch.setenv("AWS_ALLOW_HTTP", "true")
    assert ObjectStore.at(URL).get("nothing") is None
