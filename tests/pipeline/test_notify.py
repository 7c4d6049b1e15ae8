"""A command or a web hook is told of changes of state; nothing of it costs anybody the run."""

from __future__ import annotations

import datetime as dt
import json
import socket
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pytest

from pipeline import notify as module
from pipeline.config import Alarms
from pipeline.notify import notify

ROW = {
    "motor_id": "M1; rm -rf $HOME `id` \"'\\ ñ",
    "night": dt.date(2026, 2, 17),
    "time": dt.datetime(2026, 2, 17, 6, tzinfo=dt.UTC),
    "indicator": "K_piston_ring",
    "to_state": "alarm",
    "reason": "piston ring leakage +27 % [25, 29] since 1 February 2026\r\nX-Other: header",
    "deviation_percent": 27.0,
    "path": None,
}
# Writes what it gets, and what it was called with.
RECEIVER = "import sys; open(sys.argv[1], 'wb').write(sys.stdin.buffer.read())"


class Receiver(BaseHTTPRequestHandler):
    """Keeps what is posted to it."""

    status = 200
    posted: ClassVar[list[tuple[str, bytes]]]

    def do_POST(self) -> None:
        length = int(self.headers["Content-Length"])
        self.posted.append((self.headers["Content-Type"], self.rfile.read(length)))
        self.send_response(self.status)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def receiver(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, type[Receiver]]]:
    class Own(Receiver):
        posted: ClassVar[list[tuple[str, bytes]]] = []

    with HTTPServer(("127.0.0.1", 0), Own) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/hook", Own
        server.shutdown()
        thread.join()


def expected() -> dict[str, Any]:
    changes = [{**ROW, "night": "2026-02-17", "time": "2026-02-17 06:00:00+00:00"}]
    return {"fleet": "Mill", "changes": changes}


def test_a_command_gets_the_rows_and_no_shell_sees_them(tmp_path: Path) -> None:
    target = tmp_path / "got; $(id).json"
    settings = Alarms(command=(sys.executable, "-c", RECEIVER, str(target)))
    assert notify(settings, "Mill", [ROW]) == ()
    assert json.loads(target.read_bytes()) == expected()


def test_a_web_hook_gets_them_too(receiver: tuple[str, type[Receiver]]) -> None:
    url, server = receiver
    assert notify(Alarms(webhook_url=url), "Mill", [ROW]) == ()
    ((kind, content),) = server.posted
    assert kind == "application/json"
    assert json.loads(content) == expected()


def test_without_a_change_nobody_is_told(
    tmp_path: Path, receiver: tuple[str, type[Receiver]]
) -> None:
    target = tmp_path / "got"
    settings = Alarms(
        command=(sys.executable, "-c", RECEIVER, str(target)), webhook_url=receiver[0]
    )
    assert notify(settings, "Mill", []) == ()
    assert not target.exists()
    assert receiver[1].posted == []


def test_both_are_off_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr(module.subprocess, "run", forbidden)
    monkeypatch.setattr(module.urllib.request, "urlopen", forbidden)
    assert notify(Alarms(), "Mill", [ROW]) == ()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("/no/such/program",), "No such file or directory"),
        ((sys.executable, "-c", "import sys; sys.exit('no ink')"), "ended with 1: no ink"),
        ((sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"), "ended with -9"),
        ((sys.executable, "-c", "a\0b"), "embedded null byte"),
    ],
)
def test_a_command_that_fails_is_a_fault_in_words(command: tuple[str, ...], words: str) -> None:
    (fault,) = notify(Alarms(command=command), "Mill", [ROW])
    assert fault.startswith("alarms.command")
    assert words in fault


def test_a_command_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TIMEOUT_S", 0.2)
    (fault,) = notify(
        Alarms(command=(sys.executable, "-c", "import time; time.sleep(60)")), "Mill", [ROW]
    )
    assert "timed out after 0.2 seconds" in fault


def test_a_receiver_that_is_not_there_or_refuses(receiver: tuple[str, type[Receiver]]) -> None:
    url, server = receiver
    server.status = 500
    (fault,) = notify(Alarms(webhook_url=url), "Mill", [ROW])
    assert fault == "alarms.webhook_url: HTTP Error 500: Internal Server Error"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nobody = f"http://127.0.0.1:{free.getsockname()[1]}/"
    (fault,) = notify(Alarms(webhook_url=nobody), "Mill", [ROW])
    assert "Connection refused" in fault


@pytest.mark.parametrize("answer", [b"", b"no protocol at all\r\n\r\n", b"HTTP/1.1 \r\n\r\n"])
def test_a_receiver_that_answers_nonsense(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def once() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(65536)
                connection.sendall(answer)

        thread = threading.Thread(target=once)
        thread.start()
        url = f"http://127.0.0.1:{server.getsockname()[1]}/"
        (fault,) = notify(Alarms(webhook_url=url), "Mill", [ROW])
        thread.join()
    assert fault.startswith("alarms.webhook_url: ")
    assert len(fault) > len("alarms.webhook_url: ")


@pytest.mark.parametrize("url", ["http://", "http://a b/", "http://[::1", "http://h:port/"])
def test_an_address_that_is_none(url: str) -> None:
    (fault,) = notify(Alarms(webhook_url=url), "Mill", [ROW])
    assert fault.startswith("alarms.webhook_url: ")


def test_one_that_fails_does_not_keep_the_other(tmp_path: Path) -> None:
    target = tmp_path / "got"
    command = (sys.executable, "-c", RECEIVER, str(target))
    faults = notify(Alarms(command=command, webhook_url="http://"), "Mill", [ROW])
    assert len(faults) == 1
    assert json.loads(target.read_bytes()) == expected()
