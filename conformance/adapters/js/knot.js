// KNOT (9.1), and the ticks between knots, which KNTE shares.
import { Reader } from './bytes.js';
import { broken } from './error.js';
import { clamp, floorDiv } from './integers.js';
import { limitsOf } from './limits.js';

const TICK_BOUND = 2 ** 24;

export function readInterpolation(reader, requirement) {
  const { offset } = reader;
  const interpolation = reader.u8();
  if (interpolation > 1) broken(requirement, `interpolation ${interpolation}`, offset);
  return interpolation;
}

export function parseKnot(reader, track) {
  const interpolation = readInterpolation(reader, 'KNT-001');
  const { offset } = reader;
  const quantum = reader.varint();
  if (quantum < 1 || quantum > limitsOf(track.level).stepBound) broken('KNT-001', `quantum ${quantum}`, offset);
  return { interpolation, quantum };
}

// Puts one clamped count at `n` ticks.
export function putHold(out, at, stride, n, count, low, high) {
  const value = clamp(count, low, high);
  for (let i = 0; i < n; i++, at += stride) out[at] = value;
}

// Puts the clamped counts of `n` ticks of the line from v0 to v1, `ticks` later. The quotient v0 + rdiv(dv * k, ticks)
// is added up, remainder and all: dv * k may pass 2^53 at level 2.
export function putLine(out, at, stride, n, v0, v1, ticks, low, high) {
  const whole = floorDiv(v1 - v0, ticks);
  const part = 2 * (v1 - v0 - whole * ticks);
  const full = 2 * ticks;
  let value = v0;
  let rest = ticks;
  for (let i = 0; i < n; i++, at += stride) {
    out[at] = value < low ? low : value > high ? high : value;
    value += whole;
    rest += part;
    if (rest >= full) {
      rest -= full;
      value++;
    }
  }
}

export function decodeKnot(track, bytes, span, out, offset) {
  const { componentCount: C, countMin: low, countMax: high } = track;
  const { interpolation, quantum } = track.setup;
  const bound = Math.floor(limitsOf(track.level).countBound / quantum);
  const reader = new Reader(bytes, { base: offset, requirement: 'KNT-002' });
  const from = new Float64Array(C); // the values of the knot before
  const to = new Float64Array(C);
  let tick = 0;

  const readValues = () => {
    for (let c = 0; c < C; c++) {
      const at = reader.offset;
      const value = from[c] + reader.svarint();
      if (Math.abs(value) > bound) broken('KNT-004', `a knot of value ${value}`, at);
      to[c] = value;
    }
  };

  readValues();
  from.set(to);
  while (reader.left > 0) {
    const at = reader.offset;
    if (interpolation === 1 && tick >= span - 1) broken('KNT-006', `a knot after that of tick ${tick}`, at);
    const ticks = reader.varint();
    if (ticks < 1) broken('KNT-003', 'two knots of one tick', at);
    const next = tick + ticks;
    if (interpolation === 0 && next >= span) broken('KNT-005', `a knot at tick ${next} of ${span}`, at);
    if (interpolation === 1 && next > TICK_BOUND) broken('KNT-006', `a knot at tick ${next}`, at);
    readValues();
    const n = Math.min(ticks, span - tick);
    for (let c = 0; c < C; c++) {
      const v0 = from[c] * quantum;
      if (interpolation === 0) putHold(out, tick * C + c, C, n, v0, low, high);
      else putLine(out, tick * C + c, C, n, v0, to[c] * quantum, ticks, low, high);
    }
    from.set(to);
    tick = next;
  }
  // What the last knot says of the ticks from its own on: all of them with hold, and with a single knot.
  if (interpolation === 1 && tick > 0 && tick < span - 1) {
    broken('KNT-006', `the last knot at tick ${tick} of ${span}`, reader.offset);
  }
  if (tick < span) for (let c = 0; c < C; c++) putHold(out, tick * C + c, C, span - tick, from[c] * quantum, low, high);
}
