// The codecs of clause 9 by their names, and what all of them keep.
import { Reader } from './bytes.js';
import { broken, unsupported } from './error.js';
import { decodeEvents } from './evnt.js';
import { decodeKnot, parseKnot } from './knot.js';
import { decodeLpcr, parseLpcr } from './lpcr.js';
import { decodeLpcx, parseLpcx } from './lpcx.js';
import { decodeMdct, parseMdct } from './mdct.js';
import { decodeNois, parseNois } from './nois.js';
import { decodeQuan, parseQuan } from './quan.js';
import { decodeRawbCounts, decodeRawbWords, parseRawb } from './rawb.js';

export { decodeEvents };

const COUNT_CODECS = {
  KNOT: { parse: parseKnot, decode: decodeKnot },
  QUAN: { parse: parseQuan, decode: decodeQuan },
  RAWB: { parse: parseRawb, decode: decodeRawbCounts },
  LPCR: { parse: parseLpcr, decode: decodeLpcr },
  LPCX: { parse: parseLpcx, decode: decodeLpcx },
  MDCT: { parse: parseMdct, decode: decodeMdct },
  NOIS: { parse: parseNois, decode: decodeNois },
};
export const CODECS = [...Object.keys(COUNT_CODECS), 'EVNT'];

// The codec parameters (COD-002); null where they are absent.
export function parseParameters(codec, bytes, track, offset = 0) {
  if (!CODECS.includes(codec)) unsupported('TRK-011', `codec ${JSON.stringify(codec)}`, offset);
  if (codec === 'EVNT') {
    if (bytes !== null) broken('COD-002', 'codec parameters of EVNT', offset);
    return {};
  }
  if (bytes === null) broken('COD-002', 'no codec parameters', offset);
  const reader = new Reader(bytes, { base: offset, requirement: 'COD-002' });
  const setup = COUNT_CODECS[codec].parse(reader, track);
  if (reader.left > 0) broken('COD-002', `${reader.left} bytes after the codec parameters`, reader.offset);
  return setup;
}

// What this reader decodes of one packet (LIM-003): a few bytes can give 2^28 samples at level 2.
const PACKET_SAMPLE_BOUND = 2 ** 25;
const WORD_ARRAYS = { 2: Uint16Array, 4: Uint32Array, 8: BigUint64Array };

// The numbers of a packet, span * componentCount, tick by tick, clamped (DEC-001); and, where they are asked for and
// there are any, the exact values as bit patterns.
export function decodePacket(track, bytes, start, span, { exact = false, offset = 0 } = {}) {
  const length = span * track.componentCount;
  if (length > PACKET_SAMPLE_BOUND) unsupported('LIM-003', `a packet of ${length} samples`, offset);
  if (track.numberFormat !== 'counts') {
    const words = new WORD_ARRAYS[track.setup.wordSize](length);
    decodeRawbWords(track, bytes, span, words, offset);
    return { numbers: words, exact: null };
  }
  const numbers = new Int32Array(length);
  const found = COUNT_CODECS[track.codec].decode(track, bytes, span, numbers, offset, exact);
  return { numbers, exact: found ?? null };
}
