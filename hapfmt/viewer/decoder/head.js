// HEAD (6.1) and TLVs (6.2).
import { Reader, decodeText, putVarint } from './bytes.js';
import { HapfError, broken, unsupported } from './error.js';
import { LIMITS } from './limits.js';

const FIXED_SIZE = 3;
const TYPE_BOUND = 2 ** 16;
const UNCERTAINTY_BOUND = 2n ** 63n;
const [UUID, EPOCH, ENCODER] = [2, 4, 6];

// The next TLV, of a type above `before`: { type, value, at, offset }, offset being that of the value.
export function readTlv(reader, before) {
  const at = reader.offset;
  const type = reader.varint();
  const size = reader.varint();
  if (type <= before) broken('TLV-001', `TLV ${type} behind ${before}`, at);
  if (type >= TYPE_BOUND) broken('TLV-001', `TLV ${type}`, at);
  if (size > reader.left) broken('TLV-001', `TLV ${type} passes the end of its chunk`, at);
  const offset = reader.offset;
  return { type, value: reader.bytes(size), at, offset };
}

export function putTlv(array, type, value) {
  putVarint(array, type);
  putVarint(array, value.length);
  for (const byte of value) array.push(byte);
}

// The UUID of a file without one.
export function uuidOf(fileId) {
  const digits = fileId.slice(2);
  const text = `${digits.slice(0, 12)}8${digits.slice(12, 15)}8${digits[15]}00${'0'.repeat(12)}`;
  return Uint8Array.from(text.match(/../g), (pair) => parseInt(pair, 16));
}

// VER-001 first: of a file of another version no other rule is checked.
export function readHead(bytes, chunk) {
  const reader = new Reader(bytes, { start: chunk.payloadStart, end: chunk.end, requirement: 'HED-002' });
  const at = chunk.payloadStart;
  // A HEAD that is too short is judged by the fields that are whole.
  const size = chunk.end - at;
  const major = reader.u8();
  if (major !== 1) unsupported('VER-001', `major version ${major}`, at);
  const minor = size > 1 ? reader.u8() : 0;
  const level = size > 2 ? reader.u8() : 1;
  if (!(level in LIMITS)) unsupported('HED-004', `level ${level}`, at + 2);
  if (size < FIXED_SIZE) broken('HED-002', 'HEAD is too short', at);
  const head = { major, minor, level, fileId: chunk.fileId, tlvs: new Map(), uuid: uuidOf(chunk.fileId), epochNs: null, epochUncertaintyNs: null, encoder: '' };
  const faults = [];
  try {
    for (let before = -1; reader.left > 0;) {
      const tlv = readTlv(reader, before);
      head.tlvs.set(tlv.type, tlv);
      before = tlv.type;
    }
    fill(head);
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    faults.push(error);
  }
  for (const { type, at: place } of head.tlvs.values()) {
    if (type % 2 === 1) unsupported('TLV-003', `unknown critical TLV ${type} in HEAD`, place);
  }
  return { head, faults };
}

function fill(head) {
  for (const { type, value, offset } of head.tlvs.values()) {
    if ((type === UUID || type === EPOCH) && value.length !== 16) broken('HED-002', `TLV ${type} of ${value.length} bytes`, offset);
    if (type === UUID) head.uuid = value;
    if (type === ENCODER) head.encoder = decodeText(value, offset);
    if (type !== EPOCH) continue;
    const reader = new Reader(value, { base: offset });
    [head.epochNs, head.epochUncertaintyNs] = [reader.i64(), reader.u64()];
    if (head.epochUncertaintyNs >= UNCERTAINTY_BOUND) broken('HED-002', `an uncertainty of ${head.epochUncertaintyNs} ns`, offset + 8);
  }
}

// The payload of HEAD in another file, where the UUID does not follow from the file id any more.
export function headPayload({ level, uuid = null, tlvs = new Map() }) {
  const payload = [1, 0, level];
  if (uuid) putTlv(payload, UUID, uuid);
  for (const type of [EPOCH, ENCODER]) {
    if (tlvs.has(type)) putTlv(payload, type, tlvs.get(type).value);
  }
  return Uint8Array.from(payload);
}
