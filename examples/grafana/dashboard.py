"""Make dashboard.json: the metrics of a fleet on a Grafana dashboard.

Needs grafana-foundation-sdk: ``python dashboard.py``.
"""

from pathlib import Path

from grafana_foundation_sdk.builders import dashboard, prometheus, stat, timeseries
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models.dashboard import DataSourceRef

SOURCE = DataSourceRef(type_val="prometheus", uid="${source}")
WIDE, HALF = 24, 12
# Kind, title, query, legend, unit, width.
PANELS = (
    (
        stat,
        "Motors by state",
        "sum by (state) (motor_leakage_motor_state)",
        "{{state}}",
        "short",
        WIDE,
    ),
    (
        timeseries,
        "Motors in alarm",
        'motor_leakage_motor_state{state="alarm"} == 1',
        "{{motor}}",
        "short",
        HALF,
    ),
    (
        timeseries,
        "Largest gap change",
        "motor_leakage_gap_change_ratio",
        "{{motor}} {{path}}",
        "percentunit",
        HALF,
    ),
    (
        timeseries,
        "Age of the newest data",
        "time() - motor_leakage_data_timestamp_seconds",
        "{{motor}}",
        "s",
        HALF,
    ),
    (
        timeseries,
        "Age of the last good run",
        "time() - motor_leakage_last_good_run_timestamp_seconds",
        "{{fleet}}",
        "s",
        HALF,
    ),
    (
        timeseries,
        "Failed nights of the last run",
        "motor_leakage_failed_nights > 0",
        "{{motor}}",
        "short",
        HALF,
    ),
    (
        timeseries,
        "Undelivered changes of state",
        "motor_leakage_undelivered_changes",
        "{{receiver}}",
        "short",
        HALF,
    ),
    (
        timeseries,
        "Seconds by stage",
        "motor_leakage_stage_duration_seconds",
        "{{stage}}",
        "s",
        WIDE,
    ),
)


def main() -> None:
    """Write the dashboard beside this file."""
    made = dashboard.Dashboard("Motor leakage").uid("motor-leakage").time("now-90d", "now")
    made = made.with_variable(dashboard.DatasourceVariable("source").type("prometheus"))
    for kind, title, query, legend, unit, width in PANELS:
        target = prometheus.Dataquery().expr(query).legend_format(legend)
        panel = kind.Panel().title(title).unit(unit).span(width).height(8).datasource(SOURCE)
        made = made.with_panel(panel.with_target(target))
    text = JSONEncoder(sort_keys=True, indent=1).encode(made.build())
    Path(__file__).with_suffix(".json").write_text(text + "\n", "utf-8")


if __name__ == "__main__":
    main()
