// A file as clauses 5, 6 and 14.1 tell to read it: all chunks, each rule, no packet decoded yet.
import { readAttachment, readClock, readDigests, readMap, readMeta } from './ancillary.js';
import { isCritical } from './chunk.js';
import { deliver } from './deliver.js';
import { HapfError, unsupported } from './error.js';
import { readHead } from './head.js';
import { checkFoot, checkIndex, durationNs, lateIndexes, packetMs, readFoot, readIndex } from './indexes.js';
import { writeJson } from './json.js';
import { limitsOf } from './limits.js';
import { describeTracks } from './tracks.js';
import { walk } from './walk.js';

// What a reader keeps of a file besides samples (LIM-003, docs/spec/security.md).
const ENTRY_BOUND = 2 ** 21;
const NOTE_BOUND = 2 ** 19;

export function openFile(bytes, { recovering = false } = {}) {
  const file = {
    bytes, head: null, level: 2, tracks: new Map(), allTracks: new Map(), descriptions: [], packets: [], held: [], clusters: [],
    clocks: [], maps: [], metadata: null, attachments: [], unknown: [], digests: [], indexes: [], chunks: [],
    damages: [], lost: [], lostResiduals: [], lostBases: [], findings: [], notes: [], channels: [],
    closed: false, damaged: false, recovering, refused: null, criticalUnknown: false, verdict: null,
  };
  try {
    read(file);
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    refuse(file, error);
  }
  return file;
}

// Nothing of the file is used: an unknown version, or more than this reader's own limits.
function refuse(file, error) {
  file.refused = error;
  for (const name of ['packets', 'held', 'clusters', 'digests', 'damages', 'notes', 'lostResiduals', 'lostBases', 'indexes']) file[name] = [];
  file.tracks = new Map();
  note(file, error, null);
}

// Takes what breaks a rule. soft: true for what is not held against a file with damage, 'closed' for what is held
// against a closed one only (14.2).
function note(file, error, chunk, soft = false, packet = null) {
  if (!(error instanceof HapfError)) throw error;
  if (soft && file.damaged) return;
  if (file.notes.length >= NOTE_BOUND) unsupported('LIM-003', 'more broken rules than this reader tells', error.offset);
  const { kind, offset, message, also = [] } = error;
  for (const requirement of [error.requirement, ...also]) {
    file.notes.push({ requirement, offset, message, kind: kind === 'unsupported' ? kind : 'broken', chunk, packet, soft });
  }
}

function read(file) {
  const { bytes } = file;
  const walked = walk(bytes);
  file.chunks = walked.chunks;
  file.fileId = walked.fileId;
  file.damages = walked.damages;
  file.damaged = walked.damages.length > 0;
  if (walked.fileId === null) {
    file.noChunk = true;
    const error = new HapfError('broken', walked.signed ? 'FIL-002' : 'FIL-001', 'no hapf file: it holds no chunk', walked.signed ? 8 : 0);
    error.also = ['HED-001'];
    throw error;
  }
  const noteIt = (error, chunk, soft, packet) => note(file, error, chunk, soft, packet);

  readHeads(file);
  const limits = limitsOf(file.level);
  file.limits = limits;
  readUnknown(file, limits);
  const of = (type) => file.chunks.filter((chunk) => chunk.type === type && chunk.known && chunk.intact && !chunk.tooLarge);

  const described = describeTracks(bytes, of('TRAK'), file.level, file.damaged, noteIt);
  Object.assign(file, described);
  const delivered = deliver({ ...file, meter: walked.meter, limits, note: noteIt });
  const { damages, ...rest } = delivered;
  Object.assign(file, rest);
  file.damages.push(...damages);
  noteLostBases(file);

  const last = file.chunks[file.chunks.length - 1];
  file.closed = Boolean(last && last.type === 'fOOT' && last.intact);
  readAncillary(file, noteIt);
  readIndexes(file, noteIt);
}

// HED-001. VER-001, HED-004 and TLV-003 end it.
function readHeads(file) {
  let first = null;
  for (const chunk of file.chunks) {
    if (chunk.type !== 'HEAD' || !chunk.known || !chunk.intact) continue;
    const payload = file.bytes.subarray(chunk.payloadStart, chunk.end);
    if (first) {
      const same = payload.length === first.payload.length && payload.every((byte, i) => byte === first.payload[i]);
      if (!same) note(file, new HapfError('broken', 'HED-001', 'a further HEAD differs from the first', chunk.payloadStart), chunk);
      continue;
    }
    try {
      const { head, faults } = readHead(file.bytes, chunk);
      for (const fault of faults) note(file, fault, chunk);
      if (faults.length) continue;
      first = { chunk, payload };
      file.head = head;
      file.headChunk = chunk;
      file.level = head.level;
    } catch (error) {
      if (!(error instanceof HapfError) || error.kind === 'unsupported') throw error;
      note(file, error, chunk);
    }
  }
  const start = file.chunks[0];
  if (start && start.type !== 'HEAD') {
    note(file, new HapfError('broken', 'HED-001', `the first chunk is ${start.type}`, start.position), start, true);
  }
  if (!file.head && (file.damaged || file.recovering)) {
    file.damages.push({ code: 'missing-head', offset: 8, size: 0, requirement: 'HED-001', message: 'no intact HEAD: taken for version 1, level 2' });
  }
}

// LIM-001, CHK-009, CHK-010.
function readUnknown(file, limits) {
  for (const chunk of file.chunks) {
    if (chunk.payloadSize > limits.payloadBound) {
      const error = new HapfError('broken', 'LIM-001', `a payload of ${chunk.payloadSize} bytes`, chunk.position + 16);
      error.also = ['LIM-001'];
      if (chunk.intact) note(file, error, chunk);
      chunk.tooLarge = true;
    }
    if (chunk.known || !chunk.intact) continue;
    if (isCritical(chunk)) {
      file.criticalUnknown = true;
      note(file, new HapfError('unsupported', 'CHK-009', `an unknown critical chunk ${chunk.type}`, chunk.position), chunk);
    } else {
      file.unknown.push([chunk.type, chunk.position]);
    }
  }
}

function noteLostBases(file) {
  for (const track of file.lostBases) {
    if (!file.damaged && !file.recovering) continue;
    file.damages.push({
      code: 'lost-base', offset: track.description.chunk.position, size: 0, requirement: 'TRK-007', track: track.id,
      message: `track ${track.base}, the base of track ${track.id}, is not described`,
    });
  }
}

function readAncillary(file, noteIt) {
  const { bytes, allTracks, tracks, damaged } = file;
  let kept = 0;
  const keep = (n, offset) => {
    kept += n;
    if (kept > ENTRY_BOUND) unsupported('LIM-003', 'more entries than this reader keeps', offset);
  };
  const readers = {
    mETa(chunk) {
      keep(chunk.payloadSize / 16, chunk.position);
      file.metadata = Object.assign(file.metadata ?? Object.create(null), readMeta(bytes, chunk));
    },
    aTTc(chunk) {
      keep(1, chunk.position);
      file.attachments.push(readAttachment(bytes, chunk));
    },
    dGST(chunk) {
      keep(chunk.payloadSize / 32, chunk.position);
      file.digests.push(...readDigests(bytes, chunk, allTracks, tracks, damaged));
    },
    cLOk(chunk) {
      const clock = readClock(bytes, chunk, damaged ? tracks : allTracks, damaged);
      keep(clock.observations.length, chunk.position);
      file.clocks.push(clock);
    },
    cMAp(chunk) {
      const map = readMap(bytes, chunk, damaged ? tracks : allTracks, damaged);
      keep(map.points.length, chunk.position);
      file.maps.push(map);
    },
  };
  for (const chunk of file.chunks) {
    if (!chunk.known || !chunk.intact || chunk.tooLarge || !Object.hasOwn(readers, chunk.type)) continue;
    try {
      readers[chunk.type](chunk);
      chunk.good = true;
    } catch (error) {
      if (!(error instanceof HapfError) || error.requirement === 'LIM-003') throw error;
      noteIt(error, chunk);
    }
  }
  if (file.metadata) file.metadataText = writeJson(file.metadata);
}

// 11.1, 11.2: kept in a file with damage, where they show which chunks are missing; checked in another.
function readIndexes(file, noteIt) {
  const { bytes, chunks, damaged, held, allTracks } = file;
  const byPosition = new Map(chunks.map((chunk) => [chunk.position, chunk]));
  const times = new Map();
  if (!damaged) {
    for (const packet of held) {
      const track = allTracks.get(packet.track);
      if (!track) continue;
      const [first, stop] = packetMs(packet, track);
      const range = times.get(packet.chunkOffset);
      if (!range) times.set(packet.chunkOffset, [first, stop]);
      else times.set(packet.chunkOffset, [first < range[0] ? first : range[0], stop > range[1] ? stop : range[1]]);
    }
  }
  let entries = 0;
  let lastIndex = null;
  if (!damaged) for (const { chunk, error } of lateIndexes(chunks)) noteIt(error, chunk);
  const last = chunks.findLast((c) => c.type === 'fOOT' && c.intact);
  for (const chunk of chunks) {
    if (!chunk.known || !chunk.intact || chunk.tooLarge) continue;
    try {
      if (chunk.type === 'iNDX') {
        const index = readIndex(bytes, chunk);
        if (damaged) {
          entries += index.entries.length;
          if (entries > ENTRY_BOUND) unsupported('LIM-003', 'more index entries than this reader keeps', chunk.position);
          file.indexes.push(index);
        } else {
          for (const fault of checkIndex(index, chunks, byPosition, times)) noteIt(fault, chunk);
        }
        lastIndex = chunk;
      } else if (chunk.type === 'fOOT') {
        const foot = readFoot(bytes, chunk);
        const closing = chunk === last && file.closed;
        if (closing) file.durationNs = foot.durationNs;
        const duration = closing ? durationNs(held, allTracks) : null;
        for (const fault of checkFoot(foot, lastIndex, duration)) noteIt(fault, chunk, true);
      }
    } catch (error) {
      if (!(error instanceof HapfError) || error.requirement === 'LIM-003') throw error;
      noteIt(error, chunk);
    }
  }
}
