"""Mending of damaged output, by a run or by `check --tables --mend`.

Nothing is mended in its place. A damaged file is put aside, and its nights are forgotten, so that a
run makes them anew from logs or stored blocks. A manifest lists a missing file until it is there
again: if a run is broken off, the next one sees it. Each step can be repeated.
"""

from __future__ import annotations

import datetime as dt
import logging
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from pipeline.errors import StoreError
from pipeline.logs.ledger import forget_nights
from pipeline.messages import counted
from pipeline.run.verification import verify_tables
from pipeline.schema import DECISIONS, RUNS
from pipeline.store.atomic_files import move, remove
from pipeline.store.manifest import (
    WHOLE,
    manifest_file,
    manifest_key,
    manifest_keys,
    read_manifest,
    renew_manifest,
    update_manifest,
)
from pipeline.store.tables import (
    ENDING,
    PUT_ASIDE,
    days_of,
    files_of,
    name_of,
    read_table,
    whole_file,
)
from pipeline.store.verification import (
    OF_MOTORS,
    OF_TRENDS,
    TABLE_OF,
    Proof,
    TableFault,
    compare_published,
    fault_of,
    proofs_of,
    unlisted_files,
)
from pipeline.trends.nights.decisions import (
    Decision,
    journal_file,
    put_back,
    take_out_damaged_lines,
)
from pipeline.trends.nights.trend_record import note_touched

log = logging.getLogger(__name__)

# Restores a file of the output, by its path below it, from the object store.
Restore = Callable[[str], bool]
# Rows of these are made anew from the night's stored blocks if its log is gone.
FROM_BLOCKS = {"parameters"}
LOST = ("table_altered", "table_missing")
NEXT_RUN = "the next run makes it anew where the logs of that night are there"
NO_LOGS = "the logs of that night are gone, or were not asked for"
# Faults that are logged one by one.
FAULTS_TOLD = 20


def share_due(output: Path, days: int, now: dt.datetime) -> Callable[[str], bool]:
    """Choice of the files that a run proves, by name, so that all are proven within some days.

    Each day has its share, and a run takes those of all days since the run before. Of several runs
    on a day each takes the next share.
    """
    before = [day.toordinal() for day in _days_of_runs(output)]
    today = now.toordinal()
    last = max(before, default=today - days)
    if last < today:
        shares = {day % days for day in range(last + 1, today + 1)}
    else:
        shares = {(today + sum(day >= today for day in before)) % days}
    return lambda name: _turn(name) % days in shares


def _days_of_runs(output: Path) -> Iterator[dt.date]:
    """Days on which runs began, as far as the table tells."""
    for path in files_of(output, RUNS):
        with suppress(StoreError):  # which is told where it is mended
            yield from read_table(path, RUNS, columns=("started_at",))["started_at"].dt.date()


def _turn(name: str) -> int:
    """Number of a file, by its night if it has one: shares are taken modulo the days."""
    try:
        return dt.date.fromisoformat(PurePosixPath(name).stem).toordinal()
    except ValueError:
        return zlib.crc32(name.encode())


@dataclass(slots=True)
class Damage:
    """Damage to published files that a run finds, and mends as far as possible.

    Parameters
    ----------
    output
        Output folder, of which the caller holds the lock.
    restore
        Restores a file from the object store.

    Attributes
    ----------
    found
        Faults by path.
    """

    output: Path
    restore: Restore = lambda _: False
    found: dict[str, TableFault] = field(default_factory=dict)
    # By motor, the nights with a fit of which rows were lost; and faults found when the motors
    # had their turn.
    _fitted: defaultdict[str, set[dt.date]] = field(default_factory=lambda: defaultdict(set))
    _late: set[str] = field(default_factory=set)

    def look_around(self, due: Callable[[str], bool]) -> None:
        """Before the motors: check all published files, and prove those due.

        Raises StoreError if something cannot be read or written; what was done before then holds.
        """
        self.mend(self.named(rebuild_manifests(self.output, self.restore)))
        self._look(None, due)

    def look_into(self, months: Iterable[str] | None = None) -> None:
        """After the motors: prove the files of some months, or all; raises as `look_around`."""
        before = set(self.found)
        self._look(months, lambda _: True)
        self._late |= self.found.keys() - before

    def _look(self, months: Iterable[str] | None, due: Callable[[str], bool]) -> None:
        seen = compare_published(self.output, months, due)
        for key in seen.proven:
            renew_manifest(self.output, key)
        self.mend(self.named(seen.faults))

    def named(self, faults: Iterable[TableFault]) -> list[TableFault]:
        """Log faults that are new, and return them."""
        new = [one for one in faults if one.path not in self.found]
        for one in new[:FAULTS_TOLD]:
            log.warning("%s", one)
        if len(new) > FAULTS_TOLD:
            log.warning("and %d more; `check --tables` names all", len(new) - FAULTS_TOLD)
        self.found |= {one.path: one for one in new}
        return new

    def mend(self, faults: Sequence[TableFault]) -> None:
        """Let damaged and missing files be made anew.

        Raises StoreError if something cannot be written.
        """
        lost = [one for one in faults if one.code in LOST and manifest_key(one.path) != WHOLE]
        lost = [one for one in lost if not self.restore(f"tables/{one.path}")]
        self.forget([one.path for one in lost])
        for one in lost:
            path = self.output / "tables" / one.path
            if one.code == "table_altered":
                move(path, path.with_suffix(PUT_ASIDE))
            if one.path.split("/")[0] not in OF_MOTORS | OF_TRENDS:
                update_manifest(self.output, {one.path: None})  # nothing makes it anew

    def forget(self, names: Iterable[str]) -> None:
        """Let the nights of some files be made anew."""
        nights: defaultdict[dt.date, set[str]] = defaultdict(set)
        touched: list[dt.date] = []
        for name in names:
            table, label = name.split("/")[0], PurePosixPath(name).stem
            if table in OF_MOTORS:
                for night in days_of(label):
                    nights[night].add(table)
            if table in OF_MOTORS | OF_TRENDS:
                touched.append(days_of(label)[0])
        if nights:
            refit = {night for night, tables in nights.items() if tables <= FROM_BLOCKS}
            for motor_id, some in forget_nights(self.output, nights, refit=refit).items():
                self._fitted[motor_id] |= some
        if touched:
            for folder in sorted((self.output / "ledger").glob("*/")):
                note_touched(self.output, folder.name, min(touched))

    def left(self, made: Mapping[str, Collection[dt.date]]) -> Iterator[TableFault]:
        """Faults that were found and are not mended, given the nights made by motor."""
        mended: dict[dt.date, str] = {}
        for path, fault in self.found.items():
            table = path.split("/")[0]
            if table not in TABLE_OF or not (
                table in OF_MOTORS | OF_TRENDS or manifest_key(path) == WHOLE
            ):
                continue
            now = fault_of(self.output, path)
            if now is not None or not (self.output / "tables" / path).exists():
                yield self._not_made(now or fault)
            elif table in OF_MOTORS:
                for night in days_of(PurePosixPath(path).stem):
                    mended.setdefault(night, path)
        for night, path in mended.items():
            lost = [
                motor_id
                for motor_id, some in sorted(self._fitted.items())
                if night in some and night not in made.get(motor_id, ())
            ]
            if lost:
                why = NEXT_RUN if path in self._late else NO_LOGS
                message = f"rows of {', '.join(lost)} are not made anew: {why}"
                yield TableFault(path, "rows_lost", message)

    def _not_made(self, fault: TableFault) -> TableFault:
        if fault.code == "table_unreadable":
            return fault
        gives_up = f"not made anew: {NO_LOGS}; `check --tables --mend` gives it up"
        return replace(fault, message=NEXT_RUN if fault.path in self._late else gives_up)


def rebuild_manifests(output: Path, restore: Restore) -> Iterator[TableFault]:
    """Restore missing or damaged manifests, or make them anew from files that prove themselves.

    Raises StoreError if one cannot be written, or a file is of a newer version of the program.
    """
    unlisted = unlisted_files(output)
    for key in sorted(unlisted.keys() | set(manifest_keys(output))):
        if read_manifest(output, key) is not None:
            continue
        path = manifest_file(output, key)
        place, was_there = path.relative_to(output).as_posix(), path.exists()
        kind = "manifest_damaged" if was_there else "manifest_missing"
        if restore(place) and read_manifest(output, key) is not None:
            yield TableFault(place, kind, "brought back from the object store")
            continue
        names = [name for name in unlisted.get(key, ()) if _is_called_as_ours(name)]
        proofs = proofs_of(output, names)
        if was_there or proofs:
            remove(path)
            update_manifest(output, {name: digest for name, (digest, _) in proofs.items()})
            counts = Counter(proof for _, proof in proofs.values())
            yield TableFault(place, kind, _how_rebuilt(counts))
        for name in names:
            if name not in proofs:
                message = "it is in no manifest, and is damaged or not what a run publishes"
                yield TableFault(name, "table_altered", message)


def _is_called_as_ours(name: str) -> bool:
    """True if a run writes files of this name."""
    table, label = name.split("/")[0], PurePosixPath(name).stem
    if table not in TABLE_OF or not name.endswith(ENDING):
        return False
    try:
        return table not in OF_MOTORS | OF_TRENDS or bool(days_of(label))
    except ValueError:
        return False


def _how_rebuilt(counts: Mapping[Proof, int]) -> str:
    told = f"made anew: {counted(counts.get(Proof.WHOLE, 0), 'file')} proven to the last byte"
    if pages := counts.get(Proof.PAGES, 0):
        told += f", {pages} of other libraries by the checksums of their pages, which leave out "
        told += "their footers"
    return f"{told}; what may have been gone before is not known"


def restore_decisions(output: Path) -> None:
    """Put back lost lines of the journal, from the table `decisions` of the last run.

    Raises StoreError if the journal cannot be read or written.
    """
    path = whole_file(output, DECISIONS)
    if not path.exists() or fault_of(output, name_of(output, path)):
        return
    try:
        rows = read_table(path, DECISIONS).drop("run_id").to_dicts()
    except StoreError:
        return
    if count := put_back(output, [Decision(**row) for row in rows]):
        name = journal_file(output).name
        log.warning("%s is damaged or gone; put back from the table: %d lines", name, count)


def mend_output(
    output: Path, restore: Restore
) -> tuple[tuple[TableFault, ...], tuple[TableFault, ...]]:
    """Mend damage without a run; the caller holds the lock.

    Returns
    -------
    tuple of TableFault, tuple of TableFault
        Faults that were found, and those that are left.

    Raises
    ------
    StoreError
        If something cannot be read or written.
    """
    found = tuple(verify_tables(output))
    damage = Damage(output, restore)
    damage.mend([*rebuild_manifests(output, restore), *found])
    for one in found:
        if one.code in LOST and not (output / "tables" / one.path).exists():
            # It cannot be made anew, and is reported no more.
            update_manifest(output, {one.path: None})
        elif one.code in ("ledger_damaged", "history_damaged"):
            remove(output / one.path)
        elif one.path.endswith(PUT_ASIDE):
            remove(output / "tables" / one.path)
    if any(one.code == "journal_damaged" for one in found):
        restore_decisions(output)
        take_out_damaged_lines(output)
    return found, tuple(verify_tables(output))
