// The bus: rotation times now and over time, plan beside measured, retries by station, the time line of events.

import { clockView } from "./clocks.js";
import { cell, el, pairs, refill, setAttr, setText, setVar, svg, table } from "./dom.js";
import { clock, count, duration, micros, number, rate, kindOf, stateText, words } from "./format.js";
import { StateMark, mark } from "./marks.js";
import { eventItem } from "./page_plant.js";
import { axis, colour, onTheme, uPlot } from "./plots.js";

const SHOWN_EVENTS = 300;
const SPANS = [[60, "1 min"], [300, "5 min"], [900, "15 min"], [3600, "1 h"]];

class RetryRow {
  constructor(app, address) {
    this.app = app;
    this.address = address;
    this.state = new StateMark();
    this.cells = ["exchanges", "retries", "timeouts", "late", "wrong", "bad"].map((name) => ({ name, node: cell("", "n") }));
    this.bar = el("i", { class: "share" });
    this.node = el("tr", { "data-address": address },
      el("th", { scope: "row" }, el("a", { href: `#/slave/${address}` }, el("span", { class: "address", text: address }), " ", el("bdi", { class: "name", text: app.live.name(address) }))),
      el("td", {}, this.state.node), ...this.cells.map((one) => one.node), el("td", { class: "barcell" }, this.bar));
  }

  update(most) {
    const slave = this.app.live.slaves.get(this.address);
    if (!slave) return;
    this.state.update(kindOf(slave.level), stateText(slave));
    for (const { name, node } of this.cells) {
      const one = name === "bad" ? Object.values(slave.bad ?? {}).reduce((sum, more) => sum + more, 0) : slave[name];
      setText(node, count(one));
    }
    setVar(this.bar, "--part", most ? String((slave.retries ?? 0) / most) : "0");
  }
}

export class BusPage {
  constructor(app) {
    this.app = app;
    this.title = "Bus";
    app.busView ??= { span: 300, filter: "", severities: { error: true, warning: true, info: true } };
    this.view = app.busView;
  }

  build(root) {
    const { app, view } = this;
    const { live } = app;
    this.tiles = el("dl", { class: "tiles" });
    this.histogram = el("div", { class: "histogram" });
    this.plotBox = el("div", { class: "plot", role: "img", "aria-label": "Rotation times over time" });
    this.span = el("select", { id: "span", on: { change: () => this.draw(true) } }, ...SPANS.map(([s, text]) => el("option", { value: s, text, selected: s === view.span })));
    this.plan = el("div");
    this.clocks = el("div", { class: "answer" });
    this.clockCard = el("section", { class: "card", "aria-labelledby": "h-clock", hidden: true }, el("h2", { id: "h-clock", text: "Time on the bus" }), this.clocks);
    this.rows = live.addresses.map((address) => new RetryRow(app, address));
    this.filter = el("input", { id: "filter", type: "search", placeholder: "text, address, kind", autocomplete: "off", value: view.filter, on: { input: () => { view.filter = this.filter.value; this.listEvents(); } } });
    this.kinds = ["error", "warning", "info"].map((one) => {
      const box = el("input", { type: "checkbox", checked: view.severities[one], on: { change: () => { view.severities[one] = box.checked; this.listEvents(); } } });
      return el("label", {}, box, words(one));
    });
    this.strip = el("div", { class: "strip" });
    this.events = el("ol", { class: "events" });
    this.shown = el("span", { class: "faint", role: "status" });
    const retries = table("Answers by station", [["Slave"], ["State"], ["Exchanges", "n"], ["Retries", "n"], ["No answer", "n"], ["Late", "n"], ["Wrong", "n"], ["Unreadable", "n"], ["Share of retries"]], this.rows.map((row) => row.node), "retries");
    root.append(
      el("h1", { class: "visually-hidden", text: "Bus" }),
      this.tiles,
      el("div", { class: "columns two" },
        el("section", { class: "card", "aria-labelledby": "h-now" }, el("h2", { id: "h-now", text: "Rotation time since the start" }), this.histogram),
        el("section", { class: "card", "aria-labelledby": "h-plan" }, el("h2", { id: "h-plan", text: "Plan and measurement" }), this.plan)),
      this.clockCard,
      el("section", { class: "card", "aria-labelledby": "h-over" },
        el("div", { class: "heading" }, el("h2", { id: "h-over", text: "Rotation time over time" }), el("span", { class: "field" }, el("label", { for: "span", text: "Window" }), this.span)),
        this.plotBox,
        el("ul", { class: "traces" }, ...[["p50", "median", 0], ["p99", "99 % below", 1], ["max", "longest", 2]].map(([, text, n]) => el("li", {}, el("i", { class: `line dash-${[0, 1, 2][n]}`, vars: { "--trace": `var(--trace-${[0, 2, 3][n]})` } }), text)), el("li", {}, el("i", { class: "swatch" }), "darker: more rotations"))),
      el("section", { class: "card", "aria-labelledby": "h-retries" }, el("h2", { id: "h-retries", text: "Stations" }), retries),
      el("section", { class: "card", "aria-labelledby": "h-events" },
        el("div", { class: "heading" }, el("h2", { id: "h-events", text: "Time line" }), el("label", { for: "filter", class: "visually-hidden", text: "Filter the events" }), this.filter, el("span", { class: "boxes", role: "group", "aria-label": "Severity" }, ...this.kinds), this.shown),
        this.strip, this.events));
    this.watcher = new ResizeObserver(() => {
      const wide = this.plotBox.clientWidth;
      if (this.chart && wide && wide !== this.chart.width) this.chart.setSize({ width: wide, height: 230 });
      this.paintStrip(true);
    });
    this.watcher.observe(this.plotBox);
    this.offTheme = onTheme(() => this.plot());
    this.plot();
    this.listEvents();
  }

  leave() {
    this.watcher?.disconnect();
    this.offTheme?.();
    this.chart?.destroy();
    this.chart = null;
  }

  key(event) {
    if (event.key !== "/") return false;
    this.filter.focus();
    return true;
  }

  update() {
    const { live } = this.app;
    this.paintTiles(live);
    this.paintHistogram(live);
    this.paintPlan(live);
    this.paintClock(live);
    const most = Math.max(0, ...[...live.slaves.values()].map((one) => one.retries ?? 0));
    const now = performance.now();
    if (this.rows.length < 40 || now - (this.rowsAt ?? 0) > 500) {
      this.rowsAt = now;
      for (const row of this.rows) row.update(most);
    }
    this.draw(false);
    if (live.numbered !== this.numbered) this.listEvents();
    this.paintStrip(false);
  }

  paintTiles(live) {
    const { bus, plant } = live;
    const us = bus.rotation_us ?? {};
    const tiles = [
      ["Rotation time, median", micros(us.p50)], ["99 % below", micros(us.p99)], ["Longest", micros(us.max)], ["Planned", micros(plant.plan?.rotation_us?.typical)],
      ["Rotations", count(bus.rotations)], ["Retries", count(bus.retries)], ["Without answer", count(bus.timeouts)], ["Tokens lost", count(bus.tokens_lost)],
    ];
    refill(this.tiles, tiles, () => tiles.map(([term, text]) => el("div", {}, el("dt", { text: term }), el("dd", {}, el("span", { class: "figure", text })))));
  }

  paintHistogram(live) {
    const { bus, plant } = live;
    const now = performance.now();
    if (now - (this.histogramAt ?? -1e9) < 400) return;
    this.histogramAt = now;
    const classes = bus.histogram ?? [];
    const planned = plant.plan?.rotation_us ?? null;
    refill(this.histogram, [classes, bus.rotation_us, planned, this.histogram.clientWidth], () => {
      if (!classes.length) return el("p", { class: "faint", text: "No rotations yet." });
      return histogramPicture(classes, planned, this.histogram.clientWidth || 500, bus.paced === false);
    });
  }

  paintPlan(live) {
    const { bus, plant } = live;
    const us = bus.rotation_us ?? {};
    const token = bus.token_us ?? {};
    const plan = plant.plan?.rotation_us ?? {};
    const rows = [
      ["Shortest", plan.min, us.min, token.min], ["Typical, median", plan.typical, us.p50, token.p50], ["99 % below", null, us.p99, token.p99],
      ["99.9 % below", null, us.p999, token.p999], ["Longest", plan.max, us.max, token.max],
    ];
    const cycle = plant.plan?.cycle_us ?? null;
    const more = [
      ["Rate", rate(plant.baud)], ["Driver", plant.driver], ["Fixed cycle", cycle ? micros(cycle) : "none: as fast as the bus allows"],
      ["Cycles missed", bus.missed === undefined ? null : count(bus.missed)], ["Masters in the ring, by address", (bus.masters ?? []).map((one) => (one === plant.address ? `${one} (this one)` : `${one}`)).join(", ")], ["Telegrams", count(bus.telegrams)],
      ["Since the start", live.t === null ? null : duration(Math.floor(live.t))],
    ];
    const parameters = Object.entries(plant.parameters ?? {});
    refill(this.plan, [rows, cycle, bus.masters, bus.missed, Math.floor((live.t ?? 0) / 2), plant.started], () => [
      table("Rotation time", [[""], ["Planned", "n"], ["Measured", "n"], ["Token", "n"]], rows.map(([text, ...times]) =>
        el("tr", { class: text === "Longest" && typeof times[0] === "number" && times[1] > times[0] ? "over" : null }, el("th", { scope: "row", text }), ...times.map((one) => cell(typeof one === "number" ? micros(one) : "", "n"))))),
      bus.paced === false ? el("p", { class: "faint", text: "No wire paces this bus: the measured times are the computer's." }) : null,
      pairs(more, "pairs numbers"),
      parameters.length ? el("details", { open: this.open ?? false, on: { toggle: (event) => { this.open = event.target.open; } } }, el("summary", { text: "Bus parameters" }), pairs(parameters.map(([name, one]) => [name, one === null ? "–" : typeof one === "object" ? JSON.stringify(one) : String(one)]), "pairs numbers")) : null,
    ]);
  }

  paintClock(live) {
    const { clock: clocks } = live.bus;
    setAttr(this.clockCard, "hidden", !clocks);
    refill(this.clocks, [clocks ?? null, live.plant.started], () => (clocks ? clockView(clocks, (t) => live.wall(t)) : []));
  }

  // -- over time ----------------------------------------------------------------------------------------------

  plot() {
    this.chart?.destroy();
    const line = (n, dash) => ({ stroke: colour(`--trace-${n}`), width: 1.8, dash, points: { show: false } });
    this.chart = new uPlot({
      width: Math.max(200, this.plotBox.clientWidth), height: 230, legend: { show: false }, ms: 1, pxAlign: 0, padding: [null, 30, null, null],
      scales: { x: { time: false }, y: { range: (_, low, high) => (low === null ? [0, 1] : [Math.max(0, low - (high - low) * 0.1 - 1), high + (high - low) * 0.1 + 1]) } },
      axes: [axis({ size: 32, values: (_, all) => all.map((t) => clock(this.app.live.wall(t))), space: 80 }), axis({ size: 66, values: (_, all) => all.map((one) => micros(Number(one.toPrecision(6)))) })],
      cursor: { show: false },
      series: [{}, line(0, []), line(2, [8, 4]), line(3, [2, 3])],
      hooks: { drawAxes: [(chart) => this.heat(chart)] },
    }, [[], [], [], []], this.plotBox);
    this.draw(true);
  }

  columns() {
    const { columns } = this.app.rotation;
    const from = (columns.at(-1)?.t ?? 0) - this.view.span;
    return columns.filter((one) => one.t >= from);
  }

  draw(always) {
    const { view, app, chart } = this;
    view.span = Number(this.span.value);
    const last = app.rotation.columns.at(-1)?.t ?? 0;
    if (!chart || (!always && last === this.drawn)) return;
    this.drawn = last;
    const shown = this.columns();
    chart.batch(() => {
      chart.setData([shown.map((one) => one.t), shown.map((one) => one.p50), shown.map((one) => one.p99), shown.map((one) => one.max)], true);
      chart.setScale("x", { min: Math.max(last - view.span, (shown[0]?.t ?? last) - 1), max: Math.max(last, 1) });
    });
  }

  /** Behind the lines: how many rotations of each second took how long. */
  heat(chart) {
    const { ctx } = chart;
    const { left, top, width, height } = chart.bbox;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    ctx.fillStyle = colour("--heat");
    let before = null;
    const step = classWidth(this.app.live.bus.histogram ?? []);
    for (const { t, classes } of this.columns()) {
      const all = classes.reduce((sum, [, many]) => sum + many, 0);
      const x2 = chart.valToPos(t, "x", true);
      const x1 = chart.valToPos(before === null || t - before > 3 ? t - 1 : before, "x", true);
      before = t;
      for (const [upper, many] of classes) {
        const y = chart.valToPos(upper, "y", true);
        ctx.globalAlpha = 0.1 + 0.55 * Math.sqrt(many / all);
        ctx.fillRect(x1, y, Math.max(1, x2 - x1), Math.max(3, chart.valToPos(upper - step, "y", true) - y));
      }
    }
    ctx.restore();
  }

  // -- events -------------------------------------------------------------------------------------------------

  wanted() {
    const { view, app } = this;
    const text = view.filter.trim().toLowerCase();
    return app.live.events.filter((one) => view.severities[one.severity] !== false
      && (!text || `${one.address ?? ""} ${one.name ?? ""} ${one.event} ${one.text ?? ""} ${one.state ?? ""}`.toLowerCase().includes(text)));
  }

  listEvents() {
    const { live } = this.app;
    this.numbered = live.numbered;
    const found = this.wanted();
    const shown = found.slice(-SHOWN_EVENTS).reverse();
    setText(this.shown, `${found.length} events${found.length > shown.length ? `, the last ${shown.length} shown` : ""}${live.lost ? `, ${live.lost} left out` : ""}`);
    refill(this.events, `${live.numbered}|${this.view.filter}|${JSON.stringify(this.view.severities)}`, () => (shown.length ? shown.map((one) => eventItem(live, one)) : [el("li", { class: "faint", text: "none" })]));
    this.paintStrip(true);
  }

  /** The events of the window as marks in three lanes. */
  paintStrip(always) {
    const { live } = this.app;
    const now = performance.now();
    if (!always && now - (this.stripAt ?? 0) < 1000) return;
    this.stripAt = now;
    const wide = this.strip.clientWidth;
    const to = live.t ?? 0;
    const from = to - this.view.span;
    if (!wide) return;
    const lanes = { error: 14, warning: 34, info: 54 };
    const x = (t) => 64 + ((t - from) / this.view.span) * (wide - 72);
    const drawing = svg("svg", { width: wide, height: 86, viewBox: `0 0 ${wide} 86`, role: "img", "aria-label": "Events of the window; the list below has the same" });
    for (const [name, y] of Object.entries(lanes)) {
      drawing.append(svg("path", { class: "lane", d: `M64 ${y}H${wide - 8}` }), svg("text", { x: 4, y: y + 4, text: words(name) }));
    }
    const parts = wide < 500 ? 2 : 4;
    for (let n = 0; n <= parts; n += 1) {
      const t = from + (this.view.span * n) / parts;
      drawing.append(svg("text", { x: x(t), y: 80, class: n === 0 ? "start" : n === parts ? "stop" : "middle", text: clock(live.wall(t)) }));
    }
    const used = new Set();
    for (const one of this.wanted()) {
      const t = live.eventT(one);
      if (t < from || t > to) continue;
      const at = Math.round(x(t));
      const key = `${one.severity}${Math.round(at / 3)}`;
      if (used.has(key)) continue;
      used.add(key);
      const kind = kindOf(one.severity);
      drawing.append(svg("rect", { class: `event ${kind}`, x: at - 1.5, y: lanes[one.severity] - 7, width: 3, height: 14 }));
    }
    this.strip.replaceChildren(drawing);
  }
}

/** The width of the classes of a histogram in us: all are multiples of the narrowest. */
function classWidth(classes) {
  let width = Infinity;
  for (let n = 1; n < classes.length; n += 1) width = Math.min(width, classes[n][0] - classes[n - 1][0]);
  return width === Infinity ? Math.max(1, (classes[0]?.[0] ?? 100) * 0.01) : Math.max(1, width);
}

function histogramPicture(classes, planned, wide, unpaced) {
  const high = 190;
  const [top, bottom, left, right] = [18, 40, 8, 8];
  const step = classWidth(classes);
  const shownPlan = unpaced ? [] : [["min", planned?.min], ["typical", planned?.typical], ["max", planned?.max]].filter(([, us]) => typeof us === "number");
  const near = shownPlan.filter(([, us]) => us < classes.at(-1)[0] * 3);
  const low = Math.min(classes[0][0] - step, ...near.map(([, us]) => us));
  const up = Math.max(classes.at(-1)[0], ...near.map(([, us]) => us), low + step);
  const room = (up - low) * 0.04;
  const x = (us) => left + ((us - low + room) / (up - low + 2 * room)) * (wide - left - right);
  const most = Math.max(...classes.map(([, many]) => many));
  const all = classes.reduce((sum, [, many]) => sum + many, 0);
  // logarithmic, so that a single slow rotation among a million is seen
  const y = (many) => high - bottom - (Math.log1p(many) / Math.log1p(most)) * (high - top - bottom);
  const drawing = svg("svg", { width: wide, height: high, viewBox: `0 0 ${wide} ${high}`, role: "img", "aria-label": `Rotation times from ${micros(low)} to ${micros(classes.at(-1)[0])}; ${count(all)} rotations` });
  drawing.append(svg("path", { class: "axis", d: `M${left} ${high - bottom + 0.5}H${wide - right}` }));
  for (const [upper, many] of classes) {
    const from = x(upper - step);
    drawing.append(svg("rect", { class: "column", x: from, y: y(many), width: Math.max(2, x(upper) - from - 1), height: high - bottom - y(many) }, svg("title", { text: `up to ${micros(upper)}: ${count(many)}` })));
  }
  let free = -Infinity;
  for (const [name, us] of near) {
    const at = x(us);
    drawing.append(svg("path", { class: "planned", d: `M${at} ${top - 4}V${high - bottom}` }));
    const text = `plan: ${name}`;
    const end = at > wide - 90;
    if (at - (end ? 80 : 0) > free) {
      drawing.append(svg("text", { x: at + (end ? -4 : 4), y: 12, class: end ? "stop" : "start", text }));
      free = at + (end ? 0 : 80);
    }
  }
  const ticks = Math.max(2, Math.floor(wide / 130));
  for (let n = 0; n <= ticks; n += 1) {
    const us = low + ((up - low) * n) / ticks;
    drawing.append(svg("text", { x: x(us), y: high - bottom + 16, class: n === 0 ? "start" : n === ticks ? "stop" : "middle", text: micros(Number(us.toPrecision(4))) }));
  }
  drawing.append(svg("text", { x: wide / 2, y: high - 6, class: "middle faint", text: `${count(all)} rotations, logarithmic` }));
  return drawing;
}
