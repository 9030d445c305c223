// A closed file by its index (11.1): descriptions and the places of clusters, without the packets.
import { readMeta } from '../decoder/ancillary.js';
import { HEADER_SIZE, beginsWithSignature, isCritical, readHeader } from '../decoder/chunk.js';
import { crc32 } from '../decoder/crc32.js';
import { HapfError, unsupported } from '../decoder/error.js';
import { readHead } from '../decoder/head.js';
import { FOOT_SIZE, readFoot, readIndex } from '../decoder/indexes.js';
import { writeJson } from '../decoder/json.js';
import { limitsOf } from '../decoder/limits.js';
import { describeTracks } from '../decoder/tracks.js';

const SIGNATURE_SIZE = 8;
const END_SIZE = HEADER_SIZE + FOOT_SIZE;
const ENTRY_BOUND = 2 ** 20;
const READ_AT_OPEN = new Set(['HEAD', 'TRAK', 'mETa']);
const LATER = new Set(['DATA', 'iNDX', 'fOOT', 'aTTc', 'dGST', 'cLOk', 'cMAp']);

// What the index says is not so (IDX-003): the file is walked through.
export class FalseIndex extends Error {}

const need = (holds) => {
  if (!holds) throw new FalseIndex();
};

// A chunk of which all bytes are there, from bytes[0] on.
function chunkOf(bytes, type, fileId) {
  const chunk = readHeader(bytes, 0);
  need(chunk && chunk.whole && chunk.type === type && (fileId === null || chunk.fileId === fileId));
  need(crc32(bytes, chunk.payloadStart, chunk.end, chunk.seed) === chunk.payloadCrc);
  chunk.intact = true;
  return chunk;
}

// -> the facts of the file, or null where anything about its index is not as it should be.
export async function openByIndex(source) {
  try {
    return await open(source);
  } catch (error) {
    if (error instanceof FalseIndex) return null;
    if (error instanceof HapfError && error.kind !== 'io' && error.kind !== 'unsupported') return null;
    throw error;
  }
}

async function open(source) {
  const { size } = source;
  need(size >= SIGNATURE_SIZE + HEADER_SIZE + END_SIZE);
  const last = await source.read(size - END_SIZE, size);
  const footChunk = chunkOf(last, 'fOOT', null);
  const foot = readFoot(last, footChunk);
  need(foot.indexDistance && beginsWithSignature(await source.read(0, SIGNATURE_SIZE)));
  const { fileId } = footChunk;
  const indexOffset = size - END_SIZE - foot.indexDistance;
  const entries = await readChain(source, indexOffset, footChunk);
  need(entries.length && entries[0].type === 'HEAD' && entries[0].offset === SIGNATURE_SIZE);

  const file = {
    fileId, closed: true, head: null, level: 2, tracks: null, allTracks: null, metadata: {}, clusters: [],
    attachments: [], findings: [], durationNs: foot.durationNs, dataStop: indexOffset,
  };
  const chunks = await readDescriptions(source, entries, file);
  learn(chunks, file);
  for (const { type, offset, stop, sequence, startMs, stopMs } of entries) {
    if (type === 'DATA') file.clusters.push({ offset, stop, sequence, startMs, stopMs });
    else if (type === 'aTTc') file.attachments.push({ offset, stop, sequence });
  }
  return file;
}

// All entries, oldest first, each with the end and the sequence number of its chunk.
async function readChain(source, indexOffset, footChunk) {
  const parts = [];
  let count = 0;
  let stop = source.size - END_SIZE;
  let sequence = footChunk.sequence;
  for (let offset = indexOffset; ;) {
    need(offset >= SIGNATURE_SIZE && offset + HEADER_SIZE <= stop);
    const header = readHeader(await source.read(offset, offset + HEADER_SIZE), 0);
    need(header && offset + HEADER_SIZE + header.payloadSize <= stop);
    const end = offset + HEADER_SIZE + header.payloadSize;
    need(parts.length ? header.sequence === sequence : end === stop && header.sequence + 1 === sequence);
    const bytes = await source.read(offset, end);
    const index = readIndex(bytes, chunkOf(bytes, 'iNDX', footChunk.fileId));
    const { entries, firstSequence, previous } = index;
    need(entries.length && firstSequence + entries.length === header.sequence);
    count += entries.length;
    if (count > ENTRY_BOUND) unsupported('LIM-003', 'more index entries than this reader keeps', offset);
    entries.forEach((entry, i) => {
      const next = i + 1 < entries.length ? entries[i + 1].offset : offset;
      need(entry.offset >= previous && entry.offset + HEADER_SIZE <= next && next <= offset);
      entry.stop = next;
      entry.sequence = firstSequence + i;
    });
    parts.push(entries);
    if (previous === 0) break;
    need(previous < offset && entries[0].offset === previous && entries[0].type === 'iNDX');
    stop = offset;
    sequence = firstSequence;
    offset = previous;
  }
  return parts.reverse().flat();
}

async function readDescriptions(source, entries, file) {
  const wanted = entries.filter(({ type }) => READ_AT_OPEN.has(type));
  for (const { type, offset, sequence } of entries) {
    if (READ_AT_OPEN.has(type) || LATER.has(type)) continue;
    const header = readHeader(await source.read(offset, offset + HEADER_SIZE), 0);
    need(header && header.type === type && header.fileId === file.fileId && header.sequence === sequence);
    if (isCritical(header)) unsupported('CHK-009', `an unknown critical chunk ${type}`, offset);
  }
  const parts = await source.readAll(wanted.map(({ offset, stop }) => [offset, stop]));
  return wanted.map(({ type, offset, stop, sequence }, i) => {
    const bytes = parts[i];
    const chunk = chunkOf(bytes, type, file.fileId);
    need(chunk.end === stop - offset && chunk.sequence === sequence);
    return { bytes, chunk, offset };
  });
}

function learn(chunks, file) {
  const [head, ...others] = chunks;
  const read = readHead(head.bytes, head.chunk);
  need(!read.faults.length);
  file.head = read.head;
  file.level = read.head.level;
  file.limits = limitsOf(file.level);
  const descriptions = [];
  for (const { bytes, chunk } of others) {
    need(chunk.type !== 'HEAD' || sameBytes(bytes.subarray(chunk.payloadStart), head.bytes.subarray(head.chunk.payloadStart)));
    need(chunk.payloadSize <= file.limits.payloadBound);
    if (chunk.type === 'mETa') Object.assign(file.metadata, readMeta(bytes, chunk));
    if (chunk.type === 'TRAK') descriptions.push({ bytes, chunk });
  }
  file.metadata = JSON.parse(writeJson(file.metadata));
  describe(descriptions, chunks, file);
}

const sameBytes = (a, b) => a.length === b.length && a.every((byte, i) => byte === b[i]);

// The descriptions one after the other, as describeTracks reads them of a whole file.
function describe(parts, chunks, file) {
  const bytes = new Uint8Array(parts.reduce((sum, part) => sum + part.bytes.length, 0));
  const offsets = new Map(chunks.map(({ chunk, offset }) => [chunk, offset]));
  let at = 0;
  const moved = parts.map((part) => {
    bytes.set(part.bytes, at);
    const chunk = { ...part.chunk, position: at, payloadStart: at + HEADER_SIZE, end: at + part.bytes.length, origin: offsets.get(part.chunk) };
    at += part.bytes.length;
    return chunk;
  });
  const note = (error, chunk) => {
    need(error instanceof HapfError && error.kind === 'unsupported');
    file.findings.push({ requirement: error.requirement, message: error.message, offset: chunk.origin });
  };
  const { tracks, allTracks } = describeTracks(bytes, moved, file.level, false, note);
  for (const track of allTracks.values()) track.origin = track.description.chunk.origin;
  Object.assign(file, { tracks, allTracks });
}
