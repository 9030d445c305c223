// The verb `encode`: a job of conformance/README.md as a file (clause 13). Modes: lossless, and deadband on the grid of
// LPCR; words are kept as they are.
import { putSvarint, putVarint } from './bytes.js';
import { decodePacket, parseParameters } from './codecs.js';
import { crc32 } from './crc32.js';
import { TrackDigest } from './digest.js';
import { encodeComponent } from './encode-lpcr.js';
import { encodeEvents } from './encode-events.js';
import { HapfError, unsupported } from './error.js';
import { durationNs, packetMs } from './indexes.js';
import { floorDivBig } from './integers.js';
import { TRACK_BOUND, limitsOf } from './limits.js';
import { writeJson } from './json.js';
import { WORD_SIZES } from './rawb.js';
import { checkCalibration } from './values.js';
import { NO_TRACK } from './chunk.js';
import { Writer } from './writer.js';

export const MODES = ['lossless', 'deadband'];

const FORMATS = ['counts', 'int64', 'uint64', 'binary16', 'binary32', 'binary64'];
const KINDS = { full: 0, events: 3 };
const TEXTS = [[2, 'label'], [4, 'unit'], [6, 'quantity'], [8, 'axis'], [10, 'group'], [12, 'body_site'], [14, 'device']];
const PACKET_TICKS = 65536;
const CHUNK_BYTES = 2 ** 19;
const LEVEL_1_HIGH = 2 ** 23;

const le = (value, size) => Array.from({ length: size }, (_, i) => Math.floor(value / 256 ** i) & 255);
const refuse = (message) => unsupported('LIM-003', message, null);

function tlv(type, value) {
  if (value.length > 65535) refuse('a description that is too long');
  return [...le(type, 2), ...le(value.length, 2), ...value];
}

function textList(text) {
  const bytes = new TextEncoder().encode(text);
  if (bytes.length > 254 || bytes.includes(0)) refuse('a text that no string list can hold');
  return [bytes.length, ...bytes];
}

// The counts of a channel, or its words as BigInts.
function numbersOf({ format = 'counts', spans }, bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const length = spans.reduce((sum, [start, stop]) => sum + stop - start, 0);
  if (8 * length !== bytes.length) throw new Error(`${bytes.length} bytes instead of ${8 * length}`);
  if (format !== 'counts') return Array.from({ length }, (_, i) => view.getBigUint64(8 * i, true));
  return Array.from({ length }, (_, i) => Number(view.getBigInt64(8 * i, true)));
}

// A grid of LPCR whose cells are no wider than the contract says, and the contract (clause 11).
function deadbandOf(job, calibration) {
  const [kn, kd] = job.k ?? [0, 1];
  const floor = job.floor ?? 1;
  if (floor < 1) return null; // nothing but the counts themselves keeps that
  if (kn < 0 || kd < 1 || kn >= 65536 || kd >= 65536 || floor >= 2 ** 32) refuse('a contract beyond its limits');
  const zero = Math.max(-(2 ** 31), Math.min(2 ** 31 - 1, Math.round(-calibration.B / calibration.A))) || 0;
  const contract = [];
  putVarint(contract, kd);
  putVarint(contract, kn);
  contract.push(job.guaranteed ? 2 : 0);
  putVarint(contract, floor);
  putSvarint(contract, zero);
  const uniform = kn === 0 || kd > 1024 * kn; // then the floor alone
  return { kn, kd, floor, zero, contract, uniform };
}

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

function makeTrack(id, channel, numbers, job) {
  const { format = 'counts', rate } = channel;
  const words = format !== 'counts';
  const [A, B, D] = channel.calibration ?? [1, 0, 1];
  const track = {
    id, kind: 'full', codec: words ? 'RAWB' : 'LPCR', numberFormat: format, componentCount: 1, rateNum: rate[0],
    rateDen: rate[1], countMin: 0, countMax: 0, channels: [id], calibrations: [{ A, B, D }], contract: null, deviation: null,
    firstChannel: id, texts: channel, numbers, spans: channel.spans, band: null,
  };
  if (!words) {
    for (const count of numbers) {
      if (count < track.countMin) track.countMin = count;
      if (count > track.countMax) track.countMax = count;
    }
    if (track.countMin < -(2 ** 31) || track.countMax >= 2 ** 31) refuse('counts of more than 32 bits');
    try {
      checkCalibration({ A, B, D }, track, null, null);
    } catch (error) {
      if (error instanceof HapfError) refuse(error.message);
      throw error;
    }
    if (job.mode !== 'lossless') track.band = deadbandOf(job, { A, B, D });
  }
  return track;
}

const needsLevel2 = ({ countMin, countMax, band }) => countMin < -LEVEL_1_HIGH || countMax >= LEVEL_1_HIGH
  || (band !== null && (Math.abs(band.zero) > LEVEL_1_HIGH || 2 * band.floor >= 2 ** 24));

function describe(track, limits) {
  const { calibrations: [{ A, B, D }], texts, band } = track;
  track.level = limits.level;
  const parameters = track.codec === 'RAWB' ? [WORD_SIZES[track.numberFormat], 0, 0, 0] : lpcrParameters(band, limits);
  const payload = [
    1, 1, KINDS[track.kind], FORMATS.indexOf(track.numberFormat), ...new TextEncoder().encode(track.codec),
    ...le(track.rateNum, 4), ...le(track.rateDen, 4), ...le(track.countMin >>> 0, 4), ...le(track.countMax >>> 0, 4),
    ...le(track.firstChannel, 2), ...le(NO_TRACK, 2),
  ];
  const tlvs = new Map();
  if (track.kind !== 'events') {
    tlvs.set(1, parameters);
    track.setup = parseParameters(track.codec, Uint8Array.from(parameters), track);
  }
  for (const [type, name] of TEXTS) if (texts[name]) tlvs.set(type, textList(texts[name]));
  if (track.numberFormat === 'counts' && track.kind !== 'events' && (A !== 1 || B !== 0 || D !== 1)) {
    const calibration = [];
    putSvarint(calibration, A);
    putSvarint(calibration, B);
    putVarint(calibration, D);
    tlvs.set(3, calibration);
  }
  if (band) tlvs.set(16, band.contract);
  for (const type of [...tlvs.keys()].sort((a, b) => a - b)) payload.push(...tlv(type, tlvs.get(type)));
  return Uint8Array.from(payload);
}

function encodeWords(words, size) {
  const packet = new Uint8Array(1 + size * words.length);
  words.forEach((word, t) => {
    for (let b = 0; b < size; b++) packet[1 + b * words.length + t] = Number((word >> BigInt(8 * b)) & 255n);
  });
  return packet;
}

function encodeNumbers(track, numbers) {
  if (track.codec === 'RAWB') return encodeWords(numbers, track.setup.wordSize);
  const { grid } = track.setup;
  const { levels } = grid;
  return encodeComponent(numbers.map((count) => indexOf(grid, levels, count)));
}

// The packets of a track, cut where clusters of cn / cd seconds begin: { cluster, track, start, span, bytes }.
function* packetsOf(track, [cn, cd]) {
  const ticks = BigInt(cn) * BigInt(track.rateNum); // of a cluster, times `part`
  const part = BigInt(cd) * BigInt(track.rateDen);
  let at = 0;
  for (const [first, stop] of track.spans) {
    for (let start = first; start < stop;) {
      const cluster = (BigInt(start) * part) / ticks;
      const next = -floorDivBig(-((cluster + 1n) * ticks), part);
      const end = Math.min(stop, start + PACKET_TICKS, Number(next));
      const bytes = encodeNumbers(track, track.numbers.slice(at, at + end - start));
      yield { cluster, track: track.id, start, span: end - start, bytes };
      at += end - start;
      start = end;
    }
  }
}

function rowOf({ track, start, span, bytes }) {
  const row = [];
  for (const value of [track, bytes.length, start, span]) putVarint(row, value);
  const crc = crc32(bytes, 0, bytes.length, crc32(Uint8Array.from(row)));
  return [...row, ...le(crc, 4)];
}

// One DATA chunk.
function writeCluster(writer, packets, tracks) {
  const table = [];
  putVarint(table, packets.length);
  for (const packet of packets) table.push(...rowOf(packet));
  const payload = new Uint8Array(table.length + packets.reduce((sum, { bytes }) => sum + bytes.length, 0));
  payload.set(table);
  let at = table.length;
  let times = null;
  for (const packet of packets) {
    payload.set(packet.bytes, at);
    at += packet.bytes.length;
    const [start, stop] = packetMs(packet, tracks[packet.track]);
    times = times === null ? [start, stop] : [start < times[0] ? start : times[0], stop > times[1] ? stop : times[1]];
  }
  writer.write('DATA', payload, { times });
}

// One or several, as the limits of the level call for.
function writeClusters(writer, packets, tracks, limits) {
  let group = [];
  let size = 0;
  let samples = 0;
  let count = 0;
  const flush = () => {
    if (group.length === 0) return;
    writeCluster(writer, group, tracks);
    count++;
    [group, size, samples] = [[], 0, 0];
  };
  for (const packet of packets) {
    const room = packet.bytes.length + 32;
    const more = tracks[packet.track].kind === 'events' ? packet.bytes.length : packet.span;
    if (size + room > CHUNK_BYTES || samples + more > limits.sampleBound || group.length === limits.packetBound) flush();
    group.push(packet);
    size += room;
    samples += more;
  }
  flush();
  return count;
}

function headOf(level, fileId) {
  const payload = new Uint8Array(48);
  const view = new DataView(payload.buffer);
  payload.set([1, 0, level]);
  view.setUint32(12, fileId, true);
  view.setBigUint64(40, 2n ** 64n - 1n, true); // the epoch is not known
  return payload;
}

// job: the parsed JSON; read(name): the bytes of a file beside it. -> the bytes of the file.
export function encodeJob(job, read) {
  if (!MODES.includes(job.mode)) refuse(`mode ${job.mode}`);
  const layers = job.events ?? [];
  if (job.channels.length + layers.length > TRACK_BOUND) refuse('too many channels');
  const tracks = job.channels.map((channel, id) => makeTrack(id, channel, numbersOf(channel, read(channel.numbers)), job));
  const limits = limitsOf(tracks.some(needsLevel2) ? 2 : 1);
  const fileId = job.file_id ?? globalThis.crypto.getRandomValues(new Uint32Array(1))[0]; // WRT-005
  const writer = new Writer(fileId);
  writer.write('HEAD', headOf(limits.level, fileId));
  layers.forEach(({ label, rate }) => {
    tracks.push({
      id: tracks.length, kind: 'events', codec: 'EVNT', numberFormat: 'counts', componentCount: 1, rateNum: rate[0],
      rateDen: rate[1], countMin: 0, countMax: 0, channels: [], calibrations: [{ A: 1, B: 0, D: 1 }], firstChannel: NO_TRACK,
      texts: { label }, band: null,
    });
  });
  for (const track of tracks) writer.write('TRAK', describe(track, limits), { track: track.id });
  if (job.metadata) writer.write('mETa', new TextEncoder().encode(writeJson(job.metadata)));

  const clusters = new Map();
  const digests = [];
  const all = [];
  for (const track of tracks.slice(0, job.channels.length)) {
    const digest = new TrackDigest();
    for (const packet of packetsOf(track, job.cluster_s ?? [1, 1])) {
      // What stands in the file is what a decoder makes of it (WRT-003 in small).
      digest.add(packet.start, packet.span, decodePacket(track, packet.bytes, packet.start, packet.span));
      if (!clusters.has(packet.cluster)) clusters.set(packet.cluster, []);
      clusters.get(packet.cluster).push(packet);
      all.push(packet);
    }
    digests.push(digest.value());
  }
  let dataCount = 0;
  for (const cluster of [...clusters.keys()].sort((a, b) => (a < b ? -1 : 1))) {
    dataCount += writeClusters(writer, clusters.get(cluster), tracks, limits);
  }
  layers.forEach(({ events }, i) => {
    const packets = encodeEvents(job.channels.length + i, events);
    all.push(...packets);
    dataCount += writeClusters(writer, packets, tracks, limits);
  });
  digests.forEach((digest, id) => writer.write('dGST', digest, { track: id }));
  writer.writeFoot(dataCount, tracks.length, durationNs(all, new Map(tracks.map((track) => [track.id, track]))));
  return writer.bytes();
}
