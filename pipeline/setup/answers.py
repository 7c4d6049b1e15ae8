"""Questions to whoever knows the plant, and the answers that there are: taken as they stand."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pipeline.config.section import known_zone
from pipeline.errors import UsageError
from pipeline.setup.tables import Question, Table
from pipeline.units import CHANNELS

# What may be answered before it is asked.
_ALWAYS = {"time_zone", "time_format", "decimal", "time", "motor_type", "oil"}


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

    def which(
        self, own: str, motor: str, text: str, places: Sequence[str], known: Iterable[str]
    ) -> str | None:
        """The place of a motor's channel, ``motor_id.channel``, by its name.

        Motors whose places are called alike but for the motor take the answer of the first.
        """
        rests = (re.sub(r"[\[(].*?[\])]", "", without_motor(place, motor)) for place in places)
        kind = (own.rpartition(".")[2], *rests)
        first, alike = self._alike.setdefault(kind, (own, places))
        if own in self.answers or first == own:
            return self.ask(own, text, places, (*places, *known))
        answer = self.answers.get(first)
        return places[alike.index(answer)] if answer in alike else None

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
