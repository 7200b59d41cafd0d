// The time on the bus (DP-V2), and records of time-stamped events, read when somebody asks for them.

import { cell, el, pairs, table } from "./dom.js";
import { clock, count, kindOf, millis, number } from "./format.js";
import { mark } from "./marks.js";

const RECORD_FIRST = 100;
const RECORD_LAST = 115;

/** `2026-11-29T12:00:00.250Z` as date and time of UTC. */
function utc(text) {
  return typeof text === "string" ? `${text.replace("T", " ").replace("Z", "")} UTC` : null;
}

function kept(one) {
  return one.synchronised === false ? "not synchronised (SYF)" : "synchronised";
}

/** The state of the time on the bus, `bus.clock` of the stream. `since`: wall clock of a time of the bus. */
export function clockView(clocks, since) {
  const { sent, remark, masters = [] } = clocks;
  const kind = kindOf(remark?.severity);
  const rows = clocks.interval_s === null || clocks.interval_s === undefined ? [["This master", "sends no time"]] : [
    ["This master", `sends the time every ${number(clocks.interval_s)} s`],
    ["Resolution (CR)", sent ? `${sent.resolution_ms} ms` : null],
    ["Lateness of the port, 99.9 %", typeof clocks.late_ms === "number" && sent ? `${millis(clocks.late_ms)}${clocks.late_measured ? ", measured" : ", not measured yet: that of its kind"}` : null],
    ["Clock of this computer (SYF)", sent ? kept(sent) : null],
    ["Last time sent", sent ? utc(sent.time) : "none yet"],
    ["Times sent", sent ? count(sent.values) : null],
  ];
  return [
    remark ? el("p", { class: kind }, mark(kind), remark.text) : null,
    pairs(rows, "pairs numbers"),
    masters.length ? table("Other masters that send the time", [["Master"], ["Last time"], ["Resolution", "n"], ["Its clock"], ["Heard", "n"]], masters.map((one) => el("tr", { "data-address": one.address },
      cell(one.address), cell(utc(one.time)), cell(`${one.resolution_ms} ms`, "n"), cell(kept(one), one.synchronised === false ? "warn" : null), cell(`${clock(since(one.at))}, ${count(one.values)} times`, "n")))) : null,
  ];
}

/** The events of a record, the answer to the ask `stamps` of a slave. */
export function stampsView(found) {
  const rows = found.events ?? [];
  const head = el("p", { text: `Record ${found.index}: ${rows.length} ${rows.length === 1 ? "event" : "events"}, read ${clock(Date.now() / 1000)}. Times are those of the device.` });
  if (!rows.length) return [head];
  return [head, table(`Time-stamped events of record ${found.index}`, [["Time (UTC)"], ["Slot", "n"], ["Signal", "n"], ["State"], ["Kind"]], rows.map((one) => el("tr", {},
    cell(utc(one.time)?.replace(" UTC", ""), "figure"), cell(one.slot, "n"), cell(one.signal, "n"), cell(one.state_text || "–"), cell(one.kind_text))), "stamped")];
}

/** What an alarm announces, with a button that reads it; null for other alarms. */
export function announced(event, read) {
  const stamps = event.time_stamps;
  if (!stamps) return null;
  const notes = [stamps.buffer_overrun ? "events were lost: its buffer was full" : null, stamps.restarted ? "the device has begun to stamp anew" : null].filter(Boolean);
  const events = `${stamps.events} ${stamps.events === 1 ? "event" : "events"} of record ${stamps.index}`;
  return el("div", {},
    notes.length ? el("p", { class: "warn" }, mark("warn"), notes.join("; ")) : null,
    el("div", { class: "buttons" }, el("button", { type: "button", "data-key": `stamps-${event.number}`, text: `Read ${events}`, on: { click: () => read(stamps.index) } })));
}

/** The number of a record of time stamps that somebody typed, or null. */
export function recordOf(text) {
  const found = /^\d+$/.test(text.trim()) ? Number(text) : NaN;
  return found >= RECORD_FIRST && found <= RECORD_LAST ? found : null;
}
