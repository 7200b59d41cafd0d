// The state of the plant as the stream of snapshots and events tells it.

const EVENTS_KEPT = 2000;

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
    this.version = 0; // grows with each plant: pages build anew
    this.snapshots = 0;
  }

  /** Returns the kind of item: "plant", "snapshot", "event", "lost", "end"; null for anything else. */
  apply(item) {
    if (item.plant) {
      // a large plant comes in several items: all but the first have `whole` false, all but the last `more`
      const known = item.plant.whole === false ? this.plant : null;
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
        if (slave) Object.assign(slave, change);
      }
      return "snapshot";
    }
    if (item.event) {
      this.numbered += 1;
      this.events.push({ severity: "info", ...item.event, number: this.numbered });
      if (this.events.length > EVENTS_KEPT * 1.1) this.events.splice(0, this.events.length - EVENTS_KEPT);
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
