// The procedure `salvage` of clause 14.1: the packets of a DATA chunk that is damaged.
import { hasCrc, keepsTimes, placePackets, readTable } from './cluster.js';
import { LIMITS } from './limits.js';

const REACH = 65536;

// -> { kept, table, holes, payloadEnd, limit }; kept: rows with `offset`, in order. A hole is a run of rows that are not
// kept, { before, after }: the rows kept around it, null where there is none.
export function salvage(bytes, chunk, limits, seed, meter) {
  const payload = chunk.payloadStart;
  const byHeader = payload + chunk.payloadSize;
  const ends = [byHeader];
  const { next } = chunk;
  if (next !== null && next !== undefined && next !== byHeader && next <= byHeader + REACH && next > payload) ends.push(next);
  const limit = Math.min(Math.max(...ends), bytes.length);
  const table = readTable(bytes, payload, limit, limits.packetBound);
  const { entries } = table;
  meter.take(16 * entries.length, payload);
  const kept = new Map();
  const keep = (i, offset) => {
    const entry = entries[i];
    if (kept.has(i) || offset < payload || offset + entry.size > limit || !keepsTimes(entry, limits)) return;
    meter.take(entry.size + 16, payload);
    if (hasCrc(bytes, entry, offset, seed)) kept.set(i, { ...entry, offset });
  };
  let offset = table.tableEnd;
  for (let i = 0; i < entries.length; i++) {
    keep(i, offset);
    offset += entries[i].size;
  }
  for (const end of entries.length === table.count ? ends : []) {
    offset = end;
    for (let i = entries.length - 1; i >= 0; i--) {
      offset -= entries[i].size;
      keep(i, offset);
    }
  }
  const order = [...kept.keys()].sort((a, b) => a - b);
  const holes = [];
  order.forEach((i, place) => {
    if (i > (order[place - 1] ?? -1) + 1) holes.push({ before: kept.get(order[place - 1]) ?? null, after: kept.get(i) });
  });
  const last = order[order.length - 1];
  if (last === undefined) holes.push({ before: null, after: null });
  else if (last + 1 < table.count) holes.push({ before: kept.get(last), after: null });
  return { kept: order.map((i) => kept.get(i)), table, holes, payloadEnd: Math.min(byHeader, bytes.length), limit };
}

// For `identify`: bytes of the rows that hold, placed forwards, and of their packets.
export function heldSize(bytes, { payloadStart, end }, seed) {
  const { entries, tableEnd } = readTable(bytes, payloadStart, end);
  const fits = (entry) => keepsTimes(entry, LIMITS[2]) && entry.offset + entry.size <= end;
  const held = placePackets(entries, tableEnd).filter((entry) => fits(entry) && hasCrc(bytes, entry, entry.offset, seed));
  return held.reduce((sum, entry) => sum + entry.rowEnd - entry.at + entry.size, 0);
}
