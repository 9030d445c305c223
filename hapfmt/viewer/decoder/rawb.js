// RAWB (9.3): counts or words as they are, bytes of one place together.
import { broken } from './error.js';
import { inflate } from './inflate.js';

export const WORD_SIZES = { int64: 8, uint64: 8, binary16: 2, binary32: 4, binary64: 8 };

export function parseRawb(reader, track) {
  const { offset } = reader;
  const wordSize = reader.u8();
  const allowed = track.numberFormat === 'counts' ? [1, 2, 3, 4] : [WORD_SIZES[track.numberFormat]];
  if (!allowed.includes(wordSize)) broken('RAW-001', `words of ${wordSize} bytes`, offset);
  if (reader.bytes(3).some((byte) => byte !== 0)) broken('HED-005', 'reserved bytes that are not 0', offset + 1);
  return { wordSize };
}

// The planes of a packet: for each component, for each byte of the words, the bytes of all ticks.
function readPlanes(bytes, size, offset) {
  if (bytes.length === 0) broken('COD-001', 'a packet without a method', offset);
  const method = bytes[0];
  if (method > 1) broken('RAW-003', `method ${method}`, offset);
  const body = bytes.subarray(1);
  if (method === 1) return inflate(body, size, offset + 1, 'RAW-003');
  if (body.length !== size) broken('RAW-003', `${body.length} bytes instead of ${size}`, offset);
  return body;
}

export function decodeRawbCounts(track, bytes, span, out, offset) {
  const { componentCount: C, countMin: low, countMax: high } = track;
  const { wordSize } = track.setup;
  const planes = readPlanes(bytes, span * C * wordSize, offset);
  const shift = 32 - 8 * wordSize;
  for (let c = 0; c < C; c++) {
    const b0 = c * wordSize * span;
    for (let t = 0, at = c; t < span; t++, at += C) {
      let word = 0;
      for (let b = 0, from = b0 + t; b < wordSize; b++, from += span) word |= planes[from] << (8 * b);
      const count = (word << shift) >> shift;
      if (count < low || count > high) broken('RAW-005', `the count ${count} is out of range`, offset);
      out[at] = count;
    }
  }
}

// out: Uint16Array, Uint32Array or BigUint64Array.
export function decodeRawbWords(track, bytes, span, out, offset) {
  const { componentCount: C } = track;
  const { wordSize } = track.setup;
  const planes = readPlanes(bytes, span * C * wordSize, offset);
  const target = new Uint8Array(out.buffer, out.byteOffset, out.byteLength);
  for (let c = 0, from = 0; c < C; c++) {
    for (let b = 0; b < wordSize; b++) {
      for (let t = 0, at = c * wordSize + b; t < span; t++, at += C * wordSize) target[at] = planes[from++];
    }
  }
}
