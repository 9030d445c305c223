// One file that is looked at, and the answers to what the page asks for. It runs in a Worker.
import { decodeEvents } from '../decoder/codecs.js';
import { HapfError, unsupported } from '../decoder/error.js';
import { FalseIndex, openByIndex } from './byindex.js';
import { readWhole, walkFile } from './bywalk.js';
import { damagesOf, faultOf } from './damages.js';
import { describe } from './describe.js';
import { knotsBetween } from './knots.js';
import { findOverview } from './overview.js';
import { Packets } from './packets.js';
import { Pictures } from './pictures.js';
import { Signals, channelsOf, physical } from './signals.js';
import { aborted, openSource } from './sources.js';
import { gapsBetween, secondsAt, secondsBetween, tickAt } from './ticks.js';

const SAMPLE_BOUND = 2e7; // of one request
const BIN_BOUND = 2 ** 22; // channels times bins
const FAULT_BOUND = 2 ** 16;
const EVENT_BOUND = 2 ** 20;

export class Session {
  // tell(what, facts): called when something progressed.
  constructor(source, tell) {
    this.source = source;
    this.tell = tell;
    this.file = null;
    this.faults = [];
    this.report = null;
    this.busy = 0; // requests that are being answered
    this.overview = null;
    this.closed = false;
  }

  static async open(source, tell = () => {}) {
    const session = new Session(await openSource(source), tell);
    const file = await openByIndex(session.source);
    if (file) {
      session.use(file);
      session.overview = await findOverview(session.source, file);
    } else {
      await session.walk();
    }
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
    this.eventList = null;
    this.pictures?.close();
    this.pictures = new Pictures(this);
  }

  // The whole file, since its index is missing or does not hold.
  async walk() {
    const bytes = await readWhole(this.source, (done, size) => this.tell('progress', { done, size }));
    this.overview = null;
    try {
      this.use(walkFile(bytes));
    } catch (error) {
      error.size = bytes.length; // an empty file has its own sentence
      throw error;
    }
  }

  // Does something by the index, and again by a walk where the index does not hold.
  async guarded(action) {
    const { file } = this;
    this.busy++;
    try {
      return await action();
    } catch (error) {
      await this.mend(error, file);
      return await action();
    } finally {
      this.busy--;
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
    return this.guarded(() => {
      checkBand(band);
      if (!(bins >= 1) || indexes.length * bins > BIN_BOUND) unsupported('LIM-003', 'more bins than this reader makes', null);
      return this.pictures.envelope(indexes.map((index) => this.channel(index)), t0, t1, Math.floor(bins), band, signal);
    });
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
    for await (const table of this.packets.tablesOf(this.file.clusters.map((_, n) => n), signal)) {
      if (signal?.aborted) throw aborted();
      for (const track of layers) {
        await this.packets.each(table.get(track.id) ?? [], signal, (packet, bytes) => this.takeEvents(track, packet, bytes, found));
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
    const found = this.report?.damages ?? [...(this.file.bytes ? damagesOf(this.file) : []), ...this.faults];
    // An unknown end is that of the recording.
    return found.map((one) => (one.time0 !== null && one.time1 === null ? { ...one, time1: Math.max(this.facts.stop, one.time0) } : one));
  }

  // What a check of the whole file found (check.js).
  learn({ verdict, damages, findings }) {
    this.report = { verdict, damages, findings };
    this.tell('damage', { verdict });
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
    this.pictures?.close();
  }
}

function checkBand(band) {
  if (!['sum', 'lf', 'hf'].includes(band)) unsupported(null, `there is no band ${band}`, null);
}
