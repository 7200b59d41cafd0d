// Elements of the page. Every text goes through textContent, never through markup.

const SVG = "http://www.w3.org/2000/svg";

// Control characters, and those that turn the direction of a text around: a device may send any of them.
const UNPRINTABLE = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u200b\u200e\u200f\u202a-\u202e\u2060-\u2069\ufeff\ud800-\udfff]/gu;

/** The text with unprintable characters as \uXXXX. */
export function clean(value) {
  const text = typeof value === "string" ? value : String(value);
  return text.replace(UNPRINTABLE, (one) => `\\u${one.codePointAt(0).toString(16).padStart(4, "0")}`);
}

function fill(node, properties, children) {
  for (const [name, value] of Object.entries(properties ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "text") node.textContent = clean(value);
    else if (name === "on") for (const [event, act] of Object.entries(value)) node.addEventListener(event, act);
    else if (name === "vars") for (const [key, one] of Object.entries(value)) node.style.setProperty(key, one);
    else if (name === "value") node.value = value;
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  for (const child of children.flat()) {
    if (child === null || child === undefined || child === false) continue;
    node.append(child instanceof Node ? child : document.createTextNode(clean(child)));
  }
  return node;
}

/** An HTML element; `text`, `on` (listeners), `vars` (CSS properties), `value`; all others are attributes. */
export function el(tag, properties, ...children) {
  return fill(document.createElement(tag), properties, children);
}

/** An SVG element. */
export function svg(tag, properties, ...children) {
  return fill(document.createElementNS(SVG, tag), properties, children);
}

/** Set the text of a node where it differs. Returns whether it did. */
export function setText(node, value) {
  const text = clean(value);
  if (node.textContent === text) return false;
  node.textContent = text;
  return true;
}

/** Set or remove an attribute where it differs; null and false remove it. */
export function setAttr(node, name, value) {
  if (value === null || value === undefined || value === false) {
    if (node.hasAttribute(name)) node.removeAttribute(name);
    return;
  }
  const text = value === true ? "" : String(value);
  if (node.getAttribute(name) !== text) node.setAttribute(name, text);
}

export function setClass(node, value) {
  setAttr(node, "class", value || null);
}

export function setVar(node, name, value) {
  if (node.style.getPropertyValue(name) !== value) node.style.setProperty(name, value);
}

/** Replace the children of a node only when `key` has changed since the last call. */
export function refill(node, key, make) {
  const text = typeof key === "string" ? key : JSON.stringify(key);
  if (node.filledWith === text) return false;
  node.filledWith = text;
  const had = node.contains(document.activeElement) ? document.activeElement?.dataset?.key : null;
  node.replaceChildren(...[make()].flat().filter(Boolean));
  if (had) [...node.querySelectorAll("[data-key]")].find((one) => one.dataset.key === had)?.focus();
  return true;
}

/** A description list of [term, value] pairs; a value is a text or a node, null is left out. */
export function pairs(list, className = "pairs") {
  const rows = list.filter(([, value]) => value !== null && value !== undefined && value !== "");
  return el("dl", { class: className }, ...rows.map(([term, value]) =>
    el("div", {}, el("dt", { text: term }), el("dd", {}, value))));
}

/** A table in a region that scrolls within itself; `columns`: [heading, class]. */
export function table(caption, columns, rows, className = "") {
  return el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    el("table", { class: className },
      el("caption", { text: caption }),
      el("thead", {}, el("tr", {}, ...columns.map(([text, kind]) => el("th", { scope: "col", class: kind, text })))),
      el("tbody", {}, ...rows)));
}

export function cell(value, kind = null) {
  return el("td", { class: kind }, value);
}

/** Save a text as a file. */
export function download(name, text, type) {
  const url = URL.createObjectURL(new Blob([text], { type }));
  const link = el("a", { href: url, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}
