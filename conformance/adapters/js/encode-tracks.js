// The tracks of the encoder: grid, description (6.3) and packets of each.
import { putSvarint, putVarint } from '../../../hapfmt/viewer/decoder/bytes.js';
import { decodePacket, parseParameters } from '../../../hapfmt/viewer/decoder/codecs.js';
import { encodeComponent } from './encode-lpcr.js';
import { HapfError, unsupported } from '../../../hapfmt/viewer/decoder/error.js';
import { putTlv } from '../../../hapfmt/viewer/decoder/head.js';
import { floorDivBig } from '../../../hapfmt/viewer/decoder/integers.js';
import { WORD_SIZES } from '../../../hapfmt/viewer/decoder/rawb.js';
import { checkCalibration } from '../../../hapfmt/viewer/decoder/values.js';

const FORMATS = ['counts', 'int64', 'uint64', 'binary16', 'binary32', 'binary64'];
const KINDS = { full: 0, events: 3 };
const TEXTS = [[2, 'label'], [4, 'unit'], [6, 'quantity'], [8, 'axis'], [10, 'group'], [12, 'body_site'], [14, 'device']];
const PACKET_TICKS = 65536;
const LEVEL_1_HIGH = 2 ** 23;

export const refuse = (message) => unsupported('LIM-003', message, null);

export const emptyTrack = {
  kind: 'full', numberFormat: 'counts', componentCount: 1, countMin: 0, countMax: 0, calibrations: [{ A: 1, B: 0, D: 1 }],
  contract: null, deviation: null, texts: {}, band: null, parameters: null,
};

// The counts of a channel, or its words as BigInts.
function numbersOf({ format = 'counts', spans }, bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const length = spans.reduce((sum, [start, stop]) => sum + stop - start, 0);
  if (8 * length !== bytes.length) throw new Error(`${bytes.length} bytes instead of ${8 * length}`);
  if (format !== 'counts') return Array.from({ length }, (_, i) => view.getBigUint64(8 * i, true));
  return Array.from({ length }, (_, i) => Number(view.getBigInt64(8 * i, true)));
}

// The contract of clause 11, and what a grid needs to keep it.
function deadbandOf(job, calibration) {
  const [kn, kd] = job.k ?? [0, 1];
  const floor = job.floor ?? 1;
  if (floor < 1) return null; // only the counts themselves keep that
  if (kn < 0 || kd < 1 || kn >= 65536 || kd >= 65536 || floor >= 2 ** 32) refuse('a contract beyond its limits');
  const zero = Math.max(-(2 ** 31), Math.min(2 ** 31 - 1, Math.round(-calibration.B / calibration.A))) || 0;
  const contract = [];
  putVarint(contract, kn);
  putVarint(contract, kd);
  contract.push(job.guaranteed ? 2 : 0);
  putVarint(contract, floor);
  putSvarint(contract, zero);
  const uniform = kn === 0 || kd > 1024 * kn; // then the floor alone
  return { kn, kd, floor, zero, contract, uniform };
}

// The track of a channel of a job, in full band.
export function makeTrack(number, channel, bytes, job) {
  const { format = 'counts', rate: [rateNum, rateDen], spans } = channel;
  const numbers = numbersOf(channel, bytes);
  const words = format !== 'counts';
  const [A, B, D] = channel.calibration ?? [1, 0, 1];
  const track = {
    ...emptyTrack, codec: words ? 'RAWB' : 'LPCR', numberFormat: format, rateNum, rateDen, spans, numbers,
    channels: [number], calibrations: [{ A, B, D }], texts: channel,
  };
  if (words) return track;
  for (const count of numbers) {
    if (count < track.countMin) track.countMin = count;
    if (count > track.countMax) track.countMax = count;
  }
  if (track.countMin < -(2 ** 31) || track.countMax >= 2 ** 31) refuse('counts of more than 32 bits');
  checkValues(track);
  if (job.mode !== 'lossless') track.band = deadbandOf(job, { A, B, D });
  return track;
}

function checkValues(track) { // VAL-001
  try {
    checkCalibration(track.calibrations[0], track, null, null);
  } catch (error) {
    if (error instanceof HapfError) refuse(error.message);
    throw error;
  }
}

export const needsLevel2 = ({ countMin, countMax, band }) => countMin < -LEVEL_1_HIGH || countMax >= LEVEL_1_HIGH
  || (band !== null && (Math.abs(band.zero) > LEVEL_1_HIGH || 2 * band.floor >= 2 ** 24));

function lpcrParameters(band, limits) {
  const bytes = [band && !band.uniform ? 1 : 0];
  if (!band) bytes.push(1);
  else putVarint(bytes, Math.min(band.uniform ? 2 * band.floor + 1 : band.floor, limits.stepBound));
  putSvarint(bytes, band ? band.zero : 0);
  if (band && !band.uniform) {
    putVarint(bytes, band.kn);
    putVarint(bytes, band.kd);
  }
  return bytes;
}

// Gives the track its codec parameters and packets: { cluster, start, span, bytes, numbers }, as they will be decoded.
export function encodeTrack(track, limits, clusterSeconds) {
  track.level = limits.level;
  track.parameters = track.codec === 'RAWB' ? [WORD_SIZES[track.numberFormat], 0, 0, 0] : lpcrParameters(track.band, limits);
  track.setup = parseParameters(track.codec, Uint8Array.from(track.parameters), track);
  track.packets = [...stretches(track, clusterSeconds)].map(({ cluster, start, stop, at }) => {
    const span = stop - start;
    const bytes = encodeNumbers(track, track.numbers.slice(at, at + span));
    return { cluster, start, span, bytes, numbers: decodePacket(track, bytes, start, span).numbers };
  });
}

// The spans of a track, cut where clusters of cn / cd seconds begin; at: the place of their first number.
function* stretches({ rateNum, rateDen, spans }, [cn, cd]) {
  const ticks = BigInt(cn) * BigInt(rateNum); // of a cluster, times `part`
  const part = BigInt(cd) * BigInt(rateDen);
  let at = 0;
  for (const [first, last] of spans) {
    for (let start = first; start < last;) {
      const cluster = (BigInt(start) * part) / ticks;
      const next = -floorDivBig(-((cluster + 1n) * ticks), part);
      const stop = Math.min(last, start + PACKET_TICKS, Number(next));
      yield { cluster, start, stop, at };
      at += stop - start;
      start = stop;
    }
  }
}

// The index whose cell a count lies in: that of the level below it, or of the next one where that is too far away.
function indexOf(grid, levels, count) {
  const distance = count - grid.zero;
  if (!levels) return Math.round(distance / grid.step);
  const magnitude = Math.abs(distance);
  let low = 0;
  let high = levels.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (levels[middle] <= magnitude) low = middle;
    else high = middle - 1;
  }
  if (magnitude - levels[low] > Math.max(Math.floor((grid.kn * magnitude) / grid.kd), grid.step)) low++;
  return distance < 0 ? -low : low;
}

function encodeNumbers(track, numbers) {
  if (track.codec === 'RAWB') return encodeWords(numbers, track.setup.wordSize);
  const { grid } = track.setup;
  const { levels } = grid;
  return encodeComponent(numbers.map((count) => indexOf(grid, levels, count)));
}

function encodeWords(words, size) {
  const packet = new Uint8Array(1 + size * words.length);
  words.forEach((word, t) => {
    for (let b = 0; b < size; b++) packet[1 + b * words.length + t] = Number((word >> BigInt(8 * b)) & 255n);
  });
  return packet;
}

function textList(text) {
  const bytes = new TextEncoder().encode(text);
  if (bytes.length > 254 || bytes.includes(0)) refuse('a text that no string list can hold');
  return [bytes.length, ...bytes];
}

// A track as TRAK has it.
export function recordOf(track, id) {
  const { kind, calibrations: [{ A, B, D }], texts, band } = track;
  const tlvs = new Map();
  if (track.parameters) tlvs.set(1, track.parameters);
  for (const [type, name] of TEXTS) if (texts[name]) tlvs.set(type, textList(texts[name]));
  if (track.numberFormat === 'counts' && (A !== 1 || B !== 0 || D !== 1)) {
    const calibration = [];
    putSvarint(calibration, A);
    putSvarint(calibration, B);
    putVarint(calibration, D);
    tlvs.set(3, calibration);
  }
  if (band) tlvs.set(16, band.contract);
  const record = [KINDS[kind] | (FORMATS.indexOf(track.numberFormat) << 4), ...new TextEncoder().encode(track.codec), 1];
  putVarint(record, track.rateNum);
  putVarint(record, track.rateDen);
  putSvarint(record, track.countMin);
  putSvarint(record, track.countMax);
  putVarint(record, track.channels[0] ?? 0);
  record.push(0, tlvs.size);
  for (const type of [...tlvs.keys()].sort((a, b) => a - b)) putTlv(record, type, tlvs.get(type));
  return { id, componentCount: 1, record: Uint8Array.from(record) };
}
