// Envelopes: least and largest values by bins, of samples that are few, else of an overview or of pyramids. Pyramids are
// built in the background, cluster by cluster, first of the times that are looked at.
import { BadOverview, binsOf } from './overview.js';
import { Pyramid, binWidth, spansWithin } from './pyramid.js';
import { isCounted, physical, scaleOf } from './signals.js';
import { aborted } from './sources.js';
import { gapsBetween, secondsAt, secondsBetween, tickAt } from './ticks.js';

const DIRECT = 2 ** 19; // samples that are decoded at once
const PYRAMID_BYTES = 1.6e8;
const FINEST = 8; // ticks of a bin
const QUICK = 2 ** 17; // bytes of an overview for a first picture
const SLICE_MS = 20;
const VIEWS = 6; // pictures that are on the way
const GROUP = 2 ** 20; // bytes of clusters that are fetched together
const STRETCH = 2 ** 17; // ticks that are decoded without a pause
const TICK_BOUND = 2 ** 48;

const pause = () => new Promise((resolve) => { setTimeout(resolve, 0); });

export class Pictures {
  constructor(session) {
    const { file, packets, signals } = session;
    Object.assign(this, { session, file, packets, signals });
    this.pyramids = new Map();
    this.views = [];
    this.working = false;
    this.closed = false;
    this.clock = 0;
    this.last = null; // clusters of some times
  }

  close() {
    this.closed = true;
    this.pyramids.clear();
    this.views = [];
  }

  async envelope(channels, t0, t1, bins, band, signal) {
    const views = channels.map((channel) => this.viewOf(channel, t0, t1, bins, band));
    const few = views.reduce((sum, { first, stop }) => sum + stop - first, 0) <= DIRECT;
    const out = {};
    const waiting = [];
    const rough = new Map();
    for (const view of views) {
      const { index } = view.channel;
      if (signal?.aborted) throw aborted();
      const level = this.levelFor(view);
      if (view.width <= 2) out[index] = await this.bySamples(view, signal);
      else if (this.isBuilt(view)) out[index] = this.byPyramid(view);
      else if (level && level.level.size <= 2 * view.width) rough.set(view, level);
      else if (few) out[index] = await this.byBins(view, signal);
      else {
        const pyramid = this.pyramidOf(view); // of many channels it may be coarser than the picture
        const missing = this.missingIn(view, pyramid).length > 0;
        if (missing) waiting.push({ channel: view.channel, band, pyramid });
        if (missing && level) rough.set(view, level);
        else out[index] = this.byPyramid(view);
      }
    }
    if (rough.size) {
      const shown = this.atOnce(rough);
      const held = await this.load(shown, signal);
      if (!held) return this.envelope(channels, t0, t1, bins, band, signal);
      for (const [view, level] of shown) out[view.channel.index] = this.byOverview(view, level, held);
    }
    if (waiting.length) this.want(waiting, t0, t1);
    return out;
  }

  // What is shown of a channel: the ticks that it may have, in bins of `width` ticks.
  viewOf(channel, t0, t1, bins, band) {
    const { track } = channel;
    const [low, high] = this.session.extent(channel);
    const first = Math.max(tickAt(track, t0), low);
    const stop = Math.max(Math.min(tickAt(track, t1), high), first);
    const ticks = ((t1 - t0) * track.rateNum) / track.rateDen / bins;
    return { channel, band, low, high, first, stop, width: binWidth(Math.min(Math.max(ticks, 1), TICK_BOUND)) };
  }

  // `count` bins from tick `from` on hold what is shown. All bins of one width have the same places.
  binsFor({ first, stop }, width) {
    const from = Math.floor(first / width) * width;
    return { from, count: Math.ceil((stop - from) / width) };
  }

  async bySamples({ channel, band, first, stop }, signal) {
    const { track } = channel;
    const found = await this.signals.numbers(channel, band, first, stop, signal);
    const value = physical(channel, band, found, first);
    const gaps = gapsBetween(track, found.spans, first, stop);
    return { kind: 'samples', time: secondsBetween(track, first, stop), min: value, max: value, complete: true, gaps };
  }

  async byBins(view, signal) {
    const { channel, band, low, high, width } = view;
    const { from, count } = this.binsFor(view, width);
    const first = Math.max(from, low);
    const stop = Math.max(Math.min(from + count * width, high), first);
    const { values, spans } = await this.signals.numbers(channel, band, first, stop, signal);
    const min = new Float64Array(count).fill(NaN);
    const max = new Float64Array(count).fill(NaN);
    for (const [start, end] of spans) {
      for (let tick = start; tick < end; tick++) {
        const v = values[tick - first];
        if (v !== v) continue; // NaN
        const bin = Math.floor((tick - from) / width);
        if (!(min[bin] <= v)) min[bin] = v;
        if (!(max[bin] >= v)) max[bin] = v;
      }
    }
    return this.result(view, { from, width, min, max, spans, counted: isCounted(channel, band), complete: true });
  }

  byPyramid(view) {
    const { channel, band } = view;
    const pyramid = this.pyramidOf(view);
    const width = Math.max(view.width, pyramid.width);
    const { from, count } = this.binsFor(view, width);
    const { min, max } = pyramid.query(from, width, count);
    const missing = this.missingIn(view, pyramid);
    // The times of clusters that are not read yet do not count as gaps.
    const spans = missing.length ? withPending(pyramid.spans, missing, this.file.clusters, channel.track) : pyramid.spans;
    return this.result(view, { from, width, min, max, spans, counted: isCounted(channel, band), complete: !missing.length });
  }

  result({ channel, band, first, stop }, { from, width, min, max, spans, counted, complete }) {
    const { track } = channel;
    if (counted) scale(scaleOf(channel, band), min, max);
    const time = new Float64Array(min.length);
    for (let i = 0; i < time.length; i++) time[i] = secondsAt(track, from + i * width + (width - 1) / 2);
    const gaps = gapsBetween(track, spansWithin(spans, first, stop, width / 2), first, stop);
    return { kind: 'envelope', time, min, max, complete, gaps };
  }

  // The level of the overview for a picture, null where there is none. Clusters that came later count more (OVW-002).
  levelFor({ channel, band, first, stop, width }) {
    const { overview } = this.session;
    const row = band === 'sum' && overview?.rows.get(channel.index);
    if (!row || !row.ticks || stop <= first) return null;
    const later = (n) => this.file.clusters[n].offset >= overview.covered;
    if (this.clustersFor(channel, first, stop).some(later)) return null;
    return { row, level: overview.levelFor(row, width), first, stop };
  }

  // What is shown of the overview at first: where much has to be fetched, the coarsest level of each channel.
  atOnce(rough) {
    if (this.session.overview.missingBytes(rough.values()) <= QUICK) return rough;
    this.load(rough).then(() => this.session.tell('overview', {}), () => {});
    return new Map([...rough].map(([view, one]) => [view, { ...one, level: one.row.levels.at(-1) }]));
  }

  // The parts of the overview for some pictures, null where it breaks a rule: it is not used any more.
  async load(rough, signal) {
    const { session } = this;
    try {
      return await session.overview.load([...rough.values()], signal);
    } catch (error) {
      if (!(error instanceof BadOverview)) throw error;
      session.overview = null;
      return null;
    }
  }

  byOverview(view, { level }, held) {
    const width = level.size * Math.max(Math.round(view.width / level.size), 1);
    const { from, count } = this.binsFor(view, width);
    const { min, max } = binsOf(held, level, from, width, count);
    const spans = [];
    min.forEach((v, bin) => {
      if (!(v === v)) return;
      const last = spans[spans.length - 1];
      const start = from + bin * width;
      if (last && last[1] === start) last[1] += width;
      else spans.push([start, start + width]);
    });
    return this.result(view, { from, width, min, max, spans, counted: false, complete: level.size <= 2 * view.width });
  }

  // Channels of one picture mostly want the same.
  clustersFor({ track }, first, stop) {
    const [startMs, stopMs] = [1000 * secondsAt(track, first), 1000 * secondsAt(track, stop)];
    const { last } = this;
    if (last?.startMs !== startMs || last.stopMs !== stopMs) {
      this.last = { startMs, stopMs, numbers: this.packets.clustersBetween(startMs, stopMs) };
    }
    return this.last.numbers;
  }

  missingIn({ channel, first, stop }, pyramid) {
    return this.clustersFor(channel, first, stop).filter((n) => !pyramid.done[n]);
  }

  isBuilt(view) {
    const pyramid = this.pyramids.get(keyOf(view));
    return pyramid !== undefined && pyramid.width <= view.width && !this.missingIn(view, pyramid).length;
  }

  pyramidOf(view) {
    const { channel, band } = view;
    const key = keyOf(view);
    let pyramid = this.pyramids.get(key);
    if (!pyramid) {
      pyramid = new Pyramid(this.finestWidth(), isCounted(channel, band), this.file.clusters.length);
      pyramid.key = key;
      this.pyramids.set(key, pyramid);
    }
    pyramid.used = ++this.clock;
    return pyramid;
  }

  // As fine as the memory allows for all channels together.
  finestWidth() {
    const samples = [...this.session.extents.values()].reduce((sum, [first, stop]) => sum + stop - first, 0);
    let width = FINEST;
    while ((samples / width) * 12 > PYRAMID_BYTES && width < 2 ** 24) width *= 8;
    return width;
  }

  // Pyramids that were not used for long go where there are too many.
  shed() {
    const kept = new Set(this.views.flatMap(({ parts }) => parts.map(({ pyramid }) => pyramid)));
    let total = 0;
    for (const pyramid of this.pyramids.values()) total += pyramid.weight;
    const others = [...this.pyramids.values()].filter((one) => !kept.has(one)).sort((a, b) => a.used - b.used);
    for (const pyramid of others) {
      if (total <= 2 * PYRAMID_BYTES) break;
      total -= pyramid.weight;
      this.pyramids.delete(pyramid.key);
    }
  }

  // parts: [{ channel, band, pyramid }] of one picture. Several pictures may be on the way.
  want(parts, t0, t1) {
    const name = ({ pyramid }) => pyramid.key;
    const names = parts.map(name).join();
    const others = this.views.filter((view) => view.parts.map(name).join() !== names);
    this.views = [{ parts, t0, t1 }, ...others.slice(0, VIEWS - 1)];
    if (!this.working && !this.closed) this.work();
  }

  async work() {
    const { session } = this;
    this.working = true;
    this.began = performance.now();
    try {
      while (!this.closed) {
        const { parts, group } = this.nextClusters();
        if (!group.length) break;
        await this.build(group, parts);
      }
      if (!this.closed) session.tell('overview', { verdict: session.verdict });
    } catch (error) {
      session.mend(error, this.file).catch((cause) => {
        const { message, requirement = null, kind = 'internal' } = cause;
        if (!this.closed) session.tell('error', { error: { message, requirement, kind } });
      });
    } finally {
      this.working = false;
    }
  }

  // Requests come first.
  async breathe() {
    if (!this.session.busy && performance.now() - this.began < SLICE_MS) return;
    this.session.tell('overview', { verdict: this.session.verdict });
    do await pause(); while (this.session.busy && !this.closed);
    this.began = performance.now();
  }

  // Some clusters that are missing in a picture: of the times that are seen, and without an overview of all others.
  nextClusters() {
    this.shed();
    const all = this.session.overview ? [] : this.file.clusters.map((_, n) => n);
    const seen = this.views.map(({ parts, t0, t1 }) => ({ parts, numbers: this.packets.clustersBetween(1000 * t0, 1000 * t1) }));
    for (const { parts, numbers } of [...seen, ...this.views.map(({ parts }) => ({ parts, numbers: all }))]) {
      const open = numbers.filter((n) => parts.some(({ pyramid }) => !pyramid.done[n]));
      if (open.length) return { parts, group: this.firstOf(open) };
    }
    return { parts: [], group: [] };
  }

  firstOf(numbers) {
    const group = [];
    let size = 0;
    for (const n of numbers) {
      if (group.length && size > GROUP) break;
      group.push(n);
      size += this.file.clusters[n].stop - this.file.clusters[n].offset;
    }
    return group;
  }

  async build(numbers, parts) {
    const { clusters } = this.file;
    const tracks = new Set(parts.flatMap(({ channel }) => channel.parts.map(({ base }) => base.id)));
    if (!this.file.bytes && 4 * tracks.size >= this.file.tracks.size) {
      await this.session.source.readAll(numbers.map((n) => [clusters[n].offset, clusters[n].stop]));
    }
    let i = 0;
    for await (const table of this.packets.tablesOf(numbers)) {
      const n = numbers[i++];
      for (const part of parts) {
        if (part.pyramid.done[n]) continue;
        await this.breathe();
        if (this.closed) return;
        await this.put(part, table);
        part.pyramid.done[n] = 1;
      }
    }
  }

  // What one cluster has of a channel.
  async put({ channel, band, pyramid }, table) {
    for (const { base, hf } of channel.parts) {
      const track = band === 'hf' ? hf : base;
      for (const { start, stop } of stretches(table.get(track?.id) ?? [])) {
        const { values, spans } = await this.signals.numbers(channel, band, start, stop);
        pyramid.put(values, start, spans);
      }
    }
  }
}

const keyOf = ({ channel, band }) => `${channel.index} ${band}`;

function scale({ A, B, D }, min, max) {
  for (let i = 0; i < min.length; i++) {
    const a = (min[i] * A + B) / D;
    const b = (max[i] * A + B) / D;
    [min[i], max[i]] = A < 0 ? [b, a] : [a, b];
  }
}

// Packets side by side as one stretch of ticks.
function stretches(packets) {
  const found = [];
  for (const { start, span } of packets) {
    const last = found[found.length - 1];
    if (last && last.stop === start && last.stop - last.start < STRETCH) last.stop += span;
    else found.push({ start, stop: start + span });
  }
  return found;
}

// Spans with the times of clusters that were not read yet.
function withPending(spans, numbers, clusters, track) {
  const pending = []; // in milliseconds
  for (const n of numbers) {
    const { startMs, stopMs } = clusters[n];
    const last = pending[pending.length - 1];
    if (last && startMs <= last[1]) last[1] = Math.max(last[1], stopMs);
    else pending.push([startMs, stopMs]);
  }
  const tick = (ms) => (ms * track.rateNum) / track.rateDen / 1000;
  const all = spans.map(([start, stop]) => [start, stop]);
  for (const [startMs, stopMs] of pending) all.push([Math.floor(tick(startMs)), Math.ceil(tick(stopMs))]);
  all.sort((a, b) => a[0] - b[0]);
  const merged = [];
  for (const [start, stop] of all) {
    const last = merged[merged.length - 1];
    if (last && start <= last[1]) last[1] = Math.max(last[1], stop);
    else merged.push([start, stop]);
  }
  return merged;
}
