// The procedure `walk` of clause 14.1: all chunks of a file, through damage.
import { HEADER_SIZE, beginsWithSignature, clusterSeed, findHeader, readHeader } from './chunk.js';
import { crc32 } from './crc32.js';
import { unsupported } from './error.js';
import { FOOT_SIZE } from './indexes.js';
import { heldSize } from './salvage.js';

const MEBIBYTE = 2 ** 20;
// Each chunk and each damage is kept: a reader's own bound (LIM-003).
const CHUNK_BOUND = 2 ** 20;

// REC-005: what the reading of one file may cost in bytes looked at.
class Meter {
  constructor(size) {
    this.left = 16 * size + 64 * MEBIBYTE;
  }

  take(n, offset) {
    this.left -= n;
    if (this.left < 0) unsupported('REC-005', 'too much work on nested headers', offset);
  }
}

// -> { fileId, signed, chunks, damages, meter }. A chunk is its header and payloadStart, end, whole, intact, and of a chunk that
// is not intact `next`, where the walk finds the next header (null: nowhere).
export function walk(bytes) {
  const size = bytes.length;
  const damages = [];
  const chunks = [];
  const meter = new Meter(size);
  const payloadHolds = (header) => {
    const start = header.position + HEADER_SIZE;
    meter.take(Math.min(header.payloadSize, size - start), header.position);
    return start + header.payloadSize <= size && crc32(bytes, start, start + header.payloadSize, header.seed) === header.payloadCrc;
  };
  const report = (code, offset, length, message, requirement) => {
    if (damages.length >= CHUNK_BOUND) unsupported('LIM-003', 'too many damages', offset);
    damages.push({ code, offset, size: length, message, requirement, chunk: null, after: chunks.length });
  };

  const signed = beginsWithSignature(bytes);
  const fileId = identify(bytes, signed, payloadHolds, meter);
  if (fileId === null) return { fileId, signed, chunks, damages, meter };
  let position = signed ? 8 : 0;
  if (!signed) report('bad-signature', 0, 8, 'the signature is damaged', 'FIL-001');

  // Each other id once. Chunks may lie in chunks: no byte is searched twice.
  const known = new Set([fileId]);
  let searched = 0;
  const strangers = (start, stop) => {
    for (let from = Math.max(start, searched); ;) {
      const header = findHeader(bytes, from, () => true);
      if (!header || header.position >= stop) break;
      if (!known.has(header.fileId)) {
        known.add(header.fileId);
        report('other-file', header.position, 0, `a chunk of the file ${header.fileId}; this one is ${fileId}`, 'REC-013');
      }
      from = header.position + 1;
    }
    searched = Math.max(searched, stop);
  };

  const seen = new Set();
  let last = -1;
  let suspectFrom = null;
  for (;;) {
    let header = position < size ? readHeader(bytes, position) : null;
    if (header && header.fileId !== fileId) header = null;
    if (!header) {
      if (position >= size && suspectFrom === null) break;
      const next = findHeader(bytes, suspectFrom ?? position, (h) => h.fileId === fileId);
      const stop = next ? next.position : size;
      if (stop > position) {
        report('garbage', position, stop - position, 'bytes that are no chunk', 'FIL-002');
        strangers(position, stop);
      }
      const previous = chunks[chunks.length - 1];
      if (previous && previous.next === undefined) previous.next = next ? next.position : null;
      if (!next) break;
      position = next.position;
      suspectFrom = null;
      continue;
    }
    const previous = chunks[chunks.length - 1];
    if (previous && previous.next === undefined) previous.next = position;
    const { payloadStart, end, whole } = header;
    const intact = payloadHolds(header);
    if (seen.has(header.sequence)) {
      report('duplicate-chunk', position, end - position, `number ${header.sequence} for the second time`, 'CHK-005');
      suspectFrom = payloadStart;
      position = end;
      continue;
    }
    if (header.sequence > last + 1) report('missing-chunk', position, 0, `number ${header.sequence} after ${last}`, 'CHK-005');
    else if (header.sequence <= last) report('out-of-order', position, 0, `number ${header.sequence} after ${last}`, 'CHK-005');
    last = header.sequence;
    const chunk = header;
    chunk.intact = intact;
    chunk.order = chunks.length;
    if (!intact) {
      report(whole ? 'bad-payload' : 'truncated', position, end - position,
        whole ? 'the payload differs from its CRC' : 'the payload is cut short', 'CHK-003');
      chunk.damage = damages[damages.length - 1];
      chunk.damage.chunk = chunk;
      if (chunk.type !== 'aTTc') strangers(payloadStart, end);
    } else {
      seen.add(header.sequence);
    }
    if (chunks.length >= CHUNK_BOUND) unsupported('LIM-003', 'too many chunks', position);
    chunks.push(chunk);
    suspectFrom = intact ? null : payloadStart;
    position = end;
  }
  return { fileId, signed, chunks, damages, meter };
}

// The id of the HEAD at the start and of the last index or footer, if they agree. Else, of the ids with a TRAK or of that last one,
// the id under which most bytes are valid; of several the one whose first header is last (REC-013).
function identify(bytes, signed, payloadHolds, meter) {
  const last = lastMark(bytes, payloadHolds);
  const first = signed ? readHeader(bytes, 8) : null;
  if (last !== null && first && first.type === 'HEAD' && first.fileId === last && payloadHolds(first)) return last;
  const votes = new Map(); // in the order of their first headers
  const described = new Set([last]);
  for (let from = 0; ;) {
    const header = findHeader(bytes, from, () => true);
    if (!header) break;
    const { fileId, type, payloadStart, payloadSize, end, sequence } = header;
    const intact = payloadHolds(header);
    let held = intact ? HEADER_SIZE + payloadSize : 0;
    if (type === 'DATA' && !intact) {
      meter.take(8 * (end - payloadStart), header.position);
      held = heldSize(bytes, header, clusterSeed(header.seed, sequence));
    }
    if (type === 'TRAK' && intact) described.add(fileId);
    votes.set(fileId, (votes.get(fileId) ?? 0) + held);
    const stop = payloadStart + payloadSize;
    const next = stop < bytes.length ? readHeader(bytes, stop) : null;
    const follows = next !== null && next.fileId === fileId && next.sequence === sequence + 1;
    from = intact || type === 'aTTc' || stop === bytes.length || follows ? stop : header.position + 1;
  }
  const all = [...votes];
  const chosen = all.some(([fileId]) => described.has(fileId)) ? all.filter(([fileId]) => described.has(fileId)) : all;
  let best = null;
  for (const [fileId, held] of chosen) if (best === null || held >= votes.get(best)) best = fileId;
  return best;
}

// The id of the footer that ends the file, or of the last intact index or footer; null where there is none.
function lastMark(bytes, payloadHolds) {
  const at = bytes.length - HEADER_SIZE - FOOT_SIZE;
  const foot = at >= 0 ? readHeader(bytes, at) : null;
  if (foot && foot.type === 'fOOT' && foot.payloadSize === FOOT_SIZE && payloadHolds(foot)) return foot.fileId;
  for (let position = bytes.length - HEADER_SIZE; position >= 0; position--) {
    const header = readHeader(bytes, position);
    if (header && (header.type === 'iNDX' || header.type === 'fOOT') && payloadHolds(header)) return header.fileId;
  }
  return null;
}
