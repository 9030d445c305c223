// mETa, aTTc, dGST, cLOk and cMAp (11.3 to 11.6).
import { Reader, putVarint } from './bytes.js';
import { broken, unsupported } from './error.js';
import { readMetadata } from './json.js';

const DIGEST_SIZE = 32;
const TICK_MAGNITUDE = 2 ** 52;
const TIME_BOUND = 2n ** 63n;
const ENTRY_BOUND = 2 ** 20;

const payloadReader = (bytes, chunk, requirement) => new Reader(bytes, { start: chunk.payloadStart, end: chunk.end, requirement });

export function readMeta(bytes, chunk) {
  return readMetadata(bytes.subarray(chunk.payloadStart, chunk.end), chunk.payloadStart);
}

export function readAttachment(bytes, chunk) {
  const reader = payloadReader(bytes, chunk, 'ATT-001');
  const name = reader.text(reader.u8());
  if (name === '') broken('ATT-001', 'an attachment without a name', chunk.payloadStart);
  const mediaType = reader.text(reader.u8());
  return { name, mediaType, content: reader.bytes(reader.left), offset: chunk.position };
}

// OVW-009: it describes the packets of its own file.
export function isOverview(bytes, chunk) {
  const { name, mediaType } = readAttachment(bytes, chunk);
  return name === 'overview' && mediaType === 'haptics/vnd.hapf.overview';
}

// ATT-002: the name to store an attachment under.
export function safeName(name, number) {
  // eslint-disable-next-line no-control-regex
  const last = name.split(/[/\\:]/).pop().replace(/[\u0000-\u001f\u007f-\u009f]/g, '').replace(/^\.+/, '');
  return last === '' ? `attachment-${number}` : last;
}

// -> [{ track, digest, offset }].
export function readDigests(bytes, chunk, allTracks, tracks, damaged) {
  const reader = payloadReader(bytes, chunk, 'DGS-001');
  const first = reader.varint();
  if (reader.left === 0 || reader.left % DIGEST_SIZE) broken('DGS-001', `digests of ${reader.left} bytes`, reader.offset);
  const digests = [];
  for (let id = first; reader.left > 0; id++) {
    const { offset } = reader;
    const digest = reader.bytes(DIGEST_SIZE);
    const track = allTracks.get(id);
    if (!track) {
      if (damaged) continue;
      broken('DGS-001', `a digest of track ${id}, which is not described`, offset);
    }
    if (!damaged && track.description.chunk.position > chunk.position) {
      broken('DGS-001', `a digest of track ${id}, which is described behind it`, offset);
    }
    if (track.kind === 'events') broken('DGS-001', `a digest of track ${id} of kind events`, offset);
    if (tracks.has(id)) digests.push({ track: id, digest, offset, chunk });
  }
  return digests;
}

export function digestPayload(track, digest) {
  const payload = [];
  putVarint(payload, track);
  return Uint8Array.from([...payload, ...digest]);
}

// The track of a cLOk or cMAp chunk, null: none.
function readClockTrack(reader, chunk) {
  const number = reader.varint();
  chunk.track = number === 0 ? null : number - 1;
}

// The payload of such a chunk in the ticks of another track.
export function clockPayload(payload, track) {
  const reader = new Reader(payload);
  reader.varint();
  const start = [];
  putVarint(start, track === null ? 0 : 1 + track);
  return Uint8Array.from([...start, ...reader.bytes(reader.left)]);
}

// CLK-005.
function clockTrack(chunk, allTracks, damaged) {
  if (chunk.track === null) return null;
  const track = allTracks.get(chunk.track);
  const behind = track && !damaged && track.description.chunk.position > chunk.position;
  if (!track || behind || track?.kind === 'events') {
    broken('CLK-005', `track ${chunk.track} has no clock`, chunk.payloadStart);
  }
  return chunk.track;
}

function readName(reader) {
  const at = reader.offset;
  const name = reader.text(reader.u8());
  if (name === '') broken('CLK-001', 'a clock without a name', at);
  return name;
}

function checkMoment(tick, time, offset) {
  if (Math.abs(tick) >= TICK_MAGNITUDE) broken('CLK-003', `tick ${tick}`, offset);
  if (time >= TIME_BOUND || time < -TIME_BOUND) broken('CLK-003', `time ${time}`, offset);
}

const countOf = (reader, least) => {
  const at = reader.offset;
  const count = reader.varint();
  if (count < least) broken('CLK-001', `${count} entries, not ${least}`, at);
  // Each takes a byte or more: LIM-002.
  if (count > reader.left) broken('CLK-001', `${count} entries in ${reader.left} bytes`, at);
  if (count > ENTRY_BOUND) unsupported('LIM-003', 'more observations than this reader keeps', at);
  return count;
};

const checkEnd = (reader) => {
  if (reader.left) broken('CLK-001', `${reader.left} bytes behind the last entry`, reader.offset);
};

export function readClock(bytes, chunk, allTracks, damaged) {
  const reader = payloadReader(bytes, chunk, 'CLK-001');
  readClockTrack(reader, chunk);
  const name = readName(reader);
  const observations = [];
  let tick = 0;
  let time = 0n;
  for (let left = countOf(reader, 1), first = true; left > 0; left--, first = false) {
    const at = reader.offset;
    tick += reader.svarint();
    time = first ? reader.i64() : time + BigInt(reader.svarint());
    checkMoment(tick, time, at);
    observations.push({ tick, timeNs: time, uncertaintyNs: reader.varint() });
  }
  checkEnd(reader);
  return { track: clockTrack(chunk, allTracks, damaged), name, observations };
}

export function readMap(bytes, chunk, allTracks, damaged) {
  const reader = payloadReader(bytes, chunk, 'CLK-001');
  readClockTrack(reader, chunk);
  const name = readName(reader);
  const points = [];
  let tick = 0;
  let time = 0n;
  for (let left = countOf(reader, 2), first = true; left > 0; left--, first = false) {
    const at = reader.offset;
    const ticks = first ? reader.svarint() : reader.varint();
    const step = first ? reader.i64() : BigInt(reader.varint());
    if (!first && (ticks === 0 || step === 0n)) broken('CLK-003', 'ticks and times that do not grow', at);
    tick += ticks;
    time += step;
    checkMoment(tick, time, at);
    points.push({ tick, timeNs: time });
  }
  checkEnd(reader);
  return { track: clockTrack(chunk, allTracks, damaged), name, points };
}
