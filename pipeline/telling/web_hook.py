"""A web hook as a receiver: one POST a delivery, signed as Standard Webhooks 1.0 has it.

The specification: https://github.com/standard-webhooks/standard-webhooks, version 1.0.0.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import http.client
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from email.message import Message
from http import HTTPStatus
from typing import IO
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from pipeline.telling.delivery import (
    DEADLINE_S,
    Delivery,
    UndeliveredError,
    fault_words,
    filled,
    talk,
)

SECRET_PREFIX = "whsec_"  # noqa: S105 - how the specification marks one
DEFAULT_PORTS = {"http": 80, "https": 443}
# Those that keep method and body.
FOLLOWED = (HTTPStatus.TEMPORARY_REDIRECT, HTTPStatus.PERMANENT_REDIRECT)


@dataclass(frozen=True, slots=True)
class WebHook:
    """An address that deliveries are posted to; any answer of 200 to 299 says that it took one."""

    # url, headers, secret: as `[alarms]` states them, with environment variables as ``${NAME}``.
    url: str = field(repr=False)
    headers: Mapping[str, str] = field(default_factory=dict, repr=False)
    secret: str = ""
    deadline_s: float = DEADLINE_S
    name: str = "webhook"

    @property
    def label(self) -> str:
        """Scheme, host and port: a path or query may hold a token."""
        scheme, host, port = _place(self.url)
        shown = f"[{host}]" if ":" in host else host
        return f"alarms.webhook_url ({scheme}://{shown}:{port})"

    def take(self, delivery: Delivery) -> None:
        """Post it."""
        headers = {
            "User-Agent": "motor-leakage",
            **{name: filled("webhook_headers", text) for name, text in self.headers.items()},
            "Content-Type": "application/json",
            **self._of_standard(delivery, int(time.time())),
        }
        request = Request(self.url, delivery.content, headers, method="POST")  # noqa: S310
        talk(lambda: _post(request, 2 * self.deadline_s), _words, self.deadline_s)

    def _of_standard(self, delivery: Delivery, now: int) -> dict[str, str]:
        """The headers of the specification."""
        headers = {"webhook-id": delivery.id, "webhook-timestamp": str(now)}
        if self.secret:
            key = signing_key(filled("webhook_secret", self.secret))
            headers["webhook-signature"] = signature(key, delivery.id, now, delivery.content)
        return headers


def signature(key: bytes, delivery_id: str, timestamp: int, content: bytes) -> str:
    """HMAC-SHA256 over id, time and body, as receivers expect it.

    Examples
    --------
    The example of the specification's own libraries:

    >>> key = signing_key("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw")
    >>> signature(key, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    'v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE='
    """
    signed = f"{delivery_id}.{timestamp}.".encode() + content
    return "v1," + base64.b64encode(hmac.digest(key, signed, hashlib.sha256)).decode()


def signing_key(secret: str) -> bytes:
    """The key in a secret.

    Raises UndeliveredError if it is no Base64.
    """
    text = secret.removeprefix(SECRET_PREFIX)
    try:
        key = base64.b64decode(text + "=" * (-len(text) % 4), validate=True)
    except (binascii.Error, ValueError):
        key = b""
    if not key:
        raise UndeliveredError("the secret of alarms.webhook_secret is no Base64")
    return key


class _SamePlace(HTTPRedirectHandler):
    """Follows a redirect that keeps method and body and leads to the same scheme, host and port."""

    def redirect_request(
        self,
        req: Request,
        fp: IO[bytes],
        code: int,
        msg: str,  # noqa: ARG002
        headers: Message,  # noqa: ARG002
        newurl: str,
    ) -> Request | None:
        """The request again, for the new address; None: the redirect is an answer like others."""
        if code not in FOLLOWED or _place(newurl) != _place(req.full_url):
            return None
        fp.close()  # or else all that comes with it is read
        return Request(newurl, req.data, req.headers, method="POST")  # noqa: S310


def _place(url: str) -> tuple[str, str, int | None]:
    """Scheme, host and port."""
    parts = urlsplit(url)
    return parts.scheme, parts.hostname or "", parts.port or DEFAULT_PORTS.get(parts.scheme)


def _post(request: Request, timeout_s: float) -> str:
    with build_opener(_SamePlace).open(request, timeout=timeout_s):
        return ""


def _status_words(code: int) -> str:
    known = code in {status.value for status in HTTPStatus}
    words = f"HTTP {code} {HTTPStatus(code).phrase}" if known else f"HTTP {code}"
    if code // 100 == 3:
        words += "; only 307 and 308 are followed, within scheme, host and port"
    return words


def _words(error: Exception) -> str:
    if isinstance(error, HTTPError):
        error.close()
        return _status_words(error.code)
    reason = error.reason if isinstance(error, URLError) else error
    if isinstance(reason, http.client.HTTPException):
        return f"the answer is no HTTP ({type(reason).__name__})"
    return fault_words(reason)
