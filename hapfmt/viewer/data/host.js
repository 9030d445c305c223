// Answers messages with what a session gives: within a Worker, or in the thread of the page.
import { Session } from './session.js';

const METHODS = new Set(['samples', 'envelope', 'events', 'damage', 'verify', 'knots', 'bytes', 'stats']);
const TAKES_PROGRESS = new Set(['verify']);

const errorOf = ({ name, message, requirement = null, offset = null, kind = 'internal' }) => ({ name, message, requirement, offset, kind });

export class Host {
  // post(message, buffers): to the page.
  constructor(post) {
    this.post = post;
    this.session = null;
    this.running = new Map();
  }

  async take({ id, call, args, cancel }) {
    if (cancel !== undefined) {
      this.running.get(cancel)?.abort();
      return;
    }
    if (call === 'close') {
      this.session?.close();
      return;
    }
    const control = new AbortController();
    this.running.set(id, control);
    try {
      const value = await this.answer(id, call, args, control.signal);
      this.post({ id, value }, [...new Set(buffersOf(value))]);
    } catch (error) {
      this.post({ id, error: errorOf(error) }, []);
    } finally {
      this.running.delete(id);
    }
  }

  async answer(id, call, args, signal) {
    if (call === 'open') {
      this.session = await Session.open(args[0], (what, facts) => this.post({ what, facts }, []));
      return this.session.facts;
    }
    if (!this.session || !METHODS.has(call)) throw new TypeError(`no method ${call}`);
    if (TAKES_PROGRESS.has(call)) {
      return this.session[call]((done, size) => this.post({ id, progress: [done, size] }, []), { signal });
    }
    return this.session[call](...args, { signal });
  }
}

// The buffers of an answer. No two answers share one.
function* buffersOf(value) {
  if (ArrayBuffer.isView(value)) yield value.buffer;
  else if (value && typeof value === 'object') for (const one of Object.values(value)) yield* buffersOf(one);
}
