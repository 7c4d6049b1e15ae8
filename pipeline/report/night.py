"""One night of each motor for its page: what `explain` says, and the chart of its samples."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping

from pipeline.report.charts import night_chart
from pipeline.report.explain import EXPLAINED, Row, paragraphs
from pipeline.report.plotly_json import Payload, figure
from pipeline.report.tables import Read, by_motor
from pipeline.schema import PREDICTIONS


def night_payloads(night: dt.date, read: Mapping[str, Read]) -> Iterator[tuple[str, Payload]]:
    """A payload for every motor that has a primary row in `fits` of a night."""
    faults = [fault for part in read.values() for fault in part.faults]
    rows = {table.name: _grouped(read[table.name]) for table in EXPLAINED}
    samples = by_motor(read[PREDICTIONS.name].rows)
    nothing = read[PREDICTIONS.name].rows.clear()
    for motor_id, fits in sorted(rows["fits"].items()):
        if any(row["is_primary"] for row in fits):
            own = {name: found.get(motor_id, []) for name, found in rows.items()}
            words = [[one.title, one.lines] for one in paragraphs(own)]
            unread = [["Not read", faults]] if faults else []
            chart = figure(night_chart(samples.get(motor_id, nothing)))
            yield motor_id, {"night": str(night), "words": [*words, *unread], "figure": chart}


def _grouped(read: Read) -> dict[str, list[Row]]:
    """The rows of each motor; a file that is of no night stands under another's."""
    found: dict[str, list[Row]] = {}
    for row in read.rows.iter_rows(named=True):
        if row["night"] is not None:
            found.setdefault(row["motor_id"], []).append(row)
    return found
