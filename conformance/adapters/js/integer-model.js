// The integer model of 9.4, which LPCR codes its prediction errors with.
import { broken } from './error.js';
import { bitLength } from './integers.js';
import { bitModels } from './range.js';

export const EDGES = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44];
export const BUCKET_BITS = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4];
const CONTEXTS = 36;

// z[0] ... z[14] and n of the 36 models Z, 16 places each (First probabilities).
const FIRST_Z = new Int32Array(16 * CONTEXTS);
for (let c = 0; c < CONTEXTS; c++) {
  const lg = (c + 8) >> 2;
  const fr = (c + 8) % 4;
  const M = Math.floor(((9 + 2 * fr) * 2 ** lg) / 8) + 5;
  const T = Math.floor((65536 * M) / (M + 256));
  let tail = 65536;
  let w = 0;
  for (let i = 0; i < 15; i++) {
    for (; w < EDGES[i + 1]; w++) tail = Math.floor((tail * T) / 65536);
    FIRST_Z[16 * c + i] = tail;
  }
  FIRST_Z[16 * c + 15] = 10;
}
const FIRST_Y = Int32Array.from({ length: 16 }, (_, i) => (i < 15 ? 4096 * (15 - i) : 2));

export class IntegerModel {
  constructor(range, rawSigns = false) {
    this.range = range;
    this.rawSigns = rawSigns;
    this.Z = FIRST_Z.slice();
    this.Y = FIRST_Y.slice();
    this.G = bitModels(3);
    this.f = 32;
    this.s = 32;
    this.t = 0;
    this.g = 0;
  }

  // c, the model that the next bucket is coded with, and h.
  context() {
    const S = Math.floor((this.f + this.s) / 2);
    const lg = S === 0 ? 0 : bitLength(S) - 1;
    const fr = (lg < 29 ? (S * 4) >> lg : Math.floor(S / 2 ** (lg - 2))) & 3;
    return { context: Math.max(0, 4 * Math.min(lg, 10) + fr - 8), h: lg > 10 ? lg - 10 : 0 };
  }

  next() {
    const { range } = this;
    const { context, h } = this.context();
    const k = range.symbol(this.Z, 16 * context);
    let u = k;
    if (k === 15) {
      let l = range.symbol(this.Y, 0);
      if (l === 15) l += range.raw(5);
      const w = 43 + 2 ** l + range.raw(l);
      // RNG-003 before the shift: w is below 2^47 + 43, h at most 31 (Annex A).
      if (w >= 2 ** (34 - h)) broken('RNG-003', 'a coded integer of 2^34 or more', range.offset);
      u = w * 2 ** h + range.raw(h);
    } else if (k > 9 || h > 0) {
      u = EDGES[k] * 2 ** h + range.raw(BUCKET_BITS[k] + h);
      if (u >= 2 ** 34) broken('RNG-003', 'a coded integer of 2^34 or more', range.offset);
    }
    let negative = 0;
    if (u > 0) negative = this.rawSigns ? range.raw(1) : range.bit(this.G, this.g + 1);
    this.g = u === 0 ? 0 : negative ? -1 : 1;
    const U = 256 * u;
    const a = this.t < 63 ? bitLength(this.t + 1) : 7;
    this.f += Math.floor((U - this.f) / 8);
    this.s += Math.floor((U - this.s) / 2 ** a);
    this.t++;
    return negative ? -u : u;
  }

  fill(out, count) {
    for (let i = 0; i < count; i++) out[i] = this.next();
  }
}
