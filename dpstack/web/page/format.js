// Numbers, units, times and states as texts.

export const NONE = "–";

/** Up to six significant digits, no trailing zeros; whole numbers as they are. */
export function number(value) {
  if (typeof value !== "number" || !Number.isFinite(value)) return NONE;
  if (Number.isInteger(value)) return String(value).replace("-", "−");
  return String(Number(value.toPrecision(6))).replace("-", "−");
}

/** A value of process data: on or off, a number, octets as hex. */
export function value(one) {
  if (one === null || one === undefined) return NONE;
  if (typeof one === "boolean") return one ? "on" : "off";
  return typeof one === "number" ? number(one) : String(one);
}

/** The word for the number of a named value; empty where its numbers mean themselves. */
export function wordOf(field, one) {
  return field.words && typeof one === "number" ? field.words[one] ?? "no meaning" : "";
}

/** A named value without its unit: a number that has a word with it. */
export function fieldValue(field, one) {
  const word = wordOf(field, one);
  return word ? `${value(one)} (${word})` : value(one);
}

export function count(one) {
  return typeof one === "number" ? one.toLocaleString("en-US").replaceAll(",", "\u202f") : NONE;
}

/** Octets in groups of two digits, at most `limit` of them. */
export function octets(hex, limit = Infinity) {
  if (typeof hex !== "string") return NONE;
  if (!hex) return "none";
  const shown = hex.slice(0, limit * 2).replace(/../g, "$& ").trimEnd();
  return hex.length > limit * 2 ? `${shown} … (${hex.length / 2})` : shown;
}

export function percent(part, digits = 0) {
  return typeof part === "number" ? `${number(Number((part * 100).toFixed(digits)))}\u202f%` : NONE;
}

/** Microseconds as µs, ms or s. */
export function micros(us) {
  if (typeof us !== "number") return NONE;
  if (us < 10000) return `${number(us)} µs`;
  return us < 1e6 ? `${number(Number((us / 1000).toPrecision(4)))} ms` : `${number(Number((us / 1e6).toPrecision(4)))} s`;
}

export function millis(ms) {
  return typeof ms === "number" ? micros(ms * 1000) : NONE;
}

export function duration(seconds) {
  if (typeof seconds !== "number") return NONE;
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const whole = Math.floor(seconds);
  const parts = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  return parts.map((one) => String(one).padStart(2, "0")).join(":");
}

/** Local wall clock of seconds since 1970, with milliseconds where asked. */
export function clock(seconds, fine = false) {
  const date = new Date(seconds * 1000);
  if (Number.isNaN(date.getTime())) return NONE;
  const text = [date.getHours(), date.getMinutes(), date.getSeconds()].map((one) => String(one).padStart(2, "0"));
  return text.join(":") + (fine ? `.${String(date.getMilliseconds()).padStart(3, "0")}` : "");
}

export function rate(baud) {
  if (typeof baud !== "number") return NONE;
  return baud >= 1e6 ? `${number(baud / 1e6)} Mbit/s` : `${number(baud / 1e3)} kbit/s`;
}

export function words(name) {
  const text = String(name).replaceAll("_", " ");
  return text.charAt(0).toUpperCase() + text.slice(1);
}

// Marks and colours of the levels and severities that the stream names.
const KINDS = { good: "good", busy: "busy", off: "off", info: "info", warning: "warn", error: "bad" };

export function kindOf(level) {
  return KINDS[level] ?? "off";
}

/** The state of a slave in the words of the stream. */
export function stateText(slave) {
  return words(slave.state_text ?? "unknown");
}

const MODES = { operate: ["Operate", "good"], clear: ["Clear", "warn"], stop: ["Stop", "off"], offline: ["Offline", "off"] };

export function modeText(mode) {
  return MODES[mode]?.[0] ?? (mode ? words(mode) : "Unknown");
}

export function modeKind(mode) {
  return MODES[mode]?.[1] ?? "off";
}
