"""The charts of a night and of a fleet, and how Plotly gets them."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.report.charts import residual_chart
from pipeline.report.plotly_json import figure, numbers, script_json
from pipeline.schema import RESIDUAL_TESTS
from pipeline.store.tables import read_table
from tests.pipeline.written import night_file


def test_correlations_of_the_errors_are_drawn_lag_by_lag(fitted_output: Path) -> None:
    path = night_file(fitted_output, RESIDUAL_TESTS, dt.date(2026, 1, 3))
    rows = read_table(path, RESIDUAL_TESTS).filter(motor_id="CB560-02", part="validation")
    chart = residual_chart(rows.to_dicts())
    assert len(chart.panels) == 4
    for panel, row in zip(chart.panels, rows.sort("test", descending=True).to_dicts(), strict=True):
        assert row["verdict"] in panel.title
        first = 51 - len(row["lags_s"])
        drawn = {line.name: line.value[first:] for line in panel.lines}
        assert chart.time[first:].tolist() == row["lags_s"]
        assert drawn["correlation"].tolist() == row["correlations"]
        assert numbers(drawn["to"]) == numbers(np.array(row["bounds"], dtype=np.float64))
    assert figure(chart)["x"][0] == -figure(chart)["x"][-1]
    assert residual_chart([]).panels == ()


def test_what_no_chart_can_show_is_no_number() -> None:
    assert numbers(np.array([1.23456789, np.nan, np.inf, -np.inf])) == [1.23457, None, None, None]
    with pytest.raises(ValueError, match="JSON"):
        script_json({"value": float("nan")})


@given(
    st.text() | st.sampled_from(["</script><img src=x>", "<!--<script>", "]]>", "\u2028", "&lt;"])
)
def test_no_name_ends_the_script_it_stands_in(name: str) -> None:
    text = script_json({name: [name]})
    assert json.loads(text) == {name: [name]}
    assert not set(text) & set("<>&\u2028\u2029")
