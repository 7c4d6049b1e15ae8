"""Guesses at cells of text: numbers, with which marks in them, or nothing."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pipeline.config.logs import MISSING_TOKENS, THOUSANDS

_GROUP = "[" + "".join(map(re.escape, THOUSANDS)) + "]"
_NUMBER = re.compile(
    rf"[+-]?(?:\d{{1,3}}(?P<group>{_GROUP})\d{{3}}(?:(?P=group)\d{{3}})*|\d+)"
    r"(?P<fraction>[.,]\d*)?(?:[eE][+-]?\d+)?|[+-]?[.,]\d+(?:[eE][+-]?\d+)?"
)
_NOT_FINITE = re.compile(r"(?i)[+-]?(nan|inf|infinity)")
# Cells that are no numbers of a column that holds some: more kinds are no tokens for "missing".
_MOST_TOKENS = 5


@dataclass(frozen=True, slots=True)
class Marks:
    """Marks that numbers have."""

    decimal: str = "."
    thousands: str = ""  # between groups of three digits; empty for none
    is_certain: bool = True  # False where every mark could be either


def is_number(cell: str) -> bool:
    """True if a cell is a number in some dialect.

    Examples
    --------
    >>> [is_number(cell) for cell in ("-1.234,5", "1e-3", "bar", "12.03.2025")]
    [True, True, False, False]
    """
    return bool(_NUMBER.fullmatch(cell) or _NOT_FINITE.fullmatch(cell))


def is_missing(cell: str) -> bool:
    """True if a cell says that there is no sample."""
    return cell in MISSING_TOKENS


def marks_of(cells: Iterable[str]) -> Marks:
    """Decimal mark and mark between thousands that numbers seem to have.

    Examples
    --------
    >>> marks_of(["1.234,5", "7,25"])
    Marks(decimal=',', thousands='.', is_certain=True)
    >>> marks_of(["1.234", "5.678"])
    Marks(decimal='.', thousands='', is_certain=False)
    """
    numbers = [cell.lstrip("+-") for cell in cells if _NUMBER.fullmatch(cell)]
    decimals = [mark for mark in map(_decimal_of, numbers) if mark]
    groups = [mark for mark in map(_thousands_of, numbers) if mark]
    either = [mark for cell in numbers if (mark := _either(cell))]
    if decimals:
        decimal = max(set(decimals), key=decimals.count)
    elif groups and groups[0] in ".,":
        decimal = "," if groups[0] == "." else "."
    else:
        decimal = either[0] if either else "."
        return Marks(decimal, groups[0] if groups else "", not either)
    groups += [mark for mark in either if mark != decimal]
    return Marks(decimal, next((mark for mark in groups if mark != decimal), ""))


def _decimal_of(cell: str) -> str:
    """Mark in a number that can only be a decimal mark."""
    parts = re.split(r"[eE]", cell)[0]
    last = max(parts.rfind("."), parts.rfind(","))
    if last < 0 or parts.count(parts[last]) > 1:
        return ""
    before, after = parts[:last], parts[last + 1 :]
    grouped = bool(re.search(_GROUP, before))
    lone = len(after) == 3 and 1 <= len(before) <= 3 and not before.startswith("0")
    return parts[last] if grouped or not lone else ""


def _thousands_of(cell: str) -> str:
    """Mark in a number that can only stand between thousands."""
    found = re.findall(rf"(?<=\d)({_GROUP})(?=\d{{3}}(?!\d))", cell)
    if found and (found[0] not in ".," or found.count(found[0]) > 1):
        return str(found[0])
    both = re.fullmatch(r"\d{1,3}(?:([.,])\d{3})+(?!\1)[.,]\d*", cell)
    return both[1] if both else ""


def _either(cell: str) -> str:
    """Mark in a number that may be a decimal mark or stand between thousands."""
    lone = re.fullmatch(r"[1-9]\d{0,2}([.,])\d{3}", cell)
    return lone[1] if lone else ""


def as_number(cell: str, marks: Marks) -> float | None:
    """A cell's number; None: it is none.

    Examples
    --------
    >>> as_number("1.234,5", Marks(",", "."))
    1234.5
    """
    plain = cell.replace(marks.thousands, "") if marks.thousands else cell
    try:
        return float(plain.replace(marks.decimal, "."))
    except ValueError:
        return None


def strange_tokens(cells: Sequence[str]) -> tuple[str, ...]:
    """Cells of a column of numbers that seem to say "no sample", and are not known to.

    Examples
    --------
    >>> strange_tokens(["1.5", "ERR", "", "2.5"]), strange_tokens(["a", "b"])
    (('ERR',), ())
    """
    words = [cell for cell in cells if not is_number(cell) and not is_missing(cell)]
    if not words or 2 * len(words) > len(cells) or len(set(words)) > _MOST_TOKENS:
        return ()
    return tuple(dict.fromkeys(words))
