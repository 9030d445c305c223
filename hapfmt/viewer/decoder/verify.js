// What a verifier does: every packet is decoded, every digest compared (DGS-002), every rule checked.
import { decodeEvents, decodePacket } from './codecs.js';
import { TrackDigest } from './digest.js';
import { HapfError } from './error.js';
import { openFile } from './file.js';
import { breaksRule, judge, settle } from './report.js';

// Nothing is kept of what is decoded here, so that only time bounds it (LIM-003).
const SAMPLE_BOUND = 2 ** 30;

export const noteOf = ({ requirement, offset, message, kind }, packet) => ({
  requirement, offset, message, kind: kind === 'unsupported' ? kind : 'broken', chunk: packet.chunk, packet, soft: false,
});

// onProgress(done, of): called with the packets that are decoded.
export function verifyFile(bytes, { recovering = false, onProgress = () => {} } = {}) {
  const file = openFile(bytes, { recovering });
  if (!file.refused) {
    // CHK-009.
    const digests = file.criticalUnknown && !recovering ? new Map() : decodeAll(file, onProgress);
    guarded(file, () => {
      settle(file);
      // DGS-002.
      if (file.damaged || recovering || !breaksRule(file)) compareDigests(file, digests);
    });
  }
  judge(file);
  return file;
}

// Whatever a reader's own limits stop ends in the verdict.
export function guarded(file, action) {
  try {
    action();
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    file.refused = error;
    file.damages = [];
    file.lost = [];
    file.notes = [{ ...error, message: error.message, chunk: null, packet: null, soft: false }];
  }
}

// -> Map of the digest chunk's entries to the digests computed at their places. A packet that breaks a rule is left out.
function decodeAll(file, onProgress) {
  const { tracks, packets } = file;
  const states = new Map();
  const wanted = lastDigests(file);
  const results = new Map();
  let samples = 0;
  const channels = new Set();
  for (const track of tracks.values()) for (const channel of track.channels) channels.add(channel);
  let done = 0;
  for (const packet of packets) {
    onProgress(done++, packets.length);
    const track = tracks.get(packet.track);
    if (track.unsupported || !track.setup) continue;
    try {
      if (track.kind === 'events') {
        checkEvents(file, packet, decodeEvents(track, packet.bytes, packet.start, packet.span, packet.offset), channels);
        continue;
      }
      samples += packet.span * track.componentCount;
      if (samples > SAMPLE_BOUND) throw new HapfError('unsupported', 'LIM-003', 'more samples than this reader decodes', packet.offset);
      const decoded = decodePacket(track, packet.bytes, packet.start, packet.span, { exact: true, offset: packet.offset });
      // DGS-003: a digest is of the packets before it.
      const digest = wanted.get(packet.track);
      if (!digest) continue;
      if (packet.chunkOffset > digest.chunk.position) continue;
      if (!states.has(packet.track)) states.set(packet.track, new TrackDigest(track));
      states.get(packet.track).add(packet.start, packet.span, decoded);
    } catch (error) {
      if (!(error instanceof HapfError)) throw error;
      packet.broken = error.kind !== 'unsupported';
      packet.undecoded = true;
      for (const requirement of [error.requirement, ...error.also]) {
        file.notes.push(noteOf({ requirement, offset: error.offset, message: error.message, kind: error.kind }, packet));
      }
    }
  }
  for (const digest of wanted.values()) results.set(digest, (states.get(digest.track) ?? new TrackDigest()).value());
  return results;
}

// EVT-003, of a closed file.
function checkEvents(file, packet, events, channels) {
  const stranger = events.find(({ channel }) => channel !== null && !channels.has(channel));
  file.spokenOf ??= new Set();
  for (const { channel } of events) if (channel !== null) file.spokenOf.add(channel);
  if (!stranger || file.damaged) return;
  file.notes.push({
    ...noteOf(new HapfError('broken', 'EVT-003', `an event of channel ${stranger.channel}, which there is not`, packet.offset), packet),
    packet: null, soft: 'closed',
  });
}

// DGS-002: where a track has several, the last one counts.
function lastDigests(file) {
  const last = new Map();
  for (const digest of file.digests) {
    if (!file.tracks.get(digest.track)?.unsupported) last.set(digest.track, digest);
  }
  return last;
}

function compareDigests(file, computed) {
  const incomplete = new Set();
  for (const { took = [] } of file.damages) for (const { track } of took) incomplete.add(track);
  for (const { track } of file.lost) incomplete.add(track);
  for (const packet of file.held) if (!packet.delivered || packet.undecoded) incomplete.add(packet.track);
  file.incomplete = incomplete;
  file.digestsKept = [];
  for (const [digest, value] of computed) {
    if (incomplete.has(digest.track)) continue;
    if (value.every((byte, i) => byte === digest.digest[i])) {
      file.digestsKept.push(digest);
      continue;
    }
    file.damages.push({
      code: 'bad-digest', offset: digest.offset, size: 32, requirement: 'DGS-002', message: `the digest of track ${digest.track} differs`,
    });
  }
}
