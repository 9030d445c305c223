// One computation at a time; a newer one drops it. It begins once nothing was asked for a moment.

const REST_MS = 200;

export class Work {
  // run(signal, ...args): the computation; ended(error or undefined): it was not dropped.
  constructor(run, ended) {
    Object.assign(this, { run, ended, key: null, control: null, timer: null });
  }

  get busy() {
    return this.control !== null;
  }

  // Nothing is done where the key is that of the last call.
  ask(key, ...args) {
    if (key === this.key) return;
    this.stop();
    this.key = key;
    const control = new AbortController();
    this.control = control;
    this.timer = setTimeout(() => this.start(control, args), REST_MS);
  }

  async start(control, args) {
    const error = await this.run(control.signal, ...args).then(() => undefined, (reason) => reason);
    if (control.signal.aborted) return;
    this.control = null;
    this.ended(error);
  }

  stop() {
    clearTimeout(this.timer);
    this.control?.abort();
    this.control = null;
  }
}
