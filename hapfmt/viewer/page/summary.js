// Statistics of values that come in parts. Blocks are combined after Chan, Golub and LeVeque (1979). All but the power
// is computed from the distance to the first value, which loses fewer digits.

const BLOCK = 512;

export class Summary {
  constructor() {
    Object.assign(this, { count: 0, missing: 0, min: Infinity, max: -Infinity, mean: 0, squares: 0, power: 0, origin: 0 });
  }

  push(values) {
    for (let at = 0; at < values.length; at += BLOCK) this.pushBlock(values, at, Math.min(at + BLOCK, values.length));
  }

  pushBlock(values, from, to) {
    let count = 0;
    let sum = 0;
    let power = 0;
    for (let i = from; i < to; i++) {
      const value = values[i];
      if (value !== value) continue;
      if (!count && !this.count) this.origin = Number.isFinite(value) ? value : 0;
      count++;
      sum += value - this.origin;
      power += value * value;
      if (value < this.min) this.min = value;
      if (value > this.max) this.max = value;
    }
    this.missing += to - from - count;
    if (!count) return;
    const mean = sum / count;
    let squares = 0; // of deviations from the mean
    for (let i = from; i < to; i++) if (values[i] === values[i]) squares += (values[i] - this.origin - mean) ** 2;
    const total = this.count + count;
    const difference = mean - this.mean;
    if (this.count) {
      this.squares += squares + difference * difference * ((this.count * count) / total);
      this.mean += (difference * count) / total;
    } else {
      [this.squares, this.mean] = [squares, mean];
    }
    this.power += power;
    this.count = total;
  }

  // The standard deviation divides by the count.
  result() {
    const { count, missing, min, max, squares, power } = this;
    if (!count) return { count, missing, min: NaN, max: NaN, mean: NaN, sd: NaN, rms: NaN, peakToPeak: NaN };
    const mean = this.origin + this.mean;
    return { count, missing, min, max, mean, sd: Math.sqrt(squares / count), rms: Math.sqrt(power / count), peakToPeak: max - min };
  }
}
