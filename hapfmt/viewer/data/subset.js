// A part of a file, its packets copied as they are (docs/spec/editing.md).
import { clockPayload, digestPayload, isOverview } from '../decoder/ancillary.js';
import { putVarint } from '../decoder/bytes.js';
import { isSafeToCopy, randomId } from '../decoder/chunk.js';
import { decodeEvents } from '../decoder/codecs.js';
import { payloadsOf } from '../decoder/describe.js';
import { HapfError } from '../decoder/error.js';
import { openFile } from '../decoder/file.js';
import { headPayload } from '../decoder/head.js';
import { durationNs } from '../decoder/indexes.js';
import { writeJson } from '../decoder/json.js';
import { clustersOf, timesOf } from '../decoder/recover.js';
import { judge, settle } from '../decoder/report.js';
import { recordLinked } from '../decoder/trak.js';
import { guarded } from '../decoder/verify.js';
import { Writer } from '../decoder/writer.js';
import { readWhole } from './bywalk.js';
import { openSource } from './sources.js';
import { secondsAt, tickAt } from './ticks.js';

const refuse = (requirement, message, offset = null) => {
  throw new HapfError('unsupported', requirement, message, offset);
};

export async function copyPart(place, asked, onProgress) {
  return subsetOf(await readWhole(await openSource(place), onProgress), asked);
}

// channels: their numbers; t0, t1: seconds, or both null for all. name: what the notes call the file.
// -> { bytes, packets, start, stop: seconds, channels: numbers that are in it, notes }. Throws HapfError for a file that cannot be copied so.
export function subsetOf(bytes, { channels, t0 = null, t1 = null, name, fileId = randomId() }) {
  const file = opened(bytes);
  const plan = lay(file, new Set(channels));
  const writer = new Writer(fileId);
  const notes = [];
  const kept = [...plan.places.values()];
  writer.write('HEAD', headPayload(file.head));
  const records = kept.map(({ id, track, record }) => ({ id, componentCount: track.componentCount, record }));
  const described = payloadsOf(records, file.limits.payloadBound);
  for (const { payload } of described) writer.write('TRAK', payload);
  writer.write('mETa', metadataOf(file, plan, t0, t1, name));
  const first = Math.min(...file.chunks.filter(({ type, known }) => known && type === 'DATA').map(({ position }) => position), file.bytes.length);
  copyOthers(file, plan, writer, notes, (position) => position < first);
  const copied = copyPackets(file, plan, writer, window(file, t0, t1));
  copyOthers(file, plan, writer, notes, (position) => position > first);
  copyDigests(file, plan, writer, copied.partial);
  writer.writeFoot(durationNs(copied.packets, plan.view.allTracks));
  const [start, stop] = edgesOf(copied.packets, plan.view.allTracks);
  return { bytes: writer.bytes(), packets: copied.packets.length, start, stop, channels: [...plan.numbers.keys()], notes };
}

function edgesOf(packets, tracks) {
  let [start, stop] = [Infinity, -Infinity];
  for (const packet of packets) {
    const track = tracks.get(packet.track);
    start = Math.min(start, secondsAt(track, packet.start));
    stop = Math.max(stop, secondsAt(track, packet.start + packet.span));
  }
  return [start, stop];
}

// EDT-001.
function opened(bytes) {
  const file = openFile(bytes);
  if (!file.refused) guarded(file, () => settle(file));
  if (judge(file) === 'intact') return file;
  const [reason] = [...file.damages, ...file.findings];
  return refuse(reason?.requirement ?? 'EDT-001', `the file is not intact: ${reason?.message ?? file.verdict}`, reason?.offset);
}

const hasChannels = ({ kind }) => kind === 'full' || kind === 'lf';

// Which tracks are kept, under which ids, and the new numbers of their channels (EDT-003, EDT-004).
function lay(file, asked) {
  const all = [...file.allTracks.values()];
  const bases = new Set();
  for (const track of all) if (hasChannels(track) && track.channels.some((channel) => asked.has(channel))) bases.add(track.id);
  if (!bases.size) refuse('EDT-003', 'it has none of these channels');
  const kept = all.filter((track) => track.kind === 'events' || bases.has(track.kind === 'hf' ? track.base : track.id));
  const ids = new Map(kept.map((track, id) => [track.id, id]));
  const old = new Set(kept.filter(hasChannels).flatMap(({ channels }) => channels));
  const numbers = new Map([...old].sort((a, b) => a - b).map((channel, number) => [channel, number]));
  const places = new Map();
  for (const track of kept) {
    const linked = track.kind === 'hf' ? track.base : track.continues;
    const channels = (track.kind === 'hf' ? [track.firstChannel] : track.channels).map((channel) => numbers.get(channel));
    const record = track.kind === 'events' ? track.record
      : recordLinked(track, channels, linked === null ? null : ids.get(linked));
    places.set(track.id, { id: ids.get(track.id), track, record });
  }
  const everything = new Set(all.filter(hasChannels).flatMap(({ channels }) => channels));
  const view = { limits: file.limits, allTracks: new Map([...places.values()].map(({ id, track }) => [id, track])) };
  return { places, numbers, view, renumber: everything.size !== numbers.size };
}

// The ticks of each track that overlap these seconds; null: all.
function window(file, t0, t1) {
  if (t0 === null || t1 === null) return null;
  return new Map([...file.allTracks.values()].map((track) => [track.id, [tickAt(track, t0), tickAt(track, t1)]]));
}

// Its member `notes` tells what happened (11.3).
function metadataOf(file, { numbers }, t0, t1, name) {
  const { notes = [], ...rest } = file.metadata ?? {};
  const span = t0 === null ? '' : `; ${t0}:${t1} s`;
  const note = `subset of ${name}: channels ${[...numbers.keys()].join(', ')}${span}`;
  const payload = new TextEncoder().encode(writeJson({ ...rest, notes: [...Array.isArray(notes) ? notes : [notes], note] }));
  if (payload.length > file.limits.payloadBound) refuse('LIM-001', 'its metadata are too long for one note more');
  return payload;
}

// EDT-005.
function copyOthers(file, { places }, writer, notes, wanted) {
  const described = new Set(['HEAD', 'TRAK', 'DATA', 'iNDX', 'fOOT', 'mETa', 'dGST']);
  for (const chunk of file.chunks) {
    const { type, known, position } = chunk;
    if ((known && described.has(type)) || !wanted(position)) continue;
    if (!known && !isSafeToCopy(chunk)) {
      notes.push(`A chunk ${type} is left out: it is unknown, and unsafe to copy.`);
      continue;
    }
    if (known && type === 'aTTc' && isOverview(file.bytes, chunk)) continue;
    const payload = file.bytes.subarray(chunk.payloadStart, chunk.end);
    if (chunk.track === null) {
      writer.write(type, payload);
      continue;
    }
    const place = places.get(chunk.track);
    if (place) writer.write(type, clockPayload(payload, place.id));
  }
}

// EDT-002. Packets of one chunk stay together.
function copyPackets(file, plan, writer, ranges) {
  const partial = new Set();
  const packets = [];
  const clusters = new Map();
  for (const packet of file.packets) {
    const place = plan.places.get(packet.track);
    if (!place) continue;
    const [first, stop] = ranges?.get(packet.track) ?? [0, Infinity];
    const within = packet.start < stop && packet.start + packet.span > first;
    const bytes = within ? bytesOf(packet, place.track, plan) : null;
    if (!bytes) {
      partial.add(packet.track);
      continue;
    }
    const moved = { track: place.id, start: packet.start, span: packet.span, bytes, size: bytes.length };
    packets.push(moved);
    if (!clusters.has(packet.chunkOffset)) clusters.set(packet.chunkOffset, []);
    clusters.get(packet.chunkOffset).push(moved);
  }
  for (const offset of [...clusters.keys()].sort((a, b) => a - b)) {
    for (const cluster of clustersOf(clusters.get(offset), plan.view)) {
      writer.writeData(cluster, timesOf(cluster, plan.view));
    }
  }
  return { packets, partial };
}

// Events name the new numbers of their channels; null: no event is left.
function bytesOf(packet, track, { renumber, numbers }) {
  if (track.kind !== 'events' || !renumber) return packet.bytes;
  const list = [];
  let before = packet.start;
  for (const { tick, duration, channel, text } of decodeEvents(track, packet.bytes, packet.start, packet.span, packet.offset)) {
    if (channel !== null && !numbers.has(channel)) continue;
    const letters = new TextEncoder().encode(text);
    putVarint(list, tick - before);
    putVarint(list, duration);
    putVarint(list, channel === null ? 0 : numbers.get(channel) + 1);
    putVarint(list, letters.length);
    for (const letter of letters) list.push(letter);
    before = tick;
  }
  return list.length ? Uint8Array.from(list) : null;
}

// EDT-005.
function copyDigests(file, { places }, writer, partial) {
  const reached = new Map();
  for (const { track, chunkOffset } of file.packets) reached.set(track, Math.max(reached.get(track) ?? 0, chunkOffset));
  const last = new Map(file.digests.map((digest) => [digest.track, digest]));
  for (const [id, { digest, chunk }] of last) {
    const place = places.get(id);
    if (place && !partial.has(id) && chunk.position > (reached.get(id) ?? 0)) writer.write('dGST', digestPayload(place.id, digest));
  }
}
