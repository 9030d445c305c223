// KNOT (9.1): knots in varints, and the ticks between knots, whatever their coding.
import { Reader } from './bytes.js';
import { decodeCodedKnots } from './coded-knots.js';
import { broken } from './error.js';
import { readGrid } from './grid.js';
import { putHold, putLine } from './lines.js';

export function parseKnot(reader, track) {
  const { offset } = reader;
  const interpolation = reader.u8();
  const coding = reader.u8();
  if (interpolation > 1 || coding > 1) broken('KNT-001', `interpolation ${interpolation}, coding ${coding}`, offset);
  return { interpolation, coding, grid: readGrid(reader, track.level) };
}

// onKnot(tick within the packet, counts before they are clamped): called for each knot.
export function decodeKnot(track, bytes, span, out, offset, exact = false, onKnot = () => {}) {
  (track.setup.coding === 1 ? decodeCodedKnots : decodePlainKnots)(track, bytes, span, out, offset, onKnot);
}

function decodePlainKnots(track, bytes, span, out, offset, onKnot) {
  const { componentCount: C, countMin: low, countMax: high } = track;
  const { interpolation, grid } = track.setup;
  const { highest } = grid;
  const reader = new Reader(bytes, { base: offset, requirement: 'KNT-002' });
  const index = new Float64Array(C);
  const from = new Float64Array(C); // counts of the knot before
  const to = new Float64Array(C);
  let tick = 0;

  const readCounts = () => {
    for (let c = 0; c < C; c++) {
      const at = reader.offset;
      index[c] += reader.svarint();
      if (Math.abs(index[c]) > highest) broken('LPC-003', `index ${index[c]} is not on the grid`, at);
      to[c] = grid.count(index[c]);
    }
  };

  readCounts();
  onKnot(0, to);
  from.set(to);
  while (reader.left > 0) {
    const at = reader.offset;
    const ticks = reader.varint();
    if (ticks < 1) broken('KNT-003', 'two knots of one tick', at);
    if (tick + ticks >= span) broken('KNT-003', `a knot at tick ${tick + ticks} of ${span}`, at);
    readCounts();
    for (let c = 0; c < C; c++) {
      if (interpolation === 0) putHold(out, tick * C + c, C, ticks, from[c], low, high);
      else putLine(out, tick * C + c, C, ticks, from[c], to[c], ticks, low, high);
    }
    from.set(to);
    tick += ticks;
    onKnot(tick, to);
  }
  // What the last knot says of the ticks from its own on: all of them with hold, and with a single knot.
  if (interpolation === 1 && tick > 0 && tick < span - 1) {
    broken('KNT-003', `the last knot at tick ${tick} of ${span}`, reader.offset);
  }
  for (let c = 0; c < C; c++) putHold(out, tick * C + c, C, span - tick, from[c], low, high);
}
