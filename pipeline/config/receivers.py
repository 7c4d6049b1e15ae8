"""Addresses, headers and secrets of those who are told, as a config may state them."""

from __future__ import annotations

import re
from email.errors import MessageError
from email.headerregistry import Address
from urllib.parse import urlsplit

# An environment variable in a value.
VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}")
HEADER_NAME = re.compile(r"[A-Za-z0-9_-]+")
HEADER_VALUE = re.compile(r"[\x20-\x7e]+")
ADDRESS = re.compile(r"[\x21-\x7e]+")
# Headers that the program sets itself, and all that begin with `webhook-`.
OWN_HEADERS = ("connection", "content-length", "content-type", "host", "transfer-encoding")


def require_address(url: str) -> None:
    """Refuse an address that nothing can be posted to.

    Raises
    ------
    ValueError
        That says what is expected, and nothing of the address.
    """
    try:
        parts = urlsplit(url)
        whole = bool(parts.hostname) and parts.port != 0
    except ValueError:
        whole = False
    if not whole or not ADDRESS.fullmatch(url) or parts.scheme not in ("http", "https"):
        raise ValueError("expected http:// or https:// and a host, without blanks")
    if "@" in parts.netloc:
        raise ValueError("expected no name or password; webhook_headers is the place for them")


def require_header(name: str, value: str) -> None:
    """Refuse a header that cannot be sent, or that the program sets itself.

    Raises
    ------
    ValueError
        That says what is expected, and nothing of the value.
    """
    if not HEADER_NAME.fullmatch(name):
        raise ValueError("expected names of letters, digits and hyphens")
    if name.lower() in OWN_HEADERS or name.lower().startswith("webhook-"):
        raise ValueError(f"expected no {name}: the program sets it itself")
    if not HEADER_VALUE.fullmatch(value) or "$" in VARIABLE.sub("", value):
        raise ValueError(
            f"expected printable ASCII in {name}, and $ in ${{NAME}} alone, which stands for an "
            "environment variable"
        )


def require_variable(text: str) -> str:
    """A secret's place; an empty one is none.

    Raises
    ------
    ValueError
        If it is no ``${NAME}``.
    """
    if text and not VARIABLE.fullmatch(text):
        raise ValueError("expected ${NAME}, with the secret in that environment variable")
    return text


def require_mail_address(key: str, address: str) -> None:
    """Refuse what is no address of mail.

    Raises
    ------
    ValueError
        That names the key and quotes the address.
    """
    try:
        whole = bool(Address(addr_spec=address).domain)
    except (ValueError, IndexError, MessageError):
        whole = False
    if not whole:
        raise ValueError(f"expected {key} as shift@plant.example, found {address!r}")


def require_mail_server(server: str) -> tuple[str, int | None]:
    """Host and port of ``host`` or ``host:port``; the port is None where none is stated.

    Raises
    ------
    ValueError
        If it is neither.
    """
    try:
        parts = urlsplit(f"//{server}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or port == 0 or not ADDRESS.fullmatch(server) or set(server) & set("/@?#"):
        raise ValueError("expected server as host or host:port")
    return host, port
