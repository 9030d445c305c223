// What TLVs of tracks hold (clauses 8 and 11).
import { Reader, decodeText } from './bytes.js';
import { broken } from './error.js';
import { readCalibration } from './values.js';

const TWO32 = 2 ** 32;
const TWO31 = 2 ** 31;

function readerOf(tlv) {
  return new Reader(tlv.value, { base: tlv.offset, requirement: 'TLV-004' });
}

// TLV-004: one entry or `wanted` of them; what is left over is TLV-004.
function readList(tlv, wanted, readEntry) {
  const reader = readerOf(tlv);
  const list = [];
  while (reader.left > 0 && list.length < wanted) list.push(readEntry(reader, list));
  if (reader.left > 0) broken('TLV-004', `bytes behind the last entry of TLV ${tlv.type}`, reader.offset);
  if (list.length !== 1 && list.length !== wanted) {
    broken('TLV-004', `${list.length} entries in TLV ${tlv.type}, not 1 or ${wanted}`, tlv.offset);
  }
  return list;
}

export function readStrings(tlv, wanted) {
  return readList(tlv, wanted, (reader, list) => {
    const at = reader.offset;
    const size = reader.u8();
    if (size < 255) return reader.text(size);
    if (!list.length) broken('TLV-004', 'the first entry repeats the one before it', at);
    return list[list.length - 1];
  });
}

export const readText = (tlv) => decodeText(tlv.value, tlv.offset);

export const readCalibrations = (tlv, wanted) => readList(tlv, wanted, readCalibration);

export function readDeviations(tlv, wanted) {
  return readList(tlv, wanted, (reader) => {
    const at = reader.offset;
    const declared = reader.f32();
    const largest = reader.f32();
    const good = Number.isFinite(declared) && Number.isFinite(largest) && declared >= 0 && largest >= 0 && largest <= declared;
    if (!good) broken('TLV-005', `a deviation of ${largest}, declared ${declared}`, at);
    return { declared, largest };
  });
}

// TLV 16 (clause 11): { kn, kd, vector, guaranteed, floors, zeros }.
export function readContract(tlv, componentCount) {
  const reader = readerOf(tlv);
  const kn = reader.varint();
  const kd = reader.varint();
  const flags = reader.u8();
  if (kd < 1 || kd >= 65536 || kn >= 65536) broken('DBC-001', `a Weber fraction of ${kn}/${kd}`, tlv.offset);
  if (flags & ~3) broken('DBC-001', `contract flags ${flags}`, tlv.offset);
  const floors = [];
  const zeros = [];
  for (let c = 0; c < componentCount; c++) {
    const floor = reader.varint();
    const zero = reader.svarint();
    if (floor < 1 || floor >= TWO32) broken('DBC-001', `a floor of ${floor}`, tlv.offset);
    if (zero < -TWO31 || zero >= TWO31) broken('DBC-001', `a zero of ${zero}`, tlv.offset);
    floors.push(floor);
    zeros.push(zero);
  }
  if (reader.left > 0) broken('TLV-004', 'bytes behind a deadband contract', reader.offset);
  return { kn, kd, vector: (flags & 1) === 1, guaranteed: (flags & 2) === 2, floors, zeros };
}
