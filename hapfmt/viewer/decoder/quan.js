// QUAN (9.2): levels in canonical Huffman code words, with symbols for runs of level 0.
import { BitReader } from './bits.js';
import { broken } from './error.js';
import { POWERS, clamp } from './integers.js';
import { limitsOf } from './limits.js';

const SYMBOL_BOUND = 4096;

// Lengths of the code words, one for each symbol that is described.
export function readCodebook(bytes, symbolCount, offset = 0) {
  const lengths = new Uint8Array(symbolCount);
  const nibble = (i) => (bytes[i >> 1] >> (i & 1 ? 0 : 4)) & 15;
  const end = 2 * bytes.length;
  let symbol = 0;
  for (let i = 0; i < end; i++) {
    const length = nibble(i);
    if (length === 0 && i + 1 === end) break;
    const next = symbol + (length === 0 ? nibble(++i) + 1 : 1);
    if (next > symbolCount) broken('QNT-003', 'a codebook of more symbols than there are', offset + (i >> 1));
    if (length > 0) lengths[symbol] = length;
    symbol = next;
  }
  return lengths;
}

// The canonical code: `table` gives 16 * symbol + length for the next `bits` bits; bits 0: one symbol, no bits.
export function makeCode(lengths, offset = 0) {
  const counts = new Int32Array(16);
  for (const length of lengths) if (length > 0) counts[length]++;
  let used = 0;
  let sum = 0;
  let bits = 0;
  for (let n = 1; n < 16; n++) {
    used += counts[n];
    sum += counts[n] << (15 - n);
    if (counts[n] > 0) bits = n;
  }
  if (used === 1 && bits === 1) {
    return { bits: 0, table: Uint16Array.of(16 * lengths.findIndex((length) => length > 0)) };
  }
  if (sum !== 32768) broken('QNT-003', 'code words that are not complete', offset);
  const table = new Uint16Array(1 << bits);
  let at = 0;
  for (let n = 1; n <= bits; n++) {
    if (counts[n] === 0) continue;
    for (let symbol = 0; symbol < lengths.length; symbol++) {
      if (lengths[symbol] === n) table.fill(16 * symbol + n, at, (at += 1 << (bits - n)));
    }
  }
  return { bits, table };
}

export function parseQuan(reader, track) {
  const { offset } = reader;
  const step = reader.u32();
  const M = reader.u16();
  const R = reader.u8();
  const C = reader.u8();
  if (step < 1 || step > limitsOf(track.level).stepBound) broken('QNT-001', `step ${step}`, offset);
  const symbolCount = 2 * M + R + C + 1;
  if (symbolCount > SYMBOL_BOUND || R > 24 || C > 32) broken('QNT-001', 'too many symbols', offset);
  const book = reader.bytes(reader.left);
  const lengths = readCodebook(book, symbolCount, offset + 8);
  makeCode(lengths, offset + 8);
  // The table is made when packets are decoded: a file may describe thousands of tracks.
  return { step, directLevels: M, runClasses: R, escapeClasses: C, lengths };
}

let lastCode = { lengths: null, code: null };

export function decodeQuan(track, bytes, span, out, offset) {
  const { componentCount: C, countMin: low, countMax: high, setup } = track;
  const { step, directLevels: M, runClasses: R } = setup;
  if (lastCode.lengths !== setup.lengths) lastCode = { lengths: setup.lengths, code: makeCode(setup.lengths) };
  const { bits: wordBits, table } = lastCode.code;
  const bound = Math.floor((2 * limitsOf(track.level).countBound) / step);
  const bits = new BitReader(bytes);
  const total = span * C;
  const last = C * (span - 1);
  out.fill(clamp(0, low, high));
  let at = 0; // where the next level goes: component after component
  for (let i = 0; i < total;) {
    const entry = table[bits.peek(wordBits)];
    bits.position += entry & 15;
    const symbol = entry >> 4;
    let level = 0;
    if (symbol <= 2 * M) {
      level = symbol & 1 ? (symbol + 1) / 2 : -symbol / 2;
    } else if (symbol <= 2 * M + R) {
      const j = symbol - 2 * M;
      const run = POWERS[j] + bits.take(j);
      if (run > total - i) broken('QNT-004', 'a run that passes the end', offset);
      if (bits.position > bits.size) break;
      i += run;
      at = C === 1 ? i : (i % span) * C + Math.floor(i / span);
      continue;
    } else {
      const j = symbol - (2 * M + R + 1);
      level = M + POWERS[j] + bits.take(j);
      if (bits.bit()) level = -level;
    }
    if (bits.position > bits.size) break;
    if (level > bound || level < -bound) broken('QNT-006', `level ${level} times step ${step}`, offset);
    if (level !== 0) out[at] = clamp(level * step, low, high);
    i++;
    at = at < last ? at + C : at - last + 1;
  }
  if (bits.position > bits.size) broken('COD-001', 'code words are missing', offset + bytes.length);
  if (bits.usedBytes !== bytes.length) broken('QNT-004', 'bytes after the last code word', offset + bits.usedBytes);
  if (!bits.filledWithZeros) broken('QNT-004', 'bits after the last code word that are not 0', offset + bytes.length);
}
