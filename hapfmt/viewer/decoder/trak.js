// TRAK (6.3): the description of tracks.
import { Reader, putVarint } from './bytes.js';
import { CODECS, parseParameters } from './codecs.js';
import { HapfError, broken, unsupported } from './error.js';
import { readTlv } from './head.js';
import { inflate } from './inflate.js';
import { limitsOf } from './limits.js';
import { readCalibrations, readContract, readDeviations, readStrings, readText } from './lists.js';
import { checkCalibration } from './values.js';

const RATE_BOUND = 2 ** 32;
const KINDS = ['full', 'lf', 'hf', 'events'];
const FORMATS = ['counts', 'int64', 'uint64', 'binary16', 'binary32', 'binary64'];
const STRINGS = { 2: 'labels', 4: 'units', 6: 'quantities', 8: 'axes', 10: 'groups', 12: 'bodySites', 14: 'devices' };
const KNOWN_TLVS = new Set([1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 18, 20, 22]);
const OF_THE_BASE = [2, 3, 4, 6, 8, 10, 12, 14, 18];
const NO_DEVIATION = Object.freeze({ declared: 0, largest: 0 });
const NO_CALIBRATION = Object.freeze({ A: 1, B: 0, D: 1 });

// -> { description, faults }; description is null where a fault leaves none.
export function readTrak(bytes, chunk, level) {
  const faults = [];
  const payload = bytes.subarray(chunk.payloadStart, chunk.end);
  const description = { chunk, firstId: chunk.track, payload, level, tracks: [], weight: 0 };
  let deflated = false;
  let whole = true;
  try {
    const plain = unpack(description);
    deflated = plain.base === null;
    readTracks(description, plain.bytes, plain.base ?? 0, faults);
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    faults.push(error);
    whole = false;
  }
  // Inflated bytes have no offset in the file.
  if (deflated) for (const fault of faults) fault.offset = chunk.payloadStart;
  return { description: whole ? description : null, faults };
}

// The id of the first track; null where there is none to be read.
export function firstTrackOf(payload) {
  try {
    return new Reader(payload).varint();
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    return null;
  }
}

// TRK-020: the tracks as they are, and the offset in the file of their first byte, null for a DEFLATE stream.
function unpack({ payload, chunk, level }) {
  const reader = new Reader(payload, { base: chunk.payloadStart, requirement: 'TRK-020' });
  reader.varint();
  const size = reader.varint();
  const rest = payload.subarray(reader.position);
  if (size === 0) return { bytes: rest, base: reader.offset };
  if (size >= limitsOf(level).payloadBound) broken('TRK-020', `tracks of ${size} bytes`, chunk.payloadStart);
  return { bytes: inflate(rest, size, reader.offset, 'TRK-020'), base: null };
}

function readTracks(description, bytes, base, faults) {
  const { chunk, firstId, level, tracks } = description;
  const reader = new Reader(bytes, { base, requirement: 'TLV-001' });
  let components = 0;
  while (reader.left > 0) {
    const at = reader.offset;
    const start = reader.position;
    const kinds = reader.u8();
    const track = {
      id: firstId + tracks.length, description, level, at, kindNumber: kinds & 15, formatNumber: kinds >> 4,
      codec: String.fromCharCode(...reader.bytes(4)), componentCount: reader.u8(), rateNum: reader.varint(), rateDen: reader.varint(),
      countMin: reader.svarint(), countMax: reader.svarint(), tlvs: new Map(),
    };
    const channelAt = reader.position - start;
    track.firstChannel = reader.varint();
    track.linked = reader.varint() - 1;
    const linkedEnd = reader.position - start;
    const tlvCount = reader.u8();
    components += track.componentCount;
    const { rateNum, rateDen } = track;
    if (!track.componentCount || !rateNum || !rateDen || rateNum >= RATE_BOUND || rateDen >= RATE_BOUND || components > 255) {
      broken('TRK-002', `${components} components, rate ${rateNum}/${rateDen}`, at);
    }
    if (track.id > 65533) broken('TRK-003', `track id ${track.id}`, chunk.payloadStart);
    for (let i = 0, before = -1; i < tlvCount; i++) {
      const tlv = readTlv(reader, before);
      track.tlvs.set(tlv.type, tlv);
      before = tlv.type;
    }
    track.record = bytes.subarray(start, reader.position);
    track.places = [channelAt, linkedEnd];
    tracks.push(track);
  }
  if (tracks.length === 0) broken('TRK-002', 'no track', chunk.payloadStart);
  // Few bytes of DEFLATE can describe a component with many.
  description.weight = Math.max(components, bytes.length >> 10);
  limitDescriptions(description.weight, chunk.position);
  for (const track of tracks) describe(track, faults);
}

function describe(track, faults) {
  track.kind = KINDS[track.kindNumber] ?? null;
  track.numberFormat = FORMATS[track.formatNumber] ?? null;
  const strange = strangePart(track);
  track.unsupported = strange ? strange.message : null;
  track.setup = null;
  track.channels = channelsOf(track, strange);
  if (strange) {
    faults.push(strange);
    // What else the description says may refer to what is not understood: nothing more is held against it.
    describeBarely(track);
    return;
  }
  checkKind(track);
  fill(track);
  if (track.kind !== 'hf') {
    for (const calibration of new Set(track.calibrations)) {
      checkCalibration(calibration, track, null, track.tlvs.get(3)?.offset ?? track.at);
    }
  }
  readSetup(track, faults);
}

// TRK-011, TLV-003.
function strangePart(track) {
  const { at, tlvs } = track;
  if (!track.kind) return new HapfError('unsupported', 'TRK-011', `kind ${track.kindNumber}`, at);
  if (!track.numberFormat) return new HapfError('unsupported', 'TRK-011', `number format ${track.formatNumber}`, at);
  const tlv = [...tlvs.values()].find(({ type }) => type % 2 === 1 && !KNOWN_TLVS.has(type));
  if (tlv) return new HapfError('unsupported', 'TLV-003', `unknown critical TLV ${tlv.type}`, tlv.at);
  return CODECS.includes(track.codec) ? null : new HapfError('unsupported', 'TRK-011', `unknown codec ${track.codec}`, at + 1);
}

// TRK-010. What gives the numbers of a track that is not understood may be anything.
function channelsOf({ kind, componentCount, firstChannel, tlvs, at }, strange) {
  if (kind === 'events') return [];
  const given = tlvs.get(5);
  const fits = given?.value.length === 2 * (componentCount - 1);
  if (given && !fits && !strange) broken('TLV-004', 'channel numbers for another number of components', given.offset);
  const channels = Array.from({ length: componentCount }, (_, c) => (
    c > 0 && fits ? given.value[2 * c - 2] + 256 * given.value[2 * c - 1] : firstChannel + c));
  const last = Math.max(...channels);
  if (last > 65534) broken('TRK-010', `channel ${last}`, fits ? given.offset : at);
  if (new Set(channels).size < componentCount) broken('TRK-010', 'two components with one channel number', given.offset);
  return channels;
}

function describeBarely(track) {
  const all = (value) => new Array(track.componentCount).fill(value);
  const linked = track.linked < 0 ? null : track.linked;
  Object.assign(track, {
    countMin: 0, countMax: 0, base: track.kind === 'hf' ? linked : null,
    continues: track.kind === 'full' || track.kind === 'lf' ? linked : null, parameters: null, parametersOffset: null,
    calibrations: all(NO_CALIBRATION), contract: null, deviation: null, strange: true,
  });
  for (const name of Object.values(STRINGS)) track[name] = all('');
}

// The rules that kind and number format alone call for: TRK-005, -006, -009, -010, -019.
function checkKind(track) {
  const { kind, tlvs, at, countMin, countMax } = track;
  const { rangeBits, hfRangeBits } = limitsOf(track.level);
  const half = 2 ** ((kind === 'hf' ? hfRangeBits : rangeBits) - 1);
  if (countMin > countMax || countMin < -half || countMax >= half) {
    const error = new HapfError('broken', 'TRK-005', `a declared range of ${countMin} to ${countMax}`, at);
    if (countMin <= countMax) error.also = ['LIM-001'];
    throw error;
  }
  if (kind === 'hf') {
    const type = OF_THE_BASE.find((t) => tlvs.has(t));
    if (type) broken('TRK-009', `TLV ${type} of an HF track`, tlvs.get(type).at);
  }
  if (kind !== 'full' && kind !== 'events' && tlvs.has(5)) broken('TRK-009', 'channel numbers of a track of one band', tlvs.get(5).offset);
  if ((track.codec === 'EVNT') !== (kind === 'events')) {
    broken('TRK-019', `codec ${track.codec} of a track of kind ${kind}`, at + 1);
  }
  if (kind === 'events') {
    const good = track.componentCount === 1 && track.numberFormat === 'counts'
      && countMin === 0 && countMax === 0 && track.firstChannel === 0 && track.linked < 0;
    if (!good) broken('TRK-019', 'a track of kind events with other fields than it may have', at);
    const type = [...tlvs.keys()].find((t) => KNOWN_TLVS.has(t) && ![2, 14, 22].includes(t));
    if (type !== undefined) broken('TRK-019', `TLV ${type} of a track of kind events`, tlvs.get(type).at);
  }
  if (track.numberFormat !== 'counts' && kind !== 'events') {
    if (kind !== 'full' || countMin !== 0 || countMax !== 0 || tlvs.has(3) || tlvs.has(16) || track.codec !== 'RAWB') {
      broken('TRK-006', 'words with what only counts have', at);
    }
  }
}

function fill(track) {
  const { kind, componentCount, tlvs, linked } = track;
  const read = (type, reading) => (tlvs.has(type) ? reading(tlvs.get(type), componentCount) : null);
  const all = (list, absent) => (list?.length === componentCount ? list : new Array(componentCount).fill(list ? list[0] : absent));
  for (const [type, name] of Object.entries(STRINGS)) track[name] = all(read(+type, readStrings), name === 'units' ? '1' : '');
  track.calibrations = all(read(3, readCalibrations), NO_CALIBRATION);
  track.deviations = all(read(18, readDeviations), NO_DEVIATION);
  track.deviation = track.deviations.find(({ declared, largest }) => declared || largest) ?? null;
  track.contract = read(16, readContract);
  track.provenance = read(22, readText);
  track.parameters = tlvs.get(1)?.value ?? null;
  track.parametersOffset = tlvs.get(1)?.offset ?? track.at;
  track.base = kind === 'hf' ? linked : null;
  track.continues = kind !== 'hf' && linked >= 0 ? linked : null;
  track.continuesAsRead = track.continues;
}

function readSetup(track, faults) {
  try {
    track.setup = parseParameters(track.codec, track.parameters, track, track.parametersOffset);
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    track.fault = error;
    faults.push(error);
  }
}

// The record of a track with other channels, linked to another track (null: to none).
export function recordLinked({ record, tlvs, places: [channelAt, linkedEnd] }, channels, linked) {
  const rest = record.slice(linkedEnd);
  const given = tlvs.get(5)?.value;
  if (given) {
    const at = given.byteOffset - record.byteOffset - linkedEnd;
    channels.slice(1).forEach((channel, c) => rest.set([channel % 256, channel >> 8], at + 2 * c));
  }
  const numbers = [];
  putVarint(numbers, channels[0]);
  putVarint(numbers, linked === null ? 0 : 1 + linked);
  return Uint8Array.from([...record.subarray(0, channelAt), ...numbers, ...rest]);
}

export function limitDescriptions(total, offset) {
  if (total > 2 ** 20) unsupported('LIM-003', 'more components than this reader keeps', offset);
}
