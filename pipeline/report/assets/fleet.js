/* The fleet page: search and sort the motors that the page already lists. */
"use strict";

(() => {
  const table = document.getElementById("fleet");
  const form = document.getElementById("search");
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const headers = [...table.tHead.rows[0].cells];

  /* A motor that needs attention has a sentence above the table, too. */
  const sentences = new Map(
    [...document.querySelectorAll(".attention li")].map((one) => [one.dataset.motor, one]),
  );
  const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));

  function search() {
    const wanted = form.find.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of rows) {
      row.hidden = !wanted.every((word) => texts.get(row).includes(word));
      const sentence = sentences.get(row.dataset.motor);
      if (sentence) sentence.hidden = row.hidden;
    }
    const shown = rows.filter((row) => !row.hidden).length;
    document.getElementById("shown").textContent =
      shown === rows.length ? "" : `${shown} of ${rows.length} shown`;
    document.getElementById("nothing").hidden = shown > 0;
    remember();
    draw();
  }

  /* The motors that are listed in one chart; its data and the chart library come when it opens. */
  const overlay = document.getElementById("overlay");
  const plot = overlay.querySelector(".plot");
  let range = "all";
  let series = null;
  function load(source) {
    const script = document.createElement("script");
    script.src = source;
    document.head.append(script);
    return new Promise((done) => script.addEventListener("load", done));
  }
  async function open() {
    if (!overlay.open || series) return;
    window.motorLeakageFleet = (data) => (series = data);
    await Promise.all([load("assets/plotly.min.js"), load("curves.js")]);
    draw();
  }
  function draw() {
    if (!overlay.open || !series) return;
    const listed = new Set(rows.filter((row) => !row.hidden).map((row) => row.dataset.motor));
    const traces = series.motors
      .map((motor, place) => ({
        ...motor,
        x: series.nights,
        line: { width: 1.4, color: series.colours[place % series.colours.length] },
        hovertemplate: `%{x|%Y-%m-%d}: %{y:+.1f} %<extra>${motor.name}</extra>`,
      }))
      .filter((motor) => listed.has(motor.name));
    const level = { type: "line", xref: "paper", x0: 0, x1: 1, y0: series.alarm, y1: series.alarm };
    level.line = { color: "#d55e00", dash: "longdash", width: 1.4 };
    const last = Date.parse(series.nights.at(-1));
    const first = range === "all" ? Date.parse(series.nights[0]) : last - range * 86400000;
    const days = [first, last].map((time) => new Date(time).toISOString().slice(0, 10));
    const name = `Leakage against its baseline, %; dashed: alarm level +${series.alarm} %`;
    const layout = {
      title: { text: name, font: { size: 13 }, x: 0, xanchor: "left" },
      height: 360,
      margin: { l: 40, r: 10, t: 40, b: 30 },
      showlegend: true,
      legend: { orientation: "h", y: -0.12 },
      shapes: [level],
      xaxis: { range: days },
      yaxis: { fixedrange: true },
    };
    Plotly.react(plot, traces, layout, { displayModeBar: false, responsive: true });
    overlay.dataset.drawn = traces.length;
  }
  for (const button of overlay.querySelectorAll("[data-range]"))
    button.addEventListener("click", () => showRange(button.dataset.range));
  function showRange(name) {
    range = name;
    for (const button of overlay.querySelectorAll("[data-range]"))
      button.setAttribute("aria-pressed", button.dataset.range === name);
    remember();
    draw();
  }
  overlay.addEventListener("toggle", () => {
    remember();
    open();
  });

  /* Search, chart and order stand in the address, so that a view can be sent. */
  function remember() {
    const address = new URLSearchParams();
    if (form.find.value) address.set("find", form.find.value);
    if (overlay.open) address.set("chart", range);
    const sorted = headers.find((header) => header.ariaSort);
    if (sorted !== headers[1] || sorted.ariaSort !== "ascending")
      address.set("sort", `${sorted.cellIndex} ${sorted.ariaSort}`);
    history.replaceState(null, "", `#${address}`);
  }

  function recall() {
    const address = new URLSearchParams(location.hash.slice(1));
    form.find.value = address.get("find") ?? "";
    const [column, order] = address.get("sort")?.split(" ") ?? [1, "ascending"];
    if (headers[column]?.dataset.sort) sort(headers[column], order);
    if (address.has("chart")) {
      overlay.open = true;
      showRange(address.get("chart"));
    }
    search();
  }

  /* Rows without a value come last, whichever way the others are sorted. */
  function sort(header, way) {
    const sign = way === "descending" ? -1 : 1;
    for (const other of headers) other.removeAttribute("aria-sort");
    header.setAttribute("aria-sort", sign < 0 ? "descending" : "ascending");
    const value = (row) => row.cells[header.cellIndex].dataset.value;
    const known = rows.filter((row) => value(row) !== "");
    known.sort((a, b) => {
      const difference = value(a) - value(b);
      const text = () => value(a).localeCompare(value(b), "en", { numeric: true });
      return sign * (Number.isNaN(difference) ? text() : difference);
    });
    body.append(...known, ...rows.filter((row) => value(row) === ""));
  }

  /* The first click puts the worst first, the second turns the order round. */
  const TURNED = { ascending: "descending", descending: "ascending" };
  for (const header of headers.filter((one) => one.dataset.sort)) {
    const button = document.createElement("button");
    button.type = "button";
    button.append(header.firstChild);
    header.prepend(button);
    button.addEventListener("click", () => {
      sort(header, TURNED[header.ariaSort] ?? header.dataset.sort);
      remember();
    });
  }
  form.addEventListener("input", search);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(search));
  window.addEventListener("hashchange", recall);
  form.hidden = false;
  recall();
})();
