"""`motor-leakage check`: the config, and a look at the logs, before a night depends on them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
from pipeline.logs.locations import FolderLogs, logs_of
from pipeline.logs.processed import FileRecord
from pipeline.messages import counted
from pipeline.setup.channel_check import ChannelCheck, check_channels
from pipeline.setup.column_changes import column_changes
from pipeline.setup.propose import logs_below

# Objects of a motor that are opened: a check answers in seconds.
OPENED = 3
MOST_STRAYS = 8
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
    oils = dict.fromkeys([spec.file.oil, *(one.oil for one in spec.file.events if one.oil)])
    stated = (*spec.motor_type.path, *(spec.oils[name] for name in oils))
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
        placeholders=tuple(one.name for one in stated if one.source == "placeholder"),
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
