"""The channel and the unit that a name in a log means.

Names of columns, tags, topics and files are taken apart into words. A whole word decides before a
single letter does; a unit alone decides where no word is known, and has the last word.
"""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path

from pipeline.config.channels import PORT_PRESSURES
from pipeline.units import QUANTITIES, UNITS, to_canonical

_FILE = Path(__file__).with_name("vocabulary.toml")
VOCABULARY: Mapping[str, Mapping[str, str]] = tomllib.loads(_FILE.read_text("utf-8"))
CHANNEL_OF = {"temperature": "oil_temperature", "speed": "speed", "flow": "leakage_flow"}
QUANTITY_OF = {unit: quantity for quantity in ("pressure", *CHANNEL_OF) for unit in UNITS[quantity]}
LOW_SIDE = ("low_port_pressure", "charge_pressure", "case_pressure")
FEWEST_CHANNELS = 3  # by which names are a motor's

# Upper quartile of the magnitude that a motor at work shows, in the units of the tables.
USUAL: Mapping[str, tuple[float, float]] = {
    "pressure": (5.0, 450.0),
    "temperature": (5.0, 95.0),
    "speed": (0.5, 400.0),
    "flow": (0.05, 100.0),
}
_USUAL_LOW_SIDE = (0.1, 100.0)

_BRACKETED = re.compile(r"[\[(<{]([^\])>}]*)[\])>}]")
# A share, or a factor: "0.1", "10^-1", and behind another word "x10".
_FACTOR = re.compile(
    r"%|(?<![^\W_])(?:0[.,]\d+|10\^|1[eE]-\d)"
    r"|(?<=[\s_)\]])(?:[x×*/] ?|div)(?:0[.,]\d+|10+)(?![^\W_])"
)
_IMPERIAL = re.compile(r"(?i)(?<![^\W_])(?:imp|imperial|uk)(?![^\W_])")
_LABEL = re.compile(r"[{,]\s*\w+=\"([^\"]*)\"}?")
_WORD = re.compile(r"[^\W\d_]+|\d+")
_HIGHER = re.compile(r"(?<=[^\W\dA-Z_])(?=[A-Z])")
_MARK = re.compile(r"[._/:|\\\s-]+")
_PORT_WORDS = {"a", "b"}
_LONGEST_WITH_A_LETTER = 4


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a name says; `channel` is None where it means none, or contradicts its unit."""

    channel: str | None
    unit: str | None  # as the config has it; None: not stated
    merit: int = 0  # how well the name fits its channel; below 0 for a pressure that may be any


@cache
def _known_words(table: str, key: str) -> re.Pattern[str]:
    """Return words of the vocabulary, with and without the marks on their letters."""
    words = {
        spelling for word in VOCABULARY[table][key].split() for spelling in _spelled(word.lower())
    }
    return re.compile("|".join(re.escape(word).replace(r"\*", ".*") for word in words))


def _spelled(word: str) -> Iterator[str]:
    two = {"ö": "oe", "ä": "ae", "ü": "ue", "ł": "l", "ø": "o", "æ": "ae", "ı": "i"}
    yield word
    yield "".join(two.get(letter, letter) for letter in word)
    yield "".join(
        letter for letter in unicodedata.normalize("NFD", word) if not unicodedata.combining(letter)
    )


def is_in(words: Iterable[str], table: str, key: str) -> bool:
    """Return True if any word is of the vocabulary."""
    return any(map(_known_words(table, key).fullmatch, words))


def words_of(name: str) -> tuple[str, ...]:
    """Return words and numbers of a name, in lower case, without what stands in brackets."""
    plain = unicodedata.normalize("NFC", _BRACKETED.sub(" ", re.sub("[Δ∆]", "d", name)))
    words = _WORD.findall(_HIGHER.sub(" ", plain).lower())
    return tuple(re.sub(r"\bd p\b", "dp", " ".join(words)).split())


_UNITS = {low: unit for unit, names in VOCABULARY["unit"].items() for low in names.split()}
# Of "pa" the letters' case distinguishes pascals from the pressure of port A.
_UNITS |= {unit if unit == "Pa" else unit.lower(): unit for unit in QUANTITY_OF}


def unit_named(text: str) -> str | None:
    """Return unit of the config that a text is the name of."""
    plain = re.sub(r"[\s·\[\]]|^unit[=:]", "", text)
    return _UNITS.get(plain if plain.lower() == "pa" else plain.lower())


def unit_in(name: str) -> str | None:
    """Return unit that a name states: in brackets, behind a comma or stroke, or as a word."""
    return None if unread_unit(name) else unit_named(_unit_text(name))


def unread_unit(name: str, unit: str = "") -> str:
    """Return what a log states in the place of a unit that is read; empty for nothing.

    Examples
    --------
    >>> [unread_unit(name) for name in ("q [0.1 l/min]", "q [l/min] x10", "q [mA]", "q [l/min]")]
    ['0.1 l/min', 'x10', 'mA', '']
    >>> unread_unit("q gpm (imp)"), unread_unit("q [10 mbar]"), unread_unit("[default]M1.dp")
    ('imp', '10 mbar', '')
    """
    # What a name begins with is a place: "[default]Drive 1/dp".
    bracketed: list[str] = _BRACKETED.findall(_LABEL.sub("", name)[1:])
    stated = [text for text in (unit, *bracketed) if text]
    for text in stated:
        scaled = re.sub(r"^[\d.,/ ]+", "", text)
        if _FACTOR.search(text) or (unit_named(scaled) and not unit_named(text)):
            return text
    known = unit_named(unit) or unit_named(_unit_text(name))
    imperial = _IMPERIAL.search(name) if known == "us_gal/min" else None
    if factor := _FACTOR.search(_BRACKETED.sub("()", name)) or imperial:
        return factor[0]
    words = ((text, text.lower().split()) for text in stated)
    return "" if known else next((text for text, own in words if _may_be_unit(own)), "")


def _may_be_unit(words: Sequence[str]) -> bool:
    """Return True for words of a bracket that say nothing of a place or quantity."""
    tables = [(table, key) for table in ("quantity", "role", "other") for key in VOCABULARY[table]]
    has_letters = any(re.search(r"[^\W\d]", word) for word in words)
    return has_letters and not any(is_in(words, table, key) for table, key in tables)


def _unit_text(name: str) -> str:
    """Return the unit in a name, as its words have it; empty for none."""
    name = _LABEL.sub("", name)
    bracketed = _BRACKETED.findall(name)
    behind = re.findall(r"(?:\bin |, ?| / )(\S+)$", name)
    words = [word for word in re.split(r"[\s_.]+", name) if word != "per"]
    bare = _BRACKETED.sub(" ", name)
    inner = [word for word in _HIGHER.sub("_", bare).split("_") if len(word) > 2]
    others = [
        word for word in ("/".join(words[-2:]), *reversed(words[1:]), *inner) if len(word) > 1
    ]
    return next((text for text in (*bracketed, *behind, *others) if unit_named(text)), "")


def without_unit(name: str) -> str:
    """Return a name without the words of its unit, of which "min" would be a minimum."""
    words = map(re.escape, _unit_text(name).split("/"))
    return re.sub(r"[\s_/]+(?:per[\s_]+)?".join(words) + r"(?![^\W_])", " ", name)


@lru_cache(2**16)
def meaning_of(name: str, unit: str = "") -> Meaning:
    """Return meaning of a name, with what stands beside it as a unit."""
    words = words_of(without_unit(name))
    quantities = list(_quantities(words, name))
    known_unit = unit_named(unit) or unit_named(_unit_text(name))
    is_of_oil = not quantities and is_in(words, "preferred", "oil_temperature")
    if known_unit is None and (is_of_oil or "temperature" in quantities):
        last = next((word for word in reversed(words) if not is_in([word], "column", "part")), "")
        known_unit = unit_named(last) if last in ("c", "f", "k") else None
    stated = QUANTITY_OF.get(known_unit or "")
    known_unit = None if unread_unit(name, unit) else known_unit
    if stated is not None and quantities and stated not in quantities:
        return Meaning(None, known_unit)
    quantity = stated or next(iter(quantities), None)
    if quantity is None or is_in(words, "other", quantity) or is_in(words, "other", "none"):
        return Meaning(None, known_unit)
    if quantity == "pressure":
        role = _role(words, name)
        return Meaning(role or "pressure_difference", known_unit, 0 if role else -1)
    channel = CHANNEL_OF[quantity]
    return Meaning(channel, known_unit, int(is_in(words, "preferred", channel)))


def _quantities(words: Sequence[str], name: str) -> Iterator[str]:
    """Return quantities that words name; by a tag's code or a lone letter where no word does."""
    quantities = [
        quantity for quantity in VOCABULARY["quantity"] if is_in(words, "quantity", quantity)
    ]
    if not quantities:
        quantities = ["pressure" if key == "difference" else key for key in _codes(name)]
    if not quantities and len(words) <= _LONGEST_WITH_A_LETTER:
        quantities = [
            key for word in words for key in VOCABULARY["letter"] if is_in([word], "letter", key)
        ]
    return iter(quantities)


def _codes(name: str) -> list[str]:
    return [
        key
        for key, codes in VOCABULARY["code"].items()
        if re.search(rf"(?<![a-z])(?:{'|'.join(codes.split())})[-_ ]?\d", name.lower())
    ]


def _role(words: Sequence[str], name: str) -> str | None:
    """Return channel of a pressure; None: its name does not say whose it is."""
    if "difference" in _codes(name):
        return "pressure_difference"
    # A letter is that of a port only behind a word for port or pressure.
    behind = {
        second
        for first, second in pairwise((*words, *words[:1]))
        if first == "p" or is_in([first], "quantity", "pressure")
    }
    marks = [word for word in words if word not in _PORT_WORDS or word in behind]
    return next((role for role in VOCABULARY["role"] if is_in(marks, "role", role)), None)


def likely_units(
    channel: str, values: Iterable[float], usual: tuple[float, float] | None = None
) -> tuple[str, ...]:
    """Return units in which readings are usual, by default such as a motor at work shows.

    The commonest are first.
    """
    magnitudes = sorted(map(abs, values))
    quantity = QUANTITIES[channel]
    low, high = usual or (_USUAL_LOW_SIDE if channel in LOW_SIDE else USUAL[quantity])
    typical = magnitudes[(3 * len(magnitudes)) // 4] if magnitudes else float("nan")
    common = ("bar", "MPa", "kPa", "psi", "degC", "rpm", "l/min", "ml/min", "m3/h")
    units = sorted(UNITS[quantity], key=lambda unit: unit not in common)
    return tuple(
        unit for unit in units if low <= float(to_canonical(channel, typical, unit)) <= high
    )


def missing_channels(channels: Collection[str]) -> list[str]:
    """Return channels that a motor has to have, besides those that it has."""
    ports = [name for name in PORT_PRESSURES if name not in channels]
    if "pressure_difference" in channels:
        ports = []
    elif len(ports) == len(PORT_PRESSURES):
        ports = ["pressure_difference"]
    return [*ports, *(name for name in CHANNEL_OF.values() if name not in channels)]


@dataclass(frozen=True, slots=True)
class Group:
    """Names of a motor; `name` is what they share, and `signals` the rest of each."""

    name: str
    signals: dict[str, str]  # by whole name


def groups_of(names: Sequence[str], units: Mapping[str, str]) -> tuple[list[Group], list[str]]:
    """Return names by motor, and those that are no motor's.

    A group is the longest common part behind which the most channels stand, each once. Names that
    share nothing are one motor's, called nothing.
    """
    left, groups = list(names), list[Group]()
    while True:
        best = max(_candidates(left), key=lambda candidate: _fit(candidate, units), default=None)
        if best is None or _fit(best, units)[0] < FEWEST_CHANNELS:
            return groups, left
        groups.append(best)
        left = [name for name in left if name not in best.signals]


def _candidates(names: Sequence[str]) -> Iterator[Group]:
    yield Group("", {name: name for name in names})
    # Marks between words may differ from tag to tag of a motor.
    parts: dict[tuple[str, bool], dict[str, str]] = {}
    spelled: dict[tuple[str, bool], Counter[str]] = {}
    for source in names:
        # Of labels as of Prometheus, {motor="W1"}, the values name a motor.
        name = _LABEL.sub(r" \1", source)
        hidden = _BRACKETED.sub(lambda match: "x" * len(match[0]), name)
        for begin, end in (mark.span() for mark in _MARK.finditer(hidden)):
            # What stands behind is the motor's as far as no unit follows.
            tail = _BRACKETED.sub("", name[end:]).strip()
            unit = name[end:].removeprefix(tail)
            for text, is_head, rest in (
                (name[:begin], True, name[end:]),
                (tail, False, name[:begin] + unit),
            ):
                key = _MARK.sub(".", text), is_head
                parts.setdefault(key, {})[source] = rest
                spelled.setdefault(key, Counter())[text] += 1
    for (path, is_head), signals in parts.items():
        name = spelled[path, is_head].most_common(1)[0][0]
        words = words_of(name)
        ends_path = not is_head and all(
            is_in([word], "column", "part") or word.isdigit() for word in words
        )
        is_statistic = all(is_in([word], "column", "statistic") for word in words)
        if name and not (ends_path or is_statistic) and len(signals) >= FEWEST_CHANNELS:
            yield Group(name, signals)


def _fit(group: Group, units: Mapping[str, str]) -> tuple[int, int]:
    """Return channels named once less those named again, then the length of what is common."""
    channels = (
        meaning_of(signal, units.get(name, "")).channel for name, signal in group.signals.items()
    )
    counts = Counter(channel for channel in channels if channel)
    return 2 * len(counts) - counts.total(), len(group.name)
