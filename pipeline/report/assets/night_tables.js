/* One night in words and tables: outcome, parameters, model quality, residual tests, logs. */
"use strict";

motorLeakage.nightTables = (() => {
  const { ABSENT, plain, format, element, table, word, unit, isPoor } = motorLeakage;
  const { withRemark, probability } = motorLeakage;
  const { INPUTS, unfitted, parameterName, stamp } = motorLeakage.ofNight;

  function outcome({ fit, night, faults }) {
    const minute = (ms) => stamp(ms).slice(0, 16);
    const said = faults.length ? ` Could not be read: ${faults.join("; ")}` : "";
    if (fit.status !== "ok") {
      return `Night of ${night}: ${word("statuses", fit.status)}${fit.error_code ? ` (${fit.error_code})` : ""}: ${fit.reason ?? "no reason is stated"}.${said}`;
    }
    const kept =
      fit.kept_share === undefined
        ? ""
        : `; ${format(100 * fit.kept_share, 3)} % of the running motor's samples kept`;
    return `Night of ${night}: fitted, ${minute(fit.window_start)} to ${minute(fit.window_end)} UTC, ${word("flushing", fit.flushing_mode)}, oil ${fit.oil ?? ABSENT}${kept}.${said}`;
  }

  const absent = (words) => element("p", { class: "absent" }, words);

  const range = (low, high, digits) =>
    low === undefined || high === undefined
      ? null
      : `${format(low, digits)} to ${format(high, digits)}`;

  function parameters(night) {
    if (!night.parameters.length) return [absent(unfitted(night))];
    const shown = night.parameters.filter((one) => !one.placeholder);
    const order = ["K_", "scale_", "C_", "share_", "h_", "e_", "film_"];
    const rank = (name) => order.findIndex((prefix) => name.startsWith(prefix));
    shown.sort((one, other) => rank(one.parameter) - rank(other.parameter));
    const rows = shown.map((one) => {
      const share = one.parameter.startsWith("share_");
      const scaled = (value) => (value === undefined ? undefined : share ? 100 * value : value);
      const value =
        one.value === undefined
          ? range(one.feasible_min, one.feasible_max, 3)
          : format(scaled(one.value), 3);
      return [
        parameterName(one.parameter),
        cell(value),
        cell(range(scaled(one.lower), scaled(one.upper), 3)),
        cell(inAll(one.total_half_width)),
        share ? "%" : unit(one.unit),
        withRemark(word("verdicts", one.verdict), one.reason),
      ];
    });
    rows.unshift(
      leakageRow(night.fit, "reference", "leakage at reference conditions"),
      leakageRow(night.fit, "own", "leakage at the night's own conditions"),
    );
    const made = table(
      ["Parameter", "Value or range", "95 % interval", "In all", "Unit", "What the data say"],
      rows,
    );
    made.querySelectorAll("td:last-child").forEach((one) => one.classList.add("words"));
    const hidden = night.parameters.length - shown.length;
    const note =
      "Gap heights, eccentricities and film thickness ratios are not shown: they are made from the geometry in the motor type's file, which is a placeholder. Gap changes in % need none.";
    return hidden ? [made, absent(note)] : [made];
  }

  const cell = (value, ...marks) =>
    element("span", { class: "figure" }, value ?? ABSENT, ...marks);
  /* ± of samples, sensors and model together. */
  const inAll = (halfWidth) => (halfWidth === undefined ? null : `± ${format(halfWidth, 2)}`);
  const fitCell = (percent, digits) =>
    cell(
      format(percent, digits),
      ...(isPoor(percent) ? [" ", element("b", { class: "poor" }, "poor")] : []),
    );

  /* What the data say of the leakage at stated conditions; `kind` is how its columns begin. */
  function leakageRow(fit, kind, name) {
    const stem = kind === "reference" ? "reference_leakage" : "own_conditions_leakage";
    const verdict = kind === "reference" ? "reference" : "own_conditions";
    const at = INPUTS.map(
      ([, , itsUnit, column]) => `${format(fit[`${kind}_${column}`], 3)} ${itsUnit}`,
    ).join(", ");
    return [
      element("b", {}, name, element("small", {}, at)),
      element("b", { class: "figure" }, format(fit[`${stem}_l_per_min`])),
      cell(range(fit[`${stem}_lower`], fit[`${stem}_upper`], 4)),
      cell(inAll(fit[`${stem}_total_half_width`])),
      "l/min",
      withRemark(word("verdicts", fit[`${verdict}_verdict`]), fit[`${verdict}_reason`]),
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
    ["Samples, training", "n_training", ""],
    ["Samples, validation", "n_validation", ""],
    ["Effective samples, training", "n_effective", ""],
    ["The same by all correlations", "n_effective_summed", ""],
    ["Effective samples, validation", "validation_n_effective", ""],
    ["Correlation time of the errors", "correlation_time_s", "s"],
    ["Estimated coefficients off their bounds", "n_parameters", ""],
    ["Rank of the regressors", "rank", ""],
    ["Condition number", "condition_number", ""],
    ["Transport delay", "transport_delay_s", "s"],
    ["Smoothing", "smoothing_s", "s"],
  ];

  function quality(night) {
    const { fit, modes } = night;
    if (fit.status !== "ok") return [absent(unfitted(night))];
    const rows = FIGURE_ROWS.filter(([, key]) => fit[key] !== undefined).map(
      ([name, key, itsUnit]) => [
        name,
        key.endsWith("_fit_percent") ? fitCell(fit[key], 5) : cell(format(fit[key], 5)),
        itsUnit,
      ],
    );
    const parts = [table(["Figure", "Value", "Unit"], rows)];
    if (FIGURE_ROWS.some(([, key]) => key.endsWith("_fit_percent") && isPoor(fit[key])))
      parts.push(
        absent("Poor: the mean of these samples describes them better than the model does."),
      );
    const slow = /^ok: (.)(.*)/.exec(fit.interval_status ?? "");
    if (slow) parts.push(element("p", {}, `${slow[1].toUpperCase()}${slow[2]}.`));
    else if (fit.interval_status && fit.interval_status !== "ok")
      parts.push(absent(`No intervals: ${fit.interval_status}`));
    if (modes.length > 1) {
      parts.push(
        element("h3", {}, "Modes of flushing"),
        table(
          ["Mode", { name: "Fit on validation data", unit: "%" }],
          modes.map((mode) => [
            word("flushing", mode.flushing_mode) + (mode.is_primary ? " (configured)" : ""),
            fitCell(mode.validation_fit_percent),
          ]),
        ),
      );
    }
    return parts;
  }

  function files(night) {
    if (!night.files.length) return absent("No log of this night was read.");
    /* A file that could not be read has no times, nor a number of rows. */
    const time = (ms) => (ms === undefined ? null : stamp(ms));
    return table(
      [
        "File",
        "Format",
        "Outcome",
        "Rows",
        { name: "First sample", unit: "UTC" },
        { name: "Last sample", unit: "UTC" },
        "Note",
      ],
      night.files.map((file) => [
        file.path,
        file.format,
        file.status,
        file.rows,
        time(file.first_time),
        time(file.last_time),
        file.message ?? "",
      ]),
    );
  }

  /* What the residual tests come to, one row each. */
  function verdicts(night) {
    if (!night.verdicts.length) return [];
    const ordered = [...night.verdicts].sort(
      (a, b) =>
        a.part.localeCompare(b.part) || a.smoothed - b.smoothed || b.test.localeCompare(a.test),
    );
    const rows = ordered.map((one) => [
      one.part,
      one.smoothed ? "smoothed" : "before smoothing",
      one.test === "independence" ? `with ${plain(one.input)}` : word("tests", one.test),
      word("tests", one.verdict),
      one.n_lags
        ? `${one.n_outside} of ${one.n_lags} (${format(one.n_expected_outside, 2)} by chance)`
        : ABSENT,
      probability(one.p_value),
      one.largest_value === undefined
        ? ABSENT
        : `${format(one.largest_value, 2)} at ${format(one.largest_lag_s, 3)} s`,
      one.reason ?? "",
    ]);
    return [
      table(
        [
          "Part",
          "Errors",
          "Correlation of the error",
          "Test",
          "Lags outside the band",
          "p of all lags",
          "Largest",
          "Note",
        ],
        rows,
      ),
    ];
  }

  return { outcome, parameters, quality, verdicts, files };
})();
