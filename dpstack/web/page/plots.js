// uPlot with the colours of the page.

import uPlot from "./uplot/uPlot.esm.js";

export { uPlot };

const TRACES = 8;

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** The colour of the n-th trace, and its dashes: traces are told apart without colours too. */
export function trace(n) {
  return { stroke: colour(`--trace-${n % TRACES}`), dash: [[], [8, 4], [2, 3], [10, 3, 2, 3]][Math.floor(n / 2) % 4] };
}

export function axis(more = {}) {
  return {
    stroke: colour("--faint"), font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
    grid: { stroke: colour("--grid"), width: 1 }, ticks: { stroke: colour("--grid"), width: 1, size: 4 }, ...more,
  };
}

/** Calls `again` when the page turns dark or light. Returns a function that ends it. */
export function onTheme(again) {
  const query = window.matchMedia("(prefers-color-scheme: dark)");
  query.addEventListener("change", again);
  return () => query.removeEventListener("change", again);
}
