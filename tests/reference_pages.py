"""Reference pages `docs/config.md` and `docs/tables.md`, made from the code.

``python -m tests.reference_pages docs`` writes them. With ``--check`` nothing is written:
pages that are out of date are named on stderr, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import ast
import datetime as dt
import inspect
import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_origin

from pydantic import AwareDatetime
from pydantic.fields import FieldInfo

from pipeline.config import MotorFile, Settings
from pipeline.config.motor_types import MotorTypeFile, OilCircuitFile, OilFile, PathSection, Unknown
from pipeline.config.section import Section
from pipeline.config.settings import FleetFile
from pipeline.schema import (
    LATEST,
    NIGHTLY_TABLES,
    NIGHTS,
    QUALITY,
    QUALITY_REASONS,
    SCHEMA_VERSION,
    TABLES,
    TYPES,
    WHOLE_TABLES,
    Column,
    Table,
)
from pipeline.units import CHANNELS, FALLBACK_VALID_RANGE, QUANTITIES, UNITS, canonical_unit

NOTE: Final = "<!-- Made by `make docs` from the code; edit that, not this page. -->"
FILES: Final[Mapping[str, type[Section]]] = {
    "fleet.toml": FleetFile,
    "motor_types/<name>.toml": MotorTypeFile,
    "oils/<name>.toml": OilFile,
    "motors/<name>.toml": MotorFile,
    "oil_circuits/<name>.toml": OilCircuitFile,
}
KINDS: Final[Mapping[Any, str]] = {
    str: "text",
    float: "number",
    int: "count",
    bool: "flag",
    dt.date: "day",
    AwareDatetime: "moment",
}
UNIT_IN_NAME: Final = ("_percent", "_per_min", "_bar", "_c", "_rpm", "_s", "_hours", "_mib")
# A column with the same type, unit and meaning in so many tables is described once.
MANY: Final = 3


def config_reference() -> str:
    """The page `config.md`: every key of every config file, from the models that read them."""
    lines = [
        "# Config files",
        NOTE,
        "Config is TOML. Beside a fleet file lie the folders `motors`, `motor_types`, `oils` and "
        "`oil_circuits`; others call a file in them by its name without the ending. Behind a key "
        "is its default, which shows its type; the end of its name is its unit. Other keys are "
        "errors. A whole fleet lies in [docs/example/](example/fleet.toml).",
    ]
    for file, model in FILES.items():
        fields = model.model_fields.items()
        own = {name: field for name, field in fields if not any(_sections(field.annotation))}
        lines += [f"## `{file}`", "\n".join(_key_lines(model, own))]
        for name, field in fields:
            for heading, words, table, keys in _tables(name, field):
                text = "\n".join(_key_lines(table, keys))
                known = "Keys as above." if text in lines else text
                lines += [f"### `{heading}`", words, known]
        if model is MotorFile:
            lines += [_channel_lines(), "### `[override.<section>]`", _overrides()]
    return "\n\n".join(filter(None, lines)) + "\n"


def _sections(annotation: Any) -> Iterator[type[Section]]:
    """Kinds of TOML table that a key of a type can hold."""
    if inspect.isclass(annotation) and issubclass(annotation, Section):
        yield annotation
    for part in get_args(annotation):
        yield from _sections(part)


def _tables(
    name: str, field: FieldInfo
) -> Iterator[tuple[str, str, type[Section], Mapping[str, FieldInfo]]]:
    """Heading, words, model and keys of the tables of a key; first what all of several have."""
    tables = list(_sections(field.annotation))
    headings: dict[Any, str] = {tuple: f"[[{name}]]", dict: f"[{name}.<name>]"}
    heading = headings.get(get_origin(field.annotation), f"[{name}]")
    if len(tables) < 2:
        for table in tables:
            yield heading, _words(table), table, table.model_fields
            for key, inner in table.model_fields.items():
                yield from _tables(f"{name}.{key}", inner) if _has_heading(inner) else ()
        return
    words = (
        "Keys of all; `law` says which a path has besides. A key with four defaults is a table of "
        "`value` (where not `fixed`, the first starting point), `minimum`, `maximum` and `fixed`."
    )
    yield heading, words, PathSection, PathSection.model_fields
    for table in tables:
        known = {*PathSection.model_fields, "law"}
        own = {key: field for key, field in table.model_fields.items() if key not in known}
        (law,) = get_args(table.model_fields["law"].annotation)
        yield f'{heading} with law = "{law}"', _words(table), table, own


def _has_heading(field: FieldInfo) -> bool:
    """Whether a key is a table that a file gives a heading, which a parameter is not."""
    return any(not issubclass(table, Unknown) for table in _sections(field.annotation))


def _key_lines(model: type[Section], fields: Mapping[str, FieldInfo]) -> Iterator[str]:
    """A line on each key but tables with a heading."""
    meanings = _meanings(model)
    for name, field in fields.items():
        if _has_heading(field):
            continue
        table = next(_sections(field.annotation), Section)
        words = meanings.get(name) or _words(table)
        words = " ".join(words.split()).removesuffix(".")
        how = [f"`{text}`"] if (text := _default(field, table)) else [_kind(field.annotation)]
        named = ["", field.default, *words.split("`")]
        choices = [f"`{choice}`" for choice in _choices(field.annotation) if choice not in named]
        how += [" ".join(choices)] * bool(choices)
        how += ["required"] * field.is_required()
        yield f"- `{name}` ({', '.join(how)}): {words}"


def _meanings(model: type) -> dict[str, str]:
    """Texts below the keys of a model and of its bases."""
    if model is Section:
        return {}
    found = {name: words for base in model.__bases__ for name, words in _meanings(base).items()}
    (definition,) = ast.parse(inspect.getsource(model)).body
    assert isinstance(definition, ast.ClassDef)
    for key, text in pairwise(definition.body):
        match key, text:
            case [ast.AnnAssign(ast.Name(name)), ast.Expr(ast.Constant(str(words)))]:
                found[name] = words
    return found


def _default(field: FieldInfo, table: type[Section]) -> str:
    """The default as in TOML; of a parameter, value, bounds and whether it is fixed."""
    value = field.get_default()
    if issubclass(table, Unknown):
        values = [field.get_default() for field in table.model_fields.values()]
        return "" if field.is_required() else json.dumps(values)[1:-1]
    nothing = field.is_required() or value is None or value in ("", {}, ())
    return "" if nothing else json.dumps(value, ensure_ascii=False)


def _kind(annotation: Any) -> str:
    """A type in words."""
    kind, parts = get_origin(annotation), [part for part in get_args(annotation) if part]
    if kind is tuple and Ellipsis in parts:
        return f"list of {_kind(parts[0])}"
    if kind is tuple:
        return f"[{', '.join(map(_kind, parts))}]"
    if kind in (dict, Mapping) or annotation in _sections(annotation):
        return "table"
    if kind is Literal:
        return "text"
    return _kind(parts[0]) if parts else KINDS[annotation]


def _choices(annotation: Any) -> Sequence[str]:
    """Values that a key, or an element of its list, can have, where they are listed."""
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return [choice for part in get_args(annotation) for choice in _choices(part)]


def _words(table: type[Section]) -> str:
    return " ".join((table.__doc__ or "").split())


def _channel_lines() -> str:
    """Units of each quantity in a log, and the valid ranges of its channels unless stated."""
    lines = ["Units in a log, and the usual valid range of a channel:\n"]
    for quantity, units in UNITS.items():
        ranges = []
        for name in (channel for channel in CHANNELS if QUANTITIES[channel] == quantity):
            low, high = FALLBACK_VALID_RANGE[name]
            ranges.append(f"`{name}` {low:g} to {high:g} {canonical_unit(name)}")
        lines.append(f"- {' '.join(f'`{unit}`' for unit in units)}: {', '.join(ranges)}")
    return "\n".join(lines)


def _overrides() -> str:
    names = ", ".join(f"`{name}`" for name in Settings.model_fields)
    return f"Sections that a motor may override: {names}. Other keys keep the fleet's value."


def table_reference() -> str:
    """The page `tables.md`: every column of every table, from `pipeline.schema`."""
    every = [column for table in TABLES for column in table.columns]
    common = [text for text, n in Counter(every).items() if n >= MANY]
    lines = [
        "# Tables",
        NOTE,
        f"Schema version {SCHEMA_VERSION}. All tables are Parquet below `<output>/tables/`. "
        f"{_list(WHOLE_TABLES)} are a file each, such as `latest/latest.parquet`. Of the others a "
        "month is one file, such as `fits/month=2026-03/2026-03.parquet`; of "
        f"{_list(NIGHTLY_TABLES)} a night is one, such as "
        "`predictions/month=2026-03/2026-03-01.parquet` "
        "([operations](operations.md#what-a-run-leaves-behind)). "
        "Rows are sorted by night and key, and no two share a key. Times are UTC. Null means that "
        "there is no such figure, never 0. From the first release on columns are added and never "
        "removed, renamed or given another meaning: have a reader match them by name "
        "([queries.md](queries.md)).",
        "A column without a type is a number. Its unit stands behind the type, unless its name "
        "ends on it. Relative figures are in percent; `_lower` and `_upper` are the ends of an "
        "interval in the unit of their figure. These columns are of several tables:",
        "\n".join(map(_shared_line, common)),
    ]
    for table in TABLES:
        key = ", ".join(f"`{name}`" for name in table.key)
        lines += [f"## {table.name}", f"One row is {table.row}. Key: {key}."]
        if table is LATEST:
            lines.append("The columns of `nights`, and:")
        own = [column for column in table.columns if column not in common]
        own = [column for column in own if table is not LATEST or column not in NIGHTS.columns]
        for group, columns in groupby(own, lambda column: column.group):
            lines += [f"*{group}*"] * bool(group) + [_column_lines(list(columns))]
        if table is QUALITY:
            reasons = (f"- `{name}`: {reason.meaning}." for name, reason in QUALITY_REASONS.items())
            lines += ["What each reason refuses:", "\n".join(reasons)]
    return "\n\n".join(filter(None, lines)) + "\n"


def _shared_line(column: Column) -> str:
    return f"{_column_lines([column])}; in {_list(one for one in TABLES if column in one.columns)}"


def _list(tables: Iterable[Table]) -> str:
    return ", ".join(f"`{table.name}`" for table in tables)


def _column_lines(columns: Sequence[Column]) -> str:
    """A line on each column, or on several that mean the same."""
    kinds = {str(kind): word for word, kind in TYPES.items()} | {"Float64": ""}
    alike: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for column in columns:
        unit = (
            "" if column.name.endswith(UNIT_IN_NAME) or column.unit in ("1", "UTC") else column.unit
        )
        how = ", ".join(filter(None, (kinds[str(column.type)], unit)))
        alike[how and f" ({how})", column.description].append(f"`{column.name}`")
    return "\n".join(f"- {', '.join(names)}{how}: {words}" for (how, words), names in alike.items())


PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "config.md": config_reference,
    "tables.md": table_reference,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the pages into a folder, or check that those in it are what the code says."""
    parser = argparse.ArgumentParser(prog="python -m tests.reference_pages", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the pages, such as docs")
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    options = parser.parse_args(arguments)
    stale = []
    for name, page in PAGES.items():
        path, text = options.folder / name, page()
        if not options.check:
            path.write_text(text, "utf-8")
        elif not path.is_file() or path.read_text("utf-8") != text:
            stale.append(path.as_posix())
    if stale:
        parser.exit(1, f"{', '.join(stale)}: out of date; run `make docs`\n")


if __name__ == "__main__":
    main()
