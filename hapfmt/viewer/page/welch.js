// Power spectral density after Welch (1967): Hann windows that overlap by half, each without its mean, density in
// unit²/Hz. Segments have no missing sample.
import { Fft } from './fft.js';

export const SHORTEST = 16;
const LONGEST = 65536;

export const LENGTHS = [64, 256, 1024, 4096, 16384, 65536];

// The length of a segment for a number of samples. It gives about eight segments, or more.
export function lengthFor(count) {
  const length = 2 ** Math.floor(Math.log2(Math.max(1, count / 4)));
  return Math.max(SHORTEST, Math.min(4096, LONGEST, length));
}

// Takes values one after the other; calls segment(values, number of the first) for each whole one.
export class Segments {
  constructor(length, step, segment) {
    Object.assign(this, { length, step, segment });
    this.kept = new Float64Array(length);
    this.count = 0;
    this.number = 0; // of the next value
  }

  push(values) {
    const { kept, length, step } = this;
    for (let i = 0; i < values.length; i++) {
      this.number++;
      if (!Number.isFinite(values[i])) {
        this.count = 0;
        continue;
      }
      kept[this.count++] = values[i];
      if (this.count < length) continue;
      this.segment(kept, this.number - length);
      kept.copyWithin(0, step);
      this.count -= step;
    }
  }
}

// The density of single segments.
export class Density {
  constructor(length, rate) {
    this.length = length;
    this.rate = rate;
    this.fft = new Fft(length);
    this.window = Float64Array.from({ length }, (_, i) => 0.5 - 0.5 * Math.cos((2 * Math.PI * i) / length));
    this.scale = 1 / (rate * this.window.reduce((sum, w) => sum + w * w, 0));
    this.windowed = new Float64Array(length);
    this.bins = length / 2 + 1;
    this.found = new Float64Array(this.bins);
  }

  get frequency() {
    return Float64Array.from({ length: this.bins }, (_, k) => (k * this.rate) / this.length);
  }

  // -> unit²/Hz of each frequency; valid until the next call.
  of(values) {
    const { length, window, windowed, found, scale } = this;
    let sum = 0;
    for (let i = 0; i < length; i++) sum += values[i];
    const mean = sum / length;
    for (let i = 0; i < length; i++) windowed[i] = (values[i] - mean) * window[i];
    this.fft.power(windowed, found);
    for (let k = 0; k < found.length; k++) found[k] *= k > 0 && k < found.length - 1 ? 2 * scale : scale;
    return found;
  }
}

export class Welch {
  constructor(length, rate) {
    this.density = new Density(length, rate);
    this.sum = new Float64Array(this.density.bins);
    this.count = 0;
    this.segments = new Segments(length, length / 2, (values) => {
      const found = this.density.of(values);
      for (let k = 0; k < found.length; k++) this.sum[k] += found[k];
      this.count++;
    });
  }

  push(values) {
    this.segments.push(values);
  }

  // -> { frequency, density, segments }; null where no segment was whole.
  result() {
    if (!this.count) return null;
    return { frequency: this.density.frequency, density: this.sum.map((one) => one / this.count), segments: this.count };
  }
}
