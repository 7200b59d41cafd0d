// A process device of PROFIBUS PA: identity, diagnosis and blocks, read when somebody asks for them.

import { cell, el, pairs, table } from "./dom.js";
import { clock } from "./format.js";
import { mark } from "./marks.js";

const KINDS = { bad: "bad", uncertain: "warn", stale: "warn" };
const ACCESS = { r: "read only", rm: "MAN and O/S only" };
// What the head shows already.
const IN_HEAD = new Set(["software_revision", "hardware_revision", "device_man_id", "device_id", "device_ser_num", "diagnosis",
  "diagnosis_extension", "descriptor", "device_message", "device_instal_date", "write_locking", "ident_number_selector", "hw_write_protection"]);

/** The answer to the ask `pa` of a slave. */
export function deviceView(found) {
  const { identity = {}, diagnosis = {}, parameters = [], remarks = [] } = found;
  const revisions = [["software", identity.software], ["hardware", identity.hardware]].filter(([, text]) => text).map((one) => one.join(" "));
  return [
    el("p", { class: "faint", text: `Read ${clock(Date.now() / 1000)}.` }),
    el("div", { class: "columns" },
      el("div", { class: "side" }, pairs([
        ["Maker", identity.maker], ["Device", identity.device], ["Serial number", identity.serial], ["Revisions", revisions.join(", ")],
        ["Tag", identity.tag], ["Descriptor", identity.descriptor], ["Message", identity.message], ["Installed", identity.installed],
        ["Profile", identity.profile], ["Ident number", identity.ident_selector], ["Write protection", found.write_protection],
      ])),
      el("div", { class: "side" }, ...diagnosisView(diagnosis))),
    ...remarks.map((text) => el("p", { class: "warn" }, mark("warn"), text)),
    ...parameters.map(blockView),
  ];
}

function diagnosisView(diagnosis) {
  const texts = [...(diagnosis.texts ?? []), ...(diagnosis.extension_texts ?? [])];
  const kind = !diagnosis.category ? "good" : diagnosis.category === "failure" ? "bad" : "warn";
  const title = diagnosis.category ? `Diagnosis: ${diagnosis.category}` : "Diagnosis: nothing is wrong";
  return [
    el("p", { class: kind }, mark(kind), title),
    el("ul", { class: "plain" }, ...texts.map((text) => el("li", { text }))),
  ];
}

function blockView(block) {
  const name = (one) => one.name.slice(block.name.length + 1);
  const tag = (block.tag ?? "").trim();
  const row = (what, value) => el("tr", {}, cell(what), value);
  const rows = [
    modeText(block) ? row("mode", cell(modeText(block))) : null,
    block.alarms ? row("alarms", el("td", { class: block.alarms === "none" ? null : "warn" }, block.alarms)) : null,
    ...(block.values ?? []).filter((one) => !IN_HEAD.has(name(one))).map((one) => row(name(one), valueCell(one))),
  ];
  const title = `${block.name}: ${block.kind}${tag ? `, tag ${tag}` : ""}, slot ${block.slot} index ${block.index}`;
  return table(title, [["Parameter"], ["Value"]], rows.filter(Boolean), "of-block");
}

function modeText({ mode = "", target_mode: target = "" }) {
  return target && !mode.startsWith(`${target} `) ? `${mode}; wanted ${target}` : mode;
}

function valueCell(one) {
  if (one.unreadable !== undefined) return cell(`cannot be read: ${one.unreadable}`, "faint");
  const kind = KINDS[one.quality];
  return el("td", { class: kind }, kind ? mark(kind) : null, one.text ?? "");
}

/** Parameters, the answer to the ask `pa` of a slave and a name. */
export function parametersView(found) {
  const rows = found.parameters ?? [];
  return [table(`${found.name}, read ${clock(Date.now() / 1000)}`, [["Parameter"], ["Value"], ["Type"], ["Slot, index"], [""]],
    rows.map((one) => el("tr", {}, cell(one.name), valueCell(one), cell(one.type), cell(`${one.slot}, ${one.index}`), cell(ACCESS[one.access] ?? ""))))];
}
