"""What a cell or a name in a log seems to be."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial

from pipeline.ingest.time_stamps import EPOCH_UNITS, EXCEL_DAYS
from pipeline.units import QUANTITIES, UNITS

_NUMBER = re.compile(r"^[+-]?\d[\d.,' \u00a0\u202f]*([eE][+-]?\d+)?$")
_TIME_NAME = re.compile(
    r"(?i)^(date.?time|time.?stamp|time|zeit(stempel)?|datum.*|date|tid|ts|t)\b"
)
_FORMATS = (
    "%d.%m.%Y %H:%M:%S",
    "%d/%m/%Y %H:%M:%S",
    "%m/%d/%Y %H:%M:%S",
    "%m/%d/%Y %I:%M:%S %p",
    "%d-%m-%Y %H:%M:%S",
    "%Y/%m/%d %H:%M:%S",
    "%d-%b-%Y %H:%M:%S",
    "%d.%m.%y %H:%M:%S",
    "%d.%m.%Y %H:%M",
    "%m/%d/%Y %H:%M",
)
_CHANNEL_NAMES = (
    ("charge_pressure", r"charge|feed.?press|speisedruck"),
    ("case_pressure", r"case.?press|geh.usedruck"),
    ("pressure_difference", r"^d_?p\b|dp_|delta.?p|diff|Δ\s*p"),
    ("high_port_pressure", r"high|p_?a\b|port.?a\b"),
    ("low_port_pressure", r"low.?p|p_?b\b|port.?b\b"),
    ("oil_temperature", r"temp|^t_?oil|oil.?t\b|°c|degc"),
    ("speed", r"speed|rpm|drehzahl|varvtal|^n\b|1/min"),
    ("leakage_flow", r"flow|leak|drain|leck|^q\b|l/min"),
    ("pressure_difference", r"press|druck|tryck|\bbar\b"),
)
_UNIT_NAMES = {
    "°c": "degC",
    "c": "degC",
    "oc": "degC",
    "°f": "degF",
    "f": "degF",
    "1/min": "rpm",
    "min-1": "rpm",
    "lpm": "l/min",
    "m³/h": "m3/h",
    "gpm": "us_gal/min",
    "u/min": "rpm",
    "r/min": "rpm",
}
_SECONDS = {"epoch_s": 1e9, "epoch_ms": 1e12, "epoch_us": 1e15, "epoch_ns": 1e18}


def is_number(cell: str) -> bool:
    """Whether a cell is a number in some dialect.

    Examples
    --------
    >>> [is_number(cell) for cell in ("-1.234,5", "1e-3", "bar", "12.03.2025 06:00")]
    [True, True, False, False]
    """
    return bool(_NUMBER.match(cell))


def is_time_name(name: str) -> bool:
    """Whether a column's name is that of a time."""
    return bool(_TIME_NAME.match(name.strip()))


def channel_of(name: str) -> str | None:
    """Channel that a column's name seems to mean; None: none.

    Examples
    --------
    >>> channel_of("drain_flow [l/min]"), channel_of("operator")
    ('leakage_flow', None)
    """
    low = name.lower()
    return next((c for c, pattern in _CHANNEL_NAMES if re.search(pattern, low)), None)


def unit_of(channel: str, text: str) -> str | None:
    """Unit of a channel that a text such as ``p [kPa]`` or ``dp_bar`` names; None: none.

    Examples
    --------
    >>> unit_of("pressure_difference", "dp [kPa]"), unit_of("oil_temperature", "°C")
    ('kPa', 'degC')
    """
    known = {unit.lower(): unit for unit in UNITS[QUANTITIES[channel]]}
    named = {name: unit for name, unit in _UNIT_NAMES.items() if unit.lower() in known}
    parts = [text, *re.findall(r"[\[(]([^\])]+)[\])]", text), *re.split(r"[\s_]+", text)]
    for part in parts:
        low = part.strip().strip("[]()").lower()
        if low in known or low in named:
            return known.get(low) or named[low]
    return None


def decimal_and_thousands(cells: Sequence[str], separator: str) -> tuple[str, str]:
    """Decimal mark and mark between thousands that numbers seem to have.

    Examples
    --------
    >>> decimal_and_thousands(["1.234,5", "7,25"], ";")
    (',', '.')
    >>> decimal_and_thousands(["1234.5", "7.25"], ",")
    ('.', '')
    """
    numbers = [cell for cell in cells if is_number(cell)]
    both = [cell for cell in numbers if "," in cell and "." in cell]
    if both:
        decimal = "," if both[0].rfind(",") > both[0].rfind(".") else "."
        return decimal, "." if decimal == "," else ","
    commas = sum("," in cell for cell in numbers)
    decimal = "," if commas > sum("." in cell for cell in numbers) and separator != "," else "."
    spaced = [re.search(r"\d(['\u00a0\u202f ])\d{3}\b", cell) for cell in numbers]
    return decimal, next((found[1] for found in spaced if found), "")


def time_format_of(stamps: Sequence[str], decimal: str) -> str | None:
    """Format that all stamps have; None: none of those known.

    Examples
    --------
    >>> time_format_of(["13.02.2025 06:00:00,5"], ",")
    '%d.%m.%Y %H:%M:%S,%f'
    """
    if not stamps:
        return None
    plain = [stamp.replace(decimal, ".") for stamp in stamps]
    if all(re.fullmatch(r"\d+(\.\d*)?", stamp) for stamp in plain):
        # Eight digits may be a date, in ISO 8601 too; more are a count.
        return _numeric_format(list(map(float, plain)))
    if _all_read(stamps, datetime.fromisoformat):
        return "iso8601"
    for known in _FORMATS:
        for form in (known, known.replace("%S", "%S.%f"), known.replace("%S", "%S,%f")):
            if _all_read(stamps, partial(_parsed, form)):
                return form
    return None


def _numeric_format(numbers: Sequence[float]) -> str | None:
    first = numbers[0]
    if 3e4 < first < 8e4:
        return EXCEL_DAYS
    fitting = (form for form in EPOCH_UNITS if 0.6 < first / _SECONDS[form] < 7.0)
    return next(fitting, None)


def _parsed(form: str, stamp: str) -> datetime:
    return datetime.strptime(stamp, form)


def _all_read(stamps: Sequence[str], parse: Callable[[str], datetime]) -> bool:
    try:
        for stamp in stamps:
            parse(stamp)
    except ValueError:
        return False
    return True
