// The frame of the page: connection, header, routes, keys. Each page is a class of its own.

import { el, setAttr, setText, refill } from "./dom.js";
import { clock, duration, modeKind, modeText, rate } from "./format.js";
import { Link } from "./link.js";
import { Live } from "./live.js";
import { mark } from "./marks.js";
import { Orders } from "./orders.js";
import { BusPage } from "./page_bus.js";
import { CommissioningPage } from "./page_commissioning.js";
import { PlantPage } from "./page_plant.js";
import { ScopePage } from "./page_scope.js";
import { SlavePage } from "./page_slave.js";
import { WatchPage } from "./page_watch.js";
import { RotationHistory } from "./rotation.js";
import { Store } from "./scope_data.js";

// Without a snapshot for so long the values on the page are not those of the plant.
const SILENT_MS = 2000;
// The page is painted at most this often.
const PAINT_MS = 100;

/** A setting of this browser; a browser that keeps none is no fault. */
function remembered(name) {
  try {
    return localStorage.getItem(name);
  } catch {
    return null;
  }
}

function remember(name, value) {
  try {
    localStorage.setItem(name, value);
  } catch {
    // it holds until the page is closed
  }
}

const byId = (id) => document.getElementById(id);

class App {
  constructor() {
    this.live = new Live();
    this.store = new Store();
    this.rotation = new RotationHistory();
    this.welcome = null;
    this.dead = true;
    this.deadSince = null;
    this.snapshotAt = 0;
    this.refusal = null;
    this.page = null;
    this.changed = new Set(); // addresses that changed since the last painting
    this.keys = remembered("dpstack-keys") !== "off";
    this.orders = new Orders(this);
    this.pages = [
      { key: "p", path: "plant", text: "Plant", make: (app) => new PlantPage(app) },
      { key: "w", path: "watch", text: "Watch table", make: (app) => new WatchPage(app) },
      { key: "o", path: "scope", text: "Oscilloscope", make: (app) => new ScopePage(app) },
      { key: "b", path: "bus", text: "Bus", make: (app) => new BusPage(app) },
      { key: "c", path: "commissioning", text: "Commissioning", make: (app) => new CommissioningPage(app) },
    ];
    const url = new URL("ws", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.hash = "";
    url.search = "";
    this.link = new Link(url, {
      item: (item) => this.received(item),
      welcome: (welcome) => this.greeted(welcome),
      refused: (text) => this.refused(text),
      state: () => this.judge(),
    });
  }

  /** A setting of this browser, null if it keeps none. */
  remembered(name) {
    return remembered(name);
  }

  remember(name, value) {
    remember(name, value);
  }

  start() {
    const token = this.tokenOfAddress();
    this.buildNav();
    this.buildHelp();
    window.addEventListener("hashchange", () => {
      const again = this.tokenOfAddress(); // the address of a start, put into an open page
      if (again) this.link.open(again);
      this.route();
    });
    document.addEventListener("keydown", (event) => this.keyed(event));
    document.querySelector(".skip").addEventListener("click", (event) => {
      event.preventDefault();
      byId("main").focus();
    });
    setInterval(() => this.judge(), 250);
    this.route();
    this.link.open(token);
  }

  /** The secret behind #, which is no route, is taken out of the address bar before anything else happens. */
  tokenOfAddress() {
    const found = /^#(?!\/)(?:token=)?(.+)$/.exec(location.hash);
    if (!found) return null;
    history.replaceState(null, "", `${location.pathname}#/plant`);
    try {
      return decodeURIComponent(found[1]);
    } catch {
      return found[1];
    }
  }

  // -- the stream ---------------------------------------------------------------------------------------------

  greeted(welcome) {
    this.welcome = welcome;
    this.refusal = null;
    byId("token").close();
    if (welcome.source === "replay" && !this.recording) {
      this.link.ask("recording").then((about) => { this.recording = about; }, () => {});
    }
    this.route(true);
    this.paintHeader();
  }

  refused(text) {
    this.refusal = text;
    this.welcome = null;
    const dialog = byId("token");
    const input = el("input", { id: "token-input", type: "password", autocomplete: "off", spellcheck: "false" });
    const send = (event) => {
      event.preventDefault();
      dialog.close();
      this.link.open(input.value.trim() || null);
    };
    dialog.replaceChildren(
      el("h2", { id: "token-title", text: "The server did not let this page in" }),
      el("p", { class: "bad", text }),
      el("form", { on: { submit: send } },
        el("label", { for: "token-input", text: "Token" }), input,
        el("p", { class: "faint", text: "The token stays in the memory of this page and is gone when the page is closed." }),
        el("div", { class: "buttons" }, el("button", { class: "primary", text: "Connect" }))));
    if (!dialog.open) dialog.showModal();
    input.focus();
    this.judge();
  }

  received(item) {
    const { live } = this;
    const kind = live.apply(item);
    if (kind === "plant") {
      this.store.plant(live);
      this.rotation.clear();
      this.route(true);
    } else if (kind === "snapshot") {
      this.snapshotAt = performance.now();
      for (const address of Object.keys(item.snapshot.slaves ?? {})) this.changed.add(Number(address));
      this.store.sample(live);
      this.rotation.sample(live.t, live.bus.histogram);
      for (const event of live.noted) {
        this.store.event(live, event);
        this.page?.happened?.(event);
      }
      if (this.dead) this.judge();
    } else if (kind === "event") {
      this.store.event(live, item.event);
      this.page?.happened?.(item.event);
    } else if (kind === "end") {
      this.judge();
    }
    this.paintSoon();
  }

  paintSoon() {
    if (this.pending) return;
    this.pending = true;
    const wait = Math.max(0, PAINT_MS - (performance.now() - (this.paintedAt ?? 0)));
    setTimeout(() => requestAnimationFrame(() => this.paint()), wait);
  }

  paint() {
    this.pending = false;
    const begun = performance.now();
    this.paintedAt = begun;
    const { changed } = this;
    this.changed = new Set();
    if (this.live.plant && this.live.whole) this.page?.update(changed);
    this.paintHeader();
    this.paintMs = performance.now() - begun;
    this.paintings = (this.paintings ?? 0) + 1;
  }

  /** Whether the page shows the plant of this moment; else everything is grey and a banner says why. */
  judge() {
    const { live, link } = this;
    const silent = performance.now() - this.snapshotAt > SILENT_MS;
    let text = null;
    if (this.refusal) text = `Not connected: ${this.refusal}`;
    else if (live.end) text = this.welcome?.source === "replay" ? `The recording is over: ${live.end.text ?? live.end}.` : `The program has ended: ${live.end.text ?? live.end}.`;
    else if (link.state === "lost" || !link.welcomed) text = this.snapshotAt ? "The connection to the server is lost; the page tries again." : "Connecting to the server …";
    else if (this.welcome?.source === "none" && !this.snapshotAt) text = this.orders.shown ? "There is no run of this configuration. Start one, or wait for one." : "There is no run of this configuration; the page waits for one.";
    else if (!this.snapshotAt) text = "Connected; waiting for the first values …";
    else if (silent) text = "The server has sent no values for more than 2 s.";
    else if (live.bus.stale) text = "The bus has stopped answering the server: its counters are stale.";
    const dead = text !== null;
    if (dead && this.snapshotAt) {
      if (!this.dead) this.deadSince = Date.now() / 1000;
      text += ` All values below are old${this.deadSince ? `, from ${clock(this.deadSince)} or before` : ""}.`;
    }
    const turned = dead !== this.dead;
    this.dead = dead;
    const banner = byId("banner");
    setText(banner, text ?? "");
    setAttr(banner, "hidden", text === null);
    setAttr(banner, "class", this.snapshotAt || this.refusal ? "banner" : "banner calm");
    setAttr(document.body, "class", dead ? (this.snapshotAt ? "dead" : "dead nothing") : null);
    this.paintHeader();
    if (turned) this.page?.update?.(new Set(live.addresses));
  }

  // -- header -------------------------------------------------------------------------------------------------

  buildNav() {
    byId("nav").replaceChildren(...this.pages.map(({ path, text, key }) =>
      el("a", { href: `#/${path}`, "data-path": path, "aria-keyshortcuts": key, text })),
    el("button", { type: "button", class: "quiet", "aria-label": "Keys and help", text: "?", on: { click: () => this.showHelp() } }));
  }

  paintHeader() {
    const { live, welcome, dead } = this;
    const { plant, bus } = live;
    const parts = plant ? [plant.config ? plant.config.split("/").pop() : null, plant.port, rate(plant.baud), `master ${plant.address}`] : [];
    setText(byId("plant-name"), parts.filter(Boolean).join(" · "));
    const title = this.page ? `${this.page.title} – dpstack` : "dpstack";
    if (document.title !== title) document.title = title;
    const replay = welcome?.source === "replay";
    const badges = [
      replay ? ["warn", `Replay of a recording${this.recording ? `, ${this.recording.file}, ${duration(this.recording.seconds)}` : ""}: no live bus`] : null,
      welcome?.source === "demo" || plant?.virtual ? ["info", "Simulated slaves"] : null,
      plant?.read_only && !replay ? ["info", "Read-only"] : null,
      welcome && !welcome.control && !replay && !plant?.read_only ? ["info", "No orders from this page"] : null,
      bus.mode ? [dead ? "off" : modeKind(bus.mode), modeText(bus.mode)] : null,
      bus.clear ? ["warn", `Clear by itself: ${bus.clear.because}`] : null,
      bus.in_ring === false ? ["bad", "Not in the token ring"] : null,
      live.lost ? ["warn", `${live.lost} events left out`] : null,
      welcome?.name ? ["info", `Token: ${welcome.name}`] : null,
    ].filter(Boolean);
    refill(byId("badges"), badges, () => badges.map(([kind, text]) => el("span", { class: `badge ${kind}` }, mark(kind), text)));
    const state = dead ? (this.snapshotAt ? "Old values" : "No values yet") : replay ? "Replay" : "Live";
    refill(byId("live"), [dead, state], () => [mark(dead ? "bad" : replay ? "busy" : "good"), el("span", { text: state })]);
    setAttr(byId("live"), "class", dead ? "live bad" : "live good");
    if (live.t !== null) setAttr(byId("live"), "title", `${duration(live.t)} since the start of the bus`);
    this.paintOrders();
  }

  paintOrders() {
    const { orders, live, welcome } = this;
    const reading = live.plant?.read_only === true;
    const key = [orders.allowed, orders.canStart, reading, live.bus.mode];
    refill(byId("orders"), key, () => {
      if (!orders.shown) return [];
      const button = (command, text, kind, off) => el("button", {
        type: "button", class: kind, "data-key": command, text, disabled: off || !orders.allowed,
        on: { click: () => orders.give(command) },
      });
      if (orders.canStart) return [el("button", { type: "button", class: "danger", "data-key": "start", text: "Start …", on: { click: () => orders.give("start") } })];
      if (reading || !live.plant) return [];
      return [
        button("operate", "Operate …", "danger", live.bus.mode === "operate"),
        button("clear", "Clear …", null, live.bus.mode === "clear"),
        button("stop", "Stop …", null, live.bus.mode === "stop"),
      ];
    });
  }

  /** A short message for the eye and for screen readers. */
  say(text, kind = "info") {
    const said = byId("said");
    said.replaceChildren(el("p", { class: kind }, mark(kind), el("span", { text })));
    clearTimeout(this.sayTimer);
    this.sayTimer = setTimeout(() => said.replaceChildren(), 8000);
  }

  // -- routes and keys ----------------------------------------------------------------------------------------

  route(again = false) {
    const found = /^#\/([a-z]+)(?:\/(\d+))?/.exec(location.hash);
    const path = found?.[1] ?? "plant";
    const address = found?.[2] === undefined ? null : Number(found[2]);
    const where = `${path}/${address ?? ""}/${this.live.version}/${Boolean(this.welcome)}`;
    if (where === this.where && !again) {
      this.page?.addressed?.();
      return;
    }
    const moved = this.path !== `${path}/${address ?? ""}`;
    this.where = where;
    this.path = `${path}/${address ?? ""}`;
    const kept = moved ? null : this.page?.keep?.();
    this.page?.leave?.();
    const entry = this.pages.find((one) => one.path === path) ?? this.pages[0];
    this.page = path === "slave" && address !== null ? new SlavePage(this, address) : entry.make(this);
    for (const link of byId("nav").querySelectorAll("a")) {
      setAttr(link, "aria-current", link.dataset.path === (path === "slave" ? "plant" : entry.path) ? "page" : null);
    }
    const main = byId("main");
    main.replaceChildren();
    if (!this.live.plant) {
      main.append(el("p", { class: "empty", text: "No values yet." }));
      this.page = null;
      return;
    }
    this.page.build(main, kept);
    if (this.live.whole) this.page.update(new Set(this.live.addresses));
    if (moved) {
      window.scrollTo(0, 0);
      if (this.routed) main.focus({ preventScroll: true });
    }
    this.routed = true;
    this.paintHeader();
  }

  keyed(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return;
    if (event.target.closest?.("input, select, textarea, dialog[open]")) return;
    if (event.key === "?") {
      this.showHelp();
      event.preventDefault();
      return;
    }
    if (!this.keys) return;
    const entry = this.pages.find((one) => one.key === event.key);
    if (entry) location.hash = `#/${entry.path}`;
    else if (!this.page?.key?.(event)) return;
    event.preventDefault();
  }

  buildHelp() {
    const rows = [
      ...this.pages.map(({ key, text }) => [key, `page ${text}`]),
      ["/", "plant, watch table, bus: to the filter"],
      ["j, k", "one slave: the next, the one before"],
      ["Space", "oscilloscope: pause, go on"],
      ["t", "oscilloscope: arm the trigger"],
      ["e", "oscilloscope: save as CSV"],
      ["?", "this list"],
      ["Tab, Enter, Esc", "through the page, press, close a dialog"],
    ];
    const dialog = byId("help");
    const single = el("input", { type: "checkbox", id: "single-keys", checked: this.keys, on: { change: () => {
      this.keys = single.checked;
      remember("dpstack-keys", this.keys ? "on" : "off");
    } } });
    dialog.replaceChildren(
      el("h2", { id: "help-title", text: "Keys" }),
      el("table", { class: "keys" }, el("tbody", {}, ...rows.map(([key, text]) =>
        el("tr", {}, el("th", { scope: "row" }, ...key.split(", ").flatMap((one, n) => [n ? " " : null, el("kbd", { text: one })])), el("td", { text }))))),
      el("p", {}, single, el("label", { for: "single-keys", text: " keys of one letter are on" })),
      el("h2", { text: "Marks" }),
      el("ul", { class: "legend" }, ...[
        ["good", "in data exchange, or in order"], ["busy", "on its way to data exchange"], ["warn", "worth a look"],
        ["bad", "fault, error"], ["off", "offline, or not known"],
      ].map(([kind, text]) => el("li", {}, mark(kind), text))),
      el("div", { class: "buttons" }, el("button", { type: "button", class: "primary", text: "Close", on: { click: () => dialog.close() } })));
  }

  showHelp() {
    byId("help").showModal();
  }
}

const app = new App();
window.dpstack = app; // for tests and for the console of the browser
app.start();
