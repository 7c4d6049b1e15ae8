/* What the figures and tables of one night share. */
"use strict";

motorLeakage.ofNight = (() => {
  const { COLOURS, plain, word } = motorLeakage;

  const PARTS = { training: "t", validation: "v" };
  const LOOKS = {
    training: { color: COLOURS.blue, symbol: "circle" },
    validation: { color: "#a86f00", symbol: "square-open" },
  };
  /* Name in the payload, in words, unit, and how its columns of `fits` end. */
  const INPUTS = [
    ["pressure", "pressure difference", "bar", "pressure_bar"],
    ["temperature", "oil temperature", "°C", "temperature_c"],
    ["speed", "speed", "rpm", "speed_rpm"],
  ];

  const unfitted = (night) =>
    `The night was not fitted (${word("statuses", night.fit.status)}); why stands at its top.`;

  /* In place of a figure: why there is none, of a night that was fitted and of one that was not. */
  const noFigure = (night, ofFitted) => ({
    absent: ofFitted && night.fit.status === "ok" ? ofFitted : unfitted(night),
  });

  const SYMBOLS = {
    K: "K",
    h: "h",
    e: "e",
    C: "C",
    scale: "scale of",
    share: "share of",
    film_thickness_ratio: "Λ",
  };

  /* `K_piston_ring` as people write it. */
  function parameterName(name) {
    if (name === "C_f") return "flushing flow C_f";
    const prefix = Object.keys(SYMBOLS).find((one) => name.startsWith(`${one}_`));
    return prefix ? `${SYMBOLS[prefix]} ${plain(name.slice(prefix.length + 1))}` : plain(name);
  }

  const stamp = (ms) => new Date(ms).toISOString().slice(0, 19).replace("T", " ");

  return { PARTS, LOOKS, INPUTS, unfitted, noFigure, parameterName, stamp };
})();
