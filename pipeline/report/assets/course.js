/* A motor over its nights: leakage, paths, gaps, fit and conditions. */
"use strict";

(() => {
  const { COLOURS, page, style, decode, limits, plain, text, format, show, word, isPoor } =
    motorLeakage;
  const { places, nights, open, marks, band, line } = motorLeakage.overNights;

  const statuses = places.map((place) => page.statuses[place]);
  const course = (packed) => ({
    value: decode(packed.value),
    lower: decode(packed.lower),
    upper: decode(packed.upper),
    systematic: decode(packed.systematic),
  });
  const reference = course(page.reference);
  const frozen = course(page.frozen);
  const own = course(page.own);
  const known = (values) => values.some((value) => value !== null);

  const interval = (figure, at) => [figure.value[at], figure.lower[at], figure.upper[at]];

  /* The leakage that is told first is shown, the others on request. */
  const LEAKAGES = [
    ["at the reference conditions", reference, style(0), "reference"],
    ["at the motor's own conditions", frozen, style(2), "own, frozen"],
    [
      "at each night's conditions",
      own,
      { color: COLOURS.quiet, dash: "dash", symbol: "square" },
      "the night's",
    ],
  ].filter(([, leakage]) => known(leakage.value));

  /* Marks along the bottom for nights without a fit, with the reason. */
  function unfittedNights() {
    const missing = nights.map((_, at) => at).filter((at) => statuses[at] !== "ok");
    const why = (at) =>
      `${word("statuses", statuses[at])}: ${page.reasons[places[at]] ?? ""}`.slice(0, 120);
    return {
      type: "scatter",
      mode: "markers",
      name: "no fit",
      x: missing.map((at) => nights[at]),
      y: missing.map(() => 0.02),
      yaxis: "y2",
      text: missing.map((at) => text(why(at))),
      hovertemplate: "%{x|%Y-%m-%d}: %{text}<extra></extra>",
      marker: { color: COLOURS.vermilion, symbol: "x-thin-open", size: 7, line: { width: 1.5 } },
    };
  }

  show("course-leakage", () => {
    if (!LEAKAGES.length)
      return {
        absent:
          "No night of this motor has a leakage: none was fitted, or its logs determine none.",
      };
    const traces = LEAKAGES.flatMap(([name, leakage, look, short], place) => {
      const visible = place === 0 ? true : "legendonly";
      return [
        { ...band(nights, leakage.lower, leakage.upper, look.color, name), visible },
        line(name, leakage.value, look, {
          visible,
          hovertemplate: `%{x|%Y-%m-%d}: %{y:.4g} l/min<extra>${short}</extra>`,
        }),
      ];
    });
    const missing = unfittedNights();
    const first = LEAKAGES[0][1];
    return {
      traces: missing.x.length ? [...traces, missing] : traces,
      height: 340,
      onClick: open,
      layout: {
        xaxis: { type: "date" },
        yaxis: {
          title: "leakage, l/min",
          range: limits(
            [...first.value, ...first.lower, ...first.upper],
            (middle) => 0.05 * Math.abs(middle),
          ),
        },
        yaxis2: { overlaying: "y", range: [0, 1], visible: false, fixedrange: true },
        ...marks(),
      },
      table: {
        columns: [
          "Night",
          "Outcome",
          ...LEAKAGES.flatMap(([name]) => [
            { name: `Leakage ${name}`, unit: "l/min" },
            "from",
            "to",
          ]),
          { name: "± systematic, at the reference conditions", unit: "l/min" },
        ],
        rows: nights.map((night, at) => [
          night,
          word("statuses", statuses[at]),
          ...LEAKAGES.flatMap(([, leakage]) => interval(leakage, at)),
          reference.systematic[at],
        ]),
      },
    };
  });

  /* Several named courses in one chart, each in a style of its own. */
  function family(id, packed, { title, digits, absent, reach, name = plain }) {
    show(id, () => {
      const courses = packed
        .map((one) => ({ name: name(one.name), ...course(one) }))
        .filter((one) => known(one.value));
      if (!courses.length) return { absent };
      return {
        traces: courses.flatMap((one, place) => {
          const look = style(place);
          return [
            band(nights, one.lower, one.upper, look.color, one.name),
            line(one.name, one.value, look, {
              hovertemplate: `%{x|%Y-%m-%d}: %{y:.${digits}g}<extra>${text(one.name).replaceAll("%", "")}</extra>`,
            }),
          ];
        }),
        height: 340,
        onClick: open,
        layout: {
          xaxis: { type: "date" },
          yaxis: {
            title,
            zeroline: true,
            zerolinecolor: COLOURS.quiet,
            range: limits(
              [0, ...courses.flatMap((one) => [...one.value, ...one.lower, ...one.upper])],
              () => reach,
            ),
          },
          ...marks(),
        },
        table: {
          columns: [
            "Night",
            ...courses.flatMap((one) => [
              { name: one.name, unit: title.split(", ").pop() },
              "from",
              "to",
            ]),
          ],
          rows: nights.map((night, at) => [night, ...courses.flatMap((one) => interval(one, at))]),
        },
      };
    });
  }

  family("course-paths", page.paths, {
    title: "leakage, l/min",
    digits: 3,
    reach: 0,
    absent:
      "No night's logs tell the paths apart: the motor runs at one pressure, or the reference conditions lie outside what its nights cover.",
  });
  family("course-gaps", page.gaps, {
    title: "gap change, %",
    digits: 3,
    reach: 5,
    absent: "No loss factor of a single gap has a baseline yet.",
  });

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

  show("course-fit", () => {
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
      onClick: open,
      layout: {
        xaxis: { type: "date" },
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

  show("course-conditions", () => {
    const rows = [
      ["pressure", "pressure, bar"],
      ["temperature", "oil, °C"],
      ["speed", "speed, rpm"],
      ["mean_flow", "drain flow, l/min"],
    ].filter(([key]) => known(nightly[key]));
    if (!rows.length) return { absent: "No night of this motor has a fit." };
    const layout = {
      xaxis: { type: "date", anchor: `y${rows.length === 1 ? "" : rows.length}` },
      showlegend: false,
      margin: { l: 58, r: 14, t: 30, b: 36 },
    };
    rows.forEach(([, title], place) => {
      const fromTop = 1 - place / rows.length;
      layout[`yaxis${place ? place + 1 : ""}`] = {
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
            yaxis: `y${place ? place + 1 : ""}`,
            hovertemplate: `%{x|%Y-%m-%d}: %{y:.4g} ${title.split(", ")[1]}<extra></extra>`,
            marker: { size: 3, color: COLOURS.blue },
          },
        ),
      ),
      height: 400,
      onClick: open,
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
