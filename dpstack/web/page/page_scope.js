// The oscilloscope: traces of named values and drive quantities, triggers, CSV.

import { download, el, refill, setAttr, setText } from "./dom.js";
import { clock, number } from "./format.js";
import { axis, colour, onTheme, trace, uPlot } from "./plots.js";
import { Trigger, lowerBound, toCsv } from "./scope_data.js";

const WINDOWS = [[5, "5 s"], [10, "10 s"], [30, "30 s"], [60, "1 min"], [300, "5 min"], [900, "15 min"], [3600, "1 h"]];
const KINDS = [["rising", "rises through"], ["falling", "falls through"], ["above", "is above"], ["below", "is below"], ["event", "an event happens"]];
const EVENTS = ["diagnosis", "quality", "fault", "slave", "alarm", "drive", "mode", "stalled", "flapping", "remark", "ring", "notice"];
const MOST = 8;
// This part of the window lies before the trigger.
const BEFORE = 0.3;
// Between two requests for the values of each round.
const ASK_MS = 500;

export class ScopePage {
  constructor(app) {
    this.app = app;
    this.title = "Oscilloscope";
    app.scope ??= { chosen: null, window: 30, trigger: null, armed: false, hold: null, kind: "rising", level: "0", event: "diagnosis", again: false };
    this.scope = app.scope;
  }

  build(root) {
    const { scope, app } = this;
    const { store } = app;
    const all = [...store.signals.values()];
    scope.chosen = (scope.chosen ?? this.first(all)).filter((id) => store.signals.has(id));
    for (const id of scope.chosen) store.keep(id);
    this.plotBox = el("div", { class: "plot", role: "img", "aria-label": "Traces over time" });
    this.legend = el("ul", { class: "traces" });
    this.status = el("span", { class: "status", role: "status", "aria-live": "polite" });
    this.pause = el("button", { type: "button", id: "pause", on: { click: () => this.togglePause() } });
    this.window = el("select", { id: "window", on: { change: () => this.setWindow() } }, ...WINDOWS.map(([s, text]) => el("option", { value: s, text, selected: s === scope.window })));
    this.csv = el("button", { type: "button", text: "Save CSV", id: "csv", on: { click: () => this.save() } });
    this.kind = el("select", { id: "trigger-kind", on: { change: () => this.triggerForm() } }, ...KINDS.map(([kind, text]) => el("option", { value: kind, text, selected: kind === scope.kind })));
    this.source = el("select", { id: "trigger-source" });
    this.level = el("input", { id: "trigger-level", size: 6, inputmode: "decimal", value: scope.level });
    this.eventPick = el("select", { id: "trigger-event" }, ...EVENTS.map((one) => el("option", { value: one, text: one.replace("_", " "), selected: one === scope.event })));
    this.again = el("input", { type: "checkbox", id: "trigger-again", checked: scope.again });
    this.arm = el("button", { type: "button", id: "arm", on: { click: () => this.toggleArm() } });
    this.search = el("input", { type: "search", id: "signal-filter", placeholder: "Find a signal", autocomplete: "off", on: { input: () => this.listSignals() } });
    this.list = el("div", { class: "signals", role: "group", "aria-label": "Signals" });
    this.sourceBox = el("span", { class: "field" }, el("label", { for: "trigger-source", text: "Signal" }), this.source);
    this.levelBox = el("span", { class: "field" }, el("label", { for: "trigger-level", text: "Level" }), this.level);
    this.eventBox = el("span", { class: "field" }, el("label", { for: "trigger-event", text: "Event" }), this.eventPick);
    root.append(
      el("h1", { class: "visually-hidden", text: "Oscilloscope" }),
      el("div", { class: "toolbar", role: "group", "aria-label": "Time" },
        el("span", { class: "field" }, el("label", { for: "window", text: "Window" }), this.window), this.pause, this.csv, this.status),
      el("section", { class: "card scope", "aria-label": "Traces" }, this.plotBox, this.legend),
      el("div", { class: "columns two" },
        el("section", { class: "card", "aria-labelledby": "h-trigger" }, el("h2", { id: "h-trigger", text: "Trigger" }),
          el("div", { class: "fields" },
            el("span", { class: "field" }, el("label", { for: "trigger-kind", text: "Hold the picture when" }), this.kind),
            this.sourceBox, this.levelBox, this.eventBox),
          el("p", {}, this.again, el("label", { for: "trigger-again", text: " arm again after each picture" })),
          el("div", { class: "buttons" }, this.arm),
          el("p", { class: "faint", text: "A picture has 30 % of the window before the trigger. Values come with each round of the bus while this page is open; where they do not, with the snapshots, about five a second." })),
        el("section", { class: "card", "aria-labelledby": "h-signals" }, el("h2", { id: "h-signals", text: "Signals" }),
          el("label", { for: "signal-filter", class: "visually-hidden", text: "Find a signal" }), this.search, this.list)));
    this.watcher = new ResizeObserver(() => this.resize());
    this.watcher.observe(this.plotBox);
    this.offTheme = onTheme(() => this.plot());
    this.listSignals();
    this.triggerForm();
    this.plot();
    this.paintButtons();
    this.asking = setInterval(() => this.askRounds(), ASK_MS);
  }

  /** Ask for the values of the rounds since the last answer. A run that does not give them is asked no more. */
  async askRounds() {
    const { app, scope } = this;
    const { store } = app;
    if (this.asked || app.dead || app.link.state !== "open" || store.noRounds === app.live.version) return;
    const ids = scope.chosen.filter((id) => store.signals.get(id)?.rounds);
    if (!ids.length) return;
    const rounds = store.follow(ids);
    this.asked = true;
    try {
      let answer;
      do {
        answer = await app.link.ask("rounds", String(rounds.after), ...ids);
        if (!Array.isArray(answer?.rounds)) throw new Error("no rounds");
        if (store.rounds !== rounds) break; // other signals were chosen meanwhile
        store.takeRounds(rounds, answer);
      } while (answer.more);
    } catch {
      store.noRounds = app.live.version;
    } finally {
      this.asked = false;
    }
  }

  /** The signals to begin with: set point and speed of the first drive, else the first values. */
  first(all) {
    const speed = all.find((one) => one.id.endsWith(":speed"));
    if (speed) return all.filter((one) => one.address === speed.address && /:(speed|setpoint)$/.test(one.id)).map((one) => one.id);
    const named = all.filter((one) => one.id.includes(".")).slice(0, 3).map((one) => one.id);
    return named.length ? named : ["bus:p50"];
  }

  leave() {
    clearInterval(this.asking);
    this.watcher?.disconnect();
    this.offTheme?.();
    this.chart?.destroy();
    this.chart = null;
  }

  key(event) {
    const act = { " ": () => this.togglePause(), t: () => this.toggleArm(), e: () => this.save() }[event.key];
    if (!act || (event.key === " " && event.target.closest?.("button, a"))) return false;
    act();
    return true;
  }

  // -- signals ------------------------------------------------------------------------------------------------

  listSignals() {
    const { scope, app } = this;
    const wanted = this.search.value.trim().toLowerCase();
    const all = [...app.store.signals.values()].filter((one) => `${one.address ?? ""} ${one.label}`.toLowerCase().includes(wanted));
    const shown = [...all.filter((one) => scope.chosen.includes(one.id)), ...all.filter((one) => !scope.chosen.includes(one.id))].slice(0, 200);
    const boxes = shown.map((one) => {
      const box = el("input", { type: "checkbox", checked: scope.chosen.includes(one.id), "data-key": one.id, disabled: !scope.chosen.includes(one.id) && scope.chosen.length >= MOST, on: { change: () => this.choose(one.id, box.checked) } });
      return el("label", {}, box, el("bdi", { text: one.label }), one.unit ? " " : null, one.unit ? el("span", { class: "unit", text: one.unit }) : null);
    });
    const had = this.list.contains(document.activeElement) ? document.activeElement.dataset.key : null;
    this.list.replaceChildren(...boxes, ...(all.length > shown.length ? [el("p", { class: "faint", text: `${all.length - shown.length} more: use the search` })] : []));
    if (had) [...this.list.querySelectorAll("input")].find((one) => one.dataset.key === had)?.focus();
    refill(this.source, scope.chosen.join("|"), () => scope.chosen.map((id) => el("option", { value: id, text: app.store.signals.get(id).label })));
  }

  choose(id, wanted) {
    const { scope, app } = this;
    if (wanted && scope.chosen.length >= MOST) {
      app.say(`At most ${MOST} traces at once`, "warn");
    } else if (wanted) {
      scope.chosen = [...scope.chosen, id];
      app.store.keep(id);
    } else {
      scope.chosen = scope.chosen.filter((one) => one !== id);
      app.store.drop(id);
    }
    this.listSignals();
    this.plot();
  }

  // -- time, pause, trigger -----------------------------------------------------------------------------------

  setWindow() {
    this.scope.window = Number(this.window.value);
    if (this.scope.hold && !this.scope.hold.trigger) this.scope.hold.from = this.scope.hold.to - this.scope.window;
    this.draw(true);
  }

  togglePause() {
    const { scope, app } = this;
    const to = app.store.times.at(-1) ?? 0;
    scope.hold = scope.hold ? null : { from: to - scope.window, to, trigger: null };
    this.paintButtons();
    this.draw(true);
  }

  triggerForm() {
    const event = this.kind.value === "event";
    setAttr(this.sourceBox, "hidden", event);
    setAttr(this.levelBox, "hidden", event);
    setAttr(this.eventBox, "hidden", !event);
  }

  toggleArm() {
    const { scope, app } = this;
    if (scope.armed) {
      scope.armed = false;
      scope.trigger = null;
    } else {
      const level = Number(this.level.value.replace(",", ".").replace("−", "-"));
      Object.assign(scope, { kind: this.kind.value, level: this.level.value, event: this.eventPick.value, again: this.again.checked });
      if (scope.kind !== "event" && (!Number.isFinite(level) || this.level.value.trim() === "")) {
        app.say(`The level of the trigger is no number: ${this.level.value}`, "bad");
        return;
      }
      scope.make = () => new Trigger({ kind: scope.kind, id: this.source.value, level, event: scope.event });
      scope.trigger = scope.make();
      scope.armed = true;
      scope.hold = null;
      scope.watched = app.store.times.length;
      scope.watchedT = app.store.times.at(-1) ?? -Infinity;
    }
    this.paintButtons();
    this.draw(true);
  }

  happened(event) {
    if (this.scope.armed) this.scope.trigger?.happened({ ...event, t: this.app.live.eventT(event) });
  }

  /** Show the new samples to the trigger; hold the picture once the time after the trigger is over. */
  watch() {
    const { scope, app } = this;
    const { store } = app;
    const trigger = scope.trigger;
    if (!scope.armed || !trigger) return;
    const signal = store.signals.get(trigger.id);
    const rounds = store.roundsOf(trigger.id);
    if (trigger.kind !== "event" && trigger.at === null && rounds) {
      const { times, values } = rounds;
      for (let n = lowerBound(times, scope.watchedT); n < times.length; n += 1) {
        if (times[n] <= scope.watchedT) continue;
        scope.watchedT = times[n];
        if (trigger.sample(times[n], values[n])) break;
      }
    } else if (trigger.kind !== "event" && trigger.at === null && signal?.values) {
      for (let n = store.times.length - 1; n >= 0 && store.times[n] > scope.watchedT; n -= 1) scope.watched = n;
      for (let n = scope.watched; n < store.times.length; n += 1) if (store.times[n] > scope.watchedT && trigger.sample(store.times[n], signal.values[n])) break;
      scope.watchedT = store.times.at(-1) ?? scope.watchedT;
      scope.watched = store.times.length;
    }
    if (trigger.at === null) return;
    const to = trigger.at + scope.window * (1 - BEFORE);
    if ((store.times.at(-1) ?? 0) < to) return;
    scope.hold = { from: to - scope.window, to, trigger: trigger.at };
    scope.trigger = scope.again ? scope.make() : null;
    scope.armed = scope.again;
    scope.watchedT = store.times.at(-1);
    this.app.say(`Triggered at ${clock(app.live.wall(scope.hold.trigger), true)}`, "good");
    this.paintButtons();
  }

  paintButtons() {
    const { scope } = this;
    setText(this.pause, scope.hold ? "Go on" : "Pause");
    setAttr(this.pause, "aria-pressed", scope.hold ? "true" : "false");
    setText(this.arm, scope.armed ? "Disarm" : "Arm");
    setAttr(this.arm, "class", scope.armed ? "danger" : "primary");
  }

  save() {
    const { scope, app } = this;
    const { from, to } = this.range();
    const signals = scope.chosen.map((id) => app.store.signals.get(id));
    const [times, ...columns] = app.store.slice(scope.chosen, from, to);
    const within = times.map((t) => t >= from && t <= to);
    const cut = [times, ...columns].map((column) => column.filter((_, n) => within[n]));
    const name = `dpstack-${new Date(app.live.wall(to) * 1000).toISOString().slice(0, 19).replaceAll(":", "")}.csv`;
    download(name, toCsv(signals, cut, (t) => app.live.wall(t)), "text/csv");
    app.say(`Saved ${cut[0].length} samples as ${name}`, "good");
  }

  // -- drawing ------------------------------------------------------------------------------------------------

  range() {
    const { scope, app } = this;
    if (scope.hold) return scope.hold;
    const to = app.store.times.at(-1) ?? 0;
    return { from: to - scope.window, to, trigger: null };
  }

  plot() {
    const { scope, app } = this;
    this.chart?.destroy();
    const signals = scope.chosen.map((id) => app.store.signals.get(id));
    const units = [...new Set(signals.map((one) => (one.kind === "bool" ? "bool" : one.unit || "value")))];
    const scales = Object.fromEntries(units.map((unit) => [unit, unit === "bool" ? { range: () => [-0.15, 1.15] }
      : { range: (_, low, high) => (low === null ? [0, 1] : low === high ? [low - 1, high + 1] : uPlot.rangeNum(low, high, 0.08, true)) }]));
    const axes = [axis({ size: 32, values: (_, all) => all.map((t) => clock(app.live.wall(t))), space: 80 })];
    const narrow = this.plotBox.clientWidth < 520; // there the legend has to tell the units
    this.narrow = narrow;
    units.slice(0, narrow ? 2 : 3).forEach((unit, n) => {
      axes.push(axis({
        scale: unit, side: n === 1 ? 1 : 3, size: narrow ? 38 : 58, label: narrow ? undefined : unit === "bool" ? "off / on" : unit, labelSize: 18,
        grid: { show: n === 0, stroke: colour("--grid"), width: 1 },
        splits: unit === "bool" ? () => [0, 1] : undefined, values: unit === "bool" ? () => ["off", "on"] : (_, all) => all.map((one) => number(one)),
      }));
    });
    const steps = uPlot.paths.stepped({ align: 1 });
    this.chart = new uPlot({
      width: Math.max(200, this.plotBox.clientWidth), height: this.height(), legend: { show: false }, pxAlign: 0, ms: 1, padding: [null, 26, null, null],
      scales: { x: { time: false }, ...scales }, axes,
      cursor: { drag: { x: false, y: false }, points: { size: 6 } },
      series: [{}, ...signals.map((one, n) => ({ label: one.label, scale: one.kind === "bool" ? "bool" : one.unit || "value", width: 1.8, ...trace(n), paths: steps, points: { show: false } }))],
      hooks: { draw: [(chart) => this.marks(chart)], setCursor: [() => this.figures()] },
    }, app.store.slice(scope.chosen, -1, -1), this.plotBox);
    this.legendItems = signals.map((one, n) => {
      const figure = el("span", { class: "figure" });
      const line = el("i", { class: `line dash-${Math.floor(n / 2) % 4}`, vars: { "--trace": `var(--trace-${n % 8})` } });
      return { figure, node: el("li", {}, line, el("bdi", { text: one.label }), figure, one.unit ? " " : null, one.unit ? el("span", { class: "unit", text: one.unit }) : null) };
    });
    this.legend.replaceChildren(...this.legendItems.map((one) => one.node));
    this.draw(true);
  }

  height() {
    return Math.max(220, Math.min(440, Math.round(window.innerHeight * 0.5)));
  }

  resize() {
    const wide = this.plotBox.clientWidth;
    if (this.chart && wide && (wide < 520) !== this.narrow) this.plot();
    else if (this.chart && wide && wide !== this.chart.width) this.chart.setSize({ width: wide, height: this.height() });
  }

  /** Lines at the trigger, at its level and at the events of the window. */
  marks(chart) {
    const { scope, app } = this;
    const { from, to, trigger } = this.range();
    const { ctx } = chart;
    const { left, top, width, height } = chart.bbox;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    for (const one of app.store.events) {
      if (one.t < from || one.t > to || one.severity === "info") continue;
      const x = chart.valToPos(one.t, "x", true);
      ctx.strokeStyle = colour(one.severity === "error" ? "--bad" : "--warn");
      ctx.setLineDash([3, 4]);
      ctx.strokeRect(x, top, 0, height);
    }
    if (trigger !== null) {
      const x = chart.valToPos(trigger, "x", true);
      ctx.setLineDash([]);
      ctx.lineWidth = 2;
      ctx.strokeStyle = colour("--accent");
      ctx.strokeRect(x, top, 0, height);
    }
    if (scope.armed && scope.trigger && scope.kind !== "event" && scope.chosen.includes(scope.trigger.id)) {
      const signal = app.store.signals.get(scope.trigger.id);
      const y = chart.valToPos(scope.trigger.level, signal.kind === "bool" ? "bool" : signal.unit || "value", true);
      ctx.setLineDash([6, 4]);
      ctx.strokeStyle = colour("--accent");
      ctx.strokeRect(left, y, width, 0);
    }
    ctx.restore();
  }

  figures() {
    const { chart } = this;
    if (!chart) return;
    const at = chart.cursor.idx ?? chart.data[0].length - 1;
    this.scope.chosen.forEach((id, n) => {
      const one = chart.data[n + 1]?.[at];
      const kind = this.app.store.signals.get(id)?.kind;
      setText(this.legendItems[n].figure, one === null || one === undefined ? "–" : kind === "bool" ? (one ? "on" : "off") : number(Number(one.toPrecision(5))));
    });
  }

  update() {
    this.watch();
    this.draw(false);
  }

  draw(always) {
    const { scope, app, chart } = this;
    if (!chart) return;
    const { from, to, trigger } = this.range();
    const now = performance.now();
    // a long window moves slowly
    const due = scope.window > 300 ? 1000 : 0;
    const key = `${from}|${to}|${trigger}|${scope.hold ? app.store.rounds?.after : ""}`;
    if (always || (key !== this.drawn && now - (this.drawnAt ?? 0) >= due)) {
      this.drawn = key;
      this.drawnAt = now;
      chart.batch(() => {
        chart.setData(app.store.slice(scope.chosen, from, to), false);
        chart.setScale("x", { min: from, max: to });
      });
      this.figures();
    }
    const text = scope.hold ? (scope.hold.trigger === null ? "Paused" : `Picture of ${clock(app.live.wall(scope.hold.trigger), true)}`) : app.dead ? "No values" : "Running";
    const { rounds } = app.store;
    const samples = !rounds?.times.length || app.store.noRounds === app.live.version ? "" : rounds.lost ? `, each round, ${rounds.lost} missing` : ", each round";
    setText(this.status, scope.armed ? `${text}${samples}, trigger armed${scope.trigger?.at !== null && scope.trigger?.at !== undefined ? ", triggered" : ""}` : `${text}${samples}`);
  }
}
