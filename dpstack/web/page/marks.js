// Small pictures: the mark of a state (a shape of its own beside its colour), bars, state machines of drives.

import { el, setAttr, setText, setVar, svg } from "./dom.js";
import { percent, words } from "./format.js";

// Each kind of state has a shape of its own, so that it is told apart without colours.
const SHAPES = {
  good: () => [svg("circle", { cx: 8, cy: 8, r: 6, class: "full" })],
  busy: () => [svg("circle", { cx: 8, cy: 8, r: 5.2, class: "hollow" }), svg("path", { d: "M8 2.8a5.2 5.2 0 0 1 0 10.4z", class: "full" })],
  warn: () => [svg("path", { d: "M8 1.8 15 14H1z", class: "full" }), svg("path", { d: "M8 6v4M8 11.4v1.4", class: "cut" })],
  bad: () => [svg("path", { d: "M8 .8 15.2 8 8 15.2.8 8z", class: "full" }), svg("path", { d: "M5.6 5.6l4.8 4.8M10.4 5.6l-4.8 4.8", class: "cut" })],
  off: () => [svg("circle", { cx: 8, cy: 8, r: 5.4, class: "dashed" })],
  info: () => [svg("circle", { cx: 8, cy: 8, r: 2.4, class: "full" })],
};

/** The shape as a group, for a drawing. */
export function shape(kind) {
  return svg("g", { class: `mark ${kind}` }, ...(SHAPES[kind] ?? SHAPES.off)());
}

/** The shape as a picture beside a text, which says the same. */
export function mark(kind) {
  return svg("svg", { class: "sign", viewBox: "0 0 16 16", "aria-hidden": "true", focusable: "false" }, shape(kind));
}

/** A state with shape and text; `update(kind, text)` draws only what differs. */
export class StateMark {
  constructor() {
    this.label = el("span");
    this.node = el("span", { class: "state" }, this.label);
  }

  update(kind, text) {
    if (this.kind !== kind) {
      this.kind = kind;
      this.picture?.remove();
      this.picture = mark(kind);
      this.node.prepend(this.picture);
      setAttr(this.node, "class", `state ${kind}`);
    }
    setText(this.label, text);
  }
}

/** A bar from -100 to 100 % with a mark at the set point. */
export class SpeedBar {
  constructor(name) {
    this.figure = el("span", { class: "figure" });
    this.bar = el("div", { class: "bar" }, el("i", { class: "zero" }), el("i", { class: "fill" }), el("i", { class: "wanted" }));
    this.node = el("div", { class: "speed" }, el("span", { class: "term", text: name }), this.bar, this.figure);
  }

  update(actual, wanted) {
    const at = (part) => `${50 + 50 * Math.max(-1.2, Math.min(1.2, part)) / 1.2}%`;
    const known = typeof actual === "number";
    const from = known ? Math.min(0, actual) : 0;
    const to = known ? Math.max(0, actual) : 0;
    setVar(this.bar, "--from", at(from));
    setVar(this.bar, "--width", `calc(${at(to)} - ${at(from)})`);
    setVar(this.bar, "--wanted", at(wanted ?? 0));
    setAttr(this.bar, "class", known ? "bar" : "bar unknown");
    setText(this.figure, percent(actual, 1));
  }
}

// State machines by family: where each state stands (column, row), and the arrows between them.
export const MACHINES = {
  profidrive: {
    columns: 4,
    at: { switch_on_inhibited: [0, 0], ready_to_switch_on: [1, 0], ready: [2, 0], running: [3, 0], fault: [0, 1], stopping: [2, 1] },
    arrows: [
      ["switch_on_inhibited", "ready_to_switch_on"], ["ready_to_switch_on", "ready"], ["ready", "running"],
      ["running", "ready"], ["ready", "ready_to_switch_on"], ["running", "stopping"], ["stopping", "ready_to_switch_on"],
      ["fault", "switch_on_inhibited"],
    ],
  },
  drivecom: {
    columns: 5,
    at: {
      not_ready: [0, 0], switch_on_inhibited: [1, 0], ready_to_switch_on: [2, 0], ready: [3, 0], running: [4, 0],
      fault_reaction: [0, 1], fault: [1, 1], quick_stop: [3, 1], stopping: [4, 1],
    },
    arrows: [
      ["not_ready", "switch_on_inhibited"], ["switch_on_inhibited", "ready_to_switch_on"], ["ready_to_switch_on", "ready"],
      ["ready", "ready_to_switch_on"], ["ready_to_switch_on", "switch_on_inhibited"], ["ready", "running"], ["running", "ready"],
      ["running", "stopping"], ["running", "quick_stop"], ["fault_reaction", "fault"], ["fault", "switch_on_inhibited"],
    ],
  },
  simple: {
    columns: 3,
    at: { not_ready: [0, 0], ready: [1, 0], running: [2, 0], fault: [0, 1], stopping: [2, 1] },
    arrows: [
      ["not_ready", "ready"], ["ready", "not_ready"], ["ready", "running"], ["running", "stopping"], ["stopping", "ready"],
      ["fault", "ready"],
    ],
  },
};

const FAMILY = {
  "demag-dedrive": "drivecom",
  "fuji-frenic": "profidrive",
  "ls-s100": "profidrive",
  "imo-hd2": "simple",
  "keb-f5": "simple",
};

export function familyOf(profile) {
  return FAMILY[profile] ?? "drivecom";
}

const WIDE = 80;
const HIGH = 44;
const BELOW = 40;
// of every machine, so that their texts have one size
const ALL = 448;

function box([column, row], columns) {
  const step = (ALL - 4 - WIDE) / (columns - 1);
  return { x: 2 + column * step, y: 2 + row * (HIGH + BELOW) };
}

function arrow(from, to, both, columns) {
  const [a, b] = [box(from, columns), box(to, columns)];
  const middle = (one) => one.x + WIDE / 2;
  if (a.y === b.y) {
    const [start, end] = a.x < b.x ? [a.x + WIDE, b.x] : [a.x, b.x + WIDE];
    const way = Math.sign(end - start) * 3;
    const y = a.y + HIGH / 2 + (both ? 6 * (a.x < b.x ? -1 : 1) : 0);
    return `M${start} ${y}H${end - way}`;
  }
  const down = a.y < b.y;
  const [y1, y2] = down ? [a.y + HIGH, b.y] : [a.y, b.y + HIGH];
  const turn = (y1 + y2) / 2;
  return `M${middle(a)} ${y1}V${turn}H${middle(b)}V${y2 + (down ? -3 : 3)}`;
}

function twoLines(text) {
  const parts = text.split(" ");
  if (parts.length === 1) return [text];
  let best = [text, ""];
  for (let n = 1; n < parts.length; n += 1) {
    const lines = [parts.slice(0, n).join(" "), parts.slice(n).join(" ")];
    if (Math.max(...lines.map((one) => one.length)) < Math.max(...best.map((one) => one.length))) best = lines;
  }
  return best;
}

let machines = 0;

/** The state machine of a drive, the present state marked. */
export class MachinePicture {
  constructor(profile) {
    const machine = MACHINES[familyOf(profile)];
    machines += 1;
    const tip = `tip-${machines}`;
    this.boxes = new Map();
    const pairsOf = new Set(machine.arrows.map(([from, to]) => `${from} ${to}`));
    const paths = machine.arrows.map(([from, to]) => svg("path", {
      class: "arrow", d: arrow(machine.at[from], machine.at[to], pairsOf.has(`${to} ${from}`), machine.columns), "marker-end": `url(#${tip})`,
    }));
    const nodes = Object.entries(machine.at).map(([state, place]) => {
      const { x, y } = box(place, machine.columns);
      const lines = twoLines(words(state));
      const middle = y + HIGH / 2 - (lines.length - 1) * 7.5;
      const node = svg("g", { class: "node" },
        svg("rect", { x, y, width: WIDE, height: HIGH, rx: 6 }),
        ...lines.map((line, n) => svg("text", { x: x + WIDE / 2, y: middle + n * 15, text: line })));
      this.boxes.set(state, node);
      return node;
    });
    this.title = svg("title");
    this.node = svg("svg", { class: "machine", viewBox: `0 0 ${ALL} ${2 * HIGH + BELOW + 4}`, role: "img" },
      this.title,
      svg("defs", {}, svg("marker", { id: tip, viewBox: "0 0 6 6", refX: 3, refY: 3, markerWidth: 6, markerHeight: 6, orient: "auto" },
        svg("path", { class: "tip", d: "M0 0 6 3 0 6z" }))),
      ...paths, ...nodes);
  }

  update(state) {
    if (this.state === state) return;
    this.state = state;
    for (const [name, node] of this.boxes) {
      const fault = name === "fault" || name === "fault_reaction";
      setAttr(node, "class", name === state ? `node now${fault ? " bad" : ""}` : "node");
    }
    setText(this.title, `State machine of the drive; present state: ${words(state ?? "unknown")}`);
  }
}
