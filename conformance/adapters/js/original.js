// A file against its original (clause 11): contracts that do not hold, channels without one that are not the source.
import { channelsOf, countSpans } from './channels.js';
import { intersect } from './spans.js';
import { physicalValue, wordValue } from './values.js';

// The numbers of a job's channel, as they stand in its raw file.
class Source {
  constructor({ format = 'counts', calibration, spans }, bytes) {
    this.format = format;
    const [A, B, D] = calibration ?? [1, 0, 1];
    this.calibration = { A, B, D };
    this.spans = spans;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  // Those of some spans within its own: BigInts, words as their pattern.
  numbers(spans) {
    const out = [];
    let at = 0; // place of the first tick of own span i
    let i = 0;
    for (const [start, stop] of spans) {
      while (this.spans[i][1] <= start) {
        at += this.spans[i][1] - this.spans[i][0];
        i++;
      }
      for (let t = start; t < stop; t++) {
        const offset = 8 * (at + t - this.spans[i][0]);
        out.push(this.format === 'counts' ? this.view.getBigInt64(offset, true) : this.view.getBigUint64(offset, true));
      }
    }
    return out;
  }
}

const cell = new DataView(new ArrayBuffer(8));
const patternOf = (v) => {
  cell.setFloat64(0, v);
  return cell.getBigUint64(0);
};

// x of clause 11: the count nearest to the source value.
function countOf(source, number, { A, B, D }) {
  if (source.format === 'counts') return Number(number);
  const value = Number(wordValue(source.format, number));
  return Math.round((value * D - B) / A);
}

const sameCalibration = (a, b) => a.A === b.A && a.B === b.B && a.D === b.D;

// Ticks where a part of a channel without a contract is not its source (DBC-004).
function differing(part, source, spans) {
  const { track } = part.entry;
  const calibration = track.calibrations[part.component];
  const wanted = source.numbers(spans);
  const count = (same) => wanted.reduce((sum, number, i) => sum + (same(number, i) ? 0 : 1), 0);
  const found = part.numbers(spans);
  if (track.numberFormat !== 'counts') {
    return track.numberFormat === source.format ? count((word, i) => word === BigInt(found[i])) : wanted.length;
  }
  if (source.format === 'counts') {
    return sameCalibration(calibration, source.calibration) ? count((x, i) => x === BigInt(found[i])) : wanted.length;
  }
  if (source.format === 'int64' || source.format === 'uint64') {
    const { A, B, D } = calibration;
    return count((word, i) => BigInt(found[i]) * BigInt(A) + BigInt(B) === wordValue(source.format, word) * BigInt(D));
  }
  const patterns = part.isExact ? part.exact(spans) : Array.from(found, (y) => patternOf(physicalValue(calibration, y)));
  return count((word, i) => patternOf(wordValue(source.format, word)) === patterns[i]);
}

// |x - y| * kd and max(kn * |x - zero|, floor * kd): below 2^53 at any level (Annex A).
function scalarSides({ kn, kd, floors, zeros }, c, x, y) {
  return [Math.abs(x - y) * kd, Math.max(kn * Math.abs(x - zeros[c]), floors[c] * kd)];
}

// The same of the vector form, by squares.
function vectorSides({ kn, kd, floors, zeros }, xs, ys) {
  let left = 0n;
  let right = 0n;
  xs.forEach((x, c) => {
    left += BigInt((x - ys[c]) * kd) ** 2n;
    right += BigInt((x - zeros[c]) * kn) ** 2n;
  });
  const floor = BigInt(floors[0] * kd) ** 2n;
  return [left, right > floor ? right : floor];
}

function contractOf(part) {
  return (part.residual ?? part.entry).track.contract;
}

// All parts of a track with a contract: { outside, worst } for each component.
function checkContract(contract, parts, sources, spans) {
  const calibrations = parts[0].entry.track.calibrations;
  const ys = parts.map((part) => part.numbers(spans));
  const xs = sources.map((source, c) => source.numbers(spans).map((number) => countOf(source, number, calibrations[c])));
  const results = parts.map(() => ({ outside: 0, worst: 0 }));
  for (let t = 0; t < countSpans(spans); t++) {
    if (contract.vector) {
      const [left, right] = vectorSides(contract, xs.map((x) => x[t]), ys.map((y) => y[t]));
      const ratio = Math.sqrt(Number(left) / Number(right));
      for (const result of results) {
        if (left > right) result.outside++;
        result.worst = Math.max(result.worst, ratio);
      }
    } else {
      parts.forEach((_, c) => {
        const [left, right] = scalarSides(contract, c, xs[c][t], ys[c][t]);
        if (left > right) results[c].outside++;
        results[c].worst = Math.max(results[c].worst, left / right);
      });
    }
  }
  return results;
}

// job: as of the verb encode; read(name): the bytes of a file beside it. -> { contracts, kept }; kept is false where a
// channel without contract is not its source, or a guaranteed contract does not hold.
export function checkOriginal(file, decoded, job, read) {
  const { channels } = channelsOf(file, decoded);
  const sources = job.channels.map((channel) => new Source(channel, read(channel.numbers)));
  const results = new Map(sources.map((_, channel) => [channel, { channel, outside: 0, worst: 0 }]));
  let kept = channels.length === sources.length;
  const partsOf = new Map(); // entry -> its parts, one for each component
  for (const { channel, parts, spans } of channels) {
    const source = sources[channel];
    if (!source) continue;
    // A sample that there is on one side only is outside.
    const common = countSpans(intersect(source.spans, spans));
    const lone = countSpans(source.spans) + countSpans(spans) - 2 * common;
    results.get(channel).outside += lone;
    if (lone > 0) kept = false;
    for (const part of parts) {
      if (!partsOf.has(part.entry)) partsOf.set(part.entry, []);
      partsOf.get(part.entry)[part.component] = part;
    }
  }
  for (const [{ track }, parts] of partsOf) {
    const own = track.channels.map((channel) => sources[channel]);
    if (own.includes(undefined)) continue;
    const contract = contractOf(parts[0]);
    let found;
    if (contract) {
      const spans = own.reduce((all, source) => intersect(all, source.spans), parts[0].spans);
      found = checkContract(contract, parts, own, spans);
    } else {
      found = parts.map((part, c) => {
        const outside = differing(part, own[c], intersect(own[c].spans, part.spans));
        return { outside, worst: outside > 0 ? null : 0 };
      });
    }
    found.forEach(({ outside, worst }, c) => {
      const result = results.get(track.channels[c]);
      result.outside += outside;
      result.worst = worst === null || result.worst === null ? null : Math.max(result.worst, worst);
      if (outside > 0 && (!contract || contract.guaranteed)) kept = false;
    });
  }
  for (const source of sources.keys()) {
    if (channels.some(({ channel }) => channel === source)) continue;
    results.get(source).outside = countSpans(sources[source].spans);
    kept = false;
  }
  return { contracts: [...results.values()], kept };
}
