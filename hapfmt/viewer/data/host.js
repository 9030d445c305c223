// Answers messages with what a session gives: within a Worker, or in the thread of the page.
import { checkFile } from './check.js';
import { Session } from './session.js';
import { copyPart } from './subset.js';

const METHODS = new Set(['samples', 'envelope', 'events', 'damage', 'learn', 'knots', 'bytes', 'stats']);
const TELL_MS = 120; // between two messages of a kind

const errorOf = ({ name, message, requirement = null, offset = null, kind = 'internal', size = null }) => ({ name, message, requirement, offset, kind, size });

export class Host {
  // post(message, buffers): to the page.
  constructor(post) {
    this.post = post;
    this.session = null;
    this.running = new Map();
    this.news = new Map(); // what -> the facts since its last message
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

  // A few messages of a kind a second, and in any case one with the last facts.
  tell(what, facts) {
    const news = this.news.get(what);
    if (news) {
      Object.assign(news, facts);
      return;
    }
    this.post({ what, facts }, []);
    this.news.set(what, {});
    setTimeout(() => {
      const later = this.news.get(what);
      this.news.delete(what);
      if (Object.keys(later).length && !this.session?.closed) this.tell(what, later);
    }, TELL_MS);
  }

  async answer(id, call, args, signal) {
    if (call === 'open') {
      this.session = await Session.open(args[0], (what, facts) => this.tell(what, facts));
      return this.session.facts;
    }
    const onProgress = (done, of) => this.post({ id, progress: [done, of] }, []);
    if (call === 'check') return checkFile(args[0], onProgress);
    if (call === 'subset') return copyPart(...args, onProgress);
    if (!this.session || !METHODS.has(call)) throw new TypeError(`no method ${call}`);
    return this.session[call](...args, { signal });
  }
}

// The buffers of an answer. No two answers share one.
function* buffersOf(value) {
  if (ArrayBuffer.isView(value)) yield value.buffer;
  else if (value && typeof value === 'object') for (const one of Object.values(value)) yield* buffersOf(one);
}
