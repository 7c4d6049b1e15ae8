"""An S3-compatible server on loopback whose requests can be made to fail."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest
from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import make_server

from pipeline.store.object_store import ObjectStore

SIGNATURE = "AWS4-HMAC-SHA256 Credential=a/20260101/us-east-1/s3/aws4_request, Signature=x"


@dataclass(frozen=True, slots=True)
class Request:
    method: str
    path: str


def never(_: Request) -> bool:
    return False


@dataclass(slots=True)
class Server:
    """The server, what was asked of it, and what it is to refuse."""

    requests: list[Request] = field(default_factory=list)
    fails: Callable[[Request], bool] = never
    before: Callable[[Request], object] = never
    port: int = 0
    app: Any = None

    def __call__(self, environ: Any, start_response: Any) -> Any:
        request = Request(environ["REQUEST_METHOD"], environ["PATH_INFO"])
        self.requests.append(request)
        self.before(request)
        if self.fails(request):
            # The body has to be taken, or the client is cut off.
            environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
            start_response("503 Slow Down", [("Content-Length", "0")])
            return [b""]
        return self.app(environ, start_response)

    def asked(self, method: str) -> list[str]:
        return [request.path for request in self.requests if request.method == method]

    def forget(self) -> None:
        self.requests.clear()


@contextmanager
def s3_server(monkeypatch: pytest.MonkeyPatch, bucket: str) -> Iterator[Server]:
    """A server with a bucket, and the environment that leads to it."""
    found = Server(app=DomainDispatcherApplication(create_backend_app))
    server = make_server("127.0.0.1", 0, found, threaded=True)
    server.log = lambda *_: None  # type: ignore[method-assign]
    server.RequestHandlerClass.log = lambda *_: None  # type: ignore[attr-defined]
    # Looked at this often whether it is to end [s].
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    found.port = server.server_port
    try:
        environment = {"ACCESS_KEY_ID": "a", "SECRET_ACCESS_KEY": "b", "REGION": "us-east-1"}
        environment |= {"ENDPOINT_URL": f"http://127.0.0.1:{found.port}", "ALLOW_HTTP": "true"}
        for name, value in environment.items():
            monkeypatch.setenv(f"AWS_{name}", value)
        _make_bucket(found.port, bucket)
        yield found
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def _make_bucket(port: int, bucket: str) -> None:
    """A new bucket, and nothing of what tests before had left."""
    for method, path in (("POST", "/moto-api/reset"), ("PUT", f"/{bucket}")):
        connection = HTTPConnection("127.0.0.1", port)
        connection.request(method, path, headers={"Authorization": SIGNATURE})
        assert connection.getresponse().status == 200
        connection.close()


def upload(folder: Path, url: str) -> None:
    """Put all files of a folder below a URL."""
    store = ObjectStore.at(url)
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            store.create(path.relative_to(folder).as_posix(), path.read_bytes())
