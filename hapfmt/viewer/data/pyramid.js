// Least and largest numbers of a channel by 8 ticks, by 64 and so on, that grow cluster by cluster.

const FANOUT = 8;
const LEVELS = 5; // of a block: its bins, and by 8 fewer each up to one
const BINS = FANOUT ** (LEVELS - 1);
const STARTS = Array.from({ length: LEVELS }, (_, level) => {
  let start = 0;
  for (let l = 0; l < level; l++) start += FANOUT ** (LEVELS - 1 - l);
  return start;
});
const SIZE = STARTS[LEVELS - 1] + 1;

export class Pyramid {
  // width: ticks of the smallest bins.
  constructor(width, counted, clusterCount) {
    this.width = width;
    this.counted = counted;
    this.blockTicks = width * BINS;
    this.blocks = new Map(); // number -> { min, max }
    this.done = new Uint8Array(clusterCount);
    this.spans = []; // all that put() took, sorted
  }

  get weight() {
    return this.blocks.size * SIZE * (this.counted ? 8 : 16) + this.done.length + 64 * this.spans.length;
  }

  block(n) {
    let block = this.blocks.get(n);
    if (!block) {
      const Numbers = this.counted ? Int32Array : Float64Array;
      block = { min: new Numbers(SIZE).fill(this.counted ? 2 ** 31 - 1 : Infinity), max: new Numbers(SIZE).fill(this.counted ? -(2 ** 31) : -Infinity) };
      this.blocks.set(n, block);
    }
    return block;
  }

  // values[i] is the number of tick first + i; of each tick once.
  put(values, first, spans) {
    for (const [start, stop] of spans) {
      addSpan(this.spans, start, stop);
      for (let at = start; at < stop;) {
        const n = Math.floor(at / this.blockTicks);
        const end = Math.min(stop, (n + 1) * this.blockTicks);
        this.putBlock(this.block(n), values, at - first, at - n * this.blockTicks, end - at);
        at = end;
      }
    }
  }

  putBlock({ min, max }, values, from, tick, count) {
    const { width } = this;
    const firstBin = Math.floor(tick / width);
    const lastBin = Math.floor((tick + count - 1) / width);
    for (let bin = firstBin, i = 0; bin <= lastBin; bin++) {
      const stop = Math.min((bin + 1) * width - tick, count);
      let low = min[bin];
      let high = max[bin];
      for (; i < stop; i++) {
        const v = values[from + i];
        if (v < low) low = v;
        if (v > high) high = v;
      }
      min[bin] = low;
      max[bin] = high;
    }
    let [a, b] = [firstBin, lastBin];
    for (let level = 1; level < LEVELS; level++) {
      [a, b] = [Math.floor(a / FANOUT), Math.floor(b / FANOUT)];
      const below = STARTS[level - 1];
      const here = STARTS[level];
      for (let bin = a; bin <= b; bin++) {
        let low = min[here + bin];
        let high = max[here + bin];
        for (let i = below + bin * FANOUT; i < below + (bin + 1) * FANOUT; i++) {
          if (min[i] < low) low = min[i];
          if (max[i] > high) high = max[i];
        }
        min[here + bin] = low;
        max[here + bin] = high;
      }
    }
  }

  // The least and the largest of `count` bins of `width` ticks from tick `first` on; both are multiples of the
  // smallest width. NaN where there is nothing.
  query(first, width, count) {
    const min = new Float64Array(count).fill(NaN);
    const max = new Float64Array(count).fill(NaN);
    let level = 0;
    let ticks = this.width;
    while (level + 1 < LEVELS && width % (ticks * FANOUT) === 0 && first % (ticks * FANOUT) === 0) {
      level++;
      ticks *= FANOUT;
    }
    const inBlock = this.blockTicks / ticks;
    const start = STARTS[level];
    const stopTick = first + width * count;
    const each = (n) => {
      const block = this.blocks.get(n);
      if (!block) return;
      const from = Math.max(first, n * this.blockTicks);
      const to = Math.min(stopTick, (n + 1) * this.blockTicks);
      for (let tick = from, i = (from - n * this.blockTicks) / ticks; tick < to && i < inBlock; tick += ticks, i++) {
        const low = block.min[start + i];
        const high = block.max[start + i];
        if (!(low <= high)) continue;
        const bin = Math.floor((tick - first) / width);
        if (!(min[bin] <= low)) min[bin] = low;
        if (!(max[bin] >= high)) max[bin] = high;
      }
    };
    const [a, b] = [Math.floor(first / this.blockTicks), Math.floor((stopTick - 1) / this.blockTicks)];
    if (b - a < this.blocks.size) for (let n = a; n <= b; n++) each(n);
    else for (const n of this.blocks.keys()) if (n >= a && n <= b) each(n);
    return { min, max };
  }
}

// Adds a span to sorted spans that it does not overlap.
export function addSpan(spans, start, stop) {
  let [low, high] = [0, spans.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (spans[middle][0] < start) low = middle + 1;
    else high = middle;
  }
  const before = spans[low - 1];
  const after = spans[low];
  if (before && before[1] >= start) {
    before[1] = Math.max(before[1], stop);
    if (after && after[0] <= before[1]) {
      before[1] = Math.max(before[1], after[1]);
      spans.splice(low, 1);
    }
  } else if (after && after[0] <= stop) after[0] = start;
  else spans.splice(low, 0, [start, stop]);
}

// Those of sorted spans within a stretch; those closer than `near` to each other become one.
export function spansWithin(spans, first, stop, near = 0) {
  let [low, high] = [0, spans.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (spans[middle][1] <= first) low = middle + 1;
    else high = middle;
  }
  const found = [];
  for (let i = low; i < spans.length && spans[i][0] < stop; i++) {
    const start = Math.max(spans[i][0], first);
    const end = Math.min(spans[i][1], stop);
    const last = found[found.length - 1];
    if (last && start - last[1] <= near) last[1] = end;
    else found.push([start, end]);
  }
  return found;
}

// Ticks of a bin: the least of 1 to 7 times a power of 8 that is wide enough.
export function binWidth(ticks) {
  let unit = 1;
  while (unit * FANOUT <= ticks) unit *= FANOUT;
  const times = Math.max(Math.ceil(ticks / unit), 1);
  return times < FANOUT ? unit * times : unit * FANOUT;
}
