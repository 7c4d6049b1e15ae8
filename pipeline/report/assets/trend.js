/* Trends, alarms and what people said of a motor, where a run has judged its trends. */
"use strict";

(() => {
  const { COLOURS, ABSENT, page, decode, plain, text, format, element, table, word, unit } =
    motorLeakage;
  const { withRemark, probability, menu } = motorLeakage;
  const { DAY_MS, isoDay, overNights, marks, band, levelLine, known } = motorLeakage.overNights;

  const { baselines, change_points: changePoints } = page.trend;
  const indicators = page.trend.indicators.map((one) => ({
    ...one,
    nights: decode(one.days).map((day) => isoDay(day * DAY_MS)),
    state: [...one.states].map((place) => page.trend.order[Number(place)]),
  }));
  const LOOKS = {
    ok: { symbol: "circle", color: COLOURS.green },
    warning: { symbol: "triangle-up", color: COLOURS.orange },
    alarm: { symbol: "triangle-up", color: COLOURS.vermilion },
    common_cause: { symbol: "diamond", color: COLOURS.purple },
  };
  const UNKNOWN = { symbol: "circle-open", color: COLOURS.quiet };
  const look = (state) => LOOKS[state] ?? UNKNOWN;

  /* Shares are shown in percent. */
  const isShare = (one) => one.unit === "1";
  const scaled = (one, packed) =>
    decode(packed).map((value) => (value === null || !isShare(one) ? value : 100 * value));
  const unitOf = (one) => (isShare(one) ? "%" : unit(one.unit));
  const label = (one) => (unitOf(one) ? `${one.name}, ${unitOf(one)}` : one.name);

  function step(one, name, values, colour, dash, yaxis) {
    return levelLine(name, one.nights, values, colour, dash, 1.2, {
      legendgroup: name,
      yaxis,
      hovertemplate: `%{x|%Y-%m-%d}: %{y:.4g}<extra>${name}</extra>`,
    });
  }

  function course(one) {
    const value = scaled(one, one.value);
    return [
      band(one.nights, scaled(one, one.lower), scaled(one, one.upper), COLOURS.blue, "value"),
      {
        type: "scatter",
        mode: "lines+markers",
        name: text(one.name),
        legendgroup: "value",
        x: one.nights,
        y: value,
        connectgaps: false,
        line: { color: COLOURS.blue, width: 1.3 },
        marker: {
          size: 6,
          symbol: one.state.map((state) => look(state).symbol),
          color: one.state.map((state) => look(state).color),
        },
        text: one.state.map((state) => text(plain(state))),
        hovertemplate: "%{x|%Y-%m-%d}: %{y:.4g}, %{text}<extra></extra>",
      },
      step(one, "baseline", scaled(one, one.baseline_mean), COLOURS.ink, "dash"),
      step(one, "level of warning", scaled(one, one.warning_limit), COLOURS.orange, "dot"),
      step(one, "level of alarm", scaled(one, one.alarm_limit), COLOURS.vermilion, "longdash"),
    ];
  }

  /* The figure above, the CUSUM that watches it below. */
  function indicatorChart(one) {
    if (!known(decode(one.value)))
      return { absent: one.latest.gated_reason ?? one.latest.state_reason ?? "No night has it." };
    const cusum = decode(one.cusum);
    const isWatched = known(cusum);
    const traces = course(one);
    const layout = {
      xaxis: { anchor: isWatched ? "y2" : "y" },
      margin: { l: 84, r: 14, t: 26, b: 24 },
      yaxis: { title: text(unitOf(one) || one.name), automargin: true, domain: [isWatched ? 0.36 : 0, 1] },
    };
    if (isWatched) {
      layout.yaxis2 = { title: "CUSUM, sd", domain: [0, 0.26], rangemode: "tozero", nticks: 4 };
      traces.push(
        step(one, "CUSUM", cusum, COLOURS.sky, "solid", "y2"),
        step(one, "its limit", decode(one.cusum_limit), COLOURS.orange, "dashdot", "y2"),
      );
    }
    const lines = marks(changePoints.filter((point) => point.indicator === one.indicator));
    const frozen = baselines.filter((baseline) => baseline.indicator === one.indicator);
    layout.shapes = [
      ...frozen.map((baseline) => ({
        type: "rect",
        layer: "below",
        x0: baseline.start,
        x1: baseline.end,
        yref: "y domain",
        y0: 0,
        y1: 1,
        fillcolor: "#eef1f4",
        line: { width: 0 },
      })),
      ...lines.shapes,
    ];
    layout.annotations = lines.annotations;
    const [value, lower, upper, baseline] = ["value", "lower", "upper", "baseline_mean"].map(
      (name) => scaled(one, one[name]),
    );
    return {
      traces: traces.filter((trace) => trace.y.some((number) => number !== null)),
      layout,
      height: 440,
      table: {
        columns: [
          "Night",
          { name: one.name, unit: unitOf(one) },
          "from",
          "to",
          "Baseline",
          { name: "CUSUM", unit: "sd" },
          "State",
        ],
        rows: one.nights.map((night, at) => [
          night,
          value[at],
          lower[at],
          upper[at],
          baseline[at],
          cusum[at],
          plain(one.state[at]),
        ]),
      },
    };
  }

  function indicatorMenu() {
    const options = indicators.map((one, place) => [
      place,
      `${label(one)}: ${plain(one.latest.state)}`,
    ]);
    const first = indicators.findIndex((one) => known(decode(one.value)));
    const choose = (place) =>
      overNights("trend-course", () => indicatorChart(indicators[Number(place)]));
    menu("trend-course", "Indicator", options, Math.max(first, 0), choose);
    choose(Math.max(first, 0));
  }

  const figure = (content) => element("span", { class: "figure" }, content);

  /* A figure of the newest night with its interval. */
  function withInterval(latest, name, factor = 1) {
    if (latest[name] === undefined) return ABSENT;
    const [value, low, high] = [name, `${name}_lower`, `${name}_upper`].map((key) =>
      latest[key] === undefined ? null : factor * latest[key],
    );
    if (low === null) return format(value, 3);
    return `${format(value, 3)} (${format(low, 3)} to ${high === null ? "no end" : format(high, 3)})`;
  }

  function toLimit({ latest, limitDates }) {
    const status = latest.days_to_limit_status;
    if (limitDates) return limitDates;
    return status === undefined ? ABSENT : word("timesToLimit", status);
  }

  function path({ latest }) {
    if (latest.path === undefined) return latest.path_reason ?? ABSENT;
    const percent = 100 * (latest.path_probability ?? 0);
    const probable =
      latest.path_probability === undefined
        ? ""
        : ` (${percent > 99 ? "over 99" : Math.round(percent)} %)`;
    return plain(latest.path) + probable;
  }

  function indicatorTable() {
    const judged = indicators.filter((one) => one.latest.n_slope !== undefined);
    const rows = judged.map((one) => {
      const { latest } = one;
      const factor = isShare(one) ? 100 : 1;
      const said = [latest.state_reason, latest.gated_reason].filter(Boolean).join("; ");
      const away = latest.deviation_percent;
      return [
        one.name,
        unitOf(one),
        withRemark(plain(latest.state), said),
        figure(away === undefined ? ABSENT : `${away > 0 ? "+" : ""}${format(away, 3)} %`),
        figure(withInterval(latest, "slope_per_year", factor)),
        figure(withInterval(latest, "slope_per_1000_h", factor)),
        figure(probability(latest.q_value)),
        path(one),
        toLimit(one),
      ];
    });
    const names = [
      "Indicator",
      "Unit",
      "State",
      "From baseline",
      "Slope a year",
      "Slope in 1000 h",
      "q of no slope",
      "Path",
      "Days to the limit",
    ];
    return table(names, rows);
  }

  document
    .getElementById("trend-table")
    .append(element("h4", {}, "Indicators in the newest night"), indicatorTable());
  indicatorMenu();
})();
