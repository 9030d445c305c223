// The losses (docs/spec/recovery.md): a walk over packets and holes in the order of the sequence numbers.
import { unsupported } from './error.js';
import { NS_BOUND } from './indexes.js';
import { pushSpan } from './spans.js';

const MS_BOUND = 2 ** 53 - 1;
// One hole can affect every track: what this reader reports for all of them.
const SPAN_BOUND = 2 ** 20;
const WORK_BOUND = 2 ** 27;

// What may have been a DATA chunk.
const TAIL = new Set(['truncated', 'garbage', 'duplicate-chunk']);

export const spanOf = (packet) => ({ track: packet.track, start: packet.start, stop: packet.start + packet.span });

// Gives each damage its spans `took`: [{ track, start, stop | null }], and the file those that no single damage took.
export function findLosses(file) {
  if (!file.damages.length) return;
  if (file.damaged || file.recovering) new Losses(file).walk();
  const bare = file.lostResiduals.filter((track) => !track.unsupported);
  file.lost = bare.map((track) => ({ track: track.id, start: 0, stop: null }));
}

class Losses {
  constructor(file) {
    this.file = file;
    // Where a loss without a known end ends: in a closed file.
    this.durationNs = file.durationNs < NS_BOUND ? file.durationNs : null;
    this.budget = SPAN_BOUND;
    this.work = WORK_BOUND;
    this.found = [...new Set(file.chunks.map((chunk) => chunk.sequence))].sort((a, b) => a - b);
    this.types = new Map(file.chunks.map((chunk) => [chunk.sequence, chunk.type]));
    this.listed = new Map();
    for (const { firstSequence, entries } of file.indexes) entries.forEach((entry, i) => this.listed.set(firstSequence + i, entry));
    const known = new Set(this.found);
    this.gone = [...this.listed.keys()].filter((sequence) => !known.has(sequence)).sort((a, b) => a - b);
    this.lines = new Map();
    this.states = new Map();
    for (const track of [...file.tracks.values()].sort((a, b) => a.id - b.id)) {
      const chain = track.chain ?? track.id;
      if (!this.lines.has(chain)) this.lines.set(chain, { end: 0, rank: -1, states: [], spans: [] });
      const line = this.lines.get(chain);
      const state = { track, rank: track.base ?? track.id, line, hole: null };
      line.states.push(state);
      this.states.set(track.id, state);
    }
  }

  spend(work) {
    this.work -= work;
    if (this.work < 0) unsupported('LIM-003', 'more lost spans than this reader tells', 0);
  }

  walk() {
    const { file } = this;
    const jumps = file.damages.filter(({ code }) => code === 'missing-chunk').sort((a, b) => a.offset - b.offset);
    const jumpAt = (position) => jumps.findLast(({ offset }) => offset <= position) ?? jumps[0] ?? file.damages[0];
    let before = -1;
    for (const cluster of file.clusters) {
      const { chunk } = cluster;
      this.suspectMissing(before, chunk.sequence, jumpAt(chunk.position));
      before = Math.max(before, chunk.sequence);
      this.walkRows(cluster);
    }
    this.suspectMissing(before, this.found[this.found.length - 1] ?? -1, jumps[jumps.length - 1] ?? file.damages[0]);
    this.suspectTail();
    for (const state of this.states.values()) this.name(state, null);
    for (const packet of file.held) if (packet.left && packet.damage) this.leaveOut(packet);
  }

  walkRows({ chunk, kept, holes, lostTable }) {
    const times = this.timesOf(chunk.sequence);
    if (lostTable) {
      this.suspect(this.states.values(), times, lostTable);
      return;
    }
    const behind = new Map(holes.map((hole) => [hole.before, hole]));
    this.suspectRun(behind.get(null), times);
    for (const packet of kept) {
      if (packet.delivered) this.pass(packet);
      this.suspectRun(behind.get(packet), times);
    }
  }

  suspectRun(hole, times) {
    if (!hole) return;
    const [low, high] = [hole.before?.track ?? 0, hole.after?.track ?? Infinity];
    this.suspect([...this.states.values()].filter(({ track }) => track.id >= low && track.id <= high), times, hole.damage);
  }

  suspectMissing(low, high, damage) {
    const count = Math.max(high - low - 1, 0) - between(this.found, low, high).length;
    if (count <= 0) return;
    const gone = between(this.gone, low, high);
    this.spend(gone.length);
    const data = gone.map((sequence) => this.listed.get(sequence)).filter(({ type }) => type === 'DATA');
    if (gone.length < count) this.suspect(this.states.values(), null, damage);
    else if (data.length) this.suspect(this.states.values(), hullOf(data), damage);
  }

  // A file that was not closed: the content of its damaged end is not known.
  suspectTail() {
    const { file } = this;
    if (file.closed) return;
    const { position, type } = file.chunks.reduce((a, b) => (b.sequence >= a.sequence ? b : a));
    const may = (code) => TAIL.has(code) || (code === 'bad-payload' && type !== 'fOOT');
    const damage = file.damages.find(({ code, offset }) => may(code) && offset >= position);
    if (damage) this.suspect(this.states.values(), null, damage);
  }

  // [from, to] in milliseconds, or null where that is not known.
  timesOf(sequence) {
    const entry = this.listed.get(sequence);
    return entry?.type === 'DATA' ? hullOf([entry]) : null;
  }

  suspect(states, times, damage) {
    for (const state of states) {
      this.spend(1);
      if (state.rank < state.line.rank) continue;
      this.widen(state, ...ticksOf(times, state.track, this.durationNs), damage);
    }
  }

  widen(state, start, stop, damage) {
    if (!state) return;
    state.hole ??= { start, stop, damage };
    const { hole } = state;
    hole.start = Math.min(hole.start, start);
    hole.stop = hole.stop === null || stop === null ? null : Math.max(hole.stop, stop);
  }

  pass(packet) {
    const own = this.states.get(packet.track);
    if (!own || own.track.kind === 'events') return;
    const { line } = own;
    for (const state of line.states) {
      if (state.rank >= line.rank && state.rank <= own.rank) this.name(state, packet.start);
    }
    line.rank = own.rank;
    line.end = packet.start + packet.span;
    pushSpan(line.spans, packet.start, line.end);
  }

  // An intact packet that is not delivered: a tick is delivered or lost, never both.
  leaveOut({ track, start, span, damage }) {
    const own = this.states.get(track);
    if (!own || own.track.kind === 'events' || own.track.strange) return;
    damage.took = [];
    let at = start;
    for (const [first, stop] of own.line.spans) {
      this.spend(1);
      if (stop <= at) continue;
      if (first >= start + span) break;
      if (at < first) damage.took.push({ track, start: at, stop: first });
      at = stop;
    }
    if (at < start + span) damage.took.push({ track, start: at, stop: start + span });
  }

  name(state, limit) {
    const { hole, line, track } = state;
    state.hole = null;
    if (!hole) return;
    const start = Math.max(line.end, hole.start);
    const stop = limit === null ? hole.stop : Math.min(limit, hole.stop ?? Infinity);
    if (stop !== null && stop <= start) return;
    this.budget -= 1;
    if (this.budget < 0) unsupported('LIM-003', 'more lost spans than this reader tells', 0);
    hole.damage.took ??= [];
    hole.damage.took.push({ track: track.id, start, stop });
  }
}

// Those of a sorted list between two numbers.
function between(list, low, high) {
  return list.slice(firstAbove(list, low), firstAbove(list, high - 1));
}

function firstAbove(list, value) {
  let [low, high] = [0, list.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle] > value) high = middle;
    else low = middle + 1;
  }
  return low;
}

const hullOf = (entries) => [
  entries.reduce((low, { startMs }) => Math.min(low, startMs), Infinity),
  entries.reduce((high, { stopMs }) => Math.max(high, stopMs), 0),
];

// The ticks of a track that overlap these times.
function ticksOf(times, track, durationNs) {
  const scale = 1000n * BigInt(track.rateDen);
  const rate = BigInt(track.rateNum);
  const last = durationNs === null ? null : Number((durationNs * rate) / (10n ** 6n * scale));
  if (!times) return [0, last];
  const start = Number((BigInt(times[0]) * rate) / scale);
  return [start, times[1] >= MS_BOUND ? last : Number((BigInt(times[1]) * rate + scale - 1n) / scale)];
}
