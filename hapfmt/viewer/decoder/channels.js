// Decoding process (clause 10), steps 3 and 4: bands added, tracks that continue one another joined.
import { intersect, pushSpan } from './spans.js';

// One component's numbers of `spans` (within what the track covers), out of the pieces of the track, into out.
function copyNumbers(entry, component, spans, out, member) {
  const { pieces, track: { componentCount: C } } = entry;
  let at = 0;
  let next = 0;
  for (const [start, stop] of spans) {
    while (next < pieces.length && pieces[next].stop <= start) next++;
    for (let i = next; i < pieces.length && pieces[i].start < stop; i++) {
      const piece = pieces[i];
      const numbers = piece[member];
      const from = (Math.max(piece.start, start) - piece.start) * C + component;
      const to = (Math.min(piece.stop, stop) - piece.start) * C;
      for (let j = from; j < to; j += C) out[at++] = numbers[j];
      next = i; // the next span may begin in this piece too
    }
  }
}

const countSpans = (spans) => spans.reduce((sum, [start, stop]) => sum + stop - start, 0);

// One component of a track in one band: its spans, and numbers() that makes the array when it is wanted.
class Part {
  constructor(entry, component, residual = null) {
    this.entry = entry;
    this.component = component;
    this.residual = residual; // full band of an LF track (DEC-003)
    this.spans = residual ? intersect(entry.spans, residual.spans) : entry.spans;
  }

  get isExact() {
    return this.entry.track.codec === 'LPCX';
  }

  collect(member, ArrayType, spans, entry = this.entry) {
    const out = new ArrayType(countSpans(spans));
    copyNumbers(entry, this.component, spans, out, member);
    return out;
  }

  // The numbers of all spans, or of some within them.
  numbers(spans = this.spans) {
    const { entry, residual } = this;
    const first = entry.pieces[0];
    const out = this.collect('numbers', first ? first.numbers.constructor : Int32Array, spans);
    if (!residual) return out;
    const { countMin, countMax } = entry.track;
    const e = this.collect('numbers', Int32Array, spans, residual);
    for (let i = 0; i < out.length; i++) {
      const sum = out[i] + e[i];
      out[i] = sum < countMin ? countMin : sum > countMax ? countMax : sum; // DEC-001
    }
    return out;
  }

  exact(spans = this.spans) {
    return this.collect('exact', BigUint64Array, spans);
  }
}

// file: of openFile; decoded: of decodeFile. Each list has { channel, track, component, parts, spans }; `track` is the
// first one that represents the channel and describes it.
export function channelsOf(file, decoded) {
  const entries = decoded.tracks;
  const residuals = new Map(); // base -> HF
  for (const entry of entries.values()) {
    const { kind, base } = entry.track;
    if (kind === 'hf' && entries.get(base)?.track.kind === 'lf') residuals.set(base, entry);
  }
  const lists = { channels: new Map(), lf: new Map(), hf: new Map() };
  const add = (list, number, track, component, part) => {
    if (!list.has(number)) list.set(number, { channel: number, track, component, parts: [], spans: [] });
    if (part) list.get(number).parts.push(part);
  };
  for (const entry of entries.values()) { // in order of ids, hence of time where they continue one another (TRK-016)
    const { track } = entry;
    if (track.kind === 'events' || track.kind === 'hf' || track.unsupported) continue;
    const residual = residuals.get(track.id);
    track.channels.forEach((number, component) => {
      // DEC-003: nothing in full band of an LF track whose HF track is not known.
      const whole = track.kind === 'full' || residual ? new Part(entry, component, residual) : null;
      add(lists.channels, number, track, component, whole);
      add(lists.lf, number, track, component, new Part(entry, component));
      if (residual) add(lists.hf, number, track, component, new Part(residual, component));
    });
  }
  const sorted = (list) => [...list.values()].sort((a, b) => a.channel - b.channel).map((channel) => {
    for (const part of channel.parts) for (const [start, stop] of part.spans) pushSpan(channel.spans, start, stop);
    return channel;
  });
  return { channels: sorted(lists.channels), lf: sorted(lists.lf), hf: sorted(lists.hf) };
}
