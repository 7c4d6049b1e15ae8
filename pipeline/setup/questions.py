"""Questions to whoever knows the plant: which column is which channel of a motor, and its unit.

What several columns fit, or none, is asked; an answer is taken as it stands.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

from pipeline.config.channels import GOOD_QUALITY, PORT_PRESSURES
from pipeline.config.section import known_zone
from pipeline.errors import UsageError
from pipeline.messages import plain
from pipeline.setup.names import QUANTITY_OF, Group, likely_units, meaning_of, missing_channels
from pipeline.setup.tables import Column, Marks, Quality, Question, Table, as_number
from pipeline.units import CHANNELS, QUANTITIES, UNITS, to_canonical

# What may be answered before it is asked.
_ALWAYS = {"time_zone", "time_format", "decimal", "motor_type", "oil"}


class Asked:
    """Questions, and which of them have no answer yet.

    Raises UsageError (``answer``) for a time zone that there is not, asked for or not.
    """

    def __init__(self, answers: Mapping[str, str]) -> None:
        try:
            known_zone(answers.get("time_zone", "UTC"))
        except ValueError as error:
            message = f"time_zone: got {answers['time_zone']!r}; {error}"
            raise UsageError("answer", message) from None
        self.answers = answers
        self.log = ""  # in which it is asked
        self.open: dict[str, Question] = {}
        self.unused: dict[str, None] = {}  # names of columns and tags that are no channel's
        self._asked: dict[str, tuple[str, ...]] = {}
        self.alike: dict[tuple[str, ...], tuple[str, Sequence[str]]] = {}  # the first of a kind

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
            message = f"{key}: got {answer!r}; expected one of {', '.join(allowed)}"
            raise UsageError("answer", message)
        return answer

    def keys_of(self, table: Table) -> dict[str, Any]:
        """Keys of ``[logs]`` with the answers to what the log does not tell.

        Logs that read alike have one answer.
        """
        logs = dict(table.logs)
        for one in table.questions:
            is_other = self._asked.get(one.key, one.choices) != one.choices
            key = f"{one.key} of {self.log}" if is_other else one.key
            answer = self.ask(key, f"{self.log}: {one.text}", one.choices)
            if answer is not None:
                logs[one.key] = answer
                if one.key == "decimal" and answer != table.marks.decimal:
                    logs["thousands"] = table.marks.decimal
        return logs

    def require_known(self, motor_ids: Iterable[str]) -> None:
        """Refuse answers to what nobody asked; a motor's channel may always be named."""
        named = {f"{motor}.{channel}" for motor in motor_ids for channel in CHANNELS}
        strange = sorted(self.answers.keys() - self._asked.keys() - named - _ALWAYS)
        if strange:
            there = ", ".join(self.open) or "none is open"
            raise UsageError("answer", f"{strange[0]}: there is no such question; open: {there}")


def without_motor(place: str, motor: str) -> str:
    """The name of a column or tag without the motor's."""
    whole = rf"(?<![^\W_]){re.escape(motor)}(?![^\W_])"
    return re.sub(r"([._/: -])[._/: -]+", r"\1", re.sub(whole, "", place)).strip("._/: -")


# The channels of a motor

NONE = "none"
_DIFFERENCE = "pressure_difference"


@dataclass(frozen=True, slots=True)
class Chooser:
    """The columns of one motor's group."""

    group: Group
    columns: Mapping[str, Column]
    marks: Marks
    name: str
    motor_id: str
    asked: Asked

    def places(self) -> Iterator[tuple[str, Column]]:
        """Column by channel, without those that are asked for.

        Its unit is the config's, or empty where it has to be asked; its keys are all of
        ``[channels.…]``.
        """
        found = self._found()
        for channel in CHANNELS:
            if name := found.get(channel):
                column = self.columns[name]
                unit = self._unit(channel, column)
                keys = {**column.keys, **({"unit": unit} if unit else {})}
                if column.quality is not None:
                    keys |= self._quality_keys(column.quality)
                yield channel, replace(column, unit=unit or "", keys=keys)

    def _found(self) -> dict[str, str | None]:
        """Name of the column by channel."""
        rivals, bare = self._rivals()
        found: dict[str, str | None] = {}
        for channel, names in rivals.items():
            # An answer has the last word, asked for or not.
            is_open = len(names) > 1 or f"{self.motor_id}.{channel}" in self.asked.answers
            why = f"{', '.join(names)} may be it"
            found[channel] = self._which(channel, why, names) if is_open else names[0]
        if bare:
            found |= self._ports(sorted(bare, key=self._size, reverse=True), found)
        for channel in missing_channels(found):
            found[channel] = self._which(channel, "none was found", list(self.columns))
        return found

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
        is_bare = max(fitting.get(_DIFFERENCE, [(0, "")]))[0] < 0
        bare = rivals.pop(_DIFFERENCE) if is_bare else []
        high, low = (rivals.get(port, []) for port in PORT_PRESSURES)
        if high and low:
            rivals.pop(_DIFFERENCE, None)  # it is theirs
            bare = []
            if len(high) == len(low) == 1 and self._size(*high) < self._size(*low):
                bare = [*high, *low]  # the low port's is the higher one
        if (bare and high and low) or _DIFFERENCE in rivals:
            for port in PORT_PRESSURES:
                rivals.pop(port, None)
        return rivals, bare

    def _ports(
        self, names: Sequence[str], found: Mapping[str, str | None]
    ) -> dict[str, str | None]:
        """Channels of pressures of which the names do not say whose they are, the highest first."""
        high, low = PORT_PRESSURES
        told = " and ".join(f"{name} (typically {self._size(name):.4g})" for name in names)
        why = f"the log does not say whose pressure {told} is"
        if low in found or high in found:
            other = low if high in found else high
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
        """The column of a channel that is answered; None: it is asked.

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
        """Typical magnitude of a pressure, in bar where its unit is said."""
        own = self.columns[name]
        sizes = [abs(number) for number in self._numbers(own)]
        unit = meaning_of(name, own.unit).unit
        known = unit if QUANTITY_OF.get(unit or "") == "pressure" else None
        return float(to_canonical(_DIFFERENCE, median(sizes or [0.0]), known or "bar"))

    def _numbers(self, column: Column) -> list[float]:
        found = (as_number(cell, self.marks) for cell in column.filled)
        return [number for number in found if number is not None]

    def _unit(self, channel: str, column: Column) -> str | None:
        """The unit of a column; one answer is for columns called alike, where it is plausible."""
        said = meaning_of(column.name, column.unit).unit
        if said is not None and QUANTITY_OF.get(said) == QUANTITIES[channel]:
            return said
        shown = "; ".join(column.filled[:3])
        text = f"unit of {plain(channel)} ({column.name}: {shown}): which is it?"
        units = tuple(UNITS[QUANTITIES[channel]])
        likely = likely_units(channel, self._numbers(column)) or units
        key = f"unit of {without_motor(column.name, self.name) or channel}"
        if key in self.asked.answers and self.asked.answers[key] not in likely:
            key = f"{key} in {self.asked.log}"
        return self.asked.ask(key, text, likely, units)

    def _quality_keys(self, quality: Quality) -> dict[str, Any]:
        """Keys of a channel's quality; none where it is not to be used."""
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
