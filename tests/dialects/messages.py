"""MCAP of JSON, Protobuf and ROS 2 messages, by the format's own writer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tests.dialects.dialect import Dialect
from tests.dialects.recorded import Recorded
from tests.pipeline.ingest.mcap_files import PUBLISHED_BEFORE_NS, mcap_bytes
from tests.pipeline.ingest.writers import ENCODINGS


@dataclass(frozen=True)
class Mcap(Dialect):
    """A topic a channel."""

    encoding: str = "json"  # of the messages; only JSON can say that there is no reading
    options: Mapping[str, Any] = field(default_factory=dict)  # of `mcap.writer.Writer`

    format: ClassVar[str] = "mcap"

    def write(self, folder: Path, stem: str, log: Recorded) -> list[Path]:
        schema, encode = ENCODINGS[self.encoding]
        called = [self.called(name) for name in log.values]
        later_ns = PUBLISHED_BEFORE_NS if self.logs.get("time") == "publish_time" else 0
        messages = []
        columns = (part.tolist() for part in self.in_units(log).samples())
        for time_us, number, value in zip(*columns, strict=True):
            payload = encode(called[number], None if np.isnan(value) else value)
            messages.append((called[number], time_us * 1000 + later_ns, payload))
        path = folder / f"{stem}.mcap"
        path.write_bytes(mcap_bytes(messages, schema, self.encoding, called, **self.options))
        return [path]

    def holds(self, log: Recorded) -> bool:
        blank = any(np.isnan(value).any() for value in log.values.values())
        says_blank = self.encoding == "json" or bool(log.own_time_us)
        return super().holds(log) and (says_blank or not blank)
