// The procedure `salvage` of clause 12.1: the packets of a DATA chunk that is damaged.
import { hasCrc, keepsTimes, placePackets, readEntry, readTable } from './cluster.js';
import { LIMITS } from './limits.js';

const REACH = 65536;
// The entries begin within the first bytes: packet_count has three at most.
const COUNT_ROOM = 4;

// -> { kept, table, holes, allRead }; kept: entries with `offset`, in order of their rows. A hole lies
// between two kept (null: none): { before, after }.
export function salvage(bytes, chunk, tracks, limits, meter) {
  const payload = chunk.payloadStart;
  const byHeader = payload + chunk.payloadSize;
  const ends = [byHeader];
  const { next } = chunk;
  if (next !== null && next !== undefined && next !== byHeader && next <= byHeader + REACH && next > payload) ends.push(next);
  const limit = Math.min(Math.max(...ends), bytes.length);
  // Each is looked at for a while only: a search may end, and REC-005 bounds the whole.
  const budget = { left: 16 * (limit - payload + REACH) + 2 ** 22 };
  const holds = (entry, offset) => {
    if (offset < payload || !keepsTimes(entry, limits) || offset + entry.size > limit) return false;
    budget.left -= entry.size + 16;
    meter.take(entry.size + 16, payload);
    return budget.left >= 0 && hasCrc(bytes, entry, offset, chunk.seed);
  };
  const context = { bytes, payload, ends, limit, holds, tracks, budget, meter };

  const table = readTable(bytes, payload, limit, limits.packetBound);
  meter.take(16 * table.entries.length, payload);
  let kept = table.tableEnd === null ? [] : placeBothWays(context, table);
  let tableEnd = table.tableEnd;
  const all = table.tableEnd !== null && table.count > 0 && kept.length === table.entries.length;
  const last = table.entries[table.entries.length - 1];
  const lastKept = table.tableEnd !== null && kept.some((k) => k.at === last?.at) && bytesOf(kept) >= 4;
  if (!all && !lastKept) {
    const anew = lookForTable(context, table);
    if (anew && anew.kept.length > kept.length) ({ kept, tableEnd } = anew);
  }
  kept = extendBackwards(context, kept);
  const holes = holesOf(context, kept, tableEnd);
  const rows = new Set(kept.map((entry) => entry.at));
  const allRead = table.tableEnd !== null && table.entries.every((entry) => rows.has(entry.at));
  return { kept, table, holes, payloadEnd: Math.min(byHeader, bytes.length), limit, allRead };
}

// For `identify`: bytes of the packets that hold one after the other from the end of the table, and of their entries.
export function heldSize(bytes, { payloadStart, end, seed }) {
  const { entries, tableEnd } = readTable(bytes, payloadStart, end);
  if (tableEnd === null) return 0;
  const placed = placePackets(entries, tableEnd);
  const fits = (entry) => keepsTimes(entry, LIMITS[2]) && entry.offset + entry.size <= end;
  const held = placed.filter((entry) => fits(entry) && hasCrc(bytes, entry, entry.offset, seed));
  return held.reduce((sum, entry) => sum + entry.rowEnd - entry.at + entry.size, 0);
}

export const bytesOf = (kept) => kept.reduce((sum, entry) => sum + entry.size, 0);
const byRow = (a, b) => a.at - b.at;

// Step 1.
function placeBothWays({ ends, holds }, table) {
  const { entries, tableEnd } = table;
  const kept = new Map();
  let offset = tableEnd;
  for (const entry of entries) {
    if (holds(entry, offset)) kept.set(entry.at, { ...entry, offset });
    offset += entry.size;
  }
  for (const end of ends) {
    let position = end;
    for (let i = entries.length - 1; i >= 0; i--) {
      const entry = entries[i];
      if (kept.has(entry.at) && entry.size > 0) break;
      position -= entry.size;
      if (position < tableEnd) break;
      if (holds(entry, position)) kept.set(entry.at, { ...entry, offset: position });
    }
  }
  return [...kept.values()].sort(byRow);
}

// Step 2.
function lookForTable(context, table) {
  const last = lastEntry(context);
  let found;
  if (last) {
    found = { kept: last.kept, tableEnd: last.kept[last.kept.length - 1].rowEnd };
  } else {
    const tableEnd = tableFromFront(context, table);
    if (tableEnd === null) return null;
    found = { kept: [], tableEnd };
  }
  const { holds } = context;
  const firstKept = found.kept[0]?.at ?? Infinity;
  const front = [];
  let offset = found.tableEnd;
  for (const entry of table.entries) {
    if (entry.at >= firstKept || entry.rowEnd > offset) break;
    if (holds(entry, offset)) front.push({ ...entry, offset });
    offset += entry.size;
  }
  return { kept: [...front, ...found.kept], tableEnd: found.tableEnd };
}

// Step 2a: the last entry whose packet ends where the payload does.
function lastEntry({ bytes, payload, ends, limit, holds, tracks, budget, meter }) {
  const found = [];
  let firstPacket = Infinity;
  meter.take(Math.min(REACH, limit - payload), payload);
  for (let at = payload + 1; at < Math.min(payload + REACH, limit); at++) {
    const entry = readEntry(bytes, at, limit);
    if (!entry || entry.size < 1 || !tracks.has(entry.track)) continue;
    for (const end of ends) {
      const offset = end - entry.size;
      if (offset < entry.rowEnd || !holds(entry, offset)) continue;
      found.push({ ...entry, offset });
      firstPacket = Math.min(firstPacket, offset);
    }
    if (budget.left < 0) break;
  }
  const last = found.filter((entry) => entry.rowEnd <= firstPacket).pop();
  if (!last) return null;
  const kept = [last];
  for (let at = last.rowEnd; ;) {
    const entry = readEntry(bytes, at, limit);
    const offset = last.offset + last.size;
    if (!entry || entry.size !== 0 || !tracks.has(entry.track) || !holds(entry, offset)) break;
    kept.push({ ...entry, offset });
    at = entry.rowEnd;
  }
  return { kept };
}

// Step 2b: where the packets of the entries read from the front stand.
function tableFromFront({ payload, limit, holds, tracks, budget }, table) {
  let before = 0;
  const candidates = [];
  for (const entry of table.entries) {
    if (entry.size >= 1 && tracks.has(entry.track)) candidates.push({ entry, before });
    before += entry.size;
  }
  candidates.sort((a, b) => a.entry.size - b.entry.size);
  let alone = null;
  for (const { entry, before: ahead } of candidates.slice(0, 4)) {
    let best = 0;
    let place = null;
    const stop = Math.min(payload + REACH, limit);
    for (let from = entry.rowEnd; from < stop && budget.left >= 0; from++) {
      if (!holds(entry, from + ahead)) continue;
      let offset = from;
      let count = 0;
      for (const other of table.entries) {
        if (offset + other.size > limit || budget.left < 0) break;
        if (holds(other, offset)) count++;
        offset += other.size;
      }
      if (count > best) [best, place] = [count, from];
    }
    if (best > 1) return place;
    alone ??= place;
  }
  return alone;
}

// Step 3: rows that end where a kept one begins.
function extendBackwards({ bytes, payload, holds, tracks }, kept) {
  const result = new Map(kept.map((entry) => [entry.at, entry]));
  const rowEnds = new Set(kept.map((entry) => entry.rowEnd));
  for (let entry of kept) {
    while (!rowEnds.has(entry.at)) {
      const before = entryBefore(bytes, payload, entry, holds, tracks);
      if (!before || result.has(before.at)) break;
      result.set(before.at, before);
      rowEnds.add(before.rowEnd);
      entry = before;
    }
  }
  return [...result.values()].sort(byRow);
}

function entryBefore(bytes, payload, entry, holds, tracks) {
  for (let at = entry.at - 8; at >= Math.max(payload + 1, entry.at - 36); at--) {
    const before = readEntry(bytes, at, entry.at);
    if (!before || before.rowEnd !== entry.at || !tracks.has(before.track)) continue;
    const offset = entry.offset - before.size;
    if (offset >= before.rowEnd && holds(before, offset)) return { ...before, offset };
  }
  return null;
}

// Stretches in which packets are missing: between two kept ones, before the first and behind the last.
function holesOf({ payload, ends }, kept, tableEnd) {
  if (!kept.length) return [{ before: null, after: null }];
  const holes = [];
  const first = kept[0];
  const last = kept[kept.length - 1];
  if (first.offset !== tableEnd || first.at - payload >= COUNT_ROOM) holes.push({ before: null, after: first });
  for (let i = 1; i < kept.length; i++) {
    const [a, b] = [kept[i - 1], kept[i]];
    if (b.at > a.rowEnd || b.offset > a.offset + a.size) holes.push({ before: a, after: b });
  }
  if (last.rowEnd !== tableEnd || !ends.includes(last.offset + last.size)) holes.push({ before: last, after: null });
  return holes;
}
