"""The receivers that a config names."""

from __future__ import annotations

from pipeline.config import Alarms
from pipeline.telling.delivery import Receiver


def receivers_of(settings: Alarms) -> tuple[Receiver, ...]:
    """All that `[alarms]` names; none by default."""
    found: list[Receiver] = []
    if settings.command:
        from pipeline.telling.command import Command

        found.append(Command(settings.command))
    if settings.webhook_url:
        from pipeline.telling.web_hook import WebHook

        found.append(
            WebHook(settings.webhook_url, settings.webhook_headers, settings.webhook_secret)
        )
    if settings.email.to:
        from pipeline.telling.mail import Mail

        found.append(Mail(settings.email))
    return tuple(found)
