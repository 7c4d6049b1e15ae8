/* The watch: leakage and evidence by night, gap changes of the nights' own fits, all nights. */
"use strict";

(() => {
  const { COLOURS, page, style, decode, limits, text, word } = motorLeakage;
  const { DAY_MS, MARKED_NIGHTS, isoDay, places, nights } = motorLeakage.overNights;
  const { overNights, marks, band, line, levelLine, known } = motorLeakage.overNights;

  const course = (packed) => ({
    ...packed,
    look: style(packed.place),
    value: decode(packed.value),
    lower: decode(packed.lower),
    upper: decode(packed.upper),
  });
  const leakage = course({ ...page.leakage, place: 0 });
  const gaps = page.gaps.map(course);
  const flow = decode(page.flow);
  const watch = Object.fromEntries(
    Object.entries(page.watch).map(([name, packed]) => [name, decode(packed)]),
  );
  /* A name within a template of the chart library, in which a percent sign begins a figure. */
  const inTemplate = (name) => text(name).replaceAll("%", "");
  const at = (values, place) => values[place] ?? null;
  const interval = (one, place) => [one.value, one.lower, one.upper].map((part) => at(part, place));
  const percent = (share) => (share === null || share === undefined ? null : 100 * share);
  const signed = (share) =>
    share === null
      ? ""
      : `; drain flow ${share < 0 ? "−" : "+"}${Math.abs(100 * share).toFixed(1)} %`;

  /* The nights of each era's baseline, shaded. */
  const baselines = page.baselines.map(([x0, x1]) => ({
    type: "rect",
    layer: "below",
    x0,
    x1,
    yref: "paper",
    y0: 0,
    y1: 1,
    fillcolor: "#8a949e",
    opacity: 0.18,
    line: { width: 0 },
  }));

  overNights("course-leakage", () => {
    const GREY = { color: "#9aa4ae", dash: "solid", symbol: "circle" };
    const traces = [
      line("drain flow, measured", flow, GREY, {
        mode: "lines",
        line: { color: GREY.color, width: 1.2 },
        hovertemplate: "%{x|%Y-%m-%d}: %{y:.3g} l/min<extra>measured</extra>",
      }),
      band(nights, leakage.lower, leakage.upper, COLOURS.blue, "leakage"),
      line("leakage", leakage.value, leakage.look, {
        text: watch.change.map(signed),
        hovertemplate: "%{x|%Y-%m-%d}: %{y:.4g} l/min%{text}<extra></extra>",
      }),
      levelLine("baseline", nights, watch.level, COLOURS.ink, "dash", 1.2, { hoverinfo: "skip" }),
    ].filter((one) => known(one.y));
    if (!traces.length) return { absent: "No night of this motor has a flow." };
    const all = [...leakage.value, ...leakage.lower, ...leakage.upper, ...flow];
    const lines = marks(true);
    return {
      traces,
      height: 300,
      layout: {
        yaxis: { title: "l/min", range: limits(all, (middle) => 0.15 * middle) },
        shapes: [...baselines, ...lines.shapes],
        annotations: lines.annotations,
      },
      table: {
        columns: [
          "Night",
          "Outcome",
          { name: "Leakage", unit: "l/min" },
          "from",
          "to",
          { name: "Change of the drain flow", unit: "%" },
          "from",
          "to",
          { name: "Drain flow, measured", unit: "l/min" },
        ],
        rows: nights.map((night, place) => [
          night,
          word("statuses", page.statuses[places[place]]),
          ...interval(leakage, place),
          ...["change", "changeLower", "changeUpper"].map((name) => percent(watch[name][place])),
          flow[place],
        ]),
      },
    };
  });

  overNights("course-evidence", () => {
    const { evidence, limit } = watch;
    if (!known(limit)) return { absent: "There is no baseline yet, so there is no evidence." };
    /* Far beyond the limit its size says nothing more, and would hide how it came there. */
    const top = 2.5 * Math.max(...limit);
    return {
      traces: [
        line("evidence", evidence.map((one) => (one === null ? null : Math.min(one, top))), style(0), {
          text: evidence.map((one) => (one === null ? "" : one.toFixed(1))),
          hovertemplate: "%{x|%Y-%m-%d}: ln R %{text}<extra></extra>",
        }),
        levelLine("limit", nights, limit, COLOURS.vermilion, "longdash", 1.5, {
          hovertemplate: "%{x|%Y-%m-%d}: limit %{y:.1f}<extra></extra>",
        }),
      ].filter((one) => known(one.y)),
      height: 190,
      layout: {
        yaxis: { title: "ln R", range: [Math.min(-1, ...evidence), 1.05 * top] },
        shapes: marks(true).shapes,
      },
      table: {
        columns: ["Night", "ln R", "Limit"],
        rows: nights.map((night, place) => [night, evidence[place], limit[place]]),
      },
    };
  });

  overNights("course-gaps", () => {
    if (!gaps.length) return { absent: "No night's own fit tells a gap and has a baseline." };
    const all = gaps.flatMap((one) => [...one.value, ...one.lower, ...one.upper]);
    return {
      traces: gaps.flatMap((one) => [
        band(nights, one.lower, one.upper, one.look.color, one.name),
        line(one.name, one.value, one.look, {
          hovertemplate: `%{x|%Y-%m-%d}: %{y:+.3g} %<extra>${inTemplate(one.name)}</extra>`,
        }),
      ]),
      height: 240,
      layout: {
        yaxis: { title: "change, %", zeroline: true, range: limits([0, ...all], () => 5) },
        shapes: marks().shapes,
      },
      table: {
        columns: ["Night", ...gaps.flatMap((one) => [{ name: one.name, unit: "%" }, "from", "to"])],
        rows: nights.map((night, place) => [
          night,
          ...gaps.flatMap((one) => interval(one, place)),
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
        shapes: marks().shapes,
      },
    };
  });
})();
