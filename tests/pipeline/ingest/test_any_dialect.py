"""Round trip, sample by sample, of logs in any dialect of any format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.ingest import RawChannel, read_log, time_span
from pipeline.messages import counted
from tests.dialects.dialect import Dialect
from tests.dialects.recorded import Recorded
from tests.dialects.strategies import csv_dialects, logs, mcap_dialects, parquet_dialects

Pairs = list[tuple[int, float]]


def written(log: Recorded, name: str) -> Pairs:
    """Readings of a channel in the order of the log."""
    time_us, numbers, values = log.samples()
    chosen = (numbers == list(log.values).index(name)) & ~np.isnan(values)
    return list(zip(time_us[chosen].tolist(), values[chosen].tolist(), strict=True))


def found(channel: RawChannel) -> Pairs:
    here = ~channel.missing
    return list(zip(channel.time_us[here].tolist(), channel.value[here].tolist(), strict=True))


def check(dialect: Dialect, log: Recorded, folder: Path) -> None:
    source = dialect.source_of(log.values)
    paths = dialect.write(folder, "log", log)
    for name in log.values:
        (path,) = [one for one in paths if len(paths) == 1 or f"+{name}." in one.name]
        raw = read_log(path, *source)
        assert found(raw.channels[name]) == written(log, name)
        assert raw.channels[name].unparsed == 0
        every = getattr(dialect, "header_every", 0)
        again = -(-raw.rows // every) - 1 if every else 0
        assert raw.notes == ((f"{counted(again, 'line')} equal to the header",) if again else ())
        # Rows at the ends in which every channel is blank are in the span of the file alone.
        rows_us = log.samples()[0]
        assert time_span(path, *source) in (
            raw.ends(),
            (int(rows_us.min()), int(rows_us.max())),
        )


@pytest.mark.parametrize(
    "dialects",
    [csv_dialects(), parquet_dialects(), mcap_dialects()],
    ids=["csv", "parquet", "mcap"],
)
@settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    deadline=None,
    max_examples=60,
)
@given(data=st.data())
def test_what_is_written_in_any_dialect_is_read_back(
    tmp_path_factory: pytest.TempPathFactory,
    dialects: st.SearchStrategy[Dialect],
    data: st.DataObject,
) -> None:
    dialect = data.draw(dialects)
    log = data.draw(logs(dialect))
    check(dialect, log, tmp_path_factory.mktemp("dialect"))
