"""Make dashboard.json: the metrics of a fleet on a Grafana dashboard.

Needs grafana-foundation-sdk: ``python dashboard.py``. Not tried in a Grafana.
"""

from pathlib import Path

from grafana_foundation_sdk.builders import common, dashboard, prometheus, timeseries
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models.dashboard import DataSourceRef

SOURCE = DataSourceRef(type_val="prometheus", uid="${source}")
OF = "motor_leakage_"
# Title, query, legend, unit.
PANELS = (
    ("Motors by state", f"sum by (state) ({OF}motor_state)", "{{state}}", "short"),
    ("Motors in alarm", f'{OF}motor_state{{state="alarm"}} == 1', "{{motor}}", "short"),
    ("Change tonight", f"{OF}tonight_change_ratio", "{{motor}}", "percentunit"),
    ("Evidence over its limit", f"{OF}evidence / {OF}evidence_limit", "{{motor}}", "percentunit"),
    ("Lack of fit of the model", f"{OF}lack_of_fit_ratio", "{{motor}}", "percentunit"),
    ("Age of the newest data", f"time() - {OF}data_timestamp_seconds", "{{motor}}", "s"),
    ("Last good run", f"time() - {OF}last_good_run_timestamp_seconds", "{{fleet}}", "s"),
    ("Standing failures", f"{OF}standing_failures > 0", "{{motor}}", "short"),
    ("Undelivered changes", f"{OF}undelivered_changes", "{{receiver}}", "short"),
    ("Seconds of the run", f"{OF}stage_duration_seconds", "{{stage}}", "s"),
)


def main() -> None:
    """Write the dashboard beside this file."""
    made = dashboard.Dashboard("Motor leakage").uid("motor-leakage").time("now-90d", "now")
    made = made.with_variable(dashboard.DatasourceVariable("source").type("prometheus"))
    for title, query, legend, unit in PANELS:
        panel = timeseries.Panel().title(title).unit(unit).span(12).height(8).datasource(SOURCE)
        panel = panel.legend(common.VizLegendOptions().show_legend(True))
        target = prometheus.Dataquery().expr(query).legend_format(legend)
        made = made.with_panel(panel.with_target(target))
    text = JSONEncoder(sort_keys=True, indent=1).encode(made.build())
    Path(__file__).with_suffix(".json").write_text(text + "\n", "utf-8")


if __name__ == "__main__":
    main()
