/* The fleet page: filter and sort the motors that the page already lists. */
"use strict";

(() => {
  const table = document.getElementById("fleet");
  const form = document.getElementById("filters");
  const body = table.tBodies[0];
  const rows = [...body.rows];

  const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));

  function filter() {
    const wanted = form.find.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    const type = form.type.value;
    const states = new Set(
      [...form.querySelectorAll("[name=state]:checked")].map((box) => box.value),
    );
    let shown = 0;
    for (const row of rows) {
      const text = texts.get(row);
      row.hidden =
        !states.has(row.dataset.state) ||
        (type !== "" && row.dataset.type !== type) ||
        !wanted.every((word) => text.includes(word));
      shown += row.hidden ? 0 : 1;
    }
    document.getElementById("shown").textContent =
      shown === rows.length ? "" : `${shown} of ${rows.length} shown`;
    document.getElementById("nothing").hidden = shown > 0;
  }

  /* A cell's value; rows without one come last, whichever way the others are sorted. */
  function value(row, column) {
    const text = row.cells[column].dataset.value;
    return text === "" || text === undefined ? null : Number(text);
  }

  function sort(header) {
    const column = header.cellIndex;
    const descends = header.getAttribute("aria-sort") === "ascending";
    for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    header.setAttribute("aria-sort", descends ? "descending" : "ascending");
    const sign = descends ? -1 : 1;
    const place = new Map(rows.map((row, index) => [row, index]));
    const sorted = [...rows].sort((a, b) => {
      const [x, y] = [value(a, column), value(b, column)];
      if (x === null || y === null)
        return (x === null) - (y === null) || place.get(a) - place.get(b);
      return sign * (x - y) || place.get(a) - place.get(b);
    });
    body.append(...sorted);
  }

  for (const header of table.tHead.rows[0].cells) {
    if (!header.dataset.sort) continue;
    const button = document.createElement("button");
    button.type = "button";
    button.append(header.firstChild);
    header.prepend(button);
    button.addEventListener("click", () => sort(header));
  }
  form.addEventListener("input", filter);
  form.addEventListener("change", filter); /* not every browser says input of a select */
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(filter));
  document.getElementById("reset").addEventListener("click", () => form.reset());
  form.hidden = false;
  filter();
})();
