// HEAD (6.1) and TLVs (6.2).
import { Reader } from './bytes.js';
import { broken, unsupported } from './error.js';
import { LIMITS } from './limits.js';

const HEAD_SIZE = 44;

// The next TLV, of a type above `before`: { type, value, offset }, offset being that of the value.
export function readTlv(reader, before) {
  const at = reader.offset;
  if (reader.left < 4) broken('TLV-001', 'a piece of a TLV', at);
  const type = reader.u16();
  const size = reader.u16();
  if (type <= before) broken('TLV-001', `TLV ${type} behind ${before}`, at);
  if (size > reader.left) broken('TLV-001', `TLV ${type} passes the end of its chunk`, at);
  const offset = reader.offset;
  return { type, value: reader.bytes(size), offset };
}

// All to the end.
function readTlvs(reader) {
  const tlvs = [];
  while (reader.left > 0) tlvs.push(readTlv(reader, tlvs.at(-1)?.type ?? -1));
  return tlvs;
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
  const reserved = size > 3 ? reader.u8() : 0;
  const incompat = size >= 8 ? reader.u32() : 0;
  if (incompat !== 0) unsupported('VER-001', `unknown feature bits ${incompat.toString(16)}`, at + 4);
  if (!(level in LIMITS)) unsupported('HED-004', `level ${level}`, at + 2);
  if (size < HEAD_SIZE) broken('HED-002', 'HEAD is too short', at);
  const compat = reader.u32();
  const head = {
    major, minor, level, compat, fileId: chunk.fileId,
    uuid: reader.bytes(16), epochNs: reader.i64(), epochUncertaintyNs: reader.u64(),
  };
  const faults = [];
  const attempt = (action) => {
    try {
      return action();
    } catch (error) {
      faults.push(error);
      return null;
    }
  };
  const tlvs = attempt(() => readTlvs(reader)) ?? [];
  for (const tlv of tlvs) {
    if (tlv.type % 2 === 1) unsupported('TLV-003', `unknown critical TLV ${tlv.type} in HEAD`, tlv.offset - 4);
  }
  if (reserved !== 0) attempt(() => broken('HED-005', 'a reserved byte is not 0', at + 3));
  return { head, faults };
}
