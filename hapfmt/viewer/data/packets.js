// Which packets cover a time, and their bytes: of a file by its index only those that are wanted are fetched.
import { HEADER_SIZE, clusterSeed, readHeader } from '../decoder/chunk.js';
import { hasCrc, placePackets, readTable, tableFaults } from '../decoder/cluster.js';
import { unsupported } from '../decoder/error.js';
import { FalseIndex } from './byindex.js';
import { Lru } from './lru.js';

const ROW_SIZE = 12; // mostly
const HEAD_ROOM = 40;
const ROWS_KEPT = 2 ** 19;
const GROUP = 2 ** 22; // bytes of packets, or of clusters whose tables are read, at a time
const PACKET_BOUND = 2 ** 20; // of one request
const FAR = 2 ** 53 - 1;

const need = (holds) => {
  if (!holds) throw new FalseIndex();
};

// Clusters that may have something of a time, by its milliseconds.
class Order {
  constructor(clusters) {
    this.sorted = clusters.map((_, i) => i).sort((a, b) => clusters[a].startMs - clusters[b].startMs || a - b);
    this.clusters = clusters;
    this.reached = new Float64Array(clusters.length); // the latest end of those up to here
    let latest = 0;
    this.sorted.forEach((n, i) => {
      latest = Math.max(latest, stopOf(clusters[n]));
      this.reached[i] = latest;
    });
  }

  // Their numbers, in order of their starts.
  between(startMs, stopMs) {
    const margin = 1 + 1e-12 * Math.max(Math.abs(startMs), Math.abs(stopMs));
    const { sorted, reached, clusters } = this;
    let [low, high] = [0, sorted.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (reached[middle] < startMs - margin) low = middle + 1;
      else high = middle;
    }
    const found = [];
    for (let i = low; i < sorted.length && clusters[sorted[i]].startMs <= stopMs + margin; i++) {
      if (stopOf(clusters[sorted[i]]) >= startMs - margin) found.push(sorted[i]);
    }
    return found;
  }
}

const stopOf = ({ stopMs }) => (stopMs >= FAR ? Infinity : stopMs);

export class Packets {
  constructor(source, file) {
    this.source = source;
    this.file = file;
    this.order = new Order(file.clusters);
    this.tables = new Lru(ROWS_KEPT);
  }

  get clusters() {
    return this.file.clusters;
  }

  clustersBetween(startMs, stopMs) {
    return this.order.between(startMs, stopMs);
  }

  // The tables of clusters by their numbers, one after the other: a Map, track id -> packets in order of time. Few are in
  // memory at a time.
  async* tablesOf(numbers, signal) {
    for (let at = 0; at < numbers.length;) {
      const some = [];
      for (let size = 0; at < numbers.length && (!some.length || size < GROUP); at++) {
        const { offset, stop } = this.clusters[numbers[at]];
        size += stop - offset;
        some.push(numbers[at]);
      }
      const tables = new Map(some.map((n) => [n, this.clusters[n].packets ? byTrack(this.clusters[n].packets) : this.tables.get(n)]));
      const missing = some.filter((n) => !tables.get(n));
      const found = await this.readTables(missing.map((n) => this.clusters[n]), signal);
      missing.forEach((n, i) => {
        const { table, rows } = found[i];
        tables.set(n, table);
        this.tables.set(n, table, rows + 1);
      });
      for (const n of some) yield tables.get(n);
    }
  }

  async readTables(clusters, signal) {
    const room = HEADER_SIZE + HEAD_ROOM + ROW_SIZE * this.file.allTracks.size;
    const parts = await this.source.readAll(clusters.map(({ offset, stop }) => [offset, Math.min(offset + room, stop)]), signal);
    const tables = [];
    for (let i = 0; i < clusters.length; i++) tables.push(await this.parse(clusters[i], parts[i], signal));
    return tables;
  }

  // FalseIndex where anything is not as it should be.
  async parse(cluster, part, signal) {
    const { offset, stop, sequence, startMs, stopMs } = cluster;
    const { fileId, limits, allTracks, tracks } = this.file;
    const header = readHeader(part, 0);
    need(header && header.type === 'DATA' && header.fileId === fileId && header.sequence === sequence);
    need(HEADER_SIZE + header.payloadSize === stop - offset && header.payloadSize <= limits.payloadBound);
    let bytes = part;
    let table = readTable(bytes, HEADER_SIZE, bytes.length, limits.packetBound);
    if (table.tableEnd > bytes.length) {
      need(table.tableEnd <= stop - offset);
      bytes = await this.source.read(offset, offset + table.tableEnd, signal);
      table = readTable(bytes, HEADER_SIZE, bytes.length, limits.packetBound);
    }
    const seed = clusterSeed(header.seed, sequence);
    need(!tableFaults(bytes, table, HEADER_SIZE, stop - offset, allTracks, limits, seed).length);
    const last = stopMs >= FAR ? Infinity : stopMs;
    const packets = placePackets(table.entries, table.tableEnd);
    for (const packet of packets) {
      const track = tracks.get(packet.track);
      need(track);
      const ms = (1000 * track.rateDen) / track.rateNum;
      need(Math.floor(packet.start * ms) >= startMs - 1 && (packet.start + packet.span) * ms <= last + 1);
      packet.place = packet.offset;
      packet.offset += offset;
      packet.seed = seed;
    }
    return { table: byTrack(packets), rows: packets.length };
  }

  // Packets of each of these tracks within its ticks: Map track id -> packets in order of time.
  async find(ranges, signal) {
    const found = new Map([...ranges.keys()].map((id) => [id, []]));
    let [startMs, stopMs] = [Infinity, 0];
    for (const [id, [first, stop]] of ranges) {
      const { rateNum, rateDen } = this.file.tracks.get(id);
      startMs = Math.min(startMs, (first * 1000 * rateDen) / rateNum);
      stopMs = Math.max(stopMs, (stop * 1000 * rateDen) / rateNum);
    }
    let count = 0;
    for await (const table of this.tablesOf(this.clustersBetween(startMs, stopMs), signal)) {
      for (const [id, [first, stop]] of ranges) {
        for (const packet of table.get(id) ?? []) {
          if (packet.start >= stop || packet.start + packet.span <= first) continue;
          if (++count > PACKET_BOUND) unsupported('LIM-003', `more than ${PACKET_BOUND} packets`, packet.offset);
          found.get(id).push(packet);
        }
      }
    }
    for (const [id, packets] of found) {
      packets.sort((a, b) => a.start - b.start || a.offset - b.offset);
      if (this.file.tracks.get(id).kind === 'events') continue;
      // DAT-006. A walk tells which packet is delivered.
      for (let i = 1; i < packets.length; i++) need(packets[i].start >= packets[i - 1].start + packets[i - 1].span);
    }
    return found;
  }

  // Calls each(packet, bytes) for packets; FalseIndex where a CRC differs.
  async each(packets, signal, each) {
    for (let at = 0; at < packets.length;) {
      let size = 0;
      const first = at;
      while (at < packets.length && (at === first || size < GROUP)) size += packets[at++].size;
      const group = packets.slice(first, at);
      const missing = group.filter(({ bytes }) => !bytes);
      const parts = await this.source.readAll(missing.map(({ offset, size: n }) => [offset, offset + n]), signal);
      const read = new Map(missing.map((packet, i) => [packet, parts[i]]));
      for (const packet of group) {
        const bytes = packet.bytes ?? read.get(packet);
        need(packet.bytes || hasCrc(bytes, packet, 0, packet.seed));
        each(packet, bytes);
      }
    }
  }
}

function byTrack(packets) {
  const table = new Map();
  for (const packet of packets) {
    if (!table.has(packet.track)) table.set(packet.track, []);
    table.get(packet.track).push(packet);
  }
  return table;
}
