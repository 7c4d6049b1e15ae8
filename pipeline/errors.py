"""The tree of errors: each has a stable code, and a message that says what, where and what to do.

The codes stand in tables, on the terminal and in ``docs/operations.md``; they never change meaning.
"""

from __future__ import annotations

from pathlib import Path

LONGEST_MESSAGE = 2000
"""Characters of a message about a stranger's file, whatever stands in it."""


class MotorLeakageError(Exception):
    """Base of every error that the pipeline raises on purpose."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(code, message)
        self.code = code
        self.message = message

    def __str__(self) -> str:
        return self.message


def one_line(text: str, longest: int = LONGEST_MESSAGE) -> str:
    r"""Return text of a stranger's file as a line that a terminal, a table and a page can show.

    What does not print (control characters, line ends, marks that turn the direction of writing,
    bytes of a name that are no UTF-8) becomes its escape; the middle of longer text is left out.

    Examples
    --------
    >>> print(one_line("a\x1b[2J\n\u202eb"), one_line("0123456789", 5))
    a\x1b[2J\n\u202eb 01…89
    """
    half = longest // 2
    short = text if len(text) <= longest else f"{text[:half]}…{text[-half:]}"
    if short.isprintable():
        return short
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in short)


class UsageError(MotorLeakageError):
    """The command was called in a way it cannot follow; exit code 2."""


class LockedError(MotorLeakageError):
    """Another run writes to the same output; exit code 3."""


class StoreError(MotorLeakageError):
    """A table could not be read or published."""


class EngineError(MotorLeakageError):
    """The cluster for the tasks cannot be used; exit code 4."""


class LogError(MotorLeakageError):
    """A log file cannot be read, or not be trusted.

    Its name is put before the message, with the place in it: a line, a column, a record or a byte.
    """

    def __init__(self, code: str, path: Path, message: str, place: str | None = None) -> None:
        where = f"{path.name}, {place}" if place else path.name
        super().__init__(code, one_line(f"{where}: {message}"))
        self.path = path
        self.place = place
        self._args = (code, path, one_line(message), place)

    def __reduce__(self) -> tuple[type[LogError], tuple[str, Path, str, str | None]]:
        # Errors travel between processes; the default calls __init__ with the base's arguments.
        return type(self), self._args
