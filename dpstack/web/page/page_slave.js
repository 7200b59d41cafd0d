// One slave: identity, values, diagnosis and its history, counters, alarms, records, I&M, and why it does not run.

import { announced, recordOf, stampsView } from "./clocks.js";
import { cell, download, el, pairs, refill, setAttr, setText, table } from "./dom.js";
import { clock, count, duration, millis, octets, kindOf, stateText, value, words } from "./format.js";
import { StateMark, mark } from "./marks.js";
import { fieldForm } from "./orders.js";
import { deviceView, parametersView } from "./pa.js";
import { DriveCard, Values, eventItem } from "./page_plant.js";
import { Rack } from "./rack.js";

const HISTORY = new Set(["diagnosis", "fault", "slave", "alarm", "status_message", "remark", "flapping", "drive", "connection_over", "injected", "quality", "place"]);
const COUNTERS = ["exchanges", "telegrams", "retries", "timeouts", "late", "wrong"];

export class SlavePage {
  constructor(app, address) {
    this.app = app;
    this.address = address;
    this.there = app.live.slaves.has(address);
    this.title = this.there ? `${address} ${app.live.name(address)}` : `${address}`;
  }

  build(root, kept) {
    const { app, address } = this;
    const { live } = app;
    if (!this.there) {
      root.append(el("h1", { text: `There is no slave ${address}` }), el("p", {}, el("a", { href: "#/plant", text: "Back to the plant" })));
      return;
    }
    const about = live.about(address);
    const section = (id, title, ...inside) => el("section", { class: "card", "aria-labelledby": id }, el("h2", { id, text: title }), ...inside);
    this.state = new StateMark();
    this.fault = el("p", { class: "fault" });
    this.inputs = about.inputs?.length ? new Values(app, about.inputs, false) : null;
    this.outputs = about.outputs?.length ? new Values(app, about.outputs, true) : null;
    this.rawIn = el("code", { class: "octets" });
    this.rawOut = el("code", { class: "octets" });
    this.rawHeld = el("p", { class: "warn" });
    this.links = el("div");
    this.valid = el("p", { class: "age" });
    this.drive = about.drive ? new DriveCard(app, address, "h2", true) : null;
    this.rack = new Rack(app, address);
    const ppi = about.protocol === "ppi"; // an S7-200: it has named values, and nothing of DP
    const rack = this.rack.node ? section("h-rack", "Modules and channels", this.rack.node) : null;
    this.flags = el("div");
    this.history = el("ol", { class: "events" });
    this.counters = el("div");
    this.notices = el("ul", { class: "plain" });
    this.alarms = el("div");
    this.alarmList = el("ol", { class: "events" });
    this.why = el("div", { class: "answer", "aria-live": "polite" }, kept?.why ?? []);
    this.stamps = el("div", { class: "answer", "aria-live": "polite" }, kept?.stamps ?? []);
    this.records = el("div", { class: "answer", "aria-live": "polite" }, kept?.records ?? []);
    this.im = el("div", { class: "answer", "aria-live": "polite" }, kept?.im ?? []);
    this.pa = el("div", { class: "answer", "aria-live": "polite" }, kept?.pa ?? []);
    this.paOne = el("div", { class: "answer", "aria-live": "polite" }, kept?.paOne ?? []);
    this.sheet = el("div", { class: "answer sheet", "aria-live": "polite" }, kept?.sheet ?? []);
    const others = live.addresses;
    const at = others.indexOf(address);
    const to = (one, text) => (one === undefined ? null : el("a", { href: `#/slave/${one}`, text }));
    root.append(
      el("div", { class: "heading" },
        el("h1", {}, el("span", { class: "address", text: address }), " ", el("bdi", { text: live.name(address) })), this.state.node,
        el("a", { class: "to-watch", href: `#/watch?only=${address}`, text: "Watch values" }),
        el("span", { class: "turn" }, to(others[at - 1], "‹ previous"), to(others[at + 1], "next ›"))),
      this.fault,
      ...(rack && !about.drive ? [rack] : []),
      el("div", { class: "columns" }, el("div", { class: "side" },
        ppi
          ? section("h-values", "Values of the CPU", this.valid, this.inputs?.node,
            this.outputs ? [el("h3", { text: "Values that can be written" }), this.outputs.node] : null, this.outputOrders(about))
          : section("h-values", "Process data", this.valid,
            el("h3", { text: "Inputs" }), this.inputs?.node, this.rawIn,
            el("h3", { text: "Outputs" }), this.outputs?.node, this.rawOut, this.rawHeld, this.links, this.outputOrders(about)),
        this.drive ? this.drive.node : null,
        ppi ? null : section("h-why", this.whyTitle, el("p", { class: "faint", text: "The last bring-up step by step, and the likely causes in order. Nothing is parameterised by asking." }), this.button("Ask why", () => this.askWhy()), this.why),
        ppi ? null : section("h-records", "Records and I&M", this.recordForm(about), this.records, this.button("Read I&M", () => this.askIm()), this.im)),
      el("div", { class: "side" },
        ppi ? null : section("h-diagnosis", "Diagnosis", this.flags, this.notices),
        section("h-history", "History", this.history),
        section("h-identity", "Identity", this.identity(about)),
        section("h-counters", "Counters", this.counters),
        ppi ? null : section("h-alarms", "Alarms", this.alarmList, this.stamps, this.alarms, about.dpv1 ? this.stampsForm() : null))),
      ...(about.drive || ppi ? [] : [section("h-pa", "Process device (PROFIBUS PA)", el("p", { class: "faint", text: "Identity, diagnosis, and blocks with their values, units and status, if this slave is a process device. They are read over acyclic services beside data exchange." }), this.button("Read the device", () => this.askPa()), this.pa, this.paForm(), this.paOne)]),
      ...(ppi ? [] : [section("h-sheet", "Commissioning sheet", el("p", { class: "faint", text: "What to set at the device and why, telegrams, words, faults and LEDs. Made from the configuration and the drive's tables: the device is not asked." }), this.button("Show the sheet", () => this.askSheet()), this.sheet)]),
      ...(rack && about.drive ? [rack] : []));
  }

  get whyTitle() {
    return "Why it is, or is not, in data exchange";
  }

  keep() {
    return { why: [...(this.why?.childNodes ?? [])], stamps: [...(this.stamps?.childNodes ?? [])], records: [...(this.records?.childNodes ?? [])], im: [...(this.im?.childNodes ?? [])], pa: [...(this.pa?.childNodes ?? [])], paOne: [...(this.paOne?.childNodes ?? [])], sheet: [...(this.sheet?.childNodes ?? [])] };
  }

  key(event) {
    const { addresses } = this.app.live;
    const at = addresses.indexOf(this.address);
    const next = event.key === "j" ? addresses[at + 1] : event.key === "k" ? addresses[at - 1] : undefined;
    if (next === undefined || at < 0) return false;
    location.hash = `#/slave/${next}`;
    return true;
  }

  button(text, act) {
    const button = el("button", { type: "button", text, on: { click: async () => {
      button.disabled = true;
      try {
        await act();
      } finally {
        button.disabled = false;
      }
    } } });
    return el("div", { class: "buttons" }, button);
  }

  identity(about) {
    if (about.protocol === "ppi") {
      const all = [...(about.inputs ?? []), ...(about.outputs ?? [])];
      return [pairs([["Model", about.model], ["Values", count(all.length)]]), table("Named values and their addresses", [["Name"], ["Address"], ["Unit"]],
        all.map((field) => el("tr", {}, cell(field.name), cell(field.at), cell(field.unit || "-"))))];
    }
    return pairs([
      ["Vendor", about.vendor], ["Model", about.model], ["Ident number", about.ident], ["GSD file", about.gsd],
      ["Inputs, outputs", `${about.input_len ?? 0} and ${about.output_len ?? 0} octets`],
      ["Safe outputs", about.output_len ? octets(about.safe, 32) : null],
      ["Watchdog", about.watchdog_ms ? `${about.watchdog_ms} ms` : "off"],
      ["Groups", about.groups?.length ? about.groups.join(", ") : null], ["DP-V1", about.dpv1 ? "yes" : "no"],
      ["Asked", about.every > 1 ? `every ${about.every} cycles` : "every cycle"],
      ["Drive profile", about.drive ? [about.drive.profile, about.drive.telegram].filter(Boolean).join(", ") : null],
      ["Reference", about.drive ? [about.drive.reference_hz ? `${about.drive.reference_hz} Hz` : "", about.drive.reference_rpm ? `${about.drive.reference_rpm} rpm` : ""].filter(Boolean).join(", ") : null],
    ]);
  }

  outputOrders(about) {
    const { app, address } = this;
    const name = String(address);
    this.orderBox = el("div", { class: "orders-box" });
    this.orderMake = () => {
      if (!app.orders.sets(address)) return [];
      const disabled = !app.orders.allowed;
      const boxes = (about.outputs ?? []).map((field) => fieldForm(app, address, field, "set", field.name));
      if (app.orders.forces(address)) boxes.push(...this.forceOrders(about));
      if (about.output_len) {
        const input = el("input", { id: "raw-outputs", disabled, "data-key": "raw", size: 24, autocomplete: "off", spellcheck: "false", placeholder: "00 FF" });
        const set = (event) => {
          event.preventDefault();
          const hex = input.value.replaceAll(/\s/g, "");
          if (!/^([0-9a-f]{2})+$/i.test(hex) || hex.length !== about.output_len * 2) app.say(`Give ${about.output_len} octets as hex, such as 00 FF`, "bad");
          else app.orders.give("outputs", [`${name}=${hex}`]);
        };
        boxes.push(el("form", { class: "inline", on: { submit: set } }, el("label", { for: "raw-outputs", text: "All output octets" }), input, el("button", { disabled, text: "Set …" })));
      }
      return boxes;
    };
    return this.orderBox;
  }

  /** Inputs of a simulated slave: each by its name, and back to what the simulation makes. */
  forceOrders(about) {
    const { app, address } = this;
    if (!about.inputs?.length) return [];
    if (about.protocol === "ppi") {
      return [el("details", { class: "force" }, el("summary", { "data-key": "force", text: "Set values of this simulated CPU, as its program would" }),
        el("div", { class: "orders-box" }, ...about.inputs.map((field) => fieldForm(app, address, field, "force", field.name))))];
    }
    return [el("details", { class: "force" }, el("summary", { "data-key": "force", text: "Force inputs of this simulated slave" }),
      el("div", { class: "orders-box" }, ...about.inputs.map((field) => fieldForm(app, address, field, "force", field.name)),
        // an I/O station has nothing else to give: its inputs stay as they were set
        about.gsd === "io-station" ? null : el("div", { class: "buttons" }, el("button", { type: "button", disabled: !app.orders.allowed, "data-key": "release", text: "Release …", on: { click: () => app.orders.give("release", [String(address)]) } }))))];
  }

  recordForm(about) {
    const slot = el("input", { id: "record-slot", size: 4, inputmode: "numeric", value: "0" });
    const index = el("input", { id: "record-index", size: 4, inputmode: "numeric", placeholder: "0..255" });
    const valid = () => [slot, index].every((one) => /^\d+$/.test(one.value.trim()) && Number(one.value) < 256);
    const read = async (event) => {
      event.preventDefault();
      if (!valid()) {
        this.app.say("Slot and index are numbers from 0 to 255.", "bad");
        return;
      }
      await this.answer(this.records, async () => {
        const result = await this.app.link.ask("records", String(this.address), slot.value.trim(), index.value.trim());
        return this.recordView(result);
      });
    };
    const data = el("input", { id: "record-data", size: 16, autocomplete: "off", spellcheck: "false", placeholder: "00FF" });
    const write = () => {
      const hex = data.value.replaceAll(/\s/g, "");
      if (!valid() || !/^([0-9a-f]{2})+$/i.test(hex)) this.app.say("Give slot, index, and octets as hex, such as 00FF", "bad");
      else this.app.orders.give("write", [String(this.address), slot.value.trim(), index.value.trim(), hex]);
    };
    const control = this.app.orders.shown && !this.app.live.plant?.read_only;
    return [
      about.dpv1 ? null : el("p", { class: "faint", text: "This slave is configured without DP-V1: a record can only be read over a class 2 connection, where the slave has one." }),
      el("form", { class: "inline", on: { submit: read } },
        el("label", { for: "record-slot", text: "Slot" }), slot, el("label", { for: "record-index", text: "Index" }), index, el("button", { text: "Read record" })),
      control ? el("div", { class: "inline" }, el("label", { for: "record-data", text: "Octets" }), data, el("button", { type: "button", text: "Write …", on: { click: write } })) : null,
    ];
  }

  recordView(result) {
    const hex = result.data ?? "";
    const lines = [];
    for (let at = 0; at < hex.length; at += 32) {
      const part = hex.slice(at, at + 32);
      const text = part.replace(/../g, (one) => {
        const code = parseInt(one, 16);
        return code >= 32 && code < 127 ? String.fromCharCode(code) : "·";
      });
      lines.push(`${(at / 2).toString(16).padStart(4, "0")}  ${octets(part).padEnd(47)}  ${text}`);
    }
    return [
      el("p", { text: `Slot ${result.slot}, index ${result.index}: ${result.length ?? hex.length / 2} octets, read ${clock(Date.now() / 1000)}` }),
      el("pre", { class: "dump", tabindex: "0", "aria-label": "Octets of the record", text: lines.join("\n") || "(empty)" }),
    ];
  }

  /** Fill `box` with what `ask` makes, or with the error. */
  async answer(box, ask) {
    box.replaceChildren(el("p", { class: "faint", text: "Asking …" }));
    try {
      box.replaceChildren(...[await ask()].flat().filter(Boolean));
    } catch (error) {
      box.replaceChildren(el("p", { class: "bad" }, mark("bad"), error.message));
    }
  }

  askWhy() {
    return this.answer(this.why, async () => whyStory(await this.app.link.ask("why", String(this.address))));
  }

  askIm() {
    return this.answer(this.im, async () => {
      const { im } = await this.app.link.ask("im", String(this.address));
      return Object.entries(im ?? {}).map(([which, fields]) => [
        el("h3", { text: `I&M${which}` }),
        pairs(Object.entries(fields).map(([name, one]) => [words(name), typeof one === "object" && one !== null ? JSON.stringify(one) : value(one)])),
      ]).flat();
    });
  }

  askStamps(index) {
    return this.answer(this.stamps, async () => stampsView(await this.app.link.ask("stamps", String(this.address), String(index))));
  }

  /** A record of time-stamped events by its number, for one whose alarm came before this page was opened. */
  stampsForm() {
    const index = el("input", { id: "stamps-index", size: 4, inputmode: "numeric", placeholder: "100..115" });
    const read = async (event) => {
      event.preventDefault();
      const found = recordOf(index.value);
      if (found === null) this.app.say("Records of time-stamped events are 100 to 115.", "bad");
      else await this.askStamps(found);
    };
    return el("form", { class: "inline", on: { submit: read } },
      el("label", { for: "stamps-index", text: "Events with time, record" }), index, el("button", { text: "Read events" }));
  }

  askPa() {
    return this.answer(this.pa, async () => deviceView(await this.app.link.ask("pa", String(this.address))));
  }

  /** One parameter or block of a process device by name: to read, and to write where this page may give orders. */
  paForm() {
    const name = el("input", { id: "pa-name", size: 22, autocomplete: "off", spellcheck: "false", placeholder: "ai1.pv_scale, ai1, 1:110" });
    const data = el("input", { id: "pa-value", size: 16, autocomplete: "off", spellcheck: "false", placeholder: "0" });
    const read = () => this.answer(this.paOne, async () => parametersView(await this.app.link.ask("pa", String(this.address), name.value.trim())));
    const submit = async (event) => {
      event.preventDefault();
      if (name.value.trim()) await read();
      else this.app.say("Give the name of a parameter, such as ai1.out, or of a block, such as ai1.", "bad");
    };
    const write = async () => {
      const [what, value] = [name.value.trim(), data.value.trim()];
      if (!what || !value) this.app.say("Give a parameter and its new value, such as tb1.lower_range and 0", "bad");
      else if (await this.app.orders.give("pa", [String(this.address), what, value])) await read();
    };
    const control = this.app.orders.shown && !this.app.live.plant?.read_only;
    return el("form", { class: "inline", on: { submit } },
      el("label", { for: "pa-name", text: "Parameter" }), name, el("button", { text: "Read" }),
      control ? [el("label", { for: "pa-value", text: "New value" }), data, el("button", { type: "button", text: "Write …", on: { click: write } })] : null);
  }

  askSheet() {
    return this.answer(this.sheet, async () => {
      const sheet = await this.app.link.ask("sheet", String(this.address));
      const save = el("button", { type: "button", text: "Save as a file to print", on: { click: () => download(`sheet-${sheet.address}.html`, sheet.html, "text/html") } });
      return [el("div", { class: "buttons" }, save), ...sheetView(sheet)];
    });
  }

  update(changed) {
    if (!this.there) return;
    const { app, address } = this;
    const { live } = app;
    refill(this.orderBox, [app.orders.allowed, app.orders.shown, live.plant?.read_only], this.orderMake);
    this.paintHistory(live);
    if (!changed.has(address)) return;
    const slave = live.slaves.get(address);
    if (!slave) return;
    this.state.update(kindOf(slave.level), stateText(slave));
    const said = slave.fault ? { text: `${words(slave.fault.kind ?? "fault")}: ${slave.fault.text}`, severity: "error" } : slave.remark;
    setText(this.fault, said?.text ?? "");
    setAttr(this.fault, "class", said ? `fault ${kindOf(said.severity)}` : "gone");
    this.inputs?.update(slave);
    this.outputs?.update(slave);
    this.rack.update(slave);
    const { dead } = this.app;
    const alive = !dead && slave.alive;
    setText(this.rawIn, octets(slave.inputs));
    setAttr(this.rawIn, "class", alive ? "octets" : "octets old");
    setText(this.rawOut, octets(slave.outputs));
    setText(this.rawHeld, slave.held ? `${slave.withheld ? "Withheld until outputs are set anew" : "Held by the application, not sent"}: ${octets(slave.held, 32)}` : "");
    setAttr(this.rawHeld, "class", slave.held ? "warn" : "gone");
    const links = slave.links ?? [];
    refill(this.links, links, () => (links.length ? [el("h3", { text: "Links to publishers (DXB)" }), table("Inputs of other slaves that act as outputs of this one", [["Publisher"], ["Its octets"], ["To output octet"], ["State"]], links.map((link) => el("tr", {},
      cell(`${link.publisher} ${link.name}`), cell(link.octets), cell(link.to ?? "-"), cell(link.text, link.good === true ? null : link.good === false ? "bad" : "faint"))))] : []));
    const age = slave.inputs_age_ms;
    const kind = live.about(address).protocol === "ppi" ? "values" : "inputs";
    const Kind = kind === "values" ? "Values" : "Inputs";
    setText(this.valid, dead ? `These ${kind} are old.` : alive ? (Object.values(slave.qualities ?? {}).some((one) => one.quality !== "good") ? `${Kind} are read; those with a mark are not good.` : `${Kind} are valid.`) : typeof age === "number" ? `${Kind} are not valid; the last ones are ${millis(age)} old.` : `No ${kind} yet.`);
    setAttr(this.valid, "class", alive ? "faint" : "age");
    this.drive?.update();
    this.paintDiagnosis(slave);
    const rows = [
      ...COUNTERS.map((name) => [words(name), count(slave[name])]),
      ...Object.entries(slave.bad ?? {}).map(([name, many]) => [`Unreadable: ${name}`, count(many)]),
      kind === "values" ? null : ["Watchdog", slave.watchdog_ms ? `${slave.watchdog_ms} ms` : "off"],
      ["Master", slave.master ?? null],
      ["Clock", slave.clock?.text ?? null],
    ].filter(Boolean);
    refill(this.counters, rows, () => pairs(rows, "pairs numbers"));
    refill(this.alarms, slave.alarms ?? null, () => (slave.alarms
      ? pairs(Object.entries(slave.alarms).map(([name, many]) => [words(name), count(many)]), "pairs numbers")
      : el("p", { class: "faint", text: "No alarms: the slave is configured without DP-V1." })));
  }

  paintDiagnosis(slave) {
    const { flags = [], texts = [] } = slave.diagnosis ?? {};
    refill(this.flags, [slave.diagnosis, slave.conspicuous, slave.injected], () => [
      slave.diagnosis ? null : el("p", { class: "faint", text: "No diagnosis was read yet." }),
      slave.conspicuous ? el("p", { class: "warn" }, mark("warn"), slave.conspicuous) : null,
      flags.length ? el("p", { class: "flags" }, ...flags.map((flag) => el("span", { class: "flag", text: flag.replaceAll("_", " ") }))) : null,
      texts.length ? el("ul", { class: "plain" }, ...texts.map((text) => el("li", { text }))) : null,
      slave.injected?.length ? el("p", { class: "faint", text: `Simulated: ${slave.injected.join(", ")}` }) : null,
    ]);
    const notices = slave.drive?.notices ?? [];
    refill(this.notices, notices, () => notices.map((one) => el("li", {}, el("span", { class: "faint figure", text: duration(one.t) }), " ", one.text)));
  }

  historyItem(live, one) {
    const item = eventItem(live, one);
    item.querySelector("a")?.remove();
    if (one.flags?.length || one.texts?.length) item.querySelector(".text").replaceChildren(...historyTexts(one));
    return item;
  }

  alarmItem(live, one) {
    const item = this.historyItem(live, one);
    const stamps = announced(one, (index) => this.askStamps(index));
    if (stamps) item.querySelector(".text").append(stamps);
    return item;
  }

  paintHistory(live) {
    const mine = live.events.filter((one) => one.address === this.address && HISTORY.has(one.event)).slice(-100).reverse();
    const alarms = mine.filter((one) => one.event === "alarm" || one.event === "status_message");
    refill(this.alarmList, alarms.map((one) => one.number).join(), () => alarms.map((one) => this.alarmItem(live, one)));
    refill(this.history, mine.map((one) => one.number).join(), () => (mine.length
      ? mine.map((one) => this.historyItem(live, one))
      : [el("li", { class: "faint", text: "nothing since this page was opened" })]));
  }
}

function historyTexts(event) {
  const flags = (event.flags ?? []).map((flag) => el("span", { class: "flag", text: flag.replaceAll("_", " ") }));
  const head = event.event === "diagnosis" ? "Diagnosis: " : `${event.text ?? words(event.event)} `;
  return [head, ...flags, ...(event.texts ?? []).map((text) => el("div", { text }))];
}

/** The parts of a commissioning sheet. Columns without a text in any row are left out. */
export function sheetView(sheet) {
  return sheet.blocks.flatMap(({ title, lines, columns, rows }) => {
    const used = columns.map((_, n) => n).filter((n) => n === 0 || rows.some((row) => row[n]));
    return [
      el("h3", { text: title }),
      lines.length ? el("ul", { class: "plain" }, ...lines.map((text) => el("li", { text }))) : null,
      !rows.length ? null : columns.some(Boolean)
        ? table(title, used.map((n) => [columns[n]]), rows.map((row) => el("tr", {}, ...used.map((n) => cell(row[n])))))
        : pairs(rows),
    ];
  });
}

/** The story of `dpstack why`: steps, and causes with what speaks for and against them. */
export function whyStory(story) {
  const steps = story.steps ?? [];
  const causes = story.causes ?? [];
  const list = (title, texts, kind) => (texts?.length ? [el("h4", { text: title }), el("ul", { class: `plain ${kind}` }, ...texts.map((text) => el("li", { text: String(text) })))] : []);
  return [
    causes.length ? el("h3", { text: "Likely causes" }) : el("p", { text: "No cause was found." }),
    el("ol", { class: "causes" }, ...causes.map((one) => el("li", {},
      // in the words of the command line and the screen: who reads one of them finds it on the others
      el("div", { class: "cause" }, el("strong", { text: `${one.cause} (${Math.round(one.confidence * 100)} %): ${one.meaning}` }),
        el("meter", { min: 0, max: 1, value: one.confidence, "aria-label": "confidence" })),
      ...list("Speaks for it", one.for, "for"), ...list("Speaks against it", one.against, "against"),
      one.next ? el("p", { class: "next" }, el("strong", { text: "Next: " }), one.next) : null))),
    steps.length ? el("h3", { text: "The last bring-up" }) : null,
    el("ol", { class: "steps" }, ...steps.map((one) => el("li", {},
      el("span", { class: "faint figure", text: typeof one.t === "number" ? `${one.t.toFixed(3)} s` : "" }),
      el("div", {}, el("p", { text: one.text ?? [one.asked, one.answered].filter(Boolean).join(": ") }),
        one.sent && !one.text ? el("code", { class: "octets" }, el("span", { class: "faint", text: "sent " }), octets(one.sent, 40)) : null,
        one.received && !one.text ? el("code", { class: "octets" }, el("span", { class: "faint", text: "received " }), octets(one.received, 40)) : null)))),
    story.text ? el("p", { text: story.text }) : null,
  ];
}
