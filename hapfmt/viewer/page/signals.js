// What is drawn of each lane: envelopes of more than the view, so that the next pan has its picture already.
// A batch on its way is dropped only when the view has left it.

const MARGIN = 0.5; // of the view, on each side
const SINGLE = 400000; // no knots and no differences are asked for more samples
const BINS = 2 ** 21; // of all lanes

export class Signals {
  // wanted() -> lanes in sight; onData() after each answer.
  constructor(state, { wanted, width, onData }) {
    Object.assign(this, { state, wanted, width, onData });
    this.kept = new Map(); // lane key + band -> { t0, t1, bin, version, result }
    this.whole = new Map(); // the same of whole recordings
    this.batches = new Map(); // entry number + band -> batch on its way
  }

  get(lane, band) {
    return this.kept.get(`${lane.key} ${band}`)?.result ?? null;
  }

  getWhole(lane, band) {
    return this.whole.get(`${lane.key} ${band}`)?.result ?? null;
  }

  forget() {
    for (const { controller } of this.batches.values()) controller.abort();
    this.kept.clear();
    this.whole.clear();
    this.batches.clear();
  }

  get busy() {
    return this.batches.size > 0;
  }

  // Whether all that is in sight has come in full; only then is anything else asked for.
  get complete() {
    return !this.busy && this.wanted().every((lane) => this.state.bands.every((band) => this.get(lane, band)?.complete !== false));
  }

  // Asks for what the view lacks.
  refresh() {
    const bands = [...this.state.bands];
    if (this.state.knots) bands.push('knots');
    if (this.state.pairs && this.state.mode === 'stacked') bands.push('difference');
    const lacks = { knots: ({ channel }) => !channel.hasKnots, difference: ({ twin }) => !twin };
    const groups = new Map();
    for (const lane of this.wanted()) {
      for (const band of bands) {
        if (lacks[band]?.(lane) ?? !lane.channel.bands.includes(band)) continue;
        const key = `${lane.entry.number} ${band}`;
        if (!groups.has(key)) groups.set(key, { entry: lane.entry, band, lanes: [] });
        groups.get(key).lanes.push(lane);
      }
    }
    for (const [key, group] of groups) this.refreshGroup(key, group);
  }

  // The whole of one lane, for the strip.
  refreshWhole(lane, bins) {
    const key = `${lane.key} sum`;
    const version = lane.entry.version ?? 0;
    if (this.whole.get(key)?.version === version || this.batches.has(`whole ${key}`)) return;
    const { start: t0, stop: t1 } = lane.entry.recording;
    if (!(t0 < t1)) return;
    this.fetch(`whole ${key}`, { entry: lane.entry, band: 'sum', lanes: [lane], t0, t1, bin: (t1 - t0) / bins, version, forStrip: true });
  }

  refreshGroup(key, { entry, band, lanes }) {
    const { recording, offset } = entry;
    const a = Math.max(recording.start, this.state.t0 - offset);
    const b = Math.min(recording.stop, this.state.t1 - offset);
    if (!(a < b)) return;
    const span = this.state.t1 - this.state.t0;
    let bin = 2 ** Math.round(Math.log2(span / this.width())); // about a pixel
    while ((2 * span * lanes.length) / bin > BINS) bin *= 2;
    const enough = (one) => one && one.t0 <= a && one.t1 >= b && one.bin <= bin * 1.01 && one.version === (entry.version ?? 0);
    const lacking = lanes.filter((lane) => !enough(this.kept.get(`${lane.key} ${band}`)));
    if (!lacking.length) return;
    const running = this.batches.get(key);
    if (running) {
      const useful = running.t0 < b && running.t1 > a && running.bin <= bin * 4 && running.bin >= bin / 4;
      if (useful) return; // it is looked at again when it has come
      running.controller.abort();
    }
    const margin = span * MARGIN + 2 / Math.min(...lacking.map(({ rate }) => rate)); // a line needs the samples next to the view
    const t0 = Math.max(recording.start, Math.floor((a - margin) / bin) * bin);
    const t1 = Math.min(recording.stop, Math.ceil((b + margin) / bin) * bin);
    this.fetch(key, { entry, band, lanes: lacking, t0, t1, bin, version: entry.version ?? 0 });
  }

  async fetch(key, batch) {
    const { entry, band, lanes, t0, t1, bin } = batch;
    batch.controller = new AbortController();
    this.batches.set(key, batch);
    try {
      const { signal } = batch.controller;
      const indexes = lanes.map(({ index }) => index);
      const bins = Math.max(1, Math.round((t1 - t0) / bin));
      const results = band === 'knots' ? await this.knots(entry, lanes, t0, t1, signal)
        : band === 'difference' ? await this.differences(lanes, t0, t1, bin, signal)
        : await entry.recording.envelope(indexes, t0, t1, bins, band, { signal });
      if (!signal.aborted) for (const lane of lanes) this.keep(lane, batch, results[lane.index]);
    } catch (error) {
      if (!batch.controller.signal.aborted) {
        for (const lane of lanes) this.keep(lane, batch, { kind: 'failed', message: error.message, time: [], min: [], max: [], gaps: [] });
      }
    }
    if (this.batches.get(key) === batch) this.batches.delete(key);
    this.onData();
  }

  async knots(entry, lanes, t0, t1, signal) {
    const results = {};
    for (const { index, rate } of lanes) {
      if ((t1 - t0) * rate > SINGLE) continue;
      results[index] = await entry.recording.knots(index, t0, t1, { signal });
    }
    return results;
  }

  // What each lane has more than the first version of it.
  async differences(lanes, t0, t1, bin, signal) {
    const results = {};
    for (const { index, rate, entry, twin } of lanes) {
      if ((t1 - t0) * rate > SINGLE) continue;
      const shift = entry.offset - twin.entry.offset;
      const [own, first] = await Promise.all([
        entry.recording.samples(index, t0, t1, 'sum', { signal }), twin.entry.recording.samples(twin.index, t0 + shift, t1 + shift, 'sum', { signal }),
      ]);
      results[index] = differenceOf(own, first, rate, shift, bin);
    }
    return results;
  }

  keep(lane, batch, result) {
    if (!result) result = { kind: 'none', time: [], min: [], max: [], gaps: [] };
    const { recording } = lane.entry;
    const key = `${lane.key} ${batch.band}`;
    const one = { ...batch, lanes: null, result };
    if (!batch.forStrip) this.kept.set(key, one);
    if (batch.t0 <= recording.start && batch.t1 >= recording.stop) this.whole.set(key, one);
  }
}

// own, first: { time, value } of one rate. -> envelope of own − first, in bins of `bin` seconds.
export function differenceOf(own, first, rate, shift, bin) {
  const { time } = own;
  const later = first.time.length ? Math.round(time[0] * rate) - Math.round((first.time[0] - shift) * rate) : 0;
  const value = Float64Array.from(own.value, (one, i) => one - (first.value[i + later] ?? NaN));
  const step = Math.max(1, Math.floor(bin * rate));
  if (step === 1) return { kind: 'samples', time, min: value, max: value, gaps: [], complete: true };
  const count = Math.ceil(value.length / step);
  const [min, max] = [new Float64Array(count).fill(NaN), new Float64Array(count).fill(NaN)];
  value.forEach((one, i) => {
    const k = Math.floor(i / step);
    if (!(min[k] <= one) && one === one) min[k] = one;
    if (!(max[k] >= one) && one === one) max[k] = one;
  });
  return { kind: 'envelope', time: Float64Array.from(min, (_, k) => time[k * step] + (step - 1) / 2 / rate), min, max, gaps: [], complete: true };
}

// First index of a sorted array whose value is not below x.
export function lowerBound(values, x) {
  let low = 0;
  let high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < x) low = middle + 1;
    else high = middle;
  }
  return low;
}

// [from, to): what of `time` is in sight, and one more on each side.
export function inSight(time, t0, t1) {
  return [Math.max(0, lowerBound(time, t0) - 1), Math.min(time.length, lowerBound(time, t1) + 1)];
}
