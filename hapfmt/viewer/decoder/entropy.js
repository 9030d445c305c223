// Entropy coding (9.4): states and words from the front, raw bits from the back; integers by class, by bits and by length.
import { broken } from './error.js';
import { POWERS, bitLength } from './integers.js';

const PAD = 128; // zeros on either side of the coded bytes: both ends are checked after each block only
const LEAST = 65536;
const MAGNITUDE_BOUND = 2 ** 34;
const START_BOUND = 163;

export const CONTEXTS = 36;
export const EDGES = Uint8Array.of(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44);
export const BUCKET_BITS = Uint8Array.of(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4);

// Shape, scale, zeros and half of each class.
const ROWS = [
  [8, 38, 0, 0], [32, 24, 0, 0], [-4, 38, 0, 0], [-7, 24, -1, 0], [64, 14, 0, 0], [8, 38, 0, 1], [16, 76, 32, 0],
  [0, 38, 0, 1], [32, 17, 0, 0], [8, 28, 0, 1], [8, 14, 0, 1], [-4, 76, 0, 1], [-6, 38, 0, 0], [16, 24, -1, 0],
  [64, 24, 0, 0], [0, 14, 0, 1],
];

const CLASS_ENDS = [];
const CLASS_SHARES = [];

// Models of integers by bits: rows of A, of B, then C and D. A model is 256 * p + n + 2, where n + 2 stops at 255.
export const KINDS = 36; // k is below
export const EVEN = (32768 << 8) | 2;
const RARE = (8192 << 8) | 4; // that a number is small after large ones
const A = 0;
const B = A + 9 * KINDS;
export const C = B + 12 * KINDS;
export const D = C + KINDS;
export const FRESH = new Int32Array(D + 3).fill(EVEN);
for (let i = 3; i < 9; i++) FRESH.fill(RARE, A + KINDS * i, A + KINDS * i + i - 2);
for (let j = 6; j < 12; j++) FRESH.fill(RARE, B + KINDS * j, B + KINDS * j + j - 5);
const LOUD = 64; // a and b from here on have the last of the contexts by g

const QUICK_BOUND = 2 ** 28; // of averages: h <= 17, and all but the escapes fit 32 bits

// The ends of a class, 16 places for each context.
export function classEnds(number) {
  CLASS_ENDS[number] ??= makeEnds(...ROWS[number]);
  return CLASS_ENDS[number];
}

function makeEnds(shape, scale, zeros, half) {
  const ends = new Uint16Array(16 * CONTEXTS);
  for (let c = 0; c < CONTEXTS; c++) {
    const lg = (c + 8) >> 2;
    const fr = (c + 8) % 4;
    const M = Math.floor(((Math.floor(((9 + 2 * fr) * 2 ** lg) / 8) + 1) * scale) / 64) + 1;
    const T = Math.floor((65536 * M) / (M + 256));
    let g = 65536;
    let first = 0;
    let w = 0;
    for (let k = 0; k < 15; k++) {
      for (; w < EDGES[k + 1]; w++) g = w === 0 && half === 1 ? Math.floor(Math.sqrt(65536 * T)) : Math.floor((g * T) / 65536);
      const tail = Math.floor(((8 + shape) * g * 65536) / (8 * 65536 + shape * g));
      if (k === 0) first = tail;
      const less = zeros < 0 ? Math.floor((tail * 64512) / Math.max(first, 1)) : Math.floor((tail * (64 - zeros)) / 64);
      ends[16 * c + k] = k + 1 + Math.floor(((65536 - Math.min(less, 65535)) * 4080) / 65536);
    }
    ends[16 * c + 15] = 4096;
  }
  return ends;
}

// For each context the symbols of all slots, and first + 4096 * width of each symbol; makeShares fills them.
function classShares(number) {
  CLASS_SHARES[number] ??= {
    symbols: new Uint8Array(4096 * CONTEXTS), shares: new Int32Array(16 * CONTEXTS), known: new Uint8Array(CONTEXTS),
  };
  return CLASS_SHARES[number];
}

function makeShares({ symbols, shares, known }, ends, c) {
  known[c] = 1;
  for (let k = 0, first = 0; k < 16; k++) {
    const end = ends[16 * c + k];
    symbols.fill(k, 4096 * c + first, 4096 * c + end);
    shares[16 * c + k] = first + 4096 * (end - first);
    first = end;
  }
}

// The symbol of each slot.
function symbolsOf(ends) {
  const symbols = new Uint8Array(4096);
  for (let k = 0, first = 0; k < ends.length; k++) {
    symbols.fill(k, first, ends[k]);
    first = ends[k];
  }
  return symbols;
}

export function lengthEnds(weights) {
  const total = weights.reduce((sum, weight) => sum + weight, 0);
  let sum = 0;
  return Uint16Array.from(weights, (weight, i) => {
    sum += weight;
    return i + 1 + Math.floor(((4096 - weights.length) * sum) / total);
  });
}

// Context c and shift h, from S.
export function contextOf(S) {
  const lg = S === 0 ? 0 : bitLength(S) - 1;
  const fr = Math.floor((S * 4) / POWERS[lg]) % 4;
  const c = 4 * (lg < 10 ? lg : 10) + fr - 8;
  return { c: c > 0 ? c : 0, h: lg > 10 ? lg - 10 : 0 };
}

export const averageFrom = (start) => (4 + (start % 4)) * 2 ** Math.floor(start / 4);

// What comes before the coded bytes; each function throws RNG-004.
export function readProbabilities(reader, count) {
  reader.requirement = 'RNG-004';
  const { offset } = reader;
  const found = [...reader.bytes(count)];
  if (found.includes(0)) broken('RNG-004', 'a probability of 0', offset);
  return found;
}

export function readStart(reader) {
  reader.requirement = 'RNG-004';
  const start = reader.u8();
  if (start > START_BOUND) broken('RNG-004', `the start byte ${start}`, reader.offset - 1);
  return start;
}

export function readLengths(reader) {
  reader.requirement = 'RNG-004';
  const { offset } = reader;
  const first = reader.u8();
  const n = reader.u8();
  if (n < 1 || first + n > 64) broken('RNG-004', `${n} lengths from ${first} on`, offset);
  const weights = [...reader.bytes(n)];
  if (weights.every((weight) => weight === 0)) broken('RNG-004', 'lengths without a weight', offset);
  return { first, ends: lengthEnds(weights) };
}

// Where the rows of A and B for the next integer begin.
export function nearOf(a, b) {
  const g = 2 * a + b;
  return A + KINDS * (g < 3 ? g : g < LOUD ? 33 - Math.clz32(g) : 8);
}

export const loudOf = (s) => B + KINDS * (s < 1024 ? 32 - Math.clz32(s) : 11);

// The model after a bit.
export function learn(model, bit, limit) {
  const n = model & 255;
  const t = 31 - Math.clz32(n);
  const p = model >>> 8;
  const s = t < limit ? t : limit;
  const q = bit === 1 ? p + ((65535 - p) >> s) : p - (p >> s);
  return (q << 8) | (n < 255 ? n + 1 : n);
}

export class EntropyDecoder {
  constructor(bytes, offset, states) {
    this.buffer = new Uint8Array(bytes.length + 2 * PAD);
    this.buffer.set(bytes, PAD);
    this.size = bytes.length;
    this.offset = offset;
    this.next = PAD;
    this.rawBits = 0;
    this.lane = 0;
    this.view = new DataView(this.buffer.buffer);
    this.states = Uint32Array.from({ length: states }, () => (this.word() << 16) | this.word());
    this.check();
  }

  word() {
    const { buffer, next } = this;
    this.next += 2;
    return next + 1 < buffer.length ? (buffer[next] << 8) | buffer[next + 1] : 0;
  }

  check() {
    if (this.front + ((this.rawBits + 7) >> 3) > this.size) this.tooShort();
  }

  // Bytes taken at the front.
  get front() {
    return this.next - PAD;
  }

  section() {
    this.lane = 0;
  }

  // The symbol whose ends begin at a place of an array.
  symbol(ends, at = 0) {
    const slot = this.states[this.lane] & 4095;
    let i = at;
    while (slot >= ends[i]) i++;
    const first = i > at ? ends[i - 1] : 0;
    this.takeShare(first, ends[i] - first);
    return i - at;
  }

  // The caller checks after each bit, and after a few flags.
  bit(p) {
    return this.flag(4096 - 16 * p);
  }

  // A symbol with the ends `zeros` and 4096.
  flag(zeros) {
    const { states, lane } = this;
    const x = states[lane];
    const slot = x & 4095;
    const bit = (zeros - 1 - slot) >>> 31;
    const width = zeros + ((4096 - 2 * zeros) & -bit);
    const y = Math.imul(width, x >>> 12) + slot - (zeros & -bit);
    const needs = ((y >>> 16) - 1) >> 31; // all bits below 65536
    states[lane] = (y << (16 & needs)) | (this.view.getUint16(this.next) & needs);
    this.next -= needs << 1;
    this.lane = (lane + 1) & (states.length - 1);
    return bit;
  }

  // The state of the lane goes on, after a symbol with a share of the slots: width of them from first on.
  takeShare(first, width) {
    const { states, lane } = this;
    const x = states[lane];
    const y = Math.imul(width, x >>> 12) + (x & 4095) - first;
    states[lane] = y >>> 16 === 0 ? (y << 16) | this.word() : y;
    this.lane = (lane + 1) & (states.length - 1);
  }

  // An integer of k raw bits, k <= 48.
  raw(k) {
    if (k > 24) {
      const low = this.raw(24);
      return low + this.raw(k - 24) * 16777216;
    }
    const W = this.rawBits;
    const at = PAD + this.size - 1 - (W >> 3);
    const { buffer } = this;
    const word = buffer[at] | (buffer[at - 1] << 8) | (buffer[at - 2] << 16) | (buffer[at - 3] << 24);
    this.rawBits = W + k;
    return (word >>> (W & 7)) & ((1 << k) - 1);
  }

  // A section of bits, each with the probability that the two before it choose; put at out[1], out[2], ...
  repeats(count, p, out) {
    this.section();
    let before = 0;
    let fresh = 1;
    for (let t = 1; t < count; t++) {
      const bit = this.bit(p[before]);
      this.check();
      out[t] = bit;
      before = 2 * bit + (before >> 1);
      fresh += 1 - bit;
    }
    return fresh;
  }

  // A section of integers of a class; with raw signs or without signs.
  integers(count, number, start, signed, out) {
    this.section();
    const averages = { f: averageFrom(start), s: averageFrom(start) };
    for (let from = 0; from < count;) {
      from = this.quickBlocks(from, count, number, signed, averages, out);
      if (from < count) from = this.block(from, count, number, signed, averages, out);
    }
  }

  // A block of any integers; the end of the block.
  block(from, count, number, signed, averages, out) {
    const ends = classEnds(number);
    const size = count - from < 8 ? count - from : 8;
    const { c, h } = contextOf(Math.floor((averages.f + averages.s) / 2));
    const ks = new Uint8Array(8);
    for (let i = 0; i < size; i++) ks[i] = this.symbol(ends, 16 * c);
    let sum = 0;
    for (let i = 0; i < size; i++) {
      const u = this.magnitude(ks[i], h);
      sum += u;
      out[from + i] = signed && u > 0 && this.raw(1) === 1 ? -u : u;
    }
    this.check();
    this.move(averages, sum);
    return from + size;
  }

  move(averages, sum) {
    const m = 32 * sum;
    averages.f += Math.floor((m - averages.f) / 2);
    averages.s += Math.floor((3 * (m - averages.s)) / 16);
  }

  // The same in 32 bits, for whole blocks up to the first one whose averages are too large; where that begins.
  quickBlocks(from, count, number, signed, averages, out) {
    const last = count - 8;
    if (from > last || averages.f >= QUICK_BOUND || averages.s >= QUICK_BOUND) return from;
    const table = classShares(number);
    const { symbols, shares, known } = table;
    const { view, states, size } = this;
    const lanes = states.length - 1;
    const signBit = signed ? 1 : 0;
    const ks = new Uint8Array(8);
    let f = averages.f | 0;
    let s = averages.s | 0;
    let { next, rawBits } = this;
    while (from <= last) {
      const S = (f + s) >> 1;
      const lg = S === 0 ? 0 : 31 - Math.clz32(S);
      const h = lg > 10 ? lg - 10 : 0;
      const context = 4 * (lg - h) + (((S << 2) >> lg) & 3) - 8;
      const c = context > 0 ? context : 0;
      if (known[c] === 0) makeShares(table, classEnds(number), c);
      for (let i = 0; i < 8; i++) {
        const x = states[i & lanes];
        const slot = x & 4095;
        const k = symbols[(c << 12) | slot];
        const share = shares[(c << 4) | k];
        const y = Math.imul(share >> 12, x >>> 12) + slot - (share & 4095);
        const needs = ((y >>> 16) - 1) >> 31; // all bits below 65536
        states[i & lanes] = (y << (16 & needs)) | (view.getUint16(next) & needs);
        next -= needs << 1;
        ks[i] = k;
      }
      let sum = 0;
      let large = 0;
      for (let i = 0; i < 8; i++) {
        const k = ks[i];
        const word = view.getInt32(PAD + size - 4 - (rawBits >> 3)) >>> (rawBits & 7);
        if (k < 15) {
          const bits = BUCKET_BITS[k] + h;
          const u = (EDGES[k] << h) + (word & ((1 << bits) - 1));
          const minus = (word >>> bits) & signBit;
          rawBits += bits + ((-u >>> 31) & signBit);
          sum += u;
          out[from + i] = (u ^ -minus) + minus;
        } else {
          this.rawBits = rawBits;
          const u = this.large(h);
          large += u;
          out[from + i] = signed && this.raw(1) === 1 ? -u : u;
          ({ rawBits } = this);
        }
      }
      if (next - PAD + ((rawBits + 7) >> 3) > size) this.tooShort();
      from += 8;
      if (large > 0) {
        this.move(averages, sum + large);
        if (averages.f >= QUICK_BOUND || averages.s >= QUICK_BOUND) break;
        f = averages.f | 0;
        s = averages.s | 0;
      } else {
        const m = sum << 5;
        averages.f = f += (m - f) >> 1;
        const d = m - s;
        averages.s = s += 3 * (d >> 4) + ((3 * (d & 15)) >> 4); // (3 * d) >> 4
      }
    }
    this.next = next;
    this.rawBits = rawBits;
    return from;
  }

  // One integer of a class, with a raw sign, in its own context.
  integer(ends, c, h) {
    const u = this.magnitude(this.symbol(ends, 16 * c), h);
    const integer = u > 0 && this.raw(1) === 1 ? -u : u;
    this.check();
    return integer;
  }

  // u of symbol k.
  magnitude(k, h) {
    let u = k;
    if (k === 15) u = this.large(h);
    else if (k > 9 || h > 0) u = EDGES[k] * POWERS[h] + this.raw(BUCKET_BITS[k] + h);
    if (u >= MAGNITUDE_BOUND) this.tooLarge();
    return u;
  }

  // An integer of bucket 15.
  large(h) {
    const l = this.raw(6);
    // Beyond 34 bits nothing else counts: RNG-003 before the shift.
    if (l > 34) this.tooLarge();
    const high = POWERS[l] + this.raw(l) + 43;
    if (high >= POWERS[34 - h]) this.tooLarge();
    return high * POWERS[h] + this.raw(h);
  }

  // A section of integers by bits, with signs or without.
  byBits(count, signed, out) {
    this.section();
    const models = FRESH.slice();
    let a = 0; // the magnitudes before, as far as contexts tell them apart
    let b = 0;
    let s = 0;
    let d = 0;
    for (let i = 0; i < count; i++) {
      let near = nearOf(a, b);
      let loud = loudOf(s);
      let k = 0;
      while (this.flag(4096 - (((models[near] >>> 8) + (models[loud] >>> 8)) >> 5)) === 0) {
        models[near] = learn(models[near], 0, 5);
        models[loud] = learn(models[loud], 0, 7);
        near++;
        loud++;
        if (++k === KINDS) {
          this.check();
          this.tooLarge();
        }
      }
      models[near] = learn(models[near], 1, 5);
      models[loud] = learn(models[loud], 1, 7);
      let u = k;
      if (k > 2) {
        u = (2 + this.learnt(models, C + k)) * POWERS[k - 3] + 1 + this.raw(k - 3);
        if (u >= MAGNITUDE_BOUND) this.tooLarge();
      }
      if (signed && u > 0) d = 1 + this.learnt(models, D + d);
      this.check();
      out[i] = d === 2 && u > 0 ? -u : u;
      b = a;
      a = u < LOUD ? u : LOUD;
      s += Math.floor((64 * u - s) / 8);
    }
  }

  // A flag of one model.
  learnt(models, place) {
    const model = models[place];
    const bit = this.flag(4096 - (model >>> 12));
    models[place] = learn(model, bit, 7);
    return bit;
  }

  tooShort() {
    broken('RNG-001', 'the coded bytes end too early', this.offset + this.size);
  }

  tooLarge() {
    broken('RNG-003', 'a coded integer of 2^34 or more', this.offset);
  }

  // A section of integers by length with raw signs, up to 63 bits: their halves, modulo 2^64.
  wide(count, table, lower, upper) {
    this.section();
    const { first, ends } = table;
    const { view, buffer, states, size } = this;
    const lanes = states.length - 1;
    const symbols = symbolsOf(ends);
    const zero = PAD + size - 4;
    let { next, rawBits } = this;
    // 32 raw bits from W on.
    const peek = (W) => (view.getInt32(zero - (W >> 3)) >>> (W & 7)) | ((buffer[zero - 1 - (W >> 3)] << 1) << (31 - (W & 7)));
    for (let i = 0; i < count; i++) {
      const x = states[i & lanes];
      const slot = x & 4095;
      const k = symbols[slot];
      const begin = k > 0 ? ends[k - 1] : 0;
      const y = Math.imul(ends[k] - begin, x >>> 12) + slot - begin;
      const needs = ((y >>> 16) - 1) >> 31; // all bits below 65536
      states[i & lanes] = (y << (16 & needs)) | (view.getUint16(next) & needs);
      next -= needs << 1;
      const bits = first + k - 1; // those below the highest, the lowest first
      if (bits >= 0) {
        const low = peek(rawBits);
        const high = bits < 32 ? 0 : (peek(rawBits + 32) & ~(-1 << (bits - 32))) | (1 << (bits - 32));
        const minus = -(peek(rawBits + bits) & 1);
        const sum = (((bits < 32 ? (low & ~(-1 << bits)) | (1 << bits) : low) ^ minus) - minus) | 0;
        lower[i] = sum;
        upper[i] = (high ^ minus) - (sum === 0 ? minus : 0);
        rawBits += bits + 1;
      } else {
        lower[i] = upper[i] = 0;
      }
      if (next - PAD + ((rawBits + 7) >> 3) > size) this.tooShort();
    }
    this.next = next;
    this.rawBits = rawBits;
  }

  // A section of signs of the integers that are not 0.
  signs(count, p, out) {
    this.section();
    for (let i = 0; i < count; i++) {
      if (out[i] === 0) continue;
      const before = i === 0 ? 0 : Math.sign(out[i - 1]);
      if (this.bit(p[before + 1]) === 1) out[i] = -out[i];
      this.check();
    }
  }

  // After the last symbol: RNG-001.
  finish() {
    const end = this.offset + this.size;
    const back = (this.rawBits + 7) >> 3;
    if (this.states.some((x) => x !== LEAST)) broken('RNG-001', 'a state that does not end with 65536', end);
    if (this.front + back !== this.size) {
      broken('RNG-001', 'the coded bytes are more or fewer than their symbols call for', end);
    }
    const rest = this.rawBits & 7;
    if (rest > 0 && this.buffer[this.next] >> rest) {
      broken('RNG-001', 'bits left over that are not 0', end);
    }
  }
}
