// Decoding process (clause 10), steps 1 and 2: every packet alone, clamped.
import { decodeEvents, decodePacket } from './codecs.js';
import { HapfError, unsupported } from './error.js';
import { pushSpan } from './spans.js';

// What this reader decodes of a file in all, and keeps (LIM-003): few bytes can give many samples.
const SAMPLE_BOUND = 2 ** 26;

// Throws where the file has more samples than that; else packets that break a rule are among the findings.
export function decodeFile(file, { exact = true, sampleBound = SAMPLE_BOUND } = {}) {
  const tracks = new Map();
  for (const track of file.tracks.values()) {
    tracks.set(track.id, { track, pieces: [], spans: [], events: [], failed: false });
  }
  const findings = [];
  checkSamples(file, tracks, sampleBound);
  for (const packet of file.packets) {
    const entry = tracks.get(packet.track);
    if (!entry || !entry.track.setup || entry.track.unsupported) continue;
    const { track } = entry;
    const { start, span, bytes, offset } = packet;
    try {
      if (track.kind === 'events') {
        for (const event of decodeEvents(track, bytes, start, span, offset)) entry.events.push(event);
        continue;
      }
      entry.pieces.push({ start, stop: start + span, ...decodePacket(track, bytes, start, span, { exact, offset }) });
      pushSpan(entry.spans, start, start + span);
    } catch (error) {
      if (!(error instanceof HapfError)) throw error;
      entry.failed = true;
      findings.push(findingOf(error, packet));
    }
  }
  for (const entry of tracks.values()) {
    // In order of their ticks, those of one tick in the order of the file (EVT-004): the sort is stable.
    entry.events.sort((a, b) => a.tick - b.tick);
  }
  return { tracks, findings };
}

function checkSamples(file, tracks, sampleBound) {
  let samples = 0;
  for (const packet of file.packets) {
    const track = tracks.get(packet.track)?.track;
    if (track && track.kind !== 'events') samples += packet.span * track.componentCount;
    if (samples > sampleBound) unsupported('LIM-003', `more than ${sampleBound} samples`, packet.offset);
  }
}

function findingOf({ requirement, offset, message, kind }, packet) {
  return { requirement, offset, message, kind, packet };
}
