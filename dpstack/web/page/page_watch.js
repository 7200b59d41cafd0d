// The watch table: chosen values of several slaves with quality, unit and raw octets. The address of the page has the choice.

import { el, refill, setAttr, setText } from "./dom.js";
import { octets } from "./format.js";
import { StateMark } from "./marks.js";
import { fieldForm } from "./orders.js";
import { placeText, pointsOf } from "./points.js";
import { Figure, kindOfQuality } from "./quality.js";

// Rows at most, and values offered at a time.
const MOST = 100;
const OFFERED = 60;

/** The choice in an address: ids behind "?", and `only`: the slave whose values are offered. */
function chosenIn(hash) {
  const query = hash.split("?")[1];
  if (query === undefined) return null;
  const parts = query.split("&").filter(Boolean);
  const plain = (one) => {
    try {
      return decodeURIComponent(one);
    } catch {
      return one;
    }
  };
  const only = parts.find((one) => one.startsWith("only="));
  return { ids: parts.filter((one) => one !== only).map(plain), only: only ? plain(only.slice(5)) : null };
}

class WatchRow {
  constructor(page, id, point) {
    const { app } = page;
    this.app = app;
    this.point = point;
    this.shown = new Figure();
    this.state = new StateMark();
    this.words = el("span", { class: "words" });
    this.raw = el("code", { class: "octets" });
    this.orders = el("td", { "data-label": "Order" });
    const remove = el("button", { type: "button", class: "quiet", "aria-label": `Remove ${point?.label ?? id}`, "data-key": `remove ${id}`, text: "×", on: { click: () => page.drop(id) } });
    this.node = point
      ? el("tr", { "data-id": id },
        el("th", { scope: "row" }, el("a", { href: `#/slave/${point.address}` }, el("bdi", { text: point.label })), point.place ? el("span", { class: "faint where", text: placeText(point.place) }) : null),
        el("td", { class: "n", "data-label": "Value" }, this.shown.node),
        el("td", { class: "unit", "data-label": "Unit", text: point.unit }),
        el("td", { "data-label": "Quality" }, this.state.node, this.words),
        el("td", { "data-label": "Octets" }, this.raw), this.orders, el("td", {}, remove))
      : el("tr", { "data-id": id }, el("th", { scope: "row" }, el("bdi", { text: id })), el("td", { colspan: 5, class: "faint", text: "This plant has no such value." }), el("td", {}, remove));
  }

  update() {
    const { app, point } = this;
    const slave = point && app.live.slaves.get(point.address);
    if (!slave) return;
    const told = point.quality(slave, app.dead);
    this.shown.update(point.text(slave), told);
    this.state.update(kindOfQuality(told.quality), told.quality);
    setText(this.words, told.text ?? "");
    const raw = point.raw(slave);
    setText(this.raw, raw ? octets(raw) : "");
    setAttr(this.raw, "class", ["good", "uncertain"].includes(told.quality) ? "octets" : "octets old");
    const { orders } = app;
    const command = !point.field ? null : point.output ? orders.sets(point.address) && "set" : orders.forces(point.address) && "force";
    refill(this.orders, [command, orders.allowed], () => (command ? [fieldForm(app, point.address, point.field, command)] : []));
  }
}

export class WatchPage {
  constructor(app) {
    this.app = app;
    this.title = "Watch table";
    this.rows = new Map();
  }

  build(root, kept) {
    const { live } = this.app;
    this.points = new Map(pointsOf(live).map((one) => [one.id, one]));
    this.filter = el("input", { id: "watch-filter", type: "search", placeholder: "slave, value, slot", autocomplete: "off", value: kept?.filter ?? "", on: { input: () => this.offer() } });
    this.offered = el("div", { class: "signals long" });
    this.status = el("span", { class: "faint", role: "status" });
    this.body = el("tbody");
    this.head = el("tr", {}, ...["Value", "Reading", "Unit", "Quality", "Octets", "Order"].map((text) => el("th", { scope: "col", class: text === "Reading" ? "n" : null, text })), el("th", { scope: "col" }, el("span", { class: "visually-hidden", text: "Remove" })));
    this.empty = el("p", { class: "faint", text: "Choose values below. The address of this page has the choice: as a bookmark, or sent to somebody who may look, it opens the same table." });
    root.append(
      el("h1", { class: "visually-hidden", text: "Watch table" }),
      el("section", { class: "card", "aria-labelledby": "h-watch" }, el("h2", { id: "h-watch", text: "Watch table" }), this.empty,
        el("table", { class: "plant watched" }, el("caption", { class: "visually-hidden", text: "Chosen values" }), el("thead", {}, this.head), this.body)),
      el("section", { class: "card", "aria-labelledby": "h-choose" },
        el("div", { class: "heading" }, el("h2", { id: "h-choose", text: "Values of the plant" }), el("label", { class: "visually-hidden", for: "watch-filter", text: "Filter the values" }), this.filter, this.status),
        this.offered));
    this.addressed();
  }

  keep() {
    return { filter: this.filter?.value };
  }

  key(event) {
    if (event.key !== "/") return false;
    this.filter.focus();
    return true;
  }

  get store() {
    const { plant } = this.app.live;
    return `dpstack-watch ${plant?.config ?? plant?.port ?? ""}`;
  }

  /** Take the choice of the address; without one that of this browser. */
  addressed() {
    const asked = chosenIn(location.hash);
    let ids = asked?.ids ?? [];
    if (!ids.length) {
      try {
        ids = JSON.parse(this.app.remembered(this.store) ?? "[]");
      } catch {
        ids = [];
      }
    }
    if (asked?.only) {
      this.filter.value = this.app.live.name(Number(asked.only));
    }
    this.ids = [...new Set((Array.isArray(ids) ? ids : []).map(String))].slice(0, MOST);
    this.chosen();
  }

  add(id) {
    if (this.ids.length >= MOST) {
      this.app.say(`The table has ${MOST} rows; remove one first.`, "bad");
      return;
    }
    this.ids.push(id);
    this.chosen();
  }

  drop(id) {
    this.ids = this.ids.filter((one) => one !== id);
    this.chosen();
  }

  /** Show the chosen rows, and keep the choice. */
  chosen() {
    const query = this.ids.map(encodeURIComponent).join("&");
    history.replaceState(null, "", `#/watch${query ? `?${query}` : ""}`);
    this.app.remember(this.store, JSON.stringify(this.ids));
    this.rows = new Map(this.ids.map((id) => [id, this.rows.get(id) ?? new WatchRow(this, id, this.points.get(id))]));
    this.body.replaceChildren(...[...this.rows.values()].map((one) => one.node));
    setAttr(this.empty, "class", this.ids.length ? "gone" : "faint");
    setAttr(this.body.parentElement, "class", this.ids.length ? "plant watched" : "gone");
    this.offer();
    this.update();
  }

  /** The values that the filter names, as boxes to tick. */
  offer() {
    const wanted = this.filter.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    const fits = [...this.points.values()].filter((one) => {
      const text = `${one.label} ${one.address}`.toLowerCase();
      return wanted.every((word) => text.includes(word));
    });
    const shown = fits.slice(0, OFFERED);
    setText(this.status, fits.length > shown.length ? `${fits.length} values, the first ${shown.length} shown: the filter finds others` : `${fits.length} values`);
    const ticked = new Set(this.ids);
    refill(this.offered, shown.map((one) => [one.id, ticked.has(one.id)]), () => shown.map((one) => el("label", { title: one.label },
      el("input", { type: "checkbox", "data-key": `tick ${one.id}`, checked: ticked.has(one.id), on: { change: (event) => (event.target.checked ? this.add(one.id) : this.drop(one.id)) } }),
      el("bdi", { text: one.label }))));
  }

  update() {
    for (const one of this.rows.values()) one.update();
  }
}
