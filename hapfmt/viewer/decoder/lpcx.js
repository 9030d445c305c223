// LPCX (9.7): counts by LPCR, and the corrections that lead from their values to the source's binary64 numbers.
import { Reader } from './bytes.js';
import { EntropyDecoder, readLengths, readProbabilities } from './entropy.js';
import { broken } from './error.js';
import { fillValues } from './exact.js';
import { UniformGrid } from './grid.js';
import { bitLength } from './integers.js';
import { limitsOf } from './limits.js';
import { decodeIndices, splitComponents } from './lpcr.js';

const LIST_BOUND = 32;
const RULE_BOUND = 4;
const RULE_SIGNIFICANT = 2;
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
  const [least, most] = rule === 2 ? [1, 31] : [0, 0];
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
  const turned = high >> 31;
  high ^= turned & 0x7fffffff;
  low ^= turned;
  const sum = (low + lower) | 0;
  const carry = ((low & lower) | ((low | lower) & ~sum)) >>> 31;
  high = (high + upper + carry) | 0;
  const back = high >> 31;
  halves[at + UPPER] = high ^ (back & 0x7fffffff);
  halves[at + LOWER] = sum ^ back;
}

// The distinct counts of a packet, `size` of them, and the place of each count among them. The multiplier is random: no
// file can choose counts that meet in the table.
function placesOf(counts) {
  const distinct = new Int32Array(counts.length);
  const places = new Int32Array(counts.length);
  const multiplier = Math.floor(Math.random() * 2 ** 31) * 2 + 1;
  let bits = 8;
  let table = new Int32Array(2 * 2 ** bits); // counts and their places plus 1; 0: none
  let size = 0;
  for (let t = 0; t < counts.length; t++) {
    const count = counts[t];
    const at = search(table, count, Math.imul(count, multiplier) >>> (32 - bits));
    const place = table[at + 1] - 1;
    if (place >= 0) {
      places[t] = place;
      continue;
    }
    places[t] = size;
    distinct[size++] = table[at] = count;
    table[at + 1] = size;
    if (4 * size > table.length) table = enlarge(distinct, size, multiplier, ++bits);
  }
  return { places, distinct: distinct.subarray(0, size) };
}

// Where a count is, or where it goes.
function search(table, count, from) {
  let at = 2 * from;
  while (table[at] !== count && table[at + 1] !== 0) at = (at + 2) & (table.length - 1);
  return at;
}

function enlarge(distinct, size, multiplier, bits) {
  const table = new Int32Array(2 * 2 ** bits);
  for (let place = 0; place < size; place++) {
    const at = search(table, distinct[place], Math.imul(distinct[place], multiplier) >>> (32 - bits));
    table[at] = distinct[place];
    table[at + 1] = place + 1;
  }
  return table;
}

// The corrections of each count, the last one first, as the ticks at which they entered. Few bytes may ask for many
// lists: they are links within typed arrays.
class Lists {
  constructor(size, span) {
    this.heads = new Int32Array(size).fill(-1);
    this.sizes = new Uint8Array(size);
    this.links = new Int32Array(span).fill(-1);
  }

  put(place, t) {
    const { heads, links, sizes } = this;
    links[t] = heads[place];
    heads[place] = t;
    if (sizes[place] < LIST_BOUND) {
      sizes[place]++;
      return;
    }
    let at = t;
    for (let i = 1; i < LIST_BOUND; i++) at = links[at];
    links[at] = -1;
  }

  // Moves entry i to the front; its tick.
  take(place, i) {
    const { heads, links } = this;
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

// The rank of the correction of each tick, -1 for those in full; places: those of the counts, `size` of them.
function decodeRanks(coder, p, size, places) {
  const ranks = new Int8Array(places.length).fill(-1);
  const sizes = new Uint8Array(size);
  coder.section();
  for (let t = 0; t < places.length; t++) {
    const place = places[t];
    const known = sizes[place];
    const row = p[known === 0 ? 0 : t > 0 && place === places[t - 1] ? 1 : 2];
    const entries = known === 0 ? 1 : known;
    for (let i = 0; i < entries && ranks[t] < 0; i++) {
      if (coder.bit(row[i]) === 1) ranks[t] = i;
      coder.check();
    }
    if (known === 0) sizes[place] = 1;
    else if (ranks[t] < 0 && known < LIST_BOUND) sizes[place]++;
  }
  return ranks;
}

function readRanks(reader) {
  reader.requirement = 'RNG-004';
  const n = reader.u8();
  if (n > LIST_BOUND) broken('RNG-004', `${n} probabilities of ranks`, reader.offset - 1);
  const found = readProbabilities(reader, n);
  return Uint8Array.from({ length: LIST_BOUND }, (_, i) => found[i] ?? found[n - 1] ?? 128);
}

// The corrections of one component as halves, and z; or null where all are 0.
function readCorrections(part, offset, placed, counts) {
  if (part.length === 0) return null;
  const reader = new Reader(part, { base: offset, requirement: 'EXA-003' });
  const flags = reader.u8();
  if (flags > 3) broken('EXA-003', `flags ${flags}`, offset);
  const z = reader.u8();
  if (z > 63) broken('EXA-003', `steps of 2^${z}`, offset);
  const p = flags & 1 ? [0, 1, 2].map(() => readRanks(reader)) : null;
  const table = readLengths(reader);
  const coder = new EntropyDecoder(reader.bytes(reader.left), reader.offset, flags & 2 ? 4 : 1);
  const span = counts.length;
  const lower = new Int32Array(span);
  const upper = new Int32Array(span);
  if (p === null) coder.wide(span, table, lower, upper);
  else recall(coder, p, table, placed ?? placesOf(counts), lower, upper);
  coder.finish();
  return { z, lower, upper };
}

function recall(coder, p, table, { places, distinct }, lower, upper) {
  const size = distinct.length;
  const span = places.length;
  const ranks = decodeRanks(coder, p, size, places);
  let full = 0;
  for (let t = 0; t < span; t++) if (ranks[t] < 0) full++;
  // Those in full wait at the end of the arrays, never before the ticks that take them.
  let next = span - full;
  coder.wide(full, table, lower.subarray(next), upper.subarray(next));
  const lists = new Lists(size, span);
  for (let t = 0; t < span; t++) {
    const place = places[t];
    const inFull = ranks[t] < 0;
    const known = lists.heads[place] >= 0;
    const at = inFull ? next++ : known ? lists.take(place, ranks[t]) : -1;
    lower[t] = at < 0 ? 0 : lower[at];
    upper[t] = at < 0 ? 0 : upper[at];
    if (inFull || !known) lists.put(place, t);
  }
}

// v of rule 4 at tick t, or where it has none the value by rule 0, which is there; columns: the exact values of
// components that are known, its own as they come.
class Linear {
  constructor({ coefficients: [c0], terms }, columns, values) {
    this.c0 = c0;
    this.rows = terms.map(({ a, lag, w }) => ({ x: columns[a], lag, w }));
    this.reach = Math.max(...terms.map(({ lag }) => lag));
    this.values = values;
  }

  at(t) {
    const { values, rows } = this;
    if (t < this.reach) return values[t];
    let v = this.c0;
    for (const { x, lag, w } of rows) v += w * x[t - lag];
    return Number.isFinite(v) ? v + 0 : values[t];
  }
}

function readExact(track, rest, base, span, counts) {
  const { setup, componentCount: C } = track;
  const parts = rest.length === 0 ? setup.map(() => ({ bytes: rest, offset: base })) : splitComponents(rest, C, base, 'EXA-003');
  const exact = new BigUint64Array(span * C);
  const columns = setup.map(() => (C === 1 ? new Float64Array(exact.buffer) : new Float64Array(span)));
  for (const component of decodingOrder(setup)) {
    const values = columns[component];
    const halves = new Int32Array(values.buffer);
    const column = C === 1 ? counts : new Int32Array(span);
    if (C > 1) for (let t = 0, at = component; t < span; t++, at += C) column[t] = counts[at];
    const placed = setup[component].rule === RULE_SIGNIFICANT ? placesOf(column) : null;
    fillValues(setup[component], track.calibrations[component], column, placed, values);
    const corrections = readCorrections(parts[component].bytes, parts[component].offset, placed, column);
    const { z, lower, upper } = corrections ?? {};
    if (setup[component].rule === RULE_LINEAR) {
      const linear = new Linear(setup[component], columns, values);
      for (let t = 0; t < span; t++) {
        values[t] = linear.at(t);
        if (corrections !== null) movePlace(halves, 2 * t, lower[t], upper[t], z);
      }
    } else if (corrections !== null) {
      for (let t = 0; t < span; t++) movePlace(halves, 2 * t, lower[t], upper[t], z);
    }
    if (C > 1) interleave(halves, new Int32Array(exact.buffer), span, component, C);
  }
  return exact;
}

// Binary64 numbers move as halves: a NaN keeps all its bits.
function interleave(halves, out, span, component, C) {
  for (let t = 0, at = 2 * component; t < span; t++, at += 2 * C) {
    out[at] = halves[2 * t];
    out[at + 1] = halves[2 * t + 1];
  }
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
  const base = reader.offset;
  return readExact(track, reader.bytes(reader.left), base, span, counts);
}
