// Support points of the slow part, and how far from them the contract lets the source be.
import { decodeKnot } from '../decoder/knot.js';
import { HapfError } from '../decoder/error.js';
import { PACKET_BOUND } from './signals.js';
import { secondsAt } from './ticks.js';

// -> { time, value, lower, upper }: physical, in order of time; NaN where there is no contract.
export async function knotsBetween(packets, channel, first, stop, signal) {
  const { track, component } = channel;
  const tracks = channel.parts.map(({ base }) => base).filter(({ codec }) => codec === 'KNOT');
  const ranges = new Map(tracks.map(({ id }) => [id, [first, stop]]));
  const found = ranges.size ? await packets.find(ranges, signal) : new Map();
  const rows = [];
  for (const base of tracks) {
    const { countMin, countMax, calibrations, contract } = base;
    const { A, B, D } = calibrations[component];
    const physical = (count) => (count * A + B) / D;
    const decodable = found.get(base.id).filter(({ span }) => span * base.componentCount <= PACKET_BOUND);
    await packets.each(decodable, signal, (packet, bytes) => {
      const start = rows.length;
      try {
        const out = new Int32Array(packet.span * base.componentCount);
        decodeKnot(base, bytes, packet.span, out, packet.offset, false, (at, counts) => {
          const tick = packet.start + at;
          if (tick < first || tick >= stop) return;
          const y = Math.min(Math.max(counts[component], countMin), countMax);
          const edges = contract ? edgesOf(contract, component, y).map(physical) : [NaN, NaN];
          rows.push([tick, physical(y), Math.min(...edges), Math.max(...edges)]);
        });
      } catch (error) {
        // The packet has no samples either, and damage() lists it.
        if (!(error instanceof HapfError)) throw error;
        rows.length = start;
      }
    });
  }
  rows.sort((a, b) => a[0] - b[0]);
  const column = (n) => Float64Array.from(rows, (row) => row[n]);
  return { time: Float64Array.from(rows, ([tick]) => secondsAt(track, tick)), value: column(1), lower: column(2), upper: column(3) };
}

// The least and the largest x with |x - y| * kd <= max(kn * |x - zero|, floor * kd) (DBC-002), as real numbers.
export function edgesOf({ kn, kd, vector, floors, zeros }, component, y) {
  const floor = floors[vector ? 0 : component];
  const zero = zeros[component];
  const far = Math.abs(y - zero);
  const side = y < zero ? -1 : 1;
  const fraction = kn / kd;
  const inner = far / (1 + fraction);
  const outer = fraction < 1 ? far / (1 - fraction) : Infinity;
  const near = zero + side * Math.min(inner, far - floor);
  const away = zero + side * Math.max(outer, far + floor);
  return side < 0 ? [away, near] : [near, away];
}
