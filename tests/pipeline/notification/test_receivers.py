"""A command and a web hook, over real processes and sockets, take deliveries or say why not."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from pipeline.notification.delivery import Command, Delivery, Receiver, UndeliveredError, WebHook
from tests.pipeline.notification.servers import Hook, hook, raw

CONTENT = '{"reason": "; rm -rf $HOME `id` ñ"}'.encode()
DELIVERY = Delivery("msg_17", CONTENT)
# Writes what it gets to the file that it is called with.
KEEP = "import sys; open(sys.argv[1], 'wb').write(sys.stdin.buffer.read())"


def refusal(receiver: Receiver) -> UndeliveredError:
    with pytest.raises(UndeliveredError) as caught:
        receiver.take(DELIVERY)
    assert "T0KEN" not in caught.value.why
    return caught.value


def shell(script: str, *arguments: str | Path) -> tuple[str, ...]:
    return ("/bin/sh", "-c", script, "sh", *map(str, arguments))


def test_a_command_gets_the_delivery_on_its_standard_input_and_need_not_read_it(
    tmp_path: Path,
) -> None:
    target = tmp_path / "got; $(id).json"
    Command((sys.executable, "-c", KEEP, str(target))).take(DELIVERY)
    assert target.read_bytes() == CONTENT
    assert [path.name for path in tmp_path.iterdir()] == [target.name]
    Command(shell("exit 0")).take(Delivery("msg_1", b"x" * 10_000_000))


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("/no/such/program",), "No such file or directory"),
        (shell("echo no ink >&2; exit 3"), "ended with 3: no ink"),
        (shell("kill -9 $$"), "ended with -9"),
        (("/bin/sh", "-c", "a\0b"), "embedded null byte"),
        (shell("printf 'a\\033[2J\\nb%9000d' 1 >&2; exit 3"), "ended with 3: "),
    ],
)
def test_a_command_that_fails_has_not_taken_it(command: tuple[str, ...], words: str) -> None:
    fault = refusal(Command(command))
    assert words in fault.why
    assert fault.why.isprintable()
    assert len(fault.why) < 1000
    assert not fault.hung


def test_only_the_end_of_the_command_itself_is_waited_for(tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    Command(shell('sleep 600 & echo $! > "$1"', pid)).take(DELIVERY)
    os.kill(int(pid.read_text()), signal.SIGKILL)  # it ran on all the while
    fault = refusal(Command(shell('sleep 600 & echo $! > "$1"; wait', pid), 0.5))
    assert (fault.why, fault.hung) == ("did not end within 0.5 s and was killed", True)
    try:  # with its children
        child = psutil.Process(int(pid.read_text()))
        assert psutil.wait_procs([child], timeout=10)[1] == [] or child.status() == "zombie"
    except psutil.NoSuchProcess:
        pass


@pytest.fixture
def server() -> Iterator[Hook]:
    with hook() as server:
        yield server


TOKEN = {"headers": {"Authorization": "Bearer ${HOOK}"}}
NOT_SET = "environment variable HOOK of alarms.webhook_headers is not set"
NO_HEADER = "environment variable HOOK of alarms.webhook_headers holds characters that no header"
NO_BASE64 = "the secret of alarms.webhook_secret is no Base64"


@pytest.mark.parametrize(
    ("settings", "content", "words"),
    [
        (TOKEN, None, NOT_SET),
        (TOKEN, "", NOT_SET),
        (TOKEN, "T0KEN\r\nX-Other: 1", NO_HEADER),
        (TOKEN, "T0KENñ", NO_HEADER),
        *(({"secret": "${HOOK}"}, secret, NO_BASE64) for secret in ("T0KEN!", "whsec_", "T0KEN")),
    ],
)
def test_a_variable_that_is_none_is_named(
    server: Hook,
    monkeypatch: pytest.MonkeyPatch,
    settings: dict[str, Any],
    content: str | None,
    words: str,
) -> None:
    if content is not None:
        monkeypatch.setenv("HOOK", content)
    assert refusal(WebHook(server.url(), **settings)).why.startswith(words)
    assert server.posts == []


@pytest.mark.parametrize("status", [301, 307])
def test_no_redirect_is_followed(server: Hook, status: int) -> None:
    with hook() as other:
        for location in (server.url("/T0KEN"), other.url("/T0KEN"), "file:///etc/T0KEN"):
            server.answers["/hook"] = (status, location)
            why = refusal(WebHook(server.url())).why
            assert why.startswith(f"HTTP {status} ")
            assert why.endswith("; redirects are not followed")
        assert other.posts == []
    assert {post.path for post in server.posts} == {"/hook"}


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b"HTTP/1.1 204 \r\n\r\n", ""),
        (b"HTTP/1.1 299 \r\n\r\n", ""),
        (b"HTTP/1.1 404 nothing at /T0KEN?key=T0KEN\r\n\r\n", "HTTP 404 Not Found"),
        (b"HTTP/1.1 599 \r\n\r\n", "HTTP 599"),
        (b"", "answer is no HTTP"),
        (b"T0KEN\r\n\r\n", "answer is no HTTP"),
        (b"\x1b[2J\n\n", "answer is no HTTP"),
    ],
)
def test_only_an_answer_of_200_to_299_is_a_yes_and_its_words_are_not_reported(
    answer: bytes, words: str
) -> None:
    with raw(lambda connection, _: connection.sendall(answer)) as url:
        if not words:
            WebHook(url).take(DELIVERY)
            return
        fault = refusal(WebHook(url))
    assert words in fault.why
    assert not fault.hung


def test_nobody_there(server: Hook) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        receiver = WebHook(f"http://127.0.0.1:{free.getsockname()[1]}/T0KEN", {"X": "T0KEN"})
        assert refusal(receiver).why == "Connection refused"
    assert receiver.label == f"alarms.webhook_url ({receiver.url.removesuffix('/T0KEN')})"
    assert "T0KEN" not in repr(receiver)
    assert "SSL" in refusal(WebHook(f"https://127.0.0.1:{server.port}/T0KEN")).why


def drip(connection: socket.socket, over: threading.Event) -> None:
    """A header that never ends, a byte at a time: each read of it is in time."""
    connection.sendall(b"HTTP/1.1 200 OK\r\nX-Long: ")
    while not over.wait(0.02):
        connection.sendall(b"x")


def test_the_deadline_is_for_all_of_it() -> None:
    with raw(drip) as url:
        fault = refusal(WebHook(url, deadline_s=0.3))
    assert (fault.why, fault.hung) == ("no answer within 0.3 s", True)
