// MDCT (9.8): coefficients of two quantisers that alternate, and their lapped transform. Every sum stays below 2^53.
import { Reader } from './bytes.js';
import { EntropyDecoder, averageFrom, classEnds, contextOf, readStart } from './entropy.js';
import { broken } from './error.js';
import { clamp, rdiv } from './integers.js';
import { limitsOf } from './limits.js';
import { splitComponents } from './lpcr.js';

const STEP_BOUND = 2 ** 32;
const WEIGHTS_BOUND = 128;
const SUM_BOUND = 2 ** 36;

// next(state, u % 2) at 2 * state + u % 2.
const NEXT = [0, 2, 5, 7, 1, 3, 4, 6, 2, 0, 7, 5, 3, 1, 6, 4];

// C(0) to C(1024). No entry lies within 0.0005 of a tie: any Math.cos gives these.
export const COSINES = Float64Array.from({ length: 1025 }, (_, i) => (
  Math.round(32768 * Math.cos((Math.PI * i) / 2048))
));

// C(i)
export function cosine(i) {
  let n = Math.abs(i) % 4096;
  if (n > 2048) n = 4096 - n;
  return n <= 1024 ? COSINES[n] : -COSINES[2048 - n];
}

class Transform {
  constructor(M) {
    const D = 512 / M;
    const row = (of) => Float64Array.from({ length: M / 2 }, (_, i) => of(i));
    this.size = M;
    this.waves = Array.from({ length: M }, (_, k) => (
      Float64Array.from({ length: M }, (_, j) => cosine((2 * j + 1) * (2 * k + 1) * D))
    ));
    this.w = row((i) => cosine((M - 2 * i - 1) * D));
    this.z = row((i) => cosine((M + 2 * i + 1) * D));
  }

  // A block's v of its first coefficients, X; the others are 0.
  unfold(X, v) {
    v.fill(0);
    for (let k = 0; k < X.length; k++) {
      const x = X[k];
      if (x === 0) continue;
      const wave = this.waves[k];
      for (let j = 0; j < v.length; j++) v[j] += x * wave[j];
    }
    for (let j = 0; j < v.length; j++) v[j] = rdiv(v[j], 32768);
    return v;
  }

  // x in place of v, in the second half of a block and in the first half of the next one; null: there is none.
  mix(before, behind) {
    const { size: M, w, z } = this;
    for (let i = 0; i < M / 2; i++) {
      if (before === null || behind === null) {
        if (before) before[M - 1 - i] = rdiv(before[M - 1 - i], 256);
        if (behind) behind[i] = rdiv(behind[i], 256);
        continue;
      }
      const left = before[M - 1 - i];
      const right = behind[i];
      before[M - 1 - i] = rdiv(w[i] * left + z[i] * right, 8388608);
      behind[i] = rdiv(w[i] * right - z[i] * left, 8388608);
    }
  }
}

const transforms = new Map();

export function transformOf(M) {
  if (!transforms.has(M)) transforms.set(M, new Transform(M));
  return transforms.get(M);
}

export function parseMdct(reader) {
  const { offset } = reader;
  const m = reader.u8();
  const step = reader.varint();
  const n = reader.u8();
  const M = 2 ** m;
  if (m < 5 || m > 9) broken('MDC-001', `blocks of 2^${m}`, offset);
  if (step < 1 || step > STEP_BOUND) broken('MDC-001', `step ${step}`, offset);
  if (n > WEIGHTS_BOUND || n > M || (n & (n - 1)) !== 0) broken('MDC-001', `${n} weights`, offset);
  reader.requirement = 'COD-002';
  const weights = reader.bytes(n);
  const factor = (k) => weights[Math.floor((k * n) / M)];
  const steps = n === 0 ? new Float64Array(M).fill(step)
    : Float64Array.from({ length: M }, (_, k) => Math.max(1, rdiv(step * factor(k), 32)));
  return { size: M, steps };
}

export function readHeader(reader, M, countBound) {
  const { offset } = reader;
  const base = reader.svarint();
  const kept = reader.varint();
  if (Math.abs(base) > countBound) broken('MDC-002', `base ${base}`, offset);
  if (kept > M) broken('MDC-002', `${kept} coefficients of ${M}`, offset);
  if (kept === 0) {
    if (reader.left > 0) broken('COD-001', 'bytes after a constant', reader.offset);
    return { base, kept };
  }
  reader.requirement = 'RNG-004';
  const classes = reader.u8();
  return { base, kept, classes: [classes & 15, classes >> 4], start: readStart(reader) };
}

// The coefficients of one block after the other.
export class Coefficients {
  constructor({ kept, classes, start }, steps, bytes, offset) {
    this.ends = classes.map(classEnds);
    this.coder = new EntropyDecoder(bytes, offset, 1);
    this.coder.section();
    this.steps = steps;
    this.offset = offset;
    this.state = 0;
    this.P = new Float64Array(kept).fill(averageFrom(start));
    this.E = this.P.slice();
    this.u = new Float64Array(kept);
    this.seen = null; // where an array, takes [c, h, state] of each coefficient
  }

  next(X) {
    const { ends, coder, steps, P, E, u } = this;
    const last = P.length - 1;
    let a1 = E[0];
    let a2 = a1;
    let sum = 0;
    for (let k = 0; k <= last; k++) {
      const near = P[k > 0 ? k - 1 : 0] + P[k < last ? k + 1 : last];
      const { c, h } = contextOf(Math.floor((8 * a1 + 4 * a2 + 4 * P[k] + 3 * near + 10 * E[k]) / 32));
      if (this.seen) this.seen.push([c, h, this.state]);
      const Q = this.state % 2;
      const integer = coder.integer(ends[Q], c, h);
      const magnitude = Math.abs(integer);
      u[k] = magnitude;
      // Beyond 2^53 the product is rounded, and far beyond the bound.
      const x = Math.max(2 * magnitude - Q, 0) * steps[k];
      sum += x;
      if (sum > SUM_BOUND) broken('MDC-003', 'coefficients of a block that are too large', this.offset);
      X[k] = integer < 0 ? -x : x;
      this.state = NEXT[2 * this.state + (magnitude % 2)];
      a2 = a1;
      a1 = 256 * magnitude;
    }
    for (let k = 0; k <= last; k++) {
      P[k] = 256 * u[k];
      E[k] += Math.floor((P[k] - E[k]) / 4);
    }
  }

  finish() {
    this.coder.finish();
  }
}

// Calls put(at, x) with the tick and the samples of each block.
function decodeBlocks({ size: M, steps }, header, bytes, span, offset, put) {
  const coefficients = new Coefficients(header, steps, bytes, offset);
  const transform = transformOf(M);
  const X = new Float64Array(header.kept);
  let before = null;
  let spare = new Float64Array(M);
  for (let at = 0; at < span; at += M) {
    coefficients.next(X);
    const now = transform.unfold(X, spare);
    transform.mix(before, now);
    if (before) put(at - M, before);
    spare = before ?? new Float64Array(M);
    before = now;
  }
  coefficients.finish();
  transform.mix(before, null);
  put(M * Math.floor((span - 1) / M), before);
}

// Calls put(component, at, x, b) with the samples x from tick at on, the counts being b + x.
export function decodeTransformed(setup, componentCount, bytes, span, countBound, offset, put) {
  splitComponents(bytes, componentCount, offset).forEach((part, component) => {
    const reader = new Reader(part.bytes, { base: part.offset });
    const header = readHeader(reader, setup.size, countBound);
    const { base, kept } = header;
    if (kept === 0) {
      put(component, 0, new Float64Array(span), base);
      return;
    }
    decodeBlocks(setup, header, reader.bytes(reader.left), span, reader.offset, (at, x) => put(component, at, x, base));
  });
}

export function decodeMdct(track, bytes, span, out, offset) {
  const { componentCount: C, countMin: low, countMax: high, setup, level } = track;
  const { countBound } = limitsOf(level);
  decodeTransformed(setup, C, bytes, span, countBound, offset, (component, start, x, base) => {
    const stop = Math.min(start + x.length, span);
    for (let t = start; t < stop; t++) out[t * C + component] = clamp(base + x[t - start], low, high);
  });
}
