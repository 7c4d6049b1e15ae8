"""Which files are one motor's: those whose names or folders differ by a date, a count or a part.

What surely differs from log to log is in `DATES`. A count may number logs or motors: files that
differ by one alone are one motor's where they have the same columns and follow each other in time
under a name for logs; under any other name it is asked.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from glob import escape
from itertools import chain, pairwise
from pathlib import Path

from pipeline.logs.finding import suffix_of
from pipeline.setup.names import is_in, words_of

_YEAR, _MONTH, _DAY = r"(?:19|20)\d\d", r"(?:1[0-2]|0?[1-9])", r"(?:3[01]|[12]\d|0?[1-9])"
_MONTH_NAME = r"(?:jan|feb|m[aä]r|apr|ma[iy]|jun|jul|aug|sep|o[ck]t|nov|de[cz])[a-zä]{0,6}"
_WEEKDAY = r"(?:[-_ ]?(?:mo|tu|we|th|fr|sa|su|di|mi|do|so|\d)[a-z]*)?"
_TIME = r"(?:[-_T. ]{0,3}\d\d[-_.:h]?\d\d(?:[-_.:m]?\d\d(?:[.,]\d+)?)?Z?)?"
# What differs from log to log of a motor, by how it is written.
DATES = {
    "2026-01-02, 20260102, 2026-1-2 0630": rf"{_YEAR}[-_. ]?{_MONTH}[-_. ]?{_DAY}{_TIME}",
    "02.01.2026, 1-2-2026": rf"{_DAY}[-_. ]{_DAY}[-_. ]{_YEAR}{_TIME}",
    "02Jan2026, 2-Jan-26": rf"{_DAY}[-_. ]?{_MONTH_NAME}[-_. ]?(?:{_YEAR}|\d\d){_TIME}",
    "2026-Jan-02": rf"{_YEAR}[-_. ]?{_MONTH_NAME}[-_. ]?{_DAY}{_TIME}",
    "2026-W03": rf"{_YEAR}[-_]?w\d\d{_WEEKDAY}",
    "KW03_Fri, week 3": rf"(?:{_YEAR}[-_ ]?)?(?:kw|cw|wk|week|vecka)[-_ ]?\d\d?{_WEEKDAY}",
    "2026-01, Jan 2026": rf"{_YEAR}[-_.]?(?:0[1-9]|1[0-2])|{_MONTH_NAME}[-_ ]?{_YEAR}",
    "a long number": r"\d{6,}Z?",
}
_DATE = re.compile("|".join(rf"(?<!\d)(?:{form})(?!\d)" for form in DATES.values()), re.IGNORECASE)
# Of Spark: part-00000-8d1f.snappy.parquet.
_PART = re.compile(r"^part-\d+[\w-]*(?:\.c\d+)?(?:\.(?:snappy|zstd|gz|lz4))?(?=\.)", re.IGNORECASE)
_HIVE = re.compile(r"^((?:date|day|dt|ds|year|month|hour|week|[ymdh])=).+$", re.IGNORECASE)
_ID = re.compile(
    r"((?<![0-9a-f])(?=[0-9a-f-]*\d)(?=[0-9a-f-]*[a-f])[0-9a-f-]{8,}(?![0-9a-f]))", re.IGNORECASE
)
# A copy that a browser numbers, a date of two-digit years, a number.
_COPY, _SHORT_DATE = r" ?\(\d+\)", r"\d\d([-_.])\d\d\1\d\d"
VARIES, COUNT = "\0", "\1"

Parts = tuple[str, ...]
Span = tuple[int, int]
"""Ends of a log in microseconds."""
Ask = Callable[[str, str, Sequence[str]], str | None]


@dataclass(frozen=True, slots=True)
class Kind:
    """Files of a motor, or of several whose rows or columns are in each of them."""

    patterns: tuple[str, ...]
    files: tuple[Path, ...]
    name: str  # what names them


def kinds_of(
    files: Sequence[Path],
    root: Path,
    columns_of: Callable[[Path], object],
    span_of: Callable[[Path], Span | None],
    ask: Ask,
) -> list[Kind]:
    """Return the files by motor, or log of several motors, in the order of their names.

    Columns and ends distinguish logs of a motor from those of several, where they are known.
    """
    alike: dict[Parts, list[Path]] = {}
    for path in files:
        alike.setdefault(template_of(path.relative_to(root).parts), []).append(path)
    for without in (without_counts, _without_word):
        groups: dict[Parts, dict[Parts, list[Path]]] = {}
        for template, own in alike.items():
            groups.setdefault(without(template), {})[template] = own
        alike = {}
        for joined, by_template in groups.items():
            is_word = without is _without_word
            if len(by_template) > 1 and _is_one_motor(
                joined, by_template, columns_of, span_of, ask, is_word=is_word
            ):
                by_template = {joined: sorted(chain(*by_template.values()))}
            alike |= by_template
    by_motor: dict[Parts, list[Parts]] = {}
    for template in alike:
        by_motor.setdefault((*template[:-1], _unpack(template[-1])), []).append(template)
    in_folder = Counter(template[:-1] for template in by_motor)
    return [
        Kind(
            tuple(chain(*(_patterns(own, alike[own], files, root) for own in templates))),
            tuple(sorted(chain(*map(alike.__getitem__, templates)))),
            _name(template, is_alone=in_folder[template[:-1]] == 1) or root.name,
        )
        for template, templates in by_motor.items()
    ]


def _without_word(template: Parts) -> Parts:
    """Return a template with a mark for the word behind its date, as of a shift."""
    begin, mark, end = template[-1].rpartition(VARIES)
    end = re.sub(r"^([-_. ]?)[^\W\d_]+(?=\.)", rf"\1{COUNT}", end) if mark else end
    return (*template[:-1], begin + mark + end)


def _unpack(name: str) -> str:
    """Return the name of a log without the suffix of its packing."""
    return re.sub(r"(?i)\.(?:gz|zst)$", "", name)


def template_of(place: Sequence[str]) -> Parts:
    r"""Return the folders and the name of a log with a mark for what differs from log to log.

    Examples
    --------
    >>> template_of(("2026", "01", "winch.csv"))
    ('\x00', '\x00', 'winch.csv')
    >>> template_of(("W1", "date=2026-01-02", "W1_02.01.2026.csv"))
    ('W1', 'date=\x00', 'W1_\x00.csv')
    """
    template, is_date = list[str](), False
    for part in place:
        stem, suffix = (part, "") if part is not place[-1] else (Path(part).stem, Path(part).suffix)
        # Behind the folder of a year stand those of months and days.
        is_date = bool(re.fullmatch(_YEAR, stem) or (is_date and re.fullmatch(r"\d\d?", stem)))
        template.append(VARIES + suffix if is_date else _dated(part))
    return tuple(template)


def _dated(part: str) -> str:
    pieces = _ID.split(_HIVE.sub(rf"\1{VARIES}", _PART.sub(VARIES, part)))
    dated = [
        piece if at % 2 and not _DATE.fullmatch(piece) else _DATE.sub(VARIES, piece)
        for at, piece in enumerate(pieces)
    ]
    # Beside a date an id says nothing.
    return VARIES.join(dated[::2]) if VARIES in "".join(dated) else "".join(dated)


def without_counts(template: Parts) -> Parts:
    r"""Return a template with a mark for each count that may number logs: behind a date, if any.

    Examples
    --------
    >>> without_counts(("shift", "shift_0.mcap")), without_counts(("W1_\0_2.csv",))
    (('shift', 'shift_\x01.mcap'), ('W1_\x00_\x01.csv',))
    >>> without_counts(("session 1", "log.csv")), without_counts(("W1", "W1_\0.csv"))
    (('session \x01', 'log.csv'), ('W1', 'W1_\x00.csv'))
    """
    *folders, name = template
    begin, mark, end = name.rpartition(VARIES)
    last = Path(f"_{end}")
    counted = f"{begin}{mark}{_counted(last.stem)[1:]}{last.suffix}"
    if folders and counted == name and VARIES not in "".join(template):
        folders[-1] = _counted(folders[-1])
    return (*folders, counted)


def _counted(text: str) -> str:
    for form, count in ((_COPY, ""), (_ID.pattern, COUNT), (_SHORT_DATE, COUNT), (r"\d+", COUNT)):
        text = re.sub(form, count, text, flags=re.IGNORECASE)
    return text


def _is_one_motor(
    counted: Parts,
    own: Mapping[Parts, Sequence[Path]],
    columns_of: Callable[[Path], object],
    span_of: Callable[[Path], Span | None],
    ask: Ask,
    *,
    is_word: bool,
) -> bool:
    """Return True if files that differ by a count, or a word, are one motor's.

    It is asked where that is not clear.
    """
    columns = [columns_of(group[-1]) for group in own.values()]
    if None in columns or any(column != columns[0] for column in columns):
        return False
    ends = dict.fromkeys(path for group in own.values() for path in (group[0], group[-1]))
    spans = [span_of(path) for path in ends]
    known = sorted(span for span in spans if span is not None)
    if any(later[0] < earlier[1] for earlier, later in pairwise(known)):
        return False
    part = next((part for part in counted if COUNT in part), "")
    before = words_of(re.split(f"{COUNT}|{VARIES}", part)[0])[-1:]
    is_log = VARIES in part or not before or is_in(before, "file", "log")
    is_dated = all(re.search(_SHORT_DATE, template[-1]) for template in own)
    if None not in spans and (is_log or is_dated) and not is_word:
        return True
    shown = ", ".join("/".join(template) for template in list(own)[:3]).replace(VARIES, "*")
    text = f"{shown}: logs of one motor, one after the other, or of several motors?"
    pattern = "/".join(counted).replace(COUNT, "*").replace(VARIES, "*")
    return ask(f"motors of {pattern}", text, ("one", "several")) == "one"


def _patterns(
    template: Parts, own: Sequence[Path], files: Sequence[Path], root: Path
) -> tuple[str, ...]:
    """Return the pattern of a template that fits no other file, or else each file."""
    pieces = [[escape(piece) for piece in re.split(f"[{VARIES}{COUNT}]+", p)] for p in template]
    if len(pieces[-1]) == 1 and len({path.name for path in own}) > 1:
        # Copies that a browser numbers have their count behind the name of the first.
        last = Path(template[-1])
        pieces[-1] = [escape(last.stem), last.suffix]
    others = [path.relative_to(root).parts for path in files if path not in own]
    for star in ("*", "[0-9]*"):
        parts = [star.join(part) for part in pieces]
        if not any(
            len(other) == len(parts) and all(map(fnmatchcase, other, parts)) for other in others
        ):
            return ("/".join(parts),)
    return tuple(escape(path.relative_to(root).as_posix()) for path in own)


def _name(template: Parts, *, is_alone: bool) -> str:
    """Return what names the logs of a template: their folder, or else their own name."""
    *folders, name = (
        re.sub(rf"^[{VARIES}{COUNT}_. -]+|[{VARIES}{COUNT}_. -]+$", "", part)
        for part in (*template[:-1], template[-1].removesuffix(suffix_of(Path(template[-1]))))
    )
    named = [folder for folder in folders if folder and not folder.endswith("=")]
    return named[-1] if named and (is_alone or not name) else name
