// The encoder of 9.4: sections of symbols are noted, and coded from the last to the first.
import {
  BUCKET_BITS, C, D, EDGES, FRESH, averageFrom, classEnds, contextOf, learn, loudOf, nearOf,
} from '../../../hapfmt/viewer/decoder/entropy.js';
import { POWERS, bitLength } from '../../../hapfmt/viewer/decoder/integers.js';

const LEAST = 65536;
const MANY = 4096; // symbols from which on four states are taken

export class EntropyEncoder {
  constructor() {
    this.sections = [];
    this.back = []; // raw bits
    this.alone = false; // one state, however many symbols
  }

  section() {
    this.sections.push([]);
  }

  // A symbol as [first, width] of its share.
  note(first, width) {
    this.sections[this.sections.length - 1].push([first, width]);
  }

  bit(p, bit) {
    if (bit === 1) this.note(4096 - 16 * p, 16 * p);
    else this.note(0, 4096 - 16 * p);
  }

  raw(value, k) {
    for (let i = 0; i < k; i++) this.back.push(Math.floor(value / POWERS[i]) % 2);
  }

  // A section of integers with raw signs; the class and the start byte are the caller's choice.
  integers(e, number, start) {
    this.section();
    const ends = classEnds(number);
    let f = averageFrom(start);
    let s = f;
    for (let from = 0; from < e.length; from += 8) {
      const { c, h } = contextOf(Math.floor((f + s) / 2));
      let sum = 0;
      for (let i = from; i < Math.min(from + 8, e.length); i++) {
        const u = Math.abs(e[i]);
        const w = Math.floor(u / POWERS[h]);
        let k = 15;
        while (EDGES[k] > w) k--;
        const first = k > 0 ? ends[16 * c + k - 1] : 0;
        this.note(first, ends[16 * c + k] - first);
        if (k === 15) {
          const l = bitLength(w - 43) - 1;
          this.raw(l, 6);
          this.raw(w - 43 - POWERS[l], l);
          this.raw(u % POWERS[h], h);
        } else {
          this.raw(u - EDGES[k] * POWERS[h], BUCKET_BITS[k] + h);
        }
        if (u > 0) this.raw(e[i] < 0 ? 1 : 0, 1);
        sum += u;
      }
      f += Math.floor((32 * sum - f) / 2);
      s += Math.floor((3 * (32 * sum - s)) / 16);
    }
  }

  // A section of integers by bits, with signs or without; the coder has one state.
  byBits(e, signed) {
    this.section();
    const models = FRESH.slice();
    const flag = (bit, places) => {
      const width = places.reduce((sum, place) => sum + (models[place] >>> 8), 0) >> (places.length === 2 ? 5 : 4);
      this.note(bit === 1 ? 4096 - width : 0, bit === 1 ? width : 4096 - width);
      places.forEach((place, i) => { models[place] = learn(models[place], bit, i === 0 && places.length === 2 ? 5 : 7); });
    };
    let [a, b, s, d] = [0, 0, 0, 0];
    for (const integer of e) {
      const u = Math.abs(integer);
      const last = u < 3 ? u : bitLength(u - 1) + 1;
      for (let k = 0; k <= last; k++) flag(k === last ? 1 : 0, [nearOf(a, b) + k, loudOf(s) + k]);
      if (last > 2) {
        const half = POWERS[last - 3];
        flag(Math.floor((u - 1) / half) - 2, [C + last]);
        this.raw((u - 1) % half, last - 3);
      }
      if (signed && u > 0) {
        flag(integer < 0 ? 1 : 0, [D + d]);
        d = integer < 0 ? 2 : 1;
      }
      b = a;
      a = u;
      s += Math.floor((64 * u - s) / 8);
    }
    this.alone = true;
  }

  get many() {
    return !this.alone && this.sections.reduce((sum, section) => sum + section.length, 0) >= MANY;
  }

  finish() {
    const states = new Array(this.many ? 4 : 1).fill(LEAST);
    const words = [];
    for (const section of this.sections.slice().reverse()) {
      for (let i = section.length - 1; i >= 0; i--) {
        const [first, width] = section[i];
        const lane = i % states.length;
        let x = states[lane];
        if (x >= width * 1048576) {
          words.push(x % 65536);
          x = Math.floor(x / 65536);
        }
        states[lane] = Math.floor(x / width) * 4096 + (x % width) + first;
      }
    }
    const { back } = this;
    const front = states.flatMap((x) => [Math.floor(x / 65536), x % 65536]).concat(words.reverse());
    const bytes = new Uint8Array(2 * front.length + Math.ceil(back.length / 8));
    front.forEach((word, i) => {
      bytes[2 * i] = word >> 8;
      bytes[2 * i + 1] = word & 255;
    });
    back.forEach((bit, i) => { bytes[bytes.length - 1 - (i >> 3)] |= bit << (i & 7); });
    return bytes;
  }
}

// The byte for averages like those of the first integers.
export function startOf(e) {
  const few = Array.from(e.slice(0, 16), Math.abs);
  const mean = Math.floor((256 * few.reduce((sum, u) => sum + u, 0)) / Math.max(few.length, 1));
  const lg = bitLength(mean) - 1;
  return mean < 4 ? 0 : 4 * (lg - 2) + (Math.floor(mean / POWERS[lg - 2]) % 4);
}

export function probabilityOf(zeros, ones) {
  const n = zeros + ones;
  return n === 0 ? 128 : Math.min(Math.max(Math.floor((256 * ones + (n >> 1)) / n), 1), 255);
}
