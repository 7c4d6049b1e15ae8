/* One night of a motor: chosen, loaded as a script of its own, and shown. */
"use strict";

(() => {
  const { COLOURS, ABSENT, page, decode, plain, text, format, element, table, show, word, unit } = motorLeakage;

  const PARTS = { training: "t", validation: "v" };
  const LOOKS = {
    training: { color: COLOURS.blue, symbol: "circle" },
    validation: { color: "#a86f00", symbol: "square-open" },
  };
  const INPUTS = [
    ["pressure", "pressure difference", "bar"],
    ["temperature", "oil temperature", "°C"],
    ["speed", "speed", "rpm"],
  ];
  const byId = (id) => document.getElementById(id);
  const select = byId("choose");

  /* Choosing and loading */

  const loaded = new Map();
  let wanted = "";

  const isKnown = (night) => page.nights.includes(night);
  const hasFile = (night) => page.detailed[page.nights.indexOf(night)] === 1;

  motorLeakage.chooseNight = (night) => {
    if (isKnown(night)) location.hash = night;
  };

  /* The night's script calls this. */
  motorLeakage.night = (payload) => {
    loaded.set(payload.night, payload);
    if (payload.night === wanted) render(payload);
  };

  function choose(night) {
    wanted = night;
    select.value = night;
    const place = page.nights.indexOf(night);
    byId("earlier").disabled = place <= 0;
    byId("later").disabled = place >= page.nights.length - 1;
    if (loaded.has(night)) return render(loaded.get(night));
    if (!hasFile(night)) return fail(`The figures of ${night} are not in this report, which was made with fewer nights; those over the nights are above.`);
    byId("shown-night").classList.add("busy");
    byId("said").textContent = `loading ${night}`;
    const source = `../data/${encodeURIComponent(page.file)}/${night}.js`;
    const script = element("script", { src: source });
    script.addEventListener("load", () => script.remove());
    script.addEventListener("error", () => {
      script.remove();
      if (wanted === night) fail(`${source.slice(3)} is not there; copy the whole folder of the report, or make it again.`);
    });
    document.head.append(script);
    return undefined;
  }

  function fail(why) {
    byId("said").textContent = "";
    byId("outcome").textContent = why;
    byId("shown-night").classList.remove("busy");
    for (const id of ["parameters", "quality", "files", "residual-verdicts"]) byId(id).replaceChildren();
    for (const id of Object.keys(FIGURES)) show(id, () => ({ absent: why }));
  }

  function fromHash() {
    const night = decodeURIComponent(location.hash.slice(1));
    if (isKnown(night) && night !== wanted) choose(night);
  }

  const lastGood = () => {
    const place = page.statuses.lastIndexOf("ok");
    return page.nights[place >= 0 ? place : page.nights.length - 1];
  };
  const step = (by) => motorLeakage.chooseNight(page.nights[page.nights.indexOf(wanted) + by] ?? "");

  /* Figures of a night */

  function render(night) {
    byId("shown-night").classList.remove("busy");
    byId("said").textContent = "";
    byId("outcome").textContent = outcome(night);
    byId("parameters").replaceChildren(...parameters(night));
    byId("quality").replaceChildren(...quality(night));
    byId("files").replaceChildren(files(night));
    byId("residual-verdicts").replaceChildren(...verdicts(night));
    for (const [id, build] of Object.entries(FIGURES)) show(id, () => build(night));
    document.body.dataset.night = night.night;
  }

  function outcome({ fit, night, faults }) {
    const time = (ms) => new Date(ms).toISOString().slice(0, 16).replace("T", " ");
    const said = faults.length ? ` Could not be read: ${faults.join("; ")}` : "";
    if (fit.status !== "ok") {
      return `Night of ${night}: ${word("statuses", fit.status)}${fit.error_code ? ` (${fit.error_code})` : ""}: ${fit.reason ?? "no reason is stated"}.${said}`;
    }
    const kept = fit.kept_share === undefined ? "" : `; ${format(100 * fit.kept_share, 3)} % of the running motor's samples kept`;
    return `Night of ${night}: fitted, ${time(fit.window_start)} to ${time(fit.window_end)} UTC, ${word("flushing", fit.flushing_mode)}, oil ${fit.oil ?? ABSENT}${kept}.${said}`;
  }

  const unfitted = (night) => `The night was not fitted: ${night.fit.reason ?? word("statuses", night.fit.status)}.`;

  const SYMBOLS = { K: "K", h: "h", e: "e", C: "C", scale: "scale of", share: "share of", film_thickness_ratio: "Λ" };

  /* `K_piston_ring` as people write it. */
  function parameterName(name) {
    if (name === "C_f") return "flushing flow C_f";
    const prefix = Object.keys(SYMBOLS).find((one) => name.startsWith(`${one}_`));
    return prefix ? `${SYMBOLS[prefix]} ${plain(name.slice(prefix.length + 1))}` : plain(name);
  }

  const range = (low, high, digits) => (low === undefined || high === undefined ? null : `${format(low, digits)} to ${format(high, digits)}`);

  function parameters(night) {
    if (!night.parameters.length) return [element("p", { class: "absent" }, unfitted(night))];
    const shown = night.parameters.filter((one) => !one.placeholder);
    const order = ["K_", "scale_", "C_", "share_", "h_", "e_", "film_"];
    const rank = (name) => order.findIndex((prefix) => name.startsWith(prefix));
    shown.sort((one, other) => rank(one.parameter) - rank(other.parameter));
    const rows = shown.map((one) => {
      const share = one.parameter.startsWith("share_");
      const scaled = (value) => (value === undefined ? undefined : share ? 100 * value : value);
      const value = one.value === undefined ? range(one.feasible_min, one.feasible_max, 3) : format(scaled(one.value), 3);
      const words = element("span", {}, word("verdicts", one.verdict));
      if (one.reason) words.append(element("small", {}, one.reason));
      return [
        parameterName(one.parameter),
        cell(value),
        cell(range(scaled(one.lower), scaled(one.upper), 3)),
        cell(one.systematic === undefined ? null : `± ${format(scaled(one.systematic), 2)}`),
        share ? "%" : unit(one.unit),
        words,
      ];
    });
    rows.unshift(leakageRow(night.fit, "reference", "leakage at reference conditions"), leakageRow(night.fit, "own", "leakage at the night's own conditions"));
    const made = table(["Parameter", "Value or range", "95 % interval", "Systematic", "Unit", "What the data say"], rows);
    made.querySelectorAll("td:last-child").forEach((one) => one.classList.add("words"));
    const hidden = night.parameters.length - shown.length;
    const note = "Gap heights, eccentricities and film thickness ratios are not shown: they are made from the geometry in the motor type's file, which is a placeholder. Gap changes in % need none.";
    return hidden ? [made, element("p", { class: "absent" }, note)] : [made];
  }

  const cell = (value) => element("span", { class: "figure" }, value ?? ABSENT);

  /* What the data say of the leakage at stated conditions; `kind` is how its columns begin. */
  function leakageRow(fit, kind, name) {
    const stem = kind === "reference" ? "reference_leakage" : "own_conditions_leakage";
    const verdict = kind === "reference" ? "reference" : "own_conditions";
    const at = [["pressure_bar", "bar"], ["temperature_c", "°C"], ["speed_rpm", "rpm"]].map(([column, its_unit]) => `${format(fit[`${kind}_${column}`], 3)} ${its_unit}`).join(", ");
    const words = element("span", {}, word("verdicts", fit[`${verdict}_verdict`]));
    if (fit[`${verdict}_reason`]) words.append(element("small", {}, fit[`${verdict}_reason`]));
    const systematic = fit[`${stem}_systematic`];
    return [
      element("b", {}, name, element("small", {}, at)),
      element("b", { class: "figure" }, format(fit[`${stem}_l_per_min`])),
      cell(range(fit[`${stem}_lower`], fit[`${stem}_upper`], 4)),
      cell(systematic === undefined ? null : `± ${format(systematic, 2)}`),
      "l/min",
      words,
    ];
  }

  const FIGURE_ROWS = [
    ["Fit on training data", "training_fit_percent", "%"],
    ["Fit on validation data", "validation_fit_percent", "%"],
    ["Fit of the model before, on this night", "previous_model_fit_percent", "%"],
    ["RMSE, training", "training_rmse_l_per_min", "l/min"],
    ["RMSE, validation", "validation_rmse_l_per_min", "l/min"],
    ["Mean error, training", "training_mean_error_l_per_min", "l/min"],
    ["Mean error, validation", "validation_mean_error_l_per_min", "l/min"],
    ["RMSE of the model before", "previous_model_rmse_l_per_min", "l/min"],
    ["Mean error of the model before", "previous_model_mean_error_l_per_min", "l/min"],
    ["Criterion V", "cost", "(l/min)²"],
    ["FPE", "fpe", "(l/min)²"],
    ["AIC", "aic", ""],
    ["AICc", "aicc", ""],
    ["BIC", "bic", ""],
    ["Samples, training", "n_training", ""],
    ["Samples, validation", "n_validation", ""],
    ["Effective samples, training", "n_effective", ""],
    ["The same by all correlations", "n_effective_summed", ""],
    ["Effective samples, validation", "validation_n_effective", ""],
    ["AIC with effective samples", "aic_effective", ""],
    ["BIC with effective samples", "bic_effective", ""],
    ["Correlation time of the errors", "correlation_time_s", "s"],
    ["Identified coefficients", "n_parameters", ""],
    ["Rank of the regressors", "rank", ""],
    ["Condition number", "condition_number", ""],
    ["Transport delay", "transport_delay_s", "s"],
    ["Smoothing", "smoothing_s", "s"],
  ];

  function quality(night) {
    const { fit, modes } = night;
    if (fit.status !== "ok") return [element("p", { class: "absent" }, unfitted(night))];
    const rows = FIGURE_ROWS.filter(([, key]) => fit[key] !== undefined).map(([name, key, its_unit]) => [name, cell(format(fit[key], 5)), its_unit]);
    if (fit.n_starts) rows.push(["Starts at the proven minimum", cell(`${fit.n_starts_at_minimum} of ${fit.n_starts}`), ""]);
    const parts = [table(["Figure", "Value", "Unit"], rows)];
    if (fit.interval_status && fit.interval_status !== "ok") parts.push(element("p", { class: "absent" }, `No intervals: ${fit.interval_status}`));
    if (modes.length > 1) {
      parts.push(
        element("h3", {}, "Modes of flushing"),
        table(["Mode", { name: "Fit on validation data", unit: "%" }, "BIC with effective samples"], modes.map((mode) => [word("flushing", mode.flushing_mode) + (mode.is_primary ? " (configured)" : ""), mode.validation_fit_percent, mode.bic_effective])),
      );
    }
    return parts;
  }

  function files(night) {
    if (!night.files.length) return element("p", { class: "absent" }, "No log of this night was read.");
    const time = (ms) => (ms === null ? null : new Date(ms).toISOString().slice(0, 19).replace("T", " "));
    return table(
      ["File", "Format", "Outcome", "Rows", { name: "First sample", unit: "UTC" }, { name: "Last sample", unit: "UTC" }, "Note"],
      night.files.map((file) => [file.path, file.format, file.status, file.rows, time(file.first_time), time(file.last_time), file.message ?? ""]),
    );
  }

  /* Samples of a part, with a null wherever its neighbours are not neighbours in the log. */
  function samplesOf(night, letter) {
    const { samples } = night;
    if (!samples) return null;
    const after = decode(samples.after_ms);
    const steps = after.slice(1).map((time, at) => time - after[at]).sort((a, b) => a - b);
    const longest = 3 * (steps[Math.floor(0.95 * steps.length)] ?? 0);
    const columns = { pressure: decode(samples.pressure), temperature: decode(samples.temperature), speed: decode(samples.speed), measured: decode(samples.measured), predicted: decode(samples.predicted) };
    const part = { time: [], pressure: [], temperature: [], speed: [], measured: [], predicted: [] };
    let before = null;
    after.forEach((time, at) => {
      if (samples.part[at] !== letter) return;
      if (before !== null && (at - before > 1 || time - after[before] > longest)) {
        part.time.push(samples.start + after[before] + 1);
        for (const name of Object.keys(columns)) part[name].push(null);
      }
      part.time.push(samples.start + time);
      for (const name of Object.keys(columns)) part[name].push(columns[name][at]);
      before = at;
    });
    return before === null ? null : part;
  }

  const stamp = (ms) => new Date(ms).toISOString().slice(0, 19).replace("T", " ");
  const sampleRows = (part, names) => part.time.map((time, at) => [stamp(time), ...names.map((name) => part[name][at])]).filter((row) => row[1] !== null);

  const noSamples = (night, part) => ({ absent: night.samples ? `The night has no ${part} data.` : unfitted(night) });

  /* The thesis's data set: all four channels under each other, one time axis. */
  function dataSet(night, name) {
    const part = samplesOf(night, PARTS[name]);
    if (!part) return noSamples(night, name);
    const channels = [...INPUTS, ["measured", "drain flow", "l/min"]];
    const layout = { xaxis: { type: "date", anchor: "y4", title: "UTC" }, showlegend: false, hoversubplots: "axis", hovermode: "x", margin: { l: 58, r: 14, t: 30, b: 40 } };
    const traces = channels.map(([key, title, its_unit], place) => {
      const axis = place ? `y${place + 1}` : "y";
      layout[`yaxis${place ? place + 1 : ""}`] = { title: { text: `${title.replace("pressure difference", "pressure diff.").replace("oil temperature", "oil temp.")}<br>${its_unit}`, font: { size: 11 } }, domain: [1 - (place + 1) / 4 + 0.025, 1 - place / 4], nticks: 5 };
      return { type: "scatter", mode: "lines", name: title, x: part.time, y: part[key], yaxis: axis, line: { width: 1, color: LOOKS[name].color }, hovertemplate: `%{y:.4g} ${its_unit}<extra>${title}</extra>`, connectgaps: false };
    });
    return {
      traces, layout, height: 460,
      table: { columns: [{ name: "Time", unit: "UTC" }, ...channels.map(([, title, its_unit]) => ({ name: title, unit: its_unit }))], rows: sampleRows(part, channels.map(([key]) => key)) },
    };
  }

  function modelFit(night, name) {
    const part = samplesOf(night, PARTS[name]);
    if (!part) return noSamples(night, name);
    const fit = night.fit[`${name}_fit_percent`];
    const rmse = night.fit[`${name}_rmse_l_per_min`];
    const figures = [fit === undefined ? "the flow has no shape to fit" : `fit ${format(fit, 3)} %`, rmse === undefined ? "" : `RMSE ${format(rmse, 3)} l/min`].filter(Boolean).join(", ");
    return {
      traces: [
        { type: "scatter", mode: "lines", name: "measured", x: part.time, y: part.measured, line: { width: 1.4, color: "#8a949e" }, hovertemplate: "%{y:.4g} l/min<extra>measured</extra>" },
        { type: "scatter", mode: "lines", name: `model (${figures})`, x: part.time, y: part.predicted, line: { width: 1.2, color: COLOURS.vermilion, dash: "solid" }, hovertemplate: "%{y:.4g} l/min<extra>model</extra>" },
      ],
      layout: { xaxis: { type: "date", title: "UTC" }, yaxis: { title: "drain flow, l/min" }, hovermode: "x" },
      table: { columns: [{ name: "Time", unit: "UTC" }, { name: "measured", unit: "l/min" }, { name: "model", unit: "l/min" }], rows: sampleRows(part, ["measured", "predicted"]) },
    };
  }

  function errorOverTime(night) {
    const parts = Object.keys(PARTS).map((name) => [name, samplesOf(night, PARTS[name])]).filter(([, part]) => part);
    if (!parts.length) return noSamples(night, "");
    const traces = [];
    const shapes = [];
    const rows = [];
    for (const [name, part] of parts) {
      const error = part.measured.map((measured, at) => (measured === null ? null : measured - part.predicted[at]));
      traces.push({ type: "scatter", mode: "markers", name, x: part.time, y: error, marker: { size: 4, ...LOOKS[name] }, hovertemplate: `%{x|%H:%M:%S}: %{y:.3g} l/min<extra>${name}</extra>` });
      const rmse = night.fit[`${name}_rmse_l_per_min`];
      if (rmse !== undefined) {
        for (const sign of [-1, 1]) shapes.push({ type: "line", x0: part.time[0], x1: part.time.at(-1), y0: sign * rmse, y1: sign * rmse, line: { dash: "dash", width: 1.2, color: LOOKS[name].color } });
      }
      part.time.forEach((time, at) => error[at] !== null && rows.push([stamp(time), name, error[at]]));
    }
    return {
      traces,
      layout: { xaxis: { type: "date", title: "UTC" }, yaxis: { title: "measured − model, l/min", zeroline: true, zerolinecolor: COLOURS.quiet }, shapes },
      table: { columns: [{ name: "Time", unit: "UTC" }, "Part", { name: "measured − model", unit: "l/min" }], rows },
    };
  }

  /* Autocorrelation, and correlation with each input; a panel each. */

  let smoothed = false;

  const PANELS = [["the error with itself", (one) => one.test === "whiteness"], ...INPUTS.map(([key, title]) => [`the error with ${title}`, (one) => one.test === "independence" && String(one.input).includes(key)])];

  function residuals(night) {
    const both = new Set(night.residuals.map((one) => one.smoothed));
    const controls = document.querySelector("#residuals .controls");
    controls.replaceChildren();
    controls.hidden = both.size < 2;
    if (!both.has(smoothed)) smoothed = both.has(false) ? false : true;
    if (both.size > 1) {
      const menu = element("select", {}, element("option", { value: "" }, "before smoothing"), element("option", { value: "yes" }, "smoothed, as fitted"));
      menu.value = smoothed ? "yes" : "";
      menu.addEventListener("change", () => {
        smoothed = menu.value === "yes";
        show("residuals", () => residuals(night));
      });
      controls.append(element("label", {}, "Errors ", menu));
    }
    const chosen = night.residuals.filter((one) => one.smoothed === smoothed);
    if (!chosen.length) return { absent: night.fit.status === "ok" ? "No residual tests are in the tables for this night." : unfitted(night) };
    const traces = [];
    const layout = { annotations: [] };
    const rows = [];
    const longest = chosen[0].lag.at(-1);
    const period = longest ? chosen[0].longest_s / longest : null;
    PANELS.forEach(([title, belongs], place) => {
      const number = place ? place + 1 : "";
      const left = place / PANELS.length;
      layout[`xaxis${number}`] = { domain: [left + (place ? 0.025 : 0), left + 0.245], anchor: `y${number}`, title: period ? `lag, samples of ${format(period, 3)} s` : "lag, samples" };
      layout[`yaxis${number}`] = { anchor: `x${number}`, title: place ? "" : "correlation", zeroline: true, zerolinecolor: COLOURS.quiet };
      layout.annotations.push({ text: title, showarrow: false, xref: `x${number} domain`, yref: `y${number} domain`, x: 0, y: 1.01, xanchor: "left", yanchor: "bottom", font: { size: 12 } });
      for (const one of chosen.filter(belongs)) {
        const [value, bound] = [decode(one.value), decode(one.bound)];
        const look = LOOKS[one.part] ?? LOOKS.training;
        const axes = { xaxis: `x${number}`, yaxis: `y${number}`, x: one.lag };
        traces.push({ type: "scatter", mode: "markers+lines", name: one.part, legendgroup: one.part, showlegend: place === 0, y: value, marker: { size: 5, ...look }, line: { width: 0.8, color: look.color }, hovertemplate: `lag %{x}: %{y:.3f}<extra>${one.part}, ${title}</extra>`, ...axes });
        for (const sign of [-1, 1]) {
          traces.push({ type: "scatter", mode: "lines", y: bound.map((limit) => (limit === null ? null : sign * limit)), line: { dash: "dash", width: 1.2, color: look.color }, hoverinfo: "skip", showlegend: false, legendgroup: one.part, ...axes });
        }
        one.lag.forEach((lag, at) => rows.push([title, one.part, lag, value[at], bound[at]]));
      }
    });
    layout.margin = { l: 58, r: 14, t: 52, b: 40 };
    layout.legend = { orientation: "h", x: 0, xanchor: "left", y: 1.1, yanchor: "bottom" };
    return { traces, layout, height: 340, table: { columns: ["Correlation of", "Part", "Lag", "Value", "99 % band ±"], rows } };
  }

  /* What the residual tests come to, one row each. */
  function verdicts(night) {
    if (!night.verdicts.length) return [];
    const ordered = [...night.verdicts].sort((a, b) => a.part.localeCompare(b.part) || a.smoothed - b.smoothed || b.test.localeCompare(a.test));
    const rows = ordered.map((one) => [
      one.part,
      one.smoothed ? "smoothed" : "before smoothing",
      one.test === "independence" ? `with ${plain(one.input)}` : word("tests", one.test),
      word("tests", one.verdict),
      one.n_lags ? `${one.n_outside} of ${one.n_lags} (${format(one.n_expected_outside, 2)} by chance)` : ABSENT,
      one.p_value === undefined ? ABSENT : one.p_value < 1e-4 ? "< 0.0001" : format(one.p_value, 2),
      one.largest_value === undefined ? ABSENT : `${format(one.largest_value, 2)} at ${format(one.largest_lag_s, 3)} s`,
      one.reason ?? "",
    ]);
    return [table(["Part", "Errors", "Correlation of the error", "Test", "Lags outside the band", "p of all lags", "Largest", "Note"], rows)];
  }

  function waterfall(night) {
    const { starts, fit } = night;
    if (!starts) return { absent: night.fit.status === "ok" ? "No search was run: nothing is free, or it was not asked for." : unfitted(night) };
    const reached = starts.cost.map((cost, at) => at).filter((at) => starts.cost[at] !== null);
    const failed = starts.cost.length - reached.length;
    const group = (name, wanted_at, symbol, colour) => {
      const at = reached.filter((one) => starts.at_minimum[one] === wanted_at);
      return { type: "scatter", mode: "markers", name, x: at.map((one) => one + 1), y: at.map((one) => starts.cost[one]), marker: { size: 8, symbol, color: colour }, text: at.map((one) => text(`start ${starts.start[one]}: ${starts.reason[one] ?? ""}`)), hovertemplate: "%{y:.6g} (l/min)², %{text}<extra></extra>" };
    };
    const costs = reached.map((at) => starts.cost[at]);
    const low = Math.min(fit.cost ?? Infinity, ...costs);
    const high = Math.max(fit.cost ?? -Infinity, ...costs);
    const spread = Math.max(high - low, 0.02 * low);
    return {
      traces: [group("at the minimum", true, "circle", COLOURS.blue), group("elsewhere", false, "diamond-open", COLOURS.vermilion)].filter((trace) => trace.x.length),
      layout: {
        xaxis: { title: `starts, sorted${failed ? ` (${failed} failed)` : ""}`, dtick: starts.cost.length > 20 ? undefined : 1 },
        yaxis: { title: "criterion V, (l/min)²", range: [low - 0.1 * spread, low + 1.1 * spread], exponentformat: "power" },
        shapes: fit.cost === undefined ? [] : [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: fit.cost, y1: fit.cost, line: { dash: "dash", width: 1, color: COLOURS.ink } }],
      },
      table: { columns: ["Start", { name: "V", unit: "(l/min)²" }, "At the minimum", "Evaluations", "Why it ended"], rows: starts.start.map((start, at) => [start, starts.cost[at], starts.at_minimum[at] ? "yes" : "no", starts.iterations[at], starts.reason[at] ?? ""]) },
    };
  }

  /* Error budget: one indicator at a time. */

  let indicator = "";

  const INDICATORS = { reference_leakage: "reference leakage", own_conditions_leakage: "leakage at own conditions" };

  function worth(night, name) {
    if (INDICATORS[name]) return night.fit[`${name}_l_per_min`];
    return night.parameters.find((one) => one.parameter === name)?.value;
  }

  function budget(night) {
    const names = Object.keys(night.budget).filter((name) => worth(night, name));
    const controls = document.querySelector("#budget .controls");
    controls.replaceChildren();
    controls.hidden = names.length === 0;
    if (!names.length) return { absent: night.fit.status === "ok" ? "No figure of this night is known well enough for a budget, or no tolerances are stated in the config." : unfitted(night) };
    if (!names.includes(indicator)) indicator = names.includes("reference_leakage") ? "reference_leakage" : names.includes("own_conditions_leakage") ? "own_conditions_leakage" : names[0];
    const label = (name) => INDICATORS[name] ?? parameterName(name);
    const menu = element("select", {}, ...names.map((name) => element("option", { value: name }, label(name))));
    menu.value = indicator;
    menu.addEventListener("change", () => {
      indicator = menu.value;
      show("budget", () => budget(night));
    });
    controls.append(element("label", {}, "Effect on ", menu));
    const value = Math.abs(worth(night, indicator));
    const rows = night.budget[indicator].filter(([, , , effect]) => effect !== null);
    const share = (effect) => (100 * effect) / value;
    const stated = (tolerance, its_unit) => (its_unit === "1" || its_unit === "" ? `± ${format(100 * tolerance, 2)} %` : `± ${format(tolerance, 2)} ${unit(its_unit)}`);
    const names_shown = rows.map(([source, tolerance, its_unit]) => text(`${plain(source)}, ${stated(tolerance, its_unit)}`));
    const total = Math.sqrt(rows.reduce((sum, [, , , effect]) => sum + effect * effect, 0));
    return {
      traces: [
        {
          type: "bar", orientation: "h", x: [2 * share(total), ...rows.map(([, , , effect]) => share(effect))], base: [-share(total), ...rows.map(() => 0)], y: ["<b>all together</b>", ...names_shown],
          customdata: [`± ${format(share(total), 3)} %`, ...rows.map(([, , , effect]) => `${effect > 0 ? "+" : ""}${format(share(effect), 3)} %`)],
          marker: { color: [COLOURS.ink, ...rows.map(([, , , effect]) => (effect < 0 ? COLOURS.sky : COLOURS.orange))], pattern: { shape: ["", ...rows.map(([, , , effect]) => (effect < 0 ? "/" : ""))], solidity: 0.25, fgcolor: COLOURS.blue } },
          hovertemplate: "%{y}: %{customdata}<extra></extra>", showlegend: false,
        },
      ],
      height: 100 + 26 * (rows.length + 1),
      layout: { xaxis: { title: `effect on the ${text(label(indicator))}, %`, zeroline: true, zerolinecolor: COLOURS.quiet }, yaxis: { autorange: "reversed", ticklen: 0 }, margin: { l: 20, r: 14, t: 30, b: 40 } },
      table: { columns: ["Source", "Stated tolerance", { name: "Effect", unit: "%" }, { name: "Effect", unit: unit(rows[0]?.[4]) }], rows: rows.map(([source, tolerance, its_unit, effect]) => [plain(source), stated(tolerance, its_unit), share(effect), effect]) },
    };
  }

  function coverage(night) {
    const found = night.coverage;
    if (!found) return { absent: unfitted(night) };
    const traces = [];
    const layout = { barmode: "overlay", shapes: [], bargap: 0.08 };
    const rows = [];
    INPUTS.forEach(([key, title, its_unit], place) => {
      const number = place ? place + 1 : "";
      const { edges, minimum, maximum } = found[key];
      const width = edges[1] - edges[0];
      const middles = edges.slice(0, -1).map((edge) => edge + width / 2);
      layout[`xaxis${number}`] = { domain: [place / 3 + (place ? 0.03 : 0), (place + 1) / 3 - 0.01], anchor: `y${number}`, title: `${title}, ${its_unit} (${format(minimum, 3)} to ${format(maximum, 3)})`, range: [Math.max((Math.floor(minimum / width) - 1) * width, Math.min(edges[0], Math.floor(minimum / width) * width)), (Math.ceil(maximum / width) + 1) * width] };
      layout[`yaxis${number}`] = { anchor: `x${number}`, title: place ? "" : "samples, %", rangemode: "tozero" };
      for (const part of ["training", "validation"]) {
        const n = found.n[part];
        if (!n) continue;
        const share = found[key][part].map((count) => (100 * count) / n);
        const look = part === "training" ? { color: COLOURS.sky, line: { color: COLOURS.blue, width: 1 } } : { color: "rgba(0,0,0,0)", line: { color: "#a86f00", width: 2 } };
        traces.push({ type: "bar", name: part, legendgroup: part, showlegend: place === 0, x: middles, y: share.map((percent) => percent || null), width: part === "training" ? width * 0.92 : width * 0.7, marker: look, xaxis: `x${number}`, yaxis: `y${number}`, customdata: edges.slice(0, -1).map((edge) => `${edge} to ${edge + width} ${its_unit}`), hovertemplate: `%{customdata}: %{y:.2f} %<extra>${part}</extra>` });
        share.forEach((percent, at) => percent > 0 && rows.push([title, part, `${edges[at]} to ${edges[at + 1]}`, its_unit, percent]));
      }
      const at = night.fit[{ pressure: "reference_pressure_bar", temperature: "reference_temperature_c", speed: "reference_speed_rpm" }[key]];
      if (at !== undefined) {
        const range = layout[`xaxis${number}`].range;
        layout[`xaxis${number}`].range = [Math.min(range[0], at - width), Math.max(range[1], at + width)];
        layout.shapes.push({ type: "line", xref: `x${number}`, yref: `y${number} domain`, x0: at, x1: at, y0: 0, y1: 1, line: { dash: "dot", width: 1.5, color: COLOURS.ink } });
      }
    });
    return { traces, layout, height: 300, table: { columns: ["Input", "Part", "Bin", "Unit", { name: "Samples", unit: "%" }], rows } };
  }

  function conditions(night) {
    const found = night.coverage;
    if (!found) return { absent: unfitted(night) };
    const [pressure, temperature, speed] = INPUTS.map(([key]) => decode(found[key].blocks));
    const names = { t: "training", v: "validation", g: "guard" };
    const parts = [..."tvg"].filter((letter) => found.block_parts.includes(letter));
    return {
      traces: parts.map((letter) => {
        const at = pressure.map((_, place) => place).filter((place) => found.block_parts[place] === letter);
        return {
          type: "scatter", mode: "markers", name: names[letter], x: at.map((place) => pressure[place]), y: at.map((place) => speed[place]), text: at.map((place) => format(temperature[place], 3)),
          marker: { size: 8, symbol: { t: "circle", v: "square", g: "x" }[letter], color: at.map((place) => temperature[place]), coloraxis: "coloraxis", line: { width: 0.5, color: COLOURS.ink } },
          hovertemplate: "%{x:.0f} bar, %{y:.1f} rpm, %{text} °C<extra></extra>",
        };
      }),
      layout: { xaxis: { title: "pressure difference, bar" }, yaxis: { title: "speed, rpm" }, coloraxis: { colorscale: "Cividis", colorbar: { title: { text: "°C" }, thickness: 12, outlinewidth: 0 } } },
      table: { columns: ["Part", { name: "pressure difference", unit: "bar" }, { name: "speed", unit: "rpm" }, { name: "oil temperature", unit: "°C" }], rows: pressure.map((_, at) => [names[found.block_parts[at]], pressure[at], speed[at], temperature[at]]) },
    };
  }

  function refused(night) {
    const label = ([channel, reason]) => `${word("channels", channel)}: ${word("rules", reason)}`;
    const share = ([, , seen, gone]) => (seen ? (100 * gone) / seen : 0);
    const rules = night.quality.filter((row) => row[1] !== "any" && row[1] !== "incomplete" && row[3] > 0).sort((a, b) => share(b) - share(a));
    const columns = ["Channel", "Rule", "Samples", "Refused", { name: "Refused", unit: "%" }, "Kept all the same"];
    const rows = night.quality.map((row) => [word("channels", row[0]), word("rules", row[1]), row[2], row[3], share(row), row[4] || null]);
    if (!night.quality.length) return { absent: "No sample of this night was looked at." };
    if (!rules.length) return { absent: "No rule refused a sample." };
    const shown = rules.slice(0, 14);
    return {
      traces: [{ type: "bar", orientation: "h", x: shown.map(share), y: shown.map((row) => text(label(row))), marker: { color: COLOURS.blue }, hovertemplate: "%{y}: %{x:.3g} %<extra></extra>" }],
      height: 100 + 24 * shown.length,
      layout: { xaxis: { title: "of the samples looked at, %", rangemode: "tozero" }, yaxis: { autorange: "reversed", ticklen: 0 }, margin: { l: 20, r: 14, t: 30, b: 40 }, showlegend: false },
      table: { columns, rows },
    };
  }

  const FIGURES = {
    "data-training": (night) => dataSet(night, "training"),
    "data-validation": (night) => dataSet(night, "validation"),
    "fit-training": (night) => modelFit(night, "training"),
    "fit-validation": (night) => modelFit(night, "validation"),
    error: errorOverTime,
    residuals,
    starts: waterfall,
    budget,
    coverage,
    conditions,
    refused,
  };

  select.append(...page.nights.map((night, place) => element("option", { value: night }, `${night}, ${word("statuses", page.statuses[place])}`)).reverse());
  select.addEventListener("change", () => motorLeakage.chooseNight(select.value));
  byId("earlier").addEventListener("click", () => step(-1));
  byId("later").addEventListener("click", () => step(1));
  byId("good").addEventListener("click", () => motorLeakage.chooseNight(lastGood()));
  byId("picker").addEventListener("submit", (event) => event.preventDefault());
  window.addEventListener("hashchange", fromHash);
  fromHash();
  if (!wanted) choose(lastGood());
})();
