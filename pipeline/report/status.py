"""The fleet's state, and a motor over its nights, as published."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.config import Fleet, MotorSpec
from pipeline.config.hashes import DRAIN_DELAY
from pipeline.errors import UsageError
from pipeline.intraday.rows import intraday_statuses
from pipeline.logs.processed import read_settings, read_stays, same_logs, stay_lines
from pipeline.messages import counted
from pipeline.notification.delivery import Receiver
from pipeline.notification.outbox import Backlog, backlogs
from pipeline.schema import (
    AGREEING_S,
    ALARMS,
    DECIDING_NIGHTS,
    FAILED,
    FITS,
    LAG_COLUMNS,
    NIGHTS,
    TRENDS,
    Table,
    agreed_lag,
    frame,
)
from pipeline.store.heartbeat import Beat, last_good_run, read_heartbeat
from pipeline.store.published import TableFault, faults_of
from pipeline.store.state import read_state_file
from pipeline.store.tables import read_rows
from pipeline.trends.decisions import read_decisions
from pipeline.trends.motor_states import MotorState, published_states, urgency, what_of

# Failed nights of a motor that are listed, the newest.
MOST_FAILED = 3
# Newest nights whose outcomes a page shows.
RECENT_NIGHTS = 30


@dataclass(frozen=True, slots=True)
class FleetStatus:
    """All motors, those that need attention first."""

    motors: tuple[MotorState, ...]
    # When the last run ended that went through all motors; None where none did.
    last_good_run: dt.datetime | None
    beat: Beat | None = None  # heartbeat of the current or the last run; None before the first
    receivers: tuple[Backlog, ...] = ()  # changes of state not yet delivered, by receiver
    # Published files that are gone, or were written to since and are not what was published.
    damage: tuple[TableFault, ...] = ()
    standing: tuple[str, ...] = ()  # what failed, or stays as published, until somebody acts

    @property
    def newest_sample(self) -> dt.datetime | None:
        """Newest sample of all motors."""
        return max(filter(None, (motor.row["last_sample"] for motor in self.motors)), default=None)


def fleet_status(
    output: Path, motor_ids: Sequence[str], receivers: Sequence[Receiver] = ()
) -> FleetStatus:
    """Return the state of some motors, and undelivered changes by receiver.

    Raises StoreError if a table is damaged.
    """
    motors = current_states(output, motor_ids)
    return FleetStatus(
        tuple(sorted(motors, key=urgency)),
        last_good_run(output),
        read_heartbeat(output),
        backlogs(output, receivers),
        faults_of(output),
        tuple(standing(output, motor_ids)),
    )


def current_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """Return states of some motors as the last run left them, with their intraday check.

    Raises StoreError if a table is damaged.
    """
    intraday = intraday_statuses(output, motor_ids)
    states = published_states(output, motor_ids)
    return [replace(state, intraday=intraday.get(state.motor_id)) for state in states]


def standing(output: Path, motor_ids: Sequence[str]) -> Iterator[str]:
    """Yield in words what stands until somebody acts: failed nights, logs that are gone."""
    with read_state_file(output) as state:
        stays, gone = read_stays(state, motor_ids)
        settings = read_settings(state)
        shared = list(same_logs(state))
    decisions = read_decisions(output)
    excluded = {
        (decision.motor_id, decision.night) for decision in decisions if decision.kind == "excluded"
    }
    by_motor = failed_nights(output, motor_ids)
    failures = {
        motor_id: {label: why for label, why in nights.items() if (motor_id, label) not in excluded}
        for motor_id, nights in by_motor.items()
    }
    for motor_id, failed in failures.items():
        for label in sorted(failed)[-MOST_FAILED:]:
            yield f"{motor_id}: night of {label} failed: {failed[label]}"
        if (more := len(failed) - MOST_FAILED) > 0:
            yield f"{motor_id}: and {counted(more, 'night')} before"
        yield from (f"{motor_id}: {line}" for line in stay_lines(stays[motor_id]))
        if n := gone.get(motor_id):
            yield f"{motor_id}: {counted(n, 'published night')} without a log any more"
    yield from shared
    yield from _proposed_delays(output, settings)
    if any(failures.values()):
        yield (
            "a failed night: mend its log or the config, or remove the log, then fit-fleet "
            "--retry; or ack --night"
        )


def _proposed_delays(output: Path, settings: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Yield delays of drain flows on which the newest nights agree, other than the delay in use."""
    decided = {name: own[DRAIN_DELAY] for name, own in settings.items() if DRAIN_DELAY in own}
    columns = ("motor_id", "night", *LAG_COLUMNS)
    fits = read_rows(output, FITS, sorted(decided), columns).drop_nulls().unique(columns[:2])
    for (motor_id,), rows in fits.sort(columns[:2]).group_by("motor_id", maintain_order=True):
        newest = rows.tail(DECIDING_NIGHTS)
        lag = agreed_lag(newest.to_dicts()) if len(newest) == DECIDING_NIGHTS else None
        if lag is not None and abs(lag[0] - decided[motor_id]) > AGREEING_S:
            yield (
                f"{motor_id}: in the last {DECIDING_NIGHTS} nights the drain flow lags by "
                f"{lag[0]:.1f} s (explains {lag[1]:.0f} % more of it), paired are "
                f"{decided[motor_id]:.1f} s; to pair all nights so: fit-fleet --redo "
                f"{newest['night'][0]}..{newest['night'][-1]} --motors {motor_id}"
            )


def failed_nights(output: Path, motor_ids: Sequence[str]) -> dict[str, dict[dt.date, str]]:
    """Return why nights of some motors failed, in words, by motor and night."""
    columns = ("motor_id", "night", "status", "error_code", "reason")
    rows = read_rows(output, NIGHTS, motor_ids, columns).filter(status=FAILED).sort("night")
    failed: dict[str, dict[dt.date, str]] = {motor_id: {} for motor_id in motor_ids}
    for row in rows.iter_rows(named=True):
        failed[row["motor_id"]][row["night"]] = f"{row['error_code']}: {row['reason']}"
    return failed


def last_alarm(output: Path, motor_id: str, indicator: str, states: Collection[str]) -> dt.date:
    """Return the night of the last alarm of an indicator in any of some states.

    Raises UsageError (``no_alarm``) if there was none; the message lists the alarms so far.
    """
    rows = read_rows(output, ALARMS, [motor_id], ("night", "cause", "to_state")).to_dicts()
    raised: list[tuple[str, dt.date]] = [
        (what_of(row), row["night"]) for row in rows if row["to_state"] in states
    ]
    nights = [night for what, night in raised if what == indicator]
    if not nights:
        named = ", ".join(sorted({what for what, _ in raised})) or "none"
        raise UsageError(
            "no_alarm", f"{motor_id} has had no alarm of {indicator!r}; alarms so far: {named}"
        )
    return max(nights)


def finite_rows(
    output: Path,
    table: Table,
    motor_ids: Sequence[str],
    nights: Collection[dt.date] | None = None,
) -> pl.DataFrame:
    """Return rows of a table, NaN and infinity as null: no page can show them, and JSON has none.

    Raises StoreError if a file is damaged, or of a newer version of the program.
    """
    rows = read_rows(output, table, motor_ids, nights=nights)
    floats = [name for name, kind in rows.schema.items() if kind == pl.Float64]
    return rows.with_columns(
        pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name)
        for name in floats
        if not rows[name].is_finite().all()
    )


@dataclass(frozen=True)
class MotorHistory:
    """A motor: its state, and all its nights."""

    state: MotorState  # as `motor-leakage status` prints it
    spec: MotorSpec | None  # None of a motor that the config has no more
    reference: tuple[float, float, float]  # reference conditions: bar, °C, rpm
    rows: pl.DataFrame  # its rows of `nights` in time order, n of them
    # Its rows of `trends` by indicator, in time order; empty where no run has made trends.
    trends: Mapping[str, pl.DataFrame]

    @property
    def motor_id(self) -> str:
        """The motor."""
        return self.state.motor_id

    @property
    def motor_type(self) -> str:
        """Its type."""
        return self.spec.file.motor_type if self.spec else str(self.state.row["motor_type"] or "")

    @property
    def newest_data(self) -> dt.datetime | None:
        """End of the newest data that were kept, UTC; None without any."""
        newest = self.rows["last_sample"].max()
        assert newest is None or isinstance(newest, dt.datetime)
        return newest

    @property
    def recent(self) -> list[str]:
        """Statuses of its newest 30 nights, of those that have a row."""
        if not self.nights:
            return []
        first = self.nights[-1] - dt.timedelta(days=RECENT_NIGHTS)
        return self.rows.filter(self.rows["night"] > first)["status"].to_list()

    @cached_property
    def nights(self) -> list[dt.date]:
        """Labels of its nights."""
        return self.rows["night"].to_list()

    @cached_property
    def stamps(self) -> NDArray[np.datetime64]:
        """The same, shape (n,)."""
        return np.array(self.nights, dtype="datetime64[D]")

    @property
    def baseline_leakage(self) -> float | None:
        """Leakage of the newest baseline at the motor's own conditions, l/min; None without any."""
        if (known := self.trends.get("own_leakage")) is None:
            return None
        means = self.rows.join(known.select("night", "baseline_mean"), on="night").sort("night")
        first = means.drop_nulls(("baseline_start", "baseline_mean")).unique(
            "baseline_start", keep="first", maintain_order=True
        )
        return first["baseline_mean"][-1] if first.height else None

    @cached_property
    def baselines(self) -> list[tuple[dt.date, dt.date]]:
        """First and last night of each baseline."""
        ends = self.rows.select("baseline_start", "baseline_end").drop_nulls()
        return list(ends.unique(maintain_order=True).iter_rows())

    def figure(self, name: str) -> Array:
        """Return a figure of `nights`, shape (n,); NaN in nights without it."""
        return self.rows[name].cast(pl.Float64).to_numpy()

    def course(self, indicator: str) -> tuple[Array, Array, Array]:
        """Return an indicator of the nights that count, and the ends of its interval, (n,) each."""
        rows = self.trends[indicator].filter(pl.col("reason").is_null())
        trend = self.rows.select("night").join(rows, on="night", how="left", maintain_order="left")
        value, lower, upper = (
            trend[name].cast(pl.Float64).to_numpy() for name in ("value", "lower", "upper")
        )
        return value, lower, upper


def motor_histories(fleet: Fleet, states: Sequence[MotorState]) -> list[MotorHistory]:
    """Return the history of each motor."""
    motor_ids = [state.motor_id for state in states]
    nights, trends = (
        by_motor(finite_rows(fleet.output, table, motor_ids).sort("night"))
        for table in (NIGHTS, TRENDS)
    )
    specs = {spec.motor_id: spec for spec in fleet.motors}
    histories = []
    for state in states:
        name, spec = state.motor_id, specs.get(state.motor_id)
        at = spec.settings.reference if spec else fleet.settings.reference
        own = trends.get(name, frame(TRENDS, [])).partition_by("indicator", maintain_order=True)
        histories.append(
            MotorHistory(
                state,
                spec,
                (at.pressure_bar, at.temperature_c, at.speed_rpm),
                nights.get(name, frame(NIGHTS, [])),
                {part["indicator"][0]: part for part in own},
            )
        )
    return histories


def by_motor(rows: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """Return rows of a table by motor, in their order."""
    return {part["motor_id"][0]: part for part in rows.partition_by("motor_id")}
