// The encoder of 9.4, with the models of the decoder.
import { IntegerModel } from './integer-model.js';
import { BUCKET_BITS, EDGES } from './integer-run.js';
import { POWERS, bitLength } from './integers.js';
import { RangeDecoder, learnBit, learnSymbol, probability } from './range.js';

export class RangeEncoder {
  constructor() {
    this.bits = []; // of low, all but the last 15
    this.low = 0; // those
    this.width = 32768;
    this.back = []; // raw bits
  }

  add(amount) {
    this.low += amount;
    for (let carry = this.low >> 15, i = this.bits.length - 1; carry > 0; i--) {
      carry += this.bits[i];
      this.bits[i] = carry & 1;
      carry >>= 1;
    }
    this.low &= 32767;
  }

  renew() {
    while (this.width < 32768) {
      this.width *= 2;
      this.bits.push(this.low >> 14);
      this.low = (this.low * 2) & 32767;
    }
  }

  bit(models, i, b) {
    const m = Math.imul(this.width, probability(models, i)) >>> 16;
    if (b === 1) {
      this.width = m;
    } else {
      this.add(m);
      this.width -= m;
    }
    this.renew();
    learnBit(models, i, b);
  }

  symbol(models, at, s) {
    const v = (i) => (i === 15 ? 0 : (Math.imul(this.width - 16, models[at + i]) >>> 16) + 15 - i);
    const from = v(s);
    const width = (s === 0 ? this.width : v(s - 1)) - from;
    this.add(from);
    this.width = width;
    this.renew();
    learnSymbol(models, at, s);
  }

  raw(value, k) {
    for (let i = 0; i < k; i++) this.back.push(Math.floor(value / POWERS[i]) % 2);
  }

  // End.
  finish() {
    const { bits, back, width } = this;
    const { low } = this;
    const whole = low === 0 ? 0 : 32768;
    this.low = 0;
    if (whole - low + 32768 <= width) {
      this.add(whole);
    } else {
      const v = Math.ceil(low / 16384) * 16384;
      this.add(v);
      bits.push(this.low >> 14);
    }
    const bytes = new Uint8Array(Math.ceil((bits.length + back.length) / 8));
    bits.forEach((bit, i) => { bytes[i >> 3] |= bit << (7 - (i & 7)); });
    back.forEach((bit, i) => { bytes[bytes.length - 1 - (i >> 3)] |= bit << (i & 7); });
    return bytes;
  }
}

export class IntegerEncoder {
  constructor(range) {
    this.range = range;
    this.model = new IntegerModel(new RangeDecoder(new Uint8Array(0)));
  }

  put(e) {
    const { range, model } = this;
    const u = Math.abs(e);
    const at = 16 * model.context();
    const { h } = model;
    const w = Math.floor(u / POWERS[h]);
    let k = 15;
    while (EDGES[k] > w) k--;
    range.symbol(model.Z, at, k);
    if (k === 15) {
      const y = w - 43;
      const l = bitLength(y) - 1;
      range.symbol(model.Y, 0, Math.min(l, 15));
      if (l >= 15) range.raw(l - 15, 5);
      range.raw(y - POWERS[l], l);
      range.raw(u % POWERS[h], h);
    } else {
      range.raw(u - EDGES[k] * POWERS[h], BUCKET_BITS[k] + h);
    }
    if (u > 0) range.bit(model.G, model.g + 1, e < 0 ? 1 : 0);
    model.g = Math.sign(e);
    model.learn(u);
  }
}
