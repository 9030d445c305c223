// Paths of signals in the pixels of a canvas. box: { left, top, width, height, t0, t1, low, high }.
import { inSight } from './signals.js';

const FAR = 1e6; // pixels; canvases lose what is farther away

export function mapping({ left, top, width, height, t0, t1, low, high }) {
  const perSecond = width / (t1 - t0);
  const perUnit = height / (high - low);
  return {
    x: (time) => left + (time - t0) * perSecond,
    y: (value) => {
      const y = top + (high - value) * perUnit;
      return y < -FAR ? -FAR : y > FAR ? FAR : y;
    },
  };
}

// A line through samples, broken where a value is missing.
export function linePath(time, values, box, offset) {
  const { x, y } = mapping(box);
  const path = new Path2D();
  const [from, to] = inSight(time, box.t0 - offset, box.t1 - offset);
  let open = false;
  for (let i = from; i < to; i++) {
    const value = values[i];
    if (value !== value) {
      open = false;
      continue;
    }
    const [px, py] = [x(time[i] + offset), y(value)];
    if (open) path.lineTo(px, py);
    else path.moveTo(px, py);
    const alone = !open && !(values[i + 1] === values[i + 1]);
    if (alone) path.lineTo(px + 1, py);
    open = true;
  }
  return path;
}

// An area between two lines, one part for each run without missing values. `thick` is for signals: the area is that
// many pixels higher than its values, and each bin reaches to the one before it.
export function bandPath(time, lower, upper, box, offset, thick = 0) {
  const { x, y } = mapping(box);
  const [above, below] = [-thick / 2, thick / 2];
  const top = (j, first) => y(thick && j > first ? Math.max(upper[j], lower[j - 1]) : upper[j]) + above;
  const bottom = (j, first) => y(thick && j > first ? Math.min(lower[j], upper[j - 1]) : lower[j]) + below;
  const path = new Path2D();
  const [from, to] = inSight(time, box.t0 - offset, box.t1 - offset);
  for (let i = from; i < to;) {
    if (lower[i] !== lower[i]) {
      i++;
      continue;
    }
    let stop = i;
    while (stop < to && lower[stop] === lower[stop]) stop++;
    for (let j = i; j < stop; j++) {
      const px = x(time[j] + offset);
      if (j === i) path.moveTo(stop === i + 1 ? px - 0.5 : px, top(j, i));
      else path.lineTo(px, top(j, i));
    }
    if (stop === i + 1) path.lineTo(x(time[i] + offset) + 0.5, top(i, i));
    for (let j = stop - 1; j >= i; j--) path.lineTo(x(time[j] + offset), bottom(j, i));
    path.closePath();
    i = stop;
  }
  return path;
}

export function squaresPath(time, values, box, offset, size) {
  const { x, y } = mapping(box);
  const path = new Path2D();
  const [from, to] = inSight(time, box.t0 - offset, box.t1 - offset);
  for (let i = from; i < to; i++) {
    if (values[i] === values[i]) path.rect(x(time[i] + offset) - size / 2, y(values[i]) - size / 2, size, size);
  }
  return path;
}

export function dotsPath(time, values, box, offset, radius) {
  const { x, y } = mapping(box);
  const path = new Path2D();
  const [from, to] = inSight(time, box.t0 - offset, box.t1 - offset);
  for (let i = from; i < to; i++) {
    if (values[i] !== values[i]) continue;
    const [px, py] = [x(time[i] + offset), y(values[i])];
    path.moveTo(px + radius, py);
    path.arc(px, py, radius, 0, 2 * Math.PI);
  }
  return path;
}

// Spans of time over the whole height; each at least a pixel wide.
export function spansPath(spans, box, offset) {
  const { x } = mapping(box);
  const path = new Path2D();
  for (const [start, stop] of spans) {
    const [from, to] = [Math.max(start + offset, box.t0), Math.min(stop + offset, box.t1)];
    if (from <= to) path.rect(x(from), box.top, Math.max(1, x(to) - x(from)), box.height);
  }
  return path;
}

// [low, high] of what is in sight, or null.
export function rangeInSight({ time, min, max }, t0, t1) {
  let low = Infinity;
  let high = -Infinity;
  const [from, to] = inSight(time, t0, t1);
  for (let i = from; i < to; i++) {
    if (min[i] < low) low = min[i];
    if (max[i] > high) high = max[i];
  }
  return low <= high && Number.isFinite(low) && Number.isFinite(high) ? [low, high] : null;
}

// Room around a range, so that a constant is a line in the middle.
export function padded([low, high]) {
  const largest = Math.max(Math.abs(low), Math.abs(high));
  const room = high - low > largest * 1e-12 ? (high - low) * 0.08 : largest * 0.1 || 1;
  const wide = [low - room, high + room];
  return wide.every(Number.isFinite) ? wide : [low / 2 - room / 2, high / 2 + room / 2].map((v) => Math.max(-1e308, Math.min(1e308, v)));
}
