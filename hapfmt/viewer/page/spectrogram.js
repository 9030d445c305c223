// How a spectrum changes in time: densities of segments in columns, in decibels.
import { Density, Segments } from './welch.js';

// The densities of `count` samples in at most `columns` columns. Where a column has several segments, it is their mean.
export class Spectrogram {
  constructor(length, rate, count, columns) {
    this.density = new Density(length, rate);
    this.step = Math.max(1, Math.min(length / 2, Math.floor((count - length) / Math.max(1, columns - 1))));
    this.columns = Math.max(1, Math.min(columns, Math.floor((count - length) / this.step) + 1));
    this.count = count;
    this.sums = new Float32Array(this.columns * this.density.bins);
    this.hits = new Uint32Array(this.columns);
    this.segments = new Segments(length, this.step, (values, first) => this.add(values, first));
  }

  push(values) {
    this.segments.push(values);
  }

  add(values, first) {
    const { density, columns, sums, hits, count } = this;
    const column = Math.min(columns - 1, Math.floor(((first + density.length / 2) / count) * columns));
    const found = density.of(values);
    const at = column * density.bins;
    for (let k = 0; k < found.length; k++) sums[at + k] += found[k];
    hits[column]++;
  }

  // Decibels of unit²/Hz; NaN where a column has no segment.
  level(column, bin) {
    const hits = this.hits[column];
    return hits ? 10 * Math.log10(this.sums[column * this.density.bins + bin] / hits) : NaN;
  }

  // The highest level, without that of frequency 0; -Infinity where there is none.
  highest() {
    let most = 0;
    for (let column = 0; column < this.columns; column++) {
      if (!this.hits[column]) continue;
      for (let bin = 1; bin < this.density.bins; bin++) most = Math.max(most, this.sums[column * this.density.bins + bin] / this.hits[column]);
    }
    return 10 * Math.log10(most);
  }
}

// From dark blue over grey to light yellow: lighter is more, which colour-blind people see as well.
const COLORS = [[13, 22, 66], [41, 56, 104], [84, 90, 112], [126, 124, 120], [172, 158, 110], [218, 196, 88], [253, 240, 160]];

// share: 0 to 1 -> [red, green, blue]
export function colorAt(share) {
  const place = Math.max(0, Math.min(1, share)) * (COLORS.length - 1);
  const low = Math.min(COLORS.length - 2, Math.floor(place));
  return COLORS[low].map((value, i) => Math.round(value + (place - low) * (COLORS[low + 1][i] - value)));
}

// The same colours as pixels of an image.
export const PIXELS = new Uint32Array(Uint8Array.from({ length: 1024 }, (_, i) => (i % 4 === 3 ? 255 : colorAt((i >> 2) / 255)[i % 4])).buffer);
