"""Mail over a real SMTP server on loopback: TLS, log-in, refusals, a server that hangs."""

from __future__ import annotations

import datetime as dt
import email.policy
import json
import socket
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from email.message import EmailMessage
from pathlib import Path
from typing import Any

import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import SMTP, AuthResult, Envelope, LoginPassword, Session

from pipeline.config.settings import Email
from pipeline.notification.delivery import Delivery, Mail, UndeliveredError

CERTIFICATE = Path(__file__).with_name("server.pem")
PASSWORD = "correct horse"  # noqa: S105


def change(motor: str, when: str, *words: str, **more: Any) -> dict[str, Any]:
    row = dict(zip(("from_state", "to_state", "sentence"), words, strict=True))
    return {"motor_id": motor, "night": when, "cause": None, **row, **more}


RING = change("CB400-02", "2026-02-09", "ok", "warning", "piston ring gap +12 % since 1 February")
RISEN = "leakage of the piston ring has risen: +3.5 % [2.9, 4.1] tonight; 93 % probable"
WORSE = change("CB400-02", "2026-02-19", "warning", "alarm", f"{RISEN}. Plan an inspection of it.")
ZERO = change("CB400-02", "2026-02-20", "warning", "ok", "back at 0 µm", cause="flow_zero")
OTHER = change("CB400-01", "2026-02-19", "ok", "stale", "8 nights without a figure")


def delivery(*changes: dict[str, Any], kind: str = "alarms") -> Delivery:
    document = {"id": "msg_1", "type": kind, "fleet": "Mill 3", "changes": changes}
    return Delivery("msg_1", json.dumps(document).encode())


@dataclass
class Server:
    """A server on loopback and what it took."""

    port: int = 0
    mails: list[EmailMessage] = field(default_factory=list)
    logins: list[tuple[bytes, bytes]] = field(default_factory=list)
    refused: str = ""

    async def handle_RCPT(  # noqa: N802 - as aiosmtpd calls it
        self, _: SMTP, __: Session, envelope: Envelope, address: str, ___: list[str]
    ) -> str:
        if address == self.refused:
            return "550 no such user"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, _: SMTP, __: Session, envelope: Envelope) -> str:  # noqa: N802
        self.mails.append(email.message_from_bytes(envelope.content, policy=email.policy.default))
        return "250 OK"

    def authenticate(self, *arguments: object) -> AuthResult:
        (given,) = (argument for argument in arguments if isinstance(argument, LoginPassword))
        self.logins.append((given.login, given.password))
        return AuthResult(success=given.password == PASSWORD.encode(), handled=False)

    def settings(self, **changed: Any) -> Email:
        stated = {"to": ("shift@plant.example",), "sender": "leakage@plant.example"}
        stated |= {"server": f"smtp://127.0.0.1:{self.port}"}
        return Email.model_validate(stated | changed)


@contextmanager
def serving(*, starttls: bool = False, tls: bool = False) -> Iterator[Server]:
    with socket.create_server(("127.0.0.1", 0)) as free:  # aiosmtpd chooses none itself
        server = Server(free.getsockname()[1])
    context = None
    if starttls or tls:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(CERTIFICATE)
    controller = Controller(
        server,
        hostname="127.0.0.1",
        port=server.port,
        ssl_context=context if tls else None,
        tls_context=None if tls else context,
        authenticator=server.authenticate,
        auth_require_tls=not tls,
    )
    controller.start()
    try:
        yield server
    finally:
        controller.stop()


def fault_of(settings: Email, deadline_s: float = 30.0) -> UndeliveredError:
    with pytest.raises(UndeliveredError) as caught:
        Mail(settings, deadline_s).take(delivery(RING))
    assert PASSWORD not in caught.value.why
    return caught.value


def mailed(*changes: dict[str, Any], kind: str = "alarms", **settings: Any) -> EmailMessage:
    """The message of a delivery, as it came."""
    with serving() as server:
        Mail(server.settings(**settings)).take(delivery(*changes, kind=kind))
    (mail,) = server.mails
    return mail


def test_a_message_says_what_since_when_what_to_do_and_where_to_read_on() -> None:
    to, report = ("a@plant.example", "b@plant.example"), "http://plant/leakage/"
    mail = mailed(OTHER, ZERO, WORSE, RING, to=to, report_url=report)
    assert mail["Subject"] == "Mill 3: CB400-02 alarm; CB400-01 stale; CB400-02 flow zero ok"
    assert mail["From"] == "leakage@plant.example"
    assert mail["To"] == "a@plant.example, b@plant.example"
    assert mail["Message-ID"] == "<msg_1@motor-leakage>"
    assert mail.get_content().splitlines() == [
        "CB400-02: alarm since 2026-02-19; before that warning since 2026-02-09, ok",
        f"  L{RISEN[1:]}.",
        "  Plan an inspection of it.",
        "  Figures are of the night of 2026-02-19.",
        "  http://plant/leakage/motors/CB400-02.html",
        "",
        "CB400-01: stale since 2026-02-19; before that ok",
        "  8 nights without a figure.",
        "  Figures are of the night of 2026-02-19.",
        "  http://plant/leakage/motors/CB400-01.html",
        "",
        "CB400-02 flow zero: ok since 2026-02-20; before that warning",
        "  Back at 0 µm.",
        "  Figures are of the night of 2026-02-20.",
        "  http://plant/leakage/motors/CB400-02.html",
    ]


def test_a_name_in_a_log_adds_no_header() -> None:
    mail = mailed(change("CB\nBcc: x@y.example", "2026-02-09", "ok", "alarm", "\n.\nMAIL FROM:<x>"))
    assert mail["Bcc"] is None
    assert "MAIL FROM:<x>" in mail.get_content()


LOGIN = {"user": "leakage", "password": "${MAIL_PASSWORD}"}


@pytest.mark.parametrize(("security", "scheme"), [("starttls", ""), ("tls", "smtps://")])
def test_it_logs_in_over_a_checked_certificate(
    security: str, scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAIL_PASSWORD", PASSWORD)
    with serving(**{security: True}) as server:
        settings = server.settings(**LOGIN, server=f"{scheme}127.0.0.1:{server.port}")
        assert "certificate" in fault_of(settings).why
        assert server.logins == []
        monkeypatch.setenv("SSL_CERT_FILE", str(CERTIFICATE))
        Mail(settings).take(delivery(RING))
        monkeypatch.setenv("MAIL_PASSWORD", "wrong")
        assert fault_of(settings).why == "SMTP 535"
    assert len(server.mails) == 1
    assert server.logins[0] == (b"leakage", PASSWORD.encode())


def test_a_server_without_tls_and_a_refused_address_get_nothing() -> None:
    with serving() as server:
        assert "STARTTLS" in fault_of(server.settings(server=f"127.0.0.1:{server.port}")).why
        server.refused = "gone@plant.example"
        fault = fault_of(server.settings(to=(server.refused,)))
        assert fault.why == "refused for gone@plant.example"
        assert server.mails == []
        fault = fault_of(server.settings(to=("shift@plant.example", server.refused)))
        assert fault.why == "refused for gone@plant.example"


def test_a_server_that_says_nothing_is_left_at_the_deadline() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        settings = Server(port=server.getsockname()[1]).settings()
        assert fault_of(settings, deadline_s=0.2).hung


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"to": ("shift",)}, "shift@plant.example"),
        ({"to": ("a@b.example\nBcc: c@d.example",)}, "an address such as"),
        ({"sender": ""}, "an address such as"),
        ({"server": ""}, "host or host:port"),
        ({"server": "http://mail.example"}, "host or host:port"),
        ({"user": "a"}, "user and password together"),
        ({"password": "secret"}, "expected ${NAME}"),
        ({"user": "a", "password": "${P}"}, "no smtp://"),
    ],
)
def test_settings_that_cannot_work_are_refused(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError) as caught:
        Server(port=25).settings(**changed)
    assert words in str(caught.value)


@pytest.mark.parametrize(("today", "due"), [(16, 16), (17, 16), (22, 16), (23, 23)])
def test_a_weekly_summary_is_due_on_the_last_of_its_days(today: int, due: int) -> None:
    settings = Server(port=25).settings(weekly="mon")
    assert settings.summary_due(dt.date(2026, 11, today)) == dt.date(2026, 11, due)
    assert Email().summary_due(dt.date(2026, 11, today)) is None
