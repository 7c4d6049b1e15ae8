"""No column is null in every row: a fleet to which what is rare happens, beside shared fleets."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import polars as pl

from leakage.physics.oil import kinematic_viscosity_mm2_per_s
from pipeline.demo.writing import write_demo
from pipeline.schema import LATEST, NIGHTS, TABLES
from tests.pipeline.calling import without_workers
from tests.scenarios.fleets import ScenarioFleet, Simulated, make_fleet, step

NIGHT = 10
# Three motors of a tank: gaps of the first open in night 9; the second logs the viscosity; the
# third has charge pressure, from night 9 on an oil that nobody states, and a torn newest log.
RARE = (
    Simulated("M1", step(at=9, gap=0.12), format="csv", circuit="tank"),
    Simulated("M2", circuit="tank"),
    Simulated(
        "M3",
        unstated_oil=(9, "vg46"),
        circuit="tank",
        lines='[channels.charge_pressure]\nconstant = 12.0\nunit = "bar"\n',
    ),
)
LIMITS = "\n[limits]\nwarning_l_per_min = 7.0\nalarm_l_per_min = 8.0\n"


class Filled(defaultdict[str, set[str]]):
    """Columns with a value in some row, by table."""

    def add(self, output: Path) -> None:
        """Add those of an output as it is now."""
        for table in TABLES:
            for path in (output / "tables" / table.name).rglob("*.parquet"):
                rows = pl.read_parquet(path, hive_partitioning=False)
                counts = rows.null_count().row(0, named=True)
                self[table.name] |= {name for name, n in counts.items() if n < rows.height}


def add_viscosity(fleet: ScenarioFleet) -> None:
    """Have the second motor's logs say how thick the oil is: a tenth thinner than new."""
    oil = fleet.truth().specs["M2"].oils["vg68"].oil()
    for number in range(1, NIGHT + 1):
        rows = pl.read_parquet(fleet.log("M2", number))
        celsius = rows["oil_temperature"].clip(0.0, 100.0).to_numpy()  # a sensor may spike
        viscosity = 0.9 * kinematic_viscosity_mm2_per_s(celsius, oil.walther_a, oil.walther_b)
        rows.with_columns(viscosity=viscosity).write_parquet(fleet.log("M2", number))
    channel = '[channels.kinematic_viscosity]\nsource = "viscosity"\nunit = "mm2/s"'
    fleet.append("motors/M2.toml", channel)


def test_every_column_has_a_value_somewhere(
    demo: ScenarioFleet, others: ScenarioFleet, fitted_output: Path, tmp_path: Path
) -> None:
    filled = Filled(set)
    for output in (demo.output, others.output, fitted_output):
        filled.add(output)
    # A night with halts enough for an interval of the sensors' zeros.
    long = ScenarioFleet(tmp_path / "long")
    write_demo(long.folder, nights=1, minutes=120, rate_hz=1.0, motors=("CB400-01",))
    without_workers(long.config)
    filled.add(long.fitted("--motors", "CB400-01").output)
    fleet = make_fleet(tmp_path / "rare", *RARE, nights=NIGHT)
    fleet.append("motor_types/CB400.toml", LIMITS)
    add_viscosity(fleet)
    fleet.log("M3", NIGHT).write_bytes(b"torn")
    assert fleet.run("fit-fleet").code == 1
    fleet.run("ack", "M1", "--note", "ordered")
    fleet.run("ack", "M1", "--note", "as feared", "--finding", "confirmed")
    parts = ("--opened", "2026-01-11", "--worn", "balance_sleeve", "--sound", "piston ring")
    fleet.run("ack", "M1", "--note", "scored", *parts)
    fleet.run("status")
    # A rise within the next day, which the night confirms, and a damaged file.
    for motor, rise in (("M1", 0.4), ("M3", 0.0)):
        fleet.write_night(motor, NIGHT + 1, until=35, rise=rise, rise_at=30)
    fleet.run("look")
    fleet.write_night("M1", NIGHT + 1, rise=0.4, rise_at=30)
    next((fleet.output / "tables" / "trends").rglob("*.parquet")).unlink()
    assert fleet.run("fit-fleet").code == 1
    filled.add(fleet.output)
    # The logs of the change were wrong.
    sound = replace(fleet, motors={"M1": Simulated("M1", format="csv")})
    for number in range(9, NIGHT + 2):
        sound.write_night("M1", number)
    fleet.run("fit-fleet")
    filled.add(fleet.output)
    copied = set(NIGHTS.schema)
    empty = {
        f"{table.name}.{name}"
        for table in TABLES
        for name in table.schema
        if name not in filled[table.name] and not (table is LATEST and name in copied)
    }
    assert empty == set(), sorted(empty)
