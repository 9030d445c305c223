// LPCR (9.5): indices of a grid, predicted from those before them and from other components.
import { Reader } from './bytes.js';
import { EntropyDecoder, readProbabilities, readStart } from './entropy.js';
import { broken } from './error.js';
import { readGrid } from './grid.js';
import { isQuick, predictExact, predictorOf, predictQuick, sumFour, tapsOf } from './predictor.js';

const ORDER_BOUND = 32;
const BY_BITS = 64;

// Arrays that packets use one after the other: e, y and the indices. Large ones are not kept.
const SCRATCH_SIZE = 2 ** 16;
const E = 0;
const Y = 1;
const INDEX = 2;
const kept = [];

// An array with any contents.
function scratch(place, length) {
  if (length > SCRATCH_SIZE) return new Float64Array(length);
  kept[place] ??= new Float64Array(SCRATCH_SIZE);
  return kept[place].subarray(0, length);
}

export function parseLpcr(reader, track) {
  return { grid: readGrid(reader, track.level) };
}

function readComponentHeader(reader, component) {
  const start = reader.offset;
  reader.requirement = 'LPC-006';
  const flags = reader.u8();
  const header = {
    g: flags & 7, repeats: (flags & 8) !== 0, constant: (flags & 16) !== 0,
    k: [], references: [], base: 0,
  };
  const m = reader.u8();
  if (header.g > 4 || m > ORDER_BOUND || (m > 0 && header.g > 1)) {
    broken('LPC-004', `difference order ${header.g}, prediction order ${m}`, start);
  }
  if (header.constant && (flags !== 16 || m > 0)) broken('LPC-004', 'a constant with other flags', start);
  if (flags & 0xa0) broken('LPC-004', `flags ${flags}`, start);
  for (let i = 0; i < m; i++) {
    header.k.push(reader.i8());
    if (header.k[i] < -127) broken('LPC-004', 'a reflection coefficient of -128', reader.offset - 1);
  }
  if (flags & 64) {
    reader.requirement = 'LPC-006';
    const { offset } = reader;
    const r = reader.u8();
    if (r < 1 || r > 8) broken('LPC-007', `${r} references`, offset);
    for (let i = 0, before = -1; i < r; i++) {
      const a = reader.u8();
      if (a <= before || a >= component) broken('LPC-007', `component ${component} refers to ${a}`, reader.offset - 1);
      header.references.push({ a, w: [reader.i8(), reader.i8(), reader.i8()] });
      before = a;
    }
  }
  reader.requirement = 'COD-001';
  header.base = reader.svarint();
  return header;
}

// e of every tick, and where the index is that of the tick before.
function decodeErrors(header, bytes, span, offset, e, repeated) {
  const reader = new Reader(bytes, { base: offset, requirement: 'RNG-004' });
  const coding = reader.u8();
  if (coding > BY_BITS) broken('RNG-004', `the coding ${coding}`, offset);
  const start = coding === BY_BITS ? 0 : readStart(reader);
  const repeats = header.repeats ? readProbabilities(reader, 4) : null;
  const signs = coding & 32 ? readProbabilities(reader, 3) : null;
  const coder = new EntropyDecoder(reader.bytes(reader.left), reader.offset, coding & 16 ? 4 : 1);
  const fresh = repeats ? coder.repeats(span, repeats, repeated) : span;
  const errors = e.subarray(span - fresh);
  if (coding === BY_BITS) coder.byBits(fresh, true, errors);
  else coder.integers(fresh, coding & 15, start, signs === null, errors);
  if (signs) coder.signs(fresh, signs, errors);
  coder.finish();
  if (repeats) for (let t = 0, i = 0; t < span; t++) if (repeated[t] === 0) e[t] = errors[i++];
}

// x[t] of clause 9.5, References, added to e[t].
function addReferences(references, indices, span, g, c, highest, e) {
  const d = new Float64Array(span + 2); // d[t] at t + 1
  const upper = new Float64Array(span);
  const lower = new Float64Array(span);
  for (const { a, w: [w0, w1, w2] } of references) {
    putResiduals(indices[a], span, g, c, highest, d);
    // The sum of 24 products may pass 2^53 at level 2: d in two parts, the upper ones whole after the division.
    let h0 = 0;
    let l0 = 0;
    let h1 = Math.floor(d[1] / 1048576);
    let l1 = d[1] - h1 * 1048576;
    for (let t = 0; t < span; t++) {
      const h2 = Math.floor(d[t + 2] / 1048576);
      const l2 = d[t + 2] - h2 * 1048576;
      upper[t] += w0 * h0 + w1 * h1 + w2 * h2;
      lower[t] += w0 * l0 + w1 * l1 + w2 * l2;
      h0 = h1;
      l0 = l1;
      h1 = h2;
      l1 = l2;
    }
  }
  for (let t = 0; t < span; t++) e[t] += upper[t] * 16384 + Math.floor((lower[t] + 32) / 64);
}

// d[t] = y[t] - pred[t] of a reference at d[t + 1].
function putResiduals(index, span, g, c, highest, d) {
  const taps = tapsOf(c);
  const { width } = taps;
  const y = scratch(Y, span + width).fill(0, 0, width);
  for (let t = 0; t < span; t++) y[t + width] = index[t] - index[0];
  for (let i = 0; i < g; i++) for (let t = span - 1; t > 0; t--) y[t + width] -= y[t + width - 1];
  if (width === 0) {
    d.set(y, 1);
    return;
  }
  const quick = isQuick(c, g, highest);
  const stop = quick ? span - (span % 4) : 0;
  const c1 = taps.r[width + 2];
  const c2 = taps.r[width + 1];
  const c3 = taps.r[width];
  const sums = new Float64Array(4);
  for (let t = 0; t < stop; t += 4) {
    sumFour(taps, y, t, sums);
    const y0 = y[t + width];
    const y1 = y[t + width + 1];
    const y2 = y[t + width + 2];
    d[t + 1] = y0 - Math.floor(sums[0] * (1 / 8192));
    d[t + 2] = y1 - Math.floor((sums[1] + c1 * y0) * (1 / 8192));
    d[t + 3] = y2 - Math.floor((sums[2] + c2 * y0 + c1 * y1) * (1 / 8192));
    d[t + 4] = y[t + width + 3] - Math.floor((sums[3] + (c3 * y0 + c2 * y1) + c1 * y2) * (1 / 8192));
  }
  const ahead = taps.r.subarray(3);
  for (let t = stop; t < span; t++) d[t + 1] = y[t + width] - (quick ? predictQuick : predictExact)(ahead, width, y, t);
}

function checkIndex(index, highest, offset) {
  if (index > highest || index < -highest) broken('LPC-003', `index ${index} is not on the grid`, offset);
}

// From prediction errors to indices: y[t] = pred + e[t], added up g times.
function integrate(header, c, e, repeated, span, highest, offset, out) {
  const { g, base } = header;
  const taps = tapsOf(c);
  const { r, width } = taps;
  const y = scratch(Y, span + width).fill(0, 0, width);
  const D = new Float64Array(5); // the differences 0 to g of the tick before
  const quick = isQuick(c, g, highest);
  const ahead = r.subarray(3);
  const start = quick && width > 0 && repeated === null ? integrateFours(header, taps, e, y, span, highest, offset, out) : 0;
  if (start > 0) {
    D[0] = out[start - 1] - base;
    D[1] = y[start - 1 + width];
  }
  for (let t = start; t < span; t++) {
    let v;
    if (repeated !== null && repeated[t] === 1) {
      v = D[0];
      for (let i = 0; i < g; i++) {
        const difference = v - D[i];
        D[i] = v;
        v = difference;
      }
    } else {
      v = e[t];
      if (width > 0) v += quick ? predictQuick(ahead, width, y, t) : predictExact(ahead, width, y, t);
      D[g] = v;
      for (let i = g - 1; i >= 0; i--) D[i] += D[i + 1];
    }
    y[t + width] = v;
    const index = base + D[0];
    if (index > highest || index < -highest) checkIndex(index, highest, offset);
    out[t] = index;
  }
}

// The same for as many fours of ticks as there are, without repeats, where all sums are exact; how many ticks.
function integrateFours({ g, base }, taps, e, y, span, highest, offset, out) {
  const { r, width } = taps;
  const c1 = r[width + 2];
  const c2 = r[width + 1];
  const c3 = r[width];
  const sums = new Float64Array(4);
  const stop = span - (span % 4);
  let index = base;
  for (let t = 0; t < stop; t += 4) {
    sumFour(taps, y, t, sums);
    const y0 = e[t] + Math.floor(sums[0] * (1 / 8192));
    const y1 = e[t + 1] + Math.floor((sums[1] + c1 * y0) * (1 / 8192));
    const y2 = e[t + 2] + Math.floor((sums[2] + c2 * y0 + c1 * y1) * (1 / 8192));
    const y3 = e[t + 3] + Math.floor((sums[3] + (c3 * y0 + c2 * y1) + c1 * y2) * (1 / 8192));
    y[t + width] = y0;
    y[t + width + 1] = y1;
    y[t + width + 2] = y2;
    y[t + width + 3] = y3;
    const i0 = (g === 1 ? index : base) + y0;
    const i1 = (g === 1 ? i0 : base) + y1;
    const i2 = (g === 1 ? i1 : base) + y2;
    const i3 = (g === 1 ? i2 : base) + y3;
    index = i3;
    out[t] = i0;
    out[t + 1] = i1;
    out[t + 2] = i2;
    out[t + 3] = i3;
    if (Math.max(i0, i1, i2, i3) > highest || Math.min(i0, i1, i2, i3) < -highest) {
      for (let i = t; i < t + 4; i++) checkIndex(out[i], highest, offset);
    }
  }
  return stop;
}

function decodeComponent(header, coded, offset, indices, span, highest, index) {
  checkIndex(header.base, highest, offset);
  const c = predictorOf(header.k, offset);
  if (header.constant) {
    if (coded.length > 0) broken('COD-001', 'bytes after a constant', offset);
    index.fill(header.base);
    return;
  }
  const e = scratch(E, span);
  const repeated = header.repeats ? new Uint8Array(span) : null;
  decodeErrors(header, coded, span, offset, e, repeated);
  if (header.references.length > 0) addReferences(header.references, indices, span, header.g, c, highest, e);
  integrate(header, c, e, repeated, span, highest, offset, index);
}

// The component packets of a packet: their bytes and where they begin.
export function splitComponents(bytes, componentCount, offset, requirement = 'LPC-001') {
  const reader = new Reader(bytes, { base: offset, requirement });
  const sizes = [];
  let sum = 0;
  for (let i = 1; i < componentCount; i++) {
    const size = reader.varint();
    sum += size;
    if (sum > bytes.length) broken(requirement, 'component packets larger than the packet', reader.offset);
    sizes.push(size);
  }
  if (sum > reader.left) broken(requirement, 'component packets larger than the packet', reader.offset);
  sizes.push(reader.left - sum);
  return sizes.map((size) => ({ offset: reader.offset, bytes: reader.bytes(size) }));
}

// Calls put(component, index) with the indices of one component after the other.
export function decodeIndices(grid, componentCount, bytes, span, offset, put) {
  const { highest } = grid;
  const parts = splitComponents(bytes, componentCount, offset).map((part, component) => {
    const reader = new Reader(part.bytes, { base: part.offset });
    const header = readComponentHeader(reader, component);
    return { header, offset: reader.offset, coded: reader.bytes(reader.left) };
  });
  // Kept are the indices of components that another one refers to; the others share one array.
  const referred = new Set(parts.flatMap(({ header }) => header.references.map(({ a }) => a)));
  const indices = [];
  let shared = null;
  parts.forEach(({ header, offset: at, coded }, component) => {
    let index;
    if (referred.has(component)) index = indices[component] = new Float64Array(span);
    else index = shared ??= scratch(INDEX, span);
    decodeComponent(header, coded, at, indices, span, highest, index);
    put(component, index);
  });
}

export function decodeLpcr(track, bytes, span, out, offset) {
  const { componentCount: C, countMin: low, countMax: high } = track;
  const { grid } = track.setup;
  decodeIndices(grid, C, bytes, span, offset, (c, index) => grid.put(index, span, out, c, C, low, high));
}
