"""A whole fleet proposed from a plant's logs: its motors, their channels, and what has to be asked.

Nothing ambiguous is decided: it is a `Question`, whose answer is taken as it stands.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path
from typing import Any

from pipeline.errors import LogError, UsageError
from pipeline.setup.guess_cells import as_number
from pipeline.setup.guess_channels import (
    channel_of,
    is_bare_pressure,
    likely_units,
    missing_channels,
    preference,
)
from pipeline.setup.guess_files import VARYING, suffix_of
from pipeline.setup.guess_layout import Candidate, GuessedSource, is_quality_name, unit_said
from pipeline.setup.motor_groups import Group, groups_of
from pipeline.setup.suggest import LogGuess, look
from pipeline.setup.vocabulary import PORT_PRESSURES
from pipeline.units import CHANNELS, QUANTITIES, UNITS

_SUFFIXES = (".csv", ".txt", ".tsv", ".parquet", ".mcap")
_SHOWN = 12


@dataclass(frozen=True, slots=True)
class Question:
    """What a log does not say; `key` names it in an answer."""

    key: str
    text: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ProposedMotor:
    """A motor as its logs tell it; the unit of a channel is None where it has to be asked."""

    name: str  # in the log; empty where nothing there names it
    motor_id: str
    logs: Mapping[str, Any]
    sources: Mapping[str, GuessedSource]
    quality: Mapping[str, str]  # columns of qualities by channel


@dataclass(frozen=True, slots=True)
class Proposal:
    """A fleet to look at, with the questions that are open."""

    log_root: Path
    motors: tuple[ProposedMotor, ...]
    questions: tuple[Question, ...]
    unused: tuple[str, ...]  # names of columns and tags that are no channel's
    faults: tuple[str, ...]  # logs that cannot be read


def propose(source: Path, answers: Mapping[str, str]) -> Proposal:
    """Propose a fleet from a log, or a folder of logs.

    Raises LogError if there is no log, or none can be read.
    """
    if not source.exists():
        raise LogError("log_missing", source, "there is no such file or folder")
    files = sorted(_logs_below(source)) if source.is_dir() else [source]
    if not files:
        raise LogError("log_empty", source, f"there is no log ({', '.join(_SUFFIXES)}) in it")
    root = source.resolve() if source.is_dir() else source.resolve().parent
    motors: list[ProposedMotor] = []
    asked = _Asked(answers)
    unused: dict[str, None] = {}
    faults: list[str] = []
    split: set[str] = set()
    unread = 0
    for pattern, example, name in _kinds(files, root):
        try:
            guess = look(example)
        except LogError as error:
            faults.append(f"{error.code}: {error.message}")
            unread += 1
            continue
        folder = pattern.rpartition("/")[0]
        if guess.layout.kind == "file_per_channel":
            if folder in split:
                continue  # of a motor that is there already
            split.add(folder)
            name = folder.rpartition("/")[2] or root.name
        asked.log, before = name, len(asked.open)
        found = list(_motors(guess, pattern, name, asked, unused))
        if not found and len(asked.open) == before:
            columns = ", ".join(one[0] for one in guess.layout.candidates[:_SHOWN])
            faults.append(f"no_motor: {pattern}: its columns are no motor's: {columns}")
        motors += found
    if unread and unread == len(faults) and not motors and not asked.open:
        raise LogError("log_not_readable", source, f"no log of it can be read: {faults[0]}")
    return Proposal(root, _apart(motors), tuple(asked.open.values()), tuple(unused), tuple(faults))


def _logs_below(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*"):
        if path.is_file() and suffix_of(path).lower().startswith(_SUFFIXES):
            yield path


def _kinds(files: Sequence[Path], root: Path) -> Iterator[tuple[str, Path, str]]:
    """Files that differ by date alone: their pattern, the newest of them, and what names them."""
    alike: dict[tuple[Path, str], list[Path]] = {}
    for path in files:
        alike.setdefault((path.resolve().parent, VARYING.sub("\0", path.name)), []).append(path)
    for (folder, template), own in alike.items():
        below = folder.relative_to(root).as_posix()
        begin = "" if below == "." else f"{escape(below)}/"
        pattern = begin + "*".join(map(escape, re.split("\0+", template)))
        stem = re.sub(r"[\0_. -]+$", "", template.removesuffix(suffix_of(own[-1])))
        several = sum(one[0] == folder for one in alike) > 1
        yield pattern, own[-1], stem if several or below == "." else folder.name


class _Asked:
    """Questions that have no answer yet."""

    def __init__(self, answers: Mapping[str, str]) -> None:
        self.answers = answers
        self.log = ""  # in which it is asked
        self.open: dict[str, Question] = {}
        self.alike: dict[tuple[str, ...], tuple[str, Sequence[str]]] = {}

    def ask(
        self, key: str, text: str, choices: Iterable[str] = (), known: Iterable[str] = ()
    ) -> str | None:
        """The answer to a question; None, and the question is open, without one.

        The answer has to be `known`, by default one of the choices, where there are any.
        """
        likely, allowed = tuple(choices), tuple(known) or tuple(choices)
        if key not in self.answers:
            self.open.setdefault(key, Question(key, text, likely))
            return None
        if allowed and self.answers[key] not in allowed:
            message = f"{key}: got {self.answers[key]!r}; expected one of {', '.join(allowed)}"
            raise UsageError("answer", message)
        return self.answers[key]

    def which(self, own: str, motor: str, text: str, places: Sequence[str]) -> str | None:
        """The place of a motor's channel, ``motor_id.channel``.

        Motors whose places are called alike but for the motor take the answer of the first.
        """
        kind = (own.rpartition(".")[2], *(_rest(place, motor) for place in places))
        first = self.alike.setdefault(kind, (own, places))
        key, choices = (own, places) if own in self.answers else first
        answer = self.ask(key, text, choices)
        return None if answer is None else places[choices.index(answer)]


def _motors(
    guess: LogGuess, pattern: str, log: str, asked: _Asked, unused: dict[str, None]
) -> Iterator[ProposedMotor]:
    """The motors of logs that are alike."""
    folder = pattern.rpartition("/")[0]
    own = [f"{folder}/{name}" if folder else name for name in guess.layout.files]
    is_split = guess.layout.kind == "file_per_channel" or guess.format == "mcap"
    logs = _logs(guess, own if guess.layout.kind == "file_per_channel" else [pattern], asked)
    if guess.layout.motors:
        columns = tuple(guess.layout.motors)
        text = f"{log}: rows of several motors: which column has the motor's name?"
        column = (
            columns[0] if len(columns) == 1 else asked.ask(f"{log}.motor_column", text, columns)
        )
        for name in guess.layout.motors.get(column or "", ()):
            own_logs = logs | {"motor_column": column, "motor_name": name}
            yield from _grouped(guess, own_logs, name, asked, unused)
        return
    if is_split:
        for name, own_sources in (guess.layout.fields or {"": guess.layout.sources}).items():
            motor_id = _plain(name or log)
            told = {_pressure_or_channel(one): [one] for one in own_sources}
            sources = {
                channel: _with_unit(one, guess, asked, name or log)
                for channel, one in _chosen(motor_id, name or log, told, asked)
            }
            motor = ProposedMotor(name, motor_id, logs, sources, {})
            yield _complete(motor, told, guess, asked)
        unused |= dict.fromkeys(guess.layout.unused)
        return
    yield from _grouped(guess, logs, log, asked, unused)


def _pressure_or_channel(source: GuessedSource) -> str:
    """A source's channel, or "bare" for a pressure that may be any."""
    is_bare = source.channel == "pressure_difference" and is_bare_pressure(source.place)
    return "bare" if is_bare else source.channel


def _grouped(
    guess: LogGuess, logs: Mapping[str, Any], log: str, asked: _Asked, unused: dict[str, None]
) -> Iterator[ProposedMotor]:
    """The motors whose columns or tags a table has."""
    candidates = {one[0]: one for one in guess.layout.candidates}
    qualities = _qualities(candidates)
    plain = [name for name in candidates if name not in qualities.values()]
    groups, left = groups_of(plain, {name: candidates[name][2] for name in plain})
    unused |= dict.fromkeys(left)
    for group in groups:
        motor_id = _plain(group.name or log)
        rivals = _rivals(group, candidates)
        sources = {
            channel: _with_unit(source, guess, asked, group.name)
            for channel, source in _chosen(motor_id, group.name or log, rivals, asked)
        }
        quality = {
            channel: qualities.get(source.source, guess.layout.quality)
            for channel, source in sources.items()
        }
        used = {source.source for source in sources.values()}
        unused |= dict.fromkeys(name for name in group.signals if name not in used)
        motor = ProposedMotor(group.name, motor_id, logs, sources, quality)
        yield _complete(motor, rivals, guess, asked)


def _complete(
    motor: ProposedMotor, rivals: Iterable[str], guess: LogGuess, asked: _Asked
) -> ProposedMotor:
    """The motor, and questions about channels that it has to have and of which there is none."""
    sources = dict(motor.sources)
    by_name = {one[0]: one for one in guess.layout.candidates}
    there = {"pressure_difference" if one == "bare" else one for one in rivals}
    for channel in missing_channels(motor.sources):
        if channel in there:
            continue
        own, words = f"{motor.motor_id}.{channel}", channel.replace("_", " ")
        text = f"{motor.motor_id}, and motors alike: no {words} was found: which is it?"
        named = asked.which(own, motor.name or asked.log, text, tuple(by_name))
        if named is not None:
            sources[channel] = _with_unit(
                _source(channel, by_name[named]), guess, asked, motor.name
            )
    return replace(motor, sources={name: sources[name] for name in CHANNELS if name in sources})


def _logs(guess: LogGuess, files: Sequence[str], asked: _Asked) -> dict[str, Any]:
    """Keys of ``[logs]``; a comment behind one is a question."""
    logs: dict[str, Any] = {"format": guess.format, "files": files}
    for line in guess.logs:
        ((key, value),) = tomllib.loads(line).items()
        text, _, comment = line.partition("  # ")
        if comment:
            # Logs that read alike have one answer; those of another mark or format their own.
            own_key = key if key == "time_zone" else f"{key} {value}"
            answer = asked.ask(own_key, f"{asked.log}: {text}: {comment}")
            if key == "decimal" and answer not in (None, value):
                logs["thousands"] = value
            value = answer or value
        logs[key] = value
    return logs


def _qualities(candidates: Mapping[str, Candidate]) -> dict[str, str]:
    """Columns of qualities by the column that they are beside."""
    found = {}
    for name in filter(is_quality_name, candidates):
        base = re.sub(r"[\W_]+[^\W_]+$", "", name)
        if base in candidates:
            found[base] = name
    return found


def _source(channel: str, candidate: Candidate) -> GuessedSource:
    return GuessedSource(channel, candidate[1], unit_said(channel, candidate), candidate[3])


def _rivals(group: Group, candidates: Mapping[str, Candidate]) -> dict[str, list[GuessedSource]]:
    """The candidates of each channel that fit best; a pressure that may be any is last."""
    found: dict[str, list[tuple[int, GuessedSource]]] = {}
    for name, signal in group.signals.items():
        channel = channel_of(signal, candidates[name][2])
        if channel is None:
            continue
        is_bare = channel == "pressure_difference" and is_bare_pressure(signal)
        merit = -1 if is_bare else preference(channel, signal)
        found.setdefault(channel, []).append((merit, _source(channel, candidates[name])))
    best = {channel: max(merit for merit, _ in own) for channel, own in found.items()}
    if set(PORT_PRESSURES) <= set(found):  # the difference is theirs
        found.pop("pressure_difference", None)
    return {
        channel if best[channel] >= 0 else "bare": [
            one for merit, one in own if merit == best[channel]
        ]
        for channel, own in found.items()
    }


def _chosen(
    motor_id: str, motor: str, rivals: Mapping[str, Sequence[GuessedSource]], asked: _Asked
) -> Iterator[tuple[str, GuessedSource]]:
    """The source of each channel; asked where several fit."""
    for found, own in rivals.items():
        channel = "pressure_difference" if found == "bare" else found
        if len(own) == 1 and found != "bare":
            yield channel, own[0]
            continue
        names = [one.place for one in own]
        words = channel.replace("_", " ")
        text = f"{motor_id}, and motors alike: {', '.join(names)} may be the {words}: which is it?"
        named = asked.which(f"{motor_id}.{channel}", motor, text, names)
        yield from ((channel, one) for one in own if one.place == named)


def _with_unit(source: GuessedSource, guess: LogGuess, asked: _Asked, motor: str) -> GuessedSource:
    """The source with its unit; one answer is for columns called alike, where it is plausible."""
    if source.unit is not None:
        return source
    numbers = [as_number(cell, guess.marks) for cell in source.samples]
    known = [number for number in numbers if number is not None]
    shown = "; ".join(source.samples[:3])
    text = f"unit of {source.channel.replace('_', ' ')} ({source.place}: {shown}): which is it?"
    units = tuple(UNITS[QUANTITIES[source.channel]])
    likely = likely_units(source.channel, known) or units
    key = f"unit of {_rest(source.place, motor) or source.channel}"
    if key in asked.answers and asked.answers[key] not in likely:
        key = f"{key} in {asked.log}"
    return replace(source, unit=asked.ask(key, text, likely, units))


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
        own, number = _plain(motor.motor_id), 2
        while own in taken:
            own, number = f"{_plain(motor.motor_id)}-{number}", number + 1
        taken.add(own)
        found.append(replace(motor, motor_id=own))
    return tuple(found)
