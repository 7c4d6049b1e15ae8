"""Types of addresses, headers and secrets of those who are told; no error quotes a secret."""

from __future__ import annotations

import re
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator

# An environment variable in a value.
VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}")
HEADER_NAME = re.compile(r"[A-Za-z0-9_-]+")
HEADER_VALUE = re.compile(r"[\x20-\x7e]+")
ADDRESS = re.compile(r"[\x21-\x7e]+")
# Headers that the program sets itself, and all that begin with `webhook-`.
OWN_HEADERS = ("connection", "content-length", "content-type", "host", "transfer-encoding")


def _web_address(url: str) -> str:
    try:
        parts = urlsplit(url)
        whole = bool(parts.hostname) and parts.port != 0
    except ValueError:
        whole = False
    if url and not (whole and ADDRESS.fullmatch(url) and parts.scheme in ("http", "https")):
        raise ValueError("expected http:// or https:// and a host, without blanks")
    if "@" in parts.netloc:
        raise ValueError("expected no name or password; webhook_headers is the place for them")
    return url


def _web_headers(headers: dict[str, str]) -> dict[str, str]:
    for name, value in headers.items():
        if not HEADER_NAME.fullmatch(name):
            raise ValueError("expected names of letters, digits and hyphens")
        if name.lower() in OWN_HEADERS or name.lower().startswith("webhook-"):
            raise ValueError(f"expected no {name}: the program sets it itself")
        if not HEADER_VALUE.fullmatch(value) or "$" in VARIABLE.sub("", value):
            raise ValueError(
                f"expected printable ASCII in {name}, and $ in ${{NAME}} alone, which stands for "
                "an environment variable"
            )
    return headers


def _variable(text: str) -> str:
    if text and not VARIABLE.fullmatch(text):
        raise ValueError("expected ${NAME}, with the secret in that environment variable")
    return text


WebAddress = Annotated[str, AfterValidator(_web_address)]
WebHeaders = Annotated[dict[str, str], AfterValidator(_web_headers)]
Secret = Annotated[str, AfterValidator(_variable)]
"""Name of the environment variable that holds a secret, as ``${NAME}``; empty: none."""


def is_mail_address(address: str) -> bool:
    """True if mail can go to an address."""
    from email.errors import MessageError
    from email.headerregistry import Address

    try:
        return bool(Address(addr_spec=address).domain)
    except (ValueError, IndexError, MessageError):
        return False


def mail_server(server: str) -> tuple[str, int | None] | None:
    """Host and port of ``host`` or ``host:port``, the port None if it is not stated; or None."""
    try:
        parts = urlsplit(f"//{server}")
        host, port = parts.hostname, parts.port
    except ValueError:
        return None
    if not host or port == 0 or not ADDRESS.fullmatch(server) or set(server) & set("/@?#"):
        return None
    return host, port
