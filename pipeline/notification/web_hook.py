"""A web hook as a receiver: a POST for each delivery, signed as Standard Webhooks 1.0 has it.

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
from functools import partial
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from pipeline.notification.delivery import (
    DEADLINE_S,
    Delivery,
    UndeliveredError,
    fault_words,
    filled,
    talk,
)

SECRET_PREFIX = "whsec_"  # noqa: S105 - how the specification marks a secret


@dataclass(frozen=True, slots=True)
class WebHook:
    """An address that deliveries are posted to; any answer of 200 to 299 says that it took it."""

    # url, headers, secret: as `[alarms]` states them, with environment variables as ``${NAME}``.
    url: str = field(repr=False)
    headers: Mapping[str, str] = field(default_factory=dict, repr=False)
    secret: str = ""
    deadline_s: float = DEADLINE_S
    name: str = "webhook"

    @property
    def label(self) -> str:
        """Scheme and host: a path or query may hold a token."""
        parts = urlsplit(self.url)
        return f"alarms.webhook_url ({parts.scheme}://{parts.netloc})"

    def take(self, delivery: Delivery) -> None:
        """Post it."""
        now = int(time.time())
        headers = {
            "User-Agent": "motor-leakage",
            **{name: filled("webhook_headers", text) for name, text in self.headers.items()},
            "Content-Type": "application/json",
            "webhook-id": delivery.id,
            "webhook-timestamp": str(now),
        }
        if self.secret:
            key = signing_key(filled("webhook_secret", self.secret))
            headers["webhook-signature"] = signature(key, delivery.id, now, delivery.content)
        request = Request(self.url, delivery.content, headers, method="POST")  # noqa: S310
        post = partial(build_opener(_Nowhere).open, request, timeout=2 * self.deadline_s)
        talk(lambda: post().close(), _words, self.deadline_s)


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
    """The key in a secret; raises UndeliveredError if it is no Base64."""
    text = secret.removeprefix(SECRET_PREFIX)
    try:
        key = base64.b64decode(text + "=" * (-len(text) % 4), validate=True)
    except (binascii.Error, ValueError):
        key = b""
    if not key:
        raise UndeliveredError("the secret of alarms.webhook_secret is no Base64")
    return key


class _Nowhere(HTTPRedirectHandler):
    """Follows no redirect: nobody but the address in the config gets headers and alarms."""

    def redirect_request(self, *_: object) -> None:
        """None: a redirect is an answer like others."""


def _words(error: Exception) -> str:
    if isinstance(error, HTTPError):
        error.close()
        phrase = http.client.responses.get(error.code, "")
        followed = "; redirects are not followed" if error.code // 100 == 3 else ""
        return f"HTTP {error.code} {phrase}".rstrip() + followed
    reason = error.reason if isinstance(error, URLError) else error
    if isinstance(reason, http.client.HTTPException):
        return f"the answer is no HTTP ({type(reason).__name__})"
    return fault_words(reason)
