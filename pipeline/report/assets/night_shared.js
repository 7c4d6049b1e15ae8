/* What the figures and tables of one night share. */
"use strict";

motorLeakage.ofNight = (() => {
  const { COLOURS, plain, word } = motorLeakage;

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

  const unfitted = (night) =>
    `The night was not fitted (${word("statuses", night.fit.status)}); why stands at its top.`;

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

  return { PARTS, LOOKS, INPUTS, unfitted, parameterName, stamp };
})();
