// The plant: a picture of the line, a table of states and values, the drives, the last events.

import { el, refill, setAttr, setText, svg } from "./dom.js";
import { clock, count, fieldValue, micros, octets, percent, kindOf, stateText, value } from "./format.js";
import { MachinePicture, SpeedBar, StateMark, mark, shape } from "./marks.js";
import { QUANTITIES, quantity } from "./points.js";
import { Figure, fieldQuality, qualityOf, qualityText } from "./quality.js";

/** The line as a picture: the master, and the slaves in the order of their addresses. */
class LinePicture {
  constructor(app) {
    this.app = app;
    this.stations = new Map();
    this.node = el("div", { class: "line" });
    this.watcher = new ResizeObserver(() => this.lay());
    this.watcher.observe(this.node);
  }

  leave() {
    this.watcher.disconnect();
  }

  lay() {
    const { live } = this.app;
    const wide = Math.floor(this.node.clientWidth);
    const masters = (live.bus.masters ?? []).filter((one) => one !== live.plant.address && !live.slaves.has(one));
    const key = `${wide}|${masters}`;
    if (!wide || key === this.laid) return;
    this.laid = key;
    this.wide = wide;
    const all = [...live.addresses, ...masters].sort((a, b) => a - b);
    const small = all.length > 24;
    const width = small ? 58 : 112;
    const height = small ? 46 : 62;
    const room = height + 30;
    const inRow = Math.max(2, Math.floor((wide - 12) / width));
    const rows = Math.ceil((all.length + 1) / inRow);
    const drawing = svg("svg", { class: small ? "small" : null, viewBox: `0 0 ${wide} ${rows * room + 6}`, width: wide, height: rows * room + 6, role: "group", "aria-label": "The line: the master and its slaves" });
    this.stations.clear();
    const place = (n) => ({ x: 6 + (n % inRow) * width, y: 22 + Math.floor(n / inRow) * room });
    for (let row = 0; row < rows; row += 1) {
      const inThis = Math.min(inRow, all.length + 1 - row * inRow);
      const y = 10 + row * room;
      const end = 6 + (inThis - 1) * width + width / 2;
      const to = row < rows - 1 ? wide - 4 : end;
      drawing.append(svg("path", { class: "wire", d: `M${row ? 2 : 6 + width / 2} ${y}H${to}` }));
      if (row < rows - 1) drawing.append(svg("path", { class: "wire turn", d: `M${wide - 4} ${y}v${room - 20}M2 ${y + room - 20 + 0}v20M${wide - 4} ${y + room - 20}H2` }));
    }
    // the two ends of the line have a terminator
    const last = place(all.length);
    drawing.append(
      svg("path", { class: "end", d: `M${6 + width / 2} 4v12` }),
      svg("path", { class: "end", d: `M${last.x + width / 2} ${last.y - 18}v12` }));
    drawing.append(this.master(place(0), width, height));
    all.forEach((address, n) => drawing.append(masters.includes(address)
      ? this.otherMaster(address, place(n + 1), width, height) : this.station(address, place(n + 1), width, height, small)));
    this.node.replaceChildren(drawing);
    this.update(new Set(live.addresses), true);
  }

  master({ x, y }, width, height) {
    const { plant } = this.app.live;
    const wide = width - 8;
    this.masterText = svg("text", { x: x + width / 2, y: y + height - 12, class: "what" });
    return svg("g", { class: "master" },
      svg("path", { class: "stub", d: `M${x + width / 2} ${y - 12}V${y}` }),
      svg("rect", { x: x + 4, y, width: wide, height, rx: 7 }),
      svg("text", { x: x + width / 2, y: y + (height > 50 ? 25 : 20), class: "number", text: plant.address }),
      this.masterText);
  }

  /** Another master of the token ring. */
  otherMaster(address, { x, y }, width, height) {
    return svg("g", { class: "master other" },
      svg("path", { class: "stub", d: `M${x + width / 2} ${y - 12}V${y}` }),
      svg("rect", { x: x + 4, y, width: width - 8, height, rx: 7 }),
      svg("text", { x: x + width / 2, y: y + (height > 50 ? 25 : 20), class: "number", text: address }),
      svg("text", { x: x + width / 2, y: y + height - 12, class: "what", text: height > 50 ? "other master" : "master" }));
  }

  station(address, { x, y }, width, height, small) {
    const { live } = this.app;
    const name = live.name(address);
    const fits = small ? 9 : 14;
    const parts = {
      title: svg("title"),
      sign: svg("g", { transform: small ? `translate(${x + 7} ${y + 8}) scale(.75)` : `translate(${x + 9} ${y + 8})` }),
      text: small ? null : svg("text", { x: x + width / 2, y: y + height - 8, class: "what" }),
      remark: svg("g", { transform: `translate(${x + width - 22} ${y + 5}) scale(.85)` }, shape("warn")),
      frame: svg("rect", { x: x + 4, y, width: width - 8, height, rx: 5 }),
      stub: svg("path", { class: "stub", d: `M${x + width / 2} ${y - 12}V${y}` }),
    };
    const link = svg("a", { href: `#/slave/${address}`, class: "station" }, parts.title, parts.stub, parts.frame,
      svg("text", { x: x + width / 2 + (small ? 8 : 0), y: y + (small ? 20 : 22), class: "number", text: address }),
      svg("svg", { x: x + 6, y: y + (small ? 24 : 26), width: width - 12, height: 18 },
        svg("text", { x: (width - 12) / 2, y: small ? 12 : 13, class: "name", text: name.length > fits ? `${name.slice(0, fits - 1)}…` : name })),
      parts.text, parts.sign, parts.remark);
    this.stations.set(address, { link, ...parts });
    return link;
  }

  update(changed, all = false) {
    const { live } = this.app;
    if (!all) this.lay();
    if (this.masterText) setText(this.masterText, this.wide && live.slaves.size > 24 ? "master" : live.bus.mode ? `master, ${live.bus.mode}` : "master");
    for (const address of changed) {
      const parts = this.stations.get(address);
      if (!parts) continue;
      const slave = live.slaves.get(address);
      const kind = kindOf(slave.level);
      const remark = slave.remark?.text ?? "";
      const key = `${kind}|${slave.state_text}|${remark}`;
      if (!all && parts.key === key) continue;
      parts.key = key;
      setAttr(parts.link, "class", `station ${kind}`);
      if (parts.kind !== kind) parts.sign.replaceChildren(shape(kind));
      parts.kind = kind;
      if (parts.text) setText(parts.text, ofOther(slave) ? `of master ${slave.master}` : stateText(slave));
      const broken = kindOf(slave.remark?.severity);
      if (parts.broken !== broken) parts.remark.replaceChildren(shape(broken));
      parts.broken = broken;
      setAttr(parts.remark, "class", remark && broken !== kind ? null : "gone");
      setText(parts.title, `slave ${address} (${live.name(address)}): ${stateText(slave)}${remark ? `, ${remark}` : ""}`);
    }
  }
}

/** Whether another master exchanges data with the slave: it keeps its values to itself. */
const ofOther = (slave) => slave.state === "data_exchange" && slave.master != null && !slave.alive;

// Rows outside the window that are painted with each snapshot.
const AT_A_TIME = 8;

/** Terms with figures and units as a list that changes in place. */
function listOf(cells) {
  return el("dl", { class: "values" }, ...cells.map((one) => {
    one.node = el("div", {}, el("dt", {}, el("bdi", { text: one.term })), el("dd", {}, one.shown.node, one.unit ? " " : null, one.unit ? el("span", { class: "unit", text: one.unit }) : null));
    return one.node;
  }));
}

/** Named values of a slave, each with its quality. */
export class Values {
  constructor(app, fields, outputs) {
    this.app = app;
    this.outputs = outputs;
    this.cells = fields.map((field) => ({ field, term: field.name, unit: field.unit, shown: new Figure() }));
    this.node = listOf(this.cells);
  }

  update(slave) {
    const { dead } = this.app;
    const alive = this.outputs || slave.alive;
    setAttr(this.node, "class", alive ? "values" : "values old");
    for (const { field, shown, node } of this.cells) {
      const one = slave.fields?.[field.name];
      shown.update(fieldValue(field, one), fieldQuality(slave, field, { dead, output: this.outputs }));
      const held = this.outputs ? slave.held_fields?.[field.name] : undefined;
      setAttr(node, "class", one === true ? "on" : held !== undefined && held !== one ? "held" : null);
      setAttr(node, "title", held !== undefined && held !== one ? `the application's value, not sent: ${fieldValue(field, held)}` : null);
    }
  }
}

/** Quantities of a drive in its row: what it does, or its set point. */
class DriveValues {
  constructor(app, outputs) {
    this.app = app;
    this.cells = QUANTITIES.filter((one) => (one.name === "setpoint") === outputs)
      .map((one) => ({ one, term: one.text, unit: one.unit, shown: new Figure() }));
    this.node = listOf(this.cells);
  }

  update(slave) {
    const told = qualityOf(slave, null, { dead: this.app.dead });
    setAttr(this.node, "class", slave.alive ? "values" : "values old");
    for (const { one, shown, node } of this.cells) {
      const text = quantity(slave.drive, one);
      setAttr(node, "class", text === null ? "gone" : null);
      shown.update(text ?? "–", told);
    }
  }
}

class Row {
  constructor(app, address) {
    const { live } = app;
    const about = live.about(address);
    this.app = app;
    this.address = address;
    this.state = new StateMark();
    this.age = el("span", { class: "age" });
    this.inputs = about.drive ? new DriveValues(app, false) : about.inputs?.length ? new Values(app, about.inputs, false) : null;
    this.outputs = about.drive ? new DriveValues(app, true) : about.outputs?.length ? new Values(app, about.outputs, true) : null;
    this.rawIn = el("code", { class: "octets" });
    this.rawOut = el("code", { class: "octets" });
    this.counters = el("span", { class: "figure" });
    this.remark = el("td", { class: "remark", "data-label": "Remarks" });
    this.node = el("tr", { "data-address": address, id: `row-${address}` },
      el("th", { scope: "row", class: "who" }, el("a", { href: `#/slave/${address}`, title: live.name(address).length > 40 ? live.name(address) : null }, el("span", { class: "address", text: address }), " ", el("bdi", { class: "name", text: live.name(address) })),
        el("span", { class: "faint", text: about.model ?? "" })),
      el("td", { class: "is", "data-label": "State" }, this.state.node, this.age),
      el("td", { "data-label": "Inputs" }, this.inputs?.node ?? this.rawIn),
      el("td", { "data-label": "Outputs" }, this.outputs?.node ?? this.rawOut),
      el("td", { class: "n", "data-label": "Retries" }, this.counters),
      this.remark);
  }

  update() {
    const slave = this.app.live.slaves.get(this.address);
    if (!slave) return;
    this.state.update(kindOf(slave.level), stateText(slave));
    const { alive } = slave;
    setText(this.age, alive ? "" : ofOther(slave) ? "its values are not read" : typeof slave.inputs_age_ms === "number" ? "inputs not valid" : "no inputs yet");
    if (this.inputs) this.inputs.update(slave);
    else {
      setText(this.rawIn, octets(slave.inputs, 16));
      setAttr(this.rawIn, "class", alive ? "octets" : "octets old");
    }
    if (this.outputs) this.outputs.update(slave);
    else setText(this.rawOut, octets(slave.outputs, 16));
    setText(this.counters, count(slave.retries));
    setText(this.remark, slave.remark?.text ?? "");
    setAttr(this.remark, "class", slave.remark ? `remark ${kindOf(slave.remark.severity)}` : "remark");
  }
}

/** One drive: state machine, set point, actual values, faults; with orders where they are allowed. */
export class DriveCard {
  constructor(app, address, heading = "h3", open = false) {
    const about = app.live.about(address);
    this.app = app;
    this.address = address;
    this.name = app.live.name(address);
    this.machine = new MachinePicture(about.drive.profile);
    this.state = new StateMark();
    this.bar = new SpeedBar("Speed");
    this.figures = el("dl", { class: "values drive" });
    this.fault = el("p", { class: "fault" });
    this.open = open;
    this.orders = el("div", { class: "drive-orders" });
    this.node = el("article", { class: "card drive", "data-address": address },
      el("header", {}, el(heading, {}, el("a", { href: `#/slave/${address}` }, el("span", { class: "address", text: address }), " ", el("bdi", { text: this.name }))), this.state.node),
      el("p", { class: "faint", text: [about.drive.profile, about.drive.telegram].filter(Boolean).join(", ") }),
      this.bar.node, el("div", { class: "drive-view" }, this.machine.node, this.figures), this.fault, this.orders,
      ...(open && !app.live.plant?.read_only && app.welcome?.source !== "replay" ? this.parameters() : []));
  }

  update() {
    const slave = this.app.live.slaves.get(this.address);
    const drive = slave?.drive;
    if (!drive) return;
    const { state } = drive;
    this.machine.update(state);
    this.state.update(kindOf(drive.level), stateOfDrive(state));
    this.bar.update(drive.speed, drive.setpoint);
    const rows = [
      ...QUANTITIES.filter(({ name }) => name !== "speed").map((one) => {
        const text = quantity(drive, one);
        return [one.text, text === null ? one.name === "setpoint" ? "–" : null : one.unit === "%" ? `${text}\u202f%` : `${text} ${one.unit}`];
      }),
      ["At set point", drive.reached ? "yes" : "no"],
      ["Settings", drive.settings === "none" ? null : drive.settings?.replace("_", " ")],
      ["Control", drive.remote === false ? "local" : null],
    ].filter(([, text]) => text !== null);
    refill(this.figures, rows, () => rows.map(([term, text]) => el("div", {}, el("dt", { text: term }), el("dd", { class: "figure", text }))));
    const told = qualityOf(slave, null, { dead: this.app.dead });
    for (const node of [this.figures, this.bar.figure]) {
      setAttr(node, "title", told.quality === "good" ? null : qualityText(told));
      node.classList.toggle("not-good", told.quality === "bad" || told.quality === "stale");
    }
    const faults = drive.faults?.length ? drive.faults.join(", ") : "";
    const warnings = drive.warnings?.length ? drive.warnings.join(", ") : "";
    const lost = slave.alive ? "" : slave.remark?.text ?? "";
    refill(this.fault, [faults, warnings, lost], () => [
      faults ? el("span", { class: "bad" }, mark("bad"), `Fault: ${faults}`) : null,
      warnings ? el("span", { class: "warn" }, mark("warn"), `Warning: ${warnings}`) : null,
      lost && !faults ? el("span", { class: "bad" }, mark("bad"), lost) : null,
    ]);
    const { orders } = this.app;
    refill(this.orders, [orders.allowed, this.app.orders.shown, state], () => this.buttons());
  }

  /** Parameters of the drive: read by anybody, written by an order. */
  parameters() {
    const { app, name } = this;
    const id = `parameter-${this.address}`;
    const which = el("input", { id, size: 10, autocomplete: "off", spellcheck: "false", placeholder: "number or name" });
    const shown = el("p", { class: "answer", role: "status" });
    const read = async (event) => {
      event.preventDefault();
      if (!which.value.trim()) return;
      try {
        const { parameter } = await app.link.ask("parameter", name, which.value.trim());
        shown.replaceChildren(el("span", {}, `${parameter.number} ${parameter.name ?? ""}: `, el("strong", { class: "figure", text: value(parameter.value) }), parameter.unit ? ` ${parameter.unit}` : ""));
      } catch (error) {
        shown.replaceChildren(el("span", { class: "bad" }, mark("bad"), error.message));
      }
    };
    const parts = [el("label", { for: id, text: "Parameter" }), which, el("button", { text: "Read" })];
    if (app.orders.shown) {
      const wanted = el("input", { id: `${id}-value`, size: 8, autocomplete: "off", "aria-label": `New value of the parameter of ${name}`, placeholder: "new value" });
      const write = () => {
        if (which.value.trim() && wanted.value.trim()) app.orders.give("drive", [name, "write", which.value.trim(), wanted.value.trim()]);
        else app.say("Give the parameter and its new value.", "bad");
      };
      parts.push(wanted, el("button", { type: "button", text: "Write …", on: { click: write } }));
    }
    return [el("form", { class: "inline", on: { submit: read } }, ...parts), shown];
  }

  buttons() {
    const { app, name } = this;
    if (!app.orders.shown || app.live.plant?.read_only) return [];
    const disabled = !app.orders.allowed;
    const button = (order, text, kind = null) => el("button", {
      type: "button", class: kind, disabled, "data-key": order, text, on: { click: () => app.orders.give("drive", [name, order]) },
    });
    const speed = el("input", { type: "text", inputmode: "decimal", "aria-label": `Set point of ${name} in percent`, "data-key": "speed-input", size: 6, disabled, placeholder: "%" });
    const set = (event) => {
      event.preventDefault();
      const wanted = Number(speed.value.replace(",", ".").replace("%", "").replace("−", "-"));
      if (speed.value.trim() === "" || !Number.isFinite(wanted)) app.say(`The set point is no number: ${speed.value}`, "bad");
      else app.orders.give("drive", [name, "speed", `${wanted}%`]);
    };
    const buttons = el("div", { class: "buttons" },
      button("start", "Start …", "danger"), button("stop", "Stop …"), button("quick_stop", "Quick stop …"), button("acknowledge", "Acknowledge …"),
      el("form", { class: "inline", on: { submit: set } }, speed, el("button", { disabled, "data-key": "speed-set", text: "Set speed …" })));
    return el("details", { open: this.open, on: { toggle: (event) => { this.open = event.target.open; } } }, el("summary", { "data-key": "orders", text: `Orders to ${name}` }), buttons);
  }
}

function stateOfDrive(state) {
  const text = String(state ?? "unknown").replaceAll("_", " ");
  return text.charAt(0).toUpperCase() + text.slice(1);
}

// Marks of diagnoses and alarms that come and go.
const CHANGES = { appears: "▲ appears", disappears: "▼ disappears", disappears_others: "▼ disappears, others are left" };

/** One event as a list item. */
export function eventItem(live, event) {
  const about = event.address === undefined ? null
    : el("a", { href: `#/slave/${event.address}`, class: "address" }, String(event.address));
  const text = event.text ?? [event.event, event.state].filter(Boolean).join(" ");
  const change = CHANGES[event.change ?? (event.event === "alarm" ? event.specifier : null)];
  return el("li", { class: event.severity },
    el("time", { datetime: event.time, text: clock(live.eventWall(event), true) }),
    mark(event.change === "disappears" ? "good" : kindOf(event.severity)), about,
    el("span", { class: "text" }, change ? el("span", { class: "change", text: change }) : null, text));
}

export class PlantPage {
  constructor(app) {
    this.app = app;
    this.title = "Plant";
    this.visible = new Set();
    this.waiting = new Set();
    this.filterText = "";
  }

  build(root, kept) {
    const { live } = this.app;
    this.line = new LinePicture(this.app);
    this.rows = new Map(live.addresses.map((address) => [address, new Row(this.app, address)]));
    this.drives = new Map(live.addresses.filter((one) => live.about(one).drive).map((one) => [one, new DriveCard(this.app, one)]));
    this.tiles = el("dl", { class: "tiles" });
    this.events = el("ol", { class: "events" });
    this.filter = el("input", { id: "filter", type: "search", placeholder: "name, address, state", autocomplete: "off", value: kept?.filter ?? "", on: { input: () => this.select() } });
    this.shown = el("span", { class: "faint", role: "status" });
    this.body = el("tbody", {}, ...[...this.rows.values()].map((row) => row.node));
    this.watcher = new IntersectionObserver((entries) => this.seen(entries), { rootMargin: "200px" });
    for (const row of this.rows.values()) this.watcher.observe(row.node);
    root.append(
      el("h1", { class: "visually-hidden", text: "Plant" }),
      this.tiles,
      el("section", { "aria-labelledby": "h-line" }, el("h2", { id: "h-line", text: "The line" }), this.line.node),
      this.drives.size ? el("section", { "aria-labelledby": "h-drives" }, el("h2", { id: "h-drives", text: "Drives" }), el("div", { class: "cards" }, ...[...this.drives.values()].map((one) => one.node))) : "",
      el("section", { "aria-labelledby": "h-slaves" },
        el("div", { class: "heading" }, el("h2", { id: "h-slaves", text: "Slaves" }), el("label", { for: "filter", class: "visually-hidden", text: "Filter the slaves" }), this.filter, this.shown),
        el("table", { class: "plant" },
          el("caption", { class: "visually-hidden", text: "Slaves with their states and values" }),
          el("thead", {}, el("tr", {}, ...["Slave", "State", "Inputs", "Outputs"].map((text) => el("th", { scope: "col", text })), el("th", { scope: "col", class: "n", text: "Retries" }), el("th", { scope: "col", text: "Remarks" }))),
          this.body)),
      el("section", { "aria-labelledby": "h-events" }, el("h2", { id: "h-events", text: "Last events" }), this.events, el("p", {}, el("a", { href: "#/bus", text: "All events" }))));
    this.line.lay();
    this.select();
  }

  keep() {
    return { filter: this.filter?.value };
  }

  leave() {
    this.watcher?.disconnect();
    this.line?.leave();
  }

  key(event) {
    if (event.key !== "/") return false;
    this.filter.focus();
    return true;
  }

  seen(entries) {
    for (const entry of entries) {
      const address = Number(entry.target.dataset.address);
      if (!entry.isIntersecting) this.visible.delete(address);
      else if (!this.visible.has(address)) {
        this.visible.add(address);
        this.waiting.delete(address);
        this.rows.get(address)?.update();
      }
    }
  }

  /** Show the rows that the filter names. */
  select() {
    const { live } = this.app;
    const wanted = this.filter.value.trim().toLowerCase();
    let shown = 0;
    for (const [address, row] of this.rows) {
      const slave = live.slaves.get(address) ?? {};
      const fits = !wanted || `${address} ${live.name(address)} ${live.about(address).model ?? ""} ${slave.state_text} ${slave.remark?.text ?? ""}`.toLowerCase().includes(wanted);
      setAttr(row.node, "hidden", !fits);
      shown += fits ? 1 : 0;
    }
    setText(this.shown, wanted ? `${shown} of ${this.rows.size}` : "");
  }

  update(changed) {
    const { live } = this.app;
    this.line.update(changed);
    // rows in the window at once, the others a few at a time: 125 slaves must not make the page slow
    for (const address of changed) {
      if (this.visible.has(address)) this.rows.get(address)?.update();
      else this.waiting.add(address);
    }
    let rest = this.filled ? AT_A_TIME : Infinity;
    this.filled = true;
    for (const address of this.waiting) {
      if (rest-- <= 0) break;
      this.waiting.delete(address);
      this.rows.get(address)?.update();
    }
    for (const card of this.drives.values()) card.update();
    if (this.filter.value) this.select();
    this.paintTiles(live);
    const last = live.events.slice(-8).reverse();
    refill(this.events, last.map((one) => one.number).join(), () => (last.length ? last.map((one) => eventItem(live, one)) : [el("li", { class: "faint", text: "none yet" })]));
  }

  paintTiles(live) {
    let exchanging = 0;
    let faults = 0;
    const diagnosed = [];
    for (const slave of live.slaves.values()) {
      exchanging += slave.alive || ofOther(slave) ? 1 : 0;
      faults += slave.level === "error" ? 1 : 0;
      if (slave.doubts?.length || slave.conspicuous) diagnosed.push(slave);
    }
    const { bus } = live;
    const all = live.slaves.size;
    const tiles = [
      ["In data exchange", `${exchanging} of ${all}`, exchanging === all ? "good" : "bad"],
      ["With a fault", String(faults), faults ? "bad" : "good"],
      ["With a diagnosis", String(diagnosed.length), diagnosed.some((slave) => slave.level === "error") ? "bad" : diagnosed.length ? "warn" : "good"],
      ["Rotation time, median", micros(bus.rotation_us?.p50), null],
      ["99 % below", micros(bus.rotation_us?.p99), null],
      ["Retries", count(bus.retries), null],
      ["Without answer", count(bus.timeouts), null],
    ];
    refill(this.tiles, tiles, () => tiles.map(([term, text, kind]) =>
      el("div", { class: kind }, el("dt", { text: term }), el("dd", {}, kind ? mark(kind) : null, el("span", { class: "figure", text })))));
  }
}
