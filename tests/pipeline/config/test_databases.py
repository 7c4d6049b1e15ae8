"""`[logs.database]`: its faults, and what motors have in common."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.config import ConfigError, load_fleet
from pipeline.logs.landing import nightly_query
from tests.pipeline.plant_database import FILES, QUERY, logs_toml
from tests.pipeline.postgres_server import SECRET
from tests.pipeline.simulated import CANONICAL, motor_toml, write_configs
from tests.pipeline.workshop import MINI, QUICK


def test_forty_motors_of_one_table_are_one_line_each(tmp_path: Path) -> None:
    shared = (
        'name = "Mill"\n[defaults]\nmotor_type = "MINI"\noil = "vg68"\n[defaults.logs]\n'
        + logs_toml(QUERY.replace(" *", "\t*"))
    ).replace("[logs.database]", "[defaults.logs.database]")
    channels = "".join(
        f'[defaults.channels.{name}]\nsource = "{{name_in_log}}_{name}"\nunit = "{unit}"\n'
        for name, unit in CANONICAL.items()
    )
    motors = {f"W{number}": f'motor_id = "W{number}"\n' for number in range(40)}
    fleet = load_fleet(write_configs(tmp_path, motors, {"MINI": MINI}, shared + channels))
    assert not fleet.has_log_folder
    queries = [nightly_query(spec) for spec in fleet.motors]
    assert '"W7_leakage_flow"' in queries[[one.motor_id for one in fleet.motors].index("W7")]
    assert len(set(queries)) == 40
    elsewhere = fleet.at_output(tmp_path / "private")
    assert elsewhere.motors[0].log_root == tmp_path / "private" / "landed" / "W0"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (logs_toml().replace("{end}", ""), "expected the marks {start} and {end}"),
        (logs_toml("DELETE FROM log {start} {end}"), "begins with SELECT or WITH"),
        (
            logs_toml(more=f'connection = "postgresql://me:{SECRET}@h/d"\n'),
            "logs.database.connection: expected ${NAME}",
        ),
        (logs_toml(logs='files = ["*.csv"]\n'), 'expected no files with format = "sql"'),
        (logs_toml(logs='layout = "file_per_channel"\n'), 'expected "wide" or "long"'),
        ('format = "sql"\n', "logs.database: expected together with"),
        ('format = "csv"\n', "logs.files: got []; expected at least one"),
    ],
)
def test_faults_of_a_database_in_a_config(tmp_path: Path, text: str, fault: str) -> None:
    motor = motor_toml("M1", "MINI").replace(FILES, text)
    with pytest.raises(ConfigError) as raised:
        load_fleet(write_configs(tmp_path, {"M1": motor}, {"MINI": MINI}, QUICK))
    assert fault in raised.value.message
    assert SECRET not in raised.value.message
