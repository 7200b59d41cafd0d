// Single values of a plant: named values, quantities of drives, channels of modules; and their places in the octets.

import { fieldValue, number, octets, value } from "./format.js";
import { doubtsOf, fieldQuality, qualityOf, worstOf } from "./quality.js";

// Quantities of a drive: `unit` after multiplication by `scale`, rounded to `places`.
export const QUANTITIES = [
  { name: "speed", text: "Speed", unit: "%", scale: 100, places: 1 },
  { name: "setpoint", text: "Set point", unit: "%", scale: 100, places: 1 },
  { name: "frequency_hz", text: "Frequency", unit: "Hz", scale: 1, places: 2 },
  { name: "current", text: "Current", unit: "%", scale: 100, places: 1 },
  { name: "torque", text: "Torque", unit: "%", scale: 100, places: 1 },
];

/** The quantity of a drive without its unit; null if the drive does not give it. */
export function quantity(drive, { name, scale, places }) {
  const one = drive?.[name];
  return typeof one === "number" ? number(Number((one * scale).toFixed(places))) : null;
}

const AT = /^(bool|bytes|[uif](\d+)(?:le|ws)?)@(\d+)(?:\.(\d+))?(?::(\d+))?$/;

/** The place of a named value: {octet, length, bit, bits}; `bit` is counted from the lowest one. Null for an unknown text. */
export function placeOf(at) {
  const found = AT.exec(String(at ?? "").replaceAll(" ", ""));
  if (!found) return null;
  const bit = Number(found[4] ?? 0);
  const bits = found[1] === "bool" ? 1 : found[1] === "bytes" ? 8 * Number(found[5] ?? 0) : Number(found[2]);
  return { octet: Number(found[3]), length: Math.ceil((bit + bits) / 8), bit, bits };
}

/** The octets of a place as hex digits; "" where the image has none. */
export function rawOf(hex, { octet, length }) {
  return typeof hex === "string" ? hex.slice(2 * octet, 2 * (octet + length)) : "";
}

export function placeText({ octet, length, bit, bits }) {
  const where = length === 1 ? `octet ${octet}` : `octets ${octet} to ${octet + length - 1}`;
  return bits % 8 ? `${where}, bit${bits === 1 ? "" : "s"} ${bit}${bits === 1 ? "" : ` to ${bit + bits - 1}`}` : where;
}

/** The channels of a module in a direction, "input" or "output": places with their `channel`; none if their width is not known. */
export function channelsOf(module, direction) {
  const width = module[`${direction}_width`] || 0;
  const at = module[`${direction}_at`];
  const many = width && typeof at === "number" ? Math.floor((8 * (module[`${direction}s`] || 0)) / width) : 0;
  return Array.from({ length: many }, (_, channel) => {
    const start = 8 * at + channel * width;
    const octet = Math.floor(start / 8);
    return { channel, octet, bit: start % 8, bits: width, length: Math.ceil((start % 8 + width) / 8) };
  });
}

/** Whether two places share bits; within one octet bits count, else octets. */
export function overlap(one, other) {
  if (one.octet >= other.octet + other.length || other.octet >= one.octet + one.length) return false;
  return one.length > 1 || other.length > 1 || (one.bit < other.bit + other.bits && other.bit < one.bit + one.bits);
}

/** The number that stands in the bits of a place within one octet. */
export function bitsOf(hex, place) {
  const raw = rawOf(hex, place);
  return raw ? (parseInt(raw, 16) >> place.bit) & ((1 << place.bits) - 1) : null;
}

/** The raw content of a channel: on or off, a few bits as a number, octets. */
export function rawText(hex, place) {
  if (place.length > 1 || place.bits === 8) return octets(rawOf(hex, place));
  const bits = bitsOf(hex, place);
  return bits === null ? "–" : String(bits);
}

function namedPoint(address, slave, field, output) {
  const place = placeOf(field.at);
  return {
    id: `${address}.${field.name}`, address, field, output, place, label: `${slave.name}.${field.name}`, unit: field.unit ?? "",
    text: (now) => fieldValue(field, now.fields?.[field.name]),
    raw: (now) => (place ? rawOf(output ? now.outputs : now.inputs, place) : ""),
    quality: (now, dead) => fieldQuality(now, field, { dead, output }),
  };
}

function quantityPoint(address, slave, one) {
  return {
    id: `${address}:${one.name}`, address, place: null, label: `${slave.name}: ${one.text.toLowerCase()}`, unit: one.unit,
    text: (now) => quantity(now.drive, one) ?? "–",
    raw: () => "",
    quality: (now, dead) => qualityOf(now, null, { dead }),
  };
}

function channelPoint(address, slave, module, direction, place) {
  const image = direction === "input" ? "inputs" : "outputs";
  const output = direction === "output";
  return {
    id: `${address}/${module.slot}/${direction}/${place.channel}`, address, place, unit: "",
    label: `${slave.name}: slot ${module.slot}${module.name ? ` (${module.name})` : ""}, ${direction} channel ${place.channel}`,
    text: (now) => (place.bits === 1 && now[image] ? value(Boolean(bitsOf(now[image], place))) : "–"),
    raw: (now) => rawOf(now[image], place),
    quality: (now, dead) => worstOf([qualityOf(now, null, { dead, output }), ...doubtsOf(now, module.slot, direction, place.channel)]),
  };
}

/** Everything of a plant that can be watched: {id, address, label, unit, place, text(slave), raw(slave), quality(slave, dead)}; a named value also has `field` and `output`. */
export function pointsOf(live) {
  const found = [];
  const channels = []; // behind all that has a name
  for (const [key, slave] of Object.entries(live.plant?.slaves ?? {})) {
    const address = Number(key);
    for (const field of slave.inputs ?? []) found.push(namedPoint(address, slave, field, false));
    for (const field of slave.outputs ?? []) found.push(namedPoint(address, slave, field, true));
    if (slave.drive) for (const one of QUANTITIES) found.push(quantityPoint(address, slave, one));
    for (const module of slave.modules ?? []) {
      for (const direction of ["input", "output"]) {
        for (const place of channelsOf(module, direction)) channels.push(channelPoint(address, slave, module, direction, place));
      }
    }
  }
  return [...found, ...channels];
}
