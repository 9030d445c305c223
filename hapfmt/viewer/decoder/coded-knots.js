// Entropy coding of knots (9.6): gaps and differences.
import { Reader } from './bytes.js';
import { EntropyDecoder } from './entropy.js';
import { broken } from './error.js';
import { putHold, putLine } from './lines.js';

export function decodeCodedKnots(track, bytes, span, out, offset, onKnot) {
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
  onKnot(tick, from);
  if (reader.left > 0) {
    const { offset: at } = reader;
    const f = reader.varint();
    if (f < 1 || f >= span) broken('KTE-004', `${f} more knots in ${span} ticks`, at);
    const coder = new EntropyDecoder(reader.bytes(reader.left), reader.offset, 1);
    const gaps = new Float64Array(interpolation === 1 ? f - 1 : f);
    const differences = new Float64Array(f * C);
    coder.byBits(gaps.length, false, gaps);
    coder.byBits(f * C, true, differences);
    coder.finish();
    for (let left = f - 1; left >= 0; left--) {
      const next = interpolation === 1 && left === 0 ? span - 1 : tick + 1 + gaps[f - 1 - left];
      if (next >= span - left) broken('KTE-004', `a knot at tick ${next} of ${span}, ${left} following`, at);
      const ticks = next - tick;
      for (let c = 0; c < C; c++) {
        index[c] += differences[c * f + f - 1 - left];
        checkIndex(index[c]);
        const count = grid.count(index[c]);
        if (interpolation === 0) putHold(out, tick * C + c, C, ticks, from[c], low, high);
        else putLine(out, tick * C + c, C, ticks, from[c], count, ticks, low, high);
        from[c] = count;
      }
      tick = next;
      onKnot(tick, from);
    }
  }
  for (let c = 0; c < C; c++) putHold(out, tick * C + c, C, span - tick, from[c], low, high);
}
