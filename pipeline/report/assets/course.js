/* For the analyst: fit of the model and conditions over the nights. */
"use strict";

(() => {
  const { COLOURS, page, style, decode, format, axisNumber, isPoor } = motorLeakage;
  const { nights, overNights, marks, line, known } = motorLeakage.overNights;

  const nightly = Object.fromEntries(
    Object.entries(page.nightly).map(([name, packed]) => [name, decode(packed)]),
  );

  /* Crosses along the bottom, as a poor fit may lie far below the chart. */
  function poorFits(shown) {
    const poor = shown.flatMap(([name, key]) =>
      nightly[key].flatMap((value, at) => (isPoor(value) ? [{ name, value, at }] : [])),
    );
    return {
      type: "scatter",
      mode: "markers",
      name: "poor",
      x: poor.map(({ at }) => nights[at]),
      y: poor.map(() => 0.02),
      yaxis: "y2",
      text: poor.map(({ name, value }) => `${name} ${format(value, 3)} %, poor`),
      hovertemplate: "%{x|%Y-%m-%d}: %{text}<extra></extra>",
      marker: { color: COLOURS.vermilion, symbol: "x-thin-open", size: 7, line: { width: 1.5 } },
    };
  }

  overNights("course-fit", () => {
    const shown = [
      ["on training data", "training_fit", style(0)],
      ["on validation data", "validation_fit", style(1)],
      ["of the model before", "previous_fit", style(2)],
    ].filter(([, key]) => known(nightly[key]));
    if (!shown.length) return { absent: "No night of this motor has a fit." };
    const smallest = Math.min(
      ...shown.flatMap(([, key]) => nightly[key].filter((value) => value !== null)),
    );
    const poor = poorFits(shown);
    const courses = shown.map(([name, key, look]) =>
      line(name, nightly[key], look, {
        hovertemplate: `%{x|%Y-%m-%d}: %{y:.1f} %<extra>${name}</extra>`,
      }),
    );
    return {
      traces: poor.x.length ? [...courses, poor] : courses,
      layout: {
        yaxis: { title: "fit, %", range: [Math.max(Math.min(smallest - 3, 60), -50), 101] },
        yaxis2: { overlaying: "y", range: [0, 1], visible: false, fixedrange: true },
        ...marks(),
      },
      table: {
        columns: [
          "Night",
          ...shown.map(([name]) => ({ name: `Fit ${name}`, unit: "%" })),
          "Poor fit",
          { name: "Samples kept", unit: "%" },
        ],
        rows: nights.map((night, at) => [
          night,
          ...shown.map(([, key]) => nightly[key][at]),
          shown
            .filter(([, key]) => isPoor(nightly[key][at]))
            .map(([name]) => name)
            .join(", "),
          nightly.kept_share[at] === null ? null : 100 * nightly.kept_share[at],
        ]),
      },
    };
  });

  overNights("course-conditions", () => {
    const rows = [
      ["pressure", "pressure, bar"],
      ["temperature", "oil, °C"],
      ["speed", "speed, rpm"],
    ].filter(([key]) => known(nightly[key]));
    if (!rows.length) return { absent: "No night of this motor has a fit." };
    const layout = {
      xaxis: { anchor: `y${axisNumber(rows.length - 1)}` },
      showlegend: false,
    };
    rows.forEach(([, title], place) => {
      const fromTop = 1 - place / rows.length;
      layout[`yaxis${axisNumber(place)}`] = {
        title: { text: title, font: { size: 11 } },
        domain: [fromTop - 1 / rows.length + 0.04, fromTop],
        nticks: 4,
      };
    });
    return {
      traces: rows.map(([key, title], place) =>
        line(
          title,
          nightly[key],
          { ...style(0), dash: "solid" },
          {
            yaxis: `y${axisNumber(place)}`,
            hovertemplate: `%{x|%Y-%m-%d}: %{y:.4g} ${title.split(", ")[1]}<extra></extra>`,
            marker: { size: 3, color: COLOURS.blue },
          },
        ),
      ),
      height: 400,
      layout: { ...layout, shapes: marks().shapes },
      table: {
        columns: [
          "Night",
          ...rows.map(([, title]) => ({ name: title.split(", ")[0], unit: title.split(", ")[1] })),
        ],
        rows: nights.map((night, at) => [night, ...rows.map(([key]) => nightly[key][at])]),
      },
    };
  });
})();
