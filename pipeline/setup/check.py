"""`motor-leakage check`: the config, and a look at the logs, before a night depends on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from pipeline.config import Fleet, MotorSpec
from pipeline.errors import LogError
from pipeline.logs.database import DatabaseError
from pipeline.logs.files import (
    change_of,
    failed,
    growing,
    labels_of,
    look_at,
    spanned,
)
from pipeline.logs.finding import find_logs
from pipeline.logs.landing import land_newest
from pipeline.logs.ledger import FileRecord
from pipeline.logs.locations import FolderLogs, logs_of
from pipeline.messages import counted
from pipeline.setup.channel_check import ChannelCheck, check_channels
from pipeline.setup.check_units import columns_of
from pipeline.setup.propose import logs_below

# Objects of a motor that are opened: a check answers in seconds.
OPENED = 3
MOST_STRAYS = 8
# Columns that a fault names, and faults of columns that are told.
_SHOWN, _MOST = 5, 8
# A line end in UTF-16 or UTF-32 is up to four bytes long.
LINE_END_BYTES = 4
PACKED = (".gz", ".zst")


@dataclass(frozen=True, slots=True)
class MotorCheck:
    """A motor's logs from outside, and the channels of the newest."""

    motor_id: str
    motor_type: str
    log_format: str
    n_files: int
    n_nights: int  # that the files cover
    first: str | None  # label of the first night; None without a readable file
    last: str | None
    faults: tuple[str, ...]  # files that cannot be read, or are named but absent
    placeholders: tuple[str, ...]  # paths of the type, and oils, whose values are placeholders
    channels: tuple[ChannelCheck, ...]
    notes: tuple[str, ...]  # no faults, and yet worth a look


def check_motor(spec: MotorSpec) -> MotorCheck:
    """Look at the ends of each of a motor's logs, and into the newest; nothing is written.

    Of logs in an object store, which have to be copied for it, the first and the last few by name;
    of a database the newest nights that have rows.

    Raises StoreError if an object store cannot be read.
    """
    if spec.file.logs.database is None:
        return _checked(spec, logs_of(spec))
    with TemporaryDirectory(prefix="motor-leakage-nights-") as folder:
        here = replace(spec, log_root=Path(folder))
        faults, notes = list[str](), (f"the newest nights with rows were read, at most {OPENED}",)
        try:
            if not land_newest(here, OPENED):
                first = spec.file.logs.database.begin
                faults.append(f"database_empty: there are no rows from the night {first} on")
        except DatabaseError as error:
            faults.append(f"{error.code}: {error.message}")
        found = _checked(here, logs_of(here))
    return replace(
        found, faults=(*faults, *found.faults), notes=(*found.notes, *notes * bool(found.n_files))
    )


def _checked(spec: MotorSpec, logs: FolderLogs) -> MotorCheck:
    names = _some(logs.names) if spec.log_url else logs.names
    records = {name: _looked_at(name, logs, spec) for name in names}
    nights = {label for record in records.values() for label in labels_of(record)}
    channels, unfit, worth = check_channels(spec, records, logs.path)
    changes = column_changes(spec, records, logs.path)
    oils = [spec.file.oil, *(event.oil for event in spec.file.events if event.oil)]
    broken, written = (
        [f"{one.error_code}: {one.message}" for one in records.values() if one.status == status]
        for status in ("failed", "growing")
    )
    absent = [f"log_missing: {name}: named in the config and absent" for name in logs.absent]
    notes = [*worth, *written]
    if len(names) != len(logs.names):
        notes.append(
            f"{len(names)} of {len(logs.names)} objects were opened, the first and the last by "
            f"name below {spec.log_url}: nights and channels are theirs"
        )
    return MotorCheck(
        motor_id=spec.motor_id,
        motor_type=spec.file.motor_type,
        log_format=spec.file.logs.format,
        n_files=len(logs.names),
        n_nights=len(nights),
        first=min(nights).isoformat() if nights else None,
        last=max(nights).isoformat() if nights else None,
        faults=(*broken, *absent, *changes, *unfit),
        placeholders=(
            *(path.name for path in spec.motor_type.path if path.source == "placeholder"),
            *(
                spec.oils[name].name
                for name in dict.fromkeys(oils)
                if spec.oils[name].source == "placeholder"
            ),
        ),
        channels=channels,
        notes=(*notes, *_cut(spec, records, logs), *logs.unmatched()),
    )


def _some(names: Sequence[str]) -> Sequence[str]:
    """The first and the last by name; the last are the newest where names hold a date."""
    return names if len(names) <= OPENED else (names[0], *names[1 - OPENED :])


def _looked_at(name: str, logs: FolderLogs, spec: MotorSpec) -> FileRecord:
    try:
        path = logs.path(name)
    except LogError as error:  # replaced or removed since it was listed
        return failed(FileRecord(name, 0, 0, None), error)
    record = look_at(name, path)
    if record.status == "failed":
        return record
    found, why = spanned(record, path, spec), change_of(record, path)
    return found if why is None else growing(found, why)


def _cut(spec: MotorSpec, records: Mapping[str, FileRecord], logs: FolderLogs) -> Iterator[str]:
    """Text logs that end within a line."""
    if spec.file.logs.format != "csv":
        return
    for name, record in records.items():
        path = logs.path(name)
        if record.status != "ok" or path.suffix in PACKED:
            continue
        with path.open("rb") as stream:
            stream.seek(max(record.size - LINE_END_BYTES, 0))
            if not set(stream.read()) & set(b"\r\n"):
                yield f"{name}: the last line has no end: the log is cut, or being written"


def check_fleet(fleet: Fleet) -> tuple[MotorCheck, ...]:
    """Look at the logs of every motor."""
    return tuple(map(check_motor, fleet.motors))


def unclaimed(fleet: Fleet) -> tuple[str, ...]:
    """Logs in the folder of the logs that no motor claims, by their path in it."""
    if fleet.log_url or not fleet.has_log_folder:
        return ()
    there = {path: path.resolve() for path in logs_below(fleet.log_root)}
    claimed = {path.resolve() for spec in fleet.motors for path in find_logs(spec)[0].values()}
    own = fleet.output.resolve()
    return tuple(
        sorted(
            path.relative_to(fleet.log_root).as_posix()
            for path, real in there.items()
            if real not in claimed and not real.is_relative_to(own)
        )
    )


def strays_told(fleet: Fleet) -> str:
    """The logs that no motor claims, in words; empty for none."""
    strays = unclaimed(fleet)
    named = ", ".join(strays[:MOST_STRAYS]) + ", …" * (len(strays) > MOST_STRAYS)
    return f"no motor claims {counted(len(strays), 'log')}: {named}" if strays else ""


def column_changes(
    spec: MotorSpec, records: Mapping[str, FileRecord], path_of: Callable[[str], Path]
) -> tuple[str, ...]:
    """Faults of channels whose column is not in all logs, or changes its unit, with the date.

    The first and the last log are compared; where they differ, each change between them is looked
    for by halves, so that a few of many headers are read.
    """
    dated = sorted((min(labels_of(one)), name) for name, one in records.items() if one.nights)
    if len(dated) < 2:
        return ()
    sources = [one.source for one in spec.file.channels.values() if one.constant is None]

    def columns(at: int) -> dict[str, str]:
        try:
            return columns_of(path_of(dated[at][1]), spec.file.logs) or {}
        except LogError:  # which is a fault of that log already
            return {}

    def wanted(at: int) -> dict[str, str]:
        return {name: unit for name, unit in columns(at).items() if name in sources}

    last = len(dated) - 1
    if not columns(0) or not columns(last):
        return ()
    found: list[str] = []
    begin = 0
    while wanted(begin) != wanted(last) and len(found) < _MOST:
        low, high = begin, last
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if wanted(middle) == wanted(begin) else (low, middle)
        label, name = dated[high]
        log = f"the log of {label.day} {label:%B %Y} ({name})"
        found += _differences(columns(low), columns(high), sources, log)
        begin = high
    return tuple(found[:_MOST])


def _differences(
    before: Mapping[str, str], now: Mapping[str, str], sources: list[str], log: str
) -> Iterator[str]:
    new, old = (
        ", ".join([repr(one) for one in these if one not in others][:_SHOWN])
        for these, others in ((now, before), (before, now))
    )
    for source in dict.fromkeys(sources):
        if source in before and source not in now:
            also = f", but {new}, new since then" if new else ""
            yield f"column_gone: {log} has no column {source!r}{also}"
        elif source in now and source not in before:
            also = f", without {old} of the logs before" if old else ""
            yield f"column_gone: {log} is the first with column {source!r}{also}"
        elif before.get(source) != now.get(source):
            units = f"{now[source] or 'no unit'!r}; the log before has {before[source]!r}"
            yield f"unit_changed: {log} gives {source!r} in {units}"
