// The ticks between knots (9.1), held or on a line.
import { clamp, floorDiv } from './integers.js';

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
