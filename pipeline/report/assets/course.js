/* A motor over its nights: leakage, paths, gaps, fit, conditions, and trends where there are any. */
"use strict";

(() => {
  const { COLOURS, page, style, decode, limits, plain, text, format, element, table, show, word, unit } = motorLeakage;

  const places = decode(page.plotted);
  const nights = places.map((place) => page.nights[place]);
  const statuses = places.map((place) => page.statuses[place]);
  const course = (packed) => ({
    value: decode(packed.value),
    lower: decode(packed.lower),
    upper: decode(packed.upper),
    systematic: decode(packed.systematic),
  });
  const reference = course(page.reference);
  const own = course(page.own);
  const known = (values) => values.some((value) => value !== null);

  const open = (event) => motorLeakage.chooseNight(String(event.points[0].x).slice(0, 10));

  /* Events that start a new baseline, and change points, as lines over the whole height. */
  function marks(changePoints = []) {
    const dated = [
      ...page.events.map((event) => ({
        date: event.date,
        label: word("events", event.kind) + (event.note ? `: ${event.note}` : ""),
        colour: COLOURS.ink,
        dash: "solid",
      })),
      ...changePoints.map((point) => ({
        date: point.night,
        label: `change point${point.model ? ` (${plain(point.model)})` : ""}`,
        colour: COLOURS.purple,
        dash: "dot",
      })),
    ];
    return {
      shapes: dated.map((one) => ({
        type: "line", x0: one.date, x1: one.date, yref: "paper", y0: 0, y1: 1,
        line: { color: one.colour, width: 1, dash: one.dash },
      })),
      annotations: dated.map((one) => ({
        x: one.date, yref: "paper", y: 1, yanchor: "top", xanchor: "left", showarrow: false,
        text: text(one.label.slice(0, 60)), font: { size: 11, color: one.colour }, bgcolor: "rgba(255,255,255,0.8)",
      })),
    };
  }

  /* A stretch of an interval as a closed band; one trace for each, so that gaps stay gaps. */
  function band(x, lower, upper, colour, group) {
    const outline = { x: [], y: [] };
    let stretch = [];
    const close = () => {
      if (stretch.length === 1) {
        /* One night alone has an upright line. */
        const at = stretch[0];
        outline.x.push(x[at], x[at], null);
        outline.y.push(lower[at], upper[at], null);
      } else if (stretch.length > 1) {
        const back = [...stretch].reverse();
        outline.x.push(...stretch.map((at) => x[at]), ...back.map((at) => x[at]), x[stretch[0]], null);
        outline.y.push(...stretch.map((at) => upper[at]), ...back.map((at) => lower[at]), upper[stretch[0]], null);
      }
      stretch = [];
    };
    x.forEach((_, at) => {
      if (lower[at] === null || upper[at] === null || lower[at] === undefined) close();
      else stretch.push(at);
    });
    close();
    return {
      type: "scatter", mode: "lines", ...outline, fill: "toself", fillcolor: `${colour}33`,
      line: { color: `${colour}55`, width: 1 }, hoverinfo: "skip", showlegend: false, legendgroup: group,
    };
  }

  function line(name, values, look, extra = {}) {
    return {
      type: "scatter", mode: "lines+markers", name: text(name), x: nights, y: values, legendgroup: name,
      line: { color: look.color, width: 1.5, dash: look.dash },
      marker: { color: look.color, size: 5, symbol: look.symbol },
      connectgaps: false, ...extra,
    };
  }

  const interval = (figure, at) => [figure.value[at], figure.lower[at], figure.upper[at]];

  show("course-leakage", () => {
    if (!known(reference.value) && !known(own.value)) return { absent: "No night of this motor has a leakage: none was fitted, or its logs determine none." };
    const traces = [];
    if (known(reference.value)) {
      traces.push(band(nights, reference.lower, reference.upper, COLOURS.blue, "reference"));
      traces.push(line("at reference conditions", reference.value, style(0), { hovertemplate: "%{x|%Y-%m-%d}: %{y:.4g} l/min<extra>reference</extra>" }));
    }
    if (known(own.value)) {
      const only = traces.length === 0;
      const visible = only ? true : "legendonly";
      traces.push({ ...band(nights, own.lower, own.upper, COLOURS.quiet, "own"), visible });
      traces.push(line("at the night's own conditions", own.value, { color: COLOURS.quiet, dash: "dash", symbol: "square" }, { visible, legendgroup: "own", hovertemplate: "%{x|%Y-%m-%d}: %{y:.4g} l/min<extra>own conditions</extra>" }));
    }
    const missing = nights.map((_, at) => at).filter((at) => statuses[at] !== "ok");
    if (missing.length) {
      traces.push({
        type: "scatter", mode: "markers", name: "no fit", x: missing.map((at) => nights[at]), y: missing.map(() => 0.02), yaxis: "y2",
        text: missing.map((at) => text(`${word("statuses", statuses[at])}: ${page.reasons[places[at]] ?? ""}`.slice(0, 120))),
        hovertemplate: "%{x|%Y-%m-%d}: %{text}<extra></extra>",
        marker: { color: COLOURS.vermilion, symbol: "x-thin-open", size: 7, line: { width: 1.5 } },
      });
    }
    return {
      traces,
      height: 340,
      onClick: open,
      layout: {
        xaxis: { type: "date" },
        yaxis: { title: "leakage, l/min", range: known(reference.value) ? limits([...reference.value, ...reference.lower, ...reference.upper], (middle) => 0.05 * Math.abs(middle)) : limits([...own.value, ...own.lower, ...own.upper], (middle) => 0.05 * Math.abs(middle)) },
        yaxis2: { overlaying: "y", range: [0, 1], visible: false, fixedrange: true },
        ...marks(),
      },
      table: {
        columns: ["Night", "Outcome", { name: "Reference leakage", unit: "l/min" }, "lower", "upper", { name: "± systematic", unit: "l/min" }, { name: "At own conditions", unit: "l/min" }, "lower", "upper"],
        rows: nights.map((night, at) => [night, word("statuses", statuses[at]), ...interval(reference, at), reference.systematic[at], ...interval(own, at)]),
      },
    };
  });

  /* Several named courses in one chart, each in a style of its own. */
  function family(id, packed, { title, digits, absent, reach, name = plain }) {
    show(id, () => {
      const courses = packed.map((one) => ({ name: name(one.name), ...course(one) })).filter((one) => known(one.value));
      if (!courses.length) return { absent };
      return {
        traces: courses.flatMap((one, place) => {
          const look = style(place);
          return [band(nights, one.lower, one.upper, look.color, one.name), line(one.name, one.value, look, { hovertemplate: `%{x|%Y-%m-%d}: %{y:.${digits}g}<extra>${text(one.name).replaceAll("%", "")}</extra>` })];
        }),
        height: 340,
        onClick: open,
        layout: { xaxis: { type: "date" }, yaxis: { title, zeroline: true, zerolinecolor: COLOURS.quiet, range: limits([0, ...courses.flatMap((one) => [...one.value, ...one.lower, ...one.upper])], () => reach) }, ...marks() },
        table: {
          columns: ["Night", ...courses.flatMap((one) => [{ name: one.name, unit: title.split(", ").pop() }, "lower", "upper"])],
          rows: nights.map((night, at) => [night, ...courses.flatMap((one) => interval(one, at))]),
        },
      };
    });
  }

  family("course-paths", page.paths, {
    title: "leakage, l/min", digits: 3, reach: 0,
    absent: "No night's logs tell the paths apart: the motor runs at one pressure, or the reference conditions lie outside what its nights cover.",
  });
  family("course-gaps", page.gaps, {
    title: "gap change, %", digits: 3, reach: 5,
    absent: "No night's logs determine the loss factor of a single gap, so no change can be told.",
  });

  const nightly = Object.fromEntries(Object.entries(page.nightly).map(([name, packed]) => [name, decode(packed)]));

  show("course-fit", () => {
    const shown = [
      ["on training data", "training_fit", style(0)],
      ["on validation data", "validation_fit", style(1)],
      ["of the model before", "previous_fit", style(2)],
    ].filter(([, key]) => known(nightly[key]));
    if (!shown.length) return { absent: "No night of this motor has a fit." };
    const smallest = Math.min(...shown.flatMap(([, key]) => nightly[key].filter((value) => value !== null)));
    return {
      traces: shown.map(([name, key, look]) => line(name, nightly[key], look, { hovertemplate: `%{x|%Y-%m-%d}: %{y:.1f} %<extra>${name}</extra>` })),
      onClick: open,
      layout: { xaxis: { type: "date" }, yaxis: { title: "fit, %", range: [Math.max(Math.min(smallest - 3, 60), -50), 101] }, ...marks() },
      table: {
        columns: ["Night", ...shown.map(([name]) => ({ name: `Fit ${name}`, unit: "%" })), { name: "Samples kept", unit: "%" }],
        rows: nights.map((night, at) => [night, ...shown.map(([, key]) => nightly[key][at]), nightly.kept_share[at] === null ? null : 100 * nightly.kept_share[at]]),
      },
    };
  });

  show("course-conditions", () => {
    const rows = [
      ["pressure", "pressure, bar"],
      ["temperature", "oil, °C"],
      ["speed", "speed, rpm"],
      ["mean_flow", "drain flow, l/min"],
    ].filter(([key]) => known(nightly[key]));
    if (!rows.length) return { absent: "No night of this motor has a fit." };
    const layout = { xaxis: { type: "date", anchor: `y${rows.length === 1 ? "" : rows.length}` }, showlegend: false, margin: { l: 58, r: 14, t: 30, b: 36 } };
    rows.forEach(([, title], place) => {
      const from_top = 1 - place / rows.length;
      layout[`yaxis${place ? place + 1 : ""}`] = { title: { text: title, font: { size: 11 } }, domain: [from_top - 1 / rows.length + 0.04, from_top], nticks: 4 };
    });
    return {
      traces: rows.map(([key, title], place) => line(title, nightly[key], { ...style(0), dash: "solid" }, { yaxis: `y${place ? place + 1 : ""}`, hovertemplate: `%{x|%Y-%m-%d}: %{y:.4g} ${title.split(", ")[1]}<extra></extra>`, marker: { size: 3, color: COLOURS.blue } })),
      height: 400,
      onClick: open,
      layout: { ...layout, shapes: marks().shapes },
      table: {
        columns: ["Night", ...rows.map(([, title]) => ({ name: title.split(", ")[0], unit: title.split(", ")[1] }))],
        rows: nights.map((night, at) => [night, ...rows.map(([key]) => nightly[key][at])]),
      },
    };
  });

  /* Trends and alarms */

  const { indicators, alarms, baselines, change_points: changePoints } = page.trend;
  const STATE_SYMBOLS = { ok: "circle", warning: "triangle-up", alarm: "triangle-up", common_cause: "diamond", stale: "circle-open", insufficient: "circle-open" };
  const STATE_COLOURS = { ok: COLOURS.green, warning: COLOURS.orange, alarm: COLOURS.vermilion, common_cause: COLOURS.purple };

  function indicatorChart(one) {
    const value = decode(one.value);
    const [lower, upper] = [decode(one.lower), decode(one.upper)];
    const own_unit = unit(one.unit);
    const step = (name, packed, colour, dash) => ({
      type: "scatter", mode: "lines", name, x: one.nights, y: decode(packed), line: { color: colour, width: 1.2, dash, shape: "hv" },
      hovertemplate: `%{x|%Y-%m-%d}: %{y:.4g}<extra>${name}</extra>`,
    });
    const traces = [];
    if (lower.length) traces.push(band(one.nights, lower, upper, COLOURS.blue, "value"));
    traces.push({
      type: "scatter", mode: "lines+markers", name: text(plain(one.indicator)), x: one.nights, y: value, connectgaps: false,
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
    if (one.warning_limit) traces.push(step("warning", one.warning_limit, COLOURS.orange, "dashdot"));
    if (one.alarm_limit) traces.push(step("alarm", one.alarm_limit, COLOURS.vermilion, "longdash"));
    const frozen = baselines.filter((baseline) => baseline.indicator === one.indicator && baseline.start && baseline.end);
    const lines = marks(changePoints.filter((point) => point.indicator === one.indicator));
    return {
      traces,
      height: 360,
      onClick: open,
      layout: {
        xaxis: { type: "date" },
        yaxis: { title: own_unit ? `${plain(one.indicator)}, ${own_unit}` : plain(one.indicator) },
        shapes: [
          ...frozen.map((baseline) => ({ type: "rect", layer: "below", x0: baseline.start, x1: baseline.end, yref: "paper", y0: 0, y1: 1, fillcolor: "#eef1f4", line: { width: 0 } })),
          ...lines.shapes,
        ],
        annotations: lines.annotations,
      },
      table: {
        columns: ["Night", { name: plain(one.indicator), unit: own_unit }, "Baseline", "State"],
        rows: one.nights.map((night, at) => [night, value[at], decode(one.baseline_mean)[at], plain(one.state[at] ?? "")]),
      },
    };
  }

  if (indicators.length) {
    const select = element("select", { "aria-label": "Indicator" }, ...indicators.map((one, place) => element("option", { value: place }, plain(one.indicator))));
    const worst = ["alarm", "warning", "common_cause"].map((state) => indicators.findIndex((one) => one.latest.state === state)).find((place) => place >= 0);
    select.value = String(worst ?? Math.max(indicators.findIndex((one) => one.indicator === "reference_leakage"), 0));
    const controls = document.querySelector("#trend-course .controls");
    controls.append(element("label", {}, "Indicator ", select));
    controls.hidden = false;
    const chosen = () => show("trend-course", () => indicatorChart(indicators[Number(select.value)]));
    select.addEventListener("change", chosen);
    chosen();
    const range = (latest, name) => (latest[name] === undefined ? null : `${format(latest[name], 3)}${latest[`${name}_lower`] === undefined ? "" : ` (${format(latest[`${name}_lower`], 3)} to ${format(latest[`${name}_upper`], 3)})`}`);
    document.getElementById("trend-table").append(
      table(
        ["Indicator", "Unit", "State", "Slope a year", "Slope in 1000 h", "q", "Path", "Days to limit", "Note"],
        indicators.map((one) => {
          const last = one.latest;
          const path = last.path ? `${plain(last.path)}${last.path_probability === undefined ? "" : ` (${Math.round(100 * last.path_probability)} %)`}` : null;
          const to_limit = range(last, "days_to_limit") ?? (last.days_to_limit_status ? plain(last.days_to_limit_status) : null);
          return [plain(one.indicator), unit(one.unit), plain(last.state ?? ""), range(last, "slope_per_year"), range(last, "slope_per_1000_h"), last.q_value ?? null, path, to_limit, [last.provisional ? "provisional" : "", last.gated_reason ?? ""].filter(Boolean).join("; ") || null];
        }),
      ),
    );
    if (alarms.length) {
      document.getElementById("alarm-table").append(
        element("h3", {}, "Changes of state"),
        table(
          ["Time", "Indicator", "From", "To", "Why"],
          [...alarms].reverse().map((alarm) => [String(alarm.time).slice(0, 16).replace("T", " "), plain(alarm.indicator), plain(alarm.from_state ?? ""), plain(alarm.to_state ?? ""), alarm.reason ?? ""]),
        ),
      );
    }
  }
})();
