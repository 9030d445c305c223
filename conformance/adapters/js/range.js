// Adaptive coding (9.4): bit models, symbol models, the range decoder and its raw bits.
import { broken } from './error.js';

export const PAD = 64; // zeros on either side of the coded bytes: both ends are checked after each symbol only

// Several bit models in one array, four places each: p, q, n and one that is free.
export function bitModels(count) {
  const models = new Int32Array(4 * count);
  for (let i = 0; i < models.length; i += 4) models[i] = models[i + 1] = 32768;
  return models;
}

// 131072 // (2*n + 3) for n = 0 to 250.
export const RATE = Int32Array.from({ length: 251 }, (_, n) => Math.floor(131072 / (2 * n + 3)));

export function probability(models, i) {
  const at = 4 * i;
  const P = models[at + 2] < 8 ? models[at] : (3 * models[at] + models[at + 1]) >> 2;
  return P < 64 ? 64 : P > 65472 ? 65472 : P;
}

export function learnBit(models, i, b) {
  const at = 4 * i;
  const p = models[at];
  const n = models[at + 2];
  const d = (b === 0 ? 0 : 65535) - p;
  // The first product is the only one that takes more than 31 bits.
  models[at] = p + (n === 0 ? Math.floor((d * 43690) / 65536) : Math.imul(d, RATE[n]) >> 16);
  models[at + 1] += ((b === 0 ? 0 : 65535) - models[at + 1]) >> 4;
  if (n < 250) models[at + 2] = n + 1;
}

// Several symbol models in one array, 16 places each: z[0] to z[14] and n.
export function learnSymbol(models, at, s) {
  const n = models[at + 15];
  const R = RATE[n];
  for (let i = at; i < at + s; i++) models[i] += Math.imul(65535 - models[i], R) >> 16;
  for (let i = at + s; i < at + 15; i++) models[i] -= Math.imul(models[i], R) >> 16;
  if (n < 250) models[at + 15] = n + 1;
}

export class RangeDecoder {
  constructor(bytes, offset = 0) {
    this.buffer = new Uint8Array(bytes.length + 2 * PAD);
    this.buffer.set(bytes, PAD);
    this.size = bytes.length;
    this.offset = offset;
    this.width = 32768;
    this.position = 0; // N: bits of the number that were read
    this.x = this.front(15);
    this.rawBits = 0; // W
  }

  // The next k bits of the number, 1 <= k <= 16.
  front(k) {
    const at = PAD + (this.position >> 3);
    const word = (this.buffer[at] << 24) | (this.buffer[at + 1] << 16) | (this.buffer[at + 2] << 8);
    const bits = (word << (this.position & 7)) >>> (32 - k);
    this.position += k;
    return bits;
  }

  renew() {
    const k = Math.clz32(this.width) - 16;
    this.width <<= k;
    this.x = (this.x << k) | this.front(k);
    this.check();
  }

  check() {
    if (this.position - 15 + this.rawBits > 8 * this.size) this.endsTooEarly();
  }

  endsTooEarly() {
    broken('RNG-001', 'the coded bytes end too early', this.offset + this.size);
  }

  bit(models, i) {
    const m = Math.imul(this.width, probability(models, i)) >>> 16;
    let b = 0;
    if (this.x < m) {
      b = 1;
      this.width = m;
    } else {
      this.x -= m;
      this.width -= m;
    }
    if (this.width < 32768) this.renew();
    learnBit(models, i, b);
    return b;
  }

  // Finds the symbol and learns it (learnSymbol) in one pass.
  symbol(models, at) {
    const w = this.width - 16;
    const { x } = this;
    const end = at + 15;
    const n = models[end];
    const R = RATE[n];
    let above = this.width;
    let v = 0;
    let i = at;
    for (; i < end; i++) {
      const z = models[i];
      v = (Math.imul(w, z) >>> 16) + end - i;
      if (x >= v) break;
      above = v;
      models[i] = z + (Math.imul(65535 - z, R) >> 16);
    }
    if (i === end) v = 0;
    const s = i - at;
    for (; i < end; i++) models[i] -= Math.imul(models[i], R) >> 16;
    if (n < 250) models[end] = n + 1;
    this.x = x - v;
    this.width = above - v;
    if (this.width < 32768) this.renew();
    return s;
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
    this.check();
    return (word >>> (W & 7)) & ((1 << k) - 1);
  }

  // After the last symbol: RNG-001.
  finish() {
    const N = this.position;
    const W = this.rawBits;
    const end = this.offset + this.size;
    let X = 0; // the last 16 of the N bits read, with a 0 before the first where N = 15
    for (let i = Math.max(N - 16, 0); i < N; i++) {
      X = 2 * X + ((this.buffer[PAD + (i >> 3)] >> (7 - (i & 7))) & 1);
    }
    const low = (X - this.x) & 0xffff;
    let r = 15;
    let v = Math.ceil(low / 32768) * 32768;
    if (v + 32768 > low + this.width) {
      r = 14;
      v = Math.ceil(low / 16384) * 16384;
    }
    if (low + this.x < v || low + this.x >= v + 2 ** r) {
      broken('RNG-001', 'the coded bytes have another front than their symbols call for', end);
    }
    if (this.size !== Math.ceil((N - r + W) / 8)) {
      broken('RNG-001', 'the coded bytes are more or fewer than their symbols call for', end);
    }
    for (let i = N - r; i < 8 * this.size - W; i++) {
      if ((this.buffer[PAD + (i >> 3)] >> (7 - (i & 7))) & 1) {
        broken('RNG-001', 'bits between front and back of the coded bytes that are not 0', end);
      }
    }
  }
}
