/* Figures of each night's own fit: one over the nights, all of the newest night in a table. */
"use strict";

(() => {
  const { COLOURS, ABSENT, page, decode, text, format, element, table, word, unit, menu } =
    motorLeakage;
  const { DAY_MS, isoDay, overNights, marks, band } = motorLeakage.overNights;

  const SLOPE = ["slope_per_year", "slope_per_year_lower", "slope_per_year_upper"];
  /* Shares are shown in percent. */
  const figures = page.shown.map((one) => {
    const factor = one.unit === "1" ? 100 : 1;
    const column = (name) =>
      decode(one[name]).map((value) => (value === null ? null : factor * value));
    return {
      ...one,
      unit: one.unit === "1" ? "%" : unit(one.unit),
      nights: decode(one.days).map((day) => isoDay(day * DAY_MS)),
      value: column("value"),
      lower: column("lower"),
      upper: column("upper"),
      slope: SLOPE.map((name) => one.latest[name] && factor * one.latest[name]),
    };
  });

  const chart = (one) => ({
    traces: [
      band(one.nights, one.lower, one.upper, COLOURS.blue, "value"),
      {
        type: "scatter",
        mode: "lines+markers",
        x: one.nights,
        y: one.value,
        connectgaps: false,
        line: { color: COLOURS.blue, width: 1.3 },
        marker: { size: 4, color: COLOURS.blue },
        hovertemplate: "%{x|%Y-%m-%d}: %{y:.4g}<extra></extra>",
      },
    ],
    layout: {
      margin: { l: 84, r: 14, t: 26, b: 24 },
      yaxis: { title: text(one.unit || one.name), automargin: true },
      showlegend: false,
      ...marks(),
    },
    table: {
      columns: ["Night", { name: one.name, unit: one.unit }, "from", "to"],
      rows: one.nights.map((night, at) => [night, one.value[at], one.lower[at], one.upper[at]]),
    },
  });

  const choose = (place) => overNights("shown-course", () => chart(figures[Number(place)]));
  menu("shown-course", "Figure", figures.map((one, place) => [place, one.name]), 0, choose);
  choose(0);

  const cell = (words) => element("span", { class: "figure" }, words);
  const newest = (one) => one.value.findLast((value) => value !== null);
  const slope = ([value, lower, upper]) =>
    value === undefined
      ? ABSENT
      : `${format(value, 3)} (${format(lower, 3)} to ${format(upper, 3)})`;
  document.getElementById("shown-table").append(
    table(
      ["Figure", "Unit", "Newest", "Slope a year", "To its limit"],
      figures.map((one) => [
        one.name,
        one.unit,
        cell(format(newest(one))),
        cell(slope(one.slope)),
        one.limitDates || (word("timesToLimit", one.latest.days_to_limit_status) || ABSENT),
      ]),
    ),
  );
})();
