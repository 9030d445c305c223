// What was lost (12.2): how much a hole took follows from what stands around it.
import { tableFaults } from './cluster.js';
import { unsupported } from './error.js';

const MS_BOUND = 2 ** 53 - 1;
// One hole can speak of every track: what this reader tells of all of them.
const SPAN_BOUND = 2 ** 20;
const WORK_BOUND = 2 ** 27;

function spend(context, work, spans = 0) {
  context.work -= work;
  context.budget -= spans;
  if (context.work < 0 || context.budget < 0) unsupported('LIM-003', 'more lost spans than this reader tells', 0);
}

// Gives each damage its spans `took`: [{ track, start, stop | null }], and the file those that no single damage took.
export function findLosses(file) {
  if (!file.damages.length) return;
  const context = makeContext(file);
  for (const cluster of file.clusters) {
    // In a file that was not closed and has no other damage, a table that breaks a rule is a finding, no hole (12.1).
    if (!cluster.salvaged || !(file.damaged || file.recovering)) continue;
    const own = { low: cluster.chunk.sequence - 1, high: cluster.chunk.sequence + 1 };
    takeStrange(context, cluster);
    if (cluster.lostTable) {
      // The few that were kept may lie anywhere in what is missing.
      for (let i = 0; i <= cluster.kept.length; i++) takeHole(context, cluster.lostTable, cluster.first + i, own, null);
    } else {
      for (const hole of cluster.holes) {
        const place = hole.after ? file.held.indexOf(hole.after, cluster.first) : cluster.first + cluster.kept.length;
        takeHole(context, hole.damage, place, own, [hole.before?.track ?? 0, hole.after?.track ?? Infinity]);
      }
      takeHiddenRows(context, cluster, own);
    }
  }
  for (const damage of file.damages) {
    for (const hole of missingChunks(context, damage)) takeHole(context, damage, placeOf(file, hole.low), hole, null);
    if (damage.code === 'overlap') damage.took = uncovered(context, damage.packet);
  }
  file.lost = file.damaged || file.recovering
    ? file.lostResiduals.filter((track) => !track.unsupported).map((track) => ({ track: track.id, start: 0, stop: null })) : [];
}

export const spanOf = (packet) => ({ track: packet.track, start: packet.start, stop: packet.start + packet.span });

function makeContext(file) {
  const ids = new Set([...file.tracks.keys(), ...file.held.map((packet) => packet.track)]);
  const byChain = new Map();
  file.held.forEach((packet, place) => {
    if (packet.overlap) return;
    const chain = chainOf(file, packet.track);
    if (!byChain.has(chain)) byChain.set(chain, []);
    byChain.get(chain).push({ place, packet });
  });
  return { file, ids: [...ids].sort((a, b) => a - b), byChain, listings: file.indexes.map((index) => align(file, index)), gaps: gapsOf(file.chunks), budget: SPAN_BOUND, work: WORK_BOUND };
}

const chainOf = (file, id) => file.tracks.get(id)?.chain ?? `lost ${id}`;

// Bytes between the last row and the first packet may be what is left of rows behind the last one kept.
function takeHiddenRows(context, { holes, kept, first }, own) {
  const last = kept[kept.length - 1];
  if (!holes.length || holes[0].before || kept[0].offset <= last.rowEnd) return;
  takeHole(context, holes[0].damage, first + kept.length, own, [last.track, Infinity]);
}

// A damaged DATA chunk may hold the bytes of another cluster, and does not tell then what stood in it.
function takeStrange(context, { chunk, kept, table, first }) {
  const { file } = context;
  if (chunk.intact) return;
  const next = file.chunks[chunk.order + 1];
  const missing = next && next.sequence > chunk.sequence + 1;
  const overlaps = kept.some((packet) => packet.overlap);
  if (next && !missing && !overlaps && !keepsEveryRule(file, chunk, kept, table)) return;
  const { damage } = chunk;
  const range = { low: chunk.sequence - 1, high: next ? Math.max(next.sequence, chunk.sequence + 1) : Infinity };
  takeHole(context, damage, first, range, null);
  if (!next || overlaps) takeHole(context, damage, first + kept.length, range, null);
}

function keepsEveryRule(file, chunk, kept, table) {
  if (!chunk.whole || table.fault || kept.length !== table.entries.length) return false;
  if (tableFaults(table, chunk.payloadStart, chunk.end, file.allTracks, file.limits).length) return false;
  let { tableEnd } = table;
  for (const packet of kept) {
    if (packet.size && packet.offset !== tableEnd) return false;
    tableEnd += packet.size;
  }
  return true;
}

// The sequence numbers that missing chunks can have, each time between low and high.
function missingChunks(context, damage) {
  const { file, gaps } = context;
  const { chunks } = file;
  const after = damage.chunk ? damage.chunk.order : damage.after;
  const low = after > 0 ? chunks[after - 1].sequence : -1;
  if (damage.code === 'missing-chunk') {
    const high = chunks[after].sequence;
    const found = [];
    for (let i = firstWhere(gaps, (gap) => gap.low >= low); i < gaps.length && gaps[i].high <= high; i++) {
      spend(context, 1);
      if (!gaps[i].taken) found.push(gaps[i]);
    }
    for (const gap of found) gap.taken = true;
    return found;
  }
  if (!['truncated', 'duplicate-chunk', 'garbage'].includes(damage.code)) return [];
  file.lastData ??= chunks.findLast((chunk) => chunk.type === 'DATA')?.position ?? -1;
  if (damage.offset < file.lastData) return [];
  // The indexes of a closed file list every chunk.
  if (file.closed) return [];
  return [{ low, high: chunks[damage.chunk ? after + 1 : after]?.sequence ?? Infinity }];
}

function gapsOf(chunks) {
  const sequences = [...new Set(chunks.map((chunk) => chunk.sequence))].sort((a, b) => a - b);
  const gaps = [];
  let before = -1;
  for (const sequence of sequences) {
    if (sequence > before + 1) gaps.push({ low: before, high: sequence });
    before = sequence;
  }
  return gaps;
}

// Of a packet that overlaps others: the ticks that these do not have.
function uncovered(context, packet) {
  const { file } = context;
  const list = context.byChain.get(chainOf(file, packet.track)) ?? [];
  spend(context, list.length);
  const took = [];
  let { start } = packet;
  const stop = packet.start + packet.span;
  for (const { packet: other } of list) {
    const end = other.start + other.span;
    if (!other.delivered || end <= start || other.start >= stop) continue;
    if (other.start > start) took.push({ track: packet.track, start, stop: other.start });
    start = end;
  }
  if (start < stop) took.push({ track: packet.track, start, stop });
  return took;
}

function placeOf(file, low) {
  const i = firstWhere(file.clusters, ({ chunk }) => chunk.sequence > low);
  return i < file.clusters.length ? file.clusters[i].first : file.held.length;
}

// scope: [from track, to track], or null for any.
function takeHole(context, damage, place, range, scope) {
  const { file } = context;
  damage.took ??= [];
  damage.keys ??= new Set();
  spend(context, context.ids.length);
  const times = listedTimes(context, range);
  if (times === 'nothing') return;
  for (const id of context.ids) {
    if (scope && (id < scope[0] || id > scope[1])) continue;
    const track = file.tracks.get(id) ?? file.allTracks.get(id);
    let [start, stop] = within(times, track);
    if (track?.kind !== 'events') {
      const around = packetsAround(context, id, place);
      if (!around) continue;
      start = Math.max(start, around[0]);
      stop = around[1] === null ? stop : Math.min(stop ?? Infinity, around[1]);
    }
    if (stop !== null && stop <= start) continue;
    spend(context, 0, 1);
    const key = `${id} ${start} ${stop}`;
    if (damage.keys.has(key)) continue;
    damage.keys.add(key);
    damage.took.push({ track: id, start, stop });
  }
}

// The first place in a sorted list from which on a test holds.
function firstWhere(list, test) {
  let [low, high] = [0, list.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (test(list[middle])) high = middle;
    else low = middle + 1;
  }
  return low;
}

// The end of the last packet before, the start of the next one behind; null where a track of its chain tells that
// nothing of it can be missing there (TRK-016).
function packetsAround(context, id, place) {
  const list = context.byChain.get(chainOf(context.file, id)) ?? [];
  const i = firstWhere(list, (one) => one.place >= place);
  const before = list[i - 1]?.packet;
  const after = list[i]?.packet;
  const rank = (packet) => context.file.tracks.get(packet.track)?.base ?? packet.track;
  const own = context.file.tracks.get(id)?.base ?? id;
  if ((before && rank(before) > own) || (after && rank(after) < own)) return null;
  return [before ? before.start + before.span : 0, after ? after.start : null];
}

const ceilDiv = (n, d) => (n + d - 1n) / d;

function within(times, track) {
  if (!times || !track) return [0, null];
  const scale = 1000n * BigInt(track.rateDen);
  const rate = BigInt(track.rateNum);
  const start = Number(ceilDiv(BigInt(times[0]) * rate, scale));
  return [start, times[1] >= MS_BOUND ? null : Number((BigInt(times[1]) * rate) / scale)];
}

// What the indexes say of the DATA chunks between two sequence numbers that were not found intact: [start, stop] in
// milliseconds, 'nothing' where they list every chunk and none is left, null where they do not tell.
function listedTimes(context, { low, high }) {
  const { file, listings } = context;
  file.intact ??= new Set(file.chunks.filter((chunk) => chunk.intact).map((chunk) => chunk.sequence));
  for (const { first, last, entries } of listings) {
    if (low + 1 < first || high > last) continue;
    let times = null;
    for (let i = firstWhere(entries, (entry) => entry.sequence > low); i < entries.length && entries[i].sequence < high; i++) {
      spend(context, 1);
      const { type, sequence, startMs, stopMs } = entries[i];
      if (type !== 'DATA' || file.intact.has(sequence)) continue;
      times = times ? [Math.min(times[0], startMs), Math.max(times[1], stopMs)] : [startMs, stopMs];
    }
    return times ?? 'nothing';
  }
  return null;
}

// The sequence numbers of what an index lists: every chunk but iNDX and fOOT before it, so that they are told from
// behind, however many bytes were deleted or put between.
function align(file, index) {
  const own = new Set();
  const found = new Map();
  for (const { type, sequence } of file.chunks) {
    if (type === 'iNDX' || type === 'fOOT') own.add(sequence);
    found.set(sequence, type);
  }
  const entries = [];
  let sequence = index.chunk.sequence;
  for (let i = index.entries.length - 1; i >= 0; i--) {
    do sequence--; while (own.has(sequence));
    const entry = index.entries[i];
    if (sequence < 0 || (found.has(sequence) && found.get(sequence) !== entry.type)) return { first: Infinity, last: -Infinity, entries: [] };
    entries.push({ ...entry, sequence });
  }
  entries.reverse();
  // The first chunk of a file is chunk 0.
  if (index.coversFrom === 8 && entries.length && entries[0].sequence !== 0) return { first: Infinity, last: -Infinity, entries: [] };
  const first = index.coversFrom === 8 ? 0 : entries[0]?.sequence ?? index.chunk.sequence;
  return { first, last: index.chunk.sequence, entries };
}

