"""Documentation agrees with the code: generated pages, examples, queries, codes."""

from __future__ import annotations

import ast
import datetime as dt
import re
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import duckdb
import polars as pl
import pytest

from pipeline.cli.reference import FILES, PAGES, main
from pipeline.config import load_fleet
from pipeline.config.faults import GONE
from pipeline.config.section import Section
from pipeline.demo import shipped_configs
from pipeline.schema import TABLES

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text("utf-8")
WRITTEN = ("model", "validation", "operations", "dependencies", "scale", "queries", "powerbi")
HAND_WRITTEN = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(DOCS / f"{name}.md" for name in WRITTEN),
]
SOURCES = [
    path for package in ("leakage", "pipeline") for path in sorted((ROOT / package).rglob("*.py"))
]


def blocks(text: str, language: str) -> list[str]:
    """Fenced blocks of a language, those within lists without their indent."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", text, re.MULTILINE | re.DOTALL)
    return [re.sub(f"^{indent}", "", body, flags=re.MULTILINE) for indent, body in found]


def first_cells(text: str) -> Iterator[str]:
    """First cells of all tables of a page, heads and rules left out."""
    for line in text.splitlines():
        if line.startswith("| ") and not line.startswith("| ---"):
            yield line.split("|")[1].strip()


@pytest.fixture
def after_a_run(fitted_output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which we are, with the tables of the demo in `out`."""
    (tmp_path / "out").symlink_to(fitted_output)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_written_pages_pass_the_check_and_so_do_those_of_the_docs(tmp_path: Path) -> None:
    main([str(tmp_path)])
    for folder in (tmp_path, DOCS):
        main(["--check", str(folder)])
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(PAGES)


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("change", ["changed", "absent"])
def test_check_names_the_page_that_is_out_of_date(
    name: str, change: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(tmp_path)])
    page = tmp_path / name
    text = page.read_text("utf-8")
    page.unlink()
    if change == "changed":
        page.write_text(text + "\n", "utf-8")
    with pytest.raises(SystemExit) as stopped:
        main(["--check", str(tmp_path)])
    assert stopped.value.code == 1
    message = capsys.readouterr().err
    assert message.startswith(page.as_posix())
    assert not any(other in message for other in PAGES if other != name)
    assert page.exists() == (change == "changed")


def test_every_key_of_every_model_is_on_the_page() -> None:
    listed = {cell.strip("`").split(".")[-1] for cell in first_cells(PAGES["config.md"]())}
    headings = set(re.findall(r"`\[+(\w+)", PAGES["config.md"]()))
    keys: set[str] = set()
    shipped = (one for one in _below(Section) if one.__module__.startswith("pipeline."))
    models = [*FILES.values(), *shipped]
    for model in models:
        keys |= model.model_fields.keys()
    assert keys - listed - headings == set()


def _below(model: type[Section]) -> Iterator[type[Section]]:
    for child in model.__subclasses__():
        yield child
        yield from _below(child)


# Stated in the design, not read off the page.
@pytest.mark.parametrize(
    ("key", "cells"),
    [
        ("cleaning.standstill_rpm", ["number >= 0", "`0.5`"]),
        ("cleaning.guard_after_s", ["number >= 0, <= 3.1536e+07", "`30.0`"]),
        ("nights.end_hour", ["whole number >= 0, <= 23", "`6`"]),
        ("windows.training_share", ["number > 0, < 1", "`0.8`"]),
        ("time_base.rate_hz", ["number > 0, <= 1000", "none"]),
        ("path.gap_um.minimum", ["number > 0", "`1.0`"]),
        ("path.radius_mm", ["number > 0", "required"]),
        ("reference_viscosities_mm2_per_s", ["[number > 0, number > 0]", "required"]),
        ("events.date", ["date", "required"]),
        ("flushing.also", ['list of `"none"` or `"fixed"` or `"estimated"`', "`[]`"]),
    ],
)
def test_key_has_its_type_and_default(key: str, cells: list[str]) -> None:
    row = next(line for line in PAGES["config.md"]().splitlines() if line.startswith(f"| `{key}` "))
    assert [cell.strip() for cell in row.split("|")[2:4]] == cells


def test_the_example_is_a_fleet() -> None:
    fleet = load_fleet(DOCS / "example" / "fleet.toml")
    (motor,) = fleet.motors
    assert {path.law for path in motor.motor_type.path} == {"annular_gap", "speed_curve", "laminar"}
    assert motor.settings.cleaning.guard_after_s == 60.0
    assert motor.file.oil_on(dt.date(2026, 8, 31)) == "vg68"
    assert motor.file.oil_on(dt.date(2026, 9, 1)) == "vg46"
    assert motor.file.logs.separator == ";"


def test_every_column_is_on_the_page() -> None:
    parts = re.split(r"^## ", PAGES["tables.md"](), flags=re.MULTILINE)[1:]
    listed = {part.split("\n")[0]: list(first_cells(part))[1:] for part in parts}
    assert listed == {
        table.name: [f"`{column.name}`" for column in table.columns] for table in TABLES
    }


def test_tables_lie_where_the_page_says(after_a_run: Path) -> None:
    stated = re.findall(r"File: `<output>/(.*?)`", PAGES["tables.md"]())
    assert len(stated) == len(TABLES)
    for place in stated:
        pattern = re.sub("<.*?>|YYYY-MM", "*", place)
        # In three nights nothing is raised and no baseline is frozen; a run makes no starts.
        empty = ("alarms", "baselines", "change_points", "looks", "starts")
        if pattern.split("/")[1] in empty:
            continue
        assert list((after_a_run / "out").glob(pattern)), pattern


@pytest.mark.usefixtures("after_a_run")
def test_readme_duckdb_query_works() -> None:
    (query,) = blocks(README, "sql")
    with duckdb.connect() as connection:
        connection.execute("SET file_search_path = 'out'")
        connection.execute(Path("out/views.sql").read_text("utf-8"))
        rows = pl.from_arrow(connection.sql(query).to_arrow_table())
    motors = {f"CB{n}-0{i}" for n in (400, 560, 1120) for i in (1, 2)}
    assert set(rows["motor_id"]) == motors
    assert rows.height == len(motors) * rows["night"].n_unique()  # each night has a row
    is_known = pl.col("reference_leakage_l_per_min").is_between(
        "reference_leakage_lower", "reference_leakage_upper"
    )
    # A night has figures, or a reason.
    assert rows.select((is_known | pl.col("reason").is_not_null()).all()).item()


@pytest.mark.usefixtures("after_a_run")
def test_queries_on_the_validation_page_work() -> None:
    ranking, figure = blocks((DOCS / "validation.md").read_text("utf-8"), "sql")
    with duckdb.connect() as connection:
        ranked = connection.execute(ranking).fetchall()
        drawn = connection.execute(figure).fetchall()
    motors = {f"CB{n}-0{i}" for n in (400, 560, 1120) for i in (1, 2)}
    inputs = {"pressure_difference", "oil_temperature", "speed"}
    assert {(motor, name) for motor, name, _, _ in ranked} == {
        (m, i) for m in motors for i in inputs
    }
    assert all(0.0 <= share <= 1.0 for _, _, share, _ in ranked)
    # 26 lags of whiteness and 51 of each input, with a band wherever there is one.
    assert len(drawn) == 26 + 3 * 51
    assert sum(bound is None for *_, bound in drawn) == 1


def test_fleet_on_the_page_for_own_fleets_loads(tmp_path: Path) -> None:
    shutil.copytree(shipped_configs() / "motor_types", tmp_path / "my-fleet" / "motor_types")
    shutil.copytree(shipped_configs() / "oils", tmp_path / "my-fleet" / "oils")
    (tmp_path / "my-fleet" / "motors").mkdir()
    for example in blocks((DOCS / "own_fleet.md").read_text("utf-8"), "toml"):
        file = example.splitlines()[0].removeprefix("# ")
        (tmp_path / file).write_text(example, "utf-8")
    (motor,) = load_fleet(tmp_path / "my-fleet" / "fleet.toml").motors
    assert motor.file.channels["speed"].source == "W1_n"
    assert motor.file.channels["case_pressure"].constant == 1.5


def test_stated_exit_codes_are_those_of_the_command() -> None:
    tree = ast.parse((ROOT / "pipeline" / "cli" / "arguments.py").read_text("utf-8"))
    values = {
        constant.value
        for node in tree.body
        if isinstance(node, ast.Assign) and "EXIT_" in ast.unparse(node.targets[0])
        for constant in ast.walk(node.value)
        if isinstance(constant, ast.Constant)
    }
    page = (DOCS / "operations.md").read_text("utf-8")
    stated = [cell for cell in first_cells(page) if re.fullmatch(r"\d+(, \d+)*", cell)]
    assert {int(code) for cell in stated for code in cell.split(", ")} == values


def test_every_error_code_is_in_the_operations_page_and_no_other() -> None:
    page = (DOCS / "operations.md").read_text("utf-8").split("## Error codes")[1]
    listed = [code for cell in first_cells(page) for code in re.findall(r"`(\w+)`", cell)]
    assert len(listed) == len(set(listed))
    assert set(listed) == error_codes([ast.parse(path.read_text("utf-8")) for path in SOURCES])


def test_search_for_codes_sees_each_way_in_which_code_states_one() -> None:
    source = """
class OilError(LeakageError): ...
class ConfigError(MotorLeakageError):
    def __init__(self): super().__init__("config", "x")
code = "early" if short else "late"
raise OilError(code, "x")
raise errors.LogError("damaged", path, "x")
Loss("died", "x")
unfitted(spec, code="internal")
other("no_code", code=error.code)
"""
    assert error_codes([ast.parse(source)]) == {
        *("config", "early", "late", "damaged", "died", "internal"),
    }


def error_codes(trees: list[ast.Module]) -> set[str]:
    """Codes that errors are given in some modules, found without running them."""
    classes = {"MotorLeakageError", "LeakageError", "LogError", "Loss"}
    defined = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    for _ in defined:
        classes |= {node.name for node in defined if classes & {ast.unparse(b) for b in node.bases}}
    codes: set[str] = set()
    for tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func).rpartition(".")[2]
                first = node.args[:1] if name in {*classes, "__init__"} else []
                named = [keyword.value for keyword in node.keywords if keyword.arg == "code"]
                stated = [*first, *named]
            elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "code":
                stated = [node.value]
            else:
                continue
            codes |= {text for value in stated for text in _texts(value)}
    return codes


def _texts(value: ast.expr) -> Iterator[str]:
    """Texts that an expression can be: a constant, or either side of a choice."""
    if isinstance(value, ast.IfExp):
        yield from _texts(value.body)
        yield from _texts(value.orelse)
    elif isinstance(value, ast.Constant) and isinstance(value.value, str):
        yield value.value


def test_every_dependency_has_its_line() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    extras = project["project"].get("optional-dependencies", {})
    groups = [project["project"]["dependencies"], *project["dependency-groups"].values()]
    texts = [one for group in [*groups, *extras.values()] for one in group if isinstance(one, str)]
    stated = {re.split(r"[^\w-]", one)[0] for one in texts}
    page = (DOCS / "dependencies.md").read_text("utf-8")
    assert sorted(cell for cell in first_cells(page) if cell != "Package") == sorted(stated)


@pytest.mark.parametrize("path", HAND_WRITTEN, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", path.read_text("utf-8")):
        name, _, anchor = target.partition("#")
        page = path.parent / name if name else path
        assert page.exists(), target
        if anchor:
            assert anchor in headings(page), target


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings, as they are made of their words."""
    found = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in found}


@pytest.mark.parametrize("path", HAND_WRITTEN, ids=lambda path: path.name)
def test_config_keys_that_are_named_exist(path: Path) -> None:
    known = {cell.strip("`") for cell in first_cells(PAGES["config.md"]())}
    sections = {key.split(".")[0] for key in known if "." in key} - {"path"}
    if path.name == "CHANGELOG.md":  # Says which keys are gone, and a config that has one is told.
        known |= set(GONE)
    for key in re.findall(r"`(\w+(?:\.[\w<>]+)+)`", path.read_text("utf-8")):
        if key.split(".")[0] in sections and not key.endswith((".toml", ".py", ".md")):
            assert re.sub(r"^channels\.\w+", "channels.<name>", key) in known, key


def test_names_in_contributing_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    code = "\n".join(f"{path.stem}\n{path.read_text('utf-8')}" for path in SOURCES)
    made = {".venv/", "benchmarks/results/"}
    for name in re.findall(r"`([\w./]+)`", text):
        if "/" in name or name.endswith((".md", ".txt")):
            rooms = (ROOT.glob(f"{package}/**/{name}") for package in ("leakage", "pipeline"))
            assert name in made or (ROOT / name).exists() or any(map(any, rooms)), name
        else:
            assert re.search(rf"\b{re.escape(name)}\b", code) or (ROOT / name).exists(), name


def test_make_targets_that_are_named_exist() -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    for path in HAND_WRITTEN:
        for words in re.findall(r"`make ([a-z -]+)", path.read_text("utf-8")):
            assert set(words.split()) <= set(targets), words
