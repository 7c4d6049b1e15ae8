/* A motor's page: draws the figures that Python has made, and shows the night that is chosen. */
"use strict";

const motorLeakage = (() => {
  const page = JSON.parse(document.getElementById("payload").textContent);
  const byId = (id) => document.getElementById(id);
  const plotOf = (id) => document.querySelector(`#${id} .plot`);

  /* Drawing */

  const CONFIG = {
    displaylogo: false,
    responsive: true,
    showTips: false,
    plotlyServerURL: "",
    doubleClick: "reset",
    /* Listed, so that none of a later version that sends a chart away comes in unseen. */
    modeBarButtons: [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"], ["toImage"]],
    toImageButtonOptions: { scale: 2 },
  };
  const FONT = "system-ui, 'Segoe UI', Roboto, 'Liberation Sans', Arial, sans-serif";
  const AXIS = { showline: true, ticks: "outside", ticklen: 4, zeroline: false };

  function draw(id, figure) {
    const plot = plotOf(id);
    const isAbsent = !figure.data;
    plot.hidden = isAbsent;
    plot.nextElementSibling.hidden = !isAbsent;
    document.getElementById(id).dataset.drawn = isAbsent ? "absent" : "chart";
    if (isAbsent) return Plotly.purge(plot);
    const traces = figure.data.map((trace) => ({ x: figure.x, ...trace }));
    const layout = { ...figure.layout, font: { family: FONT, size: 12 } };
    for (const key of Object.keys(layout).filter((one) => /^[xy]axis/.test(one)))
      layout[key] = { ...AXIS, ...layout[key] };
    plot.style.height = `${layout.height}px`;
    return Plotly.react(plot, traces, layout, CONFIG);
  }

  /* One night: chosen, loaded as a script of its own, and shown */

  const select = byId("choose");
  const loaded = new Map();
  let wanted = "";

  function element(name, attributes, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  function show({ night, words, figure, residuals }) {
    byId("loading").textContent = "";
    byId("words").replaceChildren(
      ...words.flatMap(([title, lines]) => [
        ...(title ? [element("h3", {}, title)] : []),
        ...lines.map((line) => element("p", {}, line)),
      ]),
    );
    draw("samples", figure);
    draw("residuals", residuals);
    document.body.dataset.night = night;
  }
  const fail = (why) => show({ night: wanted, words: [["", [why]]], figure: {}, residuals: {} });

  function choose(night) {
    wanted = night;
    select.value = night;
    const place = page.nights.indexOf(night);
    byId("earlier").disabled = place <= 0;
    byId("later").disabled = place >= page.nights.length - 1;
    mark(night);
    if (loaded.has(night)) return show(loaded.get(night));
    byId("loading").textContent = `loading ${night}`;
    const source = `../data/${encodeURIComponent(page.file)}/${night}.js`;
    const script = element("script", { src: source });
    script.addEventListener("load", () => script.remove());
    script.addEventListener("error", () => {
      script.remove();
      const why = "the report was made with fewer nights, or not copied as a whole";
      if (wanted === night) fail(`${source.slice(3)} is not there: ${why}.`);
    });
    return document.head.append(script);
  }

  /* The chosen night is a line through the chart over the nights. */
  function mark(night) {
    const plot = plotOf("course");
    if (!plot.layout || !night) return;
    const shapes = (plot.layout.shapes ?? []).filter((one) => one.name !== "chosen night");
    const line = { type: "line", x0: night, x1: night, yref: "paper", y0: 0 };
    line.y1 = plot.layout.yaxis.domain[1];
    const look = { line: { color: "#76818d", width: 1 }, name: "chosen night" };
    Plotly.relayout(plot, { shapes: [...shapes, { ...line, ...look }] });
  }

  /* The night and the range of dates stand in the address: #2026-03-17&range=90 */
  let range = "all";
  const ranges = page.course.ranges ?? {};
  const isKnown = (night) => page.nights.includes(night);
  const address = (night) =>
    `#${[night, range === "all" ? "" : `range=${range}`].filter(Boolean).join("&")}`;
  function go(night) {
    if (!isKnown(night)) return;
    if (location.hash === address(night)) fromHash();
    else location.hash = address(night);
  }
  function fromHash() {
    const night = location.hash.slice(1, 11);
    const asked = /range=(\w+)/.exec(location.hash)?.[1];
    if (ranges[asked]) showRange(asked);
    if (!isKnown(night)) return;
    if (night !== wanted) choose(night);
    byId("night").scrollIntoView();
  }
  function showRange(name) {
    range = name;
    for (const button of document.querySelectorAll("[data-range]"))
      button.setAttribute("aria-pressed", button.dataset.range === name);
    return Plotly.relayout(plotOf("course"), { "xaxis.range": ranges[name] });
  }
  for (const button of document.querySelectorAll("[data-range]")) {
    button.disabled = !ranges[button.dataset.range];
    button.addEventListener("click", () => {
      showRange(button.dataset.range);
      history.replaceState(null, "", address(isKnown(location.hash.slice(1, 11)) ? wanted : ""));
    });
  }

  /* The command that acknowledges the state, as it is filled in, to be copied. */
  const form = byId("acknowledge");
  if (form) {
    const command = byId("command");
    const quoted = (words) => `'${words.replaceAll("'", "'\\''")}'`;
    const fill = () => {
      const finding = form.finding.value ? ` --finding ${form.finding.value}` : "";
      command.textContent = `${command.dataset.start} --note ${quoted(form.note.value)}${finding}`;
    };
    form.addEventListener("input", fill);
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      fill();
      getSelection().selectAllChildren(command);
      /* Without the clipboard the command stands there selected. */
      await navigator.clipboard?.writeText(command.textContent).catch(() => {});
      byId("copied").textContent = "copied; run it on the machine with the tables";
    });
    fill();
  }

  draw("course", page.course);
  if (page.course.data) {
    plotOf("course").on("plotly_click", (event) => go(String(event.points[0].x).slice(0, 10)));
    /* On paper it is as wide as the sheet (`zoom` of report.css), whatever the window is. */
    const resize = (width) => Plotly.relayout(plotOf("course"), { width, autosize: !width });
    window.addEventListener("beforeprint", () => resize(1030));
    window.addEventListener("afterprint", () => resize(null));
  }
  select.append(
    ...page.nights
      .map((night, at) => element("option", { value: night }, `${night}, ${page.statuses[at]}`))
      .reverse(),
  );
  const step = (by) => go(page.nights[page.nights.indexOf(wanted) + by] ?? "");
  select.addEventListener("change", () => go(select.value));
  byId("earlier").addEventListener("click", () => step(-1));
  byId("later").addEventListener("click", () => step(1));
  byId("picker").addEventListener("submit", (event) => event.preventDefault());
  window.addEventListener("hashchange", fromHash);
  fromHash();
  if (!wanted) choose(page.nights.at(-1));

  return {
    /* Called by a night's script. */
    night: (payload) => {
      loaded.set(payload.night, payload);
      if (payload.night === wanted) show(payload);
    },
  };
})();
