// NOIS (9.10): noise with a gain that changes, through an all-pole filter.
import { Reader } from './bytes.js';
import { EntropyDecoder, readStart } from './entropy.js';
import { broken } from './error.js';
import { POWERS, clamp, rdiv } from './integers.js';
import { splitComponents } from './lpcr.js';
import { SINES } from './predictor.js';

const ORDER_BOUND = 32;
const GAIN_BOUND = 112;
const COEFFICIENT_BOUND = 127;
const LEAST = -(2 ** 31);
const MOST = 2 ** 31 - 1;
const R = [4096, 4871, 5793, 6889];

export function parseNois(reader, track) {
  const { offset } = reader;
  const shift = reader.u8();
  const intervals = reader.u8();
  if (track.kind === 'lf' || track.contract !== null) {
    broken('NOI-001', 'a synthetic texture that is LF, or has a contract', offset);
  }
  if (shift < 3 || shift > 12 || intervals * POWERS[shift] < 64) {
    broken('NOI-003', `blocks of ${intervals} intervals of 2^${shift} ticks`, offset);
  }
  return { shift, intervals };
}

// G(q)
export function gainOf(q) {
  return q === 0 ? 0 : R[(q - 1) % 4] * POWERS[Math.floor((q - 1) / 4)];
}

// n[t]
export function noiseAt(seed, t, density) {
  let w = (seed + Math.imul(t, 2654435769)) | 0;
  w = Math.imul(w ^ (w >>> 16), 2246822507);
  w = Math.imul(w ^ (w >>> 13), 3266489909);
  w ^= w >>> 16;
  if (density > 0 && (w & 255) >= density) return 0;
  return 2 * (((w >>> 8) & 255) + ((w >>> 16) & 255) + (w >>> 24)) - 765;
}

export class Lattice {
  constructor(order) {
    this.K = new Float64Array(order);
    this.g = new Float64Array(order);
  }

  set(k) {
    for (let j = 0; j < k.length; j++) this.K[j] = k[j] < 0 ? -SINES[-k[j]] : SINES[k[j]];
  }

  // h[0] for an excitation.
  next(e) {
    const { K, g } = this;
    const m = K.length;
    let f = e;
    for (let j = m; j >= 1; j--) {
      const before = g[j - 1];
      f += rdiv(K[j - 1] * before, 32768);
      // g[j] was used for this tick already.
      if (j < m) g[j] = clamp(before - rdiv(K[j - 1] * f, 32768), LEAST, MOST);
    }
    f = clamp(f, LEAST, MOST);
    if (m > 0) g[0] = f;
    return f;
  }
}

function readHead(reader) {
  reader.requirement = 'NOI-005';
  const { offset } = reader;
  const m = reader.u8();
  if (m > ORDER_BOUND) broken('NOI-005', `a filter of order ${m}`, offset);
  const head = { m, density: reader.u8(), seed: reader.u32(), gain: reader.u8() };
  if (reader.left < (m > 0 ? 4 : 2)) broken('NOI-005', 'a component packet without its codings', reader.offset);
  if (head.gain > GAIN_BOUND) broken('NOI-006', `the gain index ${head.gain}`, reader.offset - 1);
  head.gains = readCoding(reader, 31);
  if (m > 0) head.coefficients = readCoding(reader, 15);
  return head;
}

function readCoding(reader, most) {
  const coding = reader.u8();
  if (coding > most) broken('RNG-004', `the coding ${coding}`, reader.offset - 1);
  return { number: coding & 15, states: coding & 16 ? 4 : 1, start: readStart(reader) };
}

// The gain indices of the intervals.
function readGains(coder, head, count) {
  const gains = new Float64Array(count);
  coder.integers(count - 1, head.gains.number, head.gains.start, true, gains.subarray(1));
  gains[0] = head.gain;
  for (let s = 1; s < count; s++) {
    gains[s] += gains[s - 1];
    if (gains[s] < 0 || gains[s] > GAIN_BOUND) broken('NOI-006', `the gain index ${gains[s]}`, coder.offset);
  }
  return gains;
}

// The coefficients of each block; of silent ones those of the block before.
function readBlocks(coder, head, gains, intervals) {
  const { m } = head;
  const loud = [];
  for (let s = 0; s < gains.length; s += intervals) loud.push(gains.subarray(s, s + intervals).some((q) => q > 0));
  const numbers = new Float64Array(m * loud.filter(Boolean).length);
  if (m > 0) coder.integers(numbers.length, head.coefficients.number, head.coefficients.start, true, numbers);
  for (let i = 0; i < numbers.length; i++) {
    if (i >= m) numbers[i] += numbers[i - m];
    if (Math.abs(numbers[i]) > COEFFICIENT_BOUND) broken('NOI-006', `the coefficient ${numbers[i]}`, coder.offset);
  }
  let at = -m;
  return loud.map((own) => {
    if (own) at += m;
    return at < 0 ? new Float64Array(m) : numbers.subarray(at, at + m);
  });
}

// Calls put(t, count) for each tick.
function synthesise(head, gains, blocks, { shift, intervals }, span, put) {
  const filter = new Lattice(head.m);
  const ticks = POWERS[shift];
  for (let s = 0; s < gains.length; s++) {
    const from = gainOf(gains[s > 0 ? s - 1 : 0]);
    const step = gainOf(gains[s]) - from;
    const start = s * ticks;
    const stop = Math.min(start + ticks, span);
    if (s % intervals === 0) filter.set(blocks[s / intervals]);
    if (from === 0 && step === 0) {
      filter.g.fill(0);
      for (let t = start; t < stop; t++) put(t, 0);
      continue;
    }
    for (let t = start; t < stop; t++) {
      const gain = from + Math.floor((step * (t - start)) / ticks);
      const e = rdiv(gain * noiseAt(head.seed, t, head.density), 1048576);
      put(t, rdiv(filter.next(e), 64));
    }
  }
}

function decodeComponent(bytes, offset, setup, span, put) {
  if (bytes.length === 0) {
    for (let t = 0; t < span; t++) put(t, 0);
    return;
  }
  const reader = new Reader(bytes, { base: offset });
  const head = readHead(reader);
  const coder = new EntropyDecoder(reader.bytes(reader.left), reader.offset, head.gains.states);
  const gains = readGains(coder, head, Math.ceil(span / POWERS[setup.shift]));
  const blocks = readBlocks(coder, head, gains, setup.intervals);
  coder.finish();
  synthesise(head, gains, blocks, setup, span, put);
}

export function decodeNois(track, bytes, span, out, offset) {
  const { componentCount: C, countMin: low, countMax: high, setup } = track;
  splitComponents(bytes, C, offset, 'LPC-001').forEach((part, c) => {
    decodeComponent(part.bytes, part.offset, setup, span, (t, count) => {
      out[t * C + c] = clamp(count, low, high);
    });
  });
}
