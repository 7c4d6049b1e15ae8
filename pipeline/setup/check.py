"""`motor-leakage check`: the config, and a look at the logs, before a night depends on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from pipeline.config import Fleet, MotorSpec
from pipeline.config.motor_types import OilFile
from pipeline.errors import LogError
from pipeline.logs.database import DatabaseError
from pipeline.logs.files import (
    change_of,
    failed,
    find_logs,
    growing,
    labels_of,
    look_at,
    spanned,
)
from pipeline.logs.landing import land_newest
from pipeline.logs.ledger import FileRecord
from pipeline.logs.locations import LogSource, logs_of
from pipeline.messages import counted
from pipeline.setup.channel_check import ChannelCheck, check_channels
from pipeline.setup.column_changes import column_changes
from pipeline.setup.propose import logs_below

# Objects of a motor that are opened: a check answers in seconds.
OPENED = 3
MOST_STRAYS = 8


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
        found = _checked(here, logs_of(here, ask=False))
    return replace(
        found, faults=(*faults, *found.faults), notes=(*found.notes, *notes * bool(found.n_files))
    )


def _checked(spec: MotorSpec, logs: LogSource) -> MotorCheck:
    names = _some(logs.names) if spec.log_url else logs.names
    records = {name: _looked_at(name, logs, spec) for name in names}
    nights = {label for record in records.values() for label in labels_of(record)}
    channels, unfit, worth = check_channels(spec, records, logs.path)
    changes = column_changes(spec, records, logs.path)
    broken = [record for record in records.values() if record.status == "failed"]
    written = [record for record in records.values() if record.status == "growing"]
    return MotorCheck(
        motor_id=spec.motor_id,
        motor_type=spec.file.motor_type,
        log_format=spec.file.logs.format,
        n_files=len(logs.names),
        n_nights=len(nights),
        first=min(nights).isoformat() if nights else None,
        last=max(nights).isoformat() if nights else None,
        faults=(*map(_fault, broken), *map(_absent, logs.absent), *changes, *unfit),
        placeholders=(
            *(path.name for path in spec.motor_type.path if path.source == "placeholder"),
            *(oil.name for oil in _oils(spec) if oil.source == "placeholder"),
        ),
        channels=channels,
        notes=(
            *worth,
            *map(_fault, written),
            *_left_out(spec, len(names), len(logs.names)),
            *logs.unmatched(),
        ),
    )


def _oils(spec: MotorSpec) -> list[OilFile]:
    """The oils that the motor runs or ran on."""
    names = [spec.file.oil, *(event.oil for event in spec.file.events if event.oil)]
    return [spec.oils[name] for name in dict.fromkeys(names)]


def _some(names: Sequence[str]) -> Sequence[str]:
    """The first and the last by name; the last are the newest where names hold a date."""
    return names if len(names) <= OPENED else (names[0], *names[1 - OPENED :])


def _left_out(spec: MotorSpec, n_opened: int, n_files: int) -> tuple[str, ...]:
    if n_opened == n_files:
        return ()
    return (
        f"{n_opened} of {n_files} objects were opened, the first and the last by name below "
        f"{spec.log_url}: nights and channels are theirs",
    )


def _looked_at(name: str, logs: LogSource, spec: MotorSpec) -> FileRecord:
    try:
        path = logs.path(name)
    except LogError as error:  # replaced or removed since it was listed
        return failed(FileRecord(name, 0, 0, None), error)
    record = look_at(name, path)
    if record.status == "failed":
        return record
    found, why = spanned(record, path, spec), change_of(record, path)
    return found if why is None else growing(found, why)


def _fault(record: FileRecord) -> str:
    return f"{record.error_code}: {record.message}"


def _absent(name: str) -> str:
    return f"log_missing: {name}: named in the config and absent"


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
