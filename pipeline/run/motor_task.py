"""A motor's task: what is new in its logs, which nights that touches, and the fit of each.

The task reads the logs and its own record of processed logs, writes only into its own staging
files, and returns a small outcome. Whatever goes wrong with a log or a night is a row, not an
exception.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import polars as pl
from polars.exceptions import PanicException

from pipeline.config.hashes import SettingsHashes
from pipeline.config.nights import night
from pipeline.errors import StoreError
from pipeline.logs.files import labels_of, reaches_us, slice_night
from pipeline.logs.finding import legible
from pipeline.logs.processed import GONE, FileRecord, NightRecord
from pipeline.messages import speak_as_parent
from pipeline.night.column_change import (
    COLUMNS,
    FEWEST_USUAL,
    USUAL_NIGHTS,
    column_change,
    readings_of,
    refusal,
    usual_readings,
)
from pipeline.night.fit_night import (
    FROM_TABLES,
    NightOutcome,
    fit_night,
    refit,
    refit_read,
    unfitted_outcome,
)
from pipeline.night.sample_rows import strange_flow
from pipeline.night.statistics import BLOCK_COLUMNS
from pipeline.run.night_plan import NO_LOG, NightPlan
from pipeline.run.tasks import MotorOutcome, MotorTask, Step, Work, lost
from pipeline.schema import (
    BLOCKS,
    FAILED,
    FITS,
    LAG_COLUMNS,
    LOG_FILES,
    NIGHT_TABLES,
    NIGHTS,
    NO_NEW_DATA,
    OF_NIGHT,
    OK,
    QUALITY,
    WITH_SAMPLES,
    Row,
    Table,
    agreed_lag,
)
from pipeline.store.published import TABLE_OF
from pipeline.store.publishing import stage, staged_file
from pipeline.store.tables import days_of, files_of, read_rows
from pipeline.workers.process import Loss, loss_of, one_thread, sign_of_life

log = logging.getLogger(__name__)

RowsByTable = Mapping[str, Sequence[Row]]

# Refused by these, a row of a log is none of its samples.
NO_SAMPLES = ("missing", "duplicate_time")
# First and last sample that are kept may differ by so much: rules at the ends decide on them, too.
CLOSE = dt.timedelta(minutes=1)


def run_motor(task: MotorTask) -> MotorOutcome:
    """Do everything that is new for a motor, and stage its rows.

    Raises MemoryError if there is not enough memory for what all its nights need.
    """
    speak_as_parent()
    with one_thread():
        try:
            return MotorRun(task).run()
        except StoreError as error:
            return lost(task, Loss(error.code, error.message))
        except MemoryError:  # a fresh worker may have what it takes
            raise
        except (Exception, PanicException) as error:
            log.exception("motor %s failed", task.spec.motor_id)
            return lost(task, loss_of(error))


def _roller_identified(outcome: NightOutcome) -> bool | None:
    """Return whether a night's primary fit identifies the rollers' scale; None without either."""
    verdicts = [row.get("roller_verdict") for row in outcome.rows["fits"] if row["is_primary"]]
    return verdicts[0] and verdicts[0] == "identified"


def _place_of(record: FileRecord, nights: Collection[dt.date]) -> dt.date | None:
    """Return night under which a file's row stands: its first, else the motor's first, or None."""
    return min(labels_of(record) or nights, default=None)


class MotorRun(NightPlan):
    """A motor's nights while its task makes them."""

    def __init__(self, task: MotorTask) -> None:
        super().__init__(task)
        self.lost_nights = task.lost_nights
        unpublished = {
            label: dict(record.row) for label, record in self.nights_before.items() if record.row
        }
        self.stored = _StoredNights(task.output, self.spec.motor_id, unpublished)
        self.findings: tuple[str, ...] = ()
        self.n_left = 0

    def run(self) -> MotorOutcome:
        plan = self.open_nights()
        if not plan and self._decide(plan):
            plan = self.open_nights()
        while plan:
            label, n_moved = min(plan), self.logs.n_moved
            self.n_left = len(plan)
            outcome = self._night(label, plan.pop(label))
            if outcome is not None:
                self._remember(outcome)
                for stage_name, taken in outcome.seconds.items():
                    self.seconds[stage_name] += taken
            # Reading may show that a log covers other nights than its ends do.
            if self.logs.n_moved != n_moved:
                # Also those that an earlier state of a file had been read for.
                for waiting in self.logs.waiting() & self.done.keys():
                    self._take_back(waiting)
                plan = self.open_nights()
            if self._decide(plan):
                plan = self.open_nights()
        for label in self.holes():
            reason = "no log covers this night"
            self.done[label] = unfitted_outcome(self.spec, label, NO_NEW_DATA, reason)
            self.records[label] = NightRecord(NO_NEW_DATA, row=self.done[label].rows["nights"][0])
        sign_of_life("")
        with self.timed("store_s"):
            self._stage()
        n_refitted = sum(outcome.tables is not None for outcome in self.done.values())
        return replace(self.outcome(), n_refitted=n_refitted, findings=self.findings)

    def _take_back(self, label: dt.date) -> None:
        """Leave a night to the next run, as if it had not been done in this run."""
        del self.done[label]
        if label in self.nights_before:
            self.records[label] = self.nights_before[label]
        else:
            del self.records[label]

    def _remember(self, outcome: NightOutcome) -> None:
        label = outcome.night
        before = None if outcome.tables is None else self.records.get(label)
        self.done[label] = outcome
        self.records[label] = NightRecord(
            outcome.status,
            self.hashes.statistics(label),
            self.hashes.figures(label),
            _roller_identified(outcome),
            self.logs.contents_of(label) if before is None else before.logs,
            "" if before is None else before.stays,
            row=outcome.rows["nights"][0],
        )

    def _night(self, label: dt.date, step: Step) -> NightOutcome | None:
        """Return outcome of a night; None where it stays as published, for want of its logs."""
        if step.work is Work.STAY:
            self.stay(label, step.reason)
            return None
        if given_up := self.lost_nights.get(label):
            return unfitted_outcome(
                self.spec, label, FAILED, legible(given_up.how), code=given_up.code
            )
        sign_of_life(label.isoformat(), len(self.done), self.n_left)
        try:
            if step.work is Work.REFIT:
                with self.timed("refit_s"):
                    outcome = refit(self.fitted_spec, label, *self.stored.night(label))
                if outcome is not None:
                    return outcome
                if label not in self.logs.present():
                    self.stay(label, f"{step.reason}: its blocks do not suffice, and {GONE}")
                    return None
            return self._unless_less(self._read_and_fit(label))
        except StoreError:
            raise
        except (Exception, PanicException) as error:  # a night must not cost the motor's others
            log.exception("motor %s, night %s failed", self.spec.motor_id, label)
            loss = loss_of(error)
            return unfitted_outcome(self.spec, label, FAILED, legible(loss.how), code=loss.code)

    def _unless_less(self, outcome: NightOutcome) -> NightOutcome | None:
        """Return outcome of a night that was read; None if what is published was made from more."""
        label = outcome.night
        is_known = self.is_published(label) or not self.nights_before  # a state file may be lost
        if not is_known or self.task.asks_for(label) or self.has_its_logs(label):
            return outcome
        published = self.stored.rows(label, (NIGHTS, QUALITY))
        status = next((row["status"] for row in published[NIGHTS.name]), FAILED)
        if status not in WITH_SAMPLES:
            return outcome
        is_failed = outcome.status == FAILED
        why = outcome.reason if is_failed else _why_less(outcome.rows, published)
        if why is None:
            return outcome
        self.stay(label, why, status)
        return None

    def _decide(self, plan: Mapping[dt.date, Step]) -> bool:
        """Decide what is due by the first nights; True where nights are to be made anew.

        On the rollers after all that is to do, but of a first load at once: the nights to come are
        then fitted once.
        """
        if self._decide_delay():
            return True
        return not (plan and self.nights_before) and self._decide_roller_scale()

    def _decide_delay(self) -> bool:
        """Decide on the drain flow's delay once; True where nights are to be paired anew."""
        deciding = self.nights_of_delay()
        if not deciding:
            return False
        lag = agreed_lag(self._rows_of(deciding, FITS, LAG_COLUMNS))
        delay_s, before = 0.0 if lag is None else lag[0], self.fitted_spec
        self.is_delay_decided = True
        self.fitted_spec = self.spec.decided(delay_s, roller_is_free=before.roller_is_free)
        self.hashes = SettingsHashes(self.fitted_spec)
        if delay_s == (before.drain_delay_s or 0.0):
            return False
        for label in list(self.done):
            self._take_back(label)
        self._make_anew(f"the drain flow is delayed by {delay_s:g} s")
        return True

    def _decide_roller_scale(self) -> bool:
        """Decide on the rollers' scale if that is due; True where nights are to be fitted anew."""
        decision = self.roller_decision_due()
        if decision is None:
            return False
        self.roller, before = decision, self.fitted_spec
        is_free = bool(decision["is_free"])
        self.fitted_spec = self.spec.decided(before.drain_delay_s, roller_is_free=is_free)
        self.hashes = SettingsHashes(self.fitted_spec)
        if is_free == before.roller_is_free:
            return False
        self._make_anew("the scale of the rollers is decided")
        for label, outcome in [*self.done.items()]:
            if outcome.tables is None:
                with self.timed("refit_s"):
                    self._remember(refit_read(self.fitted_spec, outcome))
            else:
                self._take_back(label)
        return True

    def _make_anew(self, why: str) -> None:
        """Have nights of before made anew as the motor is fitted now."""
        self.why_anew = why
        self.by_settings = self._outdated_by_settings()

    def _read_and_fit(self, label: dt.date) -> NightOutcome:
        here = night(label, self.spec.settings.nights)
        with self.timed("read_s"):
            names = self.logs.of_night(label)
            read = [self.logs.content(name) for name in (*self.logs.before_night(here), *names)]
        broken = [file for name in names if (file := self.logs.files[name]).status != "ok"]
        if broken:
            return unfitted_outcome(
                self.spec, label, FAILED, broken[0].message or "", code=broken[0].error_code
            )
        contents = [content for content in read if content is not None]
        channels = slice_night(contents, here, reaches_us(self.spec))
        # The night has what it needs of them, and gives it up bit by bit.
        del read, contents
        self.logs.let_go_until(label)
        if not any((channel.time_us >= here.start_us).any() for channel in channels.values()):
            return unfitted_outcome(self.spec, label, NO_NEW_DATA, "no log covers this night")
        newest = max(filter(self.task.wants, self.logs.present()), default=label)
        if self.task.first_look is None or self.nights_before or label < newest:
            return self._unless_changed(fit_night(self.fitted_spec, here, channels))
        dated, path_of = self.logs.in_time(), self.logs.path
        findings = [*self.task.first_look(self.spec, label, dated, path_of, channels)]
        outcome = fit_night(
            self.fitted_spec, here, channels, lambda samples: findings.extend(strange_flow(samples))
        )
        self.findings = tuple(findings)
        return self._unless_changed(outcome)

    def _unless_changed(self, outcome: NightOutcome) -> NightOutcome:
        """Return a night's outcome; it fails where its columns or units are others than before."""
        now = next(map(readings_of, outcome.rows["nights"]), {})
        change = None
        if now and (usual := self._usual(outcome.night)):
            is_fitted = outcome.status == OK
            change = column_change(self.spec, usual, now, is_fitted=is_fitted)
        if change is None or outcome.night in self.task.released:
            return outcome
        before = {night for night in self._fitted_nights(outcome.night) if night < outcome.night}
        # The nights before are refused where this run made them; what is published stays.
        if change.is_of_others and before and before <= self.done.keys():
            why = refusal(change.words, outcome.night)
            for label in sorted(before - self.task.released):
                self._remember(self._refused(self.done[label], why))
            return outcome
        return self._refused(outcome, refusal(change.words))

    def _refused(self, outcome: NightOutcome, why: str) -> NightOutcome:
        """Return a night that fails with a change of columns or units."""
        rows = {"quality": outcome.rows.get("quality", [])}
        return unfitted_outcome(self.spec, outcome.night, FAILED, why, "columns_changed", rows=rows)

    def _usual(self, label: dt.date) -> dict[str, float]:
        """Return medians of the last fitted nights before, or of the first after; empty if few."""
        nights = self._fitted_nights(label)
        before = [night for night in nights if night < label][-USUAL_NIGHTS:]
        after = [
            night
            for night in nights
            if night > label
            and self.records[night].statistics_hash == self.hashes.statistics(night)
        ][:USUAL_NIGHTS]
        chosen = before if len(before) >= FEWEST_USUAL else after
        return usual_readings(self._rows_of(chosen, NIGHTS, tuple(COLUMNS.values())))

    def _fitted_nights(self, label: dt.date) -> list[dt.date]:
        """Return the fitted nights whose readings are a night's, without the night itself."""
        since, until = self.spec.file.alike(label)
        return [
            night
            for night, record in sorted(self.records.items())
            if since <= night < until and night != label and record.status == OK
        ]

    def _rows_of(
        self, nights: Collection[dt.date], table: Table, columns: tuple[str, ...]
    ) -> list[Row]:
        """Return rows of some nights, as this run made them or as they are published."""
        made = {
            night: self.done[night].rows[table.name]
            for night in nights
            if night in self.done and self.done[night].tables is None
        }
        if table is NIGHTS:
            made |= {night: [dict(row)] for night in nights if (row := self.records[night].row)}
        rows = [row for night in made for row in made[night]]
        if published := set(nights).difference(made):
            motor_ids, wanted = [self.spec.motor_id], ("night", *columns)
            rows += read_rows(self.task.output, table, motor_ids, wanted, published).to_dicts()
        return rows

    def _stage(self) -> None:
        by_table: defaultdict[str, dict[dt.date, list[Row]]] = defaultdict(dict)
        for label, outcome in self.done.items():
            for table in NIGHT_TABLES:
                # A night made anew in part keeps what only its samples tell.
                if outcome.tables is None or table.name in outcome.tables:
                    by_table[table.name][label] = outcome.rows.get(table.name, [])
        by_table["log_files"] = self._file_rows(by_table["log_files"].keys())
        staged = {table: by_table[table.name] for table in NIGHT_TABLES if by_table[table.name]}
        if staged:
            stage(staged_file(self.task.staging / "nights", self.spec.motor_id), staged)

    def _file_rows(self, staged: Collection[dt.date]) -> dict[dt.date, list[Row]]:
        """Return rows of `log_files` of some nights and of those that a row leaves or enters.

        Of a night that is not done, the other rows stay as they are.
        """
        settled = self.logs.finished(self.done.keys() | self.stays.keys())
        rows: defaultdict[dt.date, list[Row]] = defaultdict(list)
        moved: defaultdict[dt.date, set[str]] = defaultdict(set)
        for row in self.logs.rows():
            name = row["path"]
            now, known = self.logs.files[name], self.task.processed.files.get(name)
            here = _place_of(now, self.records)
            there = None if known is None else _place_of(known, self.task.processed.nights)
            is_new = now != known and (row["night"] is None or name in settled)
            if here is None or not (here in staged or is_new):
                continue
            rows[here].append(row)
            for place in (here, there):
                if place is not None and place not in staged and (is_new or place != here):
                    moved[place].add(name)
        for label, names in sorted(moved.items()):
            published = read_rows(self.task.output, LOG_FILES, [self.spec.motor_id], nights=[label])
            others = published.drop("run_id").filter(~pl.col("path").is_in(list(names)))
            rows[label] += others.to_dicts()
        return {label: rows[label] for label in sorted({*staged, *moved})}


class _StoredNights:
    """The published nights of a motor; `unpublished` has own rows of nights without trends yet."""

    def __init__(self, output: Path, motor_id: str, unpublished: Mapping[dt.date, Row]) -> None:
        self._output, self._motor_id, self._unpublished = output, motor_id, unpublished
        # Nights are made in order of time: what a fit anew needs of a month is read once.
        self._of_month = lru_cache(maxsize=len(FROM_TABLES) + 2)(self._read)

    def rows(self, label: dt.date, tables: Iterable[Table]) -> dict[str, list[Row]]:
        """Return rows of a night by table; none where its month's files are absent or damaged."""
        rows = {}
        for table in tables:
            of_night = self._of_night(table, label)
            rows[table.name] = [] if of_night is None else of_night.to_dicts()
        if label in self._unpublished:
            rows[NIGHTS.name] = [dict(self._unpublished[label])]
        return rows

    def night(self, label: dt.date) -> tuple[dict[str, list[Row]], pl.DataFrame | None]:
        """Return rows of a night that a fit anew needs, and its blocks."""
        rows = self.rows(label, map(TABLE_OF.__getitem__, FROM_TABLES))
        return rows, self._of_night(BLOCKS, label)

    def _of_night(self, table: Table, label: dt.date) -> pl.DataFrame | None:
        return self._of_month(table, f"{label:%Y-%m}").get(label)

    def _read(self, table: Table, month: str) -> dict[dt.date, pl.DataFrame]:
        if not files_of(self._output, table, days_of(month)):
            return {}
        every = tuple(name for name in table.schema if name != "run_id")
        columns = {BLOCKS: BLOCK_COLUMNS, NIGHTS: OF_NIGHT}.get(table, every)
        try:
            rows = read_rows(self._output, table, [self._motor_id], columns, days_of(month))
        except StoreError as error:
            log.warning("%s; no night of %s is made from it", error, month)
            return {}
        nights = rows.sort(table.key).partition_by("night", as_dict=True, maintain_order=True)
        return {key[0]: part for key, part in nights.items()}


def _samples_of(quality: Iterable[Row]) -> int:
    """Return the number of different samples of all channels, by a night's rows of `quality`."""
    logged: dict[str, int] = {}
    absent = 0
    for row in quality:
        if row["channel"] != "time_base":
            # A rule on pairs of samples looks at fewer.
            logged[row["channel"]] = max(logged.get(row["channel"], 0), row["n_samples"])
            absent += row["n_refused"] if row["reason"] in NO_SAMPLES else 0
    return sum(logged.values()) - absent


def _why_less(made: RowsByTable, published: RowsByTable) -> str | None:
    """Return why a night is made of less than its published rows, in words; None: it is not."""
    now, before = (_samples_of(rows.get("quality", ())) for rows in (made, published))
    if now < before:
        return f"its logs hold {now} samples now, and held {before}" if now else NO_LOG
    (new,), (old,) = made["nights"], published["nights"]
    for name, at, sign in (("first_sample", "begin", -1), ("last_sample", "end", 1)):
        if old[name] is None:
            continue
        if new[name] is None:
            return "no sample of its logs is kept"
        if sign * (old[name] - new[name]) > CLOSE:
            return f"its logs {at} at {new[name]:%H:%M} UTC now, and at {old[name]:%H:%M} before"
    return None
