// The chunk header (5.1) and its property bits (5.2).
import { crc32 } from './crc32.js';
import { LIMITS } from './limits.js';

export const SIGNATURE = Uint8Array.of(0x8f, 0x48, 0x41, 0x50, 0x0d, 0x0a, 0x1a, 0x0a);
export const HEADER_SIZE = 32;
const CRC_AT = HEADER_SIZE - 4;
const SYNC = [0xf9, 0x48, 0x8b, 0x1c];
const KNOWN = new Set(['HEAD', 'TRAK', 'DATA', 'iNDX', 'fOOT', 'mETa', 'aTTc', 'dGST', 'cLOk', 'cMAp']);
const PAYLOAD_BOUND = LIMITS[2].payloadBound;

export function beginsWithSignature(bytes) {
  return SIGNATURE.every((byte, i) => bytes[i] === byte);
}

const isLetter = (byte) => (byte >= 65 && byte <= 90) || (byte >= 97 && byte <= 122);

const u32 = (bytes, p) => (bytes[p] | (bytes[p + 1] << 8) | (bytes[p + 2] << 16) | (bytes[p + 3] << 24)) >>> 0;

// A file id is kept as the text that decode.json shows: a Number does not hold 64 bits.
const word = (value) => value.toString(16).padStart(8, '0');
const idText = (high, low) => `0x${word(high)}${word(low)}`;

export function randomId() {
  const [high, low] = globalThis.crypto.getRandomValues(new Uint32Array(2));
  return idText(high, low); // WRT-002
}

function idBytes(fileId) {
  const bytes = new Uint8Array(8);
  new DataView(bytes.buffer).setBigUint64(0, BigInt(fileId), true);
  return bytes;
}

// Where a file CRC starts (clause 2): the CRC of the file id.
export const seedOf = (fileId) => crc32(idBytes(fileId));

// Where a cluster CRC starts (6.4): the file CRC of the sequence number.
export function clusterSeed(seed, sequence) {
  const bytes = new Uint8Array(8);
  new DataView(bytes.buffer).setUint32(0, sequence, true);
  return crc32(bytes, 0, 8, seed);
}

// There are few types and many chunks: each name is made once.
const types = new Map();

function typeAt(bytes, p) {
  const number = u32(bytes, p);
  let type = types.get(number);
  if (type === undefined) {
    type = String.fromCharCode(bytes[p], bytes[p + 1], bytes[p + 2], bytes[p + 3]);
    if (types.size < 1024) types.set(number, type);
  }
  return type;
}

// The header at a position, or null where there is none that is valid (14.1); the file id is not looked at. What the
// walk finds of the chunk is filled in later.
export function readHeader(bytes, position) {
  const p = position;
  if (p + HEADER_SIZE > bytes.length) return null;
  for (let i = 0; i < 4; i++) if (bytes[p + i] !== SYNC[i]) return null;
  for (let i = 4; i < 8; i++) if (!isLetter(bytes[p + i])) return null;
  if (u32(bytes, p + CRC_AT) !== crc32(bytes, p, p + CRC_AT)) return null;
  const payloadSize = u32(bytes, p + 20);
  if (payloadSize > PAYLOAD_BOUND) return null;
  const payloadStart = p + HEADER_SIZE;
  const type = typeAt(bytes, p + 4);
  return {
    position,
    type,
    fileId: idText(u32(bytes, p + 12), u32(bytes, p + 8)),
    seed: crc32(bytes, p + 8, p + 16),
    sequence: u32(bytes, p + 16),
    payloadSize,
    payloadCrc: u32(bytes, p + 24),
    payloadStart,
    end: Math.min(payloadStart + payloadSize, bytes.length),
    whole: payloadStart + payloadSize <= bytes.length,
    intact: false,
    damage: null,
    next: undefined,
    order: 0,
    known: KNOWN.has(type),
    track: null,
    tooLarge: false,
    good: false,
  };
}

// The first position from `start` on that passes `test(header)`; the scan looks at every offset.
export function findHeader(bytes, start, test) {
  for (let p = bytes.indexOf(SYNC[0], start); p >= 0; p = bytes.indexOf(SYNC[0], p + 1)) {
    const header = readHeader(bytes, p);
    if (header && test(header)) return header;
  }
  return null;
}

export const isCritical = (header) => header.type[0] <= 'Z';
export const isSafeToCopy = (header) => header.type[3] >= 'a';

export function makeChunk({ type, fileId, sequence }, payload) {
  const bytes = new Uint8Array(HEADER_SIZE + payload.length);
  const view = new DataView(bytes.buffer);
  bytes.set(SYNC, 0);
  for (let i = 0; i < 4; i++) bytes[4 + i] = type.charCodeAt(i);
  bytes.set(idBytes(fileId), 8);
  view.setUint32(16, sequence, true);
  view.setUint32(20, payload.length, true);
  view.setUint32(24, crc32(payload, 0, payload.length, seedOf(fileId)), true);
  view.setUint32(CRC_AT, crc32(bytes, 0, CRC_AT), true);
  bytes.set(payload, HEADER_SIZE);
  return bytes;
}
