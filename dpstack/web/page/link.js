// The WebSocket to the server: greeting, items, asks and orders, and a new connection after a loss.

const WAITS_MS = [500, 1000, 2000, 4000];

/** `on` has listeners: item(item), welcome(welcome), refused(text), state("connecting" | "open" | "lost"). */
export class Link {
  constructor(url, on) {
    this.url = url;
    this.on = on;
    this.token = null;
    this.tries = 0;
    this.numbers = 0;
    this.waiting = new Map();
    this.socket = null;
    this.welcomed = false;
    this.timer = null;
    this.state = "connecting";
  }

  /** `token` stays in this object's memory only. */
  open(token = this.token) {
    this.token = token;
    clearTimeout(this.timer);
    this.socket?.close();
    this.drop();
    const socket = new WebSocket(this.url);
    this.socket = socket;
    this.told("connecting");
    socket.addEventListener("open", () => socket.send(JSON.stringify({ hello: { token: this.token } })));
    socket.addEventListener("message", (message) => this.socket === socket && this.received(message.data));
    socket.addEventListener("close", () => this.socket === socket && this.closed());
  }

  told(state) {
    this.state = state;
    this.on.state(state);
  }

  received(text) {
    let item;
    try {
      item = JSON.parse(text);
    } catch {
      return;
    }
    if (item.answer) {
      const waiting = this.waiting.get(item.answer.id);
      this.waiting.delete(item.answer.id);
      if (!waiting) return;
      if (item.answer.ok) waiting.done(item.answer.result);
      else waiting.failed(new Error(item.answer.error || "the server refused without a reason"));
    } else if (item.welcome) {
      this.tries = 0;
      this.welcomed = true;
      this.told("open");
      this.on.welcome(item.welcome);
    } else if (item.refused !== undefined) {
      this.refused = true;
      this.on.refused(item.refused);
    } else {
      this.on.item(item);
    }
  }

  /** Nothing that was asked over the old connection will be answered. */
  drop() {
    this.welcomed = false;
    for (const waiting of this.waiting.values()) waiting.failed(new Error("the connection was lost before the answer"));
    this.waiting.clear();
  }

  closed() {
    this.drop();
    this.told("lost");
    if (this.refused) {
      this.refused = false; // only a new token helps
      return;
    }
    const wait = WAITS_MS[Math.min(this.tries, WAITS_MS.length - 1)];
    this.tries += 1;
    this.timer = setTimeout(() => this.open(), wait);
  }

  send(kind, fields) {
    if (!this.welcomed) return Promise.reject(new Error("no connection to the server"));
    this.numbers += 1;
    const id = this.numbers;
    const answer = new Promise((done, failed) => this.waiting.set(id, { done, failed }));
    this.socket.send(JSON.stringify({ [kind]: { id, ...fields } }));
    return answer;
  }

  /** Ask for something that changes nothing. The promise fails with the server's text. */
  ask(what, ...args) {
    return this.send("ask", { what, args });
  }

  /** An order. Only orders.js calls this, after the user has confirmed. */
  order(command, args) {
    return this.send("order", { command, args, confirmed: true });
  }
}
