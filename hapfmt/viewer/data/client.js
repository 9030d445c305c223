// A recording as the page sees it; a Worker reads and decodes it.

class RecordingError extends Error {
  constructor({ name, message, requirement, offset, kind, size }) {
    super(message);
    this.name = name === 'AbortError' ? name : 'HapfError';
    Object.assign(this, { requirement, offset, kind, size });
  }
}

// The page has the code of worker.js as a text.
let address = null;

function newWorker() {
  address ??= URL.createObjectURL(new Blob([globalThis.hapfWorkerCode], { type: 'text/javascript' }));
  return new Worker(address);
}

// source: { name, url } | { name, blob } | { name, bytes }; worker: gives a new Worker that runs worker.js;
// onChange(what, facts): 'overview', 'damage' or 'progress' when something progressed, 'error' when the work in the
// background ended.
export async function openRecording(source, { worker = newWorker, onChange = () => {}, signal } = {}) {
  const { name, url, blob, bytes } = source;
  const link = new Link(worker());
  // The Worker has no address of its own that a relative one could refer to.
  const whole = url && globalThis.document ? new URL(url, document.baseURI).href : url;
  try {
    link.onChange = (what, news) => onChange(what, news);
    const place = { url: whole, blob, bytes };
    const facts = await link.call('open', [place], { signal });
    return new Recording(name, facts, link, onChange, { place, worker });
  } catch (error) {
    link.close();
    throw error;
  }
}

class Link {
  constructor(worker) {
    this.worker = worker;
    this.waiting = new Map();
    this.next = 1;
    this.onChange = () => {};
    worker.onmessage = ({ data }) => this.take(data);
    worker.onerror = (event) => this.fail(event.message ?? 'the worker stopped');
  }

  call(call, args, { signal, onProgress } = {}) {
    if (!this.worker) return Promise.reject(new RecordingError({ message: 'the recording is closed', kind: 'closed' }));
    const id = this.next++;
    return new Promise((resolve, reject) => {
      const drop = () => {
        this.waiting.delete(id);
        this.worker?.postMessage({ cancel: id });
        reject(new RecordingError({ name: 'AbortError', message: 'the request was dropped', kind: 'aborted' }));
      };
      if (signal?.aborted) {
        drop();
        return;
      }
      signal?.addEventListener('abort', drop, { once: true });
      const settle = (action) => (value) => {
        signal?.removeEventListener('abort', drop);
        action(value);
      };
      this.waiting.set(id, { resolve: settle(resolve), reject: settle(reject), onProgress });
      this.worker.postMessage({ id, call, args });
    });
  }

  take({ id, value, error, progress, what, facts }) {
    if (what !== undefined) {
      this.onChange(what, facts);
      return;
    }
    const entry = this.waiting.get(id);
    if (!entry) return;
    if (progress) {
      entry.onProgress?.(...progress);
      return;
    }
    this.waiting.delete(id);
    if (error) entry.reject(new RecordingError(error));
    else entry.resolve(value);
  }

  fail(message) {
    for (const { reject } of this.waiting.values()) reject(new RecordingError({ message, kind: 'internal' }));
    this.waiting.clear();
  }

  close() {
    this.worker?.postMessage({ call: 'close' });
    this.worker?.terminate();
    this.worker = null;
    this.fail('the recording is closed');
  }
}

class Recording {
  constructor(name, facts, link, onChange, origin) {
    this.name = name;
    Object.assign(this, facts);
    this.origin = origin;
    this.link = link;
    link.onChange = (what, news = {}) => {
      if (news.facts) Object.assign(this, news.facts);
      if (news.verdict) this.verdict = news.verdict;
      onChange(what, news);
    };
  }

  // The times of events that hold within [t0, t1), in seconds.
  events(t0, t1, options) {
    return this.link.call('events', [t0, t1], options);
  }

  damage(options) {
    return this.link.call('damage', [], options);
  }

  // A full check, in a Worker of its own. onProgress(done, of).
  async verify(onProgress, { signal } = {}) {
    const { place, worker } = this.origin;
    const link = new Link(worker());
    try {
      const report = await link.call('check', [place], { signal, onProgress });
      await this.link.call('learn', [report]);
      return report;
    } finally {
      link.close();
    }
  }

  envelope(channelIndexes, t0, t1, bins, band = 'sum', options = {}) {
    return this.link.call('envelope', [channelIndexes, t0, t1, bins, band], options);
  }

  samples(index, t0, t1, band = 'sum', options = {}) {
    return this.link.call('samples', [index, t0, t1, band], options);
  }

  knots(index, t0, t1, options) {
    return this.link.call('knots', [index, t0, t1], options);
  }

  bytes(start, stop, options) {
    return this.link.call('bytes', [start, stop], options);
  }

  // The packets of channels that overlap [t0, t1), as a file: { bytes, packets, start, stop, channels, notes }. Without times: all.
  // asked: { channels: [index], t0, t1, name }. In a Worker of its own, which reads the whole file. onProgress(done, of): bytes.
  async subset(asked, { signal, onProgress } = {}) {
    const { place, worker } = this.origin;
    const link = new Link(worker());
    try {
      return await link.call('subset', [place, asked], { signal, onProgress });
    } finally {
      link.close();
    }
  }

  stats(options) {
    return this.link.call('stats', [], options);
  }

  close() {
    this.link.close();
  }
}
