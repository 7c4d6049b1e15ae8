/* Residual analysis of a night: correlation of the error with itself and with the inputs. */
"use strict";

(() => {
  const { COLOURS, decode, format, menu, axisNumber, show } = motorLeakage;
  const { LOOKS, INPUTS, noFigure } = motorLeakage.ofNight;

  let smoothed = false;

  const PANELS = [
    ["the error with itself", (one) => one.test === "whiteness"],
    ...INPUTS.map(([key, title]) => [
      `the error with ${title}`,
      (one) => one.test === "independence" && String(one.input).includes(key),
    ]),
  ];

  function residuals(night) {
    const both = new Set(night.residuals.map((one) => one.smoothed));
    if (!both.has(smoothed)) smoothed = !both.has(false);
    const kinds = [
      ["", "before smoothing"],
      ["yes", "smoothed, as fitted"],
    ];
    menu("residuals", "Errors", both.size > 1 ? kinds : [], smoothed ? "yes" : "", (value) => {
      smoothed = value === "yes";
      show("residuals", () => residuals(night));
    });
    const chosen = night.residuals.filter((one) => one.smoothed === smoothed);
    if (!chosen.length)
      return noFigure(night, "No residual tests are in the tables for this night.");
    const traces = [];
    const layout = { annotations: [] };
    const rows = [];
    const longest = chosen[0].lag.at(-1);
    const period = longest ? chosen[0].longest_s / longest : null;
    PANELS.forEach(([title, belongs], place) => {
      const number = axisNumber(place);
      const left = place / PANELS.length;
      layout[`xaxis${number}`] = {
        domain: [left + (place ? 0.025 : 0), left + 0.245],
        anchor: `y${number}`,
        title: period ? `lag, samples of ${format(period, 3)} s` : "lag, samples",
      };
      layout[`yaxis${number}`] = {
        anchor: `x${number}`,
        title: place ? "" : "correlation",
        zeroline: true,
        zerolinecolor: COLOURS.quiet,
      };
      layout.annotations.push({
        text: title,
        showarrow: false,
        xref: `x${number} domain`,
        yref: `y${number} domain`,
        x: 0,
        y: 1.01,
        xanchor: "left",
        yanchor: "bottom",
        font: { size: 12 },
      });
      for (const one of chosen.filter(belongs)) {
        const [value, bound] = [decode(one.value), decode(one.bound)];
        const look = LOOKS[one.part] ?? LOOKS.training;
        const axes = { xaxis: `x${number}`, yaxis: `y${number}`, x: one.lag };
        traces.push({
          type: "scatter",
          mode: "markers+lines",
          name: one.part,
          legendgroup: one.part,
          showlegend: place === 0,
          y: value,
          marker: { size: 5, ...look },
          line: { width: 0.8, color: look.color },
          hovertemplate: `lag %{x}: %{y:.3f}<extra>${one.part}, ${title}</extra>`,
          ...axes,
        });
        for (const sign of [-1, 1]) {
          traces.push({
            type: "scatter",
            mode: "lines",
            y: bound.map((limit) => (limit === null ? null : sign * limit)),
            line: { dash: "dash", width: 1.2, color: look.color },
            hoverinfo: "skip",
            showlegend: false,
            legendgroup: one.part,
            ...axes,
          });
        }
        one.lag.forEach((lag, at) => rows.push([title, one.part, lag, value[at], bound[at]]));
      }
    });
    layout.margin = { l: 58, r: 14, t: 52, b: 40 };
    layout.legend = { orientation: "h", x: 0, xanchor: "left", y: 1.1, yanchor: "bottom" };
    return {
      traces,
      layout,
      height: 340,
      table: { columns: ["Correlation of", "Part", "Lag", "Value", "99 % band ±"], rows },
    };
  }

  Object.assign(motorLeakage.nightFigures, { residuals });
})();
