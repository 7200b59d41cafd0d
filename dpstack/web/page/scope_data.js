// The data of the oscilloscope: samples of signals, triggers, CSV. Nothing here draws.

import { QUANTITIES } from "./points.js";
import { qualityOf } from "./quality.js";

// Samples kept of each signal: an hour at five a second.
const KEPT = 18000;
// All signals are kept from the start where there are at most so many; of more only the chosen ones.
const KEPT_ALL = 96;

// Rounds kept of the chosen signals.
const KEPT_ROUNDS = 30000;
const NUMBERS = /^(bool|[iuf](8|16|32|64)(le)?)$/;

/** Whether a value can be drawn: a trace has no quality beside it. */
function drawn(slave, name, output = false) {
  const { quality } = qualityOf(slave, name, { output });
  return quality === "good" || quality === "uncertain";
}

/** All signals of a plant: {id, label, unit, kind, read(live)}; one that the run gives for each round has the factor `rounds`; `read` gives NaN where there is no value, and while it is bad or stale. */
export function signalsOf(live) {
  const found = [];
  for (const [key, slave] of Object.entries(live.plant?.slaves ?? {})) {
    const address = Number(key);
    const of = (read) => (state) => {
      const now = state.slaves.get(address);
      const one = now ? read(now) : null;
      if (typeof one === "boolean") return one ? 1 : 0;
      return typeof one === "number" ? one : NaN;
    };
    const names = [...(slave.inputs ?? []).map((one) => [one, true]), ...(slave.outputs ?? []).map((one) => [one, false])];
    for (const [field, input] of names) {
      const plain = String(field.type ?? "").toLowerCase();
      if (!NUMBERS.test(plain)) continue;
      found.push({
        id: `${address}.${field.name}`, address, label: `${slave.name}.${field.name}`, rounds: 1,
        unit: plain === "bool" ? "" : field.unit ?? "", kind: plain === "bool" ? "bool" : "number",
        read: of((now) => (drawn(now, field.name, !input) ? now.fields?.[field.name] : null)),
      });
    }
    if (slave.drive) {
      for (const { name, unit, scale } of QUANTITIES) {
        found.push({
          id: `${address}:${name}`, address, rounds: scale, label: `${slave.name}: ${name.replace("_hz", "")}`, unit, kind: "number",
          read: of((now) => (typeof now.drive?.[name] === "number" && drawn(now, null) ? now.drive[name] * scale : null)),
        });
      }
    }
    found.push({ id: `${address}:retries`, address, label: `${slave.name}: retries`, unit: "count", kind: "number", read: of((now) => now.retries) });
  }
  for (const name of ["p50", "p99", "max"]) {
    found.push({ id: `bus:${name}`, address: null, label: `bus: rotation ${name}`, unit: "µs", kind: "number", read: (state) => state.bus.rotation_us?.[name] ?? NaN });
  }
  return found;
}

/** Samples by time. `times` in s since the start; `signals` by id, each with `values` as long as `times`. */
export class Store {
  constructor() {
    this.times = [];
    this.signals = new Map();
    this.kept = new Set();
    this.events = [];
    this.marks = 0;
  }

  plant(live) {
    const before = this.signals;
    const again = this.started !== live.plant.started;
    if (again) {
      this.times = [];
      this.events = [];
      this.rounds = null;
    }
    this.started = live.plant.started;
    const all = signalsOf(live);
    this.signals = new Map(all.map((one) => [one.id, one]));
    this.keepsAll = all.length <= KEPT_ALL;
    this.kept = new Set([...this.kept].filter((id) => this.signals.has(id)));
    for (const one of all) {
      const old = again ? null : before.get(one.id)?.values;
      if (old) one.values = old;
    }
    if (this.keepsAll) for (const one of all) this.keep(one.id);
    else for (const id of [...this.kept]) this.keep(id);
  }

  /** Keep the samples of a signal from now on. */
  keep(id) {
    const signal = this.signals.get(id);
    if (!signal) return;
    this.kept.add(id);
    signal.values ??= new Array(this.times.length).fill(NaN);
  }

  drop(id) {
    if (this.keepsAll) return;
    this.kept.delete(id);
    const signal = this.signals.get(id);
    if (signal) signal.values = undefined;
  }

  sample(live) {
    const { t } = live;
    const last = this.times.at(-1);
    if (typeof t !== "number") return;
    if (t === last) { // another portion of the same snapshot
      for (const id of this.kept) {
        const signal = this.signals.get(id);
        signal.values[signal.values.length - 1] = signal.read(live);
      }
      return;
    }
    if (last !== undefined && t < last) {
      this.times = [];
      for (const id of this.kept) this.signals.get(id).values = [];
    }
    this.times.push(t);
    for (const id of this.kept) {
      const signal = this.signals.get(id);
      signal.values.push(signal.read(live));
    }
    if (this.times.length > KEPT * 1.1) {
      const over = this.times.length - KEPT;
      this.times.splice(0, over);
      for (const id of this.kept) this.signals.get(id).values.splice(0, over);
    }
  }

  event(live, event) {
    this.events.push({ t: live.eventT(event), event: event.event, address: event.address ?? null, text: event.text ?? "", severity: event.severity ?? "info" });
    if (this.events.length > 2200) this.events.splice(0, this.events.length - 2000);
  }

  /** The samples of each round for these ids from now on; those of other ids are forgotten. */
  follow(ids) {
    const key = ids.join("\n");
    if (this.rounds?.key === key) return this.rounds;
    this.rounds = { key, ids, after: 0, times: [], values: ids.map(() => []), lost: 0 };
    return this.rounds;
  }

  /** Take an answer of the run to the request for the rounds of `rounds`. */
  takeRounds(rounds, { rounds: rows, lost }) {
    const { times, values, ids } = rounds;
    const last = times.at(-1);
    if (rows.length && last !== undefined && (lost || rows[0][1] < last)) {
      if (rows[0][1] < last) { // another run
        times.length = 0;
        for (const one of values) one.length = 0;
      } else { // a gap
        times.push((last + rows[0][1]) / 2);
        for (const one of values) one.push(NaN);
      }
    }
    rounds.lost += lost;
    for (const [number, t, ...found] of rows) {
      rounds.after = number;
      times.push(t);
      ids.forEach((id, n) => {
        const one = found[n];
        values[n].push(typeof one === "boolean" ? Number(one) : typeof one === "number" ? one * (this.signals.get(id)?.rounds ?? 1) : NaN);
      });
    }
    if (times.length > KEPT_ROUNDS * 1.1) {
      const over = times.length - KEPT_ROUNDS;
      times.splice(0, over);
      for (const one of values) one.splice(0, over);
    }
  }

  /** The samples of a signal by round: {times, values}; null without any. */
  roundsOf(id) {
    const at = this.rounds?.ids.indexOf(id) ?? -1;
    return at >= 0 && this.rounds.times.length ? { times: this.rounds.times, values: this.rounds.values[at] } : null;
  }

  /** As `ofSnapshots`, but with a sample of each round where there are some. */
  slice(ids, from, to) {
    const { rounds } = this;
    if (!rounds?.times.length || !ids.some((id) => rounds.ids.includes(id))) return this.ofSnapshots(ids, from, to);
    const [begin, end] = [rounds.times[0], rounds.times.at(-1)];
    const slow = this.ofSnapshots(ids, from, to);
    const merged = slow.map(() => []);
    const takeSlow = (wanted) => slow[0].forEach((t, n) => {
      if (wanted(t)) slow.forEach((column, which) => merged[which].push(column[n]));
    });
    takeSlow((t) => t < begin);
    let behind = 0; // a signal without rounds keeps the value of its last snapshot
    for (let n = Math.max(0, lowerBound(rounds.times, from) - 1); n < rounds.times.length && rounds.times[n] <= to; n += 1) {
      const t = rounds.times[n];
      while (behind + 1 < slow[0].length && slow[0][behind + 1] <= t) behind += 1;
      merged[0].push(t);
      ids.forEach((id, which) => {
        const at = rounds.ids.indexOf(id);
        const one = at < 0 ? slow[which + 1][behind] : rounds.values[at][n];
        merged[which + 1].push(one === undefined || Number.isNaN(one) ? null : one);
      });
    }
    takeSlow((t) => t > end);
    return merged;
  }

  /** [times, values of each id ...] from `from` to `to`; null where there is no valid value, or a gap of over 2 s. */
  ofSnapshots(ids, from, to) {
    const first = Math.max(0, lowerBound(this.times, from) - 1);
    const end = Math.min(this.times.length, lowerBound(this.times, to) + 1);
    const times = [];
    const columns = ids.map(() => []);
    for (let n = first; n < end; n += 1) {
      const t = this.times[n];
      if (times.length && t - times.at(-1) > 2) {
        times.push(times.at(-1) + 0.001);
        for (const column of columns) column.push(null);
      }
      times.push(t);
      ids.forEach((id, which) => {
        const one = this.signals.get(id)?.values?.[n];
        columns[which].push(one === undefined || Number.isNaN(one) ? null : one);
      });
    }
    return [times, ...columns];
  }
}

export function lowerBound(sorted, wanted) {
  let low = 0;
  let high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < wanted) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Watches one signal or the events. `kind`: rising, falling, above, below, event. `at`: time of the trigger, or null. */
export class Trigger {
  constructor({ kind, id = null, level = 0, event = null }) {
    Object.assign(this, { kind, id, level, event });
    this.before = null;
    this.at = null;
  }

  /** A sample of the signal; returns whether this one triggers. */
  sample(t, value) {
    if (this.at !== null || this.kind === "event") return false;
    if (value === null || value === undefined || Number.isNaN(value)) {
      this.before = null; // an edge across a gap is none
      return false;
    }
    const { before, level } = this;
    this.before = value;
    const fires = {
      rising: before !== null && before < level && value >= level,
      falling: before !== null && before > level && value <= level,
      above: value > level,
      below: value < level,
    }[this.kind];
    if (fires) this.at = t;
    return Boolean(fires);
  }

  happened(event) {
    if (this.at !== null || this.kind !== "event" || event.event !== this.event) return false;
    this.at = event.t;
    return true;
  }
}

/** One field of a CSV file; a text that a spreadsheet would compute is marked as text. */
export function csvField(text) {
  const plain = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\r\n;]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
}

/** CSV of samples: wall clock (ISO), seconds since the start, one column a signal; no value: an empty field. */
export function toCsv(signals, [times, ...columns], wall) {
  const head = ["time", "t_s", ...signals.map((one) => one.label + (one.unit ? ` [${one.unit}]` : ""))];
  const lines = [head.map(csvField).join(",")];
  times.forEach((t, n) => {
    const values = columns.map((column) => column[n]);
    if (values.every((one) => one === null) && n > 0 && t - times[n - 1] < 0.0011) return; // the mark of a gap
    lines.push([new Date(wall(t) * 1000).toISOString(), t.toFixed(6), ...values.map((one) => (one === null ? "" : String(one)))].join(","));
  });
  return `${lines.join("\r\n")}\r\n`;
}
