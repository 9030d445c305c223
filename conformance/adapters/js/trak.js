// TRAK (6.3): the description of a series of tracks.
import { Reader } from './bytes.js';
import { CODECS, parseParameters } from './codecs.js';
import { HapfError, broken, unsupported } from './error.js';
import { readTlvs } from './head.js';
import { limitsOf } from './limits.js';
import {
  readCalibrations, readChannels, readContinued, readContracts, readDeviations, readRanges, readSetups, readStrings, readText,
} from './lists.js';
import { checkCalibration } from './values.js';

export const NONE = 0xffff;
const KINDS = ['full', 'lf', 'hf', 'events'];
const FORMATS = ['counts', 'int64', 'uint64', 'binary16', 'binary32', 'binary64'];
const STRINGS = { 2: 'labels', 4: 'units', 6: 'quantities', 8: 'axes', 10: 'groups', 12: 'bodySites', 14: 'devices' };
const KNOWN_TLVS = new Set([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 22]);
const OF_THE_BASE = [2, 3, 4, 6, 8, 10, 12, 14, 18];
const NO_DEVIATION = Object.freeze({ declared: 0, largest: 0 });
const NO_CALIBRATION = Object.freeze({ A: 1, B: 0, D: 1 });

// -> { series, faults }; series is null where a fault leaves no description.
export function readTrak(bytes, chunk, level) {
  const faults = [];
  let series = null;
  try {
    series = readSeries(bytes, chunk, level, faults);
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    faults.push(error);
  }
  return { series, faults };
}

function readSeries(bytes, chunk, level, faults) {
  const at = chunk.payloadStart;
  const reader = new Reader(bytes, { start: at, end: chunk.end, requirement: 'TLV-002' });
  const series = {
    chunk, firstId: chunk.track, payload: bytes.subarray(at, chunk.end), level,
    trackCount: reader.u8(), componentCount: reader.u8(), kindNumber: reader.u8(), formatNumber: reader.u8(),
    codec: String.fromCharCode(...reader.bytes(4)),
    rateNum: reader.u32(), rateDen: reader.u32(), countMin: reader.i32(), countMax: reader.i32(),
    firstChannel: reader.u16(), base: reader.u16(),
  };
  const { trackCount, componentCount, firstId } = series;
  if (!trackCount || !componentCount || !series.rateNum || !series.rateDen || trackCount * componentCount > 255) {
    broken('TRK-002', `${trackCount} tracks of ${componentCount} components, rate ${series.rateNum}/${series.rateDen}`, at);
  }
  if (firstId + trackCount - 1 > 65533) broken('TRK-003', `track ids from ${firstId} on`, chunk.position + 20);
  const tlvs = readTlvs(reader);
  series.tlvs = new Map(tlvs.map((tlv) => [tlv.type, tlv]));
  series.kind = KINDS[series.kindNumber] ?? null;
  series.numberFormat = FORMATS[series.formatNumber] ?? null;

  const strange = strangePart(series, tlvs);
  if (strange) faults.push(strange);
  series.unsupported = strange ? strange.message : null;
  if (strange) {
    // What else the description says may refer to what is not understood: nothing more is held against it.
    describeBarely(series);
    return series;
  }
  checkKind(series, at);
  describe(series, faults);
  return series;
}

// TRK-004, TLV-003.
function strangePart(series, tlvs) {
  const at = series.chunk.payloadStart;
  if (!series.kind) return new HapfError('unsupported', 'TRK-004', `kind ${series.kindNumber}`, at + 2);
  if (!series.numberFormat) return new HapfError('unsupported', 'TRK-004', `number format ${series.formatNumber}`, at + 3);
  const tlv = tlvs.find(({ type }) => type % 2 === 1 && !KNOWN_TLVS.has(type));
  return tlv ? new HapfError('unsupported', 'TLV-003', `unknown critical TLV ${tlv.type}`, tlv.offset - 4) : null;
}

function describeBarely(series) {
  const { trackCount, componentCount } = series;
  series.tracks = Array.from({ length: trackCount }, (_, i) => ({
    ...common(series, i),
    codec: series.codec, countMin: 0, countMax: 0, channels: [], base: null, continues: null,
    parameters: null, parametersOffset: null, calibrations: new Array(componentCount).fill(NO_CALIBRATION),
    contract: null, deviation: null, unsupported: series.unsupported, setup: null, strange: true,
    ...Object.fromEntries(Object.values(STRINGS).map((name) => [name, new Array(componentCount).fill('')])),
  }));
}

const common = (series, i) => ({
  id: series.firstId + i, kind: series.kind, numberFormat: series.numberFormat, componentCount: series.componentCount,
  rateNum: series.rateNum, rateDen: series.rateDen, level: series.level, series, place: i,
});

// The rules that kind and number format alone call for: TRK-005, -006, -008, -009, -019.
function checkKind(series, at) {
  const { kind, tlvs } = series;
  const { rangeBits, hfRangeBits } = limitsOf(series.level);
  const half = 2 ** ((kind === 'hf' ? hfRangeBits : rangeBits) - 1);
  if (series.countMin > series.countMax || series.countMin < -half || series.countMax >= half) {
    const error = new HapfError('broken', 'TRK-005', `a declared range of ${series.countMin} to ${series.countMax}`, at + 16);
    if (series.countMin <= series.countMax) error.also = ['LIM-001'];
    throw error;
  }
  if (kind !== 'hf' && series.base !== NONE) broken('TRK-008', `base ${series.base} of a track that is not HF`, at + 26);
  if (kind === 'hf') {
    const type = OF_THE_BASE.find((t) => tlvs.has(t));
    if (type) broken('TRK-009', `TLV ${type} of an HF track`, tlvs.get(type).offset - 4);
  }
  if (kind === 'events') {
    const good = series.codec === 'EVNT' && series.componentCount === 1 && series.numberFormat === 'counts'
      && series.countMin === 0 && series.countMax === 0 && series.firstChannel === NONE;
    if (!good) broken('TRK-019', 'a track of kind events with other fields than it may have', at);
    const type = [...tlvs.keys()].find((t) => KNOWN_TLVS.has(t) && ![2, 14, 22].includes(t));
    if (type !== undefined) broken('TRK-019', `TLV ${type} of a track of kind events`, tlvs.get(type).offset - 4);
  } else if (series.firstChannel + series.componentCount - 1 > 65534) {
    broken('TRK-010', `channel ${series.firstChannel} first`, at + 24);
  }
  if (series.numberFormat !== 'counts' && kind !== 'events') {
    if (kind !== 'full' || series.countMin !== 0 || series.countMax !== 0 || tlvs.has(3)) {
      broken('TRK-006', 'words with what only counts have', at);
    }
  }
}

// The tracks, each with what is its own.
function describe(series, faults) {
  const { trackCount, componentCount, tlvs, kind } = series;
  const at = series.chunk.payloadStart;
  const all = trackCount * componentCount;
  const read = (type, reading) => (tlvs.has(type) ? reading(tlvs.get(type)) : null);

  const strings = {};
  for (const [type, name] of Object.entries(STRINGS)) strings[name] = read(+type, (tlv) => readStrings(tlv, all));
  const calibrations = read(3, (tlv) => readCalibrations(tlv, all));
  const deviations = read(18, (tlv) => readDeviations(tlv, all));
  const ranges = read(7, (tlv) => readRanges(tlv, trackCount));
  const channels = read(9, (tlv) => readChannels(tlv, trackCount, series.firstChannel));
  const continued = read(11, (tlv) => readContinued(tlv, trackCount));
  const contracts = read(16, (tlv) => readContracts(tlv, trackCount, componentCount));
  series.provenance = read(22, readText);

  if (tlvs.has(1) && tlvs.has(5)) broken('TRK-013', 'setups beside codec parameters', tlvs.get(5).offset - 4);
  const setups = read(5, (tlv) => readSetups(tlv, trackCount, series.codec));
  if (ranges) {
    const lowest = Math.min(...ranges.map(([low]) => low));
    const highest = Math.max(...ranges.map(([, high]) => high));
    if (lowest !== series.countMin || highest !== series.countMax) {
      broken('TRK-014', `ranges from ${lowest} to ${highest}, not ${series.countMin} to ${series.countMax}`, tlvs.get(7).offset);
    }
  }
  if (channels && kind !== 'events') {
    const number = Math.max(...channels) + componentCount - 1;
    if (number > 65534) broken('TRK-010', `channel ${number}`, tlvs.get(9).offset);
  }
  if (continued?.some((id) => id !== null) && kind !== 'full' && kind !== 'lf') {
    broken('TRK-016', `a track of kind ${kind} that continues another`, tlvs.get(11).offset);
  }
  const single = tlvs.get(1);
  // A list of one entry speaks for all, and all tracks share it.
  const shared = new Map();
  const part = (list, i, absent) => {
    if (list && list.length > 1) return list.slice(i * componentCount, (i + 1) * componentCount);
    const value = list ? list[0] : absent;
    if (!shared.has(value)) shared.set(value, new Array(componentCount).fill(value));
    return shared.get(value);
  };
  series.tracks = Array.from({ length: trackCount }, (_, i) => {
    const own = setups ? setups[i] : { codec: series.codec, parameters: single?.value ?? null, parametersOffset: single?.offset ?? at };
    const [countMin, countMax] = ranges ? ranges[i] : [series.countMin, series.countMax];
    const first = channels ? channels[i] : series.firstChannel + i * componentCount;
    const track = { ...common(series, i), ...own, countMin, countMax };
    track.channels = kind === 'events' ? [] : Array.from({ length: componentCount }, (_unused, c) => first + c);
    track.base = kind === 'hf' ? series.base + i : null;
    track.continues = continued ? continued[i] : null;
    track.continuesAsRead = track.continues;
    for (const name of Object.values(STRINGS)) track[name] = part(strings[name], i, name === 'units' ? '1' : '');
    track.calibrations = part(calibrations, i, NO_CALIBRATION);
    track.deviations = part(deviations, i, NO_DEVIATION);
    track.deviation = track.deviations.find(({ declared, largest }) => declared || largest) ?? null;
    track.contract = contracts ? contracts[contracts.length === 1 ? 0 : i] : null;
    track.unsupported = null;
    track.setup = null;
    return track;
  });
  const lastChannel = series.tracks[trackCount - 1].channels[componentCount - 1];
  if (lastChannel > 65534) broken('TRK-010', `channel ${lastChannel}`, at + 24);
  checkTracks(series, faults);
}

function checkTracks(series, faults) {
  const { kind, tlvs } = series;
  const words = series.numberFormat !== 'counts';
  const checked = new Map();
  for (const track of series.tracks) {
    if (words && (track.codec !== 'RAWB' || track.contract)) {
      broken('TRK-006', `words in codec ${track.codec}, or with a contract`, series.chunk.payloadStart + 4);
    }
    if ((track.codec === 'EVNT') !== (kind === 'events')) {
      broken('TRK-019', `codec ${track.codec} of a track of kind ${kind}`, series.chunk.payloadStart + 4);
    }
    if (kind !== 'hf') {
      for (const calibration of new Set(track.calibrations)) {
        checkCalibration(calibration, track, null, tlvs.get(3)?.offset ?? series.chunk.payloadStart);
      }
    }
    readSetup(track, checked, faults);
  }
}

// Tracks with the same setup share what was read of it: 255 codebooks take 70 bytes (clause 17).
function readSetup(track, checked, faults) {
  const key = track.codec + track.parametersOffset;
  if (!CODECS.includes(track.codec)) {
    track.unsupported = `codec ${track.codec}`;
    if (!checked.has(key)) faults.push(new HapfError('unsupported', 'TRK-011', `unknown codec ${track.codec}`, track.parametersOffset));
    checked.set(key, null);
    return;
  }
  const alone = track.codec === 'LPCX';
  if (!alone && checked.has(key)) {
    Object.assign(track, checked.get(key));
    return;
  }
  const result = { setup: null, fault: null };
  try {
    result.setup = parseParameters(track.codec, track.parameters, track, track.parametersOffset);
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    result.fault = error;
    faults.push(error);
  }
  checked.set(key, result);
  Object.assign(track, result);
}

export function limitDescriptions(total, offset) {
  if (total > 2 ** 20) unsupported('LIM-003', 'more components than this reader keeps', offset);
}
