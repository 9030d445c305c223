// Channels in their bands: the numbers of a stretch of ticks, out of the packets of its tracks (clause 10).
import { decodePacket } from '../decoder/codecs.js';
import { HapfError, unsupported } from '../decoder/error.js';
import { intersect, pushSpan } from '../decoder/spans.js';
import { Lru } from './lru.js';

const DECODED = 2 ** 26; // bytes that are kept
export const PACKET_BOUND = 2 ** 24; // samples of one packet

// The channels of a file: { index, track, component, parts: [{ base, hf, component }] }.
export function channelsOf({ tracks }) {
  const channels = new Map();
  for (const track of tracks.values()) {
    if (track.kind === 'events' || track.kind === 'hf') continue;
    const { hf } = track;
    track.channels.forEach((index, component) => {
      if (!channels.has(index)) channels.set(index, { index, track, component, parts: [] });
      if (!track.unsupported && track.setup) channels.get(index).parts.push({ base: track, hf: hf && hf.setup ? hf : null, component });
    });
  }
  return [...channels.values()].sort((a, b) => a.index - b.index);
}

export const hasBands = (channel) => channel.parts.some(({ base }) => base.kind === 'lf');

// Whether the numbers of a band are counts, else they are values.
export function isCounted({ parts, track }, band) {
  return band === 'hf' || (track.numberFormat === 'counts' && parts.every(({ base }) => base.codec !== 'LPCX'));
}

// The tracks of one part that a band needs, null where the part has nothing in it (DEC-003, DEC-005).
function tracksOf({ base, hf }, band) {
  if (band === 'hf') return hf ? [hf] : null;
  if (band === 'lf' || base.kind === 'full') return [base];
  return hf ? [base, hf] : null;
}

export class Signals {
  // onFault: takes a packet that does not decode.
  constructor(packets, onFault) {
    this.packets = packets;
    this.onFault = onFault;
    this.decoded = new Lru(DECODED);
    this.faulty = new Set();
    this.samplesDecoded = 0;
    this.decodeMs = 0;
  }

  // Numbers of the ticks first <= tick < stop and the spans that have any; what is between spans is not defined.
  // -> { values: Int32Array of counts | Float64Array of values, spans }.
  async numbers(channel, band, first, stop, signal) {
    const values = new (isCounted(channel, band) ? Int32Array : Float64Array)(stop - first);
    const parts = channel.parts.map((part) => ({ part, wanted: tracksOf(part, band) })).filter(({ wanted }) => wanted);
    const ranges = new Map(parts.flatMap(({ wanted }) => wanted.map(({ id }) => [id, [first, stop]])));
    const found = ranges.size ? await this.packets.find(ranges, signal) : new Map();
    const spans = [];
    for (const { part, wanted } of parts) {
      const [track, residual] = wanted;
      const put = (target) => (id) => this.put(id, part.component, found.get(id.id), target, first, stop, signal);
      let own = await put(values)(track);
      if (residual) {
        const e = new Int32Array(stop - first);
        own = intersect(own, await put(e)(residual));
        const { countMin: low, countMax: high } = track;
        for (const [from, to] of own) {
          for (let i = from - first; i < to - first; i++) {
            const sum = values[i] + e[i];
            values[i] = sum < low ? low : sum > high ? high : sum; // DEC-001
          }
        }
      }
      spans.push(...own);
    }
    if (parts.length > 1) spans.sort((a, b) => a[0] - b[0]);
    const joined = [];
    for (const [from, to] of spans) pushSpan(joined, from, to);
    return { values, spans: joined };
  }

  async put(track, component, packets, target, first, stop, signal) {
    const spans = [];
    const { componentCount: C, calibrations, numberFormat } = track;
    const calibrated = target instanceof Float64Array && numberFormat === 'counts' ? calibrations[component] : null;
    const copy = (packet, numbers) => {
      const from = Math.max(packet.start, first);
      const to = Math.min(packet.start + packet.span, stop);
      const base = (from - packet.start) * C + component;
      if (calibrated && numbers instanceof Int32Array) {
        const { A, B, D } = calibrated;
        for (let i = from - first, j = base; i < to - first; i++, j += C) target[i] = (numbers[j] * A + B) / D;
      } else if (C === 1) {
        target.set(numbers.subarray(base, base + to - from), from - first);
      } else {
        for (let i = from - first, j = base; i < to - first; i++, j += C) target[i] = numbers[j];
      }
      pushSpan(spans, from, to);
    };
    const run = [];
    const flush = async () => {
      await this.packets.each(run.splice(0), signal, (packet, bytes) => {
        const numbers = this.decode(track, packet, bytes);
        if (numbers) copy(packet, numbers);
      });
    };
    for (const packet of packets) {
      if (this.faulty.has(packet.offset)) continue;
      const known = this.decoded.get(packet.offset);
      if (!known) {
        run.push(packet);
        continue;
      }
      if (run.length) await flush();
      copy(packet, known);
    }
    if (run.length) await flush();
    return spans;
  }

  // The numbers of a packet, or null where it breaks a rule: counts, or values where it has exact ones.
  decode(track, packet, bytes) {
    const began = performance.now();
    const { start, span, offset, size } = packet;
    try {
      if (span * track.componentCount > PACKET_BOUND) unsupported('LIM-003', `a packet of ${span} ticks`, offset);
      const exact = track.codec === 'LPCX';
      const { numbers, exact: doubles } = decodePacket(track, bytes, start, span, { exact, offset });
      const values = exact ? new Float64Array(doubles.buffer) : valuesOf(track.numberFormat, numbers);
      this.samplesDecoded += numbers.length;
      this.decoded.set(offset, values, values.byteLength + 200);
      return values;
    } catch (error) {
      if (!(error instanceof HapfError)) throw error;
      this.faulty.add(offset);
      this.onFault({ track, start, stop: start + span, offset, size, error });
      return null;
    } finally {
      this.decodeMs += performance.now() - began;
    }
  }
}

function valuesOf(format, numbers) {
  switch (format) {
    case 'counts': return numbers;
    case 'binary64': return new Float64Array(numbers.buffer);
    case 'binary32': return Float64Array.from(new Float32Array(numbers.buffer));
    case 'binary16': return Float64Array.from(numbers, half);
    case 'int64': return Float64Array.from(new BigInt64Array(numbers.buffer), Number);
    default: return Float64Array.from(numbers, Number);
  }
}

function half(word) {
  const sign = word & 0x8000 ? -1 : 1;
  const exponent = (word >> 10) & 31;
  const fraction = word & 1023;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? (fraction + 1024) * 2 ** (exponent - 25) : fraction * 2 ** -24);
}

// Physical values of a stretch, NaN where there is no sample (VAL-003).
export function physical(channel, band, { values, spans }, first) {
  const out = new Float64Array(values.length).fill(NaN);
  const counted = values instanceof Int32Array;
  const { A, B, D } = counted ? scaleOf(channel, band) : { A: 1, B: 0, D: 1 };
  for (const [from, to] of spans) {
    if (counted) for (let i = from - first; i < to - first; i++) out[i] = (values[i] * A + B) / D;
    else out.set(values.subarray(from - first, to - first), from - first);
  }
  return out;
}

// DEC-005: B is 0 where only HF is wanted.
export function scaleOf({ track, component }, band) {
  const { A, B, D } = track.calibrations[component];
  return { A, B: band === 'hf' ? 0 : B, D };
}
