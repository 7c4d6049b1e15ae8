/* The fleet page: filter and sort the motors that the page already lists. */
"use strict";

(() => {
  const table = document.getElementById("fleet");
  const form = document.getElementById("filters");
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const headers = [...table.tHead.rows[0].cells];
  const boxes = [...form.querySelectorAll("[name=state]")];
  const chosenStates = () => boxes.filter((box) => box.checked).map((box) => box.value);

  /* A motor that needs attention has a sentence above the table, which is searched, too. */
  const sentences = new Map(
    [...document.querySelectorAll(".attention li")].map((one) => [one.dataset.motor, one]),
  );
  const words = (row) => row.textContent + (sentences.get(row.dataset.motor)?.textContent ?? "");
  const texts = new Map(rows.map((row) => [row, words(row).toLowerCase()]));

  function filter() {
    const wanted = form.find.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    const type = form.type.value;
    const states = chosenStates();
    let shown = 0;
    for (const row of rows) {
      const text = texts.get(row);
      row.hidden =
        !states.includes(row.dataset.state) ||
        (type !== "" && row.dataset.type !== type) ||
        !wanted.every((word) => text.includes(word));
      shown += row.hidden ? 0 : 1;
      const sentence = sentences.get(row.dataset.motor);
      if (sentence) sentence.hidden = row.hidden;
    }
    document.getElementById("shown").textContent =
      shown === rows.length ? "" : `${shown} of ${rows.length} shown`;
    document.getElementById("nothing").hidden = shown > 0;
    remember();
  }

  /* The filters and the order stand in the address, so that a view can be sent. */
  function remember() {
    const said = new URLSearchParams();
    if (form.find.value) said.set("find", form.find.value);
    if (form.type.value) said.set("type", form.type.value);
    const states = chosenStates();
    if (states.length < boxes.length) said.set("state", states.join(" "));
    const sorted = headers.find((header) => header.ariaSort);
    if (sorted !== headers[1] || sorted.ariaSort !== "ascending")
      said.set("sort", `${sorted.cellIndex} ${sorted.ariaSort}`);
    history.replaceState(null, "", `#${said}`);
  }

  function recall() {
    const said = new URLSearchParams(location.hash.slice(1));
    form.find.value = said.get("find") ?? "";
    form.type.value = said.get("type") ?? "";
    if (form.type.selectedIndex < 0) form.type.value = "";
    const states = said.get("state")?.split(" ");
    for (const box of boxes) box.checked = states === undefined || states.includes(box.value);
    const [column, order] = said.get("sort")?.split(" ") ?? [1, "ascending"];
    if (headers[column]?.dataset.sort) sort(headers[column], order);
    filter();
  }

  /* A cell's value; rows without one come last, whichever way the others are sorted. */
  function value(row, column) {
    const text = row.cells[column].dataset.value;
    return text === "" || text === undefined ? null : text;
  }

  function sort(header, way) {
    const column = header.cellIndex;
    for (const other of headers) other.removeAttribute("aria-sort");
    header.setAttribute("aria-sort", way === "descending" ? way : "ascending");
    const sign = way === "descending" ? -1 : 1;
    const place = new Map(rows.map((row, index) => [row, index]));
    const sorted = [...rows].sort((a, b) => {
      const [x, y] = [value(a, column), value(b, column)];
      if (x === null || y === null)
        return (x === null) - (y === null) || place.get(a) - place.get(b);
      const difference = x - y;
      const order = Number.isNaN(difference)
        ? x.localeCompare(y, "en", { numeric: true })
        : difference;
      return sign * order || place.get(a) - place.get(b);
    });
    body.append(...sorted);
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
  form.addEventListener("input", filter);
  form.addEventListener("change", filter); /* not every browser says input of a select */
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(filter));
  document.getElementById("reset").addEventListener("click", () => form.reset());
  window.addEventListener("hashchange", recall);
  form.hidden = false;
  recall();
})();
