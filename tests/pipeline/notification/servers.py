"""Receivers: a command that keeps what it gets, servers on loopback, and some that take nothing."""

from __future__ import annotations

import http.client
import http.server
import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


def keep(path: Path) -> str:
    """A command that appends each delivery to a file, as a line."""
    script = 'cat >> "$0"; echo >> "$0"'
    return f"command = {json.dumps(['/bin/sh', '-c', script, str(path)])}"


def delivered(folder: Path) -> list[dict[str, Any]]:
    """Deliveries in the file `told` of a folder."""
    path = folder / "told"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


@dataclass(frozen=True)
class Post:
    """A request as it came."""

    method: str
    path: str
    headers: dict[str, str]
    body: bytes


@dataclass
class Hook:
    """A server that keeps what is posted to it."""

    port: int = 0
    posts: list[Post] = field(default_factory=list)
    # By path, status and Location of the answer; 200 where there is none.
    answers: dict[str, tuple[int, str]] = field(default_factory=dict)

    def url(self, path: str = "/hook") -> str:
        return f"http://127.0.0.1:{self.port}{path}"


@contextmanager
def hook() -> Iterator[Hook]:
    web = Hook()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            headers = {name.lower(): value for name, value in self.headers.items()}
            web.posts.append(Post(self.command, self.path, headers, body))
            status, location = web.answers.get(self.path, (200, ""))
            self.send_response(status)
            if location:
                self.send_header("Location", location)
            self.end_headers()

        do_GET = do_POST  # noqa: N815 - as the base class calls it

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        web.port = server.server_port
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield web
        finally:  # or else a test that fails never ends
            server.shutdown()
            thread.join()


@contextmanager
def raw(talk: Callable[[socket.socket, threading.Event], None]) -> Iterator[str]:
    """A server that does as it likes with its first connection; its URL."""
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def once() -> None:
            connection, _ = server.accept()
            with connection:
                _read_request(connection)
                talk(connection, over)

        thread = threading.Thread(target=once, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}/T0KEN?key=T0KEN"
        over.set()
        thread.join()


def _read_request(connection: socket.socket) -> None:
    """To its end: what is left unread would reset the connection when it is closed."""
    with connection.makefile("rb") as request:
        request.readline()
        request.read(int(http.client.parse_headers(request).get("Content-Length", 0)))
