// DATA (6.4): the table of a cluster and the CRC of a packet.
import { Reader } from './bytes.js';
import { crc32 } from './crc32.js';
import { HapfError } from './error.js';
import { LIMITS, TICK_BOUND } from './limits.js';

const TWO53 = 2 ** 53;

// An entry of the table: { at, track, size, start, span, crc, rowEnd }, or null where there is none.
export function readEntry(bytes, at, end) {
  let p = at;
  const fields = [0, 0, 0, 0];
  for (let f = 0; f < 4; f++) {
    let value = 0;
    let scale = 1;
    for (let i = 0; ; i++) {
      if (p >= end || i === 8) return null;
      const byte = bytes[p++];
      value += (byte & 127) * scale;
      if (byte < 128) {
        if (byte === 0 && i > 0) return null;
        break;
      }
      scale *= 128;
    }
    if (value >= TWO53) return null;
    fields[f] = value;
  }
  if (p + 4 > end) return null;
  const crc = (bytes[p] | (bytes[p + 1] << 8) | (bytes[p + 2] << 16) | (bytes[p + 3] << 24)) >>> 0;
  const [track, size, start, span] = fields;
  return { at, track, size, start, span, crc, rowEnd: p + 4 };
}

// What can be read of a table from the front: { count, entries, tableEnd, fault }.
export function readTable(bytes, start, end, packetBound = LIMITS[2].packetBound) {
  const table = { count: null, entries: [], tableEnd: null, fault: null };
  const reader = new Reader(bytes, { start, end, requirement: 'DAT-005' });
  try {
    table.count = reader.varint();
  } catch (error) {
    table.fault = error;
    error.also = ['DAT-001'];
    return table;
  }
  let at = reader.position;
  // More than the level allows are not read at all (LIM-002).
  if (table.count < 1 || table.count > packetBound) {
    table.fault = new HapfError('broken', 'DAT-001', `${table.count} packets`, start);
    if (table.count) table.fault.also = ['LIM-001'];
    return table;
  }
  for (let i = 0; i < table.count; i++) {
    const entry = readEntry(bytes, at, end);
    if (!entry) {
      table.fault = entryFault(bytes, at, end);
      return table;
    }
    table.entries.push(entry);
    at = entry.rowEnd;
  }
  table.tableEnd = at;
  return table;
}

function entryFault(bytes, at, end) {
  const reader = new Reader(bytes, { start: at, end, requirement: 'DAT-005' });
  try {
    for (let i = 0; i < 4; i++) reader.varint();
    reader.u32();
  } catch (error) {
    return error;
  }
  return new HapfError('broken', 'DAT-001', 'no entry', at);
}

export function keepsTimes(entry, limits) {
  return entry.span >= 1 && entry.span <= limits.spanBound && entry.start + entry.span <= TICK_BOUND;
}

// DAT-004; seed: where the file CRC starts.
export function hasCrc(bytes, entry, offset, seed) {
  return offset + entry.size <= bytes.length
    && crc32(bytes, offset, offset + entry.size, crc32(bytes, entry.at, entry.rowEnd - 4, seed)) === entry.crc;
}

// DAT-009 counts samples; of events, bytes.
export function samplesOf(entry, track) {
  return track.kind === 'events' ? entry.size : entry.span * track.componentCount;
}

// The rules that the table of an intact cluster breaks, as HapfErrors.
export function tableFaults(table, start, end, tracks, limits) {
  if (table.fault) return [table.fault];
  const faults = [];
  const fault = (requirement, message, offset) => faults.push(new HapfError('broken', requirement, message, offset));
  let room = end - table.tableEnd;
  let samples = 0;
  let before = null;
  for (const entry of table.entries) {
    room -= entry.size;
    if (room < 0) {
      fault('DAT-005', 'the packets are longer than the payload', entry.at);
      break;
    }
    if (before && (entry.track < before.track || (entry.track === before.track && entry.start <= before.start))) {
      fault('DAT-002', 'entries out of order', entry.at);
    }
    if (!keepsTimes(entry, limits)) {
      fault('DAT-003', `start ${entry.start}, span ${entry.span}`, entry.at);
      if (entry.span > limits.spanBound) fault('LIM-001', `a span of ${entry.span} ticks`, entry.at);
    }
    const track = tracks.get(entry.track);
    if (track) samples += samplesOf(entry, track);
    before = entry;
  }
  if (room > 0) fault('DAT-005', `${room} bytes after the last packet`, end - room);
  if (samples > limits.sampleBound) {
    fault('DAT-009', `${samples} samples in a cluster`, start);
    fault('LIM-001', `${samples} samples in a cluster`, start);
  }
  return faults;
}

// Packets one after the other from the end of the table on.
export function placePackets(entries, from) {
  let offset = from;
  return entries.map((entry) => {
    const placed = { ...entry, offset };
    offset += entry.size;
    return placed;
  });
}
