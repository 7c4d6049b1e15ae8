/* How sure a night is: error budget, coverage, refused samples. */
"use strict";

(() => {
  const { COLOURS, decode, plain, text, format, menu, axisNumber, show, word, unit, isNarrow } =
    motorLeakage;
  const { INPUTS, noFigure, parameterName } = motorLeakage.ofNight;

  const longestLabel = () => (isNarrow() ? 26 : 60);

  /* An axis of names from the top down; bars go by place, so that no two names fall together. */
  const axisOfNames = (labels) => ({
    autorange: "reversed",
    ticklen: 0,
    showgrid: false,
    tickvals: labels.map((_, at) => at),
    ticktext: labels.map((label) =>
      text(label.length > longestLabel() ? `${label.slice(0, longestLabel())}…` : label),
    ),
  });

  /* Error budget: one indicator at a time. */

  let indicator = "";

  const INDICATORS = {
    reference_leakage: "reference leakage",
    own_conditions_leakage: "leakage at own conditions",
  };

  function worth(night, name) {
    if (INDICATORS[name]) return night.fit[`${name}_l_per_min`];
    return night.parameters.find((one) => one.parameter === name)?.value;
  }

  function budget(night) {
    const known = Object.keys(night.budget).filter((name) => worth(night, name));
    const label = (name) => INDICATORS[name] ?? parameterName(name);
    if (known.length && !known.includes(indicator))
      indicator = [...Object.keys(INDICATORS), ...known].find((name) => known.includes(name));
    const options = known.map((name) => [name, label(name)]);
    menu("budget", "Effect on", options, indicator, (value) => {
      indicator = value;
      show("budget", () => budget(night));
    });
    if (!known.length)
      return noFigure(
        night,
        "No figure of this night is known well enough for a budget, or no tolerances are stated in the config.",
      );
    const value = Math.abs(worth(night, indicator));
    const rows = night.budget[indicator].filter(([, , , effect]) => effect !== null);
    const share = (effect) => (100 * effect) / value;
    const stated = (tolerance, itsUnit) =>
      itsUnit === "1" || itsUnit === ""
        ? `± ${format(100 * tolerance, 2)} %`
        : `± ${format(tolerance, 2)} ${unit(itsUnit)}`;
    const shownNames = rows.map(
      ([source, tolerance, itsUnit]) => `${plain(source)}, ${stated(tolerance, itsUnit)}`,
    );
    const total = Math.sqrt(rows.reduce((sum, [, , , effect]) => sum + effect * effect, 0));
    return {
      traces: [
        {
          type: "bar",
          orientation: "h",
          x: [2 * share(total), ...rows.map(([, , , effect]) => share(effect))],
          base: [-share(total), ...rows.map(() => 0)],
          y: [0, ...rows.map((_, at) => at + 1)],
          customdata: [
            `all together: ± ${format(share(total), 3)} %`,
            ...rows.map(([, , , effect], at) =>
              text(`${shownNames[at]}: ${effect > 0 ? "+" : ""}${format(share(effect), 3)} %`),
            ),
          ],
          marker: {
            color: [
              COLOURS.ink,
              ...rows.map(([, , , effect]) => (effect < 0 ? COLOURS.sky : COLOURS.orange)),
            ],
            pattern: {
              shape: ["", ...rows.map(([, , , effect]) => (effect < 0 ? "/" : ""))],
              solidity: 0.25,
              fgcolor: COLOURS.blue,
            },
          },
          hovertemplate: "%{customdata}<extra></extra>",
          showlegend: false,
        },
      ],
      height: 100 + 26 * (rows.length + 1),
      layout: {
        xaxis: {
          title: `effect on the ${text(label(indicator))}, %`,
          zeroline: true,
          zerolinecolor: COLOURS.quiet,
        },
        yaxis: axisOfNames(["all together", ...shownNames]),
        margin: { l: 20, r: 14, t: 30, b: 40 },
      },
      table: {
        columns: [
          "Source",
          "Stated tolerance",
          { name: "Effect", unit: "%" },
          { name: "Effect", unit: unit(rows[0]?.[4]) },
        ],
        rows: rows.map(([source, tolerance, itsUnit, effect]) => [
          plain(source),
          stated(tolerance, itsUnit),
          share(effect),
          effect,
        ]),
      },
    };
  }

  function coverage(night) {
    const found = night.coverage;
    if (!found) return noFigure(night);
    const traces = [];
    const layout = { barmode: "overlay", shapes: [], bargap: 0.08 };
    const rows = [];
    INPUTS.forEach(([key, title, itsUnit, column], place) => {
      const number = axisNumber(place);
      const { edges, minimum, maximum } = found[key];
      const width = edges[1] - edges[0];
      const middles = edges.slice(0, -1).map((edge) => edge + width / 2);
      layout[`xaxis${number}`] = {
        domain: [place / 3 + (place ? 0.03 : 0), (place + 1) / 3 - 0.01],
        anchor: `y${number}`,
        title: {
          text: `${title}<br>${format(minimum, 3)} to ${format(maximum, 3)} ${itsUnit}`,
          font: { size: 11 },
        },
        range: [
          Math.max(
            (Math.floor(minimum / width) - 1) * width,
            Math.min(edges[0], Math.floor(minimum / width) * width),
          ),
          (Math.ceil(maximum / width) + 1) * width,
        ],
      };
      layout[`yaxis${number}`] = {
        anchor: `x${number}`,
        title: place ? "" : "samples, %",
        rangemode: "tozero",
      };
      for (const part of ["training", "validation"]) {
        const n = found.n[part];
        if (!n) continue;
        const share = found[key][part].map((count) => (100 * count) / n);
        const look =
          part === "training"
            ? { color: COLOURS.sky, line: { color: COLOURS.blue, width: 1 } }
            : { color: "rgba(0,0,0,0)", line: { color: "#a86f00", width: 2 } };
        traces.push({
          type: "bar",
          name: part,
          legendgroup: part,
          showlegend: place === 0,
          x: middles,
          y: share.map((percent) => percent || null),
          width: part === "training" ? width * 0.92 : width * 0.7,
          marker: look,
          xaxis: `x${number}`,
          yaxis: `y${number}`,
          customdata: edges.slice(0, -1).map((edge) => `${edge} to ${edge + width} ${itsUnit}`),
          hovertemplate: `%{customdata}: %{y:.2f} %<extra>${part}</extra>`,
        });
        share.forEach(
          (percent, at) =>
            percent > 0 &&
            rows.push([title, part, `${edges[at]} to ${edges[at + 1]}`, itsUnit, percent]),
        );
      }
      const at = night.fit[`reference_${column}`];
      if (at !== undefined) {
        const range = layout[`xaxis${number}`].range;
        layout[`xaxis${number}`].range = [
          Math.min(range[0], at - width),
          Math.max(range[1], at + width),
        ];
        layout.shapes.push({
          type: "line",
          xref: `x${number}`,
          yref: `y${number} domain`,
          x0: at,
          x1: at,
          y0: 0,
          y1: 1,
          line: { dash: "dot", width: 1.5, color: COLOURS.ink },
        });
      }
    });
    return {
      traces,
      layout,
      height: 300,
      table: { columns: ["Input", "Part", "Bin", "Unit", { name: "Samples", unit: "%" }], rows },
    };
  }

  function conditions(night) {
    const found = night.coverage;
    if (!found) return noFigure(night);
    const [pressure, temperature, speed] = INPUTS.map(([key]) => decode(found[key].blocks));
    const names = { t: "training", v: "validation", g: "guard" };
    const parts = [..."tvg"].filter((letter) => found.block_parts.includes(letter));
    return {
      traces: parts.flatMap((letter) => {
        const symbol = { t: "circle", v: "square", g: "x" }[letter];
        const at = pressure
          .map((_, place) => place)
          .filter((place) => found.block_parts[place] === letter);
        const points = {
          type: "scatter",
          mode: "markers",
          legendgroup: letter,
          showlegend: false,
          x: at.map((place) => pressure[place]),
          y: at.map((place) => speed[place]),
          text: at.map((place) => format(temperature[place], 3)),
          marker: {
            size: 8,
            symbol,
            color: at.map((place) => temperature[place]),
            coloraxis: "coloraxis",
            line: { width: 0.5, color: COLOURS.ink },
          },
          hovertemplate: "%{x:.0f} bar, %{y:.1f} rpm, %{text} °C<extra></extra>",
        };
        /* The legend takes no numbers for colours. */
        const key = {
          type: "scatter",
          mode: "markers",
          legendgroup: letter,
          name: names[letter],
          x: [null],
          y: [null],
          marker: { symbol, color: COLOURS.ink },
        };
        return [points, key];
      }),
      layout: {
        xaxis: { title: "pressure difference, bar" },
        yaxis: { title: "speed, rpm" },
        coloraxis: {
          colorscale: "Cividis",
          colorbar: { title: { text: "°C" }, thickness: 12, outlinewidth: 0 },
        },
      },
      table: {
        columns: [
          "Part",
          { name: "pressure difference", unit: "bar" },
          { name: "speed", unit: "rpm" },
          { name: "oil temperature", unit: "°C" },
        ],
        rows: pressure.map((_, at) => [
          names[found.block_parts[at]],
          pressure[at],
          speed[at],
          temperature[at],
        ]),
      },
    };
  }

  function refused(night) {
    const label = ([channel, reason]) => `${word("channels", channel)}: ${word("rules", reason)}`;
    const share = ([, , seen, gone]) => (seen ? (100 * gone) / seen : 0);
    const rules = night.quality
      .filter((row) => row[1] !== "any" && row[1] !== "incomplete" && row[3] > 0)
      .sort((a, b) => share(b) - share(a));
    const columns = [
      "Channel",
      "Rule",
      "Samples",
      "Refused",
      { name: "Refused", unit: "%" },
      "Kept all the same",
    ];
    const rows = night.quality.map((row) => [
      word("channels", row[0]),
      word("rules", row[1]),
      row[2],
      row[3],
      share(row),
      row[4] || null,
    ]);
    if (!night.quality.length) return { absent: "No sample of this night was looked at." };
    if (!rules.length) return { absent: "No rule refused a sample." };
    const shown = rules.slice(0, 14);
    return {
      traces: [
        {
          type: "bar",
          orientation: "h",
          x: shown.map(share),
          y: shown.map((_, at) => at),
          customdata: shown.map((row) => text(label(row))),
          marker: { color: COLOURS.blue },
          hovertemplate: "%{customdata}: %{x:.3g} %<extra></extra>",
        },
      ],
      height: 100 + 24 * shown.length,
      layout: {
        xaxis: { title: "of the samples looked at, %", rangemode: "tozero" },
        yaxis: axisOfNames(shown.map(label)),
        margin: { l: 20, r: 14, t: 30, b: 40 },
        showlegend: false,
      },
      table: { columns, rows },
    };
  }

  Object.assign(motorLeakage.nightFigures, {
    budget,
    coverage,
    conditions,
    refused,
  });
})();
