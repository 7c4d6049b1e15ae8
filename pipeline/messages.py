"""Log and error messages of the program: lines for people, or a JSON object a line.

Workers are processes of their own; their messages go to the same stderr, in the same form.
"""

from __future__ import annotations

import datetime as dt
import json
import logging
import os
import sys

# Tells worker processes, which inherit it, in what form to speak.
FORM = "MOTOR_LEAKAGE_MESSAGES"
AS_JSON = "json"
# A figure that there is not.
ABSENT = "–"


class JsonLine(logging.Formatter):
    """A record as a line of JSON: event, time (UTC), level, logger, message, traceback."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line = {
            "event": "log",
            "time": dt.datetime.fromtimestamp(record.created, dt.UTC).isoformat(),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            "process": record.process,
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line)


def speak(*, as_json: bool) -> None:
    """Choose the form of this process and of the workers that it starts."""
    os.environ[FORM] = AS_JSON if as_json else ""
    _attach()


def speak_as_parent() -> None:
    """Take the form that the process chose that started this; does nothing where it is set."""
    if not logging.getLogger().handlers:
        _attach()


def _attach() -> None:
    handler = logging.StreamHandler(sys.stderr)
    if os.environ.get(FORM) == AS_JSON:
        handler.setFormatter(JsonLine())
    else:
        handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(handlers=[handler])


def counted(n: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{n} {noun}{'s' * (n != 1)}"


def error_line(code: str, message: str, exit_code: int, *, as_json: bool) -> str:
    """Return the message of a command that ends early, with its cause."""
    if not as_json:
        return f"motor-leakage: {code}: {message}"
    line = {"event": "error", "code": code, "message": message, "exit_code": exit_code}
    return json.dumps(line)


def plain(name: str) -> str:
    """Return a name of the tables with blanks for underscores."""
    return name.replace("_", " ")


def as_sentence(words: str) -> str:
    """Return words with a capital and a full stop."""
    return f"{words[:1].upper()}{words[1:].removesuffix('.')}." if words else ""


def statement(sentence: str, advice: str) -> str:
    """Return what is reported of a motor and what to do, as pages, mail and terminal say it."""
    return " ".join(as_sentence(text) for text in (sentence, advice) if text)


def figure(value: float | None, digits: int = 3) -> str:
    """Return a figure with a number of significant digits, never in powers of ten above that.

    Examples
    --------
    >>> figure(1.2345), figure(0.05), figure(999.6), figure(-123456.0), figure(-0.0)
    ('1.23', '0.0500', '1000', '−123456', '0.00')
    """
    if value is None:
        return ABSENT
    rounded = float(f"{value:.{digits}g}") + 0.0  # no minus before a zero
    is_large = abs(rounded) >= 10**digits
    text = f"{value:.0f}" if is_large else f"{rounded:z#.{digits}g}"
    return text.removesuffix(".").replace("-", "−")
