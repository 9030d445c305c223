// Which packets a reader delivers, and in which order (14.1, DAT-006, TRK-016).
import { clusterSeed } from './chunk.js';
import { hasCrc, placePackets, readTable, samplesOf, tableFaults } from './cluster.js';
import { HapfError, unsupported } from './error.js';
import { salvage } from './salvage.js';

// A packet that is kept takes more memory than its row (LIM-003).
const PACKET_BOUND = 2 ** 22;

// -> { clusters, packets, held, damages }. held: all packets that hold, in the order in which they are looked at;
// packets: those of them that are delivered. A cluster has chunk, holes (if salvaged), first: its place in held.
export function deliver({ bytes, chunks, allTracks, tracks, limits, damaged, recovering, meter, note }) {
  const clusters = [];
  let count = 0;
  for (const chunk of chunks) {
    if (chunk.type !== 'DATA' || !chunk.known) continue;
    const cluster = readCluster({ bytes, chunk, allTracks, limits, meter, note });
    count += cluster.kept.length;
    if (count > PACKET_BOUND) unsupported('LIM-003', 'more packets than this reader keeps', chunk.position);
    clusters.push(cluster);
  }
  const damages = [];
  clusters.sort((a, b) => a.chunk.sequence - b.chunk.sequence || a.chunk.position - b.chunk.position);
  for (const cluster of clusters) {
    if (cluster.salvaged && (damaged || recovering)) reportHoles(cluster, damages);
    leaveOut({ cluster, allTracks, tracks, limits, note });
  }
  const held = [];
  const packets = [];
  const chains = new Map();
  for (const cluster of clusters) {
    cluster.first = held.length;
    for (const packet of cluster.kept) {
      held.push(packet);
      if (packet.left) continue;
      if (inTime(packet, tracks.get(packet.track), chains, damaged, note, damages)) {
        packet.delivered = true;
        packets.push(packet);
      }
    }
  }
  return { clusters, packets, held, damages };
}

function readCluster({ bytes, chunk, allTracks, limits, meter, note }) {
  const { payloadStart, end } = chunk;
  const seed = clusterSeed(chunk.seed, chunk.sequence);
  const packetOf = (entry) => ({
    ...entry, bytes: bytes.subarray(entry.offset, entry.offset + entry.size), chunk, chunkOffset: chunk.position,
    left: false, delivered: false,
  });
  if (chunk.intact) {
    const table = readTable(bytes, payloadStart, end, limits.packetBound);
    const faults = tableFaults(bytes, table, payloadStart, end, allTracks, limits, seed);
    for (const fault of faults) note(fault, chunk);
    if (!faults.length) {
      const kept = placePackets(table.entries, table.tableEnd).map(packetOf);
      for (const packet of kept) {
        if (hasCrc(bytes, packet, packet.offset, seed)) continue;
        packet.left = true;
        note(new HapfError('broken', 'DAT-004', 'the CRC of a packet differs', packet.rowEnd - 4), chunk, false, packet);
      }
      return { chunk, kept, holes: [], salvaged: false };
    }
  }
  const found = salvage(bytes, chunk, limits, seed, meter);
  const kept = found.kept.map(packetOf);
  const byRow = new Map(kept.map((packet) => [packet.at, packet]));
  const packet = (entry) => (entry ? byRow.get(entry.at) : null);
  const holes = found.holes.map(({ before, after }) => ({ before: packet(before), after: packet(after) }));
  return { ...found, chunk, kept, holes, salvaged: true };
}

// bad-table where nothing tells which packets are missing, else bad-packet for each hole (14.1).
function reportHoles(cluster, damages) {
  const { chunk, kept, holes, payloadEnd, limit } = cluster;
  const start = chunk.payloadStart;
  if (!kept.length) {
    const damage = {
      code: 'bad-table', offset: start, size: Math.max(limit - start, 0), requirement: 'DAT-005',
      message: 'the table of the packets is damaged', chunk,
    };
    cluster.lostTable = damage;
    damages.push(damage);
    return;
  }
  for (const hole of holes) {
    const offset = hole.before ? hole.before.offset + hole.before.size : start;
    const stop = hole.after ? hole.after.offset : payloadEnd;
    hole.damage = {
      code: 'bad-packet', offset, size: Math.max(stop - offset, 0), requirement: 'DAT-004', message: 'packets are damaged', chunk,
    };
    damages.push(hole.damage);
  }
}

// Packets with the right CRC that are not delivered, wherever they are in time.
function leaveOut({ cluster, allTracks, tracks, limits, note }) {
  const { chunk, kept } = cluster;
  let samples = 0;
  for (const packet of kept) {
    if (packet.left) continue;
    const track = allTracks.get(packet.track);
    const usable = tracks.has(packet.track);
    const leave = (requirement, message) => {
      packet.left = true;
      note(new HapfError('broken', requirement, message, packet.at), chunk, false, packet);
    };
    if (!track) leave('DAT-008', `a packet of track ${packet.track}, which is not described`);
    else if (!usable) leave(track.fault?.requirement ?? track.left, `a packet of track ${packet.track}, whose description breaks a rule`);
    if (packet.left) continue;
    if (track.description.chunk.position > chunk.position) {
      note(new HapfError('broken', 'TRK-001', `a packet of track ${packet.track} before its description`, packet.at), chunk, true);
    }
    samples += samplesOf(packet, track);
    if (samples > limits.sampleBound) leave('DAT-009', 'more samples than the level allows');
  }
}

function overlapOf(packet) {
  packet.damage = {
    code: 'overlap', offset: packet.offset, size: packet.size, requirement: 'DAT-006', chunk: packet.chunk, packet,
    message: `a packet of track ${packet.track} at tick ${packet.start} overlaps another`,
  };
  return packet.damage;
}

// DAT-006 within a chain of tracks that continue one another; TRK-016.
function inTime(packet, track, chains, damaged, note, damages) {
  if (track.kind === 'events' || track.strange) return true;
  const rank = track.kind === 'hf' ? track.base : track.id;
  const state = chains.get(track.chain) ?? { end: 0, rank };
  const requirement = rank === state.rank ? 'DAT-006' : 'TRK-016';
  if (packet.start < state.end) {
    packet.left = true;
    packet.overlap = true;
    if (damaged) {
      damages.push(overlapOf(packet));
    } else {
      note(new HapfError('broken', requirement, `track ${track.id}: tick ${packet.start} behind tick ${state.end}`, packet.at), packet.chunk, false, packet);
    }
    return false;
  }
  if (rank < state.rank) {
    packet.left = true;
    note(new HapfError('broken', 'TRK-016', `track ${track.id} behind a track that continues it`, packet.at), packet.chunk, false, packet);
    return false;
  }
  chains.set(track.chain, { end: packet.start + packet.span, rank });
  return true;
}
