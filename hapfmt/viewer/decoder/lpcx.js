// LPCX (9.7): counts by LPCR, and the corrections that lead from their values to the source's binary64 numbers.
import { Reader } from './bytes.js';
import { EntropyDecoder, readLengths, readProbabilities } from './entropy.js';
import { broken } from './error.js';
import { valueRule } from './exact.js';
import { UniformGrid } from './grid.js';
import { limitsOf } from './limits.js';
import { decodeIndices, splitComponents } from './lpcr.js';

const LIST_BOUND = 32;
const RULE_BOUND = 4;
const RULE_CUBIC = 3;
const RULE_LINEAR = 4;
const COEFFICIENT_BOUND = 2 ** 900;

// For each component {  rule, digits, coefficients, terms: [{ a, lag, w }] }.
export function parseLpcx(reader, track) {
  const { offset } = reader;
  if (track.kind !== 'full' || track.contract || track.deviation) {
    broken('EXA-001', 'a track of codec LPCX that is not full band, without contract and deviation', offset);
  }
  const setup = [];
  for (let i = 0; i < track.componentCount; i++) setup.push(parseComponent(reader));
  const known = new Set();
  for (const component of decodingOrder(setup)) {
    for (const { a, lag } of setup[component].terms) {
      if (!known.has(a) && (a !== component || lag === 0)) broken('EXA-002', `component ${component} from ${a}, ${lag} ticks before`, offset);
    }
    known.add(component);
  }
  return setup;
}

function parseComponent(reader) {
  const { offset } = reader;
  const rule = reader.u8();
  const digits = reader.u8();
  const count = reader.u8();
  if (reader.u8() !== 0) broken('HED-005', 'a reserved byte that is not 0', offset + 3);
  if (rule > RULE_BOUND) broken('EXA-002', `rule ${rule}`, offset);
  const [least, most] = rule === 2 ? [1, 15] : [0, 0];
  if (digits < least || digits > most) broken('EXA-002', `rule ${rule} with ${digits} digits`, offset);
  const [fewest, many] = rule === RULE_LINEAR ? [1, 16] : [0, 0];
  if (count < fewest || count > many) broken('EXA-002', `rule ${rule} with ${count} terms`, offset);
  const number = () => {
    const at = reader.offset;
    const bytes = reader.bytes(8);
    const found = new DataView(bytes.buffer, bytes.byteOffset, 8).getFloat64(0, true);
    if (!(Math.abs(found) < COEFFICIENT_BOUND)) broken('EXA-002', `the coefficient ${found}`, at);
    return found;
  };
  const coefficients = [];
  const expected = rule === RULE_CUBIC ? 4 : rule === RULE_LINEAR ? 1 : 0;
  for (let i = 0; i < expected; i++) coefficients.push(number());
  const terms = [];
  for (let i = 0; i < count; i++) terms.push({ a: reader.u8(), lag: reader.u8(), w: number() });
  return { rule, digits, coefficients, terms };
}

// Components of rule 4 come last.
function decodingOrder(setup) {
  const places = setup.map((_, component) => component);
  const isLinear = (component) => setup[component].rule === RULE_LINEAR;
  return [...places.filter((component) => !isLinear(component)), ...places.filter(isLinear)];
}

// Numbers of 64 bits are two halves of 32 here, in the order of the memory: lower, upper.
const LOWER = new Uint8Array(Uint16Array.of(1).buffer)[0] === 1 ? 0 : 1;
const UPPER = 1 - LOWER;

// Moves the binary64 number at halves[at], halves[at + 1] by a correction times 2^z in the order of the places.
export function movePlace(halves, at, lower, upper, z) {
  if (z >= 32) {
    upper = lower << (z - 32);
    lower = 0;
  } else if (z > 0) {
    upper = (upper << z) | (lower >>> (32 - z));
    lower <<= z;
  }
  let high = halves[at + UPPER];
  let low = halves[at + LOWER];
  // The place of a negative number is its bits, all but the sign the other way round; and back again.
  if (high < 0) {
    high ^= 0x7fffffff;
    low = ~low;
  }
  const sum = (low >>> 0) + (lower >>> 0);
  low = sum | 0;
  high = (high + upper + (sum > 0xffffffff ? 1 : 0)) | 0;
  if (high < 0) {
    high ^= 0x7fffffff;
    low = ~low;
  }
  halves[at + UPPER] = high;
  halves[at + LOWER] = low;
}

// The place of each count among the distinct ones of its packet.
function placesOf(counts) {
  const sorted = counts.slice().sort();
  let size = 0;
  for (let i = 0; i < sorted.length; i++) if (i === 0 || sorted[i] !== sorted[i - 1]) sorted[size++] = sorted[i];
  return {
    size,
    places: counts.map((count) => {
      let low = 0;
      for (let high = size - 1; low < high;) {
        const middle = (low + high) >> 1;
        if (sorted[middle] < count) low = middle + 1;
        else high = middle;
      }
      return low;
    }),
  };
}

// The corrections of each count, as two halves, the last one first. Few bytes may ask for many lists: they are links
// within typed arrays.
class Lists {
  constructor(size, samples) {
    this.heads = new Int32Array(size).fill(-1);
    this.links = new Int32Array(samples).fill(-1);
    this.lower = new Int32Array(samples);
    this.upper = new Int32Array(samples);
    this.used = 0;
  }

  put(place, lower, upper) {
    const { heads, links, used } = this;
    this.lower[used] = lower;
    this.upper[used] = upper;
    links[used] = heads[place];
    heads[place] = used;
    this.used = used + 1;
    let at = used;
    for (let i = 1; i < LIST_BOUND && at >= 0; i++) at = links[at];
    if (at >= 0) links[at] = -1;
  }

  // Moves entry i to the front; where it is.
  take(place, i) {
    const { heads, links } = this;
    if (heads[place] < 0) this.put(place, 0, 0);
    if (i === 0) return heads[place];
    let before = heads[place];
    for (let k = 1; k < i; k++) before = links[before];
    const at = links[before];
    links[before] = links[at];
    links[at] = heads[place];
    heads[place] = at;
    return at;
  }
}

// A correction of up to 63 bits, as two halves.
class Corrections {
  constructor(flags, z, reader) {
    this.recall = (flags & 1) !== 0;
    this.z = z;
    this.p = this.recall ? [0, 1, 2].map(() => readRanks(reader)) : null;
    this.table = readLengths(reader, 64);
    this.coder = new EntropyDecoder(reader.bytes(reader.left), reader.offset, flags & 2 ? 4 : 1);
    this.lists = null;
    this.lower = 0; // the correction that was decoded last
    this.upper = 0;
  }

  // The rank of each correction, -1 for those in full.
  ranks(places, size) {
    const { coder, p } = this;
    const ranks = new Int8Array(places.length).fill(-1);
    coder.section();
    this.lists = new Lists(size, places.length);
    const sizes = new Uint8Array(size);
    for (let t = 0; t < places.length; t++) {
      const place = places[t];
      const known = sizes[place];
      const x = known === 0 ? 0 : t > 0 && place === places[t - 1] ? 1 : 2;
      const row = p[x];
      const entries = known === 0 ? 1 : known;
      for (let i = 0; i < entries && ranks[t] < 0; i++) {
        const chance = row.length === 0 ? 128 : row[Math.min(i, row.length - 1)];
        if (coder.bit(chance) === 1) ranks[t] = i;
        coder.check();
      }
      if (known === 0) sizes[place] = 1;
      else if (ranks[t] < 0 && known < LIST_BOUND) sizes[place]++;
    }
    return ranks;
  }

  // The next correction, of the count at a place of the distinct ones; i: its rank, -1 in full.
  next(place, i) {
    if (i < 0) {
      this.inFull();
      this.lists.put(place, this.lower, this.upper);
    } else {
      const at = this.lists.take(place, i);
      this.lower = this.lists.lower[at];
      this.upper = this.lists.upper[at];
    }
  }

  push(bits, n) { // n <= 24 more bits below those of lower and upper
    if (n === 0) return;
    this.upper = (this.upper << n) | (this.lower >>> (32 - n));
    this.lower = (this.lower << n) | bits;
  }

  inFull() {
    const { coder, table } = this;
    const L = table.first + coder.symbol(table.ends);
    this.upper = this.lower = 0;
    if (L > 0) {
      this.lower = 1;
      // The lowest L - 1 bits, at most 62: raw bits, the lowest first.
      const n0 = Math.min(L - 1, 24);
      const n1 = Math.min(L - 1 - n0, 24);
      const n2 = L - 1 - n0 - n1;
      const b0 = coder.raw(n0);
      const b1 = coder.raw(n1);
      this.push(coder.raw(n2), n2);
      this.push(b1, n1);
      this.push(b0, n0);
      if (coder.raw(1)) {
        this.lower = -this.lower | 0;
        this.upper = this.lower === 0 ? -this.upper | 0 : ~this.upper;
      }
    }
    coder.check();
  }
}

function readRanks(reader) {
  reader.requirement = 'RNG-004';
  const n = reader.u8();
  if (n > LIST_BOUND) broken('RNG-004', `${n} probabilities of ranks`, reader.offset - 1);
  return readProbabilities(reader, n);
}

// The corrections of one component, or null where all are 0.
function readPart(part, offset) {
  if (part.length === 0) return null;
  const reader = new Reader(part, { base: offset, requirement: 'EXA-004' });
  const flags = reader.u8();
  if (flags > 3) broken('EXA-004', `flags ${flags}`, offset);
  const z = reader.u8();
  if (z > 63) broken('EXA-004', `steps of 2^${z}`, offset);
  return new Corrections(flags, z, reader);
}

// v of rule 4 at each tick; columns: the exact values of components that are known, its own as they come.
function linearRule({ coefficients: [c0], terms }, columns, quotient) {
  const reach = Math.max(...terms.map(({ lag }) => lag));
  const rows = terms.map(({ a, lag, w }) => ({ x: columns[a], lag, w }));
  return (count, t) => {
    if (t < reach) return quotient(count);
    let v = c0;
    for (const { x, lag, w } of rows) v += w * x[t - lag];
    return Number.isFinite(v) ? v + 0 : quotient(count);
  };
}

function readExact(track, rest, base, span, counts) {
  const { setup, componentCount: C } = track;
  const parts = rest.length === 0 ? setup.map(() => ({ bytes: rest, offset: base })) : splitComponents(rest, C, base, 'EXA-003');
  const exact = new BigUint64Array(span * C);
  const columns = setup.map(() => new Float64Array(span));
  for (const component of decodingOrder(setup)) {
    const { rule, digits, coefficients } = setup[component];
    const values = columns[component];
    const halves = new Int32Array(values.buffer);
    const isLinear = rule === RULE_LINEAR;
    const alone = valueRule(isLinear ? 0 : rule, digits, track.calibrations[component], coefficients);
    const valueOf = isLinear ? linearRule(setup[component], columns, alone) : alone;
    const corrections = readPart(parts[component].bytes, parts[component].offset);
    const column = Int32Array.from({ length: span }, (_, t) => counts[t * C + component]);
    const distinct = corrections?.recall ? placesOf(column) : null;
    const ranks = distinct && corrections.ranks(distinct.places, distinct.size);
    corrections?.coder.section();
    for (let t = 0; t < span; t++) {
      const count = column[t];
      values[t] = valueOf(count, t);
      if (corrections === null) continue;
      if (distinct) corrections.next(distinct.places[t], ranks[t]);
      else corrections.inFull();
      const { lower, upper, z } = corrections;
      if (lower !== 0 || upper !== 0) movePlace(halves, 2 * t, lower, upper, z);
    }
    corrections?.coder.finish();
    const words = new BigUint64Array(values.buffer);
    for (let t = 0; t < span; t++) exact[t * C + component] = words[t];
  }
  return exact;
}

export function decodeLpcx(track, bytes, span, counts, offset, wantsExact) {
  const { countMin: low, countMax: high, componentCount: C } = track;
  const reader = new Reader(bytes, { base: offset, requirement: 'EXA-003' });
  const n = reader.varint();
  const at = reader.offset;
  const grid = new UniformGrid(1, 0, limitsOf(track.level).countBound);
  decodeIndices(grid, C, reader.bytes(n), span, at, (component, index) => {
    for (let t = 0; t < span; t++) {
      const count = index[t];
      if (count < low || count > high) broken('EXA-003', `the count ${count} is out of range`, at);
      counts[t * C + component] = count;
    }
  });
  if (!wantsExact) return null;
  try {
    const base = reader.offset;
    return readExact(track, reader.bytes(reader.left), base, span, counts);
  } catch (error) {
    error.counts = counts; // they are valid all the same (EXA-006)
    throw error;
  }
}
