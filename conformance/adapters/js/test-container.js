// Checks of conformance/components that speak of chunks and times, as in test-components.js.
import { readClock, readMap } from './ancillary.js';
import { hasCrc, placePackets, readTable, tableFaults } from './cluster.js';
import { broken } from './error.js';
import { limitsOf } from './limits.js';
import { readStrings } from './lists.js';
import { salvage } from './salvage.js';
import { firstTick, secondsOf, tickOfTime, timeOfTick } from './times.js';

const bytesOf = (text) => Uint8Array.from(text.match(/../g) ?? [], (pair) => parseInt(pair, 16));
const LEVEL = limitsOf(1);
const NO_TRACK = 0xffff;

const everyTrack = { get: () => ({ kind: 'full', componentCount: 1 }), has: () => true };

function firstTracks(count) {
  return new Map(Array.from({ length: count }, (_, id) => [id, { id, kind: 'full', componentCount: 1 }]));
}

const pointsOf = (c) => c.points.map(([tick, time]) => ({ tick, timeNs: BigInt(time) }));

export const containers = {
  strings(c) {
    const texts = readStrings({ type: 2, value: bytesOf(c.bytes), offset: 0 }, c.components);
    return { texts: texts.length === 1 ? Array(c.components).fill(texts[0]) : texts };
  },
  cluster(c) {
    const bytes = bytesOf(c.payload);
    const table = readTable(bytes, 0, bytes.length, LEVEL.packetBound);
    const [fault] = tableFaults(table, 0, bytes.length, everyTrack, LEVEL);
    if (fault) throw fault;
    const packets = placePackets(table.entries, table.tableEnd);
    for (const packet of packets) if (!hasCrc(bytes, packet, packet.offset)) broken('DAT-004', 'the CRC differs', packet.at);
    return { entries: packets.map(({ track, size, start, span, crc, offset }) => ({ track, size, start, span, crc, offset })) };
  },
  salvage(c) {
    const bytes = bytesOf(c.bytes);
    const chunk = { payloadStart: 0, payloadSize: c.payload_size, next: c.next_header };
    const { kept } = salvage(bytes, chunk, firstTracks(8), LEVEL, { take() {} });
    return { kept: kept.map(({ at, offset, track, size, start, span }) => [at, offset, track, size, start, span]) };
  },
  'clock-chunks'(c) {
    const bytes = bytesOf(c.payload);
    const chunk = { payloadStart: 0, end: bytes.length, track: NO_TRACK, position: 0 };
    if (c.chunk === 'cMAp') {
      const { name, points } = readMap(bytes, chunk, new Map(), false);
      return { clock: name, points: points.map(({ tick, timeNs }) => [tick, timeNs]) };
    }
    const { name, observations } = readClock(bytes, chunk, new Map(), false);
    return { clock: name, observations: observations.map(({ tick, timeNs, uncertaintyNs }) => [tick, timeNs, uncertaintyNs]) };
  },
  'clock-maps'(c) {
    const points = pointsOf(c);
    return {
      times_of_ticks: c.times_of_ticks.map(([tick]) => [tick, timeOfTick(points, tick)]),
      ticks_of_times: c.ticks_of_times.map(([time]) => [time, tickOfTime(points, time)]),
    };
  },
  times(c) {
    const rate = { rateNum: c.rate[0], rateDen: c.rate[1] };
    if (c.tick !== undefined) return { seconds: secondsOf(rate, c.tick).map(Number) };
    const [start, stop] = [c.from, c.to].map((text) => {
      const [n, d] = text.split('/');
      return Number(firstTick(rate, n, d ?? 1));
    });
    return { start, stop };
  },
};
