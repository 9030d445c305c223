// The grids of 9.5: the counts of the indices. LPCR and KNOT share them.
import { broken } from './error.js';
import { clamp } from './integers.js';
import { limitsOf } from './limits.js';

const ZERO_BOUND = 2 ** 31;

export function readGrid(reader, level) {
  const limits = limitsOf(level);
  const { offset } = reader;
  const form = reader.u8();
  if (form > 1) broken('LPC-002', `grid ${form}`, offset);
  const step = reader.varint();
  if (step > limits.stepBound || (form === 0 && step < 1)) broken('LPC-002', `step ${step}`, offset);
  const zero = reader.svarint();
  if (zero < -ZERO_BOUND || zero >= ZERO_BOUND) broken('LPC-002', `zero ${zero}`, offset);
  if (form === 0) return new UniformGrid(step, zero, limits.countBound);
  const kn = reader.varint();
  const kd = reader.varint();
  if (kn < 1 || kn >= 65536 || kd < 1 || kd >= 65536 || kd > 1024 * kn) {
    broken('LPC-002', `Weber fraction ${kn}/${kd}`, offset);
  }
  return new DeadbandGrid(step, zero, kn, kd, limits.countBound);
}

export class UniformGrid {
  constructor(step, zero, bound) {
    this.step = step;
    this.zero = zero;
    this.highest = Math.floor(bound / step); // the largest magnitude of an index (LPC-003)
  }

  count(index) {
    return this.zero + index * this.step;
  }

  // Puts the clamped counts of `indices` at out[at], out[at + stride], ...
  put(indices, length, out, at, stride, low, high) {
    const { step, zero } = this;
    for (let i = 0; i < length; i++, at += stride) out[at] = clamp(zero + indices[i] * step, low, high);
  }
}

// A table may have thousands of levels, and a file as many tracks as it likes: few tables are kept.
const tables = new Map();
const TABLES_KEPT = 16;

function levelsOf(step, kn, kd, bound) {
  const key = `${step} ${kn} ${kd} ${bound}`;
  let levels = tables.get(key);
  if (levels) return levels;
  levels = [0];
  for (let y = 0; kn < kd;) {
    const top = Math.max(y + step, Math.floor((y * kd) / (kd - kn)));
    if (top >= bound) break;
    const c = top + 1;
    y = c + Math.max(Math.floor((kn * c) / kd), step);
    levels.push(y);
  }
  levels = Float64Array.from(levels);
  if (tables.size >= TABLES_KEPT) tables.delete(tables.keys().next().value);
  tables.set(key, levels);
  return levels;
}

export class DeadbandGrid {
  constructor(step, zero, kn, kd, bound) {
    this.step = step;
    this.zero = zero;
    this.kn = kn;
    this.kd = kd;
    this.bound = bound;
  }

  get levels() { // y(0) ... y(N)
    return levelsOf(this.step, this.kn, this.kd, this.bound);
  }

  get highest() { // N
    return this.levels.length - 1;
  }

  count(index) {
    const { levels } = this;
    return this.zero + (index < 0 ? -levels[-index] : levels[index]);
  }

  put(indices, length, out, at, stride, low, high) {
    const { levels, zero } = this;
    for (let i = 0; i < length; i++, at += stride) {
      const index = indices[i];
      out[at] = clamp(zero + (index < 0 ? -levels[-index] : levels[index]), low, high);
    }
  }
}
