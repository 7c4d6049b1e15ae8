"""One motor's task: what is new in its logs, which nights that touches, and the fit of each.

The task reads the logs and its own ledger, writes only into its own staging files, and returns a
small outcome. Whatever goes wrong with a log or a night is a row, not an exception.
"""

from __future__ import annotations

import datetime as dt
import logging
import pickle
import resource
import time
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import polars as pl
from polars.exceptions import PanicException
from threadpoolctl import threadpool_limits

from pipeline.config.hashes import SettingsHashes, hash_of, settings_of, why_anew
from pipeline.config.nights import night, nights_between
from pipeline.errors import StoreError
from pipeline.logs.files import is_guess, labels_of, legible, reaches_us, slice_night
from pipeline.logs.ledger import (
    FileRecord,
    Ledger,
    NightRecord,
    as_published,
    changed_months,
    ledger_folder,
    read_ledger,
    read_settings,
)
from pipeline.logs.motor_logs import LogShelf
from pipeline.messages import speak_as_told
from pipeline.night.fit_night import NightOutcome, PreviousModel, fit_night, unfitted
from pipeline.night.refit import is_refit, judged
from pipeline.night.roller import is_roller_free
from pipeline.night.rows import Row
from pipeline.run.stored_nights import StoredNights
from pipeline.run.tasks import (
    MOST_GIVEN_UP,
    MotorOutcome,
    MotorTask,
    Step,
    Work,
    lost,
)
from pipeline.schema import FITS, INPUT_FILES, NIGHT_TABLES
from pipeline.schema.fits import FAILED, INSUFFICIENT_DATA, NO_NEW_DATA, OK
from pipeline.store.atomic_files import scratch
from pipeline.store.tables import nights_back, read_rows, stage
from pipeline.workers.process import Loss, loss_of, sign_of_life

log = logging.getLogger(__name__)

# A longer silence between two logs is no row of nights without a log: a clock was wrong, or the
# motor stood in store.
LONGEST_HOLE = dt.timedelta(days=366)


def plan_motor(task: MotorTask) -> dict[dt.date, Step]:
    """The plan of a motor, night by night, with reasons; of logs only the ends are read.

    Raises
    ------
    StoreError
        If a published table that it needs is damaged.
    """
    return _Nights(replace(task, looks_first=True)).plan()


def run_motor(task: MotorTask) -> MotorOutcome:
    """Do everything that is new for a motor, or a chunk of its nights, and stage its rows.

    Raises
    ------
    MemoryError
        If there is not enough memory for what all its nights need.
    """
    speak_as_told()
    with threadpool_limits(1):
        try:
            return _done(task)
        except StoreError as error:
            return lost(task, Loss(error.code, error.message))
        except MemoryError:  # a fresh worker may have what it takes
            raise
        except (Exception, PanicException) as error:
            log.exception("motor %s failed", task.spec.motor_id)
            return lost(task, loss_of(error))


def _done(task: MotorTask) -> MotorOutcome:
    """The outcome of a chunk, of a plan of chunks, or of a motor."""
    if task.nights is not None:
        return _make_chunk(task, task.nights)
    # Written by this run, below a folder of its own.
    chunks = [pickle.loads((task.staging / name).read_bytes()) for name in task.chunks]  # noqa: S301
    given_up = dict.fromkeys((*task.given_up, *(one for part in chunks for one in part.given_up)))
    task = replace(task, given_up=tuple(given_up))
    if len(task.lost_nights) > MOST_GIVEN_UP:
        # The loss at which a motor that is not done in chunks would have been given up.
        return lost(task, task.lost_nights[sorted(task.lost_nights)[MOST_GIVEN_UP]])
    nights = _Nights(task, chunks)
    return nights.plan_of_chunks() or nights.run()


def _make_chunk(task: MotorTask, labels: Sequence[dt.date]) -> MotorOutcome:
    """Read and fit a chunk of nights, and leave them for the task that joins them."""
    nights = _Nights(task)
    made = nights.make(labels)
    seconds, memory = dict(nights.seconds), _peak_memory_mib()
    try:
        with scratch(task.staging / task.chunk) as stream:
            pickle.dump(_Chunk(made, task.given_up, seconds, memory), stream)
    except OSError as error:
        why = error.strerror or error
        raise StoreError("store_write", f"{task.chunk} cannot be written: {why}") from error
    return MotorOutcome(
        task.spec.motor_id, OK, seconds=seconds, peak_memory_mib=memory, chunk=task.chunk
    )


def _peak_memory_mib() -> float:
    # `ru_maxrss` begins with the peak of the process that started this one; Linux knows better.
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text("ascii").splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _hash_of_model(model: PreviousModel) -> str:
    return _hash_of_items(tuple(sorted((mode, tuple(theta)) for mode, theta in model.items())))


@lru_cache(maxsize=8192)
def _hash_of_items(items: tuple[tuple[str, tuple[float, ...]], ...]) -> str:
    return hash_of(dict(items))


@dataclass(frozen=True, slots=True)
class _ChunkNight:
    """A night of a chunk, with its files, in order, as they were known before and after it."""

    outcome: NightOutcome
    before: Mapping[str, FileRecord]
    after: Mapping[str, FileRecord]
    read: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Chunk:
    """A chunk on its way to the task that joins it."""

    nights: Mapping[dt.date, _ChunkNight]
    given_up: tuple[Loss, ...]
    seconds: Mapping[str, float]
    peak_memory_mib: float


def _tells_roller(outcome: NightOutcome) -> bool | None:
    """Whether a night's primary fit tells the scale of the rollers' curve; None without either."""
    verdicts = [row.get("roller_verdict") for row in outcome.rows["fits"] if row["is_primary"]]
    return verdicts[0] and verdicts[0] == "identified"


def _still_published(ledger: Ledger, output: Path) -> Ledger:
    """A ledger without the nights whose tables somebody removed: they are to be made anew."""
    gone = ledger.nights.keys() - set(nights_back(output, FITS))
    return Ledger(
        files={name: one for name, one in ledger.files.items() if not labels_of(one) & gone},
        nights={label: one for label, one in ledger.nights.items() if label not in gone},
    )


def _place_of(record: FileRecord, nights: Collection[dt.date]) -> dt.date | None:
    """Night under which a file's row stands: its first, or else the motor's first; None: none."""
    return min(labels_of(record) or nights, default=None)


def _without_failures(ledger: Ledger) -> Ledger:
    """A ledger that knows nothing of the logs and nights that failed."""
    nights = {label: one for label, one in ledger.nights.items() if one.status != FAILED}
    failed = ledger.nights.keys() - nights.keys()
    files = {
        name: one
        for name, one in ledger.files.items()
        if one.status == "ok" and not labels_of(one) & failed
    }
    return Ledger(files, nights)


class _Nights:
    """A motor's nights while its task works through them."""

    def __init__(self, task: MotorTask, chunks: Sequence[_Chunk] = ()) -> None:
        self.task = task
        self.spec = task.spec
        self.made = {label: one for chunk in chunks for label, one in chunk.nights.items()}
        self.memory_of_chunks = [chunk.peak_memory_mib for chunk in chunks]
        self.seconds: defaultdict[str, float] = defaultdict(float)
        for chunk in chunks:
            self._add(chunk.seconds)
        self.lost_nights = task.lost_nights
        self.remembered = read_ledger(task.output, task.spec.motor_id)
        self.before = _still_published(self.remembered, task.output)
        if task.retry:
            self.before = _without_failures(self.before)
        with self._timed("read_s"):
            self.logs = LogShelf(
                self.spec,
                self.before.files,
                task.latest_us,
                task.silent,
                task.looked_at,
                reads_new=not (task.looks_first or task.since or task.until),
            )
        self.withdrawn = self._no_longer_told()
        self.before = Ledger(
            self.logs.before,
            {
                label: one
                for label, one in self.before.nights.items()
                if label not in self.withdrawn
            },
        )
        self.form = as_published(task.output, self.spec)
        self.hashes = SettingsHashes(self.form)
        self.stored = StoredNights(task.output, self.spec, with_starts=task.with_starts)
        self.done: dict[dt.date, NightOutcome] = {}
        # Nights of this run as the model is stated.
        self.stated: dict[dt.date, NightOutcome] = {}
        self.records: dict[dt.date, NightRecord] = dict(self.before.nights)
        self.kept: set[dt.date] = set()
        self.reasons: dict[dt.date, str] = {}
        self.by_settings = self._outdated_by_settings()

    def _no_longer_told(self) -> set[dt.date]:
        """Published nights that only the name or time of an unreadable log told, and may not."""
        files = self.remembered.files.values()
        told = {label for one in files if is_guess(one) for label in labels_of(one)}
        if not ledger_folder(self.task.output, self.spec.motor_id).exists():
            # Without its ledger the tables alone say which nights failed.
            columns = ("motor_id", "night", "status")
            rows = read_rows(self.task.output, FITS, [self.spec.motor_id], columns)
            told |= set(rows.filter(status=FAILED)["night"])
        sure = {label for one in files if not is_guess(one) for label in labels_of(one)}
        none = {label for label in told if self.logs.plausible.why_not(label) is not None}
        return none - sure - self.logs.present()

    def plan_of_chunks(self) -> MotorOutcome | None:
        """The chunks in which the motor's nights are to be made; None: here, in one."""
        size = self.task.nights_a_chunk
        if not size or self.task.looked_at is not None:
            return None
        labels = [label for label, step in self.plan().items() if step.work is Work.READ]
        if len(labels) <= size:
            return None
        planned = replace(self.task, looked_at=self.logs.files)
        parts = [tuple(labels[at : at + size]) for at in range(0, len(labels), size)]
        chunks = tuple(replace(planned, nights=nights) for nights in parts)
        return MotorOutcome(self.spec.motor_id, OK, to_do=chunks)

    def make(self, labels: Sequence[dt.date]) -> dict[dt.date, _ChunkNight]:
        """Read and fit some nights, each on its own."""
        made = {}
        for label in labels:
            if label in self.lost_nights:
                continue
            known = dict(self.logs.files)
            used = self.logs.used_by(night(label, self.spec.settings.nights))
            outcome = self._night(label, Work.READ, {})
            assert outcome is not None
            made[label] = _ChunkNight(
                outcome,
                {name: known[name] for name in used},
                {name: self.logs.files[name] for name in used},
                frozenset(used) & self.logs.read,
            )
        sign_of_life("")
        return made

    def run(self) -> MotorOutcome:
        # Reading may show that a log covers other nights than its ends had told, so look again.
        while plan := self._plan():
            label = min(plan)
            before = self._model_before(label)
            outcome = self._night(label, plan[label].work, before)
            self.reasons[label] = plan[label].reason
            if outcome is None:
                self.kept.add(label)
                continue
            self._remember(outcome, before)
            self._add(outcome.seconds)
            # Also those that an earlier state of a file had been read for.
            for waiting in self.logs.waiting() & self.done.keys():
                self._take_back(waiting)
        if self._is_roller_free() != self.form.roller_is_free:
            self._change_form()
        for label in self._holes():
            reason = "no log covers this night"
            self.done[label] = unfitted(self.spec, label, NO_NEW_DATA, reason)
            self.records[label] = NightRecord(NO_NEW_DATA)
        sign_of_life("")
        with self._timed("store_s"):
            self._stage()
        return self._outcome()

    def _add(self, seconds: Mapping[str, float]) -> None:
        for stage_name, taken in seconds.items():
            self.seconds[stage_name] += taken

    @contextmanager
    def _timed(self, stage_name: str) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage_name] += time.perf_counter() - begin

    def plan(self) -> dict[dt.date, Step]:
        """Nights that a run would do now, and why; reading may add some."""
        return dict(sorted(self._plan().items()))

    def _outdated_by_settings(self) -> dict[dt.date, Step]:
        """Nights that were made with other settings, and how far they have to be made anew."""
        present, found = self.logs.present(), {}
        if self.task.force:
            return dict.fromkeys(present, Step(Work.READ, "asked for"))
        before = read_settings(self.task.output, self.spec.motor_id)
        why = why_anew(before, settings_of(self.form))
        for label, record in self.before.nights.items():
            if not record.statistics_hash:
                continue
            if record.statistics_hash != self.hashes.statistics(label):
                # Where the logs are gone, what is published stays.
                if label in present:
                    found[label] = Step(Work.READ, why)
            elif record.figures_hash != self.hashes.figures(label):
                found[label] = Step(Work.REFIT if record.model else Work.READ, why)
        if self.task.with_starts:
            for label in self.stored.refitted() & self.before.nights.keys() - found.keys():
                found[label] = Step(Work.REFIT, "its starts are asked for")
        return found

    def _plan(self) -> dict[dt.date, Step]:
        """Nights still to do within the asked-for range."""
        outdated = self._outdated_by_model()
        # What is not published yet cannot be judged from the tables.
        plan = {
            label: Step(Work.READ, step.reason)
            for label, step in outdated.items()
            if label in self.done
        }
        later = outdated | self.by_settings
        present, waiting = self.logs.present(), self.logs.waiting()
        for name in self.logs.files:
            if (news := self.logs.news_of(name)) is not None:
                # A night of which there is no log, or not yet, is none to be done.
                reached = self.logs.touched(name) | (self.logs.reached(name) & present)
                later |= dict.fromkeys(reached, Step(Work.READ, news))
        plan |= {label: step for label, step in later.items() if label not in self.done}
        return {
            label: step
            for label, step in plan.items()
            if label not in self.kept | waiting and self.task.wants(label)
        }

    def _outdated_by_model(self) -> dict[dt.date, Step]:
        """Nights with a fit that was judged with another model than the one before it now."""
        found, before = {}, _hash_of_model({})
        for label, record in sorted(self.records.items()):
            if not record.model:
                continue
            if record.judged_with != before:
                found[label] = Step(Work.JUDGE, "another model before it")
            before = _hash_of_model(record.model)
        return found

    def _take_back(self, label: dt.date) -> None:
        """Leave a night to the next run, as if it had not been done in this one."""
        del self.done[label]
        if label in self.before.nights:
            self.records[label] = self.before.nights[label]
        else:
            del self.records[label]

    def _remember(self, outcome: NightOutcome, before: PreviousModel) -> None:
        label = outcome.night
        self.done[label] = outcome
        self.records[label] = NightRecord(
            outcome.status,
            outcome.model,
            _hash_of_model(before),
            self.hashes.statistics(label),
            self.hashes.figures(label),
            _tells_roller(outcome),
        )

    def _holes(self) -> list[dt.date]:
        """Nights between two logs that no log covers and no row tells of yet."""
        if not self.done:
            return []
        told = self.logs.present() | self.records.keys()
        # A file that cannot be read may stand far off: its night is a guess.
        readable = [one for one in self.logs.files.values() if one.status == "ok"]
        certain = {label for record in readable for label in labels_of(record)}
        certain |= {label for label, one in self.records.items() if one.status != FAILED}
        between = {
            label
            for first, last in pairwise(sorted(certain))
            if last - first <= LONGEST_HOLE
            for label in nights_between(first, last)
        }
        return sorted(label for label in between - told if self.task.wants(label))

    def _night(self, label: dt.date, work: Work, before: PreviousModel) -> NightOutcome | None:
        """Outcome of a night; None where it stays as published, for want of its log."""
        if given_up := self.lost_nights.get(label):
            return unfitted(self.spec, label, FAILED, legible(given_up.how), code=given_up.code)
        sign_of_life(label.isoformat())
        try:
            if work is not Work.READ:
                make = self.stored.refit if work is Work.REFIT else self.stored.judge
                with self._timed("refit_s"):
                    outcome = make(label, before)
                if work is Work.JUDGE and outcome is not None:
                    return outcome
                if outcome is not None or label not in self.logs.present():
                    return outcome and self._in_form(outcome, before)
            return self._in_form(self._read_and_fit(label, before), before)
        except StoreError:
            raise
        except (Exception, PanicException) as error:  # one night must not cost the motor's others
            log.exception("motor %s, night %s failed", self.spec.motor_id, label)
            loss = loss_of(error)
            return unfitted(self.spec, label, FAILED, legible(loss.how), code=loss.code)

    def _in_form(self, stated: NightOutcome, before: PreviousModel) -> NightOutcome:
        """A night's outcome in the form in which the motor's fits are published."""
        self.stated[stated.night] = stated
        if not self.form.roller_is_free or stated.status != OK:
            return stated
        with self._timed("refit_s"):
            return self.stored.with_free_roller(stated, before) or stated

    def _is_roller_free(self) -> bool:
        """The decision of the motor's nights; as it is where only some of them were asked for."""
        if self.spec.settings.model.roller_scale == "fixed":
            return False
        if self.task.since is not None or self.task.until is not None:
            return self.form.roller_is_free
        told = {label: one.tells_roller for label, one in self.records.items()}
        begins = [event.date for event in self.spec.file.events]
        return is_roller_free(told, begins, self.spec.settings.trend.provisional_nights)

    def _change_form(self) -> None:
        """All nights with a fit in the other form, in order: each is judged with the one before."""
        self.form = replace(self.spec, roller_is_free=not self.form.roller_is_free)
        self.hashes = SettingsHashes(self.form)
        for label in sorted(label for label, one in self.records.items() if one.model):
            before = self._model_before(label)
            stated = self.stated.get(label) or self.stored.stated(label, before)
            if stated is not None:
                self.reasons.setdefault(label, "the scale of its rollers is estimated, or no more")
                self._remember(self._in_form(stated, before), before)

    def _read_and_fit(self, label: dt.date, before: PreviousModel) -> NightOutcome:
        here = night(label, self.spec.settings.nights)
        made = self.made.get(label)
        if made is not None and self.logs.take_over(here, made.before, made.after, made.read):
            return judged(self.spec, made.outcome, before)
        with self._timed("read_s"):
            names = self.logs.of_night(label)
            read = [self.logs.content(name) for name in (*self.logs.before_night(here), *names)]
        broken = [one for name in names if (one := self.logs.files[name]).status != "ok"]
        if broken:
            return unfitted(
                self.spec, label, FAILED, broken[0].message or "", code=broken[0].error_code
            )
        contents = [one for one in read if one is not None]
        channels = slice_night(contents, here, reaches_us(self.spec))
        # The night has what it needs of them, and gives it up bit by bit.
        del read, contents
        self.logs.let_go_until(label)
        if not any((channel.time_us >= here.start_us).any() for channel in channels.values()):
            return unfitted(self.spec, label, NO_NEW_DATA, "no log covers this night")
        return fit_night(self.spec, here, channels, before)

    def _model_before(self, label: dt.date) -> PreviousModel:
        return Ledger(nights=self.records).model_before(label)

    def _stage(self) -> None:
        by_table: defaultdict[str, dict[dt.date, list[Row]]] = defaultdict(dict)
        for label, outcome in self.done.items():
            for table in NIGHT_TABLES:
                # A night made anew in part keeps what only its samples tell.
                if outcome.tables is None or table.name in outcome.tables:
                    by_table[table.name][label] = outcome.rows.get(table.name, [])
        for label in self.withdrawn:
            for table in NIGHT_TABLES:
                by_table[table.name][label] = []
        by_table["input_files"] = self._file_rows(by_table["input_files"].keys())
        for table in NIGHT_TABLES:
            if nights := by_table[table.name]:
                stage(self.task.staging / table.name / f"{self.spec.motor_id}.arrow", table, nights)

    def _file_rows(self, staged: Collection[dt.date]) -> dict[dt.date, list[Row]]:
        """Rows of `input_files` of some nights, and of those which a file's row leaves or enters.

        Of a night that is not done, the other rows stay as they are.
        """
        rows: defaultdict[dt.date, list[Row]] = defaultdict(list)
        moved: defaultdict[dt.date, set[str]] = defaultdict(set)
        for row in self.logs.rows():
            name = row["path"]
            now, known = self.logs.files[name], self.remembered.files.get(name)
            here = _place_of(now, self.records)
            there = None if known is None else _place_of(known, self.remembered.nights)
            is_new = row["night"] is None and now != known
            if here is None or not (here in staged or is_new):
                continue
            rows[here].append(row)
            for place in (here, there):
                if place is not None and place not in staged and (is_new or place != here):
                    moved[place].add(name)
        for label, names in sorted(moved.items()):
            published = read_rows(
                self.task.output, INPUT_FILES, [self.spec.motor_id], nights=[label]
            )
            kept = published.drop("run_id").filter(~pl.col("path").is_in(list(names)))
            rows[label] += kept.to_dicts()
        return {label: rows[label] for label in sorted({*staged, *moved})}

    def _why_nothing(self, status: str) -> str | None:
        """The reason for no fit although nothing failed; None: there is one, or none was to do."""
        if not self.logs.files:
            return "; ".join(self.logs.unmatched()) or None
        if status != INSUFFICIENT_DATA:
            return None
        label = min(label for label, one in self.done.items() if one.status == status)
        return f"night {label}: {self.done[label].reason}"

    def _outcome(self) -> MotorOutcome:
        counts = Counter(outcome.status for outcome in self.done.values())
        errors: list[tuple[str | None, str | None]] = [
            (one.error_code, f"night {label}: {one.reason}")
            for label, one in sorted(self.done.items())
            if one.status == FAILED
        ]
        errors += [
            (record.error_code, record.message)
            for name, record in self.logs.files.items()
            if record.status == "failed"
            and not record.nights
            and self.logs.news_of(name) is not None
        ]
        errors += [
            ("log_missing", f"{name}: named in the config and absent") for name in self.logs.absent
        ]
        errors += [
            (loss.code, loss.how)
            for name, loss in self.task.silent.items()
            if name not in self.logs.files
        ]
        if errors:
            status = FAILED
        elif counts[OK]:
            status = OK
        else:
            status = counts.most_common(1)[0][0] if counts else NO_NEW_DATA
        code, message = errors[0] if errors else (None, self._why_nothing(status))
        if self.withdrawn:
            nights = ", ".join(map(str, sorted(self.withdrawn)))
            gone = f"withdrawn, as no log has samples of them: {nights}"
            message = "; ".join(one for one in (message, gone) if one)
        after = Ledger(
            {**self.before.files, **self.logs.finished(self.done)},
            self.records,
        )
        return MotorOutcome(
            motor_id=self.spec.motor_id,
            status=status,
            error_code=code,
            message=message,
            counts=counts,
            nights=tuple(sorted({*self.done, *self.withdrawn})),
            withdrawn=tuple(sorted(self.withdrawn)),
            reasons=Counter(self.reasons[label] for label in self.done if label in self.reasons),
            n_refitted=sum(is_refit(one) for one in self.done.values()),
            inputs=tuple(self.logs.files[name].sha256 or "" for name in sorted(self.logs.read)),
            files=self.logs.counts(self.done),
            growing=tuple(self.logs.growing()),
            roller_is_free=self.form.roller_is_free,
            ledger=changed_months(self.remembered, after),
            seconds=dict(self.seconds),
            peak_memory_mib=max([_peak_memory_mib(), *self.memory_of_chunks]),
        )
