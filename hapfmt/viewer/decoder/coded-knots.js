// Entropy coding of knots (9.6): gaps and differences.
import { Reader } from './bytes.js';
import { EntropyDecoder, readLengths, readProbabilities, readStart } from './entropy.js';
import { broken } from './error.js';
import { putHold, putLine } from './lines.js';

const LENGTHS = 35;

// How a row of numbers is coded; `meaning`: the bits that its coding may have.
function readRow(reader, meaning) {
  reader.requirement = 'RNG-004';
  const { offset } = reader;
  const coding = reader.u8();
  if (coding & ~meaning) broken('RNG-004', `the coding ${coding}`, offset);
  if (!(coding & 64)) return { coding, start: readStart(reader), table: null };
  if (coding & 15) broken('RNG-004', 'lengths and a class', offset);
  return { coding, start: 0, table: readLengths(reader, LENGTHS) };
}

function decodeRow(coder, { coding, start, table }, count, signed) {
  const out = new Float64Array(count);
  if (table) coder.byLength(count, table, signed, out);
  else coder.integers(count, coding & 15, start, signed, out);
  return out;
}

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
    const first = readRow(reader, 0x5f);
    const second = readRow(reader, 0x6f);
    const p = second.coding & 32 ? readProbabilities(reader, 3) : null;
    const coder = new EntropyDecoder(reader.bytes(reader.left), reader.offset, first.coding & 16 ? 4 : 1);
    const gaps = decodeRow(coder, first, interpolation === 1 ? f - 1 : f, false);
    const differences = decodeRow(coder, second, f * C, p === null);
    if (p !== null) coder.signs(f * C, p, differences);
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
