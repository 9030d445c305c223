// Recovering a file (12.3): a writer of what was found.
import { putVarint } from './bytes.js';
import { HEADER_SIZE, SIGNATURE, isCritical, isSafeToCopy, makeChunk } from './chunk.js';
import { descriptionsOf } from './describe.js';
import { durationNs, packetMs } from './indexes.js';
import { samplesOf } from './cluster.js';
import { writeJson } from './json.js';
import { judgeRecovery, reportOf } from './report.js';
import { verifyFile } from './verify.js';

const INDEX_STRETCH = 4 * 2 ** 20;
const INDEX_ROOM = 2 ** 19;
const NOTES = 40;
const MS_BOUND = 2n ** 53n - 1n;

class Writer {
  constructor(fileId) {
    this.fileId = fileId;
    this.parts = [SIGNATURE];
    this.offset = SIGNATURE.length;
    this.sequence = 0;
    this.pending = [];
    this.pendingFrom = 8;
    this.previous = 0;
    this.size = 0;
  }

  write(type, payload, { track, flags, times } = {}) {
    const size = HEADER_SIZE + payload.length;
    // IDX-005.
    const far = this.offset - this.pendingFrom + size > INDEX_STRETCH || this.size > INDEX_ROOM;
    if (far && this.pending.length && type !== 'iNDX') this.writeIndex();
    if (type !== 'iNDX' && type !== 'fOOT') {
      this.pending.push({ type, offset: this.offset, times });
      this.size += 4 + 8 + (times ? 16 : 0);
    }
    this.parts.push(makeChunk({ type, fileId: this.fileId, sequence: this.sequence++, track, flags }, payload));
    this.offset += size;
  }

  // It covers from the index before it on (IDX-004), which it need not list.
  writeIndex() {
    const list = [];
    let before = this.pendingFrom;
    for (const { type, offset, times } of this.pending) {
      for (let i = 0; i < 4; i++) list.push(type.charCodeAt(i));
      putVarint(list, offset - before);
      before = offset;
      if (!times) continue;
      const [start, stop] = times.map((t) => Number(t > MS_BOUND ? MS_BOUND : t));
      putVarint(list, start);
      putVarint(list, stop - start);
    }
    const payload = new Uint8Array(20 + list.length);
    const view = new DataView(payload.buffer);
    view.setBigUint64(0, BigInt(this.pendingFrom), true);
    view.setBigUint64(8, BigInt(this.previous), true);
    view.setUint32(16, this.pending.length, true);
    payload.set(list, 20);
    const at = this.offset;
    this.pending = [];
    this.size = 0;
    this.write('iNDX', payload);
    this.previous = at;
    this.pendingFrom = at;
  }

  writeFoot(dataCount, trackCount, duration) {
    this.writeIndex();
    const payload = new Uint8Array(32);
    const view = new DataView(payload.buffer);
    view.setBigUint64(0, BigInt(this.previous), true);
    view.setBigUint64(8, BigInt(this.offset + HEADER_SIZE + payload.length), true);
    view.setUint32(16, dataCount, true);
    view.setUint32(20, trackCount, true);
    view.setBigInt64(24, duration, true);
    this.write('fOOT', payload);
  }

  bytes() {
    const whole = new Uint8Array(this.offset);
    let at = 0;
    for (const part of this.parts) {
      whole.set(part, at);
      at += part.length;
    }
    return whole;
  }
}

// -> { bytes, report, verdict }; bytes is null where nothing is written (clause 14).
export function recoverFile(bytes, { fileId } = {}) {
  const file = verifyFile(bytes, { recovering: true });
  if (file.refused) return { bytes: null, report: reportOf(file), verdict: file.verdict };
  const { descriptions, kept } = descriptionsOf(file);
  const writer = new Writer(fileId ?? globalThis.crypto.getRandomValues(new Uint32Array(1))[0]);
  writer.write('HEAD', headPayload(file, writer.fileId));
  for (const { track, payload } of descriptions) writer.write('TRAK', payload, { track });

  const packets = file.packets.filter((packet) => kept.has(packet.track) && !packet.broken);
  const byChunk = new Map();
  for (const packet of packets) {
    if (!byChunk.has(packet.chunk)) byChunk.set(packet.chunk, []);
    byChunk.get(packet.chunk).push(packet);
  }
  const copied = copiedDigests(file);
  const harmed = file.damages.some(({ code }) => code !== 'not-closed');
  let dropped = 0;
  let dataCount = 0;
  for (const chunk of [...file.chunks].sort((a, b) => a.sequence - b.sequence || a.position - b.position)) {
    const payload = file.bytes.subarray(chunk.payloadStart, chunk.end);
    const { type, track, flags } = chunk;
    if (chunk.known && type === 'DATA') {
      for (const cluster of clustersOf(byChunk.get(chunk) ?? [], file)) {
        writer.write('DATA', cluster.payload, { times: cluster.times });
        dataCount++;
      }
    } else if (chunk.known && type === 'dGST') {
      for (const digest of copied.get(chunk) ?? []) writer.write('dGST', digest.digest, { track: digest.track });
    } else if (chunk.known && chunk.good) {
      const lostTrack = (type === 'cLOk' || type === 'cMAp') && track !== 0xffff && !kept.has(track);
      if (lostTrack) dropped++;
      else writer.write(type, payload, { track, flags: flags & 0xff00 });
    } else if (!chunk.known && chunk.intact && !chunk.tooLarge) {
      if (isCritical(chunk) || isSafeToCopy(chunk) || !harmed) writer.write(type, payload, { track, flags });
      else dropped++;
    }
  }
  const verdict = judgeRecovery(file, dropped > 0);
  if (verdict === 'damaged') writer.write('mETa', notesPayload(file, dropped));
  const trackCount = descriptions.reduce((sum, { ids }) => sum + ids.length, 0);
  writer.writeFoot(dataCount, trackCount, durationNs(packets, file.allTracks));
  return { bytes: writer.bytes(), report: reportOf(file, verdict), verdict };
}

// HEAD keeps UUID, epoch and level; the file id is a new one.
function headPayload(file, fileId) {
  const { head, headChunk } = file;
  const harmed = headChunk && file.notes.some((note) => note.chunk === headChunk);
  const payload = headChunk && !harmed ? file.bytes.slice(headChunk.payloadStart, headChunk.end) : new Uint8Array(48);
  const view = new DataView(payload.buffer);
  if (!headChunk) {
    payload.set([1, 0, 2]);
    view.setBigUint64(40, 2n ** 64n - 1n, true);
  } else if (harmed) {
    payload.set([1, head.minor, head.level]);
    view.setUint32(8, head.compat, true);
    payload.set(head.uuid, 16);
    view.setBigInt64(32, head.epochNs, true);
    view.setBigUint64(40, head.epochUncertaintyNs, true);
  }
  view.setUint32(12, fileId, true);
  return payload;
}

// The packets of one cluster, in as many chunks as the limits of the level call for.
function* clustersOf(packets, file) {
  const { payloadBound, packetBound, sampleBound } = file.limits;
  const sorted = [...packets].sort((a, b) => a.track - b.track || a.start - b.start);
  let group = [];
  let size = 8;
  let samples = 0;
  for (const packet of sorted) {
    const room = packet.rowEnd - packet.at + packet.size;
    const more = samplesOf(packet, file.allTracks.get(packet.track));
    const last = group[group.length - 1];
    const same = last && last.track === packet.track && last.start === packet.start;
    if (group.length && (same || size + room > payloadBound || group.length >= packetBound || samples + more > sampleBound)) {
      yield clusterOf(group, file);
      [group, size, samples] = [[], 8, 0];
    }
    group.push(packet);
    size += room;
    samples += more;
  }
  if (group.length) yield clusterOf(group, file);
}

function clusterOf(packets, file) {
  const count = [];
  putVarint(count, packets.length);
  const rows = packets.map((packet) => file.bytes.subarray(packet.at, packet.rowEnd));
  const parts = [Uint8Array.from(count), ...rows, ...packets.map((packet) => packet.bytes)];
  const payload = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  let times = null;
  for (const part of parts) {
    payload.set(part, at);
    at += part.length;
  }
  for (const packet of packets) {
    const [start, stop] = packetMs(packet, file.allTracks.get(packet.track));
    times = times ? [start < times[0] ? start : times[0], stop > times[1] ? stop : times[1]] : [start, stop];
  }
  return { payload, times };
}

// REC-009: those that were compared and hold, of tracks that are kept; of tracks that cannot be decoded those of
// which nothing is missing.
function copiedDigests(file) {
  const byChunk = new Map();
  const whole = !file.damages.some(({ code }) => code !== 'not-closed');
  const unread = whole ? file.digests.filter(({ track }) => file.tracks.get(track)?.unsupported) : [];
  for (const digest of [...file.digestsKept, ...unread]) {
    const track = file.tracks.get(digest.track);
    if (!track || track.baseLost) continue;
    if (!byChunk.has(digest.chunk)) byChunk.set(digest.chunk, []);
    byChunk.get(digest.chunk).push(digest);
  }
  return byChunk;
}

// REC-011.
function notesPayload(file, dropped) {
  const before = file.metadata?.notes;
  const kept = Array.isArray(before) ? before : before === undefined ? [] : [writeJson(before)];
  const report = reportOf(file);
  const lines = [];
  for (const { damages, lost } of [report, { damages: [], lost: report.lost }]) {
    for (const damage of damages) lines.push(`${damage.message} (${damage.code}) at byte ${damage.offset}${spansText(damage.lost)}`);
    if (!damages.length && lost.length) lines.push(`lost${spansText(lost)}`);
  }
  if (dropped) lines.push(`${dropped} chunks were left out`);
  const shown = lines.slice(0, NOTES).map((line) => `recovered: ${line.slice(0, 400)}`);
  if (lines.length > NOTES) shown.push(`recovered: ${lines.length - NOTES} damages more`);
  const encode = (notes) => new TextEncoder().encode(writeJson({ notes }));
  const all = encode([...kept, ...shown]);
  return all.length <= file.limits.payloadBound ? all : encode(shown);
}

function spansText(spans) {
  if (!spans.length) return '';
  const texts = spans.slice(0, 8).map(({ track, start, stop }) => `track ${track} from tick ${start} to ${stop ?? 'an unknown end'}`);
  return `: ${texts.join(', ')}${spans.length > 8 ? ` and ${spans.length - 8} spans more` : ''}`;
}
