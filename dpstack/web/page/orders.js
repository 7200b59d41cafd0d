// Orders to the bus: each is described in a dialog, and sent only after the user has confirmed it there.

import { el } from "./dom.js";
import { modeText } from "./format.js";

/** What an order will do, in sentences for its dialog. */
export function describe(live, command, args) {
  const count = live.slaves.size;
  const all = count === 1 ? "the slave" : `all ${count} slaves`;
  switch (command) {
    case "start":
      return {
        title: "Start the bus",
        lines: [
          "A master starts on this bus, and parameterises the slaves of the configuration.",
          "It starts in Clear: the slaves get safe values until you order Operate.",
        ],
        danger: true,
      };
    case "operate":
      return { title: "Operate", lines: [`The master sends the outputs of the application to ${all}.`, "Machines can move."], danger: true };
    case "clear":
      return { title: "Clear", lines: [`The master sends safe values to ${all} and goes on reading their inputs.`, "Drives stop."] };
    case "stop":
      return { title: "Stop", lines: [`The run ends in order: the master sends safe values and Clear to ${all}, then it leaves the bus.`, "Drives stop. This page shows old values until a run is there again."], danger: true };
    case "set":
      return { title: "Set named outputs", lines: args.map((one) => `Set ${one}.`), danger: true, mode: true };
    case "force":
      return { title: "Force inputs of a simulated slave", lines: [...args.map((one) => `Force ${one}.`), "The value stays until another one is forced, or the forced inputs are released. Programs react to it as to a real one."], danger: true };
    case "release":
      return { title: "Release forced inputs", lines: args.map((one) => `The simulated slave ${one} makes its inputs itself again.`) };
    case "outputs":
      return { title: "Set output octets", lines: args.map((one) => `All outputs of the slave: ${one}.`), danger: true, mode: true };
    case "drive": {
      const [name, order, ...rest] = args;
      return { title: `Drive ${name}: ${order.replaceAll("_", " ")}`, lines: [driveLine(name, order, rest)], danger: order === "start" || order === "speed" };
    }
    case "write": {
      const [name, slot, index, hex] = args;
      return { title: "Write a record", lines: [`Write ${hex.length / 2} octets (${hex}) to slot ${slot}, index ${index} of ${name}.`, "The slave can keep them after power-off."], danger: true };
    }
    case "pa": {
      const [name, parameter, value] = args;
      return { title: "Write a parameter", lines: [`${parameter} of the process device ${live.name?.(Number(name)) ?? name} becomes ${value}.`, "Its measured value, its limits or its behaviour change at once. The device keeps it after power-off.", ...(/\.(factory_reset|self_calib_cmd)$/i.test(parameter) ? ["A valve can move. A reset also loses the settings."] : [])], danger: true };
    }
    default:
      return { title: command, lines: [`${command} ${args.join(" ")}`] };
  }
}

function driveLine(name, order, rest) {
  switch (order) {
    case "start": return `The drive ${name} is switched on and the motor turns with the present set point.`;
    case "stop": return `The drive ${name} ramps down, then it is switched off.`;
    case "quick_stop": return `The drive ${name} stops by its quick stop ramp.`;
    case "coast": return `The drive ${name} is switched off at once, the motor runs out.`;
    case "acknowledge": return `The fault of ${name} is acknowledged.`;
    case "speed": return `The set point of ${name} becomes ${rest[0]} of the reference. A running motor follows at once.`;
    case "write": return `The parameter ${rest[0]} of ${name} becomes ${rest.slice(1).join(" ")}.`;
    default: return `${order} ${rest.join(" ")}`;
  }
}

/** A form that gives the order `command` ("set" an output, "force" an input) for a named value, at present or not. */
export function fieldForm(app, address, field, command, label = null) {
  const disabled = !app.orders.allowed;
  const id = `${command}-${address}-${field.name}`;
  const name = label ? null : `${command === "force" ? "Force" : "Set"} ${field.name} of ${app.live.name(address)}`;
  const input = field.type === "bool"
    ? el("select", { id, disabled, "data-key": id, "aria-label": name }, el("option", { value: "on", text: "on" }), el("option", { value: "off", text: "off" }))
    : el("input", { id, disabled, "data-key": id, size: label ? 10 : 7, autocomplete: "off", "aria-label": name });
  const give = (event) => {
    event.preventDefault();
    if (input.value.trim()) app.orders.give(command, [`${address}.${field.name}=${input.value.trim()}`]);
  };
  return el("form", { class: "inline", on: { submit: give } },
    label ? el("label", { for: id }, el("bdi", { text: label }), field.unit ? ` (${field.unit})` : "") : null, input,
    el("button", { disabled, "data-key": `${id}-give`, text: command === "force" ? "Force …" : "Set …" }));
}

export class Orders {
  constructor(app) {
    this.app = app;
    this.dialog = document.getElementById("confirm");
  }

  /** Whether this page may give orders at all: there are buttons for them. */
  get shown() {
    return this.app.welcome?.control === true && this.app.welcome.source !== "replay";
  }

  /** Whether an order can be given now: never while the page shows old values. */
  get allowed() {
    return this.shown && !this.app.dead;
  }

  /** Whether outputs of a slave can be set by their names: a drive's are made by its profile. */
  sets(address) {
    return this.shown && !this.app.live.plant?.read_only && !this.app.live.about(address).drive;
  }

  /** Whether inputs of a slave can be forced: the run itself simulates it, and it is no drive. */
  forces(address) {
    return this.sets(address) && this.app.live.plant?.virtual === true;
  }

  /** Without a run there is one order: to start one. */
  get canStart() {
    return this.shown && this.app.welcome.source === "none" && this.app.link.welcomed;
  }

  may(command) {
    return command === "start" ? this.canStart : this.allowed;
  }

  /** Show the dialog; the order is sent when the user confirms. Resolves to the result, or null when it is not sent. */
  async give(command, args = []) {
    if (!this.may(command)) return null;
    const { live, welcome } = this.app;
    const about = describe(live, command, args);
    if (!(await this.confirmed(about, live, welcome))) return null;
    if (!this.may(command)) {
      this.app.say("The order was not sent: the page shows old values.", "bad");
      return null;
    }
    try {
      const result = await this.app.link.order(command, args);
      this.app.say(`${about.title}: done.`, "good");
      return result ?? {};
    } catch (error) {
      this.app.say(`${about.title}: ${error.message}`, "bad");
      return null;
    }
  }

  confirmed(about, live, welcome) {
    const { dialog } = this;
    return new Promise((resolve) => {
      const cancel = el("button", { type: "button", text: "Cancel", on: { click: () => dialog.close("no") } });
      const confirm = el("button", {
        type: "button", id: "confirm-yes", class: about.danger ? "danger" : "primary", text: `Yes: ${about.title}`,
        on: { click: () => dialog.close("yes") },
      });
      const mode = about.mode ? el("p", { class: "faint", text: `Mode of the master now: ${modeText(live.bus.mode)}.` }) : null;
      dialog.replaceChildren(
        el("h2", { id: "confirm-title", text: about.title }),
        ...about.lines.map((text) => el("p", { text })), ...(mode ? [mode] : []),
        el("p", { class: "faint", text: `The server logs this order with the time${welcome?.name ? ` and the name ${welcome.name}` : ""}.` }),
        el("div", { class: "buttons" }, cancel, confirm));
      dialog.returnValue = "no";
      dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
      dialog.showModal();
      cancel.focus();
    });
  }
}
