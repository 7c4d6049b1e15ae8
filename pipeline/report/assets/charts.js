/* What all charts of the report share: decoding, looks, drawing when seen, tables, keys, print. */
"use strict";

const motorLeakage = (() => {
  const page = JSON.parse(document.getElementById("payload").textContent);

  /* Lines that are no path; text, grids and papers have their colours from the style sheet. */
  const COLOURS = {
    ink: "#76818d",
    quiet: "#8a949e",
    blue: "#0072b2",
    sky: "#56b4e9",
    green: "#009e73",
    orange: "#e69f00",
    vermilion: "#d55e00",
    purple: "#cc79a7",
  };
  /* Series differ in dash and marker, too, so that they can be told apart in grey. */
  const DASHES = ["solid", "dash", "dot", "dashdot", "longdash", "longdashdot", "solid"];
  const SYMBOLS = ["circle", "square", "diamond", "triangle-up", "x", "triangle-down", "cross"];
  const ABSENT = "–";

  /* Look of the path, or the series, at a place; of none: a line that is no single path. */
  function style(place) {
    if (place === null || place === undefined)
      return { color: COLOURS.ink, dash: "solid", symbol: "circle" };
    const at = place % page.colours.length;
    return { color: page.colours[at], dash: DASHES[at], symbol: SYMBOLS[at] };
  }

  /* Numbers that Python has packed; null where there is none. */
  function decode(column) {
    if (!column) return [];
    const packed = column.f4 !== undefined ? column.f4 : column.i4;
    const bytes = Uint8Array.from(atob(packed), (character) => character.charCodeAt(0));
    const numbers =
      column.f4 !== undefined ? new Float32Array(bytes.buffer) : new Int32Array(bytes.buffer);
    return Array.from(numbers, (number) => (Number.isNaN(number) ? null : number));
  }

  /* Limits of an axis that reach at least so far around the middle value: noise looks like noise. */
  function limits(values, reach) {
    const known = values
      .filter((value) => value !== null && value !== undefined)
      .sort((a, b) => a - b);
    if (!known.length) return undefined;
    const middle = known[Math.floor(known.length / 2)];
    const low = Math.min(known[0], middle - reach(middle));
    const high = Math.max(known.at(-1), middle + reach(middle));
    return [low - 0.05 * (high - low), high + 0.05 * (high - low)];
  }

  const plain = (name) => String(name).replaceAll("_", " ");

  /* The chart library reads some HTML in its texts: names of others must not be read as such. */
  const text = (name) =>
    String(name).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");

  /* A figure with so many significant digits. */
  function format(value, digits = 4) {
    if (value === null || value === undefined) return ABSENT;
    if (typeof value !== "number") return String(value);
    if (value === 0) return "0";
    const size = Math.abs(value);
    if (size < 1e-4 || size >= 1e7)
      return value.toExponential(digits - 1).replaceAll("-", "−").replace("e+", "e");
    if (Number.isInteger(value) || size >= 10 ** digits)
      return String(Math.round(value)).replace("-", "−");
    return value.toPrecision(digits).replace("-", "−");
  }

  /* Elements with texts only: whatever a name holds, it stays text. */
  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children.map((child) => (child instanceof Node ? child : String(child))));
    return made;
  }

  /* Words of a cell, with a remark in small letters below them. */
  const withRemark = (words, remark) =>
    element("span", {}, words, ...(remark ? [element("small", {}, remark)] : []));

  const probability = (p) => {
    if (p === undefined) return ABSENT;
    return p < 1e-4 ? "< 0.0001" : format(p, 2);
  };

  /* A menu above a figure; `options`: pairs of a value and its words; none: no menu. */
  function menu(figure, label, options, chosen, onChange) {
    const select = element(
      "select",
      {},
      ...options.map(([value, words]) => element("option", { value }, words)),
    );
    select.value = chosen;
    select.addEventListener("change", () => onChange(select.value));
    const controls = document.querySelector(`#${figure} .controls`);
    controls.replaceChildren(element("label", {}, `${label} `, select));
    controls.hidden = !options.length;
  }

  /* columns: names, with unit; rows: lists of cells, numbers on the right. */
  function table(columns, rows) {
    const head = element("tr");
    const numeric = columns.map((_, place) => rows.some((row) => typeof row[place] === "number"));
    columns.forEach((column, place) => {
      const cell = element("th", { scope: "col" }, column.name ?? column);
      if (column.unit) cell.append(element("small", {}, column.unit));
      if (numeric[place]) cell.className = "num";
      head.append(cell);
    });
    const body = element("tbody");
    for (const row of rows) {
      const line = element("tr");
      row.forEach((value, place) => {
        const cell = element("td", {}, value instanceof Node ? value : format(value));
        if (numeric[place]) cell.className = "num";
        line.append(cell);
      });
      body.append(line);
    }
    return element("table", {}, element("thead", {}, head), body);
  }

  function csv(columns, rows) {
    const cell = (value) => {
      const written = value === null || value === undefined ? "" : String(value);
      /* A spreadsheet takes a text that begins like a formula for one. */
      const safe =
        typeof value === "string" && /^[=+\-@\t\r]/.test(written) ? `'${written}` : written;
      return /[",\r\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
    };
    const names = columns.map((column) =>
      column.unit ? `${column.name} [${column.unit}]` : (column.name ?? column),
    );
    return [names, ...rows].map((row) => row.map(cell).join(",")).join("\r\n");
  }

  function download(name, content) {
    const link = element("a", {
      download: name,
      href: URL.createObjectURL(new Blob(["\ufeff", content], { type: "text/csv" })),
    });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  /* Charts are drawn when they come into view: a page opens at once, however many it has. */
  const waiting = new Map();
  const tables = new Map();
  const observer = new IntersectionObserver(
    (entries) =>
      entries.filter((entry) => entry.isIntersecting).forEach((entry) => draw(entry.target)),
    { rootMargin: "300px" },
  );

  /* build() gives {traces, layout, height, on, table: {columns, rows}} or {absent: why}. */
  function show(id, build) {
    const figure = document.getElementById(id);
    if (!figure) return;
    waiting.set(figure, build);
    figure.removeAttribute("data-drawn");
    observer.unobserve(figure);
    observer.observe(figure);
  }

  function draw(figure) {
    const build = waiting.get(figure);
    if (!build) return;
    waiting.delete(figure);
    observer.unobserve(figure);
    const chart = build();
    const plot = figure.querySelector(".plot");
    const absent = figure.querySelector(":scope > .absent");
    const details = figure.querySelector("details");
    const isAbsent = chart.absent !== undefined;
    plot.hidden = isAbsent;
    absent.hidden = !isAbsent;
    details.hidden = isAbsent || !chart.table;
    absent.textContent = isAbsent ? chart.absent : "";
    tables.set(details, chart.table);
    fill(details);
    if (isAbsent) {
      Plotly.purge(plot);
      figure.dataset.drawn = "absent";
      return;
    }
    const made = layout(chart);
    /* Where the window changes its size, the chart takes its height from here. */
    plot.style.height = `${made.height}px`;
    Plotly.react(plot, chart.traces, made, CONFIG).then(() => {
      figure.dataset.drawn = "chart";
      for (const [event, handler] of Object.entries(chart.on ?? {})) {
        plot.removeAllListeners(event);
        plot.on(event, handler);
      }
    });
  }

  /* Those in a closed fold have no width yet. */
  const drawAll = () =>
    [...waiting.keys()].filter((one) => !one.closest("details:not([open])")).forEach(draw);

  /* Buttons are listed, so that none of a later version that sends a chart away comes in unseen. */
  const CONFIG = {
    displaylogo: false,
    responsive: true,
    showTips: false,
    plotlyServerURL: "",
    displayModeBar: "hover",
    doubleClick: "reset",
    modeBarButtons: [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"], ["toImage"]],
    toImageButtonOptions: { scale: 2 },
  };

  /* End of the names of the axes of a chart that is the first, second … of several in a figure. */
  const axisNumber = (place) => (place ? String(place + 1) : "");

  const isNarrow = () => window.innerWidth < 600;
  const AXIS = {
    showline: true,
    ticks: "outside",
    ticklen: 4,
    zeroline: false,
    exponentformat: "power",
    automargin: true,
    title: { standoff: 6 },
  };

  function layout(chart) {
    const made = {
      height: chart.height ?? 320,
      margin: { l: 58, r: 14, t: 30, b: 40 },
      font: {
        family: "system-ui, 'Segoe UI', Roboto, 'Liberation Sans', Arial, sans-serif",
        size: 12,
      },
      hovermode: "closest",
      legend: {
        orientation: "h",
        x: 0,
        xanchor: "left",
        y: 1.01,
        yanchor: "bottom",
        font: { size: 12 },
      },
      ...chart.layout,
    };
    /* A narrow window breaks the legend into more lines, which need room. */
    if (isNarrow() && made.showlegend !== false && chart.traces.length > 3)
      Object.assign(made, { height: made.height + 50, margin: { ...made.margin, t: 90 } });
    const axes = Object.keys(made).filter((key) => /^[xy]axis\d*$/.test(key));
    for (const key of new Set(["xaxis", "yaxis", ...axes])) {
      const own = made[key] ?? {};
      const title = typeof own.title === "string" ? { text: own.title } : own.title;
      made[key] = { ...AXIS, ...own, title: { ...AXIS.title, ...title } };
    }
    return made;
  }

  function fill(details) {
    const content = tables.get(details);
    const place = details.querySelector(".scroll");
    place.replaceChildren();
    details.querySelector("button")?.remove();
    if (!content || !details.open) return;
    place.append(table(content.columns, content.rows));
    const button = element("button", { type: "button" }, "Save as CSV");
    const name = details.closest("figure").id;
    button.addEventListener("click", () =>
      download(`${name}.csv`, csv(content.columns, content.rows)),
    );
    place.before(button);
  }

  /* With the plot focused: + and − zoom in time, arrows move, 0 or Home shows all. */
  function onKey(event) {
    const plot = event.currentTarget;
    const full = plot._fullLayout;
    if (!full || event.ctrlKey || event.metaKey || event.altKey) return;
    const axes = Object.keys(full).filter((key) => /^xaxis\d*$/.test(key));
    const step = {
      "+": [0.25, -0.25],
      "=": [0.25, -0.25],
      "-": [-0.5, 0.5],
      ArrowLeft: [-0.2, -0.2],
      ArrowRight: [0.2, 0.2],
    }[event.key];
    const change = {};
    for (const key of axes) {
      const axis = full[key];
      if (event.key === "0" || event.key === "Home") change[`${key}.autorange`] = true;
      if (!step) continue;
      const [low, high] = axis.range.map((end) => axis.r2l(end));
      change[`${key}.range`] = [
        axis.l2r(low + step[0] * (high - low)),
        axis.l2r(high + step[1] * (high - low)),
      ];
    }
    if (Object.keys(change).length) {
      event.preventDefault();
      Plotly.relayout(plot, change);
    }
  }

  document
    .querySelectorAll(".chart .plot")
    .forEach((plot) => plot.addEventListener("keydown", onKey));
  document
    .querySelectorAll(".chart details")
    .forEach((details) => details.addEventListener("toggle", () => fill(details)));

  /* On paper all charts have one width, whatever the window had. */
  const PAPER_WIDTH = 660;
  const drawn = () => [...document.querySelectorAll("[data-drawn=chart] .plot")];
  window.addEventListener("beforeprint", () => {
    drawAll();
    drawn().forEach((plot) => Plotly.relayout(plot, { width: PAPER_WIDTH }));
  });
  window.addEventListener("afterprint", () =>
    drawn().forEach((plot) => Plotly.relayout(plot, { width: null, autosize: true })),
  );

  const word = (kind, code) => page.words[kind]?.[code] ?? plain(code ?? "");
  const unit = (code) => page.words.units[code] ?? code ?? "";
  const isPoor = (percent) => typeof percent === "number" && percent < page.poor_fit_percent;

  return {
    COLOURS,
    ABSENT,
    page,
    style,
    decode,
    limits,
    plain,
    text,
    format,
    element,
    withRemark,
    probability,
    menu,
    table,
    axisNumber,
    show,
    drawAll,
    word,
    unit,
    isPoor,
    isNarrow,
    /* By the figure's id: what draws it for a night. */
    nightFigures: {},
  };
})();
