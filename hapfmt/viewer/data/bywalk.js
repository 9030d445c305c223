// A file without an index, or with damage: all of its bytes, read by the procedures of clause 14.
import { unsupported } from '../decoder/error.js';
import { openFile } from '../decoder/file.js';
import { writeJson } from '../decoder/json.js';
import { judge, settle } from '../decoder/report.js';
import { guarded } from '../decoder/verify.js';
import { WHOLE_BOUND } from './sources.js';

const STEP = 2 ** 22;

// onProgress: bytes read, of how many.
export async function readWhole(source, onProgress = () => {}, signal = undefined) {
  const { size } = source;
  if (size > WHOLE_BOUND) unsupported('LIM-003', `a file of ${size} bytes has to be read as a whole`, 0);
  if (size <= STEP) return source.read(0, size, signal);
  const bytes = new Uint8Array(size);
  for (let at = 0; at < size; at += STEP) {
    const stop = Math.min(at + STEP, size);
    bytes.set(await source.read(at, stop, signal), at);
    onProgress(stop, size);
  }
  return bytes;
}

export function walkFile(bytes) {
  const found = openFile(bytes);
  if (!found.refused) guarded(found, () => settle(found));
  const verdict = judge(found);
  if (found.refused) throw found.refused;
  if (found.criticalUnknown) {
    const { requirement, message, offset } = found.findings.find(({ kind }) => kind === 'unsupported');
    unsupported(requirement, message, offset);
  }
  for (const track of found.allTracks.values()) track.origin = track.description.chunk.position;
  return {
    fileId: found.fileId, closed: found.closed, head: found.head, level: found.level, limits: found.limits,
    tracks: found.tracks, allTracks: found.allTracks, clusters: clustersOf(found), bytes, verdict,
    metadata: found.metadata ? JSON.parse(writeJson(found.metadata)) : {},
    attachments: found.attachments.map(({ name, offset, content }) => ({ name, offset, content })),
    findings: found.findings, damages: found.damages, lost: found.lost, durationNs: null,
  };
}

// The packets that are delivered, by chunks.
function clustersOf({ packets, tracks }) {
  const clusters = [];
  let last = null;
  for (const packet of packets) {
    if (last?.offset !== packet.chunkOffset) {
      last = { offset: packet.chunkOffset, stop: packet.chunk.end, startMs: Infinity, stopMs: 0, packets: [] };
      clusters.push(last);
    }
    const { rateNum, rateDen } = tracks.get(packet.track);
    const ms = (1000 * rateDen) / rateNum;
    last.startMs = Math.min(last.startMs, packet.start * ms);
    last.stopMs = Math.max(last.stopMs, (packet.start + packet.span) * ms);
    last.packets.push(packet);
  }
  return clusters;
}
