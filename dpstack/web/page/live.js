// The state of the plant as the stream of snapshots and events tells it.

const EVENTS_KEPT = 2000;
// Places of one slave in a snapshot that become events of their own; the others are counted in one.
const PLACES_SHOWN = 8;
// Changes of the places of one slave that a minute of the stream lists: one that flaps must not drive out all other events.
const CHANGES_A_MINUTE = 40;
const SEVERITIES = { bad: "error", uncertain: "warning" };

/** `plant`, `bus`, `slaves` (Map by address) merged from the items; `events` oldest first. */
export class Live {
  constructor() {
    this.plant = null;
    this.bus = {};
    this.slaves = new Map();
    this.events = [];
    this.numbered = 0;
    this.lost = 0;
    this.end = null;
    this.t = null;
    this.whole = false;
    this.listed = new Map(); // by address: the minute, and the changes listed in it
    this.noted = []; // events that the page made of the last snapshot
    this.version = 0; // grows with each plant: pages build anew
    this.snapshots = 0;
  }

  /** Returns the kind of item: "plant", "snapshot", "event", "lost", "end"; null for anything else. */
  apply(item) {
    if (item.plant) {
      // a large plant comes in several items: all but the first have `whole` false, all but the last `more`
      const known = item.plant.whole === false ? this.plant : null;
      if (!known && this.plant?.started !== item.plant.started) { // another run
        this.slaves.clear();
        this.listed.clear();
      }
      this.plant = { ...(known ?? item.plant), slaves: { ...known?.slaves, ...item.plant.slaves } };
      if (item.plant.more) return null;
      const there = new Set(Object.keys(this.plant.slaves).map(Number));
      for (const address of this.slaves.keys()) if (!there.has(address)) this.slaves.delete(address);
      for (const address of there) if (!this.slaves.has(address)) this.slaves.set(address, {});
      this.end = null;
      this.version += 1;
      return "plant";
    }
    if (item.snapshot) {
      const { t, whole, bus, slaves } = item.snapshot;
      const doubts = new Map([...this.slaves].map(([address, slave]) => [address, slave.doubts]));
      this.noted = [];
      if (whole) {
        this.bus = {};
        for (const address of this.slaves.keys()) this.slaves.set(address, {});
      }
      this.t = t;
      this.whole = true;
      this.snapshots += 1;
      Object.assign(this.bus, bus);
      for (const [address, change] of Object.entries(slaves ?? {})) {
        const slave = this.slaves.get(Number(address));
        if (!slave) continue;
        Object.assign(slave, change);
        if ("doubts" in change) this.compare(Number(address), doubts.get(Number(address)) ?? [], change.doubts ?? []);
      }
      return "snapshot";
    }
    if (item.event) {
      this.keep(item.event);
      return "event";
    }
    if (item.lost) {
      this.lost += item.lost;
      return "lost";
    }
    if (item.end) {
      this.end = item.end;
      return "end";
    }
    return null;
  }

  /** Keep an event, in the order of time. */
  keep(given) {
    this.numbered += 1;
    const event = { severity: "info", ...given, number: this.numbered };
    const t = this.eventT(event);
    let at = this.events.length;
    while (at > 0 && this.eventT(this.events[at - 1]) > t) at -= 1;
    this.events.splice(at, 0, event);
    if (this.events.length > EVENTS_KEPT * 1.1) this.events.splice(0, this.events.length - EVENTS_KEPT);
    return event;
  }

  /** Note which places of a slave have a diagnosis now and had none before, and the other way round. */
  compare(address, before, now) {
    const key = (one) => [one.slot, one.channel, one.direction, one.reason, one.text].join("|");
    const [old, present] = [before, now].map((all) => new Map(all.map((one) => [key(one), one])));
    const changes = [
      ...[...present].filter(([one]) => !old.has(one)).map(([, one]) => ["appears", one]),
      // nothing is known of those of a slave that has left data exchange
      ...(this.slaves.get(address)?.state === "data_exchange" ? [...old] : [])
        .filter(([one]) => !present.has(one)).map(([, one]) => ["disappears", one]),
    ];
    if (!changes.length) return;
    const minute = Math.floor(this.t / 60);
    const listed = this.listed.get(address)?.minute === minute ? this.listed.get(address) : { minute, count: 0 };
    this.listed.set(address, listed);
    const known = listed.count;
    listed.count += changes.length;
    const note = (change, severity, text, since) => {
      const t = change === "appears" && typeof since === "number" ? since : this.t;
      this.noted.push(this.keep({ event: "place", change, severity, t, address, text: `${text} (${this.name(address)})` }));
    };
    if (known >= CHANGES_A_MINUTE) return;
    if (known && listed.count >= CHANGES_A_MINUTE) {
      note(null, "warning", "its diagnoses come and go; further changes of this minute are not listed");
      return;
    }
    for (const [change, one] of changes.slice(0, PLACES_SHOWN)) {
      note(change, change === "appears" ? SEVERITIES[one.quality] ?? "info" : "info", one.text, one.since);
    }
    for (const change of ["appears", "disappears"]) {
      const more = changes.slice(PLACES_SHOWN).filter(([one]) => one === change);
      if (more.length) note(change, "info", `${more.length} more diagnoses`, more[0][1].since);
    }
  }

  /** Addresses in ascending order. */
  get addresses() {
    return [...this.slaves.keys()].sort((a, b) => a - b);
  }

  about(address) {
    return this.plant?.slaves?.[address] ?? {};
  }

  name(address) {
    return this.about(address).name ?? `slave ${address}`;
  }

  /** Wall clock in seconds since 1970 of `t` seconds since the start. */
  wall(t) {
    return (this.plant?.started ?? 0) + t;
  }

  /** Seconds since the start of the bus; an event of the server itself has only its wall clock. */
  eventT(event) {
    return typeof event.t === "number" ? event.t : this.eventWall(event) - (this.plant?.started ?? 0);
  }

  /** Wall clock of an event in seconds since 1970. */
  eventWall(event) {
    const ms = Date.parse(event.time ?? "");
    return Number.isNaN(ms) ? this.wall(event.t ?? 0) : ms / 1000;
  }
}
