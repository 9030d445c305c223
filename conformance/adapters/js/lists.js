// The lists that TLVs of TRAK hold (6.2, 6.3, clauses 8 and 11).
import { Reader, decodeText } from './bytes.js';
import { HapfError, broken } from './error.js';
import { readCalibration } from './values.js';

const TWO32 = 2 ** 32;
const TWO31 = 2 ** 31;

function readerOf(tlv, requirement = 'TLV-007') {
  return new Reader(tlv.value, { base: tlv.offset, requirement });
}

// TLV-004: one entry or `wanted` of them; what is left over is TLV-007.
function readList(tlv, wanted, readEntry) {
  const reader = readerOf(tlv);
  const list = [];
  while (reader.left > 0 && list.length < wanted) list.push(readEntry(reader, list));
  if (reader.left > 0) broken('TLV-007', `bytes behind the last entry of TLV ${tlv.type}`, reader.offset);
  if (list.length !== 1 && list.length !== wanted) {
    broken('TLV-004', `${list.length} entries in TLV ${tlv.type}, not 1 or ${wanted}`, tlv.offset);
  }
  return list;
}

// As readList, but always one entry for each track.
function readEach(tlv, trackCount, requirement, readEntry) {
  const reader = readerOf(tlv, requirement);
  const list = [];
  endingWithTlv(() => {
    for (let i = 0; i < trackCount; i++) list.push(readEntry(reader, list));
  });
  if (reader.left > 0) broken('TLV-007', `bytes behind the last entry of TLV ${tlv.type}`, reader.offset);
  return list;
}

export function readStrings(tlv, wanted) {
  return readList(tlv, wanted, (reader, list) => {
    const at = reader.offset;
    const size = reader.u8();
    if (size < 255) return reader.text(size);
    if (!list.length) broken('CNV-005', 'the first entry repeats the one before it', at);
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

// TLV 5: for each track its setup { codec, parameters, parametersOffset }.
export function readSetups(tlv, trackCount, firstCodec) {
  return endingWithTlv(() => setupsOf(tlv, trackCount, firstCodec));
}

// Where bytes are missing, that is also TLV-007.
function endingWithTlv(read) {
  try {
    return read();
  } catch (error) {
    if (error instanceof HapfError && error.kind === 'truncated') error.also = ['TLV-007'];
    throw error;
  }
}

function setupsOf(tlv, trackCount, firstCodec) {
  const reader = readerOf(tlv, 'TRK-013');
  const setups = [];
  const codecCount = reader.varint();
  if (codecCount < 1 || codecCount > trackCount) broken('TRK-013', `${codecCount} codecs`, tlv.offset);
  for (let i = 0; i < codecCount; i++) {
    const codec = String.fromCharCode(...reader.bytes(4));
    const at = reader.offset;
    const count = reader.varint();
    if (count < 1 || setups.length + count > trackCount) broken('TRK-013', `${count} setups of a codec`, at);
    for (let j = 0; j < count; j++) {
      const size = reader.varint();
      const parametersOffset = reader.offset;
      setups.push({ codec, parameters: reader.bytes(size), parametersOffset });
    }
  }
  const places = [];
  for (let i = 0; i < trackCount; i++) {
    const at = reader.offset;
    const place = reader.varint();
    if (place >= setups.length) broken('TRK-013', `place ${place} of ${setups.length} setups`, at);
    places.push(setups[place]);
  }
  if (reader.left > 0) broken('TLV-007', 'bytes behind the last entry of TLV 5', reader.offset);
  if (places[0].codec !== firstCodec) broken('TRK-013', 'the codec of the first track is another one', tlv.offset);
  return places;
}

// TLV 7: for each track [countMin, countMax].
export function readRanges(tlv, trackCount) {
  return readEach(tlv, trackCount, 'TRK-014', (reader) => {
    const at = reader.offset;
    const w = reader.u8();
    if (w <= 31) return [0, 2 ** w - 1];
    if (w >= 64 && w <= 95) return [-(2 ** (w - 64)), 2 ** (w - 64) - 1];
    if (w !== 255) broken('TRK-014', `a range of kind ${w}`, at);
    const lowest = reader.svarint();
    const difference = reader.varint();
    if (difference >= TWO32) broken('TRK-014', `a range of ${difference} counts`, at);
    return [lowest, lowest + difference];
  });
}

// TLV 9: for each track the number of its first channel.
export function readChannels(tlv, trackCount, firstChannel) {
  const numbers = readEach(tlv, trackCount, 'TRK-015', (reader) => reader.varint());
  if (numbers[0] !== firstChannel) broken('TRK-015', `channel ${numbers[0]} first, not ${firstChannel}`, tlv.offset);
  return numbers;
}

// TLV 11: for each track the id that it continues, or null.
export function readContinued(tlv, trackCount) {
  return readEach(tlv, trackCount, 'TLV-004', (reader) => {
    const value = reader.varint();
    return value === 0 ? null : value - 1;
  });
}

// TLV 16 (clause 11): for each track, or once, { kn, kd, vector, guaranteed, floors, zeros }, or null.
export function readContracts(tlv, trackCount, componentCount) {
  return readList(tlv, trackCount, (reader) => {
    const at = reader.offset;
    const kd = reader.varint();
    if (kd === 0) return null;
    const kn = reader.varint();
    const flags = reader.u8();
    if (kd >= 65536 || kn >= 65536) broken('DBC-001', `a Weber fraction of ${kn}/${kd}`, at);
    if (flags & ~3) broken('DBC-001', `contract flags ${flags}`, at);
    const floors = [];
    const zeros = [];
    for (let c = 0; c < componentCount; c++) {
      const floor = reader.varint();
      const zero = reader.svarint();
      if (floor < 1 || floor >= TWO32) broken('DBC-001', `a floor of ${floor}`, at);
      if (zero < -TWO31 || zero >= TWO31) broken('DBC-001', `a zero of ${zero}`, at);
      floors.push(floor);
      zeros.push(zero);
    }
    return { kn, kd, vector: (flags & 1) === 1, guaranteed: (flags & 2) === 2, floors, zeros };
  });
}
