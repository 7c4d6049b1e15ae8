"""Tables and columns that `docs/powerbi.md` relies on; Power BI itself cannot be run here."""

from __future__ import annotations

import re
from pathlib import Path

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.schema import FITS, NIGHT_TABLES, PARAMETERS, QUALITY, TABLES, Table, data_dictionary
from pipeline.store.tables import table_folder

PAGE = (Path(__file__).parents[1] / "docs" / "powerbi.md").read_text("utf-8")
CODE = {
    found[1]: found[2]
    for found in re.finditer(r"^```powerquery\n// (\w+)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
}
COLUMNS = {table.name: set(table.schema) for table in TABLES}
# Of Folder.Files, and those that the code makes itself.
OTHER_COLUMNS = {"Content", "Extension", "Name", "Night", "fit", "motor_night", "night"}


def files(output: Path, table: Table) -> list[Path]:
    found = sorted(table_folder(output, table).rglob("*.parquet"))
    assert found or table not in (FITS, PARAMETERS, QUALITY)
    return found


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_published_files_have_the_types_that_are_stated(fitted_output: Path, table: Table) -> None:
    plain = {pl.String: pa.string(), pl.Int64: pa.int64(), pl.Float64: pa.float64()}
    plain |= {pl.Boolean: pa.bool_(), pl.Date: pa.date32()}
    plain |= {pl.Datetime: pa.timestamp("us", "UTC")}
    for path in files(fitted_output, table):
        schema = pq.read_schema(path)
        assert schema.names == list(table.schema)
        for name, kind in table.schema.items():
            found = schema.field(name).type
            if isinstance(kind, pl.List):
                assert pa.types.is_list(found)
            else:
                base = kind if isinstance(kind, type) else type(kind)
                assert found == plain[base], name


def test_code_knows_every_type_of_the_dictionary_but_lists() -> None:
    known = set(re.findall(r"(\w+) = (?:type \w+|Int64\.Type)", CODE["ReadTable"]))
    kinds = {kind.partition("(")[0] for kind in data_dictionary()["type"]}
    assert kinds - {"List"} == known
    stated = set(re.findall(r"^\| (\w+) \| .* \| .* \|$", PAGE, re.MULTILINE)) - {"In", "Many"}
    assert stated == kinds


def test_files_lie_where_the_code_looks(fitted_output: Path) -> None:
    (path,) = re.findall(r'TablesFolder & "(\\data_[^"]+)"', CODE["ReadTable"])
    assert (fitted_output / "tables" / path.replace("\\", "/").lstrip("/")).is_file()
    for table in NIGHT_TABLES:
        for file in files(fitted_output, table):
            assert re.fullmatch(r"\d{4}-\d\d(-\d\d)?\.parquet", file.name)
            assert file.parent.name == f"month={file.name[:7]}"


def test_names_in_the_code_exist() -> None:
    assert list(CODE) == [
        "TablesFolder", "RangeStart", "RangeEnd", "ReadTable", "fits", "parameters", "quality",
        "motors",
    ]  # fmt: skip
    for name, code in CODE.items():
        named = set(re.findall(r'ReadTable\("(\w+)"\)', code))
        assert named <= COLUMNS.keys()
        tables = named | ({"data_dictionary"} if name == "ReadTable" else {"fits"})
        known = OTHER_COLUMNS.union(*(COLUMNS[table] for table in tables))
        if name == "motors":
            known |= COLUMNS["fits"]
        used = set(re.findall(r"(?<=[ ({])\[(\w+)\]", code))
        used |= set(re.findall(r'(?<=[{ ])"([a-z]+_[a-z_]+)"', code))
        assert used <= known, (name, used - known)


def test_names_in_relationships_and_measures_exist() -> None:
    rest = re.sub(r"```powerquery.*?```", "", PAGE, flags=re.DOTALL)
    used = set(re.findall(r"\b(\w+)\[(\w+)\]", rest))
    assert len(used) > 10
    for table, column in used:
        assert column in COLUMNS.get(table, COLUMNS["fits"]) | OTHER_COLUMNS, (table, column)
    assert "K_piston_ring" in rest


def test_keys_of_relationships_are_unique_on_one_side(fitted_output: Path) -> None:
    def read(table: Table) -> pl.DataFrame:
        return pl.concat([pl.read_parquet(path) for path in files(fitted_output, table)])

    primary = read(FITS).filter("is_primary")
    assert primary.select("motor_id", "night").is_unique().all()
    for table in NIGHT_TABLES:
        key = ["motor_id", "night"]
        if "flushing_mode" in table.key:
            key.append("flushing_mode")
        if files(fitted_output, table):
            orphans = read(table).join(read(FITS), on=key, how="anti")
            assert orphans.height == 0, table.name
    assert read(QUALITY).height > primary.height
