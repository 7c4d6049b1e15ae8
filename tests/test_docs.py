"""The written pages agree with the code: examples, configs, links, codes, keys."""

from __future__ import annotations

import ast
import doctest
import io
import re
import shutil
import subprocess
import tokenize
import tomllib
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import polars as pl
import pytest

from pipeline.cli import arguments
from pipeline.config import Alarms, load_fleet
from pipeline.config.channels import Channel
from pipeline.config.logs import Logs
from pipeline.demo import shipped_configs
from pipeline.ingest import csv as csv_log
from pipeline.ingest import parquet
from pipeline.ingest.mcap import messages as mcap_messages
from tests.pipeline.cli.test_extras import stated
from tests.pipeline.cli.test_help import keys
from tests.query_page import views
from tests.reference_pages import PAGES

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text("utf-8")
HAND_WRITTEN = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(path for path in sorted(DOCS.glob("*.md")) if path.name not in PAGES),
]
SOURCES = [
    path for package in ("leakage", "pipeline") for path in sorted((ROOT / package).rglob("*.py"))
]
# Beginnings of the codes that stand in tables, each of which has its line.
ROOMS = ("log_", "task_", "scheduler_", "object_store_")
NO_CODES = {"log_files", "log_note", "log_of_samples"}


# Words of an older language; the trade has others.
OLD_WORDS = re.compile(
    r"\b(told|tells|would tell|goes on|a look at|its course|(the motor's|its) own conditions"
    r"|cannot be told|over 99 % probable|lack of fit|refused samples|not white|zeros of the sensors"
    r"|the model before|no motor claims|goes into no|its zero is known|tell as much as"
    r"|nothing is known since)\b",
    re.IGNORECASE,
)
WORDS_FOR_ANYTHING = re.compile(r"\b(found|kept|one|said|told)\b")


def texts_for_people() -> Iterator[tuple[str, str]]:
    """Pages, templates, descriptions of columns and messages, with their places."""
    package = ROOT / "pipeline"
    written = [ROOT / "README.md", *DOCS.glob("*.md"), package / "schema" / "columns.csv"]
    for folder in ("assets", "templates"):
        written += (package / "report" / folder).iterdir()
    for path in written:
        yield from (
            (f"{path.name}:{n}", line)
            for n, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        )
    for path in SOURCES:
        if not OLD_WORDS.search(text := path.read_text("utf-8")):
            continue
        tree = ast.parse(text)
        # Docstrings are for people only where they are the help of a command.
        helps = "cli" in path.parts
        docstrings = {
            id(node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and not helps
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and id(node) not in docstrings:
                yield f"{path.name}:{node.lineno}", str(node.value)


def test_what_people_read_is_in_the_words_of_the_trade() -> None:
    seen = list(texts_for_people())
    assert len(seen) > 2000
    assert [(place, found[0]) for place, text in seen if (found := OLD_WORDS.search(text))] == []


def test_names_say_what_they_stand_for() -> None:
    """No name of the code is a participle or a pronoun for whatever came out."""
    folders = ("benchmarks", "docs", "examples", "validation")
    places = []
    for path in [*SOURCES, *(path for name in folders for path in (ROOT / name).rglob("*.py"))]:
        text = path.read_text("utf-8")
        if WORDS_FOR_ANYTHING.search(text):
            places += [
                f"{path.relative_to(ROOT)}:{token.start[0]}"
                for token in tokenize.generate_tokens(io.StringIO(text).readline)
                if token.type == tokenize.NAME and WORDS_FOR_ANYTHING.fullmatch(token.string)
            ]
    assert places == []


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


def test_the_walk_through_runs_and_prints_what_it_says() -> None:
    found = doctest.testfile(str(DOCS / "fitting.md"), module_relative=False)
    assert found.attempted > 10
    assert found.failed == 0


@pytest.mark.usefixtures("after_a_run")
def test_readme_duckdb_query_works() -> None:
    (query,) = blocks(README, "sql")
    with views() as tables:
        rows = tables.sql(query).pl()
    motors = {f"CB{n}-0{i}" for n in (400, 560, 1120) for i in (1, 2)}
    assert set(rows["motor_id"]) == motors
    assert rows.height == len(motors) * rows["night"].n_unique()  # each night has a row
    is_known = pl.col("own_leakage_l_per_min", "reference_leakage_l_per_min").is_not_null()
    # A night has figures, or a reason.
    assert rows.select(
        (pl.all_horizontal(is_known) | pl.col("leakage_reason").is_not_null()).all()
    ).item()


def test_the_fleet_of_the_page_on_the_start_loads(tmp_path: Path) -> None:
    shutil.copytree(shipped_configs() / "motor_types", tmp_path / "my-fleet" / "motor_types")
    shutil.copytree(shipped_configs() / "oils", tmp_path / "my-fleet" / "oils")
    (tmp_path / "my-fleet" / "motors").mkdir()
    for example in blocks((DOCS / "start.md").read_text("utf-8"), "toml"):
        file = example.splitlines()[0].removeprefix("# ")
        (tmp_path / file).write_text(example, "utf-8")
    (motor,) = load_fleet(tmp_path / "my-fleet" / "fleet.toml").motors
    assert motor.file.channels["speed"].source == "W1_n"
    assert motor.file.channels["case_pressure"].constant == 1.5


def test_the_historian_s_log_is_one_that_the_config_takes() -> None:
    page = (DOCS / "logs.md").read_text("utf-8")
    example = tomllib.loads(page.partition("```toml")[2].partition("```")[0])
    tables = {name: tuple(v) if isinstance(v, list) else v for name, v in example["logs"].items()}
    assert Logs.model_validate(tables).layout == "long"
    (keys,) = example["channels"].values()
    channel = Channel.model_validate(keys)
    settings = (channel.between, channel.quality_good)
    assert settings == ("hold", (192,))


def test_the_receivers_of_the_page_on_results_are_a_config() -> None:
    page = (DOCS / "results.md").read_text("utf-8").partition("## Notifications")[2]
    config = tomllib.loads(page.partition("```toml")[2].partition("```")[0])["alarms"]
    config |= {"command": tuple(config["command"])}
    config["email"] |= {"to": tuple(config["email"]["to"])}
    assert Alarms.model_validate(config).email is not None


def test_the_limits_of_the_page_are_those_of_the_code() -> None:
    text = (DOCS / "operations.md").read_text("utf-8").partition("## Security")[2]
    gib, mib = 2**30, 2**20
    assert f"unpacks to {csv_log.LARGEST_TEXT // gib} GiB at most" in text
    assert f"to {csv_log.LARGEST_RATIO} times its size" in text
    assert f"a line has {csv_log.LONGEST_LINE // mib} MiB" in text
    assert f"a header {csv_log.MOST_CELLS} cells" in text
    assert parquet.MOST_ROWS == 2**27
    assert f"{parquet.MOST_ROWS_A_BYTE} a byte" in text
    assert f"a chunk of MCAP has {mcap_messages.LARGEST_CHUNK // mib} MiB" in text


def test_stated_exit_codes_are_those_of_the_command() -> None:
    values = {code for name, code in vars(arguments).items() if name.startswith("EXIT_")}
    page = (DOCS / "operations.md").read_text("utf-8")
    stated = [cell for cell in first_cells(page) if re.fullmatch(r"\d+(, \d+)*", cell)]
    assert {int(code) for cell in stated for code in cell.split(", ")} == values


def test_codes_of_the_operations_page_are_the_program_s() -> None:
    """All that logs and databases can be refused with, and no code that there is not."""
    page = (DOCS / "operations.md").read_text("utf-8")
    cells = first_cells(page.partition("## Error codes")[2])
    listed = [code for cell in cells for code in re.findall(r"`([a-z_]+)`", cell)]
    listed = [code for code in listed if "_" in code or code in ("internal", "locked")]
    source = "\n".join(path.read_text("utf-8") for path in SOURCES)
    assert [code for code in listed if f'"{code}"' not in source] == []
    used = set(re.findall(rf'"((?:{"|".join(ROOMS)})[a-z_]+)"', source)) - NO_CODES
    assert used <= set(listed)


def test_every_dependency_has_its_line() -> None:
    names = {re.split(r"[^\w-]", text)[0] for text in stated()}
    page = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    part = page.partition("## Dependencies")[2].partition("\n## ")[0]
    assert sorted(cell for cell in first_cells(part) if cell.islower()) == sorted(names)


@pytest.mark.parametrize("path", HAND_WRITTEN, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", path.read_text("utf-8")):
        if target.startswith("https:"):
            continue
        name, _, anchor = target.partition("#")
        page = path.parent / name if name else path
        assert page.exists(), target
        if anchor:
            assert anchor in headings(page), target


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings, as they are made of their words."""
    found = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in found}


def test_config_keys_that_are_named_exist() -> None:
    known = set(keys())
    sections = {key.split(".")[0] for key in known if "." in key} - {"path"}
    pages = (page for page in HAND_WRITTEN if page.name != "CHANGELOG.md")  # which has those gone
    text = "\n".join(page.read_text("utf-8") for page in pages)
    for key in re.findall(r"`(\w+(?:\.[\w<>]+)+)`", text):
        if key.split(".")[0] in sections and not key.endswith((".toml", ".py", ".md")):
            assert re.sub(r"^channels\.\w+", "channels.<name>", key) in known, key


def test_names_in_contributing_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    code = "\n".join(f"{path.stem}\n{path.read_text('utf-8')}" for path in SOURCES)
    words = set(re.findall(r"\w+", code))
    made = {".venv/", "benchmarks/results/"}
    for name in re.findall(r"`([\w./]+)`", text):
        if "/" in name or name.endswith((".md", ".txt")):
            rooms = (ROOT.glob(f"{package}/**/{name}") for package in ("leakage", "pipeline"))
            assert name in made or (ROOT / name).exists() or any(map(any, rooms)), name
        else:
            assert set(name.split(".")) <= words or (ROOT / name).exists(), name


def test_make_targets_that_are_named_exist() -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    for path in HAND_WRITTEN:
        for words in re.findall(r"`make ([a-z -]+)", path.read_text("utf-8")):
            assert set(words.split()) <= set(targets), words


@pytest.mark.parametrize(("given", "expected"), [((), ""), (("JOBS=3",), "--jobs 3")])
def test_make_leaves_the_workers_to_the_config_unless_set(
    given: tuple[str, ...], expected: str
) -> None:
    command = ("make", "--dry-run", "fit-fleet", *given)
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    (line,) = re.findall(r"motor-leakage fit-fleet .*", done.stdout)
    assert line.removeprefix("motor-leakage fit-fleet configs/fleet.toml").strip() == expected


def test_the_image_has_what_the_page_on_clusters_starts() -> None:
    pins = (ROOT / "requirements" / "image.txt").read_text("utf-8")
    text = (ROOT / "docs" / "scale.md").read_text("utf-8")
    started = set(re.findall(r"command: \[(\w+), (\w+)", text))
    assert started == {("dask", "scheduler"), ("dask", "worker")}
    for command, name in started:
        (program,) = entry_points(group="console_scripts", name=command)
        (part,) = entry_points(group=f"{command}_cli", name=name)
        for entry in (program, part):
            assert entry.dist is not None
            assert f"\n{entry.dist.name}==" in pins
