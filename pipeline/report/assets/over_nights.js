/* What charts over the nights share: intervals as bands, dated events, lines that open a night. */
"use strict";

motorLeakage.overNights = (() => {
  const { COLOURS, page, decode, text, format, word } = motorLeakage;

  const places = decode(page.plotted);
  const nights = places.map((place) => page.nights[place]);

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
        date: point.change_night,
        label: `${point.size_percent > 0 ? "+" : ""}${format(point.size_percent, 2)} % (${point.model})`,
        colour: COLOURS.purple,
        dash: "dot",
      })),
    ];
    return {
      shapes: dated.map((one) => ({
        type: "line",
        x0: one.date,
        x1: one.date,
        yref: "paper",
        y0: 0,
        y1: 1,
        line: { color: one.colour, width: 1, dash: one.dash },
      })),
      annotations: dated.map((one) => ({
        x: one.date,
        yref: "paper",
        y: 1,
        yanchor: "top",
        xanchor: "left",
        showarrow: false,
        text: text(one.label.slice(0, 60)),
        font: { size: 11, color: one.colour },
        bgcolor: "rgba(255,255,255,0.8)",
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

  function line(name, values, look, extra = {}) {
    return {
      type: "scatter",
      mode: "lines+markers",
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

  return { places, nights, open, marks, band, line };
})();
