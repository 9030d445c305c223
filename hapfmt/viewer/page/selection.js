// The selected span of time, on the common time line, and who wants to know of it.
export class Selection {
  #listeners = [];

  constructor() {
    this.range = null; // [t0, t1] seconds
  }

  onChange(action) {
    this.#listeners.push(action);
  }

  set(a, b) {
    this.#change([Math.min(a, b), Math.max(a, b)]);
  }

  clear() {
    this.#change(null);
  }

  #change(range) {
    const same = range === this.range || (range && this.range && range[0] === this.range[0] && range[1] === this.range[1]);
    if (same) return;
    this.range = range;
    for (const action of this.#listeners) action(range);
  }

  // The range on the time line of one recording, cut to what it has; null: nothing of it is selected.
  within(entry) {
    if (!this.range) return null;
    const start = Math.max(entry.recording.start, this.range[0] - entry.offset);
    const stop = Math.min(entry.recording.stop, this.range[1] - entry.offset);
    return start < stop ? [start, stop] : null;
  }
}
