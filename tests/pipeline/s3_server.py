"""A small S3 server on loopback whose requests can be made to fail.

What the clients ask for: buckets by their path, objects with tags, conditional gets, byte ranges,
listings in one page, removals of many at once.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import parse_qs, unquote, urlsplit
from xml.etree import ElementTree as ET

import pytest

import pipeline.store.object_store
from pipeline.store.object_store import ObjectStore

BUCKET = "tests"
URL = f"s3://{BUCKET}/fleet"
S3 = "{http://s3.amazonaws.com/doc/2006-03-01/}"


@dataclass(frozen=True, slots=True)
class Request:
    method: str
    path: str


@dataclass(frozen=True, slots=True)
class Stored:
    content: bytes
    put_on: int  # seconds on the server's clock

    @property
    def tag(self) -> str:
        return f'"{hashlib.md5(self.content, usedforsecurity=False).hexdigest()}"'


def never(_: Request) -> bool:
    return False


@dataclass(slots=True)
class Server:
    """The server, what it holds and was asked, and what it is to refuse."""

    objects: dict[str, Stored] = field(default_factory=dict)
    requests: list[Request] = field(default_factory=list)
    fails: Callable[[Request], bool] = never
    before: Callable[[Request], object] = never
    clock: Iterator[int] = field(default_factory=itertools.count)
    port: int = 0
    lock: Any = field(default_factory=threading.Lock)

    def asked(self, method: str) -> list[str]:
        return [request.path for request in self.requests if request.method == method]

    def forget(self) -> None:
        self.requests.clear()

    def below(self, url: str) -> dict[str, bytes]:
        """Content of all objects below a URL, by path."""
        folder = url.removeprefix(f"s3://{BUCKET}/") + "/"
        return {
            key.removeprefix(folder): stored.content
            for key, stored in sorted(self.objects.items())
            if key.startswith(folder)
        }


class Handler(BaseHTTPRequestHandler):
    """One request. Answers are a status, a body and headers."""

    protocol_version = "HTTP/1.1"
    served: ClassVar[Server]

    def log_message(self, *_: object) -> None:
        pass

    def do(self) -> None:
        # The body has to be taken, or the client is cut off.
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        place = urlsplit(self.path)
        request = Request(self.command, unquote(place.path))
        self.served.requests.append(request)
        self.served.before(request)
        bucket, _, key = request.path.removeprefix("/").partition("/")
        if self.served.fails(request):
            self._answer(503)
        elif bucket != BUCKET:
            self._answer(404, b"<Error><Code>NoSuchBucket</Code></Error>")
        else:
            with self.served.lock:
                self._serve(key, parse_qs(place.query, keep_blank_values=True), body)

    do_GET = do_HEAD = do_PUT = do_POST = do  # noqa: N815

    def _serve(self, key: str, query: dict[str, list[str]], body: bytes) -> None:
        objects = self.served.objects
        if self.command == "PUT":
            objects[key] = Stored(body, next(self.served.clock))
            self._answer(200, ETag=objects[key].tag)
        elif self.command == "POST":
            self._remove([key.text or "" for key in ET.fromstring(body).iter(S3 + "Key")])  # noqa: S314
        elif not key:
            self._list(query.get("prefix", [""])[0])
        elif (found := objects.get(key)) is None:
            self._answer(404, b"<Error><Code>NoSuchKey</Code></Error>")
        else:
            self._get(found)

    def _get(self, found: Stored) -> None:
        headers = {"ETag": found.tag, "Last-Modified": formatdate(found.put_on, usegmt=True)}
        content, (begin, _, end) = found.content, self._range()
        if (wanted := self.headers.get("If-Match")) and wanted != found.tag:
            self._answer(412)
        elif not (begin or end):
            self._answer(200, content, **headers)
        else:
            first = int(begin) if begin else max(len(content) - int(end), 0)
            last = min(int(end), len(content) - 1) if begin and end else len(content) - 1
            of_all = f"bytes {first}-{last}/{len(content)}"
            self._answer(206, content[first : last + 1], **headers, **{"Content-Range": of_all})

    def _remove(self, keys: Sequence[str]) -> None:
        root = ET.Element("DeleteResult")
        for key in keys:
            self.served.objects.pop(key, None)
            ET.SubElement(ET.SubElement(root, "Deleted"), "Key").text = key
        self._answer(200, ET.tostring(root))

    def _range(self) -> tuple[str, str, str]:
        return self.headers.get("Range", "").removeprefix("bytes=").partition("-")

    def _list(self, prefix: str) -> None:
        root = ET.Element("ListBucketResult")
        ET.SubElement(root, "IsTruncated").text = "false"
        for key, stored in sorted(self.served.objects.items()):
            if not key.startswith(prefix):
                continue
            found = ET.SubElement(root, "Contents")
            said = {"Key": key, "Size": str(len(stored.content)), "ETag": stored.tag}
            said["LastModified"] = f"{dt.datetime.fromtimestamp(stored.put_on, dt.UTC):%FT%TZ}"
            for name, text in said.items():
                ET.SubElement(found, name).text = text
        self._answer(200, ET.tostring(root))

    def _answer(self, status: int, body: bytes = b"", **headers: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


@contextmanager
def s3_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """A server with an empty bucket, and the environment that leads to it."""
    monkeypatch.setattr(pipeline.store.object_store, "RETRIES", 1)
    found = Server()
    handler = type("Handler", (Handler,), {"served": found})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.daemon_threads = True
        # Looked at this often whether it is to end [s].
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        found.port = server.server_port
        environment = {"ACCESS_KEY_ID": "a", "SECRET_ACCESS_KEY": "b", "REGION": "us-east-1"}
        environment |= {"ENDPOINT_URL": f"http://127.0.0.1:{found.port}", "ALLOW_HTTP": "true"}
        for name, value in environment.items():
            monkeypatch.setenv(f"AWS_{name}", value)
        yield found
        server.shutdown()
        thread.join()


def upload(folder: Path, url: str) -> None:
    """Put all files of a folder below a URL."""
    store = ObjectStore.at(url)
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            store.put(path.relative_to(folder).as_posix(), path.read_bytes())
