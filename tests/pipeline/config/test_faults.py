"""Single faults of config files: each is named by file, key, what stands there, what was expected.

A case changes a text of a shipped file, or adds one behind it where nothing is to be replaced.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.pipeline.config.conftest import MOTOR, OIL, SAMPLE, TYPE, Configs

CHANNEL, LAW = "channels.pressure_difference", 'law = "annular_gap"'
DEFORMATION = "deformation_pressure_bar = 120.0"
POINTS = "deformation_points = [[10.0, 8.0, 1.0], [20.0, 8.0, 1.5], [40.0, 8.0, 1.6]]"
RING, ROLLER = (f'path "{name}"' for name in ("piston_ring", "cam_roller"))
BALANCE = 'name = "balance_piston"'
NU, ETA = (f'[channels.{name}_viscosity]\nsource = "{name}"\n' for name in ("kinematic", "dynamic"))
VISCOSITY, AT_100 = "viscosity_40_c_mm2_per_s", "viscosity_100_c_mm2_per_s"
MARCH = "[[events]]\ndate = 2026-03-01\n"
FLEET, MCAP = "fleet.toml", "motors/CB560-01.toml"
FLOW, ON_CHANGE = "[channels.leakage_flow]", 'sampling = "on_change"'
DAY_3, DAY_4 = "2026-01-03T12:00:00", "2026-01-04T12:00:00"
BOTH = f"[[{DAY_3}Z, {DAY_4}Z]]"
DELAY = "override.transport_delay"

Case = tuple[str, str, str, str, str]
"""File, text before (empty: the text is added), text after, key, words of the message."""

CASES: tuple[Case, ...] = (
    # The fleet file
    (FLEET, "", '[nights]\ntime_zone = "Europe/Atlantis"', "nights.time_zone", "IANA"),
    (FLEET, "", '[nights]\ntime_zone = "right/UTC"', "nights.time_zone", "IANA"),
    (FLEET, "", "[smoothing]\nwindow_s = 120.0", "smoothing.window_s", "less than 120"),
    (FLEET, "", "[smothing]\nwindow_s = 1.0", "smothing", "did you mean smoothing?"),
    (FLEET, "", "[defaults]\noyl = 'vg68'", "defaults.oyl", "did you mean oil?"),
    # A channel
    (MOTOR, "resolution = 0.1", "resolutoin = 0.1", f"{CHANNEL}.resolutoin", "spelling"),
    (MOTOR, "resolution = 0.1", "resolution = true", f"{CHANNEL}.resolution", "got true; expected"),
    (MOTOR, "resolution = 0.1", "resolution = nan", f"{CHANNEL}.resolution", "a finite number"),
    (MOTOR, "[-450.0, 450.0]", "[450.0, -450.0]", f"{CHANNEL}.valid_range", "got [450.0, -4"),
    (MOTOR, '"dp_bar"', '"x"\nscale = 0.0', f"{CHANNEL}.scale", "got 0.0; expected a factor"),
    (MOTOR, 'source = "dp_bar"\n', "", f"{CHANNEL}.source", "is missing"),
    (
        MOTOR,
        "[-450.0, 450.0]",
        "[100.0, 450.0]\nsensor_maximum = 90.0",
        f"{CHANNEL}.sensor_maximum",
        "more than the lower end of valid_range",
    ),
    (MOTOR, "[channels.speed]", "[channels.spede]", "channels.spede", "'oil_temperature', 'speed'"),
    # The dialect
    (MOTOR, 'time = "time"', 'time_format = "%d.%m."', "logs.time_format", 'got "%d.%m."'),
    (MOTOR, 'time = "time"', 'encoding = "utf-99"', "logs.encoding", "text encoding"),
    (MOTOR, 'time = "time"', 'encoding = "hex"', "logs.encoding", "text encoding"),
    (MOTOR, 'time = "time"', 'separator = "."', "logs.separator", "than the decimal mark"),
    (MOTOR, 'time = "time"', 'separator = "·"', "logs.separator", "ASCII"),
    (MOTOR, 'time = "time"', 'thousands = "x"', "logs.thousands", "expected one of '.', ',', "),
    (MOTOR, 'time = "time"', 'thousands = ","', "logs.thousands", "decimal mark and the sep"),
    (MCAP, '"publish_time"', '"a..b"', "logs.time", "is no path"),
    (MCAP, 'field = "value"', 'field = "a["', f"{CHANNEL}.field", "is no path"),
    (MOTOR, 'format = "csv"', 'format = "xlsx"', "logs.format", ": csv, mcap, parquet"),
    (MOTOR, '["CB400-01/*.csv"]', "[]", "logs.files", "at least one"),
    # The motor
    (MOTOR, 'motor_id = "CB400-01"', 'motor_id = "CB400-07"', "motor_id", "as the file"),
    (
        MOTOR,
        "[channels.pressure_difference]",
        "[channels.high_port_pressure]",
        "channels",
        "high_port_pressure and low_port_pressure",
    ),
    (
        MOTOR,
        "[channels.speed]",
        '[channels.low_port_pressure]\nsource = "x"\nunit = "bar"\n[channels.speed]',
        "channels",
        "high_port_pressure and low_port_pressure",
    ),
    (MOTOR, "[channels.speed]", "[channels.case_pressure]", "channels", "expected also speed"),
    (MOTOR, "", '[flushing]\nalso = ["none"]', "flushing", "each mode once"),
    (MOTOR, "", '[flushing]\nmode = "maybe"', "flushing.mode", "'none', 'fixed' or 'estimated'"),
    (MOTOR, "", '[[events]]\ndate = 2026-02-30\nkind = "overhaul"', "", "is not TOML"),
    (MOTOR, "", '[[events]]\ndate = 2026-03-01T06:00:00\nkind = "note"', "events.0.date", "got"),
    (MOTOR, "", f'{MARCH}kind = "oil_change"', "events.0.oil", "expected the oil's name"),
    (MOTOR, "", f'{MARCH}kind = "oil_change"\noil = "vg47"', "events.0.oil", 'got "vg47"'),
    (MOTOR, "", f'{MARCH}kind = "note"\noil = "vg46"', "events.0.oil", "a note changes nothing"),
    (MOTOR, "", f'{MARCH}kind = "overhaul"\n' * 1001, "events", "at most 1000"),
    (MOTOR, "", "[override.smoothing]\nwindow = 5.0", "override.smoothing.window", "spelling"),
    (MOTOR, "", "[override.smoothing]\nwindow_s = 500.0", "override.smoothing.window_s", "less"),
    (MOTOR, "", "[override.execution]\nworkers = 99", "override.execution", "is no key"),
    # What a channel's samples are, the drain line, and periods set by hand
    *(
        (MOTOR, FLOW, f"{FLOW}\n{keys}", f"channels.leakage_flow.{key}", words)
        for keys, key, words in (
            ('sampling = "on_change"', "longest_silence_s", "expected a time"),
            ('between = "hold"', "between", "on_change"),
            # The end of the silence after a sample has to be a date.
            (f"{ON_CHANGE}\nlongest_silence_s = 1e12", "longest_silence_s", "less than"),
            ('sampling = "mean"', "mean_of_s", "together with"),
            ("mean_of_s = 10.0", "mean_of_s", "together with"),
            ("volume_per_count_cm3 = 1.0", "volume_per_count_cm3", "together with unit"),
            ("time_offset_s = 3600.0", "time_offset_s", "less than"),
            (f'earlier_units = [["bar", {DAY_4}Z]]', "earlier_units", "expected units of"),
            (f'earlier_units = [["l/h", {DAY_4}]]', "earlier_units.0.1", "timezone"),
            (f'earlier_units = [["l/h", {DAY_4}Z], ["l/s", {DAY_3}Z]]', "earlier_units", "got"),
        )
    ),
    *(
        (MOTOR, "", f"[{DELAY}]\n{keys}", f"{DELAY}{key}", words)
        for keys, key, words in (
            ("fixed_s = 61.0", ".fixed_s", "less than"),
            ("fixed_s = 1.0\nline_volume_l = 0.1", ".fixed_s", "not both"),
        )
    ),
    (MOTOR, "", f"[periods]\ntraining = [[{DAY_4}Z, {DAY_3}Z]]", "periods", "the later"),
    (MOTOR, "", f"[periods]\ntraining = [[{DAY_3}, {DAY_4}]]", "periods.training.0.0", "timezone"),
    (MOTOR, "", f"[periods]\ntraining = {BOTH}\nvalidation = {BOTH}", "periods", "not overlap"),
    # Analyses of the oil, and viscosities in the log
    (MOTOR, "", SAMPLE.replace("46.0", "0.5"), f"oil_samples.0.{VISCOSITY}", "or equal to 2"),
    (MOTOR, "", SAMPLE.replace("46.0", "440.0"), f"oil_samples.0.{VISCOSITY}", "is an event"),
    (MOTOR, "", f"{SAMPLE}{AT_100} = 46.0", f"oil_samples.0.{AT_100}", "less than"),
    (MOTOR, "", SAMPLE.replace("2020", "9998"), "oil_samples.0.date", "a day that has come"),
    (MOTOR, "", SAMPLE + SAMPLE, "oil_samples.1.date", "expected a date after 2020-01-05"),
    (MOTOR, "", f'{NU}unit = "cP"', "channels.kinematic_viscosity.unit", "expected one of mm2/s"),
    (MOTOR, "", f'{NU}unit = "cSt"\n{ETA}unit = "cP"', "channels", "not both"),
    # The motor type and the oil
    (TYPE, 'motor_type = "CB400"', 'motor_type = "CB401"', "motor_type", "as the file"),
    (TYPE, 'source = "placeholder"\n', "", f"{RING} source", "is missing"),
    (TYPE, LAW, 'law = "gap"', f"{RING} law", "'annular_gap', 'speed_curve'"),
    (TYPE, f"{LAW}\n", "", f"{RING} law", "is missing"),
    (TYPE, "minimum = 1.0", "minimum = 9.0", f"{RING} gap_um", "minimum <= value <= maximum"),
    (TYPE, "speed_range_rpm = [0.0, 125.0]", "", ROLLER, "speed_range_rpm, or points"),
    (TYPE, BALANCE, 'name = "piston_ring"', f"{RING} name", "not taken"),
    (TYPE, BALANCE, 'name = "known"', 'path "known" name', "not taken"),
    (TYPE, DEFORMATION, "deformation_points = [[10.0, 8.0, 1.0]]", RING, "3 points"),
    (TYPE, DEFORMATION, POINTS.replace("1.6", "9.0"), RING, "does not close with"),
    (TYPE, DEFORMATION, POINTS.replace("[[10.0", "[[0.0"), RING, "above 0"),
    (TYPE, DEFORMATION, f"{DEFORMATION}\n{POINTS}", RING, "not both"),
    (OIL, "[46.0, 6.8]", "[6.8, 46.0]", "", "do not fall with temperature"),
    (OIL, "density_15_c_kg_per_m3", "density", "density_15_c_kg_per_m3", "is missing"),
)


@pytest.mark.parametrize(("file", "before", "after", "key", "words"), CASES)
def test_a_fault_has_file_key_and_words(
    configs: Configs, file: str, before: str, after: str, key: str, words: str
) -> None:
    if file == FLEET:
        (configs / file).write_text('name = "F"\n', "utf-8")
    if before:
        configs.change(file, before, after)
    else:
        configs.add(file, f"\n{after}\n")
    messages = {(fault.file, fault.key): fault.message for fault in configs.faults()}
    assert words in messages[file, key]


def web_hooks() -> Iterator[tuple[str, str]]:
    """Lines of `[alarms]`, each with a secret, and words of the fault."""
    where = "webhook_url: expected http:// or https:// and a host"
    yield from (
        (f"webhook_url = {url}", where)
        for url in (
            *('"file:///T0KEN"', '"http:/T0KEN"', '"http://h/T0 KEN"', '"http://h/T0KEN\\r\\n"'),
            *('"http://[::1"', '"http://h:T0KEN/"', '"http://h:99999/"', '"h.example/T0KEN"'),
        )
    )
    yield 'webhook_url = "https://me:T0KEN@h/"', "webhook_url: expected no name or password"
    yield 'webhook_url = ["http://h/T0KEN"]', "webhook_url: expected a valid string"
    yield "deadband_percent = 15.0\nwebhook_url = 'http://h/T0KEN'", "is no key of this table"
    yield 'webhook_headers = { "X:" = "T0KEN" }', "webhook_headers: expected names of letters"
    yield 'webhook_headers = { Host = "T0KEN" }', "webhook_headers: expected no Host: the program"
    yield 'webhook_headers = { webhook-id = "T0KEN" }', "expected no webhook-id"
    yield from (
        (f"webhook_headers = {{ X = {value} }}", "webhook_headers: expected printable ASCII")
        for value in ('"$T0KEN"', '"${T0KEN"', '"${1}"', '"T0KENñ"', '"T0\\nKEN"', '""')
    )
    yield 'webhook_secret = "whsec_T0KEN"', "webhook_secret: expected ${NAME}, with the secret in"
    yield 'webhook_secret = "${A}${B}"', "webhook_secret: expected ${NAME}"


@pytest.mark.parametrize(("line", "words"), [*web_hooks()])
def test_a_web_hook_that_cannot_be_posted_to(configs: Configs, line: str, words: str) -> None:
    configs.add(FLEET, f"\n[alarms]\n{line}\n")
    (fault,) = configs.faults()
    assert words in str(fault)
    assert "T0KEN" not in str(fault)


@pytest.mark.parametrize(
    "motor_id", ["../x", "", "..", ".hidden", "-x", "a b", "a\\\\b", "x" * 65, "ü", "a\\n"]
)
def test_ids_that_are_no_file_name(configs: Configs, motor_id: str) -> None:
    configs.change(MOTOR, 'motor_id = "CB400-01"', f'motor_id = "{motor_id}"')
    assert configs.places() == {(MOTOR, "motor_id")}


@pytest.mark.parametrize(
    "pattern",
    [
        *("/etc/passwd", "\\\\\\\\server\\\\x", "a/../../b.csv", "a\\\\..\\\\b.csv", ".."),
        *("", "a/", "a/.", "a\\u0000.csv", "a\\n.csv", "a/**", "a/**b.csv", "a/b**/c.csv"),
        *("é" * 128, "x" * 256 + "/*.csv", "folder/" * 147),
    ],
)
def test_logs_that_leave_the_log_root_or_are_no_files(configs: Configs, pattern: str) -> None:
    configs.change(MOTOR, '["CB400-01/*.csv"]', f'["good/*.csv", "{pattern}"]')
    assert configs.places() == {(MOTOR, "logs.files.1")}


@pytest.mark.parametrize("pattern", ["**/*.csv", "a/[0-9]?.csv", "...csv", "a..b.csv"])
def test_logs_below_the_log_root(configs: Configs, pattern: str) -> None:
    configs.change(MOTOR, "CB400-01/*.csv", pattern)
    assert configs.motor().file.logs.files == (pattern,)


# Files together


def test_all_faults_of_all_files_at_once(configs: Configs) -> None:
    configs.change(MOTOR, 'motor_type = "CB400"', 'motor_type = "CB500"')
    configs.change(MOTOR, 'unit = "bar"', 'unit = "hPa"')
    configs.change(MOTOR, "resolution = 0.1", 'resolution = "fine"')
    configs.change(TYPE, "radius_mm = 35.0", "radius_mm = -35.0")
    configs.change(FLEET, "end_hour = 6", "end_hour = 24")
    (configs / "oils/vg32.toml").write_text("name = \n", encoding="utf-8")
    messages = {(fault.file, fault.key): fault.message for fault in configs.faults()}
    for file, key, words in (
        (MOTOR, "motor_type", 'got "CB500"; expected one of CB1120, CB400, CB560'),
        (MOTOR, f"{CHANNEL}.resolution", 'got "fine"; expected a valid number'),
        (TYPE, f"{RING} radius_mm", "got -35.0; expected greater than 0"),
        (FLEET, "nights.end_hour", "got 24; expected less than or equal to 23"),
        ("oils/vg32.toml", "", "is not TOML"),
    ):
        assert words in messages.pop((file, key))
    # The unit is judged with the other channels, once each channel by itself is sound.
    assert messages.keys() <= {(MOTOR, f"{CHANNEL}.unit")}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"motor_id = 'a'\nmotor_id = 'b'", "is not TOML"),
        ("motor_id = 'ü'".encode("latin-1"), "is not UTF-8"),
        ("motor_id = 'a'".encode("utf-16"), "is not UTF-8"),
        (b"a = " + b"[" * 100_000, "is not TOML"),
        (b"a = " + b"9" * 10_000, "is not TOML"),
        (b".".join([b"a"] * 1500) + b" = 1", "is not TOML"),
    ],
)
def test_a_file_that_is_no_toml_leaves_the_others_judged(
    configs: Configs, content: bytes, words: str
) -> None:
    (configs / MOTOR).write_bytes(content)
    configs.change("motors/CB400-02.toml", 'oil = "vg68"', 'oil = "vg100"')
    messages = {fault.file: fault.message for fault in configs.faults()}
    assert messages.keys() == {MOTOR, "motors/CB400-02.toml"}
    assert words in messages[MOTOR]


def test_files_with_a_name_that_is_no_id(configs: Configs) -> None:
    for file in (MOTOR, TYPE):
        (configs / file).rename((configs / file).with_name("-rf *.toml"))
    files = {file for file, _ in configs.places()}
    assert {f"{kind}/-rf *.toml" for kind in ("motors", "motor_types")} <= files


def test_reference_conditions_beyond_the_oil(configs: Configs) -> None:
    configs.change(OIL, "[46.0, 6.8]", "[1.2, 0.3]")
    configs.change(FLEET, "temperature_c = 50.0", "temperature_c = 149.0")
    configs.change(MOTOR, 'oil = "vg68"', 'oil = "vg46"')
    (fault,) = configs.faults()
    assert (fault.file, "vg46" in fault.message) == (MOTOR, True)


@pytest.mark.parametrize("fault", ["another motor's", "another channel's"])
def test_a_column_is_of_one_channel_of_one_motor(configs: Configs, fault: str) -> None:
    if fault == "another motor's":
        text = (configs / MOTOR).read_text("utf-8").replace("CB400-01", "CB400-03", 1)
        (configs / "motors" / "CB400-03.toml").write_text(text, "utf-8")
        assert configs.places() == {("motors/CB400-03.toml", "channels.leakage_flow.source")}
    else:
        configs.change(MOTOR, '"speed_rpm"', '"drain_flow_lpm"')
        assert configs.places() == {(MOTOR, "channels.leakage_flow.source")}


def test_a_circuit_is_one_of_a_motor_and_has_the_only_analyses(configs: Configs) -> None:
    for name in ("winch", "wench"):
        configs.add(f"oil_circuits/{name}.toml", SAMPLE)
    configs.add("motors/CB1120-01.toml", SAMPLE)
    assert configs.places() == {
        ("oil_circuits/wench.toml", ""),
        ("motors/CB1120-01.toml", "oil_samples"),
    }


def test_an_oil_with_a_fault_is_reported_beside_its_analyses(configs: Configs) -> None:
    configs.change("oils/vg68.toml", "density_15_c_kg_per_m3", "density")
    configs.add(MOTOR, SAMPLE)
    assert {file for file, _ in configs.places()} == {"oils/vg68.toml"}


def test_a_motors_file_that_is_no_toml_leaves_its_circuit_alone(configs: Configs) -> None:
    configs.add("oil_circuits/winch.toml", SAMPLE)
    for name in ("CB1120-01", "CB1120-02"):
        configs.add(f"motors/{name}.toml", "broken =")
    assert {file[:13] for file, _ in configs.places()} == {"motors/CB1120"}
