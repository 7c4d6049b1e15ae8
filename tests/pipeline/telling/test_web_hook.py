"""A web hook over real sockets: its posts, redirects and deadline."""

from __future__ import annotations

import base64
import hashlib
import hmac
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from pipeline.telling.delivery import Delivery, UndeliveredError
from pipeline.telling.web_hook import WebHook
from tests.pipeline.telling.servers import Hook, hook, raw

SECRET = "${HOOK_SECRET}"  # noqa: S105
DELIVERY = Delivery("msg_17", '{"fleet": "ñ"}'.encode())


@pytest.fixture
def server() -> Iterator[Hook]:
    with hook() as found:
        yield found


def fault_of(url: str, deadline_s: float = 30.0, **settings: Any) -> UndeliveredError:
    with pytest.raises(UndeliveredError) as caught:
        WebHook(url, deadline_s=deadline_s, **settings).take(DELIVERY)
    assert "T0KEN" not in caught.value.why
    return caught.value


def test_the_delivery_is_posted_with_its_id_and_time(server: Hook) -> None:
    before = int(time.time())
    WebHook(server.url("/a?b=c")).take(DELIVERY)
    (post,) = server.posts
    assert (post.method, post.path, post.body) == ("POST", "/a?b=c", DELIVERY.content)
    assert post.headers["content-type"] == "application/json"
    assert post.headers["webhook-id"] == "msg_17"
    assert before <= int(post.headers["webhook-timestamp"]) <= time.time()
    assert "webhook-signature" not in post.headers


@pytest.mark.parametrize("prefix", ["", "whsec_"])
def test_it_is_signed_as_standard_webhooks_has_it(
    server: Hook, monkeypatch: pytest.MonkeyPatch, prefix: str
) -> None:
    key = bytes(range(32))
    monkeypatch.setenv("HOOK_SECRET", prefix + base64.b64encode(key).decode())
    WebHook(server.url(), secret=SECRET).take(DELIVERY)
    (post,) = server.posts
    signed = b".".join([b"msg_17", post.headers["webhook-timestamp"].encode(), post.body])
    expected = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    assert post.headers["webhook-signature"] == f"v1,{expected}"


def test_headers_come_with_their_environment_variables(
    server: Hook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOOK_TOKEN", "abc.d$e${f}")
    headers = {"Authorization": "Bearer ${HOOK_TOKEN}", "X-Plant": "3"}
    WebHook(server.url(), headers).take(DELIVERY)
    (post,) = server.posts
    assert post.headers["authorization"] == "Bearer abc.d$e${f}"
    assert post.headers["x-plant"] == "3"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "environment variable HOOK_TOKEN of alarms.webhook_headers is not set"),
        ("", "HOOK_TOKEN of alarms.webhook_headers is not set"),
        ("T0KEN\r\nX-Other: 1", "holds characters that no header may have"),
        ("T0KENñ", "holds characters that no header may have"),
    ],
)
def test_a_variable_that_is_none_is_named(
    server: Hook, monkeypatch: pytest.MonkeyPatch, content: str | None, words: str
) -> None:
    if content is not None:
        monkeypatch.setenv("HOOK_TOKEN", content)
    fault = fault_of(server.url(), headers={"Authorization": "Bearer ${HOOK_TOKEN}"})
    assert words in fault.why
    assert server.posts == []


def test_a_secret_that_is_no_base64_is_named(server: Hook, monkeypatch: pytest.MonkeyPatch) -> None:
    for content in ("T0KEN!", "whsec_", "T0KEN"):
        monkeypatch.setenv("HOOK_SECRET", content)
        fault = fault_of(server.url(), secret=SECRET)
        assert fault.why == "the secret of alarms.webhook_secret is no Base64"
    assert server.posts == []


@pytest.mark.parametrize("status", [307, 308])
def test_a_redirect_within_the_place_keeps_method_body_and_headers(
    server: Hook, status: int
) -> None:
    for to in (server.url("/new?x=1"), "/new?x=1"):
        server.answers["/hook"] = (status, to)
        WebHook(server.url(), {"X-Plant": "3"}).take(DELIVERY)
        first, second = server.posts[-2:]
        assert (second.method, second.path, second.body) == ("POST", "/new?x=1", DELIVERY.content)
        assert second.headers == first.headers


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_nothing_goes_to_another_place(server: Hook, status: int) -> None:
    with hook() as other:
        for location in (
            other.url("/T0KEN"),
            f"https://127.0.0.1:{server.port}/T0KEN",
            f"http://localhost:{server.port}/T0KEN",
            f"//127.0.0.1:{other.port}/T0KEN",
            "file:///etc/T0KEN",
            "http://[T0KEN",
        ):
            server.answers["/hook"] = (status, location)
            fault_of(server.url())
        assert other.posts == []
    if status < 304:  # nor are they followed within the place
        server.answers["/hook"] = (status, server.url("/T0KEN"))
        why = fault_of(server.url()).why
        assert why.startswith(f"HTTP {status} ")
        assert why.endswith("; only 307 and 308 are followed, within scheme, host and port")
    assert {post.path for post in server.posts} == {"/hook"}


def test_a_circle_of_redirects_ends(server: Hook) -> None:
    server.answers["/hook"] = (307, "/hook")
    assert fault_of(server.url()).why.startswith("HTTP 307 ")


def test_any_answer_of_200_to_299_is_a_yes_and_any_other_a_no(server: Hook) -> None:
    for status in (204, 299):
        server.answers["/hook"] = (status, "")
        WebHook(server.url()).take(DELIVERY)
    for status, words in ((404, " Not Found"), (500, " Internal Server Error"), (599, "")):
        server.answers["/hook?T0KEN"] = (status, "")
        fault = fault_of(server.url("/hook?T0KEN"))
        assert (fault.why, fault.hung) == (f"HTTP {status}{words}", False)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        *((one, "answer is no HTTP") for one in (b"", b"T0KEN\r\n\r\n", b"HTTP/1.1 \r\n\r\n")),
        (b"\x1b[2J\n\n", "answer is no HTTP"),
        (b"HTTP/1.1 404 nothing at /T0KEN?key=T0KEN\r\n\r\n", "HTTP 404 Not Found"),
    ],
)
def test_words_of_the_server_are_not_told(answer: bytes, words: str) -> None:
    with raw(lambda connection, _: connection.sendall(answer)) as url:
        assert words in fault_of(url).why


def test_nobody_there_and_a_server_that_does_not_speak_tls(server: Hook) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/T0KEN"
        assert fault_of(url).why == "Connection refused"
    assert "SSL" in fault_of(f"https://127.0.0.1:{server.port}/T0KEN").why


def silent(_: socket.socket, over: threading.Event) -> None:
    over.wait(30)


def drip(connection: socket.socket, over: threading.Event) -> None:
    """A header that never ends, a byte at a time: each read of it is in time."""
    connection.sendall(b"HTTP/1.1 200 OK\r\nX-Long: ")
    while not over.wait(0.02):
        connection.sendall(b"x")


@pytest.mark.parametrize("talk", [silent, drip])
def test_the_deadline_is_for_all_of_it(talk: Any) -> None:
    with raw(talk) as url:
        fault = fault_of(url, 0.3)
    assert (fault.why, fault.hung) == ("no answer within 0.3 s", True)


def test_a_name_that_nobody_looks_up_is_in_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    over = threading.Event()

    def hang(*_: object, **__: object) -> Any:
        over.wait(30)
        raise OSError

    monkeypatch.setattr(socket, "getaddrinfo", hang)
    assert fault_of("http://hook.invalid/T0KEN", 0.1).hung
    over.set()


def test_a_body_that_never_ends_is_not_read() -> None:
    def endless(connection: socket.socket, over: threading.Event) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
        silent(connection, over)

    with raw(endless) as url:
        WebHook(url).take(DELIVERY)


@pytest.mark.parametrize(
    ("url", "label"),
    [
        ("https://h.example/T0KEN?T0KEN", "alarms.webhook_url (https://h.example:443)"),
        ("http://H.example:81/T0KEN", "alarms.webhook_url (http://h.example:81)"),
        ("http://[::1]/T0KEN", "alarms.webhook_url (http://[::1]:80)"),
    ],
)
def test_people_see_scheme_host_and_port_of_it(url: str, label: str) -> None:
    assert WebHook(url).label == label
    assert "T0KEN" not in repr(WebHook(url, {"X": "T0KEN"}))
