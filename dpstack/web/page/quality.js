// The quality of values as the stream names it. Nothing is judged here but what the page alone knows: that it shows old values.

import { el, setAttr, setText } from "./dom.js";
import { wordOf } from "./format.js";
import { mark } from "./marks.js";

const WORST = ["good", "uncertain", "stale", "bad"];
const KINDS = { good: "good", uncertain: "warn", stale: "off", bad: "bad" };
const GOOD = { quality: "good", text: "" };
const NOT_ALIVE = { quality: "stale", text: "the slave does not give it any more" };
const PAGE_OLD = { quality: "stale", text: "this page gets no values" };

export function kindOfQuality(quality) {
  return KINDS[quality] ?? "off";
}

function worse(one, other) {
  return WORST.indexOf(one.quality) < WORST.indexOf(other.quality) ? other : one;
}

/** {quality, text, since} of a named value, of the drive and of all values without a name (null). `dead`: the page shows old values. */
export function qualityOf(slave, name, { dead = false, output = false } = {}) {
  // a stream of an older version has no qualities: it says only whether the inputs are those of this moment
  const told = (name === null ? null : slave.qualities?.[name]) ?? slave.quality ?? (slave.alive || output ? GOOD : NOT_ALIVE);
  return dead ? worse(told, PAGE_OLD) : told;
}

/** As `qualityOf`, of a named value, without the word for its number, which stands beside the number. */
export function fieldQuality(slave, field, options) {
  const told = qualityOf(slave, field.name, options);
  const word = wordOf(field, slave.fields?.[field.name]);
  return word && told.text?.startsWith(word) ? { ...told, text: told.text.slice(word.length).replace(/^; /, "") } : told;
}

/** The doubts about a slot, or about a channel of it in a direction: "input", "output". */
export function doubtsOf(slave, slot, direction = null, channel = null) {
  return (slave.doubts ?? []).filter((one) => one.slot === slot
    && (direction === null || one.direction === null || one.direction === undefined || one.direction === direction)
    && (channel === null || one.channel === null || one.channel === undefined || one.channel === channel));
}

/** The worst of these, which have a quality each; good if there are none. */
export function worstOf(all) {
  return all.reduce((found, one) => worse(found, one), GOOD);
}

/** The quality in words: the reason, where there is one. */
export function qualityText({ quality, text }) {
  return text ? `${quality}: ${text}` : quality;
}

/** A figure with the mark of its quality. A value that is not good has the words as its title, and for screen readers. */
export class Figure {
  constructor() {
    this.shown = el("span", { class: "figure" });
    this.words = el("span", { class: "visually-hidden" });
    this.node = el("span", { class: "reading" }, this.shown, this.words);
  }

  update(text, told) {
    setText(this.shown, text);
    const said = told.quality === "good" ? "" : qualityText(told);
    if (this.said === said) return;
    this.said = said;
    this.picture?.remove();
    this.picture = said ? mark(kindOfQuality(told.quality)) : null;
    if (this.picture) this.node.prepend(this.picture);
    setText(this.words, said && ` (${said})`);
    setAttr(this.node, "title", said || null);
    setAttr(this.node, "class", said ? `reading q-${told.quality}` : "reading");
  }
}
