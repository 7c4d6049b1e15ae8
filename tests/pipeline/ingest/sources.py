"""Arguments of a reader besides the log's path, as a motor's config states them."""

from __future__ import annotations

from typing import Any, NamedTuple

from pipeline.config.channels import Channel, Channels
from pipeline.config.logs import Logs


class Source(NamedTuple):
    """Arguments of a reader: the log's dialect, and the channels that are wanted."""

    logs: Logs
    channels: Channels

    @staticmethod
    def of(log_format: str, channels: Channels, **keys: Any) -> Source:
        """Logs of a format, with any key of `Logs`."""
        return Source(logs_of(log_format, **keys), channels)

    def but(self, channels: Channels | None = None, **keys: Any) -> Source:
        """With other channels, or other keys of `Logs`."""
        logs = Logs(**self.logs.model_dump() | keys)
        return Source(logs, self.channels if channels is None else channels)


def logs_of(log_format: str, **keys: Any) -> Logs:
    """Logs of a format, with any key of `Logs`."""
    return Logs(format=log_format, files=("*",), **keys)


def column(name: str, unit: str, **keys: Any) -> Channel:
    """A channel by the name of its column or topic."""
    return Channel(source=name, unit=unit, **keys)


def changed(channel: Channel, **keys: Any) -> Channel:
    """A channel with other keys."""
    return Channel(**channel.model_dump(exclude_unset=True) | keys)
