// The values that were used last, up to a bound on the sum of their weights.

export class Lru {
  constructor(bound) {
    this.bound = bound;
    this.weight = 0;
    this.entries = new Map();
  }

  get(key) {
    const entry = this.entries.get(key);
    if (!entry) return undefined;
    this.entries.delete(key);
    this.entries.set(key, entry);
    return entry.value;
  }

  // What is heavier than the bound by itself is not kept.
  set(key, value, weight) {
    this.delete(key);
    if (weight > this.bound) return;
    this.entries.set(key, { value, weight });
    this.weight += weight;
    for (const oldest of this.entries.keys()) {
      if (this.weight <= this.bound) break;
      this.delete(oldest);
    }
  }

  delete(key) {
    const entry = this.entries.get(key);
    if (!entry) return;
    this.weight -= entry.weight;
    this.entries.delete(key);
  }

  clear() {
    this.entries.clear();
    this.weight = 0;
  }
}
