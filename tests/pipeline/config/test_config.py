"""The config's door: all faults of all files at once, and nothing else gets in."""

from __future__ import annotations

import datetime as dt
import shutil
import tomllib
from pathlib import Path

import pytest

from pipeline.config import ConfigError, Fault, Fleet, load_fleet
from pipeline.demo import shipped_configs

MOTOR = "motors/CB400-01.toml"
TYPE = "motor_types/CB400.toml"
OIL = "oils/vg46.toml"
BAR = 'source = "x"\nunit = "bar"'
MOTOR_IDS = ["CB1120-01", "CB1120-02", "CB400-01", "CB400-02", "CB560-01", "CB560-02"]


@pytest.fixture
def configs(tmp_path: Path) -> Path:
    shutil.copytree(shipped_configs(), tmp_path / "configs")
    return tmp_path / "configs"


def change(configs: Path, file: str, before: str, after: str) -> None:
    path = configs / file
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after, 1), encoding="utf-8")


def add(configs: Path, file: str, text: str) -> None:
    with (configs / file).open("a", encoding="utf-8") as stream:
        stream.write(text)


def load(configs: Path) -> Fleet:
    return load_fleet(configs / "fleet.toml")


def faults(configs: Path) -> tuple[Fault, ...]:
    with pytest.raises(ConfigError) as caught:
        load(configs)
    for fault in caught.value.faults:
        assert str(fault) in str(caught.value)
    return caught.value.faults


def only_fault(configs: Path) -> Fault:
    (fault,) = faults(configs)
    return fault


# What is shipped


def test_shipped_configs_load(configs: Path) -> None:
    fleet = load(configs)
    assert [spec.motor_id for spec in fleet.motors] == MOTOR_IDS
    assert fleet.name == "Demo fleet"
    assert fleet.log_root == configs.parent / "demo" / "logs"
    assert fleet.output == configs.parent / "out"
    for spec in fleet.motors:
        for mode in ("none", "fixed", "estimated"):
            assert spec.motor(dt.date(2026, 1, 2), mode).columns[-3:] == (
                "one",
                "known",
                "measured",
            )


@pytest.mark.parametrize(("motor_type", "count"), [("CB400", 24), ("CB560", 32), ("CB1120", 64)])
def test_shipped_counts_are_those_of_the_model(motor_type: str, count: int) -> None:
    # model.md, section 3: 8 interfaces a cam row, 3, 4 and 8 rows.
    document = tomllib.loads((shipped_configs() / f"motor_types/{motor_type}.toml").read_text())
    assert [path["count"] for path in document["path"]] == [count] * 4


@pytest.mark.parametrize("folder", ["motor_types", "oils"])
def test_every_placeholder_says_so(folder: str) -> None:
    files = sorted((shipped_configs() / folder).glob("*.toml"))
    assert len(files) == 3
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert "PLACEHOLDER" in text.splitlines()[0]
        document = tomllib.loads(text)
        parts = document["path"] if folder == "motor_types" else [document]
        assert [part["source"] for part in parts] == ["placeholder"] * len(parts)


def test_the_source_of_a_constant_must_be_named(configs: Path) -> None:
    change(configs, TYPE, 'source = "placeholder"\n', "")
    change(configs, OIL, 'source = "placeholder"\n', "")
    assert set(faults(configs)) == {
        Fault(TYPE, 'path "piston_ring" source', "is missing"),
        Fault(OIL, "source", "is missing"),
    }


PORTS = (
    ("[channels.pressure_difference]", "[channels.high_port_pressure]"),
    (
        "[channels.speed]",
        '[channels.low_port_pressure]\nsource = "low"\nunit = "bar"\n[channels.speed]',
    ),
)


@pytest.mark.parametrize(
    ("ports", "model", "is_two_sided", "low_side"),
    [
        ((), "", False, "unknown"),
        ((), "charge_pressure_bar = 15.0", True, "modelled"),
        ((), "two_sided = true", True, "modelled"),
        (PORTS, "", True, "modelled"),
        (PORTS, "two_sided = false", False, "known"),
    ],
)
def test_leakage_is_two_sided_where_the_low_side_is_known(
    configs: Path, ports: tuple[tuple[str, str], ...], model: str, is_two_sided: bool, low_side: str
) -> None:
    for before, after in ports:
        change(configs, MOTOR, before, after)
    add(configs, MOTOR, f"\n[override.model]\n{model}\n")
    spec = next(one for one in load(configs).motors if one.motor_id == MOTOR[7:-5])
    assert spec.settings.model.two_sided is is_two_sided
    assert spec.low_side == low_side


# All faults at once


def test_all_faults_of_all_files_at_once(configs: Path) -> None:
    change(configs, MOTOR, 'motor_type = "CB400"', 'motor_type = "CB500"')
    change(configs, MOTOR, 'unit = "bar"', 'unit = "hPa"')
    change(configs, MOTOR, "resolution = 0.1", 'resolution = "fine"')
    change(configs, TYPE, "radius_mm = 35.0", "radius_mm = -35.0")
    change(configs, OIL, "density_15_c_kg_per_m3", "density")
    change(configs, "fleet.toml", "end_hour = 6", "end_hour = 24")
    (configs / "oils/vg32.toml").write_text("name = \n", encoding="utf-8")
    found = {(fault.file, fault.key): fault.message for fault in faults(configs)}
    assert found.pop((MOTOR, "motor_type")) == 'got "CB500"; expected one of CB1120, CB400, CB560'
    assert found.pop((MOTOR, "channels.pressure_difference.resolution")) == (
        'got "fine"; expected a valid number'
    )
    assert found.pop((TYPE, 'path "piston_ring" radius_mm')) == "got -35.0; expected greater than 0"
    assert found.pop((OIL, "density_15_c_kg_per_m3")) == "is missing"
    assert "check its spelling" in found.pop((OIL, "density"))
    assert found.pop(("fleet.toml", "nights.end_hour")) == (
        "got 24; expected less than or equal to 23"
    )
    assert found.pop(("oils/vg32.toml", "")).startswith("is not TOML")
    # The unit is judged with the other channels, once each channel by itself is sound.
    assert found.keys() <= {(MOTOR, "channels.pressure_difference.unit")}


def test_several_faults_of_one_motor_across_its_channels(configs: Path) -> None:
    change(configs, MOTOR, 'unit = "bar"', 'unit = "hPa"')
    change(configs, MOTOR, 'unit = "rpm"', 'unit = "Hz"')
    change(configs, MOTOR, 'oil = "vg68"', 'oil = "vg100"')
    found = {fault.key: fault.message for fault in faults(configs)}
    assert found["channels.pressure_difference.unit"].startswith('got "hPa"; expected one of bar,')
    assert found["channels.speed.unit"] == 'got "Hz"; expected one of rpm, 1/s, rad/s, deg/s'
    assert found["oil"] == 'got "vg100"; expected one of vg32, vg46, vg68'
    assert len(found) == 3


def test_a_fleet_file_with_faults_hides_no_motor_s(configs: Path) -> None:
    change(configs, "fleet.toml", 'name = "Demo fleet"', "name = 7")
    change(configs, MOTOR, 'oil = "vg68"', 'oil = "vg100"')
    assert {(fault.file, fault.key) for fault in faults(configs)} == {
        ("fleet.toml", "name"),
        (MOTOR, "oil"),
    }


def test_a_fault_of_a_type_is_reported_once_not_for_each_motor(configs: Path) -> None:
    change(configs, TYPE, "count = 24", "count = 0")
    assert only_fault(configs).file == TYPE


def test_message_counts_and_names_them(configs: Path) -> None:
    change(configs, MOTOR, 'oil = "vg68"', 'oil = "vg100"')
    with pytest.raises(ConfigError) as caught:
        load(configs)
    assert caught.value.code == "config"
    assert str(caught.value).splitlines() == [
        "1 config fault",
        f'  {MOTOR}: oil: got "vg100"; expected one of vg32, vg46, vg68',
    ]


def test_a_wrong_unit_is_told_beside_other_faults_of_its_file(configs: Path) -> None:
    change(configs, MOTOR, 'unit = "rpm"', 'unit = "rmp"')
    change(configs, MOTOR, "resolution = 0.1", 'resolution = "fine"')
    found = {fault.key for fault in faults(configs)}
    assert "channels.speed.unit" in found
    assert any(key.endswith(".resolution") for key in found)


# Single faults: file, key, what was found, what was expected


def check_fault(configs: Path, file: str, key: str, words: str) -> None:
    found = {(fault.file, fault.key): fault.message for fault in faults(configs)}
    assert words in found[file, key]


CHANNEL, LAW = "channels.pressure_difference", 'law = "annular_gap"'
DEFORMATION = "deformation_pressure_bar = 120.0"
POINTS = "deformation_points = [[10.0, 8.0, 1.0], [20.0, 8.0, 1.5], [40.0, 8.0, 1.6]]"
RING, PISTON, ROLLER = (
    f'path "{name}"' for name in ("piston_ring", "balance_piston", "cam_roller")
)
VISCOSITIES = "reference_viscosities_mm2_per_s"
FAULTS: dict[str, list[tuple[str, str, str, str]]] = {
    MOTOR: [
        # A channel
        ("resolution = 0.1", "resolutoin = 0.1", f"{CHANNEL}.resolutoin", "spelling"),
        *(
            ("resolution = 0.1", f"resolution = {value}", f"{CHANNEL}.resolution", words)
            for value, words in (
                ("true", "got true; expected a valid number"),
                ("nan", "got NaN; expected a finite number"),
                ("inf", "expected a finite number"),
                ("-0.1", "greater than or equal to 0"),
            )
        ),
        (
            "[-450.0, 450.0]",
            "[450.0, -450.0]",
            f"{CHANNEL}.valid_range",
            "got [450.0, -450.0]; exp",
        ),
        ("[-450.0, 450.0]", "[450.0]", f"{CHANNEL}.valid_range.1", "is missing"),
        ('"dp_bar"', '"x"\nscale = 0.0', f"{CHANNEL}.scale", "got 0.0; expected a factor"),
        ('source = "dp_bar"', "source = 5", f"{CHANNEL}.source", "got 5; expected a valid string"),
        ('source = "dp_bar"\n', "", f"{CHANNEL}.source", "is missing"),
        ("[channels.speed]", "[channels.spede]", "channels.spede", "'oil_temperature', 'speed'"),
        # The dialect
        *(
            ('time = "time"', f"{key} = {value}", f"logs.{key}", words)
            for key, value, words in (
                ("time_zone", '"Mars/Phobos"', "IANA"),
                ("time_format", '"%d.%m."', 'got "%d.%m."'),
                ("encoding", '"utf-99"', "text encoding"),
                ("encoding", '"hex"', "text encoding"),
                ("separator", '"."', "another mark than the decimal mark"),
                ("separator", '"·"', "ASCII"),
                ("separator", '";;"', "at most 1 character"),
                ("thousands", '"x"', "expected one of '.', ',', "),
                ("thousands", '","', "another mark than the decimal mark and the sep"),
                ("stamp", '"a..b"', "is no path"),
                ("decimal", '";"', "'.' or ','"),
                ("skip_rows", "-1", "greater than or equal to 0"),
                ("skip_rows", "1.0", "got 1.0; expected a valid integer"),
                ("missing_tokens", '""', "valid array"),
                ("columns", "5", "spelling"),
            )
        ),
        # The motor
        ('motor_id = "CB400-01"', 'motor_id = "CB400-07"', "motor_id", "as the file"),
        (
            'format = "csv"',
            'format = "xlsx"',
            "logs.format",
            ": csv, mcap, parquet, sql",
        ),
        ('["CB400-01/*.csv"]', '"CB400-01/*.csv"', "logs.files", "valid array"),
        ('["CB400-01/*.csv"]', "[]", "logs.files", "at least one"),
        ("[logs]", "[[logs]]", "logs", "expected an object"),
    ],
    TYPE: [
        ('motor_type = "CB400"', 'motor_type = "CB401"', "motor_type", "as the file"),
        (LAW, 'law = "gap"', f"{RING} law", "one of 'annular_gap', 'speed_curve'"),
        (f"{LAW}\n", "", f"{RING} law", "is missing"),
        ("count = 24", "count = 24.0", f"{RING} count", "got 24.0; expected a valid integer"),
        ("minimum = 1.0", "minimum = 9.0", f"{RING} gap_um", "minimum <= value <= maximum"),
        ("minimum = 1.0", "minimum = 0.0", f"{RING} gap_um.minimum", "greater than 0"),
        ("maximum = 1.0", "maximum = 1.1", f"{PISTON} eccentricity.maximum", "less than or equal"),
        ("deformation_pressure_bar", "deformation_points", f"{RING} deformation_points", "array"),
        ("speed_range_rpm", "points", f"{ROLLER} points.0", "got 0.0; expected a valid array"),
        ("speed_range_rpm = [0.0, 125.0]", "", ROLLER, "speed_range_rpm, or points"),
        *(
            ('name = "balance_piston"', f'name = "{name}"', f'path "{name}" name', words)
            for name, words in (
                ("piston_ring", "not taken"),
                ("flushing", "not taken"),
                ("known", "not taken"),
                ("Piston", "text that matches"),
            )
        ),
        *(
            (DEFORMATION, f"deformation_points = [{points}]", RING, words)
            for points, words in (
                ("[10.0, 8.0, 1.0], [20.0, 8.0, 2.0]", "3 points"),
                ("[10.0, 8.0, 1.0], [20.0, 8.0, 2.5], [40.0, 8.0, 9.0]", "does not close with"),
                ("[0.0, 8.0, 1.0], [20.0, 8.0, 2.5], [40.0, 8.0, 9.0]", "above 0"),
            )
        ),
        (DEFORMATION, f"{DEFORMATION}\n{POINTS}", RING, "not both"),
    ],
    OIL: [
        ("[46.0, 6.8]", "[6.8, 46.0]", "", "do not fall with temperature"),
        ("[46.0, 6.8]", "[46.0, 0.0]", f"{VISCOSITIES}.1", "got 0.0; expected greater than 0"),
        ("[46.0, 6.8]", "[46.0]", f"{VISCOSITIES}.1", "is missing"),
    ],
}


@pytest.mark.parametrize(
    ("file", "before", "after", "key", "words"),
    [(file, *one) for file, several in FAULTS.items() for one in several],
)
def test_a_fault_has_file_key_and_words(
    configs: Path, file: str, before: str, after: str, key: str, words: str
) -> None:
    change(configs, file, before, after)
    check_fault(configs, file, key, words)


@pytest.mark.parametrize(
    ("table", "line", "key", "words"),
    [
        ("nights", 'time_zone = "Europe/Atlantis"', "nights.time_zone", "IANA"),
        ("nights", "end_hour = 6.5", "nights.end_hour", "valid integer"),
        ("execution", "workers = 0", "execution.workers", "greater than or equal to 1"),
        ("execution", 'backend = "spark"', "execution.backend", "'loky', 'sequential' or 'dask'"),
        ("estimation", "seed = 1.5", "estimation.seed", "valid integer"),
        ("estimation", 'starting_points = "10"', "estimation.starting_points", 'got "10"'),
        ("cleaning", "hampel_window = 10", "cleaning.hampel_window", "expected an odd number"),
        ("windows", "training_share = 1.0", "windows.training_share", "less than 1"),
        ("smoothing", "window_s = 120.0", "", "less than windows.block_s = 120"),
        ("smothing", "window_s = 1.0", "smothing", "spelling"),
        ("folders", 'output = ["a"]', "folders.output", "valid string"),
    ],
)
def test_faults_of_the_fleet_file(
    configs: Path, table: str, line: str, key: str, words: str
) -> None:
    (configs / "fleet.toml").write_text(f'name = "F"\n[{table}]\n{line}\n', encoding="utf-8")
    check_fault(configs, "fleet.toml", key, words)


@pytest.mark.parametrize(
    "motor_id",
    ["../x", "a/b", "", ".", "..", ".hidden", "-x", "a b", "a\\\\b", "x" * 65, "ü", "a\\n"],
)
def test_ids_that_are_no_file_name(configs: Path, motor_id: str) -> None:
    change(configs, MOTOR, 'motor_id = "CB400-01"', f'motor_id = "{motor_id}"')
    assert {fault.key for fault in faults(configs)} == {"motor_id"}


@pytest.mark.parametrize("file", [MOTOR, TYPE])
def test_a_file_with_a_name_that_is_no_id(configs: Path, file: str) -> None:
    path = configs / file
    path.rename(path.with_name("-rf *.toml"))
    assert any(fault.file.endswith("/-rf *.toml") for fault in faults(configs))


@pytest.mark.parametrize(
    "pattern",
    [
        *("/etc/passwd", "\\\\\\\\server\\\\x", "../x.csv", "a/../../b.csv", "a\\\\..\\\\b.csv"),
        *("..", ".", "", "a/", "a/.", "a\\u0000.csv", "a\\n.csv"),
        *("**", "a/**", "a/**b.csv", "a/b**/c.csv"),
        *("é" * 128, "x" * 256 + "/*.csv", "folder/" * 147),
    ],
)
def test_logs_that_leave_the_log_root_or_are_no_files(configs: Path, pattern: str) -> None:
    change(configs, MOTOR, '["CB400-01/*.csv"]', f'["good/*.csv", "{pattern}"]')
    fault = only_fault(configs)
    assert (fault.file, fault.key) == (MOTOR, "logs.files.1")
    assert "expected" in fault.message


@pytest.mark.parametrize(
    "pattern", ["a.csv", "*.csv", "**/*.csv", "a/[0-9]?.csv", "...csv", "a..b.csv"]
)
def test_logs_below_the_log_root(configs: Path, pattern: str) -> None:
    change(configs, MOTOR, "CB400-01/*.csv", pattern)
    assert load(configs).motors[2].file.logs.files == (pattern,)


# Channels


def test_channels_that_are_missing(configs: Path) -> None:
    text = (configs / MOTOR).read_text(encoding="utf-8")
    (configs / MOTOR).write_text(text[: text.index("[channels.oil_temperature]")], encoding="utf-8")
    assert "expected also leakage_flow, oil_temperature, speed" in only_fault(configs).message


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("[channels.pressure_difference]", "[channels.high_port_pressure]"),
        ("[channels.speed]", f"[channels.low_port_pressure]\n{BAR}\n[channels.speed]"),
    ],
)
def test_pressure_comes_as_difference_or_as_two_ports(
    configs: Path, before: str, after: str
) -> None:
    change(configs, MOTOR, before, after)
    fault = only_fault(configs)
    assert (fault.file, fault.key) == (MOTOR, "channels")
    assert "high_port_pressure and low_port_pressure" in fault.message


# Flushing


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('mode = "fixed"\nalso = ["fixed"]', "each mode once"),
        ('mode = "maybe"', "'none', 'fixed' or 'estimated'"),
        ("flow_l_per_min = 30.0", "minimum_l_per_min <= flow_l_per_min"),
        ("flow_l_per_min = -1.0", "greater than or equal to 0"),
        ('also = "none"', "valid array"),
    ],
)
def test_flushing(configs: Path, table: str, words: str) -> None:
    add(configs, MOTOR, f"\n[flushing]\n{table}\n")
    assert words in only_fault(configs).message


# Events and overrides


def test_an_oil_change_is_dated(configs: Path) -> None:
    add(configs, MOTOR, '\n[[events]]\ndate = 2026-03-01\nkind = "oil_change"\noil = "vg46"\n')
    add(configs, MOTOR, '\n[[events]]\ndate = 2026-02-01\nkind = "oil_change"\noil = "vg32"\n')
    add(configs, MOTOR, '\n[[events]]\ndate = 2026-04-01\nkind = "overhaul"\n')
    spec = load(configs).motors[2]
    oils = {
        (2026, 1, 31): "vg68",
        (2026, 2, 1): "vg32",
        (2026, 2, 28): "vg32",
        (2026, 3, 1): "vg46",
        (2026, 5, 1): "vg46",
    }
    assert {date: spec.file.oil_on(dt.date(*date)) for date in oils} == oils
    names = {spec.motor(dt.date(*date), "none").oil.name for date in oils}
    assert len(names) == 3


@pytest.mark.parametrize(
    ("event", "key", "words"),
    [
        ('date = 2026-02-30\nkind = "overhaul"', "", "is not TOML"),
        ('date = "soon"\nkind = "overhaul"', "events.0.date", 'got "soon"'),
        ('date = 20260301\nkind = "overhaul"', "events.0.date", "got 20260301"),
        ('date = 2026-03-01T06:00:00\nkind = "overhaul"', "events.0.date", "got"),
        ('kind = "overhaul"', "events.0.date", "is missing"),
        (
            'date = "2026-03-01"\nkind = "overhaul"',
            "events.0.date",
            'got "2026-03-01"; expected a date without quotation marks',
        ),
        ('date = 2026-03-01\nkind = "oil_change"', "events.0.oil", "expected the oil's name"),
        ('date = 2026-03-01\nkind = "repair"', "events.0.kind", 'got "repair"'),
        ('date = 2026-03-01\nkind = "oil_change"\noil = "vg47"', "events.0.oil", 'got "vg47"'),
    ],
)
def test_events(configs: Path, event: str, key: str, words: str) -> None:
    add(configs, MOTOR, f"\n[[events]]\n{event}\n")
    fault = only_fault(configs)
    assert (fault.file, fault.key) == (MOTOR, key)
    assert words in fault.message


def test_times_in_quotation_marks(configs: Path) -> None:
    """TOML has a type of its own for them; a text would pass for one silently."""
    whole = "[2026-03-01T20:00:00Z, 2026-03-01T21:00:00Z]"
    half = '[2026-03-02T20:00:00Z, "2026-03-02T21:00:00Z"]'
    add(configs, MOTOR, f"\n[periods]\ntraining = [{whole}, {half}]\n")
    fault = only_fault(configs)
    assert (fault.file, fault.key) == (MOTOR, "periods.training.1.1")
    assert fault.message == ('got "2026-03-02T21:00:00Z"; expected a time without quotation marks')
    change(configs, MOTOR, '"2026-03-02T21:00:00Z"', "2026-03-02T21:00:00Z")
    load(configs)


def test_an_override_holds_for_its_motor_alone(configs: Path) -> None:
    change(configs, "fleet.toml", "[execution]", "[smoothing]\nwindow_s = 5.0\n[execution]")
    add(
        configs,
        MOTOR,
        '\n[override.smoothing]\napply_to = "leakage"\n[override.nights]\nend_hour = 5\n',
    )
    settings = {spec.motor_id: spec.settings for spec in load(configs).motors}
    assert settings["CB400-01"].smoothing.window_s == 5.0
    assert settings["CB400-01"].smoothing.apply_to == "leakage"
    assert settings["CB400-01"].nights.end_hour == 5
    assert settings["CB400-02"].smoothing.apply_to == "all"
    assert settings["CB400-02"].nights.end_hour == 6


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("[override.smoothing]\nwindow = 5.0", "override.smoothing.window"),
        ("[override.smoothing]\nwindow_s = -5.0", "override.smoothing.window_s"),
        ("[override.smoothing]\nwindow_s = 500.0", "override"),
        ("[override]\nsmoothing = 5.0", "override.smoothing"),
        ("[override.execution]\nworkers = 99", "override.execution"),
        ('[override.folders]\noutput = "/tmp"', "override.folders"),
        ('[override]\noutput = "/tmp"', "override.output"),
        ("[override]\nname = 5", "override.name"),
        ("[[override]]\nx = 5", "override"),
    ],
)
def test_overrides_that_are_none(configs: Path, override: str, key: str) -> None:
    add(configs, MOTOR, f"\n{override}\n")
    fault = only_fault(configs)
    assert (fault.file, fault.key) == (MOTOR, key)


def test_reference_conditions_beyond_the_oil_are_a_fault_of_the_config(configs: Path) -> None:
    thin = "[1.2, 0.3]"
    change(configs, OIL, "[46.0, 6.8]", thin)
    change(configs, "fleet.toml", "temperature_c = 50.0", "temperature_c = 149.0")
    change(configs, MOTOR, 'oil = "vg68"', 'oil = "vg46"')
    fault = only_fault(configs)
    assert fault.file == MOTOR
    assert "vg46" in fault.message


# Files and folders


def test_no_fleet_file(tmp_path: Path) -> None:
    assert str(only_fault(tmp_path)) == "fleet.toml: cannot be read: No such file or directory"


def test_a_folder_instead_of_the_fleet_file(configs: Path) -> None:
    with pytest.raises(ConfigError, match=r"configs: cannot be read: Is a directory"):
        load_fleet(configs)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"motor_id = CB400", "is not TOML"),
        (b"motor_id = 'a'\nmotor_id = 'b'", "is not TOML"),
        ("motor_id = 'ü'".encode("latin-1"), "is not UTF-8"),
        ("motor_id = 'a'".encode("utf-16"), "is not UTF-8"),
        (bytes(range(256)), "is not"),
        (b"a = " + b"[" * 5000, "is not TOML"),
    ],
)
def test_a_file_that_is_no_toml_leaves_the_others_judged(
    configs: Path, content: bytes, words: str
) -> None:
    (configs / MOTOR).write_bytes(content)
    change(configs, "motors/CB400-02.toml", 'oil = "vg68"', 'oil = "vg100"')
    found = {fault.file: fault for fault in faults(configs)}
    assert found.keys() == {MOTOR, "motors/CB400-02.toml"}
    assert words in found[MOTOR].message


def test_a_file_may_begin_with_a_byte_order_mark(configs: Path) -> None:
    """As editors of Windows write it."""
    for file in ("fleet.toml", MOTOR, TYPE, OIL):
        path = configs / file
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert len(load(configs).motors) == 6


def test_an_empty_motor_file(configs: Path) -> None:
    (configs / MOTOR).write_bytes(b"")
    keys = {fault.key for fault in faults(configs)}
    assert keys == {"motor_id", "motor_type", "oil", "logs", "channels"}


def test_folders_that_are_not_there(configs: Path) -> None:
    for name in ("motors", "motor_types", "oils"):
        (configs / name).rename(configs / f"old_{name}")
    found = faults(configs)
    assert {fault.file for fault in found} == {"motors", "motor_types", "oils"}
    assert all("expected a folder at" in fault.message for fault in found)


def test_a_folder_without_motors(configs: Path) -> None:
    for path in (configs / "motors").iterdir():
        path.unlink()
    assert only_fault(configs).message == "expected at least one motor's file"


def test_folders_are_those_of_the_fleet_file(configs: Path) -> None:
    (configs / "motors").rename(configs.parent / "my motors")
    change(configs, "fleet.toml", 'output = "../out"', 'motors = "../my motors"\noutput = "../o"')
    fleet = load(configs)
    assert len(fleet.motors) == 6
    assert fleet.output == configs.parent / "o"


NO_FOLDERS = {
    "a null character": "a\\u0000b",
    "a long name": "x" * 300,
    "links in a circle": "../circle/x",
    "nothing": "",
}


@pytest.mark.parametrize("name", NO_FOLDERS.values(), ids=NO_FOLDERS.keys())
@pytest.mark.parametrize("key", ["motors", "logs", "output"])
def test_folders_that_cannot_be(configs: Path, key: str, name: str) -> None:
    (configs.parent / "circle").symlink_to("circle")
    text = (configs / "fleet.toml").read_text("utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(f"{key} = ")]
    at = next(number for number, line in enumerate(lines) if line.startswith("[folders]"))
    lines.insert(at + 1, f'{key} = "{name}"')
    (configs / "fleet.toml").write_text("\n".join(lines), "utf-8")
    (fault,) = (one for one in faults(configs) if one.file == "fleet.toml")
    assert fault.key == f"folders.{key}"
    assert fault.message.startswith(f'got "{name}"; expected ')


@pytest.mark.parametrize(
    ("logs", "output", "words"),
    [
        ("../logs", "../logs", "expected another folder than that of the logs"),
        ("../logs", "../x/../logs/.", "expected another folder than that of the logs"),
        ("..", "../CB400-01/", "CB400-01/*.csv of CB400-01 reaches into it"),
        ("../out/staging", "../out", "expected a folder without the logs"),
        ("../out/tables/fits", "../out", "expected a folder without the logs"),
    ],
)
def test_output_and_logs_that_spoil_each_other(
    configs: Path, logs: str, output: str, words: str
) -> None:
    change(configs, "fleet.toml", '"../demo/logs"', f'"{logs}"')
    change(configs, "fleet.toml", '"../out"', f'"{output}"')
    fault = only_fault(configs)
    assert (fault.file, fault.key) == ("fleet.toml", "folders.output")
    assert fault.message.startswith(f'got "{output}"; expected ')
    assert words in fault.message


@pytest.mark.parametrize(
    ("pattern", "output", "is_spoilt"),
    [
        ("**/*.csv", "../out", True),
        ("o?t/**/*.csv", "../out", True),
        ("*/*.csv", "../out", True),
        ("*/*.csv", "../out/deep", False),
        ("logs/**/*.csv", "../out", False),
        ("*.csv", "../out", False),
    ],
)
def test_an_output_below_the_logs_is_one_where_no_log_is_looked_for(
    configs: Path, pattern: str, output: str, is_spoilt: bool
) -> None:
    change(configs, "fleet.toml", '"../demo/logs"', '".."')
    change(configs, "fleet.toml", '"../out"', f'"{output}"')
    change(configs, MOTOR, "CB400-01/*.csv", pattern)
    if is_spoilt:
        assert f"{pattern} of CB400-01 reaches into it" in only_fault(configs).message
    else:
        assert load(configs).output == (configs / output).resolve()


def test_logs_beside_the_tables_spoil_nothing(configs: Path) -> None:
    change(configs, "fleet.toml", '"../demo/logs"', '"../out/logs"')
    assert load(configs).log_root == configs.parent / "out" / "logs"


def test_what_is_no_toml_file_is_left_alone(configs: Path) -> None:
    (configs / "motors" / "README.md").write_text("notes")
    (configs / "motors" / "CB400-01.toml~").write_text("backup")
    assert len(load(configs).motors) == 6


@pytest.mark.parametrize(
    ("table", "lines", "words"),
    [
        ("alarms", "deadband_percent = 15.0", "expected deadband_percent below warning_percent"),
        ("alarms", "warning_percent = 30.0", "expected warning_percent below alarm_percent"),
        ("alarms", "on_nights = [6, 5]", "expected on_nights as [m, n] with 1 <= m <= n"),
        ("trend", "baseline_nights = 30\nprovisional_nights = 40", "no more than baseline_nights"),
    ],
)
def test_settings_of_trends_that_contradict_each_other(
    configs: Path, table: str, lines: str, words: str
) -> None:
    path = configs / "fleet.toml"
    path.write_text(path.read_text("utf-8") + f"\n[{table}]\n{lines}\n", "utf-8")
    (fault,) = faults(configs)
    assert fault.key == table
    assert words in str(fault)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        *(
            (f"webhook_url = {url}", "webhook_url: expected http:// or https:// and a host")
            for url in (
                '"file:///T0KEN"',
                '"http://"',
                '"http:/T0KEN"',
                '"http://h/T0 KEN"',
                '"http://h/T0KEN\\r\\n"',
                '"http://[::1"',
                '"http://h:T0KEN/"',
                '"http://h:99999/"',
                '"h.example/T0KEN"',
            )
        ),
        ('webhook_url = "https://me:T0KEN@h/"', "webhook_url: expected no name or password"),
        ('webhook_url = ["http://h/T0KEN"]', "webhook_url: expected a valid string"),
        ("deadband_percent = 15.0\nwebhook_url = 'http://h/T0KEN'", "expected deadband_percent"),
        ('webhook_headers = { "X:" = "T0KEN" }', "webhook_headers: expected names of letters"),
        ('webhook_headers = { Host = "T0KEN" }', "webhook_headers: expected no Host: the program"),
        ('webhook_headers = { webhook-id = "T0KEN" }', "expected no webhook-id"),
        *(
            (f"webhook_headers = {{ X = {value} }}", "webhook_headers: expected printable ASCII")
            for value in (
                '"$T0KEN"',
                '"${T0KEN"',
                '"${}"',
                '"${1}"',
                '"T0KENñ"',
                '"T0\\nKEN"',
                '""',
            )
        ),
        ("webhook_headers = { X = 1 }", "webhook_headers.X: expected a valid string"),
        ('webhook_secret = "whsec_T0KEN"', "webhook_secret: expected ${NAME}, with the secret in"),
        ('webhook_secret = "${A}${B}"', "webhook_secret: expected ${NAME}"),
    ],
)
def test_a_web_hook_that_cannot_be_posted_to(configs: Path, line: str, words: str) -> None:
    path = configs / "fleet.toml"
    path.write_text(path.read_text("utf-8") + f"\n[alarms]\n{line}\n", "utf-8")
    (fault,) = faults(configs)
    assert words in str(fault)
    assert "T0KEN" not in str(fault)


def test_a_web_hook_with_all_that_it_may_have(configs: Path) -> None:
    path = configs / "fleet.toml"
    lines = """
        [alarms]
        webhook_url = "https://h.example:8443/a/b?c=d"
        webhook_headers = { Authorization = "Bearer ${HOOK_TOKEN}", X-Plant = "3, hall ${HALL}" }
        webhook_secret = "${HOOK_SECRET}"
    """
    path.write_text(path.read_text("utf-8") + lines, "utf-8")
    alarms = load(configs).settings.alarms
    assert alarms.webhook_headers["X-Plant"] == "3, hall ${HALL}"
