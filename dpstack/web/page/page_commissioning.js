// Commissioning: scan, match idents with GSD files, choose modules, name the slaves, check the plan, take the TOML.

import { cell, download, el, pairs, setAttr, table } from "./dom.js";
import { micros, octets, rate, words } from "./format.js";
import { mark } from "./marks.js";

const FIT = { exact: ["good", "fits"], unknown: ["busy", "modules not known"], partly: ["warn", "fits partly"], none: ["bad", "does not fit"] };
const RATES = [9600, 19200, 31250, 45450, 93750, 187500, 500000, 1500000, 3000000, 6000000, 12000000];

/** One slave that a scan has found: the candidate chosen for it, its modules and its name. */
class Found {
  constructor(page, station, match) {
    this.page = page;
    this.station = station;
    this.match = match;
    this.candidates = match?.candidates ?? [];
    this.use = this.candidates.some((one) => one.keys);
    this.which = Math.max(0, this.candidates.findIndex((one) => one.keys));
    this.name = station.name || match?.name || `slave-${station.address}`;
    this.telegram = null;
    this.rows = null; // numbers of modules, null: as the candidate proposes
    this.choice = null;
  }

  get candidate() {
    return this.candidates[this.which] ?? null;
  }

  /** The keys of the [[slave]] table. */
  keys() {
    const base = { name: this.name, address: this.station.address, ...(this.candidate?.keys ?? {}) };
    if (this.telegram && base.drive) base.telegram = this.telegram;
    if (this.rows && this.choice) base.modules = this.rows.map((number) => (number === null ? "" : this.choice.modules[number]?.key ?? ""));
    return base;
  }

  build() {
    const { station } = this;
    const id = `found-${station.address}`;
    const take = el("input", { type: "checkbox", id: `${id}-take`, checked: this.use, disabled: !this.candidates.some((one) => one.keys), on: { change: () => { this.use = take.checked; this.page.stale(); this.paint(); } } });
    const name = el("input", { id: `${id}-name`, value: this.name, size: 18, autocomplete: "off", spellcheck: "false", on: { input: () => { this.name = name.value; this.page.stale(); } } });
    this.pick = el("select", { id: `${id}-which`, on: { change: () => { this.which = Number(this.pick.value); this.rows = null; this.choice = null; this.telegram = null; this.page.stale(); this.paint(); } } },
      ...this.candidates.map((one, n) => el("option", { value: n, selected: n === this.which, text: candidateText(one) })));
    this.fit = el("p", { class: "fit" });
    this.more = el("div", { class: "more" });
    this.node = el("article", { class: "card found", "aria-labelledby": `${id}-title` },
      el("header", {},
        el("h3", { id: `${id}-title` }, el("span", { class: "address", text: station.address }), " ", station.ident ?? "no ident number"),
        el("span", { class: "field check" }, take, el("label", { for: `${id}-take`, text: "take it into the configuration" }))),
      el("p", { class: "faint", text: `${words(station.state ?? "unknown")}${typeof station.master === "number" ? `, master ${station.master}` : ""}${station.name ? ", in the present configuration" : ""}${station.config ? `; identifier octets ${station.config}` : ""}` }),
      el("div", { class: "fields" },
        el("span", { class: "field" }, el("label", { for: `${id}-name`, text: "Name" }), name),
        el("span", { class: "field wide" }, el("label", { for: `${id}-which`, text: "Description" }), this.candidates.length ? this.pick : el("span", { class: "faint", text: "none: no GSD file and no known drive has this ident number" }))),
      this.fit, this.more);
    this.paint();
    return this.node;
  }

  paint() {
    const one = this.candidate;
    setAttr(this.node, "class", this.use ? "card found" : "card found left-out");
    const [kind, text] = FIT[one?.fit] ?? ["off", ""];
    this.fit.replaceChildren(...(one ? [mark(kind), el("span", { text: `${words(text)}: ${one.text}.` })] : []));
    const parts = [];
    if (one?.kind === "drive" && one.telegrams.length > 1) {
      const id = `found-${this.station.address}-telegram`;
      const pick = el("select", { id, on: { change: () => { this.telegram = pick.value; this.page.stale(); } } },
        ...one.telegrams.map((name) => el("option", { value: name, text: name, selected: name === (this.telegram ?? one.keys?.telegram) })));
      parts.push(el("span", { class: "field" }, el("label", { for: id, text: "Telegram" }), pick));
    }
    if (one?.kind === "gsd") {
      if (this.choice) parts.push(this.slots());
      else parts.push(el("div", { class: "buttons" }, el("button", { type: "button", text: "Choose modules", on: { click: (event) => this.load(event.target) } })));
    }
    this.more.replaceChildren(...parts);
  }

  async load(button) {
    button.disabled = true;
    try {
      this.choice = await this.page.app.link.ask("modules", this.candidate.gsd, this.station.config ?? null);
      const reading = this.choice.readings?.[0];
      this.rows = reading ? reading.places.map((place) => place.modules[0] ?? null) : [...(this.choice.default ?? [])];
      this.reading = reading ? 0 : null;
      this.page.stale();
      this.paint();
      this.more.querySelector("select, button")?.focus();
    } catch (error) {
      button.disabled = false;
      this.page.app.say(error.message, "bad");
    }
  }

  /** A select for each slot; those that a reading leaves open have a mark. */
  slots() {
    const { choice, station } = this;
    const changed = () => {
      this.page.stale();
      this.paint();
    };
    const first = choice.first_slot ?? 1;
    const rows = this.rows.map((number, n) => {
      const slot = first + n;
      const id = `found-${station.address}-slot-${slot}`;
      const allowed = choice.slots?.find((one) => one.slot === slot)?.modules ?? choice.modules.map((_, which) => which);
      const shown = number === null || allowed.includes(number) ? allowed : [number, ...allowed];
      const pick = el("select", { id, on: { change: () => { this.rows[n] = pick.value === "" ? null : Number(pick.value); changed(); } } },
        el("option", { value: "", text: "(empty slot)", selected: number === null }),
        ...shown.filter((which) => choice.modules[which].key !== null).map((which) => el("option", { value: which, selected: which === number, text: moduleText(choice.modules[which]) })));
      const place = this.reading === null || this.reading === undefined ? null : choice.readings[this.reading].places[n];
      const remark = !place ? null : place.unknown ? el("span", { class: "bad" }, mark("bad"), `${place.config}: of no module`)
        : place.modules.length > 1 ? el("span", { class: "warn" }, mark("warn"), `${place.config}: ${place.modules.length} modules have these octets, choose`) : el("span", { class: "faint", text: place.config });
      return el("li", {}, el("label", { for: id, text: `Slot ${slot}` }), pick, remark);
    });
    const readings = choice.readings ?? [];
    const more = readings.length > 1 ? (() => {
      const id = `found-${station.address}-reading`;
      const pick = el("select", { id, on: { change: () => { this.reading = Number(pick.value); this.rows = readings[this.reading].places.map((place) => place.modules[0] ?? null); changed(); } } },
        ...readings.map((one, n) => el("option", { value: n, selected: n === this.reading, text: `${n + 1}: ${one.places.length} modules` })));
      return el("span", { class: "field" }, el("label", { for: id, text: `Ways to read the octets${choice.more_readings ? " (there are more)" : ""}` }), pick);
    })() : null;
    const room = choice.max_module === null || choice.max_module === undefined || this.rows.length < choice.max_module;
    return el("div", { class: "slots" }, more, el("ol", {}, ...rows),
      choice.modular ? el("div", { class: "buttons" },
        el("button", { type: "button", text: "Add a slot", disabled: !room, on: { click: () => { this.rows.push(null); this.reading = null; changed(); } } }),
        el("button", { type: "button", text: "Remove the last slot", disabled: !this.rows.length, on: { click: () => { this.rows.pop(); this.reading = null; changed(); } } })) : null);
  }
}

function candidateText(one) {
  const who = { drive: one.drive, gsd: one.gsd, octets: "only ident number and octets" }[one.kind] ?? one.kind;
  return [who, [one.vendor, one.model].filter(Boolean).join(" "), one.revision].filter(Boolean).join(", ");
}

function moduleText(module) {
  return `${module.name} (${module.inputs} in, ${module.outputs} out)`;
}

export class CommissioningPage {
  constructor(app) {
    this.app = app;
    this.title = "Commissioning";
    app.commissioning ??= { scan: null, found: [], made: null, folder: null, bad: [] };
    this.kept = app.commissioning;
  }

  build(root) {
    const { app, kept } = this;
    const { plant } = app.live;
    kept.bus ??= { port: plant.port ?? "", baud: plant.baud ?? 500000, address: plant.address ?? 2 };
    this.scanned = el("div", { class: "answer", "aria-live": "polite" });
    this.list = el("div", { class: "cards wide" });
    this.bad = el("div");
    this.made = el("div", { class: "answer", "aria-live": "polite" });
    this.scanButton = el("button", { type: "button", id: "scan", class: "primary", text: "Scan the bus", on: { click: () => this.scan() } });
    this.makeButton = el("button", { type: "button", id: "make", class: "primary", text: "Check and make the TOML", on: { click: () => this.make() } });
    const port = el("input", { id: "bus-port", value: kept.bus.port, size: 20, autocomplete: "off", spellcheck: "false", on: { input: () => { kept.bus.port = port.value; this.stale(); } } });
    const baud = el("select", { id: "bus-baud", on: { change: () => { kept.bus.baud = Number(baud.value); this.stale(); } } }, ...RATES.map((one) => el("option", { value: one, text: rate(one), selected: one === kept.bus.baud })));
    const address = el("input", { id: "bus-address", value: kept.bus.address, size: 4, inputmode: "numeric", on: { input: () => { kept.bus.address = Number(address.value); this.stale(); } } });
    const step = (number, id, title, ...inside) => el("section", { class: "card step", "aria-labelledby": id }, el("h2", { id }, el("span", { class: "number", text: number }), title), ...inside);
    root.append(
      el("h1", { text: "Commissioning" }),
      el("p", { class: "lead", text: "From the stations on the wire to a configuration. Nothing here changes a slave: a scan only asks, and the text is yours to save." }),
      step("1", "h-scan", "Scan", el("p", { class: "faint", text: "The master asks every address in the free time of its token; data exchange goes on." }), el("div", { class: "buttons" }, this.scanButton), this.scanned),
      step("2", "h-match", "Choose descriptions, modules and names", this.bad, this.list),
      step("3", "h-bus", "The bus", el("div", { class: "fields" },
        el("span", { class: "field" }, el("label", { for: "bus-port", text: "Port" }), port),
        el("span", { class: "field" }, el("label", { for: "bus-baud", text: "Rate" }), baud),
        el("span", { class: "field" }, el("label", { for: "bus-address", text: "Address of the master" }), address))),
      step("4", "h-check", "Check the plan, take the configuration", el("div", { class: "buttons" }, this.makeButton), this.made));
    this.paintScan();
    this.paintFound();
    this.paintMade();
  }

  update() {
    const dead = this.app.dead;
    for (const button of [this.scanButton, this.makeButton]) if (!button.busy) setAttr(button, "disabled", dead || (button === this.makeButton && !this.kept.found.some((one) => one.use)));
  }

  /** What was made is older than the choices. */
  stale() {
    if (this.kept.made) {
      this.kept.made = null;
      this.paintMade();
    }
    this.update();
  }

  async during(button, box, act) {
    button.busy = true;
    button.disabled = true;
    box.replaceChildren(el("p", { class: "faint", text: "Asking …" }));
    try {
      await act();
    } catch (error) {
      box.replaceChildren(el("p", { class: "bad" }, mark("bad"), error.message));
    } finally {
      button.busy = false;
      this.update();
    }
  }

  scan() {
    const { kept, app } = this;
    return this.during(this.scanButton, this.scanned, async () => {
      kept.scan = await app.link.ask("scan");
      kept.made = null;
      kept.found = [];
      this.paintScan();
      const stations = (kept.scan.stations ?? []).filter((one) => one.type === undefined || one.type === "slave");
      const asked = stations.map(({ address, ident = null, config = null, type = "slave" }) => ({ address, ident, config, type }));
      let match = { stations: [] };
      try {
        match = await app.link.ask("match", asked);
      } catch (error) {
        this.list.replaceChildren(el("p", { class: "bad" }, mark("bad"), error.message));
        return;
      }
      kept.folder = match.folder ?? null;
      kept.bad = match.bad ?? [];
      const byAddress = new Map((match.stations ?? []).map((one) => [one.address, one]));
      kept.found = stations.map((one) => new Found(this, one, byAddress.get(one.address)));
      this.paintScan();
      this.paintFound();
      this.paintMade();
    });
  }

  paintScan() {
    const { scan } = this.kept;
    if (!scan) return;
    const stations = scan.stations ?? [];
    this.scanned.replaceChildren(table(`Stations at ${rate(scan.baud)}`, [["Address"], ["Type"], ["Ident"], ["State"], ["Master", "n"], ["Octets"]],
      stations.map((one) => el("tr", {}, cell(String(one.address)), cell(words(one.type ?? "slave")), cell(one.ident ?? ""), cell(words(one.state ?? "")), cell(typeof one.master === "number" ? String(one.master) : "", "n"), cell(el("code", { text: one.config ? octets(one.config.replaceAll(" ", ""), 16) : "" }))))));
    if (!stations.length) this.scanned.append(el("p", { text: "Nobody answered." }));
    if (scan.unreadable?.length) this.scanned.append(el("p", { class: "warn" }, mark("warn"), `Unreadable answers at ${scan.unreadable.join(", ")}: two stations with one address?`));
  }

  paintFound() {
    const { kept } = this;
    for (const one of kept.found) one.page = this;
    this.list.replaceChildren(...(kept.found.length ? kept.found.map((one) => one.build()) : [el("p", { class: "faint", text: kept.scan ? "No slaves were found." : "Scan first." })]));
    this.bad.replaceChildren(...(kept.folder ? [el("p", { class: "faint", text: `GSD files of ${kept.folder}` })] : []),
      ...(kept.bad.length ? [el("details", {}, el("summary", { text: `${kept.bad.length} GSD file(s) cannot be used` }), el("ul", { class: "plain" }, ...kept.bad.map((one) => el("li", { text: `${one.gsd}: ${one.reason}` }))))] : []));
    this.update();
  }

  make() {
    const { kept, app } = this;
    return this.during(this.makeButton, this.made, async () => {
      const slaves = kept.found.filter((one) => one.use).map((one) => one.keys());
      kept.made = await app.link.ask("toml", { bus: { port: kept.bus.port, baud: kept.bus.baud, address: kept.bus.address }, slaves });
      this.paintMade();
    });
  }

  /** Check the text as the user has changed it. */
  async check(text) {
    try {
      this.kept.made = { ...(await this.app.link.ask("check", text)), toml: text };
      this.paintMade();
      document.getElementById("toml")?.focus();
    } catch (error) {
      this.app.say(error.message, "bad");
    }
  }

  paintMade() {
    const { made } = this.kept;
    if (!made) {
      this.made.replaceChildren();
      return;
    }
    const errors = made.errors ?? [];
    const findings = made.plan?.findings ?? [];
    const kind = errors.length ? "bad" : findings.length ? "warn" : "good";
    const us = made.plan?.rotation_us;
    const text = el("textarea", { class: "toml", id: "toml", spellcheck: "false", autocomplete: "off", value: made.toml ?? "", on: { input: () => { made.toml = text.value; } } });
    const copy = async () => {
      try {
        await navigator.clipboard.writeText(text.value);
        this.app.say("Copied", "good");
      } catch {
        this.app.say("The browser does not allow to copy here: mark the text and copy it.", "bad");
      }
    };
    this.made.replaceChildren(...[
      el("p", { class: kind }, mark(kind), words(made.text ?? "")),
      errors.length ? el("ul", { class: "plain errors" }, ...errors.map((one) => el("li", { class: "bad" }, one.line ? `line ${one.line}: ` : "", one.text, one.suggestion ? el("span", { class: "faint", text: ` – ${one.suggestion}` }) : null))) : null,
      findings.length ? el("ul", { class: "plain" }, ...findings.map((one) => el("li", { text: typeof one === "string" ? one : one.text ?? JSON.stringify(one) }))) : null,
      us ? pairs([["Rotation time, shortest", micros(us.min)], ["typical", micros(us.typical)], ["longest", micros(us.max)]], "pairs numbers") : null,
      el("label", { for: "toml", text: "The configuration; further keys may be added here" }), text,
      el("div", { class: "buttons" },
        el("button", { type: "button", text: "Check this text", on: { click: () => this.check(text.value) } }),
        el("button", { type: "button", text: "Save plant.toml", on: { click: () => download("plant.toml", text.value, "application/toml") } }),
        el("button", { type: "button", text: "Copy", on: { click: copy } })),
    ].filter(Boolean));
  }
}
