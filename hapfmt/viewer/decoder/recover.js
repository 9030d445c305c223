// Recovering a file (docs/spec/recovery.md): writes the chunks that were found.
import { digestPayload, isOverview } from './ancillary.js';
import { isCritical, isSafeToCopy, randomId } from './chunk.js';
import { descriptionsOf } from './describe.js';
import { INDEX_STRETCH, durationNs, packetMs } from './indexes.js';
import { HEAD_ROOM, ROW_ROOM, samplesOf } from './cluster.js';
import { headPayload } from './head.js';
import { writeJson } from './json.js';
import { judgeRecovery, reportOf } from './report.js';
import { verifyFile } from './verify.js';
import { Writer } from './writer.js';

const NOTES = 40;

// -> { bytes, report, verdict }; bytes is null where nothing is written (clause 13).
export function recoverFile(bytes, { fileId } = {}) {
  const file = verifyFile(bytes, { recovering: true });
  if (file.refused) return { bytes: null, report: reportOf(file), verdict: file.verdict };
  const { descriptions, kept } = descriptionsOf(file);
  const writer = new Writer(fileId ?? randomId());
  // HEAD keeps UUID, epoch, encoder and level; the file id is a new one.
  writer.write('HEAD', headPayload(file.head ?? { level: 2 }));
  for (const { payload } of descriptions) writer.write('TRAK', payload);

  const packets = file.packets.filter((packet) => kept.has(packet.track) && !packet.broken);
  const byChunk = new Map();
  for (const packet of packets) {
    if (!byChunk.has(packet.chunk)) byChunk.set(packet.chunk, []);
    byChunk.get(packet.chunk).push(packet);
  }
  const harmed = file.damages.some(({ code }) => code !== 'not-closed');
  let dropped = 0;
  for (const chunk of [...file.chunks].sort((a, b) => a.sequence - b.sequence || a.position - b.position)) {
    const payload = file.bytes.subarray(chunk.payloadStart, chunk.end);
    const { type, track } = chunk;
    if (chunk.known && type === 'DATA') {
      for (const cluster of clustersOf(byChunk.get(chunk) ?? [], file)) {
        writer.writeData(cluster, timesOf(cluster, file));
      }
    } else if (chunk.known && chunk.good && type !== 'dGST') {
      const lostTrack = (type === 'cLOk' || type === 'cMAp') && track !== null && !kept.has(track);
      if (lostTrack) dropped++;
      else if (type !== 'aTTc' || !isOverview(file.bytes, chunk)) writer.write(type, payload);
    } else if (!chunk.known && chunk.intact && !chunk.tooLarge) {
      if (isCritical(chunk) || isSafeToCopy(chunk) || !harmed) writer.write(type, payload);
      else dropped++;
    }
  }
  // Behind the packets that they refer to.
  for (const digest of copiedDigests(file)) writer.write('dGST', digestPayload(digest.track, digest.digest));
  const verdict = judgeRecovery(file, dropped > 0);
  if (verdict === 'damaged') writer.write('mETa', notesPayload(file, dropped));
  writer.writeFoot(durationNs(packets, file.allTracks));
  return { bytes: writer.bytes(), report: reportOf(file, verdict), verdict };
}

// The packets of one cluster, in as many chunks as the limits of the level call for.
export function* clustersOf(packets, file) {
  const { payloadBound, packetBound, sampleBound } = file.limits;
  const sorted = [...packets].sort((a, b) => a.track - b.track || a.start - b.start);
  let group = [];
  let size = HEAD_ROOM;
  let samples = 0;
  for (const packet of sorted) {
    const room = ROW_ROOM + packet.size;
    const more = samplesOf(packet, file.allTracks.get(packet.track));
    const last = group[group.length - 1];
    const same = last && last.track === packet.track && last.start === packet.start;
    if (group.length && (same || size + room > payloadBound || group.length >= packetBound || samples + more > sampleBound)) {
      yield group;
      [group, size, samples] = [[], HEAD_ROOM, 0];
    }
    group.push(packet);
    size += room;
    samples += more;
  }
  if (group.length) yield group;
}

export function timesOf(packets, file) {
  let times = null;
  for (const packet of packets) {
    const [start, stop] = packetMs(packet, file.allTracks.get(packet.track));
    times = times ? [start < times[0] ? start : times[0], stop > times[1] ? stop : times[1]] : [start, stop];
  }
  return times;
}

// REC-010: those that were compared and hold, of tracks that are kept; of tracks that cannot be decoded those of a file
// without damage. One that packets of its track follow is not kept.
function copiedDigests(file) {
  const whole = !file.damages.some(({ code }) => code !== 'not-closed');
  const last = new Map();
  for (const packet of file.packets) last.set(packet.track, Math.max(last.get(packet.track) ?? 0, packet.chunkOffset));
  const unread = whole ? file.digests.filter(({ track }) => file.tracks.get(track)?.unsupported) : [];
  return [...file.digestsKept, ...unread].filter(({ track: id, chunk }) => {
    const track = file.tracks.get(id);
    return track && !track.baseLost && (last.get(id) ?? 0) < chunk.position;
  }).sort((a, b) => a.offset - b.offset);
}

// REC-010.
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
