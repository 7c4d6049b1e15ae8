/* The first screen: gap changes with their limits, leakage by path, the nights to choose from. */
"use strict";

(() => {
  const { COLOURS, page, style, decode, limits, text, word } = motorLeakage;
  const { DAY_MS, MARKED_NIGHTS, isoDay, places, nights } = motorLeakage.overNights;
  const { overNights, marks, band, line, levelLine, known } = motorLeakage.overNights;

  const { first } = page;
  const course = (packed) => ({
    ...packed,
    look: style(packed.place),
    value: decode(packed.value),
    lower: decode(packed.lower),
    upper: decode(packed.upper),
  });
  const changes = first.changes.map(course);
  const paths = first.paths.map(course);
  const leakage = course(first.leakage);
  const flow = decode(first.flow);
  const levels = Object.entries(first.limits).map(([name, packed]) => [name, decode(packed)]);
  const LEVEL_COLOURS = { warning: COLOURS.orange, alarm: COLOURS.vermilion };
  /* A name within a template of the chart library, in which a percent sign begins a figure. */
  const inTemplate = (name) => text(name).replaceAll("%", "");
  const all = (one) => [...one.value, ...one.lower, ...one.upper];
  const at = (values, place) => values[place] ?? null;
  const interval = (one, place) => [one.value, one.lower, one.upper].map((part) => at(part, place));
  const outcome = (place) => word("statuses", page.statuses[places[place]]);

  function level(name, values) {
    const dash = name === "alarm" ? "longdash" : "dot";
    return levelLine(`level of ${name}`, nights, values, LEVEL_COLOURS[name], dash, 1.5, {
      hovertemplate: `%{x|%Y-%m-%d}: %{y:.3g} %<extra>${name}, ${inTemplate(first.limitsOf)}</extra>`,
    });
  }

  overNights("course-gaps", () => {
    if (!changes.length) return { absent: "No gap has a baseline yet, so no change is known." };
    const lines = changes.flatMap((one) => [
      band(nights, one.lower, one.upper, one.look.color, one.name),
      line(one.name, one.value, one.look, {
        hovertemplate: `%{x|%Y-%m-%d}: %{y:+.3g} %<extra>${inTemplate(one.name)}</extra>`,
      }),
    ]);
    return {
      traces: [...lines, ...levels.map(([name, values]) => level(name, values))],
      height: 260,
      layout: {
        yaxis: {
          title: "change, %",
          zeroline: true,
          range: limits([0, ...changes.flatMap(all), ...levels.flatMap(([, one]) => one)], () => 5),
        },
        ...marks([], first.told),
      },
      table: {
        columns: [
          "Night",
          ...changes.flatMap((one) => [{ name: one.name, unit: "%" }, "from", "to"]),
          ...levels.map(([name]) => ({ name: `Level of ${name}`, unit: "%" })),
        ],
        rows: nights.map((night, place) => [
          night,
          ...changes.flatMap((one) => interval(one, place)),
          ...levels.map(([, values]) => at(values, place)),
        ]),
      },
    };
  });

  /* Layers on one another. Over a silence of more than a week they end, and begin anew; where
     nights are thinned, of more than three of the steps that are left. */
  const SILENCE_MS = DAY_MS * Math.max(7, (21 * page.nights.length) / nights.length - 14);
  function layers() {
    const told = nights.map((_, place) => place).filter((place) => paths[0]?.value[place] != null);
    const days = told.flatMap((place, count) => {
      const before = Date.parse(nights[told[count - 1]]);
      const now = Date.parse(nights[place]);
      return now - before > SILENCE_MS ? [[before + 1], [now - 1], [now, place]] : [[now, place]];
    });
    return paths.map((one) => ({
      type: "scatter",
      mode: "lines",
      stackgroup: "paths",
      name: text(one.name),
      x: days.map(([time]) => new Date(time).toISOString()),
      y: days.map(([, place]) => (place === undefined ? 0 : one.value[place])),
      line: { color: one.look.color, width: 0.5 },
      fillcolor: `${one.look.color}77`,
      hovertemplate: `%{x|%Y-%m-%d}: %{y:.3g} l/min<extra>${inTemplate(one.name)}</extra>`,
    }));
  }

  const GREY = { color: "#9aa4ae", dash: "solid", symbol: "circle" };

  overNights("course-leakage", () => {
    const measured = line("drain flow, measured", flow, GREY, {
      mode: "lines",
      line: { color: GREY.color, width: 1.2 },
      hovertemplate: "%{x|%Y-%m-%d}: %{y:.3g} l/min<extra>measured</extra>",
    });
    const total = [
      band(nights, leakage.lower, leakage.upper, COLOURS.ink, "total"),
      line(paths.length ? "in all" : leakage.name, leakage.value, style(null), {
        hovertemplate: "%{x|%Y-%m-%d}: %{y:.4g} l/min<extra>in all</extra>",
        ...(paths.length ? { mode: "lines" } : {}),
      }),
    ];
    const traces = [measured, ...layers(), ...total].filter((one) => known(one.y));
    if (!traces.length) return { absent: "No night of this motor has a flow." };
    return {
      traces,
      height: 260,
      layout: { yaxis: { title: "l/min", rangemode: "tozero" }, ...marks() },
      table: {
        columns: [
          "Night",
          "Outcome",
          { name: leakage.name, unit: "l/min" },
          "from",
          "to",
          ...(leakage.systematic ? [{ name: "± systematic", unit: "l/min" }] : []),
          ...paths.map((one) => ({ name: one.name, unit: "l/min" })),
          { name: "drain flow, measured", unit: "l/min" },
        ],
        rows: nights.map((night, place) => [
          night,
          outcome(place),
          ...interval(leakage, place),
          ...(leakage.systematic ? [decode(leakage.systematic)[place]] : []),
          ...paths.map((one) => at(one.value, place)),
          flow[place],
        ]),
      },
    };
  });

  /* Every night of the calendar in the colour of its outcome; a click chooses it. */
  const OUTCOMES = {
    ok: COLOURS.green,
    insufficient_data: COLOURS.orange,
    failed: COLOURS.vermilion,
    stood_still: COLOURS.sky,
    no_new_data: "#aab3bd",
  };

  overNights("course-nights", () => {
    const kinds = Object.keys(OUTCOMES);
    const start = Date.parse(page.nights[0]);
    const days = Math.round((Date.parse(page.nights.at(-1)) - start) / DAY_MS) + 1;
    const place = new Map(page.nights.map((night, at) => [night, at]));
    const labels = Array.from({ length: days }, (_, day) => isoDay(start + day * DAY_MS));
    const at = labels.map((night) => place.get(night));
    const status = at.map((one) => page.statuses[one]);
    const said = (code, reason) => `${word("statuses", code)} ${text(reason ?? "")}`;
    const traces = [
      {
        type: "heatmap",
        x: labels,
        y: [0.5],
        z: [status.map((one) => (one === undefined ? null : kinds.indexOf(one)))],
        zmin: -0.5,
        zmax: kinds.length - 0.5,
        colorscale: kinds.flatMap((kind, count) => [
          [count / kinds.length, OUTCOMES[kind]],
          [(count + 1) / kinds.length, OUTCOMES[kind]],
        ]),
        showscale: false,
        xgap: days > MARKED_NIGHTS ? 0 : 2,
        text: [status.map((one, day) => said(one, page.reasons[at[day]]))],
        hovertemplate: "%{x|%Y-%m-%d}: %{text}<extra></extra>",
      },
    ];
    return {
      traces,
      height: 78,
      layout: {
        yaxis: { visible: false, fixedrange: true, range: [0, 1] },
        ...marks(),
        annotations: [],
      },
    };
  });
})();
