"""A fleet proposed from a plant's logs: its motors, their channels, and what has to be asked.

Nothing ambiguous is decided: it is a `Question`, whose answer is taken as it stands.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from pathlib import Path
from statistics import median
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pipeline.config.channels import GOOD_QUALITY
from pipeline.errors import LogError, UsageError
from pipeline.setup.cells import Marks, as_number, is_missing, marks_of
from pipeline.setup.names import (
    FEWEST_CHANNELS,
    PORT_PRESSURES,
    QUANTITY_OF,
    Group,
    groups_of,
    is_in,
    likely_units,
    meaning_of,
    missing_channels,
    unit_in,
    words_of,
)
from pipeline.setup.sniff import sniff
from pipeline.setup.tables import SAMPLES, Cells, Column, Table
from pipeline.units import CHANNELS, QUANTITIES, UNITS, to_canonical

SUFFIXES = (".csv", ".txt", ".tsv", ".parquet", ".mcap")
# A date, with a time or without, or a long number: what differs from file to file of one kind.
VARYING = re.compile(
    r"(?<!\d)(?:20\d\d[-_.]?\d\d[-_.]?\d\d(?:[-_T. ]?\d\d[-_.]?\d\d(?:[-_.]?\d\d)?)?|\d{6,})(?!\d)"
)
NONE = "none"
_SHOWN = 12
_SHARED_BY_CHANCE = 0.5  # stamps of a second in which a state changes


@dataclass(frozen=True, slots=True)
class Question:
    """What a log does not say; `key` names it in an answer."""

    key: str
    text: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Place:
    """Where a channel is in a log; the unit is None where it has to be asked."""

    column: Column
    unit: str | None
    quality: str = ""

    def keys(self) -> dict[str, str]:
        """Keys of ``[channels.…]``."""
        return {
            **self.column.keys,
            **({"unit": self.unit} if self.unit else {}),
            **({"quality_source": self.quality} if self.quality else {}),
        }


@dataclass(frozen=True, slots=True)
class ProposedMotor:
    """A motor as its logs tell it."""

    name: str  # in the log; empty where nothing there names it
    motor_id: str
    logs: Mapping[str, Any]  # keys of ``[logs]``; what is asked is there as assumed
    channels: Mapping[str, Place]
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class Proposal:
    """A fleet to look at, with the questions that are open."""

    log_root: Path
    motors: tuple[ProposedMotor, ...]
    questions: tuple[Question, ...]
    unused: tuple[str, ...]  # names of columns and tags that are no channel's
    faults: tuple[str, ...]  # logs that cannot be read


@dataclass(frozen=True, slots=True)
class _Kind:
    """Files that differ by date alone."""

    pattern: str
    files: tuple[Path, ...]
    name: str  # what names them
    stem: str


def propose(source: Path, answers: Mapping[str, str], root: Path | None = None) -> Proposal:
    """Propose a fleet from a log, or a folder of logs; patterns of files are below `root`.

    Raises LogError if there is no log, or none can be read, and UsageError (``answer``) for an
    answer that cannot be.
    """
    if not source.exists():
        raise LogError("log_missing", source, "there is no such file or folder")
    files = sorted(logs_below(source)) if source.is_dir() else [source.resolve()]
    if not files:
        raise LogError("log_empty", source, f"there is no log ({', '.join(SUFFIXES)}) in it")
    root = root or (source.resolve() if source.is_dir() else source.resolve().parent)
    motors, faults = list[ProposedMotor](), list[str]()
    loose: dict[Path, list[tuple[_Kind, Table]]] = {}
    asked, unread, unused = _Asked(answers), 0, dict[str, None]()
    for kind in _kinds(files, root):
        try:
            table = sniff(kind.files[-1])
        except LogError as error:
            faults.append(f"{error.code}: {error.message}")
            unread += 1
            continue
        asked.log = kind.name
        found = list(_motors(table, kind, asked, unused))
        motors += found
        if not found:
            loose.setdefault(kind.files[0].parent, []).append((kind, table))
    for folder, kinds in loose.items():
        asked.log = folder.name
        found = list(_split_motors(kinds, asked, unused))
        motors += found
        for kind, table in kinds if not found else ():
            columns = ", ".join(one.name for one in table.columns[:_SHOWN])
            faults.append(f"no_motor: {kind.pattern}: its columns are no motor's: {columns}")
    if unread == len(faults) > 0 and not motors:
        raise LogError("log_not_readable", source, f"no log of it can be read: {faults[0]}")
    asked.require_known(one.motor_id for one in motors)
    return Proposal(root, _apart(motors), tuple(asked.open.values()), tuple(unused), tuple(faults))


def suffix_of(path: Path) -> str:
    """Ending of a log's name, that of a packed one with what it packs.

    Examples
    --------
    >>> suffix_of(Path("a.2025.csv.gz")), suffix_of(Path("a.1.csv"))
    ('.csv.gz', '.csv')
    """
    packed = path.suffix.lower() in (".gz", ".zst")
    return "".join(path.suffixes[-2:]) if packed else path.suffix


def logs_below(folder: Path) -> Iterator[Path]:
    """Files of a folder that are logs by their names."""
    for path in folder.resolve().rglob("*"):
        if path.is_file() and suffix_of(path).lower().startswith(SUFFIXES):
            yield path


def _kinds(files: Sequence[Path], root: Path) -> Iterator[_Kind]:
    alike: dict[tuple[Path, str], list[Path]] = {}
    for path in files:
        alike.setdefault((path.parent, VARYING.sub("\0", path.name)), []).append(path)
    for (folder, template), own in alike.items():
        below = folder.relative_to(root).as_posix()
        begin = "" if below == "." else f"{escape(below)}/"
        parts = [escape(part) for part in re.split("\0+", template)]
        others = [path.name for path in files if path.parent == folder and path not in own]
        # A pattern fits no file of another kind.
        name = "*".join(parts)
        if any(fnmatchcase(other, name) for other in others):
            name = "[0-9]*".join(parts)
        stem = re.sub(r"^[\0_. -]+|[\0_. -]+$", "", template.removesuffix(suffix_of(own[-1])))
        several = sum(one[0] == folder for one in alike) > 1
        label = stem if several or below == "." else folder.name
        yield _Kind(begin + name, tuple(own), label or folder.name, stem.replace("\0", " "))


class _Asked:
    """Questions that have no answer yet."""

    def __init__(self, answers: Mapping[str, str]) -> None:
        self.answers = answers
        self.log = ""  # in which it is asked
        self.open: dict[str, Question] = {}
        self._asked: dict[str, tuple[str, ...]] = {}
        self._alike: dict[tuple[str, ...], tuple[str, Sequence[str]]] = {}

    def ask(
        self, key: str, text: str, choices: Iterable[str] = (), known: Iterable[str] = ()
    ) -> str | None:
        """The answer to a question; None, and the question is open, without one.

        The answer has to be `known`, by default one of the choices, where there are any.
        """
        likely = tuple(choices)
        allowed = tuple(known) or likely
        self._asked[key] = likely
        if key not in self.answers:
            self.open.setdefault(key, Question(key, text, likely))
            return None
        answer = self.answers[key]
        if allowed and answer not in allowed:
            raise UsageError(
                "answer", f"{key}: got {answer!r}; expected one of {', '.join(allowed)}"
            )
        if key == "time_zone":
            _require_zone(answer)
        return answer

    def of_log(self, key: str, text: str, choices: Iterable[str]) -> str | None:
        """As `ask`; logs that read alike have one answer."""
        own = tuple(choices)
        if self._asked.get(key, own) != own:
            key = f"{key} of {self.log}"
        return self.ask(key, f"{self.log}: {text}", own)

    def which(
        self, own: str, motor: str, text: str, places: Sequence[str], known: Iterable[str]
    ) -> str | None:
        """The place of a motor's channel, ``motor_id.channel``, by its name.

        Motors whose places are called alike but for the motor take the answer of the first.
        """
        rests = (re.sub(r"[\[(].*?[\])]", "", _rest(place, motor)) for place in places)
        kind = (own.rpartition(".")[2], *rests)
        first, alike = self._alike.setdefault(kind, (own, places))
        if own in self.answers or first == own:
            return self.ask(own, text, places, (*places, *known))
        answer = self.answers.get(first)
        return places[alike.index(answer)] if answer in alike else None

    def require_known(self, motor_ids: Iterable[str]) -> None:
        """Refuse answers to what nobody asked; a motor's channel may always be named."""
        named = {f"{motor}.{channel}" for motor in motor_ids for channel in CHANNELS}
        always = {"time_zone", "time_format", "decimal", "time", "table", "motor_type", "oil"}
        strange = sorted(self.answers.keys() - self._asked.keys() - named - always)
        if strange:
            there = ", ".join(self.open) or "none is open"
            raise UsageError("answer", f"{strange[0]}: there is no such question; open: {there}")


def _require_zone(name: str) -> None:
    try:
        ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        message = f"time_zone: got {name!r}; expected a zone such as UTC or Europe/Oslo"
        raise UsageError("answer", message) from None


# The motors of a table


def _motors(
    table: Table, kind: _Kind, asked: _Asked, unused: dict[str, None]
) -> Iterator[ProposedMotor]:
    """The motors of logs that are alike; none where their columns are not enough for one."""
    layout, columns, quality, several = _layout(table)
    names, units = [one.name for one in columns], {one.name: one.unit for one in columns}
    if not several and not groups_of(list(_without_labels(names).values()), units)[0]:
        return
    logs = {**_answered(table, asked), **layout, "files": [kind.pattern]}
    if not several:
        yield from _grouped(columns, table.marks, logs, quality, kind, asked, unused)
        return
    text = f"{kind.name}: rows of several motors: which column has the motor's name?"
    choices = tuple(several)
    column = (
        choices[0] if len(choices) == 1 else asked.ask(f"{kind.name}.motor_column", text, choices)
    )
    for name in several.get(column or "", ()):
        own = logs | {"motor_column": column, "motor_name": name}
        named = replace(kind, name=name)
        yield from _grouped(columns, table.marks, own, quality, named, asked, unused)


def _answered(table: Table, asked: _Asked) -> dict[str, Any]:
    """Keys of ``[logs]`` with the answers to what the log does not tell."""
    logs = dict(table.logs)
    for one in table.open:
        answer = asked.of_log(one.key, one.text, one.answers)
        if answer is not None:
            logs |= one.answers.get(answer, {one.key: answer})
    return logs


def _layout(table: Table) -> tuple[dict[str, str], list[Column], str, dict[str, Cells]]:
    """Keys of the layout, candidates for channels, the rows' quality, and motors by column."""
    numbers = [one for one in table.columns if one.kind == "number"]
    texts = [one for one in table.columns if one.kind == "text"]
    named = [one for one in numbers if is_in(words_of(one.name), "column", "value")]
    value = numbers[0] if len(numbers) == 1 else named[0] if len(named) == 1 else None
    if value is not None and texts and (found := _long(table, value, texts)):
        return found
    readable = [one for one in table.columns if one.kind in ("number", "nothing")]
    several = {one.name: own for one in (*texts, *numbers) if (own := _motors_beside(one, table))}
    return {}, readable, "", several


def _long(
    table: Table, value: Column, texts: Sequence[Column]
) -> tuple[dict[str, str], list[Column], str, dict[str, Cells]] | None:
    """A row a sample, with the channel's name in a column."""
    units = [one.name for one in texts if is_in(words_of(one.name), "column", "unit")][:1]
    names = [one for one in texts if one.name not in units]
    if not names:
        return None
    column = max(names, key=lambda one: len({meaning_of(cell).channel for cell in one.filled}))
    seen: dict[str, tuple[list[str], str]] = {}
    for name, cell, *unit in table.rows([column.name, value.name, *units]):
        cells, _ = seen.setdefault(name.strip(), ([], next(iter(unit), "")))
        if len(cells) < SAMPLES and not is_missing(cell):
            cells.append(cell)
    found = [
        Column(name, tuple(cells), "number", unit, {"source": name})
        for name, (cells, unit) in seen.items()
        if not is_missing(name)
    ]
    told = {meaning_of(one.name, one.unit).channel for one in found} - {None}
    if len(told) < 2 - is_in(words_of(column.name)[-1:], "column", "channel"):
        return None
    good = {str(one).lower() for one in GOOD_QUALITY}
    quality = [
        one.name
        for one in texts
        if is_quality_name(one.name) and good & {cell.lower() for cell in one.filled}
    ]
    several = {}
    for part in (one for one in names if one is not column and one.name not in quality):
        # Each of another column's words comes with a motor's channels: it is the motor's.
        channels: dict[str, set[str | None]] = {}
        for cell, name in table.rows([part.name, column.name]):
            channels.setdefault(cell.strip(), set()).add(meaning_of(name).channel)
        if len(channels) > 1 and all(
            len(own - {None}) >= FEWEST_CHANNELS for own in channels.values()
        ):
            several[part.name] = tuple(sorted(channels))
    keys = {"layout": "long", "channel_column": column.name, "value_column": value.name}
    return keys, found, next(iter(quality), ""), several


def _motors_beside(column: Column, table: Table) -> Cells:
    """Cells of a column that names the motor of each row; none where it does not.

    Its name says so, or rows of other cells repeat most of a cell's time stamps.
    """
    words = [word for word in words_of(column.name) if not is_in([word], "column", "number")]
    is_named = is_in(words[-1:], "column", "motor")
    if meaning_of(column.name, column.unit).channel or not (is_named or column.kind == "text"):
        return ()
    stamps: dict[str, set[Cells]] = {}
    for cell, *stamp in table.rows([column.name, *table.times]):
        if not is_missing(cell):
            stamps.setdefault(cell.strip(), set()).add(tuple(stamp))
    if not (is_named and column.kind == "text"):
        seen = Counter(stamp for own in stamps.values() for stamp in own)
        shared = (sum(seen[stamp] > 1 for stamp in own) / len(own) for own in stamps.values())
        if min(shared, default=0.0) <= _SHARED_BY_CHANCE:
            return ()
    return tuple(sorted(stamps)) if len(stamps) > 1 else ()


def is_quality_name(name: str) -> bool:
    """True if the last word of a name is that of a quality.

    Examples
    --------
    >>> is_quality_name("PT101.Q"), is_quality_name("status"), is_quality_name("Q")
    (True, True, False)
    """
    words = words_of(name)
    return is_in(words[-1:], "column", "quality") or (words[-1:] == ("q",) and len(words) > 1)


_LABEL = re.compile(r'([A-Za-z_]\w*)="([^"]*)"')
_SERIES = re.compile(r'[\w:]*\{[A-Za-z_]\w*="[^"]*"(?:, ?[A-Za-z_]\w*="[^"]*")*\}')


def _without_labels(names: Sequence[str]) -> dict[str, str]:
    """Names of series, ``metric{label="value"}``, as paths of the labels that differ.

    Examples
    --------
    >>> list(_without_labels(['{__name__="p", at="x", m="1"}', '{__name__="p", at="x", m="2"}'])
    ...     .values())
    ['1/p', '2/p']
    """
    labels = {name: dict(_LABEL.findall(name)) for name in names if _SERIES.fullmatch(name)}
    differing = {
        key
        for own in labels.values()
        for key, value in own.items()
        if any(one.get(key) != value for one in labels.values())
    }
    plain = {}
    for name in names:
        own = labels.get(name, {})
        metric = own.pop("__name__", "") or name.partition("{")[0]
        apart = [value for key, value in own.items() if key in differing]
        plain[name] = "/".join((*apart, metric)) if name in labels else name
    return plain


def _split_motors(
    kinds: Sequence[tuple[_Kind, Table]], asked: _Asked, unused: dict[str, None]
) -> Iterator[ProposedMotor]:
    """Motors whose channels lie in several files of a folder."""
    tables = [(k, t) for k, t in kinds if t.times and t.logs.get("format") != "mcap"]
    places = [
        (kind, one) for kind, table in tables for one in table.columns if one.kind == "number"
    ]
    if not places:
        return
    common = Counter(one.name for _, one in places).most_common(1)[0][0]
    columns, files = [], dict[str, tuple[Path, ...]]()
    for kind, one in places:
        meant = meaning_of(one.name, one.unit).channel
        keys = {"source": kind.pattern} | ({"value_column": one.name} if one.name != common else {})
        name = f"{kind.stem} {one.name}" if meant else kind.stem
        unit = one.unit or unit_in(one.name) or ""
        columns.append(replace(one, name=name, unit=unit, keys=keys))
        files[kind.pattern] = kind.files
    if not groups_of([one.name for one in columns], {one.name: one.unit for one in columns})[0]:
        return
    # The dialect is that of all files together: one may hold no letter or mark that tells it.
    marks = marks_of(cell for one in columns for cell in one.cells)
    told: dict[str, Any] = {"decimal": marks.decimal, "thousands": marks.thousands}
    encodings = {table.logs["encoding"] for _, table in tables if "encoding" in table.logs}
    told["encoding"] = next(iter(encodings), "")
    logs = _answered(tables[0][1], asked) | {key: one for key, one in told.items() if one}
    logs |= {"layout": "file_per_channel", "value_column": common}
    folder = kinds[0][0].files[0].parent
    whole = _Kind("", (), folder.name, "")
    for motor in _grouped(columns, marks, logs, "", whole, asked, unused):
        own = list(dict.fromkeys(one.column.keys["source"] for one in motor.channels.values()))
        found = tuple(path for pattern in own for path in files[pattern])
        yield replace(motor, logs={**motor.logs, "files": own}, files=found)


# The channels of a motor


def _grouped(
    columns: Sequence[Column],
    marks: Marks,
    logs: Mapping[str, Any],
    quality: str,
    kind: _Kind,
    asked: _Asked,
    unused: dict[str, None],
) -> Iterator[ProposedMotor]:
    """The motors whose columns, tags or fields there are."""
    plain = _without_labels([one.name for one in columns])
    by_name = {plain[one.name]: replace(one, name=plain[one.name]) for one in columns}
    qualities = {
        base: by_name[name].keys["source"]
        for name in filter(is_quality_name, by_name)
        if (base := re.sub(r"[\W_]+[^\W_]+$", "", name)) in by_name and base != name
    }
    names = [name for name in by_name if by_name[name].keys["source"] not in qualities.values()]
    groups, left = groups_of(names, {name: by_name[name].unit for name in names})
    unused |= dict.fromkeys(left)
    for group in groups:
        chooser = _Chooser(group, by_name, marks, kind.name, asked)
        found = chooser.channels()
        used = {one.name for one in found.values()}
        unused |= dict.fromkeys(name for name in group.signals if name not in used)
        channels = {
            channel: Place(
                found[channel],
                chooser.unit(channel, found[channel]),
                qualities.get(found[channel].name, quality),
            )
            for channel in CHANNELS
            if channel in found
        }
        yield ProposedMotor(group.name, chooser.motor_id, logs, channels, kind.files)


class _Chooser:
    """The columns of one motor's channels; asks where several fit, or none."""

    def __init__(
        self, group: Group, columns: Mapping[str, Column], marks: Marks, log: str, asked: _Asked
    ) -> None:
        self.group, self.columns, self.marks, self.asked = group, columns, marks, asked
        self.name = group.name or log
        self.motor_id = _plain(self.name)

    def channels(self) -> dict[str, Column]:
        """Column by channel; without those that are asked for."""
        rivals, bare = self._rivals()
        found = {channel: self._one(channel, own) for channel, own in rivals.items()}
        if bare:
            found |= self._ports(sorted(bare, key=self.size, reverse=True), found)
        for channel in missing_channels(found):
            text = (
                f"{self.motor_id}, and motors alike: no {_words(channel)} was found: which is it?"
            )
            found[channel] = self._which(channel, text, list(self.columns))
        return {channel: self.columns[name] for channel, name in found.items() if name}

    def _rivals(self) -> tuple[dict[str, list[str]], list[str]]:
        """The columns that fit each channel best, and pressures of nobody in particular."""
        fitting: dict[str, list[tuple[int, str]]] = {}
        for name, signal in self.group.signals.items():
            meaning = meaning_of(signal, self.columns[name].unit)
            if meaning.channel is not None:
                fitting.setdefault(meaning.channel, []).append((meaning.merit, name))
        rivals = {
            channel: [name for merit, name in own if merit == max(own)[0]]
            for channel, own in fitting.items()
        }
        is_bare = max(fitting.get("pressure_difference", [(0, "")]))[0] < 0
        bare = rivals.pop("pressure_difference") if is_bare else []
        ports = [rivals.get(port, []) for port in PORT_PRESSURES]
        if all(ports):
            rivals.pop("pressure_difference", None)  # it is theirs
            bare = []
            if [len(own) for own in ports] == [1, 1] and self.size(*ports[0]) < self.size(
                *ports[1]
            ):
                bare = [*ports[0], *ports[1]]  # the low port's is the higher one
        if (bare and all(ports)) or "pressure_difference" in rivals:
            for port in PORT_PRESSURES:
                rivals.pop(port, None)
        return rivals, bare

    def _one(self, channel: str, names: Sequence[str]) -> str | None:
        """The one column that fits a channel, or that is answered; None: it is asked."""
        if len(names) == 1:
            # An answer has the last word, asked for or not.
            key = f"{self.motor_id}.{channel}"
            is_told = key in self.asked.answers
            return self.asked.ask(key, "", self.columns) if is_told else names[0]
        told = ", ".join(names)
        text = (
            f"{self.motor_id}, and motors alike: {told} may be the {_words(channel)}: which is it?"
        )
        return self._which(channel, text, names)

    def _ports(
        self, names: Sequence[str], found: Mapping[str, str | None]
    ) -> dict[str, str | None]:
        """Channels of pressures of which the names do not say whose they are, the highest first."""
        high, low = PORT_PRESSURES
        told = " and ".join(f"{name} (typically {self.size(name):.4g})" for name in names)
        if low in found or high in found:
            other = low if high in found else high
            return {other: self._which(other, self._text(told, other), names)}
        if len(names) > 1:
            text = (
                f"{self._text(told, high)} The other is the low port's; {NONE}: they are no ports'"
            )
            chosen = self._which(high, text, [*names, NONE])
            if chosen != NONE:
                others = [name for name in names if name != chosen]
                lower = others[0] if chosen and len(others) == 1 else None
                if chosen and len(others) > 1:
                    lower = self._which(low, self._text(told, low), others)
                return {high: chosen, low: lower}
        channel = "pressure_difference"
        return {channel: self._which(channel, self._text(told, channel), names)}

    def _text(self, told: str, channel: str) -> str:
        return (
            f"{self.motor_id}, and motors alike: the log does not say whose pressure {told} is: "
            f"which is the {_words(channel)}?"
        )

    def _which(self, channel: str, text: str, names: Sequence[str]) -> str | None:
        own = f"{self.motor_id}.{channel}"
        return self.asked.which(own, self.name, text, names, self.columns)

    def size(self, name: str) -> float:
        """Typical magnitude of a pressure, in bar where its unit is said."""
        own = self.columns[name]
        numbers = (as_number(cell, self.marks) for cell in own.filled)
        sizes = [abs(number) for number in numbers if number is not None]
        unit = meaning_of(name, own.unit).unit
        known = unit if QUANTITY_OF.get(unit or "") == "pressure" else None
        return float(to_canonical("pressure_difference", median(sizes or [0.0]), known or "bar"))

    def unit(self, channel: str, column: Column) -> str | None:
        """The unit of a column; one answer is for columns called alike, where it is plausible."""
        said = meaning_of(column.name, column.unit).unit
        if said is not None and QUANTITY_OF.get(said) == QUANTITIES[channel]:
            return said
        numbers = [as_number(cell, self.marks) for cell in column.filled]
        shown = "; ".join(column.filled[:3])
        text = f"unit of {_words(channel)} ({column.name}: {shown}): which is it?"
        units = tuple(UNITS[QUANTITIES[channel]])
        likely = likely_units(channel, [one for one in numbers if one is not None]) or units
        key = f"unit of {_rest(column.name, self.name) or channel}"
        if key in self.asked.answers and self.asked.answers[key] not in likely:
            key = f"{key} in {self.asked.log}"
        return self.asked.ask(key, text, likely, units)


def _words(channel: str) -> str:
    return channel.replace("_", " ")


def _rest(place: str, motor: str) -> str:
    """The name of a column or tag without the motor's."""
    whole = rf"(?<![^\W_]){re.escape(motor)}(?![^\W_])"
    return re.sub(r"([._/: -])[._/: -]+", r"\1", re.sub(whole, "", place)).strip("._/: -")


def _plain(name: str) -> str:
    """A name as an id may be."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-._")[:64] or "motor"


def _apart(motors: Sequence[ProposedMotor]) -> tuple[ProposedMotor, ...]:
    """The motors, each with an id of its own."""
    taken: set[str] = set()
    found = []
    for motor in motors:
        own, number = motor.motor_id, 2
        while own in taken:
            own, number = f"{motor.motor_id}-{number}", number + 1
        taken.add(own)
        found.append(replace(motor, motor_id=own))
    return tuple(found)
