"""Make dashboard.json: the metrics of a fleet, and the curve of a motor, on a Grafana dashboard.

Needs grafana-foundation-sdk: ``python dashboard.py``. Not opened in a Grafana: its server is in no
package index that the tests reach.
"""

from pathlib import Path

from grafana_foundation_sdk.builders import common, dashboard, prometheus, timeseries
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models.dashboard import DataSourceRef, DynamicConfigValue

SOURCE = DataSourceRef(type_val="prometheus", uid="${source}")
OF = "motor_leakage_"
OF_MOTOR = '{motor="$motor"}'
# Title, unit, figure, ends of its interval, and levels: the curve of the motor that is chosen.
CURVES = (
    (
        "Leakage of $motor against its baseline",
        "percent",
        ("leakage_change_percent", "leakage_change_lower", "leakage_change_upper"),
        {"alarm level": "alarm_level_percent", "ten nights show": "detection_limit_percent"},
    ),
    (
        "Leakage of $motor at its usual operating point",
        "flowlpm",
        ("own_leakage_l_per_min", "own_leakage_lower", "own_leakage_upper"),
        {},
    ),
)
# Title, query, legend, unit.
PANELS = (
    ("Motors by state", f"sum by (state) ({OF}motor_state)", "{{state}}", "short"),
    ("Motors in alarm", f'{OF}motor_state{{state="alarm"}} == 1', "{{motor}}", "short"),
    ("Evidence over its limit", f"{OF}evidence / {OF}evidence_limit", "{{motor}}", "percentunit"),
    ("Model error", f"{OF}model_error_percent", "{{motor}}", "percent"),
    ("Age of the newest data", f"time() - {OF}data_timestamp_seconds", "{{motor}}", "s"),
    ("Last good run", f"time() - {OF}last_good_run_timestamp_seconds", "{{fleet}}", "s"),
    ("Standing failures", f"{OF}standing_failures > 0", "{{motor}}", "short"),
    ("Undelivered changes", f"{OF}undelivered_changes", "{{receiver}}", "short"),
    ("Seconds of the run", f"{OF}stage_duration_seconds", "{{stage}}", "s"),
)


def panel(title: str, unit: str, *queries: tuple[str, str]) -> timeseries.Panel:
    """A panel of queries, each with its legend."""
    made = timeseries.Panel().title(title).unit(unit).span(12).height(8).datasource(SOURCE)
    made = made.legend(common.VizLegendOptions().show_legend(True))
    for place, (query, legend) in enumerate(queries):
        target = prometheus.Dataquery().expr(query).legend_format(legend).ref_id("ABCDE"[place])
        made = made.with_target(target)
    return made


def curve(
    title: str, unit: str, names: tuple[str, str, str], levels: dict[str, str]
) -> timeseries.Panel:
    """A figure of the motor that is chosen: a band between the ends of its interval, and levels."""
    named = dict(zip(("figure", "lower", "upper"), names, strict=True)) | levels
    queries = [(f"{OF}{name}{OF_MOTOR}", legend) for legend, name in named.items()]
    thin = DynamicConfigValue("custom.lineWidth", 0)
    band = [DynamicConfigValue("custom.fillBelowTo", "lower"), thin]
    dashed = DynamicConfigValue("custom.lineStyle", {"fill": "dash", "dash": [10, 10]})
    made = panel(title, unit, *queries)
    made = made.override_by_name("upper", band).override_by_name("lower", [thin])
    for legend in levels:
        made = made.override_by_name(legend, [dashed])
    return made


def main() -> None:
    """Write the dashboard beside this file."""
    made = dashboard.Dashboard("Motor leakage").uid("motor-leakage").time("now-90d", "now")
    made = made.with_variable(dashboard.DatasourceVariable("source").type("prometheus"))
    motors = dashboard.QueryVariable("motor").datasource(SOURCE)
    made = made.with_variable(motors.query(f"label_values({OF}motor_state, motor)"))
    for described in CURVES:
        made = made.with_panel(curve(*described))
    for title, query, legend, unit in PANELS:
        made = made.with_panel(panel(title, unit, (query, legend)))
    text = JSONEncoder(sort_keys=True, indent=1).encode(made.build())
    Path(__file__).with_suffix(".json").write_text(text + "\n", "utf-8")


if __name__ == "__main__":
    main()
