// DATA (6.4): the table of a cluster and the CRC of a packet.
import { Reader, putVarint } from './bytes.js';
import { crc32 } from './crc32.js';
import { HapfError } from './error.js';
import { LIMITS, TICK_BOUND } from './limits.js';

const WIDTH_BOUND = 6;
const FIELDS = new Uint8Array(40);
const FIELDS_VIEW = new DataView(FIELDS.buffer);

function numberAt(bytes, at, width) {
  let value = 0;
  for (let i = width - 1; i >= 0; i--) value = value * 256 + bytes[at + i];
  return value;
}

// What can be read of a table: { count, entries, tableEnd, fault }. An entry is a row that is whole, { at, rowEnd, count,
// track, size, start, span, crc }; tableEnd is null where the head cannot be read.
export function readTable(bytes, start, end, packetBound = LIMITS[2].packetBound) {
  const table = { count: null, entries: [], tableEnd: null, fault: null };
  const reader = new Reader(bytes, { start, end, requirement: 'DAT-005' });
  const widths = [];
  const least = [];
  try {
    table.count = reader.varint();
    // More than the level allows are not read at all (LIM-002).
    if (table.count < 1 || table.count > packetBound) {
      table.fault = new HapfError('broken', 'DAT-001', `${table.count} packets`, start);
      if (table.count) table.fault.also = ['LIM-001'];
      return table;
    }
    const packed = reader.u16();
    for (let i = 0; i < 4; i++) widths.push((packed >> (4 * i)) & 15);
    if (Math.max(...widths) > WIDTH_BOUND) {
      table.fault = new HapfError('broken', 'DAT-001', `a field of ${Math.max(...widths)} bytes`, reader.offset - 2);
      return table;
    }
    for (let i = 0; i < 4; i++) least.push(reader.varint());
  } catch (error) {
    table.fault = error;
    error.also = ['DAT-001', 'CNV-002'];
    return table;
  }
  const rowSize = widths[0] + widths[1] + widths[2] + widths[3] + 4;
  let at = reader.position;
  table.tableEnd = at + table.count * rowSize + 4;
  for (let i = 0; i < table.count && at + rowSize <= end; i++) {
    const entry = { at, rowEnd: at + rowSize, count: table.count, track: 0, size: 0, start: 0, span: 0, crc: 0 };
    const values = [0, 0, 0, 0];
    let place = at;
    for (let f = 0; f < 4; f++) {
      values[f] = least[f] + numberAt(bytes, place, widths[f]);
      place += widths[f];
    }
    [entry.track, entry.size, entry.start, entry.span] = values;
    entry.crc = numberAt(bytes, place, 4);
    table.entries.push(entry);
    at = entry.rowEnd;
  }
  if (table.tableEnd > end) table.fault = new HapfError('truncated', 'DAT-005', 'the table ends early', end);
  return table;
}

export function keepsTimes(entry, limits) {
  return entry.span >= 1 && entry.span <= limits.spanBound && entry.start + entry.span <= TICK_BOUND;
}

// DAT-011; seed: where the cluster CRC starts.
export function hasTableCrc(bytes, start, table, seed) {
  const at = table.tableEnd - 4;
  return crc32(bytes, start, at, seed) === numberAt(bytes, at, 4);
}

// Where the CRC of a packet continues after its row.
function crcOfFields(values, seed) {
  values.forEach((value, i) => {
    FIELDS_VIEW.setUint32(8 * i, value % 2 ** 32, true);
    FIELDS_VIEW.setUint32(8 * i + 4, Math.floor(value / 2 ** 32), true);
  });
  return crc32(FIELDS, 0, 40, seed);
}

// DAT-004.
export function hasCrc(bytes, entry, offset, seed) {
  const { count, track, size, start, span, crc } = entry;
  return offset + size <= bytes.length && crc32(bytes, offset, offset + size, crcOfFields([count, track, size, start, span], seed)) === crc;
}

// DAT-009 counts samples; of events, bytes.
export function samplesOf(entry, track) {
  return track.kind === 'events' ? entry.size : entry.span * track.componentCount;
}

// The rules that the table of an intact cluster breaks, as HapfErrors.
export function tableFaults(bytes, table, start, end, tracks, limits, seed) {
  if (table.fault) return [table.fault];
  const faults = [];
  const fault = (requirement, message, offset) => faults.push(new HapfError('broken', requirement, message, offset));
  if (!hasTableCrc(bytes, start, table, seed)) fault('DAT-011', 'the CRC of a table differs', table.tableEnd - 4);
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
      fault('DAT-002', 'rows out of order', entry.at);
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

// Bytes that a packet adds to a payload at most, and those before the rows and behind them.
export const ROW_ROOM = 20;
export const HEAD_ROOM = 40;

function bytesFor(value) {
  let width = 0;
  for (let rest = value; rest > 0; rest = Math.floor(rest / 256)) width++;
  return width;
}

// A DATA payload of packets { track, start, span, bytes }, in order; seed: where the cluster CRC starts.
export function makeCluster(packets, seed) {
  const rows = packets.map(({ track, start, span, bytes }) => [track, bytes.length, start, span]);
  const least = [0, 1, 2, 3].map((f) => rows.reduce((low, row) => Math.min(low, row[f]), Infinity));
  const widths = [0, 1, 2, 3].map((f) => bytesFor(rows.reduce((high, row) => Math.max(high, row[f] - least[f]), 0)));
  const list = [];
  const put = (value, width) => {
    for (let i = 0, rest = value; i < width; i++, rest = Math.floor(rest / 256)) list.push(rest % 256);
  };
  putVarint(list, packets.length);
  put(widths.reduce((sum, width, f) => sum + width * 16 ** f, 0), 2);
  for (const value of least) putVarint(list, value);
  rows.forEach((row, i) => {
    row.forEach((value, f) => put(value - least[f], widths[f]));
    const { bytes } = packets[i];
    put(crc32(bytes, 0, bytes.length, crcOfFields([packets.length, ...row], seed)), 4);
  });
  put(crc32(Uint8Array.from(list), 0, list.length, seed), 4);
  const payload = new Uint8Array(list.length + packets.reduce((sum, { bytes }) => sum + bytes.length, 0));
  payload.set(list, 0);
  let at = list.length;
  for (const { bytes } of packets) {
    payload.set(bytes, at);
    at += bytes.length;
  }
  return payload;
}
