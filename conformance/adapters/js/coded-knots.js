// Adaptive coding of knots (9.6): gaps and differences.
import { Reader } from './bytes.js';
import { broken } from './error.js';
import { POWERS } from './integers.js';
import { putHold, putLine } from './lines.js';
import { RangeDecoder, bitModels } from './range.js';

const GAP_LENGTH = 24;
const DIFFERENCE_LENGTH = 34;

// The magnitude model of length n.
class MagnitudeModel {
  constructor(range, n) {
    this.range = range;
    this.n = n;
    this.L = bitModels(n + 1);
    this.H = bitModels(n + 1);
  }

  next() {
    const { range, L, H, n } = this;
    let b = 0;
    while (range.bit(L, b) === 1) {
      if (b === n) broken('KTE-003', `a magnitude of more than ${n} bits`, range.offset);
      b++;
    }
    if (b < 2) return b;
    return (2 + range.bit(H, b)) * POWERS[b - 2] + range.raw(b - 2);
  }
}

export function decodeCodedKnots(track, bytes, span, out, offset) {
  const { componentCount: C, countMin: low, countMax: high } = track;
  const { interpolation, grid } = track.setup;
  const { highest } = grid;
  const reader = new Reader(bytes, { base: offset });
  const index = new Float64Array(C);
  const from = new Float64Array(C); // counts of the knot before

  const checkIndex = (value) => {
    if (value > highest || value < -highest) broken('LPC-003', `index ${value} is not on the grid`, offset);
  };

  for (let c = 0; c < C; c++) {
    index[c] = reader.svarint();
    checkIndex(index[c]);
    from[c] = grid.count(index[c]);
  }
  let tick = 0;
  if (reader.left > 0) {
    const { offset: at } = reader;
    const f = reader.varint();
    if (f < 1 || f >= span) broken('KTE-002', `${f} more knots in ${span} ticks`, at);
    const range = new RangeDecoder(reader.bytes(reader.left), reader.offset);
    const gaps = new MagnitudeModel(range, GAP_LENGTH);
    const differences = new MagnitudeModel(range, DIFFERENCE_LENGTH);
    const S = bitModels(3);
    const signs = new Int8Array(C);
    for (let left = f - 1; left >= 0; left--) {
      const next = interpolation === 1 && left === 0 ? span - 1 : tick + 1 + gaps.next();
      if (next >= span - left) broken('KTE-004', `a knot at tick ${next} of ${span}, ${left} following`, at);
      const ticks = next - tick;
      for (let c = 0; c < C; c++) {
        let d = differences.next();
        if (d !== 0 && range.bit(S, signs[c] + 1) === 1) d = -d;
        signs[c] = Math.sign(d);
        index[c] += d;
        checkIndex(index[c]);
        const count = grid.count(index[c]);
        if (interpolation === 0) putHold(out, tick * C + c, C, ticks, from[c], low, high);
        else putLine(out, tick * C + c, C, ticks, from[c], count, ticks, low, high);
        from[c] = count;
      }
      tick = next;
    }
    range.finish();
  }
  for (let c = 0; c < C; c++) putHold(out, tick * C + c, C, span - tick, from[c], low, high);
}
