// The rack of a slave as the online view of a PLC tool shows it: slots with their modules, channels, and the values beside them.

import { el, refill, setAttr, setText } from "./dom.js";
import { fieldValue, kindOf, octets } from "./format.js";
import { mark } from "./marks.js";
import { channelsOf, overlap, placeOf, placeText, rawText } from "./points.js";
import { Figure, doubtsOf, fieldQuality, kindOfQuality, qualityOf, qualityText, worstOf } from "./quality.js";

const IMAGES = { input: "inputs", output: "outputs" };

/** A named value beside its channel: name, figure, unit, and its quality in words if it is not good. */
class NamedValue {
  constructor(field, output, more) {
    this.field = field;
    this.output = output;
    this.shown = new Figure();
    this.words = el("span", { class: "words" });
    this.node = el("span", { class: "value" }, el("bdi", { class: "faint", text: field.name }), " ", this.shown.node,
      field.unit ? el("span", { class: "unit", text: ` ${field.unit}` }) : null, more ? el("span", { class: "faint", text: ` (${more})` }) : null, this.words);
  }

  update(slave, dead) {
    const told = fieldQuality(slave, this.field, { dead, output: this.output });
    this.shown.update(fieldValue(this.field, slave.fields?.[this.field.name]), told);
    setText(this.words, told.quality === "good" ? "" : qualityText(told));
    setAttr(this.words, "class", `words ${kindOfQuality(told.quality)}`);
    return told;
  }
}

/** A channel: its number, raw content, the values in it. One without a number stands for all octets of a direction. */
class Channel {
  constructor(slot, direction, place, values) {
    Object.assign(this, { slot, direction, place, values });
    this.raw = el("code", { class: "raw", title: placeText(place) });
    this.words = el("span", { class: "words" });
    const number = place.channel === undefined ? placeText(place) : String(place.channel);
    this.node = el("li", { "data-channel": place.channel ?? null }, el("span", { class: "number", text: number }), this.raw, ...values.map((one) => one.node), this.words);
  }

  update(slave, dead) {
    const { slot, direction, place } = this;
    const doubts = doubtsOf(slave, slot, direction, place.channel ?? null);
    const told = this.values.map((one) => one.update(slave, dead));
    const all = qualityOf(slave, null, { dead, output: direction === "output" });
    const worst = worstOf([...told, ...doubts, all]);
    setText(this.raw, rawText(slave[IMAGES[direction]], place));
    setAttr(this.node, "class", `${worst.quality === "good" ? "" : `q-${worst.quality}`}${place.bits === 1 && this.raw.textContent === "1" ? " high" : ""}`.trim() || null);
    // the words of a channel stand once: beside its value, else at the channel
    const own = doubts.filter((one) => one.channel !== null && one.channel !== undefined && !told.some((other) => other.text === one.text));
    setText(this.words, own.map((one) => one.text).join("; "));
    setAttr(this.words, "class", own.length ? `words ${kindOfQuality(worstOf(own).quality)}` : "gone");
  }
}

class Slot {
  constructor(about, module, fields) {
    this.slot = module.slot;
    this.sign = el("span", { class: "slot-sign" });
    this.doubts = el("ul", { class: "plain doubts" });
    this.channels = [];
    // a stream of an older version does not say where the octets of a slot are
    const lists = ["input", "output"].filter((one) => module[`${one}s`] && typeof module[`${one}_at`] === "number").map((direction) => this.list(module, direction, fields[direction]));
    this.node = el("article", { class: "slot", "data-slot": module.slot, "aria-label": `Slot ${module.slot}` },
      el("header", {}, this.sign, el("h3", { text: `Slot ${module.slot}` }), el("span", { class: "module", text: module.name || (module.config ? "" : "(empty)") }),
        module.config ? el("code", { class: "faint", title: "identifier octets", text: octets(String(module.config), 8) }) : null),
      this.doubts, ...lists);
  }

  list(module, direction, fields) {
    const places = channelsOf(module, direction);
    const whole = { octet: module[`${direction}_at`], length: module[`${direction}s`], bit: 0, bits: 8 * module[`${direction}s`] };
    const all = places.length ? places : [whole];
    const inside = fields.filter(({ place }) => place && overlap(place, whole));
    const rows = all.map((place) => {
      // a value stands at the first of the channels that it covers
      const own = inside.filter((one) => !one.shown && overlap(one.place, place));
      return new Channel(module.slot, direction, place, own.map((one) => {
        one.shown = true;
        return new NamedValue(one.field, direction === "output", place.channel === undefined || one.place.bits > place.bits || one.place.bits < place.bits ? placeText(one.place) : null);
      }));
    });
    this.channels.push(...rows);
    const bits = places.length > 0 && places[0].bits === 1;
    return el("div", { class: "direction" }, el("h4", { text: direction === "input" ? "Inputs" : "Outputs" }),
      el("ol", { class: bits ? "channels bits" : "channels" }, ...rows.map((one) => one.node)));
  }

  update(slave, dead) {
    const doubts = doubtsOf(slave, this.slot);
    const worst = worstOf(doubts);
    const kind = doubts.length ? kindOfQuality(worst.quality) : "";
    setAttr(this.node, "class", kind && kind !== "good" ? `slot ${kind}-slot` : "slot");
    refill(this.sign, kind, () => (kind && kind !== "good" ? [mark(kind)] : []));
    // those of a channel stand beside it, the slot's header has all
    refill(this.doubts, doubts, () => doubts.map((one) => el("li", { class: kindOfQuality(one.quality) },
      one.text, one.remedy ? el("span", { class: "quiet remedy", text: one.remedy }) : null)));
    for (const one of this.channels) one.update(slave, dead);
  }
}

/** Slots with channels, values, qualities and raw octets of a slave; `node` is null for a slave whose slots are not known. */
export class Rack {
  constructor(app, address) {
    this.app = app;
    this.address = address;
    const about = app.live.about(address);
    const modules = (about.modules ?? []).map((one, n) => ({ slot: n + 1, ...one }));
    const placed = (all) => (all ?? []).map((field) => ({ field, place: placeOf(field.at) }));
    const fields = { input: placed(about.inputs), output: placed(about.outputs) };
    this.known = new Set(modules.map((one) => one.slot));
    this.slots = modules.map((one) => new Slot(about, one, fields));
    this.all = el("p");
    this.elsewhere = el("ul", { class: "plain doubts" });
    this.node = modules.length ? el("div", { class: "rack-view" }, this.all, this.elsewhere, el("div", { class: "rack" }, ...this.slots.map((one) => one.node))) : null;
  }

  update(slave) {
    if (!this.node) return;
    const { dead } = this.app;
    const told = qualityOf(slave, null, { dead });
    setText(this.all, told.quality === "good" ? "" : `All values are ${qualityText(told)}`);
    setAttr(this.all, "class", told.quality === "good" ? "gone" : kindOfQuality(told.quality));
    const elsewhere = (slave.doubts ?? []).filter((one) => !this.known.has(one.slot));
    refill(this.elsewhere, elsewhere, () => elsewhere.map((one) => el("li", { class: kindOf(slave.level), text: one.text })));
    for (const one of this.slots) one.update(slave, dead);
  }
}
