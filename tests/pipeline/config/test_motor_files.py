"""Files of motors, their types and oils: single faults, and what holds when."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import pytest

from tests.pipeline.config.shipped import (
    MOTOR,
    OIL,
    SAMPLE,
    TYPE,
    add,
    change,
    check_fault,
    faults,
    load,
    only_fault,
)

BAR = 'source = "x"\nunit = "bar"'

CHANNEL, LAW = "channels.pressure_difference", 'law = "annular_gap"'
DEFORMATION = "deformation_pressure_bar = 120.0"
POINTS = "deformation_points = [[10.0, 8.0, 1.0], [20.0, 8.0, 1.5], [40.0, 8.0, 1.6]]"
RING, PISTON, ROLLER = (
    f'path "{name}"' for name in ("piston_ring", "balance_piston", "cam_roller")
)
FAULTS: dict[str, list[tuple[str, str, str, str]]] = {
    MOTOR: [
        # A channel
        ("resolution = 0.1", "resolutoin = 0.1", f"{CHANNEL}.resolutoin", "spelling"),
        *(
            ("resolution = 0.1", f"resolution = {value}", f"{CHANNEL}.resolution", words)
            for value, words in (
                ("true", "got true; expected a valid number"),
                ("nan", "got NaN; expected a finite number"),
            )
        ),
        ("[-450.0, 450.0]", "[450.0, -450.0]", f"{CHANNEL}.valid_range", "got [450.0, -4"),
        ('"dp_bar"', '"x"\nscale = 0.0', f"{CHANNEL}.scale", "got 0.0; expected a factor"),
        ('source = "dp_bar"\n', "", f"{CHANNEL}.source", "is missing"),
        (
            "resolution = 0.1",
            "sensor_maximum = -1.0",
            f"{CHANNEL}.sensor_maximum",
            "greater than 0",
        ),
        (
            "[-450.0, 450.0]",
            "[100.0, 450.0]\nsensor_maximum = 90.0",
            f"{CHANNEL}.sensor_maximum",
            "more than the lower end of valid_range",
        ),
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
                ("thousands", '"x"', "expected one of '.', ',', "),
                ("thousands", '","', "another mark than the decimal mark and the sep"),
                ("stamp", '"a..b"', "is no path"),
                ("decimal", '";"', "'.' or ','"),
            )
        ),
        # The motor
        ('motor_id = "CB400-01"', 'motor_id = "CB400-07"', "motor_id", "as the file"),
        ('format = "csv"', 'format = "xlsx"', "logs.format", ": csv, mcap, parquet"),
        ('["CB400-01/*.csv"]', "[]", "logs.files", "at least one"),
    ],
    TYPE: [
        ('motor_type = "CB400"', 'motor_type = "CB401"', "motor_type", "as the file"),
        ('source = "placeholder"\n', "", f"{RING} source", "is missing"),
        (LAW, 'law = "gap"', f"{RING} law", "'annular_gap', 'speed_curve'"),
        (f"{LAW}\n", "", f"{RING} law", "is missing"),
        ("minimum = 1.0", "minimum = 9.0", f"{RING} gap_um", "minimum <= value <= maximum"),
        ("speed_range_rpm = [0.0, 125.0]", "", ROLLER, "speed_range_rpm, or points"),
        *(
            ('name = "balance_piston"', f'name = "{name}"', f'path "{name}" name', words)
            for name, words in (
                ("piston_ring", "not taken"),
                ("flushing", "not taken"),
                ("known", "not taken"),
                ("Piston", "expected pattern"),
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


WHOLE = """motor_id = "M1"
motor_type = "CB400"
oil = "vg68"
[logs]
format = "csv"
files = ["M1/*.csv"]
[channels]
pressure_difference = { source = "dp", unit = "bar" }
oil_temperature = { source = "T", unit = "degC" }
speed = { source = "n", unit = "rpm" }
leakage_flow = { source = "q", unit = "l/min" }
"""


def test_a_motor_s_file_of_few_lines_is_whole(configs: Path) -> None:
    assert WHOLE.count("\n") <= 15
    (configs / "motors" / "M1.toml").write_text(WHOLE, "utf-8")
    assert "M1" in {spec.motor_id for spec in load(configs).motors}


@pytest.mark.parametrize(
    "motor_id",
    ["../x", "a/b", "", ".", "..", ".hidden", "-x", "a b", "a\\\\b", "x" * 65, "ü", "a\\n"],
)
def test_ids_that_are_no_file_name(configs: Path, motor_id: str) -> None:
    change(configs, MOTOR, 'motor_id = "CB400-01"', f'motor_id = "{motor_id}"')
    assert {fault.key for fault in faults(configs)} == {"motor_id"}


def test_files_with_a_name_that_is_no_id(configs: Path) -> None:
    for file in (MOTOR, TYPE):
        (configs / file).rename((configs / file).with_name("-rf *.toml"))
    assert {f"{kind}/-rf *.toml" for kind in ("motors", "motor_types")} <= {
        fault.file for fault in faults(configs)
    }


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


def test_channels_that_are_missing(configs: Path) -> None:
    text = (configs / MOTOR).read_text(encoding="utf-8")
    (configs / MOTOR).write_text(text[: text.index("[channels.oil_temperature]")], encoding="utf-8")
    assert "expected also leakage_flow, oil_temperature, speed" in only_fault(configs).message


PORTS = (
    ("[channels.pressure_difference]", "[channels.high_port_pressure]"),
    ("[channels.speed]", f"[channels.low_port_pressure]\n{BAR}\n[channels.speed]"),
)


@pytest.mark.parametrize(("before", "after"), PORTS)
def test_pressure_comes_as_difference_or_as_two_ports(
    configs: Path, before: str, after: str
) -> None:
    change(configs, MOTOR, before, after)
    fault = only_fault(configs)
    assert (fault.file, fault.key) == (MOTOR, "channels")
    assert "high_port_pressure and low_port_pressure" in fault.message


def test_an_oil_change_is_dated(configs: Path) -> None:
    add(configs, MOTOR, '\n[[events]]\ndate = 2026-03-01\nkind = "oil_change"\noil = "vg46"\n')
    add(configs, MOTOR, '\n[[events]]\ndate = 2026-02-01\nkind = "oil_change"\noil = "vg32"\n')
    add(configs, MOTOR, '\n[[events]]\ndate = 2026-04-01\nkind = "overhaul"\n')
    spec = load(configs).motors[2]
    dates = [dt.date(2026, *one) for one in ((1, 31), (2, 1), (2, 28), (3, 1), (5, 1))]
    oils = [spec.file.oil_on(date) for date in dates]
    assert oils == ["vg68", "vg32", "vg32", "vg46", "vg46"]
    assert len({spec.motor(date, "none").oil.name for date in dates}) == 3


def test_an_override_holds_for_its_motor_alone(configs: Path) -> None:
    change(configs, "fleet.toml", "[execution]", "[smoothing]\nwindow_s = 5.0\n[execution]")
    add(configs, MOTOR, "\n[override]\nsmoothing.window_s = 7.0\nnights.end_hour = 5\n")
    settings = {spec.motor_id: spec.settings for spec in load(configs).motors}
    assert settings["CB400-01"].smoothing.window_s == 7.0
    assert settings["CB400-01"].nights.end_hour == 5
    assert settings["CB400-02"].smoothing.window_s == 5.0
    assert settings["CB400-02"].nights.end_hour == 6


NU, ETA = (f'[channels.{name}_viscosity]\nsource = "{name}"\n' for name in ("kinematic", "dynamic"))
VISCOSITY, AT_100 = "viscosity_40_c_mm2_per_s", "viscosity_100_c_mm2_per_s"
MARCH = "[[events]]\ndate = 2026-03-01\n"
ADDED = [
    ('[flushing]\nmode = "fixed"\nalso = ["fixed"]', "flushing", "each mode once"),
    ('[flushing]\nmode = "maybe"', "flushing.mode", "'none', 'fixed' or 'estimated'"),
    ("[flushing]\nflow_l_per_min = 30.0", "flushing", "minimum_l_per_min <= flow_l_per_min"),
    ('[[events]]\ndate = 2026-02-30\nkind = "overhaul"', "", "is not TOML"),
    ('[[events]]\ndate = 2026-03-01T06:00:00\nkind = "overhaul"', "events.0.date", "got"),
    (f'{MARCH}kind = "oil_change"', "events.0.oil", "expected the oil's name"),
    (f'{MARCH}kind = "oil_change"\noil = "vg47"', "events.0.oil", 'got "vg47"'),
    (f'{MARCH}kind = "note"\noil = "vg46"', "events.0.oil", "a note changes nothing"),
    ("[override.smoothing]\nwindow = 5.0", "override.smoothing.window", "spelling"),
    ("[override.smoothing]\nwindow_s = 500.0", "override.smoothing.window_s", "less than"),
    ("[override.execution]\nworkers = 99", "override.execution", "is no key"),
    ('[override]\noutput = "/tmp"', "override.output", "is no key"),
    # Analyses of the oil, and viscosities in the log
    *(
        (SAMPLE.replace("46.0", at_40), f"oil_samples.0.{VISCOSITY}", words)
        for at_40, words in (("0.5", "or equal to 2"), ("440.0", "another oil is an event"))
    ),
    (f"{SAMPLE}viscosity_100_c_mm2_per_s = 46.0", f"oil_samples.0.{AT_100}", "less than"),
    (SAMPLE.replace("2020", "9998"), "oil_samples.0.date", "a day that has come"),
    ("[[oil_samples]]\ndate = 2020-01-05", "oil_samples.0", "or water_mg_per_kg"),
    (SAMPLE + SAMPLE, "oil_samples.1.date", "expected a date after 2020-01-05"),
    (NU, "channels.kinematic_viscosity.unit", "is missing"),
    (f'{NU}unit = "cP"', "channels.kinematic_viscosity.unit", "expected one of mm2/s"),
    (f'{NU}unit = "cSt"\n{ETA}unit = "cP"', "channels", "not both"),
]


@pytest.mark.parametrize(("text", "key", "words"), ADDED)
def test_tables_that_cannot_be(configs: Path, text: str, key: str, words: str) -> None:
    add(configs, MOTOR, f"\n{text}\n")
    fault = only_fault(configs)
    assert (fault.file, fault.key) == (MOTOR, key)
    assert words in fault.message


def test_reference_conditions_beyond_the_oil_are_a_fault_of_the_config(configs: Path) -> None:
    change(configs, OIL, "[46.0, 6.8]", "[1.2, 0.3]")
    change(configs, "fleet.toml", "temperature_c = 50.0", "temperature_c = 149.0")
    change(configs, MOTOR, 'oil = "vg68"', 'oil = "vg46"')
    fault = only_fault(configs)
    assert fault.file == MOTOR
    assert "vg46" in fault.message


@pytest.mark.parametrize(
    ("ports", "model", "is_two_sided"),
    [
        ((), "", False),
        ((), "charge_pressure_bar = 15.0", True),
        ((), "two_sided = true", True),
        (PORTS, "", True),
        (PORTS, "two_sided = false", False),
    ],
)
def test_leakage_is_two_sided_where_the_low_side_is_known(
    configs: Path, ports: tuple[tuple[str, str], ...], model: str, is_two_sided: bool
) -> None:
    for before, after in ports:
        change(configs, MOTOR, before, after)
    add(configs, MOTOR, f"\n[override.model]\n{model}\n")
    spec = next(motor for motor in load(configs).motors if motor.motor_id == MOTOR[7:-5])
    assert spec.settings.model.two_sided is is_two_sided
