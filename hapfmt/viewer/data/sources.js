// The bytes of a file at an offset: in memory, of a Blob, or behind a URL (HTTP Range).
import { HapfError } from '../decoder/error.js';
import { Lru } from './lru.js';

const BLOCK = 2 ** 15;
const TAIL = 2 ** 16; // the first request: the end of the file, where its index is
const RUN = 2 ** 22; // bytes of the largest request
const AT_ONCE = 4; // requests
const CACHE = 2 ** 25;
export const WHOLE_BOUND = 2 ** 30; // bytes of a file that is read as a whole

export const failed = (message) => new HapfError('io', null, message);
const changed = () => failed('the file changed while it was read; load the page again');
const odd = (status) => failed(status === 410 ? 'something else has replaced the file; start hapfmt view again' : `the server answers a range with status ${status}`);

export function aborted() {
  const error = new Error('the request was dropped');
  error.name = 'AbortError';
  return error;
}

// source: { name, url } | { name, blob } | { name, bytes }.
export async function openSource({ url, blob, bytes }) {
  if (bytes) return new Memory(bytes);
  if (blob) return new Blocks(new BlobParts(blob), blob.size);
  const parts = new UrlParts(url);
  const { tail, size, whole } = await parts.open();
  if (whole) return new Memory(whole, parts);
  const blocks = new Blocks(parts, size);
  blocks.keep(size - tail.length, tail);
  return blocks;
}

class Memory {
  constructor(bytes, parts = null) {
    this.bytes = bytes;
    this.size = bytes.length;
    this.parts = parts;
  }

  get requests() {
    return this.parts ? this.parts.requests : 0;
  }

  get fetched() {
    return this.parts ? this.parts.fetched : 0;
  }

  async read(start, stop) {
    return this.bytes.subarray(start, stop);
  }

  async readAll(ranges) {
    return ranges.map(([start, stop]) => this.bytes.subarray(start, stop));
  }
}

class BlobParts {
  constructor(blob) {
    this.blob = blob;
    this.requests = 0;
    this.fetched = 0;
  }

  async fetch(start, stop) {
    this.requests++;
    try {
      const bytes = new Uint8Array(await this.blob.slice(start, stop).arrayBuffer());
      this.fetched += bytes.length;
      return bytes;
    } catch (error) {
      throw failed(`the file cannot be read: ${error.message}`);
    }
  }
}

class UrlParts {
  constructor(url) {
    this.url = url;
    this.requests = 0;
    this.fetched = 0;
    this.size = null;
    this.version = null;
  }

  async request(range, bound) {
    this.requests++;
    let response;
    let bytes;
    try {
      response = await fetch(this.url, { headers: { Range: `bytes=${range}` } });
      bytes = response.status === 200 || response.status === 206
        ? await bodyOf(response, response.status === 200 ? WHOLE_BOUND : bound) : null;
    } catch (error) {
      if (error instanceof HapfError) throw error;
      throw failed(`the file cannot be fetched: ${error.message}`);
    }
    if (bytes) this.fetched += bytes.length;
    return { response, bytes };
  }

  async open() {
    const { response, bytes } = await this.request(`-${TAIL}`, TAIL);
    if (response.status === 416) return { whole: new Uint8Array(0) };
    if (response.status === 200) return { whole: bytes };
    const place = placeOf(response);
    if (!place || place.stop !== place.size || place.stop - place.start !== bytes.length) {
      throw odd(response.status);
    }
    this.size = place.size;
    this.version = versionOf(response);
    return { tail: bytes, size: place.size };
  }

  async fetch(start, stop) {
    const { response, bytes } = await this.request(`${start}-${stop - 1}`, stop - start);
    if (response.status === 200 || response.status === 416) throw changed();
    const place = placeOf(response);
    if (!place) throw odd(response.status);
    const grown = this.version !== null && place.size > this.size; // by one that is being recorded
    if ((place.size !== this.size && !grown) || versionOf(response) !== this.version) throw changed();
    if (place.start !== start || place.stop !== stop || bytes.length !== stop - start) {
      throw failed('the server gives other bytes than were asked for');
    }
    return bytes;
  }
}

const versionOf = ({ headers }) => headers.get('etag') ?? headers.get('last-modified');

function placeOf({ status, headers }) {
  const found = /^bytes (\d{1,15})-(\d{1,15})\/(\d{1,15})$/.exec(headers.get('content-range') ?? '');
  if (status !== 206 || !found) return null;
  const [start, last, size] = found.slice(1).map(Number);
  return { start, stop: last + 1, size };
}

// A server may send more than it was asked for.
async function bodyOf(response, bound) {
  const reader = response.body.getReader();
  const parts = [];
  let size = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    size += value.length;
    if (size > bound) {
      await reader.cancel();
      throw failed(`the server sends more than ${bound} bytes`);
    }
    parts.push(value);
  }
  const bytes = new Uint8Array(size);
  let at = 0;
  for (const part of parts) {
    bytes.set(part, at);
    at += part.length;
  }
  return bytes;
}

// Blocks of a file, the last used of them in memory; missing ones side by side come in one request.
class Blocks {
  constructor(parts, size) {
    this.parts = parts;
    this.size = size;
    this.cache = new Lru(CACHE);
    this.coming = new Map(); // block -> promise
  }

  get requests() {
    return this.parts.requests;
  }

  get fetched() {
    return this.parts.fetched;
  }

  keep(start, bytes) {
    const stop = start + bytes.length;
    for (let n = Math.ceil(start / BLOCK); n * BLOCK < stop; n++) {
      const end = Math.min((n + 1) * BLOCK, this.size);
      if (end > stop) break;
      this.cache.set(n, bytes.slice(n * BLOCK - start, end - start), end - n * BLOCK);
    }
  }

  async read(start, stop, signal) {
    return (await this.readAll([[start, stop]], signal))[0];
  }

  // ranges: [start, stop] within the file; none is changed by its reader.
  async readAll(ranges, signal) {
    const held = new Map();
    const missing = [];
    for (const [start, stop] of ranges) {
      for (let n = Math.floor(start / BLOCK); n * BLOCK < stop; n++) {
        if (held.has(n)) continue;
        const block = this.cache.get(n) ?? this.coming.get(n);
        held.set(n, block ?? null);
        if (!block) missing.push(n);
      }
    }
    const runs = runsOf(missing.sort((a, b) => a - b));
    for (let i = 0; i < runs.length; i += AT_ONCE) {
      if (signal?.aborted) throw aborted();
      await Promise.all(runs.slice(i, i + AT_ONCE).map((run) => this.fetchRun(run, held)));
    }
    for (const [n, block] of held) {
      if (block instanceof Promise) held.set(n, await block);
    }
    if (signal?.aborted) throw aborted();
    return ranges.map(([start, stop]) => join(held, start, stop));
  }

  async fetchRun([first, last], held) {
    const start = first * BLOCK;
    const whole = this.parts.fetch(start, Math.min((last + 1) * BLOCK, this.size));
    for (let n = first; n <= last; n++) {
      const block = whole.then((bytes) => bytes.subarray(n * BLOCK - start, (n + 1) * BLOCK - start));
      block.catch(() => {});
      this.coming.set(n, block);
    }
    try {
      const bytes = await whole;
      for (let n = first; n <= last; n++) held.set(n, bytes.subarray(n * BLOCK - start, (n + 1) * BLOCK - start));
      this.keep(start, bytes);
    } finally {
      for (let n = first; n <= last; n++) this.coming.delete(n);
    }
  }
}

// Numbers of blocks, sorted, as [first, last].
function runsOf(numbers) {
  const runs = [];
  for (const n of numbers) {
    const run = runs[runs.length - 1];
    if (run && n <= run[1] + 2 && (n + 1 - run[0]) * BLOCK <= RUN) run[1] = n;
    else runs.push([n, n]);
  }
  return runs;
}

function join(held, start, stop) {
  const first = Math.floor(start / BLOCK);
  if (stop <= (first + 1) * BLOCK && stop > start) {
    return held.get(first).subarray(start - first * BLOCK, stop - first * BLOCK);
  }
  const bytes = new Uint8Array(Math.max(stop - start, 0));
  for (let n = first; n * BLOCK < stop; n++) {
    const from = Math.max(start, n * BLOCK);
    const to = Math.min(stop, (n + 1) * BLOCK);
    bytes.set(held.get(n).subarray(from - n * BLOCK, to - n * BLOCK), from - start);
  }
  return bytes;
}
