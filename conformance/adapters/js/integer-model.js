// The integer model of 9.4, which LPCR codes its prediction errors with.
import { broken } from './error.js';
import { POWERS, bitLength } from './integers.js';
import { BUCKET_BITS, EDGES, runSmall } from './integer-run.js';
import { bitModels } from './range.js';

const CONTEXTS = 36;
const MAGNITUDE_BOUND = 2 ** 34;
const SMALL = 2 ** 29; // below it integers of 32 bits do

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
  constructor(range) {
    this.range = range;
    this.Z = FIRST_Z.slice();
    this.Y = FIRST_Y.slice();
    this.G = bitModels(3);
    this.f = 32;
    this.s = 32;
    this.t = 0;
    this.g = 0;
    this.h = 0;
  }

  // c, the model that the next bucket is coded with; and this.h.
  context() {
    const { f, s } = this;
    let lg;
    let fr;
    if (f < SMALL && s < SMALL) {
      const S = (f + s) >> 1;
      lg = S === 0 ? 0 : 31 - Math.clz32(S);
      fr = ((S << 2) >> lg) & 3;
    } else {
      const S = Math.floor((f + s) / 2);
      lg = bitLength(S) - 1;
      fr = Math.floor(S / POWERS[lg - 2]) & 3;
    }
    this.h = lg > 10 ? lg - 10 : 0;
    const c = 4 * (lg < 10 ? lg : 10) + fr - 8;
    return c > 0 ? c : 0;
  }

  next() {
    const { range } = this;
    const k = range.symbol(this.Z, 16 * this.context());
    const { h } = this;
    let u = k;
    if (k === 15) {
      u = this.large(h);
    } else if (k > 9 || h > 0) {
      u = EDGES[k] * POWERS[h] + range.raw(BUCKET_BITS[k] + h);
      if (u >= MAGNITUDE_BOUND) this.tooLarge();
    }
    let negative = 0;
    if (u > 0) negative = range.bit(this.G, this.g + 1);
    this.g = u === 0 ? 0 : negative ? -1 : 1;
    this.learn(u);
    return negative ? -u : u;
  }

  // Step 2, after the bucket 15.
  large(h) {
    const { range } = this;
    let l = range.symbol(this.Y, 0);
    if (l === 15) l += range.raw(5);
    const w = 43 + POWERS[l] + range.raw(l);
    // RNG-003 before the shift: w is below 2^47 + 43, h at most 31 (Annex A).
    if (w >= POWERS[34 - h]) this.tooLarge();
    return w * POWERS[h] + range.raw(h);
  }

  learn(u) {
    const { f, s, t } = this;
    const a = t < 63 ? 32 - Math.clz32(t + 1) : 7;
    this.t = t + 1;
    if (u < SMALL / 256 && f < SMALL && s < SMALL) {
      this.f = f + (((u << 8) - f) >> 3);
      this.s = s + (((u << 8) - s) >> a);
    } else {
      this.f = f + Math.floor((256 * u - f) / 8);
      this.s = s + Math.floor((256 * u - s) / POWERS[a]);
    }
  }

  tooLarge() {
    broken('RNG-003', 'a coded integer of 2^34 or more', this.range.offset);
  }

  fill(out, count) {
    for (let i = 0; i < count;) {
      i = runSmall(this, out, i, count);
      if (i < count) out[i++] = this.next();
    }
  }
}
