/* One night of a motor: chosen, loaded as a script of its own, and shown. */
"use strict";

(() => {
  const { page, element, show, word, nightFigures, nightTables } = motorLeakage;

  const byId = (id) => document.getElementById(id);
  const select = byId("choose");

  /* Choosing and loading */

  const loaded = new Map();
  let wanted = "";

  const isKnown = (night) => page.nights.includes(night);
  const hasFile = (night) => page.detailed[page.nights.indexOf(night)] === 1;

  motorLeakage.chooseNight = (night) => {
    if (!isKnown(night)) return;
    if (location.hash === `#${night}`) fromHash();
    else location.hash = night;
  };

  /* The night's script calls this. */
  motorLeakage.night = (payload) => {
    loaded.set(payload.night, payload);
    if (payload.night === wanted) render(payload);
  };

  function choose(night) {
    wanted = night;
    select.value = night;
    motorLeakage.overNights.markNight(night);
    const place = page.nights.indexOf(night);
    byId("earlier").disabled = place <= 0;
    byId("later").disabled = place >= page.nights.length - 1;
    if (loaded.has(night)) return render(loaded.get(night));
    if (!hasFile(night))
      return fail(
        `The figures of ${night} are not in this report, which was made with fewer nights; those over the nights are above.`,
      );
    busy(true);
    byId("said").textContent = `loading ${night}`;
    const source = `../data/${encodeURIComponent(page.file)}/${night}.js`;
    const script = element("script", { src: source });
    script.addEventListener("load", () => script.remove());
    script.addEventListener("error", () => {
      script.remove();
      if (wanted === night)
        fail(
          `${source.slice(3)} is not there; copy the whole folder of the report, or make it again.`,
        );
    });
    document.head.append(script);
    return undefined;
  }

  const busy = (isBusy) =>
    ["night", "analyst"].forEach((id) => byId(id).classList.toggle("busy", isBusy));

  function fail(why) {
    byId("said").textContent = "";
    byId("outcome").textContent = why;
    busy(false);
    for (const id of ["parameters", "quality", "files", "residual-verdicts"])
      byId(id).replaceChildren();
    for (const id of Object.keys(nightFigures)) show(id, () => ({ absent: why }));
  }

  /* A night that is chosen comes into view, and is marked there and in the charts. */
  function fromHash() {
    const night = location.hash.slice(1);
    if (!isKnown(night)) return;
    if (night !== wanted) choose(night);
    byId("night").classList.add("chosen");
    byId("night").scrollIntoView();
  }

  const lastGood = () => {
    const place = page.statuses.lastIndexOf("ok");
    return page.nights[place >= 0 ? place : page.nights.length - 1];
  };
  const step = (by) =>
    motorLeakage.chooseNight(page.nights[page.nights.indexOf(wanted) + by] ?? "");

  /* Figures of a night */

  function render(night) {
    busy(false);
    byId("said").textContent = "";
    byId("outcome").textContent = nightTables.outcome(night);
    byId("parameters").replaceChildren(...nightTables.parameters(night));
    byId("quality").replaceChildren(...nightTables.quality(night));
    byId("files").replaceChildren(nightTables.files(night));
    byId("residual-verdicts").replaceChildren(...nightTables.verdicts(night));
    for (const [id, build] of Object.entries(nightFigures)) show(id, () => build(night));
    document.body.dataset.night = night.night;
  }

  select.append(
    ...page.nights
      .map((night, place) =>
        element("option", { value: night }, `${night}, ${word("statuses", page.statuses[place])}`),
      )
      .reverse(),
  );
  select.addEventListener("change", () => motorLeakage.chooseNight(select.value));
  byId("earlier").addEventListener("click", () => step(-1));
  byId("later").addEventListener("click", () => step(1));
  byId("good").disabled = !page.statuses.includes("ok");
  byId("good").addEventListener("click", () => motorLeakage.chooseNight(lastGood()));
  byId("picker").addEventListener("submit", (event) => event.preventDefault());
  window.addEventListener("hashchange", fromHash);
  fromHash();
  if (!wanted) choose(lastGood());
})();
