// iNDX and fOOT (11.1, 11.2).
import { Reader } from './bytes.js';
import { HapfError, broken } from './error.js';

export const FOOT_SIZE = 12;
export const INDEX_STRETCH = 4 * 2 ** 20;
const ENTRY_LEAST = 5;
const MS_BOUND = 2 ** 53 - 1;
export const NS_BOUND = 2n ** 63n - 1n;

export function readIndex(bytes, chunk) {
  const reader = new Reader(bytes, { start: chunk.payloadStart, end: chunk.end, requirement: 'IDX-002' });
  const previous = Number(reader.u64());
  const firstSequence = reader.u32();
  const count = reader.u32();
  if (count * ENTRY_LEAST > reader.left) broken('IDX-002', `${count} entries in ${reader.left} bytes`, chunk.payloadStart + 12);
  const entries = [];
  let offset = previous;
  for (let i = 0; i < count; i++) {
    const at = reader.offset;
    const type = String.fromCharCode(...reader.bytes(4));
    const distance = reader.varint();
    offset += distance;
    const entry = { type, offset, at };
    if (type === 'DATA') {
      entry.startMs = reader.varint();
      entry.stopMs = entry.startMs + reader.varint();
    }
    entries.push(entry);
  }
  if (reader.left) broken('IDX-002', `${reader.left} bytes behind the last entry`, reader.offset);
  return { chunk, previous, firstSequence, entries };
}

// How many of the chunks are before a position.
function placeOf(chunks, position) {
  let [low, high] = [0, chunks.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (chunks[middle].position < position) low = middle + 1;
    else high = middle;
  }
  return low;
}

const fault = (requirement, message, offset) => new HapfError('broken', requirement, message, offset);
const ceilDiv = (n, d) => (n + d - 1n) / d;

// Milliseconds of a packet, [start rounded down, stop rounded up], exact.
export function packetMs(packet, track) {
  const scale = 1000n * BigInt(track.rateDen);
  const rate = BigInt(track.rateNum);
  return [(BigInt(packet.start) * scale) / rate, ceilDiv(BigInt(packet.start + packet.span) * scale, rate)];
}

// IDX-002 in a file without damage. chunks: all, in order; times: chunk position ->
// [first, last] ms.
export function checkIndex(index, chunks, byPosition, times) {
  const { chunk, previous, firstSequence, entries } = index;
  const faults = [];
  const at = chunk.payloadStart;
  const before = byPosition.get(previous);
  if (previous > 0 && (!before || before.type !== 'iNDX' || previous >= chunk.position)) {
    faults.push(fault('IDX-002', `no index before at offset ${previous}`, at));
  }
  const first = placeOf(chunks, previous);
  const count = placeOf(chunks, chunk.position) - first;
  const differs = count === entries.length
    ? entries.findIndex(({ type, offset }, i) => type !== chunks[first + i].type || offset !== chunks[first + i].position)
    : Math.min(Math.max(count, 0), entries.length);
  if (differs < 0 && count > 0 && firstSequence !== chunks[first].sequence) {
    faults.push(fault('IDX-002', `counts its chunks from ${firstSequence}, not ${chunks[first].sequence}`, at + 8));
  }
  if (differs >= 0) {
    const place = entries[differs]?.at ?? at + 12;
    faults.push(fault('IDX-002', `entry ${differs} is not the chunk at that offset`, place));
    return faults;
  }
  for (const entry of entries) {
    const range = entry.type === 'DATA' && times.get(entry.offset);
    if (!range) continue;
    const stop = range[1] > BigInt(MS_BOUND) ? BigInt(MS_BOUND) : range[1];
    if (BigInt(entry.startMs) > range[0] || BigInt(entry.stopMs) < stop) {
      faults.push(fault('IDX-002', `${entry.startMs} to ${entry.stopMs} ms, not ${range[0]} to ${range[1]}`, entry.at));
    }
  }
  return faults;
}

// IDX-005: where more than 4 MiB of chunks have no index, and there was something to list.
export function* lateIndexes(chunks) {
  let unlisted = 0;
  for (const chunk of chunks) {
    if (chunk.type === 'iNDX' || chunk.type === 'fOOT') {
      if (chunk.type === 'iNDX') unlisted = 0;
      continue;
    }
    const size = chunk.end - chunk.position;
    if (unlisted > 0 && unlisted + size > INDEX_STRETCH) {
      yield { chunk, error: fault('IDX-005', `${unlisted + size} bytes of chunks without an index`, chunk.position) };
      unlisted = 0;
    }
    unlisted += size;
  }
}

export function readFoot(bytes, chunk) {
  if (chunk.payloadSize !== FOOT_SIZE) broken('FOT-001', `a fOOT of ${chunk.payloadSize} bytes`, chunk.payloadStart);
  const reader = new Reader(bytes, { start: chunk.payloadStart, end: chunk.end, requirement: 'FOT-001' });
  return { chunk, indexDistance: reader.u32(), durationNs: reader.u64() };
}

// The end of the latest packet in nanoseconds, rounded up.
export function durationNs(packets, allTracks) {
  let latest = 0n;
  for (const { track: id, start, span } of packets) {
    const track = allTracks.get(id);
    if (!track) continue;
    const stop = ceilDiv(BigInt(start + span) * BigInt(track.rateDen) * 1000000000n, BigInt(track.rateNum));
    if (stop > latest) latest = stop;
  }
  return latest > NS_BOUND ? NS_BOUND : latest;
}

// FOT-002; durationNs: of the one that closes the file, else null. last: the index before it, or null.
export function checkFoot({ chunk, indexDistance, durationNs: told }, last, durationNs) {
  const faults = [];
  const distance = last ? chunk.position - last.position : 0;
  if (indexDistance !== distance) faults.push(fault('FOT-002', `an index ${indexDistance} bytes before, not ${distance}`, chunk.payloadStart));
  if (durationNs !== null && told !== durationNs) {
    faults.push(fault('FOT-002', `a duration of ${told} ns, not ${durationNs}`, chunk.payloadStart + 4));
  }
  return faults;
}
