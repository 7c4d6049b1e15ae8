"""A night's file holds what the tables hold, and shows no height that a placeholder has made."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.config import load_fleet
from pipeline.report.night import night_payloads
from pipeline.report.tables import read_night
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.schema import BLOCK_STATISTICS, PARAMETERS, PREDICTIONS, QUALITY, SENSITIVITIES
from pipeline.store.tables import night_file, read_table
from tests.conftest import OwnFleet
from tests.pipeline.report.conftest import change_table, rows_with, rows_without
from tests.pipeline.report.packed import unpacked

NIGHT = dt.date(2026, 1, 3)
MOTOR = "CB560-02"


def payloads(output: Path) -> dict[str, dict[str, Any]]:
    return dict(night_payloads(NIGHT, read_night(output, NIGHT)))


@pytest.fixture(scope="module")
def fitted(fitted_output: Path) -> dict[str, dict[str, Any]]:
    return payloads(fitted_output)


def rows_of(output: Path, table: Any, motor: str = MOTOR) -> pl.DataFrame:
    return read_table(night_file(output, table, NIGHT), table, [NIGHT]).filter(motor_id=motor)


def test_samples_are_those_of_the_table(fitted: dict[str, Any], fitted_output: Path) -> None:
    samples, rows = fitted[MOTOR]["samples"], rows_of(fitted_output, PREDICTIONS)
    for name, column in {
        "pressure": "pressure_difference_bar",
        "temperature": "oil_temperature_c",
        "speed": "speed_rpm",
        "measured": "measured_l_per_min",
        "predicted": "predicted_l_per_min",
    }.items():
        np.testing.assert_allclose(unpacked(samples[name]), rows[column], rtol=1e-6)
    times = samples["start"] + unpacked(samples["after_ms"]).astype(np.int64)
    assert times.tolist() == rows["time"].dt.epoch("ms").to_list()
    letters = {"training": "t", "validation": "v", "guard": "g"}
    assert samples["part"] == "".join(letters[part] for part in rows["part"])


def test_thinned_samples_hold_the_extremes_of_the_night(fitted_output: Path) -> None:
    """Against the smallest and largest values that the blocks have kept of all samples."""
    for motor in ("CB400-01", MOTOR):
        rows = rows_of(fitted_output, PREDICTIONS, motor)
        blocks = rows_of(fitted_output, BLOCK_STATISTICS, motor)
        assert 500 < rows.height <= 720 < blocks["n"].sum()
        for column, name in (("pressure_difference_bar", "pressure_bar"), ("speed_rpm",) * 2):
            assert rows[column].min() == blocks[f"minimum_{name}"].min()
            assert rows[column].max() == blocks[f"maximum_{name}"].max()


def test_coverage_counts_every_kept_sample_once(
    fitted: dict[str, Any], fitted_output: Path
) -> None:
    coverage, rows = fitted[MOTOR]["coverage"], rows_of(fitted_output, BLOCK_STATISTICS)
    for part in ("training", "validation"):
        n = rows.filter(part=part)["n"].sum()
        assert coverage["n"][part] == n > 0
        for channel in ("pressure", "temperature", "speed"):
            assert sum(coverage[channel][part]) == n
            assert len(coverage[channel]["edges"]) == len(coverage[channel][part]) + 1
    assert coverage["pressure"]["maximum"] == rows["maximum_pressure_bar"].max()
    assert coverage["temperature"]["minimum"] == rows["minimum_temperature_c"].min()
    assert len(coverage["block_parts"]) == rows.height


def test_budget_is_sorted_by_the_size_of_the_effect(
    fitted: dict[str, Any], fitted_output: Path
) -> None:
    budget, rows = fitted[MOTOR]["budget"], rows_of(fitted_output, SENSITIVITIES)
    assert sum(map(len, budget.values())) == rows.height
    for name, sources in budget.items():
        effects = [abs(effect) for *_, effect, _ in sources]
        assert effects == sorted(effects, reverse=True)
        assert {source for source, *_ in sources} == set(rows.filter(indicator=name)["source"])


def test_rules_that_refused_something_are_told(fitted: dict[str, Any], fitted_output: Path) -> None:
    rows = rows_of(fitted_output, QUALITY).filter(
        (pl.col("n_refused") > 0) | (pl.col("n_noted") > 0)
    )
    told = {(channel, rule) for channel, rule, *_ in fitted[MOTOR]["quality"]}
    others = told - set(rows.select("channel", "reason").rows())
    assert told >= set(rows.select("channel", "reason").rows())
    assert {rule for _, rule in others} <= {"any"}
    assert list(fitted) == sorted(f"CB{n}-0{i}" for n in (400, 560, 1120) for i in (1, 2))


def test_modes_of_flushing_are_compared_and_the_primary_one_shown(
    output: Path, fitted: dict[str, Any]
) -> None:
    def also(rows: pl.DataFrame) -> pl.DataFrame:
        other = rows.filter(motor_id=MOTOR).with_columns(flushing_mode=pl.lit("estimated"))
        if "is_primary" in rows.columns:
            other = other.with_columns(is_primary=pl.lit(value=False))
        return pl.concat([rows, other])

    for name in ("fits", "parameters", "starts", "sensitivities", "predictions"):
        change_table(output, name, also, str(NIGHT))
    found = payloads(output)[MOTOR]
    assert [mode["flushing_mode"] for mode in found["modes"]] == ["none", "estimated"]
    assert {**found, "modes": []} == fitted[MOTOR]


HEIGHTS = ("h_", "e_", "film_thickness_ratio_")


def gap_rows(payload: dict[str, Any]) -> list[dict[str, Any]]:
    return [row for row in payload["parameters"] if row["parameter"].startswith(HEIGHTS)]


def figures(row: dict[str, Any]) -> set[str]:
    return row.keys() & {"value", "lower", "upper", "feasible_min", "feasible_max"}


def test_heights_of_a_placeholder_s_geometry_are_not_shown(fitted: dict[str, Any]) -> None:
    for payload in fitted.values():
        gaps = gap_rows(payload)
        assert len(gaps) == 8  # h and Λ of three gaps, e of two
        assert all(row["placeholder"] and not figures(row) for row in gaps)
        factors = [row for row in payload["parameters"] if row["parameter"].startswith("K_")]
        assert len(factors) == 3
        assert all("value" in row for row in factors)


def test_parameters_say_which_rest_on_a_placeholder(own_fleet: OwnFleet) -> None:
    fleet_file = own_fleet("CB400-01")
    for log in sorted((fleet_file.parent.parent / "demo" / "logs" / "CB400-01").iterdir())[1:]:
        log.unlink()
    type_file = fleet_file.parent / "motor_types" / "CB400.toml"
    before, name, after = type_file.read_text("utf-8").partition('name = "piston_ring"')
    known = after.replace('source = "placeholder"', 'source = "drawing 4711"', 1)
    type_file.write_text(before + name + known, "utf-8")
    fleet = load_fleet(fleet_file)
    run_fleet(RunRequest(fleet))
    (path,) = (fleet.output / "tables" / "parameters").rglob("*.parquet")
    marks = dict(read_table(path, PARAMETERS).select("parameter", "geometry_is_placeholder").rows())
    for parameter, is_placeholder in marks.items():
        expected = "piston_ring" not in parameter if parameter.startswith(HEIGHTS) else None
        assert is_placeholder is expected, parameter


def test_heights_of_a_known_geometry_are_shown(output: Path) -> None:
    known = pl.col("parameter").str.ends_with("piston_ring")

    def mark(rows: pl.DataFrame) -> pl.DataFrame:
        return rows.with_columns(geometry_is_placeholder=~known)

    change_table(output, "parameters", mark, str(NIGHT))
    gaps = {row["parameter"]: row for row in gap_rows(payloads(output)[MOTOR])}
    row = rows_of(output, PARAMETERS).filter(parameter="h_piston_ring").to_dicts()[0]
    assert gaps["h_piston_ring"]["value"] == row["value"] > 0
    assert figures(gaps["h_piston_ring"]) >= {"value", "feasible_min", "feasible_max"}
    assert not figures(gaps["h_balance_sleeve"])
    # Schema version 2 did not say whether a geometry is a placeholder.
    change_table(output, "parameters", rows_with(MOTOR, geometry_is_placeholder=None))
    assert not any(figures(row) for row in gap_rows(payloads(output)[MOTOR]))


def test_a_night_without_a_fit_says_why_and_what_was_refused(output: Path) -> None:
    said = {"status": "insufficient_data", "reason": "only 3 % are kept"}
    change_table(output, "fits", rows_with(MOTOR, **said), str(NIGHT))
    for name in ("parameters", "sensitivities", "predictions", "block_statistics"):
        change_table(output, name, rows_without(MOTOR))
    payload = payloads(output)[MOTOR]
    assert payload["fit"].items() >= said.items()
    assert (payload["samples"], payload["coverage"]) == (None, None)
    assert (payload["parameters"], payload["budget"]) == ([], {})
    assert payload["quality"]
    assert payload["files"][0]["path"].startswith(MOTOR)


def test_a_night_of_which_no_table_is_there_is_empty(tmp_path: Path) -> None:
    assert payloads(tmp_path) == {}
