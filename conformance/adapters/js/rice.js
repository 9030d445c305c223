// Rice codes of LPCR (9.5, flag Rice).
import { BitReader } from './bits.js';
import { broken } from './error.js';
import { POWERS } from './integers.js';

const BLOCK = 32;
const ZERO_BOUND = 24;

function riceCode(bits, k) {
  let n = 0;
  while (n < ZERO_BOUND && bits.bit() === 0) n++;
  const u = n < ZERO_BOUND ? n * POWERS[k] + bits.take(k) : bits.take(35);
  return u % 2 === 0 ? u / 2 : -(u + 1) / 2;
}

export function decodeRice(bytes, count, out, offset) {
  const bits = new BitReader(bytes);
  let w = 0;
  for (let t = 0; t < count; t += BLOCK) {
    const end = Math.min(t + BLOCK, count);
    w += riceCode(bits, 0);
    if (w < 0 || w > 31) broken('LPC-011', `width ${w}`, offset);
    if (w === 0) out.fill(0, t, end);
    else for (let i = t; i < end; i++) out[i] = riceCode(bits, w - 1);
    if (bits.position > bits.size) broken('LPC-012', 'Rice codes are missing', offset + bytes.length);
  }
  if (bits.usedBytes !== bytes.length) broken('LPC-012', 'bytes after the last Rice code', offset + bits.usedBytes);
  if (!bits.filledWithZeros) broken('LPC-012', 'bits after the last Rice code that are not 0', offset + bytes.length);
}
