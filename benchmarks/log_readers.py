"""Just to read logs, as fast as can be: a process of its own for benchmarks.

`python -m benchmarks.log_readers READER FILE...` reads the files into columns, one after the other.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

Reader = Callable[[Path], Any]


def _pyarrow_parquet() -> Reader:
    import pyarrow.parquet as pq

    return lambda path: pq.read_table(path, use_threads=False)


def _pyarrow_csv() -> Reader:
    from pyarrow import csv

    return lambda path: csv.read_csv(path, csv.ReadOptions(use_threads=False))


def _batch_mcap() -> Reader:
    from pipeline.config.channels import Channel, Channels
    from pipeline.config.logs import Logs
    from pipeline.ingest import read_log

    channels: Channels = {
        "pressure_difference": Channel(source="/mill/motor_1/pressure_difference", unit="bar"),
        "oil_temperature": Channel(source="/mill/motor_1/oil_temperature", unit="degC"),
        "speed": Channel(source="/mill/motor_1/speed", unit="rpm"),
        "leakage_flow": Channel(source="/mill/motor_1/drain_flow", unit="l/min"),
    }
    logs = Logs(format="mcap", files=("*.mcap",), time="publish_time")
    return lambda path: read_log(path, logs, channels)


def _official_mcap() -> Reader:
    import io

    import polars as pl
    from mcap.reader import make_reader

    def read(path: Path) -> pl.DataFrame:
        topics, times, payloads = [], [], []
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
                topics.append(channel.topic)
                times.append(message.publish_time)
                payloads.append(message.data)
        frame = pl.read_ndjson(io.BytesIO(b"\n".join(payloads)))
        return frame.with_columns(topic=pl.Series(topics), time=pl.Series(times))

    return read


READERS: dict[str, Callable[[], Reader]] = {
    "pyarrow_parquet": _pyarrow_parquet,
    "pyarrow_csv": _pyarrow_csv,
    "batch_mcap": _batch_mcap,
    "official_mcap": _official_mcap,
}


def main(name: str, *files: str) -> None:
    """Read the files."""
    reader = READERS[name]()
    for file in files:
        reader(Path(file))


if __name__ == "__main__":
    main(*sys.argv[1:])
