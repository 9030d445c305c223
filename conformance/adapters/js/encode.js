// The verb `encode`: a job of conformance/README.md as a file (clause 15). Each channel is a track of its own: counts
// by LPCR, without loss or on the grid of a contract, words as they are.
import { digestPayload } from '../../../hapfmt/viewer/decoder/ancillary.js';
import { randomId } from '../../../hapfmt/viewer/decoder/chunk.js';
import { payloadsOf } from '../../../hapfmt/viewer/decoder/describe.js';
import { TrackDigest } from '../../../hapfmt/viewer/decoder/digest.js';
import { encodeEvents } from './encode-events.js';
import { emptyTrack, encodeTrack, makeTrack, needsLevel2, recordOf, refuse } from './encode-tracks.js';
import { headPayload } from '../../../hapfmt/viewer/decoder/head.js';
import { durationNs, packetMs } from '../../../hapfmt/viewer/decoder/indexes.js';
import { writeJson } from '../../../hapfmt/viewer/decoder/json.js';
import { TRACK_BOUND, limitsOf } from '../../../hapfmt/viewer/decoder/limits.js';
import { Writer } from '../../../hapfmt/viewer/decoder/writer.js';

export const MODES = ['lossless', 'deadband'];

const CHUNK_BYTES = 2 ** 19;

// One DATA chunk.
function writeCluster(writer, packets, tracks) {
  let times = null;
  for (const packet of packets) {
    const [start, stop] = packetMs(packet, tracks[packet.track]);
    times = times === null ? [start, stop] : [start < times[0] ? start : times[0], stop > times[1] ? stop : times[1]];
  }
  writer.writeData(packets, times);
}

// One or several, as the limits of the level call for.
function writeClusters(writer, packets, tracks, limits) {
  let group = [];
  let size = 0;
  let samples = 0;
  const flush = () => {
    if (group.length === 0) return;
    writeCluster(writer, group, tracks);
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
}

function digestOf(track) {
  const digest = new TrackDigest();
  for (const { start, span, numbers } of track.packets) digest.add(start, span, { numbers, exact: null });
  return digest.value();
}

function layerTrack(id, { label, rate: [rateNum, rateDen], events }) {
  return {
    ...emptyTrack, kind: 'events', codec: 'EVNT', rateNum, rateDen, channels: [], texts: { label }, packets: encodeEvents(id, events),
  };
}

// job: the parsed JSON; read(name): the bytes of a file in its folder. -> the bytes of the file.
export function encodeJob(job, read) {
  if (!MODES.includes(job.mode)) refuse(`mode ${job.mode}`);
  const channels = job.channels.map((channel, number) => makeTrack(number, channel, read(channel.numbers), job));
  const limits = limitsOf(channels.some(needsLevel2) ? 2 : 1);
  for (const channel of channels) encodeTrack(channel, limits, job.cluster_s ?? [1, 1]);
  const tracks = [...channels];
  const sampled = tracks.length;
  for (const layer of job.events ?? []) tracks.push(layerTrack(tracks.length, layer));
  if (tracks.length > TRACK_BOUND) refuse('too many tracks');

  const writer = new Writer(job.file_id ?? randomId());
  writer.write('HEAD', headPayload({ level: limits.level }));
  for (const { payload } of payloadsOf(tracks.map(recordOf), limits.payloadBound)) writer.write('TRAK', payload);
  if (job.metadata) writer.write('mETa', new TextEncoder().encode(writeJson(job.metadata)));

  const clusters = new Map(); // of samples
  const packets = tracks.flatMap((track, id) => track.packets.map((packet) => ({ ...packet, track: id })));
  for (const packet of packets) {
    if (packet.track >= sampled) continue;
    if (!clusters.has(packet.cluster)) clusters.set(packet.cluster, []);
    clusters.get(packet.cluster).push(packet);
  }
  for (const cluster of [...clusters.keys()].sort((a, b) => (a < b ? -1 : 1))) {
    writeClusters(writer, clusters.get(cluster), tracks, limits);
  }
  writeClusters(writer, packets.filter(({ track }) => track >= sampled), tracks, limits);
  tracks.slice(0, sampled).forEach((track, id) => writer.write('dGST', digestPayload(id, digestOf(track))));
  writer.writeFoot(durationNs(packets, new Map(tracks.map((track, id) => [id, track]))));
  return writer.bytes();
}
