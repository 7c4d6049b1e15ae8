"""Reference pages `docs/config.md` and `docs/tables.md`, made from the code.

``python -m pipeline.cli.reference docs`` writes them. With ``--check`` nothing is written:
pages that are out of date are named on stderr, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import polars as pl
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import ModelSchema

from pipeline.config import MotorFile, Settings
from pipeline.config.channels import FALLBACK_VALID_RANGE
from pipeline.config.motor_types import MotorTypeFile, OilFile
from pipeline.config.oil_samples import OilCircuitFile
from pipeline.config.section import Section
from pipeline.config.settings import FleetFile
from pipeline.schema import (
    LOOKS,
    NIGHT_TABLES,
    QUALITY,
    QUALITY_REASONS,
    SCHEMA_VERSION,
    TABLES,
    TREND_TABLES,
    WHOLE_TABLES,
    Table,
    data_dictionary,
)
from pipeline.store.tables import table_folder
from pipeline.units import CHANNELS, QUANTITIES, UNITS, canonical_unit

Schema = Mapping[str, Any]

NOTE: Final = "<!-- Made by `make docs` from the code; edit that, not this page. -->"
FILES: Final[Mapping[str, type[Section]]] = {
    "fleet.toml": FleetFile,
    "motor_types/<name>.toml": MotorTypeFile,
    "oils/<name>.toml": OilFile,
    "motors/<name>.toml": MotorFile,
    "oil_circuits/<name>.toml": OilCircuitFile,
}
LIMITS: Final[Mapping[str, str]] = {
    "minimum": ">=",
    "exclusiveMinimum": ">",
    "maximum": "<=",
    "exclusiveMaximum": "<",
}
KINDS: Final[Mapping[str, str]] = {
    "boolean": "true or false",
    "integer": "whole number",
    "number": "number",
    "object": "table",
    "string": "text",
}


class WithMeanings(GenerateJsonSchema):
    """Schema of a model in which each key is described by the text below it."""

    def model_schema(self, schema: ModelSchema) -> JsonSchemaValue:
        """Schema of a model, or of one below it."""
        found = super().model_schema(schema)
        for name, words in _meanings(schema["cls"]).items():
            found["properties"][name]["description"] = words
        return found


def _meanings(model: type) -> dict[str, str]:
    """Texts below the keys of a model and of its bases."""
    if model is Section:
        return {}
    found = {name: words for base in model.__bases__ for name, words in _meanings(base).items()}
    (definition,) = ast.parse(inspect.getsource(model)).body
    assert isinstance(definition, ast.ClassDef)
    for key, text in pairwise(definition.body):
        match key, text:
            case ast.AnnAssign(ast.Name(name)), ast.Expr(ast.Constant(str(words))):
                found[name] = words.removesuffix(".")
    return found


def config_reference() -> str:
    """The page `config.md`: every key of every config file, from the models that read them."""
    lines = [
        "# Config files",
        NOTE,
        "Config is TOML. A fleet file names the folders in which motors, motor types, oils and oil "
        "circuits lie, one file each; a file's name without its ending is the name by which others "
        "call it. A key that is not listed here is an error, and so is a value of another type; "
        "the end of a key's name is its unit. `motor-leakage check` reports every fault of every "
        "file at once.",
        "A whole fleet as an example lies in [docs/example/](example/fleet.toml).",
    ]
    for file, model in FILES.items():
        schema = model.model_json_schema(schema_generator=WithMeanings)
        lines += [f"## `{file}`", *_model_lines(schema)]
        if model is MotorFile:
            lines += [*_channel_lines(), *_override_lines()]
    return "\n\n".join(lines) + "\n"


def table_reference() -> str:
    """The page `tables.md`: every column of every table, from `pipeline.schema`."""
    lines = [
        "# Tables",
        NOTE,
        f"Schema version {SCHEMA_VERSION}. All tables are Parquet below `<output>/tables/`, where "
        "`<output>` is `out` in the folder from which the run was started, unless the config or "
        "`--output` says otherwise. Rows are sorted by night and key, and no two share a key. "
        "Times are UTC. Null means that there is no such figure, never 0. The table "
        "`data_dictionary` holds what this page says. A month is one file, "
        "`month=YYYY-MM/YYYY-MM.parquet`; of `predictions`, `block_statistics` and "
        "`residual_tests` a night is one, `month=YYYY-MM/YYYY-MM-DD.parquet` "
        "([operations.md](operations.md#months)).",
        "Columns are added at the end and never removed, renamed or given another meaning. Files "
        "that an older version wrote lack what came later: have a reader match columns by name. "
        "[queries.md](queries.md) does so for DuckDB, Polars and pandas and answers common "
        "questions; [powerbi.md](powerbi.md) is for Power BI; `motor-leakage export` writes CSV "
        "([operations.md](operations.md)). The last column names what some readers cannot hold.",
        _grid(("Table", "One row is", "Columns that are lists"), map(_index_row, TABLES)),
    ]
    columns = data_dictionary()
    for table in TABLES:
        rows = columns.filter(pl.col("table") == table.name).iter_rows(named=True)
        lines += [
            f"## {table.name}",
            f"One row is {table.row}. Key: {', '.join(f'`{name}`' for name in table.key)}. "
            f"File: `{_place(table)}`.",
            _grid(
                ("Column", "Type", "Unit", "Meaning"),
                (
                    (f"`{row['column']}`", _short(row["type"]), row["unit"], row["description"])
                    for row in rows
                ),
            ),
        ]
        if table is QUALITY:
            reasons = (f"- `{name}`: {one.meaning}." for name, one in QUALITY_REASONS.items())
            lines += ["What each reason refuses:", "\n".join(reasons)]
    return "\n\n".join(lines) + "\n"


PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "config.md": config_reference,
    "tables.md": table_reference,
}


def _index_row(table: Table) -> Sequence[str]:
    lists = [name for name, kind in table.schema.items() if isinstance(kind, pl.List)]
    return f"[{table.name}](#{table.name})", table.row, ", ".join(f"`{name}`" for name in lists)


def _place(table: Table) -> str:
    folder = table_folder(Path("<output>"), table).as_posix()
    if table in WHOLE_TABLES:
        return f"{folder}/{table.name}.parquet"
    name = "<night>" if table in (*NIGHT_TABLES, *TREND_TABLES) else "<start of the run>"
    if table is LOOKS:
        name = "looks-<day>"
    return f"{folder}/month=YYYY-MM/{name}.parquet"


def _short(kind: str) -> str:
    """A column's type; all times are of one kind."""
    return "Datetime" if kind.startswith("Datetime") else kind


def _grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    cells = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in cells
    )


def _model_lines(schema: Schema) -> Iterator[str]:
    """A file's own keys first, then a part for each of its tables."""
    tables = {name: list(_tables(name, field, schema)) for name, field in _fields(schema).items()}
    own = [name for name, parts in tables.items() if not parts]
    if own:
        yield _key_grid(
            {**schema, "properties": {name: _fields(schema)[name] for name in own}}, schema
        )
    for heading, prefix, part in (one for parts in tables.values() for one in parts):
        yield f"### {heading}"
        yield _paragraph(part["description"])
        yield _key_grid(part, schema, prefix)


def _tables(name: str, field: Schema, root: Schema) -> Iterator[tuple[str, str, Schema]]:
    """Heading, prefix of its keys, and schema of each kind of TOML table that a key can hold."""
    target = _resolved(field, root)
    named, items = target.get("additionalProperties"), _resolved(target.get("items", {}), root)
    if "properties" in target:
        yield f"`[{name}]`", f"{name}.", target
    elif isinstance(named, Mapping):
        yield f"`[{name}.<name>]`", f"{name}.<name>.", _resolved(named, root)
    elif "oneOf" in items:
        tag = items["discriminator"]["propertyName"]
        for one in (_resolved(option, root) for option in items["oneOf"]):
            yield f'`[[{name}]]` with `{tag} = "{_fields(one)[tag]["const"]}"`', f"{name}.", one
    elif "properties" in items:
        yield f"`[[{name}]]`", f"{name}.", items


def _key_grid(part: Schema, root: Schema, prefix: str = "") -> str:
    return _grid(("Key", "Type", "Default", "Meaning"), _key_rows(part, root, prefix))


def _key_rows(part: Schema, root: Schema, prefix: str) -> Iterator[Sequence[str]]:
    for name, field in _fields(part).items():
        target = _resolved(field, root)
        yield (
            f"`{prefix}{name}`",
            _kind(target, root),
            "required" if name in part.get("required", ()) else _default(field, target),
            _paragraph(field.get("description") or target["description"]),
        )
        if "properties" in target:
            yield from _key_rows(target, root, f"{prefix}{name}.")


def _kind(field: Schema, root: Schema) -> str:
    if "enum" in field or "const" in field:
        return " or ".join(f'`"{value}"`' for value in field.get("enum", [field.get("const")]))
    if "prefixItems" in field:
        return f"[{', '.join(_kind(_resolved(one, root), root) for one in field['prefixItems'])}]"
    if field.get("type") == "array":
        kinds = [_kind(_resolved(one, root), root) for one in _options(field["items"])]
        return f"list of {', '.join(kinds)}"
    if isinstance(field.get("additionalProperties"), Mapping):
        return f"table of {_kind(field['additionalProperties'], root)}"
    if "pattern" in field:
        return f"text as `{field['pattern']}`"
    # An exclusive limit takes the place of an inclusive one on the same side.
    limits = {sign[:1]: f"{sign} {field[key]:g}" for key, sign in LIMITS.items() if key in field}
    kind = "date" if field.get("format") == "date" else KINDS[field["type"]]
    return f"{kind} {', '.join(limits.values())}".strip()


def _default(field: Schema, target: Schema) -> str:
    """The default; nothing for a table, whose keys have theirs."""
    value = field.get("default")
    if "default" not in field or (value == {} and "properties" in target):
        return ""
    return "none" if value is None else f"`{json.dumps(value, ensure_ascii=False)}`"


def _fields(schema: Schema) -> Mapping[str, Schema]:
    fields: Mapping[str, Schema] = schema["properties"]
    return fields


def _resolved(field: Schema, root: Schema) -> Schema:
    """Type of a field without references and "or null"; a table has its own words."""
    options = [one for one in field.get("anyOf", ()) if one.get("type") != "null"]
    plain: Schema = {**field, **options[0]} if options else field
    reference = plain.get("$ref", "").rpartition("/")[2]
    return {**plain, **root["$defs"][reference]} if reference else plain


def _options(items: Schema) -> Sequence[Schema]:
    """Type of an element of a list."""
    options: Sequence[Schema] = items.get("anyOf", [items])
    return options


def _paragraph(text: str) -> str:
    return " ".join(text.split())


def _channel_lines() -> Iterator[str]:
    yield "### Channels, their units in a log, and their usual valid ranges"
    yield _grid(
        ("Channel", "Units", "Valid range unless stated"),
        (
            (
                f"`{name}`",
                ", ".join(f"`{unit}`" for unit in UNITS[QUANTITIES[name]]),
                " to ".join(f"{end:g}" for end in FALLBACK_VALID_RANGE[name])
                + f" {canonical_unit(name)}",
            )
            for name in CHANNELS
        ),
    )


def _override_lines() -> Iterator[str]:
    sections = ", ".join(f"`{name}`" for name in Settings.model_fields)
    yield "### `[override.<section>]`"
    yield (
        f"Sections that a motor may override: {sections}. Keys as in the fleet file; those that "
        "are not named keep the fleet's value."
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the pages into a folder, or check that those in it are what the code says."""
    parser = argparse.ArgumentParser(prog="python -m pipeline.cli.reference", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the pages, such as docs")
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    options = parser.parse_args(arguments)
    paths = {options.folder / name: page() for name, page in PAGES.items()}
    if not options.check:
        for path, text in paths.items():
            path.write_text(text, "utf-8")
        return
    stale = [
        path.as_posix()
        for path, text in paths.items()
        if not path.is_file() or path.read_text("utf-8") != text
    ]
    if stale:
        parser.exit(1, f"{', '.join(stale)}: out of date; run `make docs`\n")


if __name__ == "__main__":
    main()
