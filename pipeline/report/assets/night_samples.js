/* The samples of a night: data sets, model, prediction error, as the thesis shows them. */
"use strict";

(() => {
  const { COLOURS, decode, format, axisNumber, isPoor } = motorLeakage;
  const { PARTS, LOOKS, INPUTS, unfitted, stamp } = motorLeakage.ofNight;

  const SERIES = ["pressure", "temperature", "speed", "measured", "predicted"];

  /* Samples of a part, with a null wherever its neighbours are not neighbours in the log. */
  function samplesOf(night, letter) {
    const { samples } = night;
    if (!samples) return null;
    const after = decode(samples.after_ms);
    const steps = after
      .slice(1)
      .map((time, at) => time - after[at])
      .sort((a, b) => a - b);
    const longest = 3 * (steps[Math.floor(0.95 * steps.length)] ?? 0);
    const columns = Object.fromEntries(SERIES.map((name) => [name, decode(samples[name])]));
    const part = { time: [], ...Object.fromEntries(SERIES.map((name) => [name, []])) };
    let before = null;
    after.forEach((time, at) => {
      if (samples.part[at] !== letter) return;
      if (before !== null && (at - before > 1 || time - after[before] > longest)) {
        part.time.push(samples.start + after[before] + 1);
        for (const name of SERIES) part[name].push(null);
      }
      part.time.push(samples.start + time);
      for (const name of SERIES) part[name].push(columns[name][at]);
      before = at;
    });
    return before === null ? null : part;
  }

  const sampleRows = (part, names) =>
    part.time
      .map((time, at) => [stamp(time), ...names.map((name) => part[name][at])])
      .filter((row) => row[1] !== null);

  const noSamples = (night, part) => ({
    absent: night.samples ? `The night has no ${part} data.` : unfitted(night),
  });

  /* The thesis's data set: all four channels under each other, one time axis. */
  function dataSet(night, name) {
    const part = samplesOf(night, PARTS[name]);
    if (!part) return noSamples(night, name);
    const channels = [...INPUTS, ["measured", "drain flow", "l/min"]];
    const layout = {
      xaxis: { type: "date", anchor: "y4", title: "UTC" },
      showlegend: false,
      hoversubplots: "axis",
      hovermode: "x",
    };
    const traces = channels.map(([key, title, itsUnit], place) => {
      layout[`yaxis${axisNumber(place)}`] = {
        title: {
          text: `${title.replace("pressure difference", "pressure diff.").replace("oil temperature", "oil temp.")}<br>${itsUnit}`,
          font: { size: 11 },
        },
        domain: [1 - (place + 1) / 4 + 0.025, 1 - place / 4],
        nticks: 5,
      };
      return {
        type: "scatter",
        mode: "lines",
        name: title,
        x: part.time,
        y: part[key],
        yaxis: `y${axisNumber(place)}`,
        line: { width: 1, color: LOOKS[name].color },
        hovertemplate: `%{y:.4g} ${itsUnit}<extra>${title}</extra>`,
        connectgaps: false,
      };
    });
    return {
      traces,
      layout,
      height: 460,
      table: {
        columns: [
          { name: "Time", unit: "UTC" },
          ...channels.map(([, title, itsUnit]) => ({ name: title, unit: itsUnit })),
        ],
        rows: sampleRows(
          part,
          channels.map(([key]) => key),
        ),
      },
    };
  }

  function modelFit(night, name) {
    const part = samplesOf(night, PARTS[name]);
    if (!part) return noSamples(night, name);
    const fit = night.fit[`${name}_fit_percent`];
    const rmse = night.fit[`${name}_rmse_l_per_min`];
    const figures = [
      fit === undefined ? "the flow has no shape to fit" : `fit ${format(fit, 3)} %${isPoor(fit) ? " (poor)" : ""}`,
      rmse === undefined ? "" : `RMSE ${format(rmse, 3)} l/min`,
    ]
      .filter(Boolean)
      .join(", ");
    const flow = (name, values, line, label) => ({
      type: "scatter",
      mode: "lines",
      name: label,
      x: part.time,
      y: values,
      line,
      hovertemplate: `%{y:.4g} l/min<extra>${name}</extra>`,
    });
    const [grey, red] = [COLOURS.quiet, COLOURS.vermilion];
    return {
      traces: [
        flow("measured", part.measured, { width: 1.4, color: grey }, "measured"),
        flow("model", part.predicted, { width: 1.2, color: red }, `model (${figures})`),
      ],
      layout: {
        xaxis: { type: "date", title: "UTC" },
        yaxis: { title: "drain flow, l/min" },
        hovermode: "x",
      },
      table: {
        columns: [
          { name: "Time", unit: "UTC" },
          { name: "measured", unit: "l/min" },
          { name: "model", unit: "l/min" },
        ],
        rows: sampleRows(part, ["measured", "predicted"]),
      },
    };
  }

  function errorOverTime(night) {
    const parts = Object.keys(PARTS)
      .map((name) => [name, samplesOf(night, PARTS[name])])
      .filter(([, part]) => part);
    if (!parts.length) return noSamples(night, "");
    const traces = [];
    const shapes = [];
    const rows = [];
    for (const [name, part] of parts) {
      const error = part.measured.map((measured, at) =>
        measured === null ? null : measured - part.predicted[at],
      );
      traces.push({
        type: "scatter",
        mode: "markers",
        name,
        x: part.time,
        y: error,
        marker: { size: 4, ...LOOKS[name] },
        hovertemplate: `%{x|%H:%M:%S}: %{y:.3g} l/min<extra>${name}</extra>`,
      });
      const rmse = night.fit[`${name}_rmse_l_per_min`];
      if (rmse !== undefined) {
        for (const sign of [-1, 1])
          shapes.push({
            type: "line",
            x0: part.time[0],
            x1: part.time.at(-1),
            y0: sign * rmse,
            y1: sign * rmse,
            line: { dash: "dash", width: 1.2, color: LOOKS[name].color },
          });
      }
      part.time.forEach(
        (time, at) => error[at] !== null && rows.push([stamp(time), name, error[at]]),
      );
    }
    return {
      traces,
      layout: {
        xaxis: { type: "date", title: "UTC" },
        yaxis: { title: "measured − model, l/min", zeroline: true, zerolinecolor: COLOURS.quiet },
        shapes,
      },
      table: {
        columns: [
          { name: "Time", unit: "UTC" },
          "Part",
          { name: "measured − model", unit: "l/min" },
        ],
        rows,
      },
    };
  }

  Object.assign(motorLeakage.nightFigures, {
    "data-training": (night) => dataSet(night, "training"),
    "data-validation": (night) => dataSet(night, "validation"),
    "fit-training": (night) => modelFit(night, "training"),
    "fit-validation": (night) => modelFit(night, "validation"),
    error: errorOverTime,
  });
})();
