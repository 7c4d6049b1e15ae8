/* What charts over the nights share: one axis of time, intervals, events, the night chosen. */
"use strict";

motorLeakage.overNights = (() => {
  const { COLOURS, page, decode, text, word, show } = motorLeakage;

  const places = decode(page.plotted);
  const nights = places.map((place) => page.nights[place]);

  /* The axis of time that all charts share: whoever zooms, all follow. */
  const DAY_MS = 86400000;
  const isoDay = (ms) => new Date(ms).toISOString().slice(0, 10);
  const shifted = (night, days) => isoDay(Date.parse(night) + days * DAY_MS);
  const WHOLE = [shifted(page.nights[0], -1), shifted(page.nights.at(-1), 1)];
  let span = WHOLE;
  const linked = () => [...document.querySelectorAll("[data-drawn=chart] .plot.over-nights")];

  function zoomed(event) {
    const isWhole = event["xaxis.autorange"];
    const range = isWhole
      ? WHOLE
      : (event["xaxis.range"] ?? [event["xaxis.range[0]"], event["xaxis.range[1]"]]);
    if (range[0] === undefined || (!isWhole && String(range) === String(span))) return;
    span = range;
    for (const plot of linked()) Plotly.relayout(plot, { "xaxis.range": [...span] });
  }

  /* A chart over the nights: its own traces and layout on the shared axis; a click chooses. */
  function overNights(id, build) {
    document.querySelector(`#${id} .plot`)?.classList.add("over-nights");
    show(id, () => {
      const chart = build();
      if (chart.absent !== undefined) return chart;
      const { xaxis, yaxis, shapes, ...layout } = chart.layout ?? {};
      return {
        ...chart,
        on: {
          plotly_relayout: zoomed,
          plotly_click: (event) => motorLeakage.chooseNight(String(event.points[0].x).slice(0, 10)),
        },
        layout: {
          margin: { l: 64, r: 14, t: 26, b: 24 },
          ...layout,
          xaxis: { type: "date", range: [...span], automargin: false, ...xaxis },
          yaxis: { automargin: false, ...yaxis },
          shapes: [...(shapes ?? []), ...chosenLine()],
        },
      };
    });
  }

  /* The chosen night is a line through all charts. */
  let chosen = "";
  const chosenLine = () =>
    chosen ? [{ ...upright(chosen, COLOURS.ink, "solid"), name: "chosen night" }] : [];
  function markNight(night) {
    chosen = night;
    for (const plot of linked()) {
      const others = (plot.layout.shapes ?? []).filter((one) => one.name !== "chosen night");
      Plotly.relayout(plot, { shapes: [...others, ...chosenLine()] });
    }
  }

  const upright = (x, color, dash) => ({
    type: "line",
    x0: x,
    x1: x,
    yref: "paper",
    y0: 0,
    y1: 1,
    line: { color, width: 1, dash },
  });

  /* Events that start a new baseline, and changes that were told, as lines over the whole height. */
  function marks(withTold = false) {
    const dated = [
      ...page.events.map((event) => ({
        date: event.date,
        label: word("events", event.kind) + (event.note ? `: ${event.note}` : ""),
        colour: COLOURS.ink,
        dash: "solid",
      })),
      ...(withTold ? page.told : []).map(({ night, label, isAlarm }) => ({
        date: night,
        label,
        colour: isAlarm ? COLOURS.vermilion : COLOURS.orange,
        dash: "dot",
      })),
    ];
    return {
      shapes: dated.map((one) => upright(one.date, one.colour, one.dash)),
      annotations: dated.map((one, place) => ({
        x: one.date,
        yref: "paper",
        y: 1,
        yanchor: "top",
        yshift: -13 * (place % 3),
        xanchor: "left",
        showarrow: false,
        text: text(one.label.slice(0, 60)),
        font: { size: 11 },
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
        outline.x.push(
          ...stretch.map((at) => x[at]),
          ...back.map((at) => x[at]),
          x[stretch[0]],
          null,
        );
        outline.y.push(
          ...stretch.map((at) => upper[at]),
          ...back.map((at) => lower[at]),
          upper[stretch[0]],
          null,
        );
      }
      stretch = [];
    };
    x.forEach((_, at) => {
      if (lower[at] === null || upper[at] === null || lower[at] === undefined) close();
      else stretch.push(at);
    });
    close();
    return {
      type: "scatter",
      mode: "lines",
      ...outline,
      fill: "toself",
      fillcolor: `${colour}33`,
      line: { color: `${colour}55`, width: 1 },
      hoverinfo: "skip",
      showlegend: false,
      legendgroup: group,
    };
  }

  /* Of more nights than that the marks would cover the lines. */
  const MARKED_NIGHTS = 200;
  function line(name, values, look, extra = {}) {
    return {
      type: "scatter",
      mode: nights.length > MARKED_NIGHTS ? "lines" : "lines+markers",
      name: text(name),
      x: nights,
      y: values,
      legendgroup: name,
      line: { color: look.color, width: 1.5, dash: look.dash },
      marker: { color: look.color, size: 5, symbol: look.symbol },
      connectgaps: false,
      ...extra,
    };
  }

  /* A level in steps from night to night. */
  const levelLine = (name, x, y, colour, dash, width, extra) => ({
    type: "scatter",
    mode: "lines",
    name,
    x,
    y,
    line: { color: colour, width, dash, shape: "hv" },
    ...extra,
  });

  const known = (values) => values.some((value) => value !== null);

  return {
    places,
    nights,
    DAY_MS,
    isoDay,
    MARKED_NIGHTS,
    overNights,
    markNight,
    marks,
    band,
    line,
    levelLine,
    known,
  };
})();
