// One file that is looked at: what the page asks for, and the work in the background. It runs in a Worker.
import { decodeEvents } from '../decoder/codecs.js';
import { HapfError, unsupported } from '../decoder/error.js';
import { reportOf } from '../decoder/report.js';
import { verifyFile } from '../decoder/verify.js';
import { FalseIndex, openByIndex } from './byindex.js';
import { readWhole, walkFile } from './bywalk.js';
import { damagesOf, faultOf } from './damages.js';
import { describe } from './describe.js';
import { knotsBetween } from './knots.js';
import { Packets } from './packets.js';
import { Pyramid, binWidth, spansWithin } from './pyramid.js';
import { Signals, channelsOf, isCounted, physical, scaleOf } from './signals.js';
import { aborted, openSource } from './sources.js';
import { gapsBetween, secondsAt, secondsBetween, tickAt } from './ticks.js';

const SAMPLE_BOUND = 2e7; // of one request
const BIN_BOUND = 2 ** 22; // channels times bins
const DIRECT = 2 ** 20; // samples that are decoded at once for an envelope
const PYRAMID_BYTES = 1.6e8;
const FAULT_BOUND = 2 ** 16;
const EVENT_BOUND = 2 ** 20;
const SLICE_MS = 20;
const VIEWS = 6; // pictures that are on the way
const GROUP = 2 ** 20; // bytes of clusters that are fetched together

const pause = () => new Promise((resolve) => { setTimeout(resolve, 0); });

export class Session {
  // tell(what, facts): called when something progressed.
  constructor(source, tell) {
    this.source = source;
    this.tell = tell;
    this.file = null;
    this.faults = [];
    this.report = null;
    this.pyramids = new Map();
    this.views = [];
    this.working = false;
    this.closed = false;
    this.clock = 0;
  }

  static async open(source, tell = () => {}) {
    const session = new Session(await openSource(source), tell);
    const file = await openByIndex(session.source);
    if (file) session.use(file);
    else await session.walk();
    return session.guarded(async () => {
      session.facts = await describe(session);
      return session;
    });
  }

  use(file) {
    this.file = file;
    this.packets = new Packets(this.source, file);
    this.signals = new Signals(this.packets, (fault) => this.fault(fault));
    this.channels = channelsOf(file);
    this.byIndex = new Map(this.channels.map((channel) => [channel.index, channel]));
    this.faults = [];
    this.pyramids.clear();
    this.views = [];
    this.eventList = null;
  }

  // The whole file, since its index is missing or does not hold.
  async walk() {
    const bytes = await readWhole(this.source, (done, size) => this.tell('progress', { done, size }));
    this.use(walkFile(bytes));
  }

  // Does something by the index, and again by a walk where the index does not hold.
  async guarded(action) {
    const { file } = this;
    try {
      return await action();
    } catch (error) {
      await this.mend(error, file);
      return action();
    }
  }

  // file: the one in use where the error arose.
  async mend(error, file) {
    if (!(error instanceof FalseIndex)) throw error;
    if (file.bytes) throw new Error('a walk disagrees with itself');
    this.mended ??= this.walk().then(() => describe(this)).then((facts) => {
      this.facts = facts;
      this.tell('damage', { facts, verdict: this.verdict });
    });
    await this.mended;
  }

  get verdict() {
    if (this.report) return this.report.verdict;
    if (this.file.bytes && this.file.verdict !== 'intact') return this.file.verdict;
    return this.faults.length ? 'nonconforming' : 'intact so far';
  }

  fault(fault) {
    if (this.faults.length < FAULT_BOUND) this.faults.push(faultOf(this.file, fault));
    this.tell('damage', { verdict: this.verdict });
  }

  channel(index) {
    return this.byIndex.get(index) ?? unsupported(null, `there is no channel ${index}`, null);
  }

  // The first tick and the one after the last of what a channel may have.
  extent(channel) {
    return this.extents.get(channel.index) ?? [0, 0];
  }

  ticksOf(channel, t0, t1) {
    const [low, high] = this.extent(channel);
    const first = Math.max(tickAt(channel.track, t0), low);
    return [first, Math.max(Math.min(tickAt(channel.track, t1), high), first)];
  }

  samples(index, t0, t1, band = 'sum', { signal } = {}) {
    return this.guarded(async () => {
      const channel = this.channel(index);
      checkBand(band);
      const [first, stop] = this.ticksOf(channel, t0, t1);
      if (stop - first > SAMPLE_BOUND) unsupported('LIM-003', `more than ${SAMPLE_BOUND} samples`, null);
      const found = await this.signals.numbers(channel, band, first, stop, signal);
      return {
        time: secondsBetween(channel.track, first, stop),
        value: physical(channel, band, found, first),
        gaps: gapsBetween(channel.track, found.spans, first, stop),
      };
    });
  }

  envelope(indexes, t0, t1, bins, band = 'sum', { signal } = {}) {
    return this.guarded(async () => {
      checkBand(band);
      if (!(bins >= 1) || indexes.length * bins > BIN_BOUND) unsupported('LIM-003', 'more bins than this reader makes', null);
      const views = indexes.map((index) => this.viewOf(this.channel(index), t0, t1, Math.floor(bins), band));
      const direct = views.reduce((sum, { first, stop }) => sum + stop - first, 0) <= DIRECT;
      const out = {};
      const waiting = [];
      for (const view of views) {
        if (direct || view.width <= 2) out[view.channel.index] = await this.fromSamples(view, signal);
        else {
          const { result, pyramid } = this.fromPyramid(view);
          out[view.channel.index] = result;
          if (!result.complete) waiting.push({ channel: view.channel, band, pyramid });
        }
      }
      if (waiting.length) this.want(waiting, t0, t1);
      return out;
    });
  }

  viewOf(channel, t0, t1, bins, band) {
    const [first, stop] = this.ticksOf(channel, t0, t1);
    const ticks = ((t1 - t0) * channel.track.rateNum) / channel.track.rateDen / bins;
    return { channel, band, first, stop, width: binWidth(Math.min(Math.max(ticks, 1), 2 ** 48)) };
  }

  async fromSamples({ channel, band, first, stop, width }, signal) {
    const { track } = channel;
    if (width <= 2) {
      const found = await this.signals.numbers(channel, band, first, stop, signal);
      const value = physical(channel, band, found, first);
      return {
        kind: 'samples', time: secondsBetween(track, first, stop), min: value, max: value, complete: true,
        gaps: gapsBetween(track, found.spans, first, stop),
      };
    }
    const from = Math.floor(first / width) * width;
    const count = Math.ceil((stop - from) / width);
    const [low, high] = this.extent(channel);
    const [a, b] = [Math.max(from, low), Math.min(from + count * width, high)];
    const found = await this.signals.numbers(channel, band, a, Math.max(b, a), signal);
    const min = new Float64Array(count).fill(NaN);
    const max = new Float64Array(count).fill(NaN);
    for (const [start, end] of found.spans) {
      for (let i = start; i < end; i++) {
        const v = found.values[i - a];
        const bin = Math.floor((i - from) / width);
        if (!(min[bin] <= v)) min[bin] = v;
        if (!(max[bin] >= v)) max[bin] = v;
      }
    }
    return this.envelopeOf({ channel, band, first, stop, width }, from, min, max, found.spans, true);
  }

  envelopeOf({ channel, band, first, stop, width }, from, min, max, spans, complete) {
    const { track } = channel;
    if (isCounted(channel, band)) scale(scaleOf(channel, band), min, max);
    const time = new Float64Array(min.length);
    for (let i = 0; i < time.length; i++) time[i] = secondsAt(track, from + i * width + (width - 1) / 2);
    return {
      kind: 'envelope', time, min, max, complete,
      gaps: gapsBetween(track, spansWithin(spans, first, stop, width / 2), first, stop),
    };
  }

  fromPyramid(view) {
    const { channel, band, first, stop } = view;
    const pyramid = this.pyramidOf(channel, band);
    const width = Math.max(view.width, binWidth(pyramid.width));
    const from = Math.floor(first / width) * width;
    const count = Math.ceil((stop - from) / width);
    const { min, max } = pyramid.query(from, width, count);
    const missing = this.clustersFor(channel.track, first, stop).filter((n) => !pyramid.done[n]);
    // The times of clusters that are not read yet do not count as gaps.
    const spans = missing.length ? withPending(pyramid.spans, missing, this.file.clusters, channel.track) : pyramid.spans;
    return { pyramid, result: this.envelopeOf({ ...view, width }, from, min, max, spans, missing.length === 0) };
  }

  clustersFor(track, first, stop) {
    return this.packets.clustersBetween(1000 * secondsAt(track, first), 1000 * secondsAt(track, stop));
  }

  pyramidOf(channel, band) {
    const key = `${channel.index} ${band}`;
    let pyramid = this.pyramids.get(key);
    if (!pyramid) {
      pyramid = new Pyramid(this.baseWidth(), isCounted(channel, band), this.file.clusters.length);
      pyramid.key = key;
      this.pyramids.set(key, pyramid);
    }
    pyramid.used = ++this.clock;
    return pyramid;
  }

  // As fine as the memory allows for all channels together.
  baseWidth() {
    let width = 8;
    const samples = [...this.extents.values()].reduce((sum, [first, stop]) => sum + stop - first, 0);
    while ((samples / width) * 12 > PYRAMID_BYTES && width < 2 ** 24) width *= 8;
    return width;
  }

  // Pyramids that were not used for long go where there are too many.
  shed(kept) {
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
    if (!this.working) this.work();
  }

  async work() {
    this.working = true;
    this.began = performance.now();
    try {
      while (!this.closed) {
        const { file } = this;
        const { parts, group } = this.nextClusters();
        if (!group.length) break;
        try {
          await this.build(group, parts);
        } catch (error) {
          await this.mend(error, file);
        }
      }
      if (!this.closed) this.tell('overview', { verdict: this.verdict });
    } catch (error) {
      this.tell('error', { error: { message: error.message, requirement: error.requirement ?? null, kind: error.kind ?? 'internal' } });
    } finally {
      this.working = false;
    }
  }

  // Lets requests come in between.
  async breathe() {
    if (performance.now() - this.began < SLICE_MS) return;
    this.tell('overview', { verdict: this.verdict });
    await pause();
    this.began = performance.now();
  }

  // Some clusters that are missing in a picture: of the times that are seen, then of all others.
  nextClusters() {
    this.shed(new Set(this.views.flatMap(({ parts }) => parts.map(({ pyramid }) => pyramid))));
    const all = this.file.clusters.map((_, n) => n);
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

  async build(numbers, wanted) {
    const { clusters } = this.file;
    const tracks = new Set(wanted.flatMap(({ channel }) => channel.parts.map(({ base }) => base.id)));
    if (!this.file.bytes && 4 * tracks.size >= this.file.tracks.size) {
      await this.source.readAll(numbers.map((n) => [clusters[n].offset, clusters[n].stop]));
    }
    const tables = await this.packets.tablesOf(numbers);
    for (let i = 0; i < numbers.length && !this.closed; i++) {
      await this.breathe();
      for (const { channel, band, pyramid } of wanted) {
        if (pyramid.done[numbers[i]]) continue;
        for (const { base, hf } of channel.parts) {
          const track = band === 'hf' ? hf : base;
          for (const { start, stop } of stretches(tables[i].get(track?.id) ?? [])) {
            const { values, spans } = await this.signals.numbers(channel, band, start, stop);
            pyramid.put(values, start, spans);
          }
        }
        pyramid.done[numbers[i]] = 1;
      }
    }
  }

  knots(index, t0, t1, { signal } = {}) {
    return this.guarded(async () => {
      const channel = this.channel(index);
      const [first, stop] = this.ticksOf(channel, t0, t1);
      if (stop - first > SAMPLE_BOUND) unsupported('LIM-003', `more than ${SAMPLE_BOUND} samples`, null);
      return knotsBetween(this.packets, channel, first, stop, signal);
    });
  }

  async events(t0, t1, { signal } = {}) {
    return this.guarded(async () => {
      this.eventList ??= await this.readEvents(signal);
      return this.eventList.filter(({ time, duration }) => time < t1 && (time >= t0 || time + duration > t0));
    });
  }

  // All events: one that still holds may have begun in any cluster.
  async readEvents(signal) {
    const layers = [...this.file.tracks.values()].filter((track) => track.kind === 'events' && !track.unsupported && track.setup);
    if (!layers.length) return [];
    const found = [];
    const numbers = this.file.clusters.map((_, n) => n);
    for (let at = 0; at < numbers.length; at += 256) {
      if (signal?.aborted) throw aborted();
      const tables = await this.packets.tablesOf(numbers.slice(at, at + 256), signal);
      for (const track of layers) {
        const packets = tables.flatMap((table) => table.get(track.id) ?? []);
        await this.packets.each(packets, signal, (packet, bytes) => this.takeEvents(track, packet, bytes, found));
      }
    }
    return found.sort((a, b) => a.time - b.time || a.layerTrack - b.layerTrack).map(({ layerTrack, ...event }) => event);
  }

  takeEvents(track, packet, bytes, found) {
    const { start, span, offset, size } = packet;
    try {
      for (const { tick, duration, channel, text } of decodeEvents(track, bytes, start, span, offset)) {
        if (found.length >= EVENT_BOUND) unsupported('LIM-003', `more than ${EVENT_BOUND} events`, offset);
        found.push({
          time: secondsAt(track, tick), duration: secondsAt(track, duration), text, label: text, channel,
          kind: track.labels[0], layer: track.labels[0], tick, layerTrack: track.id,
        });
      }
    } catch (error) {
      if (!(error instanceof HapfError) || error.requirement === 'LIM-003') throw error;
      this.fault({ track, start, stop: start + span, offset, size, error });
    }
  }

  async damage() {
    if (this.report) return this.report.damages;
    return [...(this.file.bytes ? damagesOf(this.file) : []), ...this.faults];
  }

  async verify(onProgress = () => {}, { signal } = {}) {
    const bytes = this.file.bytes ?? await readWhole(this.source, onProgress, signal);
    const file = verifyFile(bytes);
    const { verdict, damages, findings } = reportOf(file);
    this.report = { verdict, damages: damagesOf(file), findings: [...damages, ...findings] };
    this.tell('damage', { verdict });
    return { verdict, findings: this.report.findings };
  }

  async bytes(start, stop, { signal } = {}) {
    const { size } = this.source;
    const [from, to] = [start, stop].map((at) => Math.min(Math.max(Math.floor(at) || 0, 0), size));
    return (await this.source.read(from, Math.max(to, from), signal)).slice();
  }

  stats() {
    return {
      requests: this.source.requests, bytesFetched: this.source.fetched,
      samplesDecoded: this.signals.samplesDecoded, decodeMs: this.signals.decodeMs,
    };
  }

  close() {
    this.closed = true;
    this.pyramids.clear();
  }
}

function checkBand(band) {
  if (!['sum', 'lf', 'hf'].includes(band)) unsupported(null, `there is no band ${band}`, null);
}

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
    if (last && last.stop === start && last.stop - last.start < 2 ** 18) last.stop += span;
    else found.push({ start, stop: start + span });
  }
  return found;
}

// Spans with the times of clusters that were not read yet.
function withPending(spans, numbers, clusters, track) {
  const all = spans.map(([start, stop]) => [start, stop]);
  for (const n of numbers) {
    const { startMs, stopMs } = clusters[n];
    const tick = (ms) => (ms * track.rateNum) / track.rateDen / 1000;
    all.push([Math.floor(tick(startMs)), Math.ceil(tick(stopMs))]);
  }
  all.sort((a, b) => a[0] - b[0]);
  const merged = [];
  for (const [start, stop] of all) {
    const last = merged[merged.length - 1];
    if (last && start <= last[1]) last[1] = Math.max(last[1], stop);
    else merged.push([start, stop]);
  }
  return merged;
}
