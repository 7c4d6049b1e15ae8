"""A motor's nights: what is new in its logs, what is to be made anew, and what came of it.

Nothing here makes a night, so nothing loads the science.
"""

from __future__ import annotations

import datetime as dt
import resource
import time
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.config.hashes import ROLLER, SettingsHashes, settings_of, why_anew
from pipeline.logs.files import labels_of
from pipeline.logs.motor_logs import MotorLogs
from pipeline.logs.processed import (
    GONE,
    FileRecord,
    NightRecord,
    ProcessedChange,
    ProcessedLogs,
    as_published,
    read_processed,
    read_settings,
)
from pipeline.messages import counted
from pipeline.run.tasks import MotorOutcome, MotorTask, RunRequest, Step, Work
from pipeline.schema import (
    DECIDING_NIGHTS,
    FAILED,
    INSUFFICIENT_DATA,
    NO_NEW_DATA,
    OK,
    WITH_SAMPLES,
)
from pipeline.store.state import read_state_file
from pipeline.trends.decisions import read_decisions
from pipeline.trends.motor_states import CHANGED, published_states
from pipeline.trends.tasks import decisions_of, read_records, trend_hash

if TYPE_CHECKING:
    from pipeline.night.fit_night import NightOutcome

NO_LOG = "no log covers it any more"
# First nights of a baseline that decide on the scale of the rollers, and the part of them that has
# to identify it: later nights are like most of them.
ROLLER_NIGHTS, MOST = 15, 0.8


def peak_memory_mib() -> float:
    # `ru_maxrss` begins with the peak of the process that started this; Linux knows better.
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text("ascii").splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _without_failures(processed: ProcessedLogs) -> ProcessedLogs:
    """Return a record of processed logs that knows nothing of the logs and nights that failed."""
    nights = {label: night for label, night in processed.nights.items() if night.status != FAILED}
    failed = processed.nights.keys() - nights.keys()
    files = {
        name: file
        for name, file in processed.files.items()
        if file.status == "ok" and not labels_of(file) & failed
    }
    return ProcessedLogs(files, nights)


def roller_decision(
    identified: Mapping[dt.date, bool | None], begins: Sequence[dt.date]
) -> dict[str, Any] | None:
    """Return what the first nights of the latest baseline with enough say of the rollers' scale.

    `identified` says by night whether it identifies the scale, None without a fit; `begins` are the
    dates of the events that begin a baseline. None where no baseline has its nights.
    """
    borders = sorted({dt.date.min, *begins, dt.date.max})
    for begin, end in reversed(list(pairwise(borders))):
        nights = sorted(label for label in identified if begin <= label < end)
        first = [identified[label] for label in nights if identified[label] is not None]
        first = first[:ROLLER_NIGHTS]
        if len(first) == ROLLER_NIGHTS:
            return {"since": str(begin), "is_free": sum(map(bool, first)) >= MOST * len(first)}
    return None


class NightPlan:
    """The nights of a motor during its task."""

    def __init__(self, task: MotorTask) -> None:
        self.task = task
        self.spec = task.spec
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.settings_before = task.processed.settings or {}
        before = _without_failures(task.processed) if task.retry else task.processed
        with self.timed("read_s"):
            self.logs = MotorLogs(
                self.spec, before.files, task.latest_us, task.silent, task.log_records
            )
        self.abandoned = self._without_log()
        self.logs.before = {
            name: file
            for name, file in before.files.items()
            if not labels_of(file) & self.abandoned
        }
        self.nights_before = before.nights
        self.roller = self.settings_before.get(ROLLER)
        self.fitted_spec = as_published(self.spec, self.settings_before)
        self.hashes = SettingsHashes(self.fitted_spec)
        self.is_delay_decided = False  # in this run
        self.done: dict[dt.date, NightOutcome] = {}
        self.records: dict[dt.date, NightRecord] = dict(before.nights)
        self.stays: dict[dt.date, str] = {}
        self._note_gone()
        self.by_settings = self._outdated_by_settings()

    @cached_property
    def why_anew(self) -> str:
        """What changed since the run before, in words."""
        return why_anew(self.settings_before, self.hashes.settings)

    @contextmanager
    def timed(self, stage_name: str) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage_name] += time.perf_counter() - begin

    @property
    def is_quiet(self) -> bool:
        """True where no night is to be made, and nothing to be decided."""
        is_decided = self.roller_decision_due() is None and not self.nights_of_delay()
        return is_decided and not self.open_nights()

    def _note_gone(self) -> None:
        """Note which published nights have no log any more, and which have a log again."""
        if not self.logs.files or self.task.silent:
            return
        present = self.logs.present()
        for label, record in self.nights_before.items():
            stays = "" if label in present else GONE
            if record.status in WITH_SAMPLES and {record.stays, stays} == {"", GONE}:
                self.records[label] = replace(record, stays=stays)

    def _outdated_by_settings(self) -> dict[dt.date, Step]:
        """Return nights that were made with other settings and how far to make them anew."""
        present, steps = self.logs.present(), {}
        for label, record in self.nights_before.items():
            if not record.statistics_hash:
                continue
            statistics, figures = self.hashes.statistics(label), self.hashes.figures(label)
            if (record.statistics_hash, record.figures_hash) == (statistics, figures):
                if record.refused:  # The settings are again those that it was made with.
                    self.records[label] = replace(record, stays="", refused="")
            elif record.refused != f"{statistics} {figures}":
                is_of_blocks = record.statistics_hash == statistics and record.status == OK
                if is_of_blocks or label in present:
                    work = Work.REFIT if is_of_blocks else Work.READ
                    steps[label] = Step(work, self.why_anew)
                elif record.status in WITH_SAMPLES:
                    steps[label] = Step(Work.STAY, f"{self.why_anew}, and {GONE}")
        asked = filter(self.task.asks_for, present)
        return steps | dict.fromkeys(asked, Step(Work.READ, "asked for"))

    def open_nights(self) -> dict[dt.date, Step]:
        """Return nights still to do within the asked-for range."""
        later = dict(self.by_settings)
        present, waiting = self.logs.present(), self.logs.waiting()
        for name in self.logs.files:
            if (news := self.logs.news_of(name)) is not None:
                # A night of which there is no log, or not yet, is none to be done.
                reached = self.logs.touched(name) | (self.logs.reached(name) & present)
                later |= {label: self._step(label, news, present) for label in reached}
        later |= dict.fromkeys(self.abandoned, Step(Work.READ, "its log is gone"))
        later |= {
            label: Step(Work.READ, "released for fitting")
            for label, record in self.nights_before.items()
            if record.status == FAILED and label in self.task.released
        }
        done = self.done.keys() | self.stays.keys() | waiting
        return {
            label: step
            for label, step in later.items()
            if label not in done and self.task.wants(label)
        }

    def _step(self, label: dt.date, news: str, present: set[dt.date]) -> Step:
        """Return what is to be done about a night of which a log has news."""
        is_lost = label not in present and self.is_published(label) and not self.has_its_logs(label)
        return Step(Work.STAY, NO_LOG) if is_lost else Step(Work.READ, news)

    def is_published(self, label: dt.date) -> bool:
        """Return True where a night was made from samples."""
        record = self.nights_before.get(label)
        return record is not None and record.status in WITH_SAMPLES

    def has_its_logs(self, label: dt.date) -> bool:
        """Return True where all is there that a night was made from."""
        record = self.nights_before.get(label)
        return record is not None and self.logs.has_contents(record.logs)

    def stay(self, label: dt.date, why: str, status: str = OK) -> None:
        """Leave a night as it is published, and note why."""
        record = self.nights_before.get(label) or NightRecord(status)
        settings = self.hashes.statistics(label), self.hashes.figures(label)
        is_of_them = settings == (record.statistics_hash, record.figures_hash)
        refused = "" if is_of_them else " ".join(settings)
        self.records[label] = replace(record, stays=why, refused=refused)
        self.stays[label] = why

    def holes(self) -> list[dt.date]:
        """Return nights between two logs that no log covers and that have no row yet."""
        if not self.done:
            return []
        certain = {label for label, record in self.records.items() if record.status != FAILED}
        return sorted(filter(self.task.wants, self.logs.holes(certain) - self.records.keys()))

    def roller_decision_due(self) -> dict[str, Any] | None:
        """Return the decision on the rollers' scale if it is to be made: once in a baseline."""
        identified = {label: record.roller_identified for label, record in self.records.items()}
        begins = [event.date for event in self.spec.file.baseline_events]
        decision = roller_decision(identified, begins)
        is_new = decision is not None and (self.roller or {}).get("since") != decision["since"]
        return decision if is_new else None

    def nights_of_delay(self) -> list[dt.date]:
        """Return nights that decide on the drain flow's delay; empty if decided, or too early.

        The first ones, once; the first ones asked for where somebody wants nights made anew.
        """
        if not self.spec.settings.transport_delay.is_estimated:
            return []
        is_asked = self.task.redo is not None
        if (self.fitted_spec.drain_delay_s is not None and not is_asked) or self.is_delay_decided:
            return []
        fitted = [
            label
            for label, record in sorted(self.records.items())
            if record.status == OK
            and (not is_asked or (label in self.done and self.task.asks_for(label)))
        ]
        return fitted[:DECIDING_NIGHTS] if len(fitted) >= DECIDING_NIGHTS else []

    def _without_log(self) -> set[dt.date]:
        """Return failed nights whose log somebody has removed: nothing fails any more."""
        # Nobody can say so where a folder is not mounted, or does not answer.
        if not (self.logs.files or self.task.retry) or self.task.silent:
            return set()
        failed = {
            label
            for label, night in self.task.processed.nights.items()
            if night.status == FAILED and self.task.wants(label)
        }
        return failed - self.logs.present()

    def _made_anew(self) -> str:
        """Return how many published nights other settings made anew, in words; empty for none."""
        before, now, asks_for = self.settings_before, self.hashes.settings, self.task.asks_for
        labels = [night for night in self.done if self.is_published(night) and not asks_for(night)]
        is_other = any(before.get(part) != now[part] for part in ("versions", "nights"))
        nights = counted(len(labels), "night")
        return f"{nights} made anew: {self.why_anew}" if labels and is_other else ""

    def _n_standing(self) -> int:
        """Return failures that stand after this run: nights, logs of no night, and absent logs."""
        failed = [
            label
            for label, record in self.records.items()
            if record.status == FAILED and label not in self.task.excluded
        ]
        return len(failed) + len(self._failed_logs()) + len(self.logs.absent)

    def _failed_logs(self) -> dict[str, FileRecord]:
        """Return logs that cannot be read, and that no night fails with."""
        staying = {label for label, record in self.records.items() if record.stays}
        return {
            name: file
            for name, file in self.logs.files.items()
            if file.status == "failed" and labels_of(file) <= staying
        }

    def _why_nothing(self, status: str) -> str | None:
        """Return the reason for no fit although nothing failed; None with a fit, or none to do."""
        if not self.logs.files:
            return "; ".join(self.logs.unmatched()) or None
        if self.task.redo and not any(map(self.task.asks_for, self.done)):
            return "no log covers a night of --redo: what is published stays"
        if status != INSUFFICIENT_DATA:
            return None
        label = min(label for label, night in self.done.items() if night.status == status)
        return f"night {label}: {self.done[label].reason}"

    def outcome(self) -> MotorOutcome:
        counts = Counter(outcome.status for outcome in self.done.values())
        errors: list[tuple[str | None, str | None]] = [
            (night.error_code, f"night {label}: {night.reason}")
            for label, night in sorted(self.done.items())
            if night.status == FAILED
        ]
        errors += [
            (record.error_code, record.message)
            for name, record in self._failed_logs().items()
            if self.logs.news_of(name) is not None
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
        settled = self.done.keys() | self.stays.keys()
        files = {**self.logs.before, **self.logs.finished(settled)}
        settings = self.hashes.settings | ({ROLLER: self.roller} if self.roller else {})
        after = ProcessedLogs(files, self.records, settings)
        return MotorOutcome(
            motor_id=self.spec.motor_id,
            status=status,
            error_code=code,
            message=message,
            counts=counts,
            nights=tuple(sorted(self.done)),
            anew=self._made_anew(),
            inputs=tuple(self.logs.files[name].sha256 or "" for name in sorted(self.logs.read)),
            files=self.logs.counts(settled),
            stays={
                label: why
                for label, why in sorted(self.stays.items())
                if why != getattr(self.nights_before.get(label), "stays", "")
            },
            growing=tuple(self.logs.growing()),
            left_out=tuple(self.logs.left_out()),
            n_standing=self._n_standing(),
            seconds=dict(self.seconds),
            peak_memory_mib=peak_memory_mib(),
            change=ProcessedChange.between(self.task.processed, after),
        )


def plan_fleet(request: RunRequest) -> Iterator[tuple[str, Mapping[dt.date, Step]]]:
    """Yield nights that a run would do, motor by motor, and why; of logs only the ends are read.

    Raises StoreError if a published table that is needed is damaged.
    """
    output = request.fleet.output
    with read_state_file(output) as state:
        for task in request.tasks(output / "staging"):
            known = replace(task, processed=read_processed(state, task.spec.motor_id))
            yield task.spec.motor_id, dict(sorted(NightPlan(known).open_nights().items()))


def plan_states(
    request: RunRequest, changed: Collection[str], stays: Collection[str]
) -> Iterator[tuple[str, str]]:
    """Yield motors with a state in force whose trends are made anew by other settings, with what
    becomes of it, in words; `stays` are those of which some nights stay as they are.
    """
    for motor in published_states(request.fleet.output, sorted(changed)):
        if motor.state in CHANGED:
            how = "is judged anew: it stays in force, or its end is reported"
            if motor.motor_id in stays:
                how = "stays in force: nights before keep the settings they were made with"
            yield motor.motor_id, f"{motor.state} since {motor.row['state_since']} {how}"


def plan_trends(request: RunRequest) -> Iterator[tuple[str, str]]:
    """Yield motors whose trends a run would make anew from their first night on, and why, in words.

    Those of nights that are new or made anew follow in any case.
    """
    output, specs = request.fleet.output, request.specs
    decisions = decisions_of(specs, read_decisions(output))
    with read_state_file(output) as state:
        records, settings = read_records(state), read_settings(state)
    for spec in (as_published(spec, settings.get(spec.motor_id)) for spec in specs):
        record = records.get(spec.motor_id)
        if record is not None and record.trend_hash != trend_hash(spec, decisions[spec.motor_id]):
            before, now = settings.get(spec.motor_id, {}), settings_of(spec)
            yield (
                spec.motor_id,
                "a baseline was reset, or a new version"
                if {**before, **now} == before
                else why_anew(before, now, trends=True),
            )
