"""From which night on the other motors of an oil circuit see that a motor's baseline begins anew.

An event or a reset is often entered nights after its date. The motor itself begins anew with that
date. The others were told of the nights since by what was known then, and that stands: they see
the new baseline from the first night on that none of the circuit had been told when it was entered.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

from pipeline.config import MotorSpec
from pipeline.config.motors import Event
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import History

DAY = dt.timedelta(days=1)


def beginnings(
    spec: MotorSpec,
    decisions: Sequence[Decision],
    before: Mapping[str, dt.date] | None,
    last_told: dt.date | None,
) -> dict[str, dt.date]:
    """By event and reset of a motor, the first night from which others see its new baseline."""
    dates = _dates(spec, decisions)
    if before is None or last_told is None:
        return dates
    # With another oil the figures since its date are others: what was seen then is gone.
    other_oil = {_name(one) for one in spec.file.events if _changes_oil(spec, one)}
    return {
        name: before[name]
        if name in before
        else date
        if name in other_oil
        else max(date, last_told + DAY)
        for name, date in dates.items()
    }


def earlier_views(
    history: History, decisions: Sequence[Decision], seen_from: Mapping[str, dt.date]
) -> Iterator[tuple[dt.date, History, tuple[Decision, ...]]]:
    """A motor as others saw it before a night, without what was entered later; latest night first.

    Nothing where all events and resets were entered in time.
    """
    dates = _dates(history.spec, decisions)
    late = {name: night for name, night in seen_from.items() if night > dates[name]}
    for until in sorted(set(late.values()), reverse=True):
        yield until, *_without(history, decisions, {one for one in late if late[one] >= until})


def _without(
    history: History, decisions: Sequence[Decision], names: Collection[str]
) -> tuple[History, tuple[Decision, ...]]:
    file = history.spec.file
    kept = tuple(one for one in file.events if _name(one) not in names)
    spec = replace(history.spec, file=file.model_copy(update={"events": kept}))
    return replace(history, spec=spec), tuple(one for one in decisions if _name(one) not in names)


def _dates(spec: MotorSpec, decisions: Sequence[Decision]) -> dict[str, dt.date]:
    events = {_name(one): one.date for one in spec.file.events}
    resets = {_name(one): one.night for one in decisions if one.kind == "baseline_reset"}
    return events | resets


def _name(one: Event | Decision) -> str:
    if isinstance(one, Event):
        return f"{one.kind} {one.date}"
    return f"{one.kind} {one.night} {one.indicator}"


def _changes_oil(spec: MotorSpec, event: Event) -> bool:
    return spec.file.oil_on(event.date) != spec.file.oil_on(event.date - DAY)
