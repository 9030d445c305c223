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

// The predictor c as the functions below take it: backwards, of a multiple of four coefficients, behind three zeros.
export function tapsOf(c) {
  const width = (c.length + 3) & ~3;
  const r = new Float64Array(width + 3);
  for (let j = 0; j < c.length; j++) r[width + 2 - j] = c[j];
  return { r, width };
}

// The sum of c[j] * y[t + i - j] and 4096 for four ticks t + i at once, without their products of y[t] and later, put at
// sums[i]. y of tick t lies at t + width.
export function sumFour({ r, width }, y, t, sums) {
  let s0 = 4096;
  let s1 = 4096;
  let s2 = 4096;
  let s3 = 4096;
  let c1 = r[0];
  let c2 = r[1];
  let c3 = r[2];
  for (let i = 0; i < width; i += 4, t += 4) {
    const y0 = y[t];
    const y1 = y[t + 1];
    const y2 = y[t + 2];
    const y3 = y[t + 3];
    const c4 = r[i + 3];
    const c5 = r[i + 4];
    const c6 = r[i + 5];
    const c7 = r[i + 6];
    s0 += c4 * y0 + c5 * y1 + (c6 * y2 + c7 * y3);
    s1 += c3 * y0 + c4 * y1 + (c5 * y2 + c6 * y3);
    s2 += c2 * y0 + c3 * y1 + (c4 * y2 + c5 * y3);
    s3 += c1 * y0 + c2 * y1 + (c3 * y2 + c4 * y3);
    c1 = c5;
    c2 = c6;
    c3 = c7;
  }
  sums[0] = s0;
  sums[1] = s1;
  sums[2] = s2;
  sums[3] = s3;
}

// Whether all sums are, of g-th differences of indices up to `highest` less one of them.
export function isQuick(c, g, highest) {
  return 2 * highest * 2 ** g < quickBound(c);
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
