/* Trends and alarms of a motor, where a run has left such tables. */
"use strict";

(() => {
  const { COLOURS, page, decode, plain, text, format, element, table, show, unit } = motorLeakage;
  const { open, marks, band } = motorLeakage.overNights;

  const { indicators, alarms, baselines, change_points: changePoints } = page.trend;
  const STATE_SYMBOLS = {
    ok: "circle",
    warning: "triangle-up",
    alarm: "triangle-up",
    common_cause: "diamond",
    stale: "circle-open",
    insufficient: "circle-open",
  };
  const STATE_COLOURS = {
    ok: COLOURS.green,
    warning: COLOURS.orange,
    alarm: COLOURS.vermilion,
    common_cause: COLOURS.purple,
  };

  function indicatorChart(one) {
    const value = decode(one.value);
    const [lower, upper] = [decode(one.lower), decode(one.upper)];
    const ownUnit = unit(one.unit);
    const step = (name, packed, colour, dash) => ({
      type: "scatter",
      mode: "lines",
      name,
      legendgroup: name,
      x: one.nights,
      y: decode(packed),
      line: { color: colour, width: 1.2, dash, shape: "hv" },
      hovertemplate: `%{x|%Y-%m-%d}: %{y:.4g}<extra>${name}</extra>`,
    });
    const traces = [];
    if (lower.length) traces.push(band(one.nights, lower, upper, COLOURS.blue, "value"));
    traces.push({
      type: "scatter",
      mode: "lines+markers",
      name: text(plain(one.indicator)),
      legendgroup: "value",
      x: one.nights,
      y: value,
      connectgaps: false,
      line: { color: COLOURS.blue, width: 1.3 },
      marker: {
        size: 6,
        symbol: one.state.map((state) => STATE_SYMBOLS[state] ?? "circle"),
        color: one.state.map((state) => STATE_COLOURS[state] ?? COLOURS.quiet),
      },
      text: one.state.map((state) => text(plain(state ?? ""))),
      hovertemplate: "%{x|%Y-%m-%d}: %{y:.4g}, %{text}<extra></extra>",
    });
    if (one.baseline_mean) traces.push(step("baseline", one.baseline_mean, COLOURS.ink, "dash"));
    if (one.warning_limit)
      traces.push(step("warning", one.warning_limit, COLOURS.orange, "dashdot"));
    if (one.alarm_limit) traces.push(step("alarm", one.alarm_limit, COLOURS.vermilion, "longdash"));
    const frozen = baselines.filter(
      (baseline) => baseline.indicator === one.indicator && baseline.start && baseline.end,
    );
    const lines = marks(changePoints.filter((point) => point.indicator === one.indicator));
    return {
      traces,
      height: 360,
      onClick: open,
      layout: {
        xaxis: { type: "date" },
        yaxis: { exponentformat: "power", title: ownUnit ? `${plain(one.indicator)}, ${ownUnit}` : plain(one.indicator) },
        shapes: [
          ...frozen.map((baseline) => ({
            type: "rect",
            layer: "below",
            x0: baseline.start,
            x1: baseline.end,
            yref: "paper",
            y0: 0,
            y1: 1,
            fillcolor: "#eef1f4",
            line: { width: 0 },
          })),
          ...lines.shapes,
        ],
        annotations: lines.annotations,
      },
      table: {
        columns: ["Night", { name: plain(one.indicator), unit: ownUnit }, "Baseline", "State"],
        rows: one.nights.map((night, at) => [
          night,
          value[at],
          decode(one.baseline_mean)[at],
          plain(one.state[at] ?? ""),
        ]),
      },
    };
  }

  if (indicators.length) {
    const select = element(
      "select",
      { "aria-label": "Indicator" },
      ...indicators.map((one, place) => element("option", { value: place }, plain(one.indicator))),
    );
    const worst = ["alarm", "warning", "common_cause"]
      .map((state) => indicators.findIndex((one) => one.latest.state === state))
      .find((place) => place >= 0);
    select.value = String(
      worst ??
        Math.max(
          indicators.findIndex((one) => one.indicator === "reference_leakage"),
          0,
        ),
    );
    const controls = document.querySelector("#trend-course .controls");
    controls.append(element("label", {}, "Indicator ", select));
    controls.hidden = false;
    const chosen = () =>
      show("trend-course", () => indicatorChart(indicators[Number(select.value)]));
    select.addEventListener("change", chosen);
    chosen();
    const range = (latest, name) =>
      latest[name] === undefined
        ? null
        : `${format(latest[name], 3)}${latest[`${name}_lower`] === undefined ? "" : ` (${format(latest[`${name}_lower`], 3)} to ${format(latest[`${name}_upper`], 3)})`}`;
    document.getElementById("trend-table").append(
      table(
        [
          "Indicator",
          "Unit",
          "State",
          "Slope a year",
          "Slope in 1000 h",
          "q",
          "Path",
          "Days to limit",
          "Note",
        ],
        indicators.map((one) => {
          const last = one.latest;
          const path = last.path
            ? `${plain(last.path)}${last.path_probability === undefined ? "" : ` (${Math.round(100 * last.path_probability)} %)`}`
            : null;
          const toLimit =
            range(last, "days_to_limit") ??
            (last.days_to_limit_status ? plain(last.days_to_limit_status) : null);
          return [
            plain(one.indicator),
            unit(one.unit),
            plain(last.state ?? ""),
            range(last, "slope_per_year"),
            range(last, "slope_per_1000_h"),
            last.q_value ?? null,
            path,
            toLimit,
            [last.provisional ? "provisional" : "", last.gated_reason ?? ""]
              .filter(Boolean)
              .join("; ") || null,
          ];
        }),
      ),
    );
    if (alarms.length) {
      document.getElementById("alarm-table").append(
        element("h3", {}, "Changes of state"),
        table(
          ["Time", "Indicator", "From", "To", "Why"],
          [...alarms]
            .reverse()
            .map((alarm) => [
              String(alarm.time).slice(0, 16).replace("T", " "),
              plain(alarm.indicator),
              plain(alarm.from_state ?? ""),
              plain(alarm.to_state ?? ""),
              alarm.reason ?? "",
            ]),
        ),
      );
    }
  }
})();
