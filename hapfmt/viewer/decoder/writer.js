// Writing chunks (5.1), the index (11.1) and the end of a file (11.2).
import { putVarint } from './bytes.js';
import { HEADER_SIZE, SIGNATURE, clusterSeed, makeChunk, seedOf } from './chunk.js';
import { HEAD_ROOM, ROW_ROOM, makeCluster } from './cluster.js';
import { FOOT_SIZE } from './indexes.js';

const INDEX_STRETCH = 4 * 2 ** 20;
const INDEX_ROOM = 2 ** 19;
// A closed file of no more bytes and chunks has no index (IDX-005).
const BARE_SIZE = 2 ** 16;
const BARE_COUNT = 16;
const MS_BOUND = 2n ** 53n - 1n;

export class Writer {
  constructor(fileId) {
    this.fileId = fileId;
    this.seed = seedOf(fileId);
    this.parts = [SIGNATURE];
    this.offset = SIGNATURE.length;
    this.sequence = 0;
    this.pending = [];
    this.previous = 0;
    this.size = 0;
  }

  // IDX-005: before a chunk of this many bytes.
  makeRoom(size) {
    const far = this.offset - this.previous + size > INDEX_STRETCH || this.size > INDEX_ROOM;
    if (far && this.pending.some(({ type }) => type !== 'iNDX')) this.writeIndex();
  }

  // A DATA chunk of packets { track, start, span, bytes }, in order.
  writeData(packets, times) {
    const room = packets.reduce((sum, { bytes }) => sum + ROW_ROOM + bytes.length, HEADER_SIZE + HEAD_ROOM);
    this.makeRoom(room);
    this.put('DATA', makeCluster(packets, clusterSeed(this.seed, this.sequence)), times);
  }

  write(type, payload) {
    if (type !== 'iNDX') this.makeRoom(HEADER_SIZE + payload.length);
    this.put(type, payload, null);
  }

  put(type, payload, times) {
    const size = HEADER_SIZE + payload.length;
    this.pending.push({ type, offset: this.offset, times });
    this.size += 4 + 8 + (times ? 16 : 0);
    this.parts.push(makeChunk({ type, fileId: this.fileId, sequence: this.sequence++ }, payload));
    this.offset += size;
  }

  // Lists all chunks from the previous index on.
  writeIndex() {
    const list = [];
    let before = this.previous;
    for (const { type, offset, times } of this.pending) {
      for (let i = 0; i < 4; i++) list.push(type.charCodeAt(i));
      putVarint(list, offset - before);
      before = offset;
      if (!times) continue;
      const [start, stop] = times.map((t) => Number(t > MS_BOUND ? MS_BOUND : t));
      putVarint(list, start);
      putVarint(list, stop - start);
    }
    const payload = new Uint8Array(16 + list.length);
    const view = new DataView(payload.buffer);
    view.setBigUint64(0, BigInt(this.previous), true);
    view.setUint32(8, this.sequence - this.pending.length, true);
    view.setUint32(12, this.pending.length, true);
    payload.set(list, 16);
    const at = this.offset;
    this.pending = [];
    this.size = 0;
    this.write('iNDX', payload);
    this.previous = at;
  }

  writeFoot(duration) {
    const size = HEADER_SIZE + FOOT_SIZE;
    if (this.previous || this.offset + size > BARE_SIZE || this.sequence >= BARE_COUNT) this.writeIndex();
    const payload = new Uint8Array(FOOT_SIZE);
    const view = new DataView(payload.buffer);
    view.setUint32(0, this.previous ? this.offset - this.previous : 0, true);
    view.setBigUint64(4, duration, true);
    this.put('fOOT', payload, null);
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
