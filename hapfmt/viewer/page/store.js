// What the page shows: one object, and those who want to know of changes.
export class Store {
  #listeners = [];

  constructor(values) {
    Object.assign(this, values);
  }

  // action(changed: Set of keys) runs after each change of one of `keys`.
  on(keys, action) {
    this.#listeners.push({ keys, action });
  }

  set(values) {
    const changed = new Set(Object.keys(values).filter((key) => this[key] !== values[key]));
    if (!changed.size) return;
    Object.assign(this, values);
    this.tell(changed);
  }

  // For what changed inside: lists that grew, signals that came.
  tell(changed) {
    for (const { keys, action } of this.#listeners) if (keys.some((key) => changed.has(key))) action(changed);
  }
}
