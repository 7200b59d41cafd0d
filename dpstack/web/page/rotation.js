// Rotation times over time: the counts of each second, from the counts since the start that the snapshots have.

const KEPT = 3600;
const INTERVAL_S = 1;

/** What was added between two histograms [[upper_us, count], ...]; their classes may differ. */
export function added(before, after) {
  const uppers = after.map(([upper]) => upper);
  const old = new Map();
  for (const [upper, count] of before) {
    const into = uppers.find((one) => one >= upper - 1e-6) ?? uppers.at(-1);
    old.set(into, (old.get(into) ?? 0) + count);
  }
  return after.map(([upper, count]) => [upper, Math.max(0, count - (old.get(upper) ?? 0))]).filter(([, count]) => count > 0);
}

/** The upper limit of the class in which a part of all rotations lies. */
export function quantile(classes, part) {
  const all = classes.reduce((sum, [, count]) => sum + count, 0);
  let seen = 0;
  for (const [upper, count] of classes) {
    seen += count;
    if (seen >= part * all) return upper;
  }
  return null;
}

/** `columns`: {t, classes, p50, p99, max} of each interval, oldest first. */
export class RotationHistory {
  constructor() {
    this.clear();
  }

  clear() {
    this.columns = [];
    this.before = null;
    this.at = null;
  }

  sample(t, histogram) {
    if (!Array.isArray(histogram) || typeof t !== "number") return;
    if (this.before === null || t < this.at) {
      if (t < this.at) this.columns = [];
      this.before = histogram;
      this.at = t;
      return;
    }
    if (t - this.at < INTERVAL_S) return;
    const classes = added(this.before, histogram);
    this.before = histogram;
    this.at = t;
    const max = classes.length ? classes.at(-1)[0] : null;
    this.columns.push({ t, classes, p50: quantile(classes, 0.5), p99: quantile(classes, 0.99), max });
    if (this.columns.length > KEPT * 1.1) this.columns.splice(0, this.columns.length - KEPT);
  }
}
