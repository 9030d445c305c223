// The predictor of LPCR (9.5) and its sine table (Annex C).
import { broken } from './error.js';
import { rdiv } from './integers.js';

// 32768 * sin(pi * k / 256), rounded. No entry lies within 0.001 of a tie: any Math.sin gives these.
export const SINES = Int32Array.from({ length: 128 }, (_, k) => Math.round(32768 * Math.sin((Math.PI * k) / 256)));

const P_BOUND = 2 ** 36;
const C_BOUND = 2 ** 21;

// c[1] ... c[m] from k[1] ... k[m], both counted from 0 here.
export function predictorOf(k, offset = 0) {
  let p = [];
  for (let n = 0; n < k.length; n++) {
    const K = k[n] < 0 ? -SINES[-k[n]] : SINES[k[n]];
    const next = new Array(n + 1);
    for (let j = 0; j < n; j++) next[j] = p[j] - rdiv(K * p[n - 1 - j], 32768);
    next[n] = K * 32;
    if (next.some((v) => Math.abs(v) > P_BOUND)) broken('LPC-005', 'a predictor that is too large', offset);
    p = next;
  }
  const c = Float64Array.from(p, (v) => rdiv(v, 128));
  if (c.some((v) => Math.abs(v) > C_BOUND)) broken('LPC-005', 'a predictor that is too large', offset);
  return c;
}

function sumOfMagnitudes(c) {
  let sum = 0;
  for (const v of c) sum += Math.abs(v);
  return sum;
}

// Up to which |y| the sum of products and 4096 stay below 2^53.
export function quickBound(c) {
  return Math.floor((2 ** 53 - 4096) / Math.max(sumOfMagnitudes(c), 1));
}

// (sum of c[j] * y[t - 1 - j] + 4096) // 8192. r: the predictor backwards; y of tick t lies at t + m, m zeros before it.
export function predictQuick(r, m, y, t) {
  let a = 4096;
  let b = 0;
  let i = 0;
  for (; i + 1 < m; i += 2) {
    a += r[i] * y[t + i];
    b += r[i + 1] * y[t + i + 1];
  }
  if (i < m) a += r[i] * y[t + i];
  return Math.floor((a + b) * (1 / 8192));
}

// The same beyond 2^53 (level 2): y in two parts, the products of each below 2^48, the upper ones whole after the
// division.
export function predictExact(r, m, y, t) {
  let upper = 0;
  let lower = 4096;
  for (let i = 0; i < m; i++) {
    const v = y[t + i];
    const high = Math.floor(v / 131072);
    upper += r[i] * high;
    lower += r[i] * (v - high * 131072);
  }
  return upper * 16 + Math.floor(lower / 8192);
}
