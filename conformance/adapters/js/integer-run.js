// Many integers of the model of 9.4 in a row: what IntegerModel.next() does, in one loop with its state in local
// variables, as long as 32 bits do. It takes two thirds of the time.
import { PAD, RATE, learnBit, probability } from './range.js';

// The buckets: E[k], and a[k] raw bits.
export const EDGES = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44];
export const BUCKET_BITS = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4];

const SMALL = 2 ** 22; // bound of both averages: h is below 12, and no integer takes more than one piece of raw bits
const ABOVE = 2 ** 19; // an integer from here on ends the run
const CONTEXTS = Uint16Array.from({ length: 2048 }, (_, S) => {
  const lg = S === 0 ? 0 : 31 - Math.clz32(S);
  return 16 * Math.max(0, 4 * lg + (((S << 2) >> lg) & 3) - 8); // S < 2048: lg is at most 10
});

// Puts integers at out[from], ... and gives the place behind the last one: `to`, or before an integer that is not small.
export function runSmall(model, out, from, to) {
  const { range, Z, G } = model;
  const { buffer, size } = range;
  const end = PAD + size - 1;
  let { f, s, t, g } = model;
  let { width, x, position, rawBits } = range;
  let done = from;
  while (done < to && f < SMALL && s < SMALL) {
    const S = (f + s) >> 1;
    let at;
    let h = 0;
    if (S < 2048) {
      at = CONTEXTS[S];
    } else {
      h = 21 - Math.clz32(S);
      at = 16 * (32 + ((S >> (h + 8)) & 3));
    }

    const last = at + 15; // RangeDecoder.symbol
    const n = Z[last];
    const R = RATE[n];
    const w = width - 16;
    let above = width;
    let v = 0;
    let i = at;
    for (; i < last; i++) {
      const z = Z[i];
      v = (Math.imul(w, z) >>> 16) + last - i;
      if (x >= v) break;
      above = v;
      Z[i] = z + (Math.imul(65535 - z, R) >> 16);
    }
    const k = i - at;
    if (k === 15) v = 0;
    for (; i < last; i++) Z[i] -= Math.imul(Z[i], R) >> 16;
    if (n < 250) Z[last] = n + 1;
    x -= v;
    width = above - v;
    if (width < 32768) {
      const bits = Math.clz32(width) - 16;
      const p = PAD + (position >> 3);
      const word = (buffer[p] << 24) | (buffer[p + 1] << 16) | (buffer[p + 2] << 8);
      width <<= bits;
      x = (x << bits) | ((word << (position & 7)) >>> (32 - bits));
      position += bits;
    }

    let u = k;
    if (k === 15) {
      range.width = width;
      range.x = x;
      range.position = position;
      range.rawBits = rawBits;
      u = model.large(h);
      ({ width, x, position, rawBits } = range);
    } else if (k > 9 || h > 0) {
      const bits = BUCKET_BITS[k] + h;
      const p = end - (rawBits >> 3);
      const word = buffer[p] | (buffer[p - 1] << 8) | (buffer[p - 2] << 16) | (buffer[p - 3] << 24);
      u = (EDGES[k] << h) + ((word >>> (rawBits & 7)) & ((1 << bits) - 1));
      rawBits += bits;
    }

    let negative = 0;
    if (u === 0) {
      g = 0;
    } else {
      const m = Math.imul(width, probability(G, g + 1)) >>> 16; // RangeDecoder.bit
      if (x < m) {
        negative = 1;
        width = m;
      } else {
        x -= m;
        width -= m;
      }
      if (width < 32768) {
        const bits = Math.clz32(width) - 16;
        const p = PAD + (position >> 3);
        const word = (buffer[p] << 24) | (buffer[p + 1] << 16) | (buffer[p + 2] << 8);
        width <<= bits;
        x = (x << bits) | ((word << (position & 7)) >>> (32 - bits));
        position += bits;
      }
      learnBit(G, g + 1, negative);
      g = negative ? -1 : 1;
    }
    if (position - 15 + rawBits > 8 * size) range.endsTooEarly();
    out[done++] = negative ? -u : u;
    const a = t < 63 ? 32 - Math.clz32(t + 1) : 7;
    t++;
    if (u >= ABOVE) {
      f += Math.floor((256 * u - f) / 8);
      s += Math.floor((256 * u - s) / (1 << a));
      break;
    }
    f += ((u << 8) - f) >> 3;
    s += ((u << 8) - s) >> a;
  }
  Object.assign(model, { f, s, t, g });
  Object.assign(range, { width, x, position, rawBits });
  return done;
}
