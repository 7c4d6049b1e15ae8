"""Questions to whoever knows the plant: which column is which channel of a motor, and its unit.

What several columns fit, or none, is asked; an answer is taken as it stands.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from statistics import median
from typing import Any

from pipeline.config.channels import COUNTED, GOOD_QUALITY, PORT_PRESSURES, PULSES, TOTAL, Channel
from pipeline.config.loading import validate
from pipeline.config.logs import require_time_format
from pipeline.config.section import known_zone
from pipeline.errors import UsageError
from pipeline.messages import plain
from pipeline.setup.names import (
    QUANTITY_OF,
    Group,
    is_in,
    likely_units,
    meaning_of,
    missing_channels,
    unread_unit,
    words_of,
)
from pipeline.setup.tables import Column, Marks, Quality, Question, Table, as_number
from pipeline.units import CHANNELS, QUANTITIES, UNITS, to_canonical

# What may be answered before it is asked, and what is not asked any more with another answer.
_ALWAYS = {"time_zone", "time_format", "decimal", "motor_type", "oil"}
_KINDS = ("unit of ", "good codes of ", "motors of ", "time_format of ", "decimal of ")
_MOST_LEFT_OUT = 5  # columns that a question shows
_CHECKS = {"time_zone": known_zone, "time_format": require_time_format}
# Readings of the same unit are alike within this factor.
_ALIKE = 5.0


class Asked:
    """Questions, and which of them have no answer yet."""

    def __init__(self, answers: Mapping[str, str]) -> None:
        for key, answer in answers.items():
            try:
                _CHECKS.get(key.partition(" of ")[0], str)(answer)
            except ValueError as error:
                message = f"{key}: got {answer!r}; {error}"
                raise UsageError("answer", message) from None
        self.answers = answers
        self.log = ""  # in which it is asked
        self.open: dict[str, Question] = {}
        self.unneeded: list[str] = []  # answers to what is not asked now
        self.unused: dict[str, None] = {}  # names of columns and tags that are no channel's
        self._asked: dict[str, tuple[str, ...]] = {}
        self._used: set[str] = set()  # answers that held though nobody asked
        self.alike: dict[tuple[str, ...], tuple[str, Sequence[str]]] = {}  # the first of a kind
        self.sizes: dict[str, float] = {}  # typical reading of the first column of a name

    def ask(
        self, key: str, text: str, choices: Iterable[str] = (), known: Iterable[str] | None = None
    ) -> str | None:
        """Return the answer to a question; None, and the question is open, without any.

        The answer has to be `known`, by default one of the choices; any is taken of none.
        """
        likely = tuple(choices)
        allowed = likely if known is None else tuple(known)
        self._asked[key] = likely
        if key not in self.answers:
            self.open.setdefault(key, Question(key, text, likely))
            return None
        answer = self.answers[key]
        if allowed and answer not in allowed:
            message = f"{key}: got {answer!r}; expected one of {', '.join(allowed)}"
            raise UsageError("answer", message)
        return answer

    def keys_of(self, table: Table) -> dict[str, Any]:
        """Return keys of ``[logs]`` with the answers to what the log does not tell.

        Logs that read alike share an answer.
        """
        logs = dict(table.logs)
        for question in table.questions:
            is_other = self._asked.get(question.key, question.choices) != question.choices
            key = f"{question.key} of {self.log}" if is_other else question.key
            answer = self.ask(key, f"{self.log}: {question.text}", question.choices)
            if answer is not None:
                logs[question.key] = answer
                if question.key == "decimal" and answer != table.marks.decimal:
                    logs["thousands"] = table.marks.decimal
        if "time_format" in self.answers and "%" in logs.get("time_format", ""):
            # Other logs of the motor may be written as the answer says.
            logs["time_format"] = self.answers["time_format"]
            self._used.add("time_format")
        return logs

    def require_known(self, motor_ids: Iterable[str]) -> None:
        """Refuse answers to what nobody asks; those that are not needed now are for later."""
        ids = list(motor_ids)
        named = {f"{motor}.{key}" for motor in ids for key in (*CHANNELS, "motor_type", "oil")}
        left = sorted(
            self.answers.keys() - self._asked.keys() - self._used - named - {"motor_type", "oil"}
        )
        self.unneeded = [key for key in left if key in _ALWAYS or key.startswith(_KINDS)]
        if strange := [key for key in left if key not in self.unneeded]:
            there = ", ".join(self.open) or "none is open"
            near = get_close_matches(strange[0], [*self._asked, *named, *_ALWAYS], 1)
            meant = f"; did you mean {near[0]!r}?" if near else ""
            message = f"{strange[0]}: there is no such question; open: {there}{meant}"
            raise UsageError("answer", message)


def without_motor(place: str, motor: str) -> str:
    """Return the name of a column or tag without the motor's."""
    whole = rf"(?<![^\W_]){re.escape(motor)}(?![^\W_])"
    return re.sub(r"([._/: -])[._/: -]+", r"\1", re.sub(whole, "", place)).strip("._/: -")


def shared_channel(name: str, columns: Mapping[str, Column]) -> str | None:
    """Return the channel that a column of no motor alone is, or None."""
    unit = columns[name].unit
    words = {"tank", "reservoir", "common", "sammel", "behälter", "supply", "return"}
    plain_name = " ".join(word for word in re.split(r"[._/ ]+", name) if word.lower() not in words)
    return meaning_of(name, unit).channel or meaning_of(plain_name, unit).channel


# The channels of a motor

NONE = "none"
_DIFFERENCE = "pressure_difference"


@dataclass(frozen=True, slots=True)
class Chooser:
    """The columns of a motor's group."""

    group: Group
    columns: Mapping[str, Column]
    marks: Marks
    name: str
    motor_id: str
    asked: Asked
    further: Callable[[str], Sequence[str]]  # cells of a column from all over the log
    shared: Sequence[str] = ()  # columns that are no motor's alone
    left_out: Sequence[str] = ()  # columns that cannot be read, and why

    def places(self) -> Iterator[tuple[str, Column]]:
        """Yield column by channel, without those that are asked for.

        Its unit is the config's, or empty where it has to be asked; its keys are all of
        ``[channels.…]``.
        """
        column_names = self._column_names()
        for channel in CHANNELS:
            if name := column_names.get(channel):
                column = self.columns[name]
                unit_keys = self._unit_keys(channel, column)
                keys = {**column.keys, **unit_keys}
                if column.quality is not None:
                    keys |= self._quality_keys(column.quality)
                yield channel, replace(column, unit=unit_keys.get("unit", ""), keys=keys)

    def _column_names(self) -> dict[str, str | None]:
        """Name of the column by channel."""
        rivals, bare = self._rivals()
        column_names: dict[str, str | None] = {}
        for channel, names in rivals.items():
            # An answer has the last word, asked for or not.
            is_open = len(names) > 1 or f"{self.motor_id}.{channel}" in self.asked.answers
            why = f"{', '.join(names)} may be it"
            column_names[channel] = self._which(channel, why, names) if is_open else names[0]
        if bare:
            column_names |= self._ports(sorted(bare, key=self._size, reverse=True), column_names)
        for channel in missing_channels(column_names):
            # A thermometer in the tank, or a gauge in a common line, is of every motor.
            shared = [name for name in self.shared if shared_channel(name, self.columns) == channel]
            is_answered = f"{self.motor_id}.{channel}" in self.asked.answers
            if len(shared) == 1 and not is_answered:
                column_names[channel] = shared[0]
                continue
            own = [name for name in self.columns if name in self.group.signals]
            choices = list(dict.fromkeys((*shared, *own, *self.shared)))
            why = "; ".join(("none was found", *self.left_out[:_MOST_LEFT_OUT]))
            column_names[channel] = self._which(channel, why, choices)
        return column_names

    def _rivals(self) -> tuple[dict[str, list[str]], list[str]]:
        """Return the columns that fit each channel best, and pressures of nobody in particular."""
        fitting: dict[str, list[tuple[int, str]]] = {}
        for name, signal in self.group.signals.items():
            meaning = meaning_of(signal, self.columns[name].unit)
            if meaning.channel is not None:
                fitting.setdefault(meaning.channel, []).append((meaning.merit, name))
        rivals = {
            channel: [name for merit, name in own if merit == max(own)[0]]
            for channel, own in fitting.items()
        }
        is_bare = max(fitting.get(_DIFFERENCE, [(0, "")]))[0] < 0
        bare = rivals.pop(_DIFFERENCE) if is_bare else []
        high, low = (rivals.get(port, []) for port in PORT_PRESSURES)
        if high and low:
            rivals.pop(_DIFFERENCE, None)  # it is theirs
            bare = []
            if len(high) == len(low) == 1 and self._size(*high) < self._size(*low):
                bare = [*high, *low]  # the low port's is the higher
        if (bare and high and low) or _DIFFERENCE in rivals:
            for port in PORT_PRESSURES:
                rivals.pop(port, None)
        return rivals, bare

    def _ports(
        self, names: Sequence[str], column_names: Mapping[str, str | None]
    ) -> dict[str, str | None]:
        """Return channels of pressures whose names do not say which, the highest first."""
        high, low = PORT_PRESSURES
        columns = " and ".join(f"{name} (typically {self._size(name):.4g})" for name in names)
        why = f"the log does not say whose pressure {columns} is"
        if low in column_names or high in column_names:
            other = low if high in column_names else high
            return {other: self._which(other, why, names)}
        if len(names) > 1:
            more = f" The other is the low port's; {NONE}: they are no ports'"
            chosen = self._which(high, why, [*names, NONE], more)
            if chosen != NONE:
                others = [name for name in names if name != chosen]
                lower = others[0] if chosen and len(others) == 1 else None
                if chosen and not lower:
                    lower = self._which(low, why, others)
                return {high: chosen, low: lower}
        return {_DIFFERENCE: self._which(_DIFFERENCE, why, names)}

    def _which(self, channel: str, why: str, names: Sequence[str], more: str = "") -> str | None:
        """Return the column of a channel that is answered; None: it is asked.

        Motors whose columns are called alike but for the motor take the answer of the first.
        """
        own = f"{self.motor_id}.{channel}"
        rests = (without_motor(name, self.name) for name in names)
        first, alike = self.asked.alike.setdefault((channel, *rests), (own, names))
        if own in self.asked.answers or first == own:
            motor = f"{self.motor_id}, and motors alike"
            text = f"{motor}: {why}: which is the {plain(channel)}?{more}"
            return self.asked.ask(own, text, names, (*names, *self.columns))
        answer = self.asked.answers.get(first)
        return names[alike.index(answer)] if answer in alike else None

    def _size(self, name: str) -> float:
        """Return typical magnitude of a pressure, in bar where its unit is stated."""
        own = self.columns[name]
        sizes = [abs(number) for number in self._numbers(own)]
        unit = meaning_of(name, own.unit).unit
        known = unit if QUANTITY_OF.get(unit or "") == "pressure" else None
        return float(to_canonical(_DIFFERENCE, median(sizes or [0.0]), known or "bar"))

    def _numbers(self, column: Column) -> list[float]:
        numbers = (as_number(cell, self.marks) for cell in column.filled)
        return [number for number in numbers if number is not None]

    def _unit_keys(self, channel: str, column: Column) -> dict[str, Any]:
        """Return unit of a column, and what else of its number is answered; empty if it is asked.

        An answer is for columns called alike whose readings are alike.
        """
        unit = meaning_of(column.name, column.unit).unit
        if unit is not None and QUANTITY_OF.get(unit) == QUANTITIES[channel]:
            return {"unit": unit}
        # The head of a log may be a standstill.
        known = (as_number(cell, self.marks) for cell in self.further(column.name))
        numbers = [abs(number) for number in known if number] or [*map(abs, self._numbers(column))]
        shown = "; ".join(column.filled[:3])
        text = f"{self.motor_id}: unit of {plain(channel)} ({column.name}: {shown}): which is it?"
        units = tuple(UNITS[QUANTITIES[channel]])
        likely = likely_units(channel, numbers) or units
        example = f'unit = "{units[0]}", scale = 1.0, offset = 0.0'
        if unread := unread_unit(column.name, column.unit):
            text += f" The log says {unread!r}, none of {', '.join(units)}: answer keys of the "
            text += f"channel, as {example}"
            units = likely = ()
        elif channel == COUNTED and is_in(words_of(column.name), "column", "counter"):
            example = f'unit = "{TOTAL}", volume_per_count_cm3 = 1000.0'
            text += f" Of a counter answer keys of the channel, as {example}; of counts since the "
            text += f"sample before the unit is {PULSES!r}"
            units = likely = ()
        key = f"unit of {without_motor(column.name, self.name) or channel}"
        size = median(numbers or [0.0])
        first = self.asked.sizes.setdefault(key, size)
        own = f"{key} in {self.motor_id}"
        is_alike = first == size or 1.0 / _ALIKE < size / (first or 1.0) < _ALIKE
        if own in self.asked.answers or not is_alike:
            key = own
        answer = self.asked.ask(key, text, likely, ())
        if answer is None or answer in units:
            return {"unit": answer} if answer else {}
        keys: dict[str, Any] = {}
        with suppress(tomllib.TOMLDecodeError):
            keys = tomllib.loads(f"keys = {{{answer}}}")["keys"]
        answered = validate(Channel, {"source": "any", **keys}, "", [])
        if answered is None or answered.unit not in (*UNITS[QUANTITIES[channel]], TOTAL, PULSES):
            expected = ", ".join((*units, f"keys of the channel, as {example}"))
            raise UsageError("answer", f"{key}: got {answer!r}; expected {expected}")
        return keys

    def _quality_keys(self, quality: Quality) -> dict[str, Any]:
        """Return keys of a channel's quality; none where it is not to be used."""
        codes: Sequence[str | int] = quality.good or ()
        key = f"good codes of {' '.join(quality.words)}"
        if not codes or key in self.asked.answers:
            seen = "; ".join(dict.fromkeys(quality.cells))
            text = (
                f"quality {quality.source} ({seen}): which codes are those of a good sample, with "
                f"commas between them? {NONE}: it is no quality"
            )
            answer = self.asked.ask(key, text)
            if answer is None or answer == NONE:
                self.asked.unused[quality.source] = None
                return {}
            codes = [int(code) if code.isdigit() else code for code in answer.split(",")]
        known = {str(code).casefold() for code in GOOD_QUALITY}
        is_default = {str(code).casefold() for code in codes} <= known
        source = {"quality_source": quality.source}
        return source if is_default else source | {"quality_good": list(codes)}
