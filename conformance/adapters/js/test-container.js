// Checks of conformance/components about chunks and times, as in test-components.js.
import { readClock, readMap } from '../../../hapfmt/viewer/decoder/ancillary.js';
import { clusterSeed, seedOf } from '../../../hapfmt/viewer/decoder/chunk.js';
import { hasCrc, placePackets, readTable, tableFaults } from '../../../hapfmt/viewer/decoder/cluster.js';
import { checkContracts } from '../../../hapfmt/viewer/decoder/contract.js';
import { broken } from '../../../hapfmt/viewer/decoder/error.js';
import { limitsOf } from '../../../hapfmt/viewer/decoder/limits.js';
import { readStrings } from '../../../hapfmt/viewer/decoder/lists.js';
import { salvage } from '../../../hapfmt/viewer/decoder/salvage.js';
import { firstTick, secondsOf, tickOfTime, timeOfTick } from '../../../hapfmt/viewer/decoder/times.js';

const bytesOf = (text) => Uint8Array.from(text.match(/../g) ?? [], (pair) => parseInt(pair, 16));
const LEVEL = limitsOf(1);
const SEED = clusterSeed(seedOf('0x0000000000000007'), 2);

const everyTrack = { get: () => ({ kind: 'full', componentCount: 1 }), has: () => true };

const pointsOf = (c) => c.points.map(([tick, time]) => ({ tick, timeNs: BigInt(time) }));

export const containers = {
  strings(c) {
    const texts = readStrings({ type: 2, value: bytesOf(c.bytes), offset: 0 }, c.components);
    return { texts: texts.length === 1 ? Array(c.components).fill(texts[0]) : texts };
  },
  cluster(c) {
    const bytes = bytesOf(c.payload);
    const table = readTable(bytes, 0, bytes.length, LEVEL.packetBound);
    const [fault] = tableFaults(bytes, table, 0, bytes.length, everyTrack, LEVEL, SEED);
    if (fault) throw fault;
    const packets = placePackets(table.entries, table.tableEnd);
    for (const packet of packets) if (!hasCrc(bytes, packet, packet.offset, SEED)) broken('DAT-004', 'the CRC differs', packet.at);
    return { entries: packets.map(({ track, size, start, span, crc, offset }) => ({ track, size, start, span, crc, offset })) };
  },
  salvage(c) {
    const bytes = bytesOf(c.bytes);
    const chunk = { payloadStart: 0, payloadSize: c.payload_size, next: c.next_header };
    const { kept } = salvage(bytes, chunk, LEVEL, SEED, { take() {} });
    return { kept: kept.map(({ offset, track, size, start, span }) => [offset, track, size, start, span]) };
  },
  'clock-chunks'(c) {
    const bytes = bytesOf(c.payload);
    const chunk = { payloadStart: 0, end: bytes.length, track: null, position: 0 };
    if (c.chunk === 'cMAp') {
      const { name, points } = readMap(bytes, chunk, everyTrack, true);
      return { track: chunk.track, clock: name, points: points.map(({ tick, timeNs }) => [tick, timeNs]) };
    }
    const { name, observations } = readClock(bytes, chunk, everyTrack, true);
    return { track: chunk.track, clock: name, observations: observations.map(({ tick, timeNs, uncertaintyNs }) => [tick, timeNs, uncertaintyNs]) };
  },
  'clock-maps'(c) {
    const points = pointsOf(c);
    return {
      times_of_ticks: c.times_of_ticks.map(([tick]) => [tick, timeOfTick(points, tick)]),
      ticks_of_times: c.ticks_of_times.map(([time]) => [time, tickOfTime(points, time)]),
    };
  },
  // A file of one packet that holds y, against x.
  contract(c) {
    const { kn, kd, floor: floors, zero: zeros, vector, x, y } = c;
    if (y.flat().some((count) => count !== (count | 0))) return {}; // no file has such counts
    const span = y[0].length;
    const words = new Int32Array(y.flat());
    const planes = Uint8Array.from({ length: 4 * words.length + 1 }, (_, i) => {
      const [component, byte, tick] = [Math.floor((i - 1) / span / 4), Math.floor((i - 1) / span) % 4, (i - 1) % span];
      return i === 0 ? 0 : (words[component * span + tick] >> (8 * byte)) & 255;
    });
    const track = {
      id: 0, kind: 'full', codec: 'RAWB', numberFormat: 'counts', componentCount: y.length, countMin: -(2 ** 31), countMax: 2 ** 31 - 1,
      channels: y.map((_, component) => component), calibrations: y.map(() => ({ A: 1, B: 0, D: 1 })), setup: { wordSize: 4 },
      contract: { kn, kd, floors, zeros, vector, guaranteed: true }, base: null, level: 2,
    };
    const file = { tracks: new Map([[0, track]]), packets: [{ track: 0, start: 0, span, bytes: planes, offset: 0 }] };
    const job = { channels: x.map(() => ({ format: 'counts', spans: [[0, span]] })) };
    const found = checkContracts(file, job, x.map((row) => new BigUint64Array(BigInt64Array.from(row, BigInt).buffer)));
    // They tell how many ticks are outside, and the ratio as a Number.
    const near = ([n, d], { worst }) => Math.abs(worst - Math.sqrt(Number(n) / Number(d))) <= 1e-12 * worst;
    const told = vector ? found.slice(0, 1) : found;
    return {
      outside: told.map(({ outside }, i) => (outside === c.outside[i].length ? c.outside[i] : outside)),
      worst_squared: told.map((one, i) => (near(c.worst_squared[i], one) ? c.worst_squared[i] : one.worst)),
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
