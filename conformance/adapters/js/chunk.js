// The chunk header (5.1) and its property bits (5.2).
import { crc32 } from './crc32.js';
import { LIMITS } from './limits.js';

export const SIGNATURE = Uint8Array.of(0x8f, 0x48, 0x41, 0x50, 0x0d, 0x0a, 0x1a, 0x0a);
export const HEADER_SIZE = 32;
export const NO_TRACK = 0xffff;
const SYNC = [0xf9, 0x48, 0x8b, 0x1c];
const KNOWN = new Set(['HEAD', 'TRAK', 'DATA', 'iNDX', 'fOOT', 'mETa', 'aTTc', 'dGST', 'cLOk', 'cMAp']);
const PAYLOAD_BOUND = LIMITS[2].payloadBound;

export function beginsWithSignature(bytes) {
  return SIGNATURE.every((byte, i) => bytes[i] === byte);
}

const isLetter = (byte) => (byte >= 65 && byte <= 90) || (byte >= 97 && byte <= 122);

// The header at a position, or null where there is none that is valid (12.1); the file id is not looked at.
export function readHeader(bytes, position) {
  const p = position;
  if (p + HEADER_SIZE > bytes.length) return null;
  for (let i = 0; i < 4; i++) if (bytes[p + i] !== SYNC[i]) return null;
  for (let i = 4; i < 8; i++) if (!isLetter(bytes[p + i])) return null;
  const view = new DataView(bytes.buffer, bytes.byteOffset + p, HEADER_SIZE);
  if (view.getUint32(28, true) !== crc32(bytes, p, p + 28)) return null;
  const payloadSize = view.getUint32(16, true);
  if (payloadSize > PAYLOAD_BOUND) return null;
  return {
    position,
    type: String.fromCharCode(bytes[p + 4], bytes[p + 5], bytes[p + 6], bytes[p + 7]),
    fileId: view.getUint32(8, true),
    sequence: view.getUint32(12, true),
    payloadSize,
    track: view.getUint16(20, true),
    flags: view.getUint16(22, true),
    payloadCrc: view.getUint32(24, true),
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

// CHK-007: an unknown critical flag bit makes a chunk one of an unknown type.
export function isKnown(header) {
  return KNOWN.has(header.type) && (header.flags & 0xff) === 0;
}

export const isCritical = (header) => header.type[0] <= 'Z';
export const isSafeToCopy = (header) => header.type[3] >= 'a';

export function makeChunk({ type, fileId, sequence, track = NO_TRACK, flags = 0 }, payload) {
  const bytes = new Uint8Array(HEADER_SIZE + payload.length);
  const view = new DataView(bytes.buffer);
  bytes.set(SYNC, 0);
  for (let i = 0; i < 4; i++) bytes[4 + i] = type.charCodeAt(i);
  view.setUint32(8, fileId, true);
  view.setUint32(12, sequence, true);
  view.setUint32(16, payload.length, true);
  view.setUint16(20, track, true);
  view.setUint16(22, flags, true);
  view.setUint32(24, crc32(payload), true);
  view.setUint32(28, crc32(bytes, 0, 28), true);
  bytes.set(payload, HEADER_SIZE);
  return bytes;
}
